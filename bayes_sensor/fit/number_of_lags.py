"""How many lags the data support: chains of one to four stages compared by their evidence.

Each chain is fitted by least squares from its neighbours, and then by likelihood under the
campaign's own noise law.  The log evidence is Schwarz's approximation, log L - k/2 log n (Annals
of Statistics 6, 1978, 461), for k parameters and n = sum of n_k (1 - phi)/(1 + phi) independent
samples: neighbours that are correlated do not count twice.  All numbers of lags have equal prior
odds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log
from typing import NamedTuple

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.fit.block_averages import averages
from bayes_sensor.fit.first_estimates import Look, first_look, initial_bounds
from bayes_sensor.fit.fit import Fit
from bayes_sensor.fit.fitted_noise import all_residuals, estimate_noise
from bayes_sensor.fit.lag_count import LagCount, supported
from bayes_sensor.fit.likelihood_maximum import likelihood_maximum
from bayes_sensor.fit.misfit import TOLERATED
from bayes_sensor.fit.refinement import refine, with_noise
from bayes_sensor.fit.starts import limits
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.rig import Rig
from bayes_sensor.rig.stages import KINDS
from bayes_sensor.workers import one_thread

MOST_LAGS = 4
"""lags up to which chains are compared; more only where the campaign's rig has more"""
SHARES = (0.1, 0.5)
"""of the longest lag: a further lag starts there"""
NEAR = 5.0
"""sampling intervals from which a further lag moves no switch to another interval"""
KINDS_COUNTED = ("lag", "volume")
"""kinds of stages that may be added or left out"""
FRESH = {"lag": ("filter", "probe: lag"), "volume": ("line", "cell")}
"""names of stages that a campaign's rig does not have"""


class LagNumbers(NamedTuple):
    """How many lags a chain has, by kind."""

    flat: int
    """that do not depend on flow, the sensor's among them"""
    volumes: int

    @property
    def n(self) -> int:
        """All lags."""
        return self.flat + self.volumes


@dataclass(frozen=True, eq=False)
class _Fitted:
    problem: Problem
    theta: FloatArray
    """(n_mean,) least squares"""
    cost: float


@one_thread
def count_lags(campaign: Campaign | Problem, fit: Fit) -> LagCount | None:
    """How many lags the data support; None where nothing can be compared.

    That is so where the model is not the exact chain, a parameter is held or tied, a stage is
    neither a lag nor a volume, or the fit has no step or no noise to judge by.
    """
    problem = as_problem(campaign)
    plain = problem.chain == "exact" and not problem.held
    plain = plain and not problem.campaign.ties
    kinds = [stage.kind.name for stage in problem.layout.rig.stages]
    if not plain or fit.cannot_tell or not fit.step_seen or not set(kinds) <= set(KINDS_COUNTED):
        return None
    looks = [first_look(e) for e in problem.campaign]
    own = LagNumbers(kinds.count("lag"), kinds.count("volume"))
    most_volumes = 0
    if problem.campaign.flows_known and not problem.campaign.same_flow:
        most_volumes = max(1, own.volumes)

    def with_stages(stages: tuple[str, ...]) -> Problem:
        other = replace(problem.campaign, stages=stages, side_information={}, sensor_is="unknown")
        return Problem(other, noise=problem.noise)

    theta = fit.theta_hat[: problem.layout.n_mean]
    first = _as_one_lag(problem, theta, with_stages(("sensor",)))
    chains = [
        LagNumbers(n - volumes, volumes)
        for n in range(1, max(MOST_LAGS, own.n) + 1)
        for volumes in range(most_volumes + 1)
        if n > volumes
    ]
    fitted: dict[LagNumbers, _Fitted] = {}
    likelihood: dict[LagNumbers, tuple[float, FloatArray]] = {}
    for chain in chains:
        if _left_behind(chain, {each: value for each, (value, _) in likelihood.items()}):
            continue
        stages = stages_of(problem.layout.rig, chain, most_volumes > 0)
        fitted[chain] = _least_squares(with_stages(stages), looks, _starts(chain, fitted, first))
        likelihood[chain] = _maximum(fitted[chain], looks)
    best = max(likelihood, key=lambda chain: likelihood[chain][0])
    n_samples = _independent(fitted[best].problem, likelihood[best][1])
    penalty = {
        chain: 0.5 * log(n_samples) * (len(found.problem.layout) - len(found.problem.fixed))
        for chain, found in fitted.items()
    }
    for chain in reversed(fitted):
        for less in _with_one_less(chain):
            gain = likelihood[chain][0] - penalty[chain]
            if less in fitted and gain > likelihood[less][0] - penalty[less]:
                start = _without_lag(fitted[chain].problem, likelihood[chain][1], less)
                if start is not None:
                    again = _climb(fitted[less].problem, start, looks)
                    likelihood[less] = max(likelihood[less], again, key=lambda found: found[0])
    values: dict[LagNumbers, float] = {}
    evidence: dict[int, float] = {}
    names: dict[int, tuple[str, ...]] = {}
    for chain in fitted:
        # a further lag of zero leaves the likelihood as it is
        fewer = [values[less] for less in _with_one_less(chain) if less in values]
        values[chain] = max(likelihood[chain][0], *fewer, -np.inf)
        value = values[chain] - penalty[chain]
        if value > evidence.get(chain.n, -np.inf):
            evidence[chain.n] = value
            names[chain.n] = fitted[chain].problem.campaign.stages
    highest = max(evidence.values())
    evidence = {n: value - highest for n, value in evidence.items()}
    missed = fit.misfit is not None and fit.misfit > TOLERATED
    return LagCount(supported(evidence), evidence, names, own.n, missed)


