"""All bound methods on one campaign, side by side."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bayes_sensor.bounds.bootstrap import block_bootstrap
from bayes_sensor.bounds.classical import (
    crlb_ar1,
    crlb_iid,
    crlb_iid_one_percent_step,
    posterior_intervals,
)
from bayes_sensor.bounds.evidence import Evidence, Progress
from bayes_sensor.bounds.jackknife import jackknife_experiments
from bayes_sensor.bounds.profile import profile
from bayes_sensor.bounds.records import Bound, Bounds
from bayes_sensor.bounds.sandwich import sandwich
from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.fit import Fit
from bayes_sensor.likelihood import Problem, as_problem

Method = Callable[[Evidence], Bound]

METHODS: dict[str, Method] = {
    "crlb_iid": crlb_iid,
    "crlb_iid_one_percent_step": crlb_iid_one_percent_step,
    "crlb_ar1": crlb_ar1,
    "sandwich": sandwich,
    "sandwich_ar1": lambda evidence: sandwich(evidence, parametric=True),
    "block_bootstrap": block_bootstrap,
    "jackknife_experiments": jackknife_experiments,
    "profile": profile,
    "posterior": posterior_intervals,
}
"""every method by name; a caller may pass another mapping"""


def compare_bounds(
    campaign: Campaign | Problem,
    fit: Fit,
    posterior: Any = None,
    methods: Sequence[str] | Mapping[str, Method] | None = None,
    seed: int = 1,
    progress: Progress | None = None,
    n_resamples: int = 400,
) -> Bounds:
    """Intervals of every parameter at 68, 95 and 99.7 % by every method.

    ``methods``: names out of :data:`METHODS` or another mapping of that shape; default all, the
    posterior only where one is given.  Methods that rest on least squares are centred on the fit,
    those under coloured noise (``crlb_ar1``, ``profile``) on the maximum of that likelihood.

    Raises CampaignError for an unknown method, for ``posterior`` without one, or for a fit of
    another campaign.
    """
    problem = as_problem(campaign)
    if methods is None:
        chosen = {k: m for k, m in METHODS.items() if k != "posterior" or posterior is not None}
    elif isinstance(methods, Mapping):
        chosen = dict(methods)
    else:
        unknown = [name for name in methods if name not in METHODS]
        if unknown:
            raise CampaignError(f"no bound method '{unknown[0]}'; there are {', '.join(METHODS)}")
        chosen = {name: METHODS[name] for name in methods}
    if "posterior" in chosen and posterior is None:
        raise CampaignError("the method 'posterior' needs the posterior; sample it first")
    for e in problem.campaign:
        _ = e.values  # a design has no data to bound
    bounds: dict[str, Bound] = {}
    seconds: dict[str, float] = {}
    done = 0

    def report(fraction: float, text: str) -> None:
        if progress is not None:
            progress((done + fraction) / len(chosen), text)

    evidence = Evidence(problem, fit, posterior, seed, n_resamples, report)
    for name, method in chosen.items():
        report(0.0, name)
        start = time.perf_counter()
        bounds[name] = method(evidence)
        seconds[name] = time.perf_counter() - start
        done += 1
    return Bounds(bounds, problem.campaign.signal_unit, seconds, evidence.likelihood)
