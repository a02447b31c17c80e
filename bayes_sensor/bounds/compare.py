"""All bound methods on one campaign, side by side."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_sensor.bounds.bound import Bound
from bayes_sensor.bounds.bounds_table import Bounds
from bayes_sensor.bounds.context import Evidence, Progress, check_data
from bayes_sensor.bounds.methods import METHODS, BoundMethod
from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.fit import Fit
from bayes_sensor.fit.fit_warnings import OF_LAGS
from bayes_sensor.fit.identifiability import coloured_noise, slow_noise
from bayes_sensor.fit.least_squares import fit_or_given
from bayes_sensor.likelihood.held_values import refuse_held
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.lags import Naming
from bayes_sensor.workers import one_thread

Method = Callable[[Evidence], Bound]

TOO_SLOW_TO_JUDGE = "too little of it is seen to judge the spread of least squares"
FEW_STRETCHES = (
    "its law rests on few independent stretches and phi is likely to be taken too low, so that "
    "intervals may be too narrow; those of the posterior allow for it"
)

CLOSE = 0.5
"""tau over tau_v above which a Gaussian about one of the two orders is too narrow"""


def close_words(lags: Sequence[str]) -> str:
    """What lags of these names that are close do to intervals."""
    return (
        f"{' and '.join(lags)} are close, and the cascade is unchanged when they swap: intervals "
        "about one order may be too narrow, those of the profile are not"
    )


def why_mute(evidence: Evidence, method: BoundMethod) -> str:
    """Why a method has no value for these data, as a sentence; empty where it has."""
    if not method.needs_posterior and not evidence.fit.step_seen:
        return "no step is seen in any experiment"
    # a lag, or a volume, too small to see is an ordinary outcome
    ordinary = [*evidence.fit.unseen, *(evidence.fit.names[:1] if evidence.at_bound else [])]
    names = evidence.fit.names[: evidence.fit.n_shared]
    shared = [n for n in evidence.fit.at_bound if n in names]
    walled = [n for n in shared if n not in ordinary]
    if method.least_squares and walled:
        return f"least squares ended at the edge of its search in {', '.join(walled)}"
    if method.noise == "residuals":
        slow = slow_noise(evidence.problem, evidence.coloured_theta)
        return slow and f"{slow}: {TOO_SLOW_TO_JUDGE} ({_modelling()} model it)"
    return ""


def _modelling() -> str:
    """The names of the methods that model the noise, as a list in words."""
    *names, last = (m.name for m in METHODS.values() if m.noise in ("fitted", "averaged"))
    return f"{', '.join(names)} and {last}"


def doubts(evidence: Evidence, method: BoundMethod) -> list[str]:
    """Warnings on a method's intervals for these data, in sentences."""
    found = []
    theta = evidence.theta
    lags = evidence.problem.commuting.without_volumes.lags(theta)
    if not method.both_orders and (lags[:-1] > CLOSE * lags[1:]).any():
        names = evidence.problem.commuting.without_volumes.names
        found.append(close_words([name.removesuffix("_s") for name in names]))
    if method.noise == "white":
        found.append(coloured_noise(evidence.problem, theta))
        found += evidence.noise_doubts
    if method.noise == "fitted":
        slow = slow_noise(evidence.problem, evidence.coloured_theta)
        found.append(slow and f"{slow}: {FEW_STRETCHES}")
        found += evidence.noise_doubts
    return [sentence for sentence in found if sentence]


def _record(name: str, method: Method) -> BoundMethod:
    return method if isinstance(method, BoundMethod) else BoundMethod(name, name, "", method)


def with_remark(bound: Bound, remark: str) -> Bound:
    """The bound with one more sentence in its status."""
    status = remark if bound.status == "ok" else f"{bound.status}; {remark}"
    return replace(bound, status=status)


def without_roles(bound: Bound, reason: str) -> Bound:
    """The bound without its values of lags and volumes but for the sensor's, which refer to one of
    two fits only."""
    lost = np.array([name.startswith(("tau_v_s", "tau_", "V_")) and name != "tau_s"
                     for name in bound.names])  # fmt: skip
    return replace(
        with_remark(bound, reason),
        sd=np.where(lost, np.nan, bound.sd),
        low=np.where(lost[:, None], np.nan, bound.low),
        high=np.where(lost[:, None], np.nan, bound.high),
    )