def _left_behind(chain: LagNumbers, likelihood: dict[LagNumbers, float]) -> bool:
    """Whether a chain is not worth a fit: the same with one lag less is further behind another of
    its length than its own last lag has brought, and a further lag brings less than the one before.
    """
    shorter, before = (chain._replace(flat=chain.flat - less) for less in (1, 2))
    if before.flat < 1:
        return False
    if shorter not in likelihood or before not in likelihood:
        return True
    highest = max(value for each, value in likelihood.items() if each.n == shorter.n)
    gain = max(likelihood[shorter] - likelihood[before], 0.0)
    return highest - likelihood[shorter] > gain


def stages_of(rig: Rig, chain: LagNumbers, flows_differ: bool) -> tuple[str, ...]:
    """The stages of a chain: those of ``rig``, as far as there are so many, then fresh ones.

    Where flows do not differ a volume is one more lag.
    """
    known = {word for kind in KINDS.values() for word in kind.words}
    own: dict[str, list[str]] = {"lag": [], "volume": []}
    for stage in rig.stages:
        if stage.name != "sensor":
            kind = stage.kind.name if flows_differ else "lag"
            word = stage.name
            if kind != stage.kind.name:
                continue  # a volume's name, for a lag
            own[kind].append(word if word in known else f"{word}: {kind}")
    found: list[str] = []
    for kind, number in (("lag", chain.flat - 1), ("volume", chain.volumes)):
        names = own[kind] + [name for name in FRESH[kind] if name not in own[kind]]
        names += [f"{kind}{i}: {kind}" for i in range(1, number + 1)]
        found += names[:number]
    return (*found, "sensor")


def _as_one_lag(problem: Problem, theta: FloatArray, alone: Problem) -> FloatArray:
    """(n_mean,) of a fit ``theta`` (n_mean,) with one lag for each sensor, as wide as the chain.

    Its square is the sum of squares, and the mean delay of every response is kept.
    """
    layout, other = problem.layout, alone.layout
    found = np.concatenate([np.zeros(other.n_shared), theta[layout.n_shared :]])
    wide: dict[int, list[float]] = {}
    moved: dict[int, float] = {}
    for k, e in enumerate(problem.campaign):
        taus = layout.taus(theta, k, e.total_flow)
        width = float(np.sqrt((taus**2).sum()))
        wide.setdefault(int(other.shared[k][0]), []).append(width)
        moved |= {int(i): float(taus.sum()) - width for i in other.switches(k)}
    for place, widths in wide.items():
        found[place] = float(np.median(widths))
    for i, shift in moved.items():
        found[i] += shift
    return found


def _with_one_less(chain: LagNumbers) -> tuple[LagNumbers, LagNumbers]:
    """The chains that lack one of its lags."""
    return LagNumbers(chain.flat - 1, chain.volumes), LagNumbers(chain.flat, chain.volumes - 1)


