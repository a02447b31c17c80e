"""How far an explanation closes the gap: against dense algebra, and against planted leftovers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t

from bayes_sensor.diagnosis import CATALOGUE
from bayes_sensor.diagnosis.closed_fraction import VISIBLE
from bayes_sensor.diagnosis.closure import (
    DRAWS,
    INEXACT,
    INEXACT_DOF,
    closure,
    draw_remaining_misfit,
    held_out,
    misfit_removed,
)
from bayes_sensor.diagnosis.data.preparation import fit_base, prepare
from bayes_sensor.diagnosis.evidence.coordinate_priors import Part
from bayes_sensor.diagnosis.evidence.discrepancy import Discrepancy, make_discrepancies
from bayes_sensor.diagnosis.evidence.hypotheses import normalise_weights, to_convergence
from bayes_sensor.diagnosis.evidence.refit import Refit, refit
from bayes_sensor.diagnosis.evidence.refit_coordinates import Coordinates
from bayes_sensor.rig.layout import Layout
from tests.support.planted_effects import measured, theta

STEP = 0.05
"""V, a baseline step beside the valve's asymmetry"""


def explained_excess(base: Refit, *names: str, form: int = 0) -> Refit:
    """The refit with effects, each in one of its forms."""
    parts = tuple(Part(CATALOGUE[n], CATALOGUE[n].forms[form]) for n in names)
    coords = Coordinates(base.coords.binned, parts)
    starts: dict[str, float] = {}
    for part in parts:
        starts |= part.form.starts[0]
    return to_convergence(refit(coords, coords.start(base.x, starts), most_steps=60))


def normalised(base: Refit) -> list[Discrepancy]:
    """Discrepancies with weights that sum to one, as they are weighed."""
    made = make_discrepancies(base.coords.binned, base)
    return normalise_weights(made, [d.weight for d in made])


@pytest.fixture(scope="module")
def alone() -> Refit:
    """The fit without effects, of a campaign with a slow closing valve."""
    campaign = measured({"valve_asymmetry": 1.15}, seed=3)
    return fit_base(prepare(campaign, Layout.of(campaign).flat(theta(campaign))).binned)


@pytest.fixture(scope="module")
def both() -> Refit:
    """The same, of one whose baseline steps after the pulse besides."""
    campaign = measured({"valve_asymmetry": 1.3, "baseline_step": STEP}, seed=5)
    return fit_base(prepare(campaign, Layout.of(campaign).flat(theta(campaign))).binned)


def test_what_is_left_is_the_dense_posterior(alone):
    fitted = explained_excess(alone, "dead_volume")
    coords, j, r = fitted.coords, fitted.jacobian, fitted.residual
    one = next(d for d in normalised(alone) if d.name == "response 1 0.01")
    k = (one.basis * one.variance) @ one.basis.T
    spread = np.linalg.solve(coords.own_prior_matrix, j.T)
    data = np.eye(len(j)) + k + j @ spread
    away = r - j @ (coords.prior_centre - fitted.x)
    mean = k @ np.linalg.solve(data, away)
    covariance = k - k @ np.linalg.solve(data, k)
    left = np.eye(len(j)) - j @ np.linalg.solve(j.T @ j + coords.own_prior_matrix, j.T)
    form = left.T @ left
    expected = float(np.trace(form @ covariance) + mean @ form @ mean)
    middle = form @ covariance
    spread_of = np.sqrt(
        2.0 * np.trace(middle @ middle) + 4.0 * mean @ form @ covariance @ form @ mean
    )
    _, drawn = draw_remaining_misfit(fitted, [one], seed=2)
    assert len(drawn) == DRAWS
    assert drawn.mean() == pytest.approx(expected, abs=4.0 * spread_of / np.sqrt(DRAWS))
    assert drawn.std() == pytest.approx(spread_of, rel=0.1)


def test_what_an_effect_takes_away_is_the_noise_free_misfit(alone):
    binned = alone.coords.binned
    truth = explained_excess(alone, "valve_asymmetry")
    noise_free = [truth.coords.bin_means(truth.x, k) for k in range(len(binned.bins))]
    size = refit(alone.coords, alone.x, data=noise_free, most_steps=60).misfit
    assert size > 50.0
    assert misfit_removed(alone, truth) == pytest.approx(size, abs=4.0 * np.sqrt(size))
    assert misfit_removed(alone, alone) == 0.0


def test_a_right_effect_may_close_everything(alone):
    found = closure(alone, explained_excess(alone, "valve_asymmetry"), normalised(alone))
    assert found.fraction > 0.97
    assert found.high == 1.0
    assert 0.8 < found.low < found.fraction
    assert found.d_after < 3.0
    assert found.d_before**2 * found.fraction == pytest.approx(found.d_before**2 - found.d_after**2)