def with_names(bound: Bound, naming: Naming) -> Bound:
    """The bound with its lags under the names that may be stated, or by size."""
    names, arrays = list(bound.names), [bound.estimate, bound.sd, bound.low, bound.high]
    estimate, sd, low, high = (array.copy() for array in arrays)
    shared = naming.commuting.shared
    for name, (label, factor) in zip(shared, naming.labels, strict=True):
        i = bound.names.index(name)
        names[i] = label
        for array in (estimate, sd, low, high):
            array[i] *= factor
    unnamed = tuple(name for name in shared if name not in names)
    return replace(
        bound, names=names, estimate=estimate, sd=sd, low=low, high=high, unnamed=unnamed
    )


def with_words(bound: Bound, naming: Naming) -> Bound:
    """The bound with the names of tau, tau_v and V in its status replaced by those that may be
    stated.

    A posterior's own status has the right names already, and does not come here.
    """
    shared = naming.commuting.shared
    words = dict(zip(shared, (name for name, _ in naming.labels), strict=True))
    for name, label in tuple(words.items()):
        if name.startswith("tau"):
            words[name.removesuffix("_s")] = OF_LAGS.get(label, label.removesuffix("_s"))
    known = "|".join(re.escape(name) for name in sorted(words, key=len, reverse=True))
    status = re.sub(rf"\b({known})(?![\w\[])", lambda m: words[m[0]], bound.status)
    return replace(bound, status=status)


@one_thread
def compare_bounds(
    campaign: Campaign | Problem,
    fit: Fit | None = None,
    posterior: Any = None,
    methods: str | Sequence[str] | Mapping[str, Method] | None = None,
    seed: int = 1,
    progress: Progress | None = None,
    n_resamples: int = 400,
) -> Bounds:
    """Intervals of every parameter at 68, 95 and 99.7 % by every method.

    ``fit``: that of the campaign; None: it is made here.

    ``methods``: one or several names out of :data:`METHODS`, or another mapping of that shape;
    default all, the posterior only where one is given.  Methods based on least squares are centred
    on the fit, those with autocorrelated noise (``crlb_ar1``, ``profile``) on the maximum of that
    likelihood.

    A lag that cannot be assigned is named by its size (``lag_fast_s``, ``lag_slow_s``), and tau or
    tau_v has no value.

    If no step is visible, a method gives no value and the reason.  So does least squares if the
    noise is correlated over much of a record.

    Raises CampaignError for an unknown method, for ``posterior`` without one, for a fit or a
    posterior of another campaign, for a ``block_bootstrap`` of fewer than two resamples, or for
    data that allow no interval at all.
    """
    problem = as_problem(campaign)
    refuse_held(problem, "bounds")
    if methods is None:
        available = posterior is not None
        chosen = {k: m for k, m in METHODS.items() if available or not m.needs_posterior}
    elif isinstance(methods, Mapping):
        chosen = {k: _record(k, m) for k, m in methods.items()}
    else:
        names = [methods] if isinstance(methods, str) else methods
        unknown = [name for name in names if name not in METHODS]
        if unknown:
            raise CampaignError(f"no bound method '{unknown[0]}'; there are {', '.join(METHODS)}")
        chosen = {name: METHODS[name] for name in names}
    without = [k for k, m in chosen.items() if m.needs_posterior and posterior is None]
    if without:
        raise CampaignError(f"the method '{without[0]}' needs the posterior; sample it first")
    for e in problem.campaign:
        _ = e.values  # a design has no data to bound
    fit = fit_or_given(problem, fit, seed, "compare_bounds")
    if fit.cannot_tell:
        raise CampaignError(f"no interval can be given: {fit.cannot_tell}")
    bounds: dict[str, Bound] = {}
    seconds: dict[str, float] = {}
    done = 0

    def report(fraction: float, text: str) -> None:
        if progress is not None:
            progress((done + fraction) / len(chosen), text)

    evidence = Evidence(problem, fit, posterior, seed, n_resamples, report)
    check_data(problem, fit, posterior)
    # the draws know more of the names than the fit's Gaussian does
    naming = getattr(posterior, "naming", None) or fit.naming
    for name, method in chosen.items():
        report(0.0, name)
        start = time.perf_counter()
        mute = why_mute(evidence, method)
        if mute:
            bound = Bound.without_values(*evidence.of_mean(evidence.theta), mute)
            bound = replace(bound, method=name, assumes="that the data can tell")
        else:
            bound = method(evidence)
            if not method.needs_posterior:
                bound = with_words(bound, naming)
                bound = without_roles(bound, fit.twin) if fit.twin else bound
            for doubt in doubts(evidence, method):
                bound = with_remark(bound, doubt)
        bounds[name] = with_names(bound, naming)
        seconds[name] = time.perf_counter() - start
        done += 1
    report(0.0, "done")
    return Bounds(
        bounds,
        problem.campaign.signal_unit,
        seconds,
        (*fit.caveats, *evidence.noise_doubts),
        evidence.likelihood,
    )