def _starts(
    chain: LagNumbers, fitted: dict[LagNumbers, _Fitted], first: FloatArray
) -> list[FloatArray]:
    """Starts (n_mean,) for a chain from those with one lag less."""
    if chain.n == 1:
        return [first]
    found = []
    for less in _with_one_less(chain):
        if less in fitted:
            parent = fitted[less]
            flat = less.flat < chain.flat
            found += [_with_lag(parent, share, flat) for share in SHARES]
    return found


def _with_lag(parent: _Fitted, share: float, flat: bool) -> FloatArray:
    """The parent's parameters (n_mean,) with one more lag, or volume, behind those of its kind."""
    layout, campaign = parent.problem.layout, parent.problem.campaign
    n, theta = layout.n_shared, parent.theta
    longest = float(
        np.median([layout.slowest(theta, k, e.total_flow) for k, e in enumerate(campaign)])
    )
    lag = share * longest
    flow = float(np.median([e.total_flow for e in campaign])) if not flat else 1.0
    n_flat = sum(not name.startswith("V_") for name in layout.shared_names)
    place = n_flat if flat else n
    later = theta.copy()
    for i in layout.all_switches:
        later[i] -= lag
    return np.insert(later, place, lag if flat else lag * flow)


def _least_squares(problem: Problem, looks: list[Look], starts: Sequence[FloatArray]) -> _Fitted:
    layout = problem.layout
    low, high = limits(layout, initial_bounds(problem, looks, None))
    points = averages(problem.campaign, looks, 40, 150)
    best: _Fitted | None = None
    for start in starts:
        begin = problem.commuting.by_size(np.clip(start, low, high))
        found = refine(
            problem,
            points,
            np.clip(begin, low, high),
            low,
            high,
            max_evaluations=60,
            tolerance=1e-8,
        )
        if best is None or found.cost < best.cost:
            best = _Fitted(problem, found.theta, found.cost)
    if best is None:
        raise CampaignError("number of lags: there is no start")
    return replace(best, theta=problem.commuting.without_volumes.by_size(best.theta))


def _maximum(found: _Fitted, looks: list[Look]) -> tuple[float, FloatArray]:
    """Highest log-likelihood of a chain, from its least squares, and where it is."""
    problem, layout = found.problem, found.problem.layout
    vector = with_noise(layout, found.theta)
    residuals, squares = all_residuals(problem, vector)
    rms = (sum(squares) / problem.campaign.n_samples) ** 0.5
    for name, value in estimate_noise(problem, residuals, rms).items():
        vector[layout.index(name)] = value
    return _climb(problem, problem.flat(vector), looks)


def _climb(problem: Problem, vector: FloatArray, looks: list[Look]) -> tuple[float, FloatArray]:
    layout, n = problem.layout, problem.layout.n_mean
    low, high = np.full(len(layout), -np.inf), np.full(len(layout), np.inf)
    low[:n], high[:n] = limits(layout, initial_bounds(problem, looks, None))
    for row in layout.noise:
        low[row] = (-0.99999, 0.0, 0.0)
        high[row[0]] = 0.99999
    return likelihood_maximum(problem, vector, low, high)


def _without_lag(problem: Problem, vector: FloatArray, less: LagNumbers) -> FloatArray | None:
    """A start for a chain from that with one lag more, ``vector`` (n_theta,), whose shortest is
    left out; None where that is well above the sampling interval.

    The response of one lag bends at its switch. With correlated noise each sampling interval in
    which the switch may lie then has a maximum of its own, and least squares may start in a wrong
    one.  The longer chain's response is smooth and has found its way.
    """
    layout, campaign = problem.layout, problem.campaign
    volumes = [i for i, name in enumerate(layout.shared_names) if name.startswith("V_")]
    flat = [i for i in range(layout.n_own, layout.n_shared) if i not in volumes]
    some = volumes if less.volumes < len(volumes) else flat
    gone = min(some, key=lambda i: float(vector[i]))
    start = np.array(vector)
    for k, e in enumerate(campaign):
        lag = vector[gone] / e.total_flow if gone in volumes else vector[gone]
        if lag > NEAR * e.interval:
            return None
        switches = layout.switches(k)
        start[switches] = vector[switches] + lag
    return np.delete(start, gone)


def _independent(problem: Problem, vector: FloatArray) -> float:
    """How many independent samples the campaign's are worth."""
    total = 0.0
    for k, e in enumerate(problem.campaign):
        phi = max(float(vector[problem.layout.noise[k, 0]]), 0.0)
        total += e.n_samples * (1.0 - phi) / (1.0 + phi)
    return max(total, 1.0)
