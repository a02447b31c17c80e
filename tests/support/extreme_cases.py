"""Campaigns at the edge of what can be told, each drawn from a truth that is returned with it.

Used by the tests and by ``paper/studies/study_extremes.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from bayes_sensor.bounds import compare_bounds
from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.fit import Fit, fit_least_squares
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import Posterior, Settings, sample_posterior
from bayes_sensor.rig.cascade import local_parameters
from tests.support.campaigns import small_design, small_theta


@dataclass(frozen=True)
class Extreme:
    """One kind of campaign and what may be said of it."""

    words: str
    make: Callable[[int], tuple[Problem, FloatArray]]
    """a drawn campaign as a Problem, and its truth (n_theta,), by seed"""
    sampler: str = "emcee"
    """which draws the posterior; ``independence`` is far quicker where it is of use"""


def _drawn(
    seed: int,
    design: Campaign | None = None,
    n_keep: int | None = None,
    **changes: float,
) -> tuple[Problem, FloatArray]:
    """A simulated small campaign with some of its truth changed."""
    design = design or small_design()
    phi, sigma = changes.pop("phi", 0.5), changes.pop("sigma", 0.02)
    beta = changes.pop("beta", None)
    theta = small_theta(design, phi, sigma, changes.pop("growth", sigma))
    theta.update(changes)
    if beta is not None:
        for values in theta["experiments"].values():
            values["beta_V"] = beta
    problem = Problem(design)
    return replace(problem, campaign=simulate(problem, theta, seed=seed)), problem.layout.flat(
        theta
    )


def two_samples(seed: int) -> tuple[Problem, FloatArray]:
    """All but two samples of each record are masked."""
    problem, theta = _drawn(seed)
    experiments = []
    for e in problem.campaign:
        used = np.zeros(len(e.t), dtype=bool)
        used[[len(e.t) // 3, len(e.t) // 2]] = True
        experiments.append(replace(e, mask=used))
    return Problem(replace(problem.campaign, experiments=tuple(experiments))), theta


def one_of_two_samples(seed: int) -> tuple[Problem, FloatArray]:
    """All but two samples of the second record are masked; the first is whole."""
    problem, theta = _drawn(seed)
    first, second = problem.campaign
    used = np.zeros(len(second.t), dtype=bool)
    used[[len(used) // 3, len(used) // 2]] = True
    return Problem(
        replace(problem.campaign, experiments=(first, replace(second, mask=used)))
    ), theta


def plateau_only(seed: int) -> tuple[Problem, FloatArray]:
    """All samples of the second record but those on its plateau are masked."""
    problem, theta = _drawn(seed)
    first, second = problem.campaign
    used = (second.t > 4.0) & (second.t < 6.5)
    return Problem(
        replace(problem.campaign, experiments=(first, replace(second, mask=used)))
    ), theta


def constant(seed: int) -> tuple[Problem, FloatArray]:
    """Every record is one and the same number."""
    problem, theta = _drawn(seed, beta=0.0)
    values = {e.name: np.full(len(e.t), 0.3) for e in problem.campaign}
    return Problem(problem.campaign.with_data(values)), theta


def only_the_fall(seed: int) -> tuple[Problem, FloatArray]:
    """Records that begin on the plateau and hold the fall alone, its command as commanded_on."""
    problem, theta = _drawn(seed)
    layout = problem.layout
    experiments, truth = [], list(theta[:3])
    for e in problem.campaign:
        y0, beta, _, tf = local_parameters(theta, layout, e.name)
        part = e.t >= 5.0
        experiments.append(
            replace(e, t=e.t[part], y=e.values[part], mask=e.used[part], drive=None,
                    commanded_on=e.commanded_off, commanded_off=None)
        )  # fmt: skip
        truth += [y0 + beta, -beta, tf]
    campaign = replace(problem.campaign, experiments=tuple(experiments))
    return Problem(campaign), np.array([*truth, *theta[-3:]])


CASES: Mapping[str, Extreme] = {
    "ordinary": Extreme("nothing unusual, for comparison", _drawn, "independence"),
    "one experiment": Extreme(
        "one experiment: valve and manifold cannot be told apart",
        lambda seed: _drawn(seed, small_design(1)),
    ),
    "two samples": Extreme("two samples left of every record", two_samples),
    "two samples in one": Extreme("two samples left of one of two records", one_of_two_samples),
    "one level in one": Extreme("only the plateau left of one of two records", plateau_only),
    "step not seen": Extreme("no step at all: beta is 0", lambda seed: _drawn(seed, beta=0.0)),
    "no noise": Extreme("no noise at all", lambda seed: _drawn(seed, sigma=0.0)),
    "noise above the step": Extreme(
        "noise of five times the step", lambda seed: _drawn(seed, sigma=7.5, growth=0.0)
    ),
    "phi near 1": Extreme("AR(1) noise, phi .999", lambda seed: _drawn(seed, phi=0.999)),
    "phi negative": Extreme(
        "AR(1) noise, phi -.8", lambda seed: _drawn(seed, phi=-0.8), "independence"
    ),
    "tau below the interval": Extreme(
        "tau a tenth of the sampling interval", lambda seed: _drawn(seed, tau_s=0.001)
    ),
    "equal time constants": Extreme(
        "tau, tau_v and V/Q of the first experiment all 200 ms",
        lambda seed: _drawn(seed, tau_s=0.2, tau_v_s=0.2),
    ),
    "tau above the record": Extreme(
        "a lag of 40 s in a record of 12 s", lambda seed: _drawn(seed, tau_v_s=40.0)
    ),
    "constant signal": Extreme("the same number throughout", constant),
    "only the fall": Extreme("only the fall recorded", only_the_fall),
}
"""by name"""


SHARED = ("tau_s", "tau_v_s", "V_mL")
METHODS = ("crlb_iid", "crlb_ar1", "sandwich", "sandwich_ar1", "block_bootstrap", "profile")
QUICK = Settings(
    n_chains=2, n_walkers=40, n_draws=800, target_ess=400, max_draws=6000, max_steps=1000
)


@dataclass(eq=False)
class Told:
    """What the program says of one drawn campaign: 95 % intervals of tau, tau_v and V."""

    fit: Fit
    posterior: Posterior | None = None
    refusals: list[str] = field(default_factory=list)
    """sentences of what was refused"""
    intervals: dict[str, FloatArray] = field(default_factory=dict)
    """by method: (3, 2), nan where no value is given"""
    warned: dict[str, bool] = field(default_factory=dict)
    """by method: whether a printed warning, a status or exit code 3 stands beside the intervals"""


VERDICTS = ("none", "unlisted", "family", "effect", "refused")


def diagnose(problem: Problem, seed: int = 1) -> tuple[str, tuple[str, ...], float]:
    """The gap's verdict, what it names and with which probability; ``refused``: one message.

    Nothing is wrong with any of these campaigns but their size, so that every name is a false one.
    """
    from bayes_sensor.diagnosis import diagnose_gap

    try:
        fit = fit_least_squares(problem, seed=seed, swarms=1, particles=6, euler=False)
        found = diagnose_gap(
            problem.campaign, fit, seed=seed, bootstrap=0, hidden=False, separate=False
        ).verdict
    except CampaignError:
        return "refused", (), 0.0
    return found.kind, found.effects, found.probability


ORDINARY = ("ok", "upper limit", "intervals taken in tau^2")
"""a status with one of these says how tau is stated, not that something is wrong"""


def ordinary(sentence: str) -> bool:
    """Whether a sentence of a status says how an interval is stated, not that it is doubtful."""
    return any(sentence == word or (len(word) > 2 and word in sentence) for word in ORDINARY)


def ask(
    problem: Problem,
    seed: int = 1,
    settings: Settings = QUICK,
    sampler: str = "emcee",
    n_resamples: int = 200,
) -> Told:
    """Fit, posterior and bounds as the command line would have them, with small settings."""
    fit = fit_least_squares(problem, seed=seed, swarms=1, particles=6, euler=False)
    told = Told(fit)
    # that tau is an upper limit is an answer, not a doubt
    doubts = [text for text in fit.warnings if "cannot tell tau from zero" not in text]
    said = bool(doubts) or not fit.converged
    try:
        told.posterior = posterior = sample_posterior(problem, fit, seed, sampler, settings)
        ends = np.array([posterior.quantiles(name, [0.025, 0.975]) for name in SHARED])
        middle, upper = posterior.quantiles("tau_s", [0.5, 0.95])
        if ends[0, 0] < 0.15 * middle:  # as the headline has it: an upper limit
            ends[0] = 0.0, upper
        told.intervals["posterior"] = ends
        told.warned["posterior"] = said or bool(posterior.warnings)
    except CampaignError as error:
        told.refusals.append(str(error))
    try:
        bounds = compare_bounds(problem, fit, None, METHODS, seed, n_resamples=n_resamples)
        for name, bound in bounds.methods.items():
            # a lag that is nobody's for sure has no name, and the names no value
            told.intervals[name] = np.array(
                [bound.interval(p) if p in bound.names else (np.nan, np.nan) for p in SHARED]
            )
            rest = [part for part in bound.status.split("; ") if not ordinary(part)]
            told.warned[name] = said or bool(rest)
    except CampaignError as error:
        told.refusals.append(str(error))
    return told
