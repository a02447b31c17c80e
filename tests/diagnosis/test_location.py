"""Where the misfit lies: what explanations put into a cell against the noise-free truth."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import kstest
from scipy.stats import t as student

from bayes_sensor.diagnosis import Gap, diagnose_gap
from bayes_sensor.diagnosis.data.bins import PHASES
from bayes_sensor.diagnosis.data.noise_floor import DOF
from bayes_sensor.diagnosis.data.preparation import fit_base, prepare
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.effects.simulate_effects import simulate_with_effects
from bayes_sensor.diagnosis.evidence.discrepancy import make_discrepancies
from bayes_sensor.diagnosis.evidence.hypotheses import MOST_TERMS
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.diagnosis.evidence.refit import refit
from bayes_sensor.diagnosis.excess_shares import explained_excess, in_volts, shared_by_findings
from bayes_sensor.diagnosis.location import OF_FINDINGS, locate, parts_of_cells, predict_left_out
from bayes_sensor.diagnosis.signals.effect_signatures import signatures
from bayes_sensor.diagnosis.verdict import Judgement
from bayes_sensor.diagnosis.wording import Conclusion, sentence
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.rig.layout import Layout
from tests.support.planted_effects import design, diagnosed, measured, theta

WEAK = {
    "dead_volume": 0.03, "flow_switching": 0.15, "gain_drift": 0.00025, "baseline_step": 0.0025,
    "valve_asymmetry": 1.035, "axial_dispersion": 0.2,
}  # fmt: skip
"""strengths that are seen at a misfit of about eight standard deviations"""


@lru_cache(maxsize=16)
def weak(effect: str, seed: int = 5) -> Gap:
    return diagnose_gap(
        measured({effect: WEAK[effect]}, seed), bootstrap=0, separate=False, hidden=False
    )


def left_without_noise(gap: Gap, effect: str) -> np.ndarray:
    """(n_bins in all,) whitened: what the effect leaves of noise-free data after the refit."""
    plan = design()
    clean, *_ = simulate_with_effects(plan, theta(plan, 1e-9), {effect: WEAK[effect]}, seed=1)
    base = gap.comparison.base
    data = [
        np.array([e.values[a:z].mean() for a, z in zip(b.first, b.last, strict=True)])
        for b, e in zip(gap.comparison.binned.bins, clean, strict=True)
    ]
    return refit(base.coords, base.x, data=data, most_steps=60, tolerance=1e-8).residual


def true_shares(gap: Gap, effect: str) -> tuple[np.ndarray, float]:
    """(n_cells,) shares of what the effect adds without noise, and its detectability."""
    plan = design()
    clean, *_ = simulate_with_effects(plan, theta(plan, 1e-9), {effect: WEAK[effect]}, seed=1)
    without, *_ = simulate_with_effects(plan, theta(plan, 1e-9), {}, seed=1)
    binned = gap.comparison.binned
    added = {e.name: (e.values - w.values) ** 2 for e, w in zip(clean, without, strict=True)}
    power = []
    for part in parts_of_cells(binned)[: len(gap.map.cells)]:
        b = binned.bins[part.experiment]
        local = part.rows - binned.rows[part.experiment].start
        of_bins = [added[b.experiment.name][b.first[i] : b.last[i]].sum() for i in local]
        power.append(float(np.sum(of_bins)))
    left = left_without_noise(gap, effect)
    return np.array(power) / np.sum(power), float(np.sqrt(left @ left))


def misplaced(shares: np.ndarray, truth: np.ndarray) -> float:
    """Share of the misfit that is put into a wrong cell."""
    return 0.5 * float(np.sum(np.abs(shares - truth)))


# of the other two a weak one is taken for a rival, which adds elsewhere
@pytest.mark.slow
@pytest.mark.parametrize(
    "effect", [name for name in WEAK if name not in ("flow_switching", "baseline_step")]
)
def test_the_misfit_is_found_beneath_the_noise(effect: str) -> None:
    gap = weak(effect)
    truth, d = true_shares(gap, effect)
    assert 8.0 < d < 11.0 and gap.map.shared_by == "explanations"
    cells = gap.map.cells
    shares = np.array([cell.share for cell in cells])
    above = np.array([cell.d**2 for cell in cells])  # as measured, and only where it is above
    assert shares.sum() == pytest.approx(1.0) and np.all(shares >= 0.0)
    assert misplaced(shares, truth) < 0.5
    assert misplaced(shares, truth) < misplaced(above / above.sum(), truth)
    by_phase = [
        {phase: sum(s for c, s in zip(cells, some) if c.phase == phase) for phase in PHASES}
        for some in (shares, truth)
    ]
    said, true = (max(some, key=lambda phase: some[phase]) for some in by_phase)
    # of a drift of the gain, rise and plateau hold as much
    assert said == true or effect == "gain_drift"


def test_volts_are_what_explanations_take_where_they_add_it() -> None:
    gap = weak("axial_dispersion")
    left = left_without_noise(gap, "axial_dispersion")
    binned = gap.comparison.binned
    true = sum(
        np.sum(b.count * (binned.floor.cholesky[k] @ left[rows]) ** 2)
        for k, (b, rows) in enumerate(zip(binned.bins, binned.rows, strict=True))
    )
    said = 0.0
    for part, cell in zip(parts_of_cells(binned), gap.map.cells, strict=False):
        local = part.rows - binned.rows[part.experiment].start
        n = np.sum(binned.bins[part.experiment].count[local])
        assert cell.measured_excess_rms_V != cell.excess_rms_V
        said += n * cell.excess_rms_V**2
    assert np.sqrt(said) == pytest.approx(np.sqrt(true), rel=0.25)


@pytest.mark.slow
def test_a_jump_on_the_plateau_lies_on_the_plateau_and_says_when() -> None:
    campaign = measured({}, seed=5)
    values = {e.name: e.values + 0.04 * (e.t > 25.0) * (e.t < 30.0) for e in campaign}
    moved = diagnose_gap(campaign.with_data(values), bootstrap=0, separate=False, hidden=False)
    phases = moved.where.groupby("phase")["share"].sum()
    assert phases["plateau"] > 0.6
    # a step after the pulse lies after it
    step = diagnosed("baseline_step", 0.03)
    phases = step.where.groupby("phase")["share"].sum()
    assert phases["tail"] + phases["fall"] > 0.9
    sets_in = step.to_json()["verdict"]["sets_in"]
    assert len(sets_in) == len(campaign)
    for place, e in zip(sets_in, campaign, strict=True):
        assert place["experiment"] == e.name and place["phase"] in ("plateau", "fall")
        assert place["time_s"] == pytest.approx(e.commanded_off + 0.5, abs=0.3)
    assert diagnosed("flow_error").to_json()["verdict"]["sets_in"] == []


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 40, -1])
def test_the_noise_that_a_process_leaves_is_that_of_dense_matrices(which: int) -> None:
    gap = weak("dead_volume")
    fitted = gap.comparison.find("axial_dispersion").refit
    beside = make_discrepancies(gap.comparison.binned, gap.comparison.base)[which]
    whole = np.eye(len(fitted.residual)) + (beside.basis * beside.variance) @ beside.basis.T
    compare_hypotheses = np.linalg.inv(whole)
    jacobian, prior = fitted.jacobian, fitted.coords.own_prior_matrix
    slope = jacobian.T @ compare_hypotheses @ fitted.residual - prior @ (
        fitted.x - fitted.coords.prior_centre
    )
    step = np.linalg.solve(jacobian.T @ compare_hypotheses @ jacobian + prior, slope)
    assert Linearised(fitted).promised is None
    left = Linearised(fitted).left(beside)
    assert left == pytest.approx(compare_hypotheses @ (fitted.residual - jacobian @ step), abs=1e-9)
    # nothing that the refit could still take up: J'e is what the prior pulls with
    pulled = prior @ (fitted.x + step - fitted.coords.prior_centre)
    assert jacobian.T @ left == pytest.approx(pulled, abs=1e-6 * np.abs(pulled).max() + 1e-6)


@pytest.mark.slow
def test_explanations_take_what_they_leave_out_of_the_residual() -> None:
    comparison = weak("valve_asymmetry").comparison
    best = max(comparison.hypotheses, key=lambda h: h.log_weight)
    sure = replace(comparison, hypotheses=(replace(best, terms=best.terms[:1]),))
    share = best.terms[0].share
    taken, added = explained_excess(sure)
    assert taken.shape == added.shape == (len(comparison.base.residual), 2)
    assert not np.any(taken[:, 0]) and not np.any(added[:, 0])
    whole = comparison.base.residual - Linearised(best.terms[0].refit).left(best.terms[0].beside)
    binned = comparison.binned
    assert taken[:, 1] == pytest.approx(np.sqrt(share) * in_volts(binned, whole))
    assert binned.whitened(in_volts(binned, whole)) == pytest.approx(whole)
    count = np.concatenate([b.count for b in binned.bins])
    assert count @ added**2 == pytest.approx(count @ taken**2)
    nothing = next(h for h in comparison.hypotheses if h.key == "none")
    for some in explained_excess(replace(comparison, hypotheses=(nothing,))):
        assert not np.any(some)


def test_terms_of_a_hypothesis_are_its_likeliest_and_sum_to_one() -> None:
    for h in weak("gain_drift").comparison.hypotheses:
        shares = [term.share for term in h.terms]
        assert sum(shares) == pytest.approx(1.0) and shares == sorted(shares, reverse=True)
        assert len(shares) <= MOST_TERMS
        assert all((term.beside is not None) == (h.incomplete and not h.within) for term in h.terms)


def test_what_happens_once_is_where_it_happens() -> None:
    located = diagnosed("none", seed=1).map
    assert located.shared_by == "nothing"
    cells = {(c.experiment, c.phase): c for c in located.cells}
    late = cells["3", "plateau"]
    found = shared_by_findings(
        located, [("3", late.t_start_s + 0.1, 27.0), ("1", cells["1", "tail"].t_end_s - 0.1, 9.0)]
    )
    shares = {(c.experiment, c.phase): c.share for c in found.cells if c.share}
    assert shares == {("3", "plateau"): 0.75, ("1", "tail"): 0.25}
    assert found.shared_by == "findings" and found.scales == located.scales
    assert shared_by_findings(located, []).cells == located.cells
    assert shared_by_findings(located, []).shared_by == "nothing"


def test_a_single_event_is_shared_out_and_no_misfit_of_the_model_is_claimed() -> None:
    campaign = measured({}, seed=3)
    values = {e.name: e.values.copy() for e in campaign}
    e = campaign.experiments[1]
    values[e.name] += 0.12 * ((e.t > 24.0) & (e.t < 24.6))
    gap = diagnose_gap(campaign.with_data(values), bootstrap=0, separate=False, hidden=False)
    assert gap.verdict.kind == "unlisted"
    assert gap.map.shared_by == "findings"
    assert "The model" not in gap.verdict.sentence
    top = max(gap.map.cells, key=lambda c: c.share)
    assert (top.experiment, top.phase) == ("2", "plateau")
    assert gap.to_json()["where_shared_by"] == "findings"


def test_a_record_without_a_fall_has_no_part_in_predicting_falls() -> None:
    campaign = measured({}, seed=4)
    first = campaign.experiments[0]
    before = first.t < first.commanded_off - 1.0
    short = replace(
        first, t=first.t[before], y=first.values[before],
        mask=None if first.mask is None else first.mask[before], commanded_off=None,
    )  # fmt: skip
    some = replace(campaign, experiments=(short, *campaign.experiments[1:]))
    binned = prepare(some, Layout.of(some).flat(fit_least_squares(some, euler=False).theta_hat))
    base = fit_base(binned.binned)
    left = predict_left_out(binned.binned, base)  # warnings are errors here
    assert "fall" in left and all(np.isfinite(d) for d in left.values())


# --------------------------------------------------------------------------- courses


@pytest.mark.slow
@pytest.mark.parametrize("effect", WEAK)
def test_a_weak_misfit_is_seen_along_courses_and_not_by_its_size(effect: str) -> None:
    budget = weak(effect).budget
    assert budget["p_value_of_form"] < 1e-3
    assert budget["p_value_of_size"] > 3.0 * budget["p_value_of_form"]
    smallest = min(1.5 * budget["p_value_of_size"], 3.0 * budget["p_value_of_form"])
    # a tenth of the level is for findings in single samples, of which there are none
    assert budget["p_value"] == pytest.approx(min(1.0, smallest / (1.0 - OF_FINDINGS)))


def test_courses_are_what_the_refit_leaves() -> None:
    comparison = weak("dead_volume").comparison
    base = comparison.base
    found = signatures(base, CATALOGUE)
    assert np.sum(found**2, axis=1) == pytest.approx(1.0)
    # as orthogonal to what the refit can do as its priors let it
    inside = found @ (base.jacobian / np.linalg.norm(base.jacobian, axis=0))
    assert np.abs(inside).max() < 0.05
    alone = signatures(base, {"mains_pickup": CATALOGUE["mains_pickup"]})
    assert alone.shape == (0, len(base.residual))
    located = locate(comparison.binned, base, signatures=alone)
    assert located.p_value_of_form is None and located.p_value == located.p_value_of_size


def test_p_values_of_courses_are_uniform_under_noise() -> None:
    comparison = weak("dead_volume").comparison
    base, binned = comparison.base, comparison.binned
    along, leverage = signatures(base, CATALOGUE), base.leverage
    rng = np.random.default_rng(8)
    found = []
    for _ in range(60):
        noise = rng.standard_normal(binned.n_bins) * np.sqrt(DOF / rng.chisquare(DOF))
        here = replace(base, residual=leverage.leave(noise[:, None])[:, 0])
        found.append(locate(binned, here, signatures=along).p_value_of_form)
    assert kstest(found, "uniform").pvalue > 0.01


def test_beyond_the_simulations_the_sum_over_courses_bounds_the_p_value() -> None:
    comparison = weak("dead_volume").comparison
    base, binned = comparison.base, comparison.binned
    along = signatures(base, CATALOGUE)[:3]
    here = replace(base, residual=base.residual * 0.0 + 12.0 * along[0])
    located = locate(binned, here, signatures=along)
    tail = 2.0 * student.sf(12.0, DOF)
    assert located.p_value_of_form == pytest.approx(3.0 * tail, rel=1e-6)


def test_refitted_simulations_make_no_p_value_smaller() -> None:
    comparison = weak("dead_volume").comparison
    base, binned = comparison.base, comparison.binned
    along = signatures(base, CATALOGUE)
    linear = locate(binned, base, signatures=along)
    refitted = locate(binned, base, bootstrap=20, signatures=along)
    assert refitted.p_value_of_size >= linear.p_value_of_size
    assert refitted.p_value_of_form >= linear.p_value_of_form


def test_what_differs_from_experiment_to_experiment_has_a_course_for_each() -> None:
    comparison = weak("dead_volume").comparison
    found = signatures(comparison.base, {"flow_error": CATALOGUE["flow_error"]})
    assert len(found) == len(comparison.binned.campaign)
    # a flow that is not what its controller said, in one of the experiments
    campaign = measured({}, seed=6)
    second = campaign.experiments[1]
    said = replace(second, carrier_flow=1.07 * second.carrier_flow)
    experiments = (campaign.experiments[0], said, *campaign.experiments[2:])
    gap = diagnose_gap(
        replace(campaign, experiments=experiments), bootstrap=0, separate=False, hidden=False
    )
    assert gap.budget["p_value_of_form"] < 1e-4 < 0.05 < gap.budget["p_value_of_size"]
    assert gap.map.shared_by == "explanations"


def test_gas_that_is_not_steady_is_shared_out_over_the_plateaus() -> None:
    campaign = measured({}, seed=3)
    rng = np.random.default_rng(2)
    values = {}
    for e in campaign:  # streaks of gas that was not mixed, half a second long
        slow = lfilter([1.0], [1.0, -0.98], rng.standard_normal(len(e.t)))
        on = (e.t > e.commanded_on + 5.0) & (e.t < e.commanded_off)
        values[e.name] = e.values + 0.03 * on * slow / np.std(slow)
    gap = diagnose_gap(campaign.with_data(values), bootstrap=0, separate=False, hidden=False)
    found = {f.name: f.probability for f in gap.findings}
    assert gap.verdict.kind == "unlisted" and found["unsteady"] > 0.5
    assert gap.map.shared_by == "findings"
    shares = gap.where.groupby("phase")["share"].sum()
    assert shares["plateau"] == pytest.approx(1.0, abs=1e-4)
    assert (gap.where.share > 1e-4).sum() == len(campaign)


def test_what_noise_would_seldom_leave_is_told_where_nothing_is_stated() -> None:
    gap = diagnosed("none", seed=1)

    def said(p: float) -> str:
        located = replace(gap.map, p_value=p)
        return sentence(Conclusion(
            Judgement("none", (), None, 0.594), gap.comparison, gap.probabilities,
            gap.comparison.hypotheses[0], located, gap.shrink.closure, gap.findings, (),
            (0.0123, 0.2), "V",
        ))  # fmt: skip

    assert said(0.4).startswith("Nothing is missing that this campaign could show (59 %). Effects")
    assert said(0.4).endswith("be anywhere from 12 to 200 ms.")
    assert "Noise alone would seldom leave as much (p = 0.021)" in said(0.021)
