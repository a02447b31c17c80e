"""Choose the next experiments: those of a grid that narrow tau's interval most."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray, counted
from bayes_sensor.design.planned_experiments import (
    PlannedSetting,
    Truth,
    planned,
    refuse_several_sensors,
    settings_of,
    truth_of,
)
from bayes_sensor.design.proposal import Design
from bayes_sensor.design.record_information import eliminate, information_of, sum_information
from bayes_sensor.design.tau_interval import Beforehand, known_beforehand, predict, predict_tau
from bayes_sensor.likelihood.held_values import refuse_held
from bayes_sensor.likelihood.noise import lag_coefficient
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.layout import Layout, Theta

if TYPE_CHECKING:
    import pandas as pd

AS_GOOD = 0.03
"""share of the gain that is sacrificed for a shorter experiment"""


def design_experiments(
    campaign: Campaign | Problem,
    theta: Theta,
    target_tau: float,
    flows: tuple[float, float],
    concentrations: tuple[float, float],
    durations: tuple[float, float],
    k: int | None = None,
    k_max: int = 40,
    trigger: float | None = None,
    prior: Prior | None = None,
    n_grid: tuple[int, int, int] = (5, 4, 3),
) -> Design:
    """The next experiments that bring tau's 95 % interval to +- ``target_tau`` (s, half length).

    Candidates: total flow (mL/s), concentration (fraction) and duration (s) on a grid within the
    given limits.  The best one is added until the target is met or ``k`` are chosen (``k`` None: as
    many as needed up to ``k_max``), then single ones are exchanged while the interval improves
    (Fedorov, Theory of Optimal Experiments, 1972).  ``trigger``: sd (s) with which the new
    experiments' switch times will be known.  The step's size is taken proportional to the
    concentration, by least squares over the campaign; noise as in ``theta``; the existing
    experiments count as done.

    tau is the sensor's lag, be it the shorter or the longer one (:meth:`Problem.by_name`).

    Raises CampaignError for limits that are not a range, a target that is not positive, or if
    neither the campaign nor ``theta`` says which lag is the sensor's.
    """
    problem = as_problem(campaign)
    refuse_held(problem, "design")
    vector = problem.by_name(theta)
    refuse_unplannable(problem.campaign)
    if not target_tau > 0:
        raise CampaignError(f"design: the target must be a positive time, but is {target_tau} s")
    for label, (low, high) in (
        ("flows", flows),
        ("concentrations", concentrations),
        ("durations", durations),
    ):
        if not 0 < low <= high or not np.isfinite(high):
            raise CampaignError(f"design: {label} must be a range with 0 < low <= high")
    if concentrations[1] >= 1.0:
        raise CampaignError("design: concentrations are fractions below 1")
    truth, present = truth_of(problem, vector), settings_of(problem, vector)
    prior = prior or problem.prior_of_tau(vector)
    candidates = candidate_settings(
        problem, vector, present, truth, flows, concentrations, durations, n_grid
    )
    if not candidates:
        raise CampaignError(
            "design: no duration within its limits lets the response settle: expected at least "
            f"{truth.shortest(flows[1]):.3g} s, but the longest is {durations[1]:.3g} s; allow "
            "longer ones (--duration)"
        )
    lengths = [len(c.experiment.t) * c.experiment.interval for c in candidates]
    beforehand = known_beforehand(problem)
    before = predict(present, truth, prior, beforehand=beforehand)
    fastest = truth.fastest(present)
    tau = min(max(truth.tau, before.high68, 2e-3 * fastest), max(truth.tau, 0.5 * fastest))
    chosen: list[int] = []
    for _ in range(2):  # once more with sensitivities where the better experiments put tau
        base = sum_information(present, truth, tau)
        parts = [information_of(c, truth, tau, trigger) for c in candidates]
        chosen = choose_greedily(
            base, parts, truth.tau, prior, beforehand, target_tau, k, k_max, lengths
        )
        total = base + np.sum([parts[i] for i in chosen], axis=0) if chosen else base
        after = predict_tau(total, truth.tau, prior, beforehand)
        better = max(truth.tau, min(after.high68, tau), 2e-3 * fastest)
        if better > 0.9 * tau:
            break
        tau = better
    picked = [candidates[i] for i in sorted(chosen)]
    reached = bool(after.half_width95 <= target_tau)
    words = (
        f"{counted(len(picked), 'more experiment')}: 95 % interval of tau "
        f"+-{1e3 * after.half_width95:.3g} ms"
    )
    words += "" if reached else f", not the +-{1e3 * target_tau:.3g} ms wanted"
    combined, new_theta, table = _proposal(problem, vector, truth, picked)
    return Design(
        table, combined, new_theta, before, after, target_tau, reached, words, prior, truth.noise
    )


def refuse_unplannable(campaign: Campaign) -> None:
    """Raise CampaignError for a campaign without flows or with several sensors."""
    where = campaign.source or campaign.title
    if not campaign.flows_known:
        raise CampaignError(
            f"{where}: proposals are chosen by their total flow and concentration, but the "
            "campaign gives none; give carrier_flow and test_gas_flow, or use what_if, which needs "
            "no flows"
        )
    refuse_several_sensors(campaign)


def candidate_settings(
    problem: Problem,
    vector: FloatArray,
    present: list[PlannedSetting],
    truth: Truth,
    flows: tuple[float, float],
    concentrations: tuple[float, float],
    durations: tuple[float, float],
    n_grid: tuple[int, int, int],
) -> list[PlannedSetting]:
    c = np.array([s.experiment.concentration for s in present])
    beta = np.array([s.beta for s in present])
    gain = float(c @ beta / (c @ c))
    y0 = float(np.median([s.y0 for s in present]))
    reference = problem.campaign.reference_concentration
    delays = [
        s.switches[0] - s.experiment.commanded_on
        for s in present
        if s.experiment.commands is None and s.experiment.commanded_on is not None
    ]
    delay = max(float(np.median(delays)), 0.0) if delays else 0.5 * truth.fastest(present)
    result = []
    for flow in np.unique(np.geomspace(*flows, n_grid[0])):
        for fraction in np.unique(np.linspace(*concentrations, n_grid[1])):
            for duration in np.unique(np.linspace(*durations, n_grid[2])):
                if duration < truth.shortest(flow):
                    continue
                weight = truth.noise.weight_of(float(fraction / reference))
                result.append(
                    planned(
                        "candidate", float(flow), float(fraction), float(duration),
                        truth.interval, y0, gain * float(fraction), weight, delay,
                    )
                )  # fmt: skip
    return result


def choose_greedily(
    base: FloatArray,
    parts: list[FloatArray],
    tau: float,
    prior: Prior,
    beforehand: Beforehand,
    target: float,
    k: int | None,
    k_max: int,
    durations: list[float],
) -> list[int]:
    """Greedy addition, then exchange; positions in ``parts``, with repetition."""

    def worth(total: FloatArray) -> float:
        # the bound on tau and on tau^2 together stand for the interval, and cost no quadrature
        M = eliminate(total, [0, 1])
        slope = np.array([2.0 * tau, 1.0])
        return float(slope @ M @ slope) + 1e-9 * float(M[0, 0])

    def pick(total: FloatArray) -> int:
        # the shortest of those that are as good as the best
        gains = np.array([worth(total + part) for part in parts]) - worth(total)
        good = np.flatnonzero(gains >= (1.0 - AS_GOOD) * gains.max())
        return int(min(good, key=lambda i: (durations[i], -gains[i])))

    def half_width(total: FloatArray) -> float:
        return predict_tau(total, tau, prior, beforehand).half_width95

    total, chosen = base.copy(), list[int]()
    most = k_max if k is None else k
    while len(chosen) < most:
        if k is None and half_width(total) <= target:
            break
        best = pick(total)
        chosen.append(best)
        total = total + parts[best]
    improved = True
    while improved and chosen:
        improved = False
        for position, old in enumerate(chosen):
            without = total - parts[old]
            best = pick(without)
            if best != old and worth(without + parts[best]) > worth(total) * (1 + 1e-9):
                chosen[position] = best
                total = without + parts[best]
                improved = True
    return chosen


def _proposal(
    problem: Problem, vector: FloatArray, truth: Truth, picked: list[PlannedSetting]
) -> tuple[Campaign, FloatArray, pd.DataFrame]:
    import pandas as pd

    taken = set(problem.campaign.names_of_experiments)
    experiments = [replace(e, y=None) for e in problem.campaign]
    local: list[float] = []
    rows = []
    number = 0
    for setting in picked:
        number += 1
        while f"new{number}" in taken:
            number += 1
        name = f"new{number}"
        e = replace(setting.experiment, name=name)
        experiments.append(e)
        local += [setting.y0, setting.beta, *setting.switches]
        rows.append(
            {
                "name": name,
                "total_flow_mL_s": e.total_flow,
                "concentration": e.concentration,
                "duration_s": len(e.t) * e.interval,
                "on_s": e.commanded_on,
                "off_s": e.commanded_off,
                "interval_s": e.interval,
                "beta_V": setting.beta,
            }
        )
    order = problem.campaign.sensor_is
    if order == "unknown":  # theta says it
        flat = [v for n, v in zip(truth.rig.names, truth.shared, strict=True) if n[:2] != "V_"]
        ends = {min(flat): "faster", max(flat): "slower"}
        order = "faster" if truth.tau == min(flat) else ends.get(truth.tau, order)
    combined = Campaign(
        f"{problem.campaign.title}, with proposals", tuple(experiments),
        problem.campaign.side_information, problem.campaign.signal_unit,
        sensor_is=order, stages=problem.campaign.stages,
    )  # fmt: skip
    n = problem.layout.n_mean
    noise = [truth.phi, truth.sigma0, truth.sigma1]
    if truth.noise.by_concentration:
        # sigma1 refers to the highest concentration, which a proposal may raise
        times = combined.reference_concentration / problem.campaign.reference_concentration
        noise[2] = truth.noise.referred(truth.sigma0, truth.sigma1, times)
    if combined.reference_interval != truth.interval:
        noise[0] = lag_coefficient(truth.phi, combined.reference_interval / truth.interval)
    theta = np.concatenate([vector[:n], local, noise])
    assert len(theta) == len(Layout.of(combined))
    return combined, theta, pd.DataFrame(rows)