@pytest.mark.parametrize("closing", [1.06, 1.15])
def test_a_right_effect_is_allowed_what_its_form_lacks(closing):
    campaign = measured({"valve_asymmetry": closing}, seed=3)
    base = fit_base(prepare(campaign, Layout.of(campaign).flat(theta(campaign))).binned)
    fitted, others = explained_excess(base, "valve_asymmetry"), normalised(base)
    taken = misfit_removed(base, fitted)
    chance, _sizes = draw_remaining_misfit(fitted, others)
    assert chance < 0.04
    # one-sided: among 95 of 100, the chance of something else counted among the other five
    lacking = INEXACT * t.isf(0.5 * (0.05 - chance) / (1.0 - chance), INEXACT_DOF)
    seen = VISIBLE**2 / taken
    low = closure(base, fitted, others).low
    assert 1.0 - low <= 1.1 * min(lacking**2, seen)
    assert 1.0 - low >= 0.9 * min((INEXACT * t.isf(0.025, INEXACT_DOF)) ** 2, seen)


def test_what_may_be_right_in_its_place_counts_with_its_odds(alone):
    fitted, rival = (
        explained_excess(alone, "valve_asymmetry"),
        explained_excess(alone, "dead_volume"),
    )
    others, taken = normalised(alone), misfit_removed(alone, fitted)
    between = float(np.sum((fitted.residual - rival.residual) ** 2))
    assert between > 20.0
    certain = closure(alone, fitted, others)
    for odds in (1e-6, 1.0):
        found = closure(alone, fitted, others, others=[(rival, odds)])
        assert found.fraction == certain.fraction
        if odds < 1e-3:
            assert found.low == pytest.approx(certain.low, abs=1e-3)
        else:
            assert found.low == pytest.approx(taken / (taken + between), rel=0.1)
            assert found.low < certain.low - 0.01


@pytest.mark.parametrize("named", ["valve_asymmetry", "baseline_step"])
def test_the_interval_holds_what_a_second_cause_leaves(both, named):
    binned = both.coords.binned
    truth = explained_excess(both, "valve_asymmetry", "baseline_step")
    noise_free = [truth.coords.bin_means(truth.x, k) for k in range(len(binned.bins))]
    fitted = explained_excess(both, named)
    before = refit(both.coords, both.x, data=noise_free, most_steps=60).misfit
    after = refit(fitted.coords, fitted.x, data=noise_free, most_steps=60).misfit
    found = closure(both, fitted, normalised(both))
    assert 0.1 < after / before < 0.9
    assert found.low < 1.0 - after / before < found.high < 1.0
    assert found.high - found.low < 0.25
    assert found.d_before == pytest.approx(np.sqrt(before), rel=0.2)


def test_what_no_discrepancy_follows_is_left_all_the_same(alone):
    fitted = explained_excess(alone, "valve_asymmetry")
    n = len(fitted.residual)
    for size, seen in ((0.2, False), (1.5, True)):  # from bin to bin up and down
        rough = replace(fitted, residual=fitted.residual + size * (-1.0) ** np.arange(n))
        found = closure(alone, rough, normalised(alone))
        assert (found.high < 1.0) == seen
        assert (found.d_after**2 > 0.5 * size**2 * n) == seen


def test_no_effect_closes_nothing_and_no_gap_gives_no_fraction(alone):
    found = closure(alone, alone, normalised(alone))
    assert (found.low, found.fraction, found.high) == (0.0, 0.0, 0.0)
    campaign = measured({}, seed=5)
    quiet = fit_base(prepare(campaign, Layout.of(campaign).flat(theta(campaign))).binned)
    assert closure(quiet, explained_excess(quiet, "valve_asymmetry"), normalised(quiet)).withheld


def test_what_one_experiment_is_not_used_for_is_predicted(alone):
    right = held_out(alone, explained_excess(alone, "valve_asymmetry"))
    assert right.fraction == pytest.approx(1.0, abs=0.2)
    assert 0.5 < right.low < right.fraction <= right.high == max(1.0, right.fraction)
    wrong = held_out(alone, explained_excess(alone, "baseline_step"))
    assert wrong.high < right.low


def test_a_held_out_interval_holds_the_fraction_that_closes_without_noise(alone):
    # half the asymmetry taken for all of it: held, so that noise decides nothing about it
    coords = explained_excess(alone, "valve_asymmetry").coords
    held = Coordinates(coords.binned, coords.parts, {"closing_ratio": 1.07})
    half = refit(held, held.start(alone.x, {}), most_steps=60)
    truth = Coordinates(coords.binned, coords.parts, {"closing_ratio": 1.15})
    exact = refit(truth, truth.start(alone.x, {}), most_steps=60)
    mean = [exact.coords.bin_means(exact.x, k) for k in range(len(coords.binned.bins))]
    rng = np.random.default_rng(7)
    factors = coords.binned.floor.cholesky

    def seen(noise):
        data = tuple(m + noise * c @ rng.standard_normal(len(m)) for m, c in zip(mean, factors))
        binned = replace(coords.binned, data=data)
        pair = [
            refit(Coordinates(binned, r.coords.parts, r.coords.held), r.x, most_steps=30)
            for r in (alone, half)
        ]
        return held_out(*pair), pair

    _, (before, after) = seen(0.0)
    n = len(before.residual)
    true = 1.0 - after.misfit / before.misfit
    assert n > 50 and 0.3 < true < 0.95
    found = [seen(1.0)[0] for _ in range(12)]
    inside = [f.low <= true <= f.high for f in found if f is not None]
    assert len(inside) > 8 and sum(inside) >= len(inside) - 1
