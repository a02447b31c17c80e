"""Explanations whose mean jumps with a switch: their optima, and tau from the profile."""

import emcee
import numpy as np
import pytest

from bayes_sensor.diagnosis import CATALOGUE
from bayes_sensor.diagnosis.data.preparation import fit_base, prepare
from bayes_sensor.diagnosis.evidence.coordinate_priors import FASTER, Part
from bayes_sensor.diagnosis.evidence.hypotheses import compare_hypotheses, fit_effect
from bayes_sensor.diagnosis.evidence.refit import refit
from bayes_sensor.diagnosis.evidence.refit_coordinates import Coordinates
from bayes_sensor.diagnosis.evidence.tau_profile import has_jump, profile_tau
from bayes_sensor.rig.layout import Layout
from tests.support.planted_effects import measured, theta

EFFECT = CATALOGUE["baseline_step"]
STEPS = 1500
TAUS = np.log((0.02, 0.04, 0.06, 0.09, 0.14))
"""ln s, where refits begin"""


@pytest.fixture(scope="module")
def binned():
    campaign = measured({"baseline_step": 0.06}, seed=5, sigma=0.02)
    return prepare(campaign, Layout.of(campaign).flat(theta(campaign))).binned


@pytest.fixture(scope="module")
def optima(binned):
    coords = Coordinates(binned, (Part(EFFECT, EFFECT.forms[0]),))
    x = coords.start(binned.base, {})
    return [refit(coords, coords.with_tau(x, t)) for t in TAUS]


def test_it_takes_the_best_of_several_optima(optima):
    objectives = [r.objective for r in optima]
    assert max(objectives) > min(objectives) + 1.0  # a refit alone may stay at a worse one
    found = [profile_tau(r) for r in optima]
    assert max(s.best.objective for s in found) < min(objectives) + 0.1
    means = [s.log_tau for s in found]
    assert np.ptp(means) < 0.2 * found[0].sd_log_tau


@pytest.mark.slow
def test_tau_has_the_mean_and_spread_of_a_posterior_sampled(optima):
    best = min(optima, key=lambda r: r.objective)
    coords, profile = best.coords, profile_tau(best)

    def log_posterior(x: np.ndarray) -> float:
        if np.any(x < coords.lowest):
            return -np.inf
        differences = np.concatenate(coords.binned.data) - coords.all_means(x)
        left, away = coords.binned.whitened(differences), x - coords.prior_centre
        return -0.5 * float(left @ left + away @ coords.own_prior_matrix @ away)

    walkers = 4 * coords.size
    rng = np.random.RandomState(1)
    begin = rng.multivariate_normal(best.x, np.linalg.inv(best.normal), walkers)
    begin = np.maximum(begin, coords.lowest + 1e-6)
    sampler = emcee.EnsembleSampler(
        walkers, coords.size, log_posterior,
        moves=[(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)],
    )  # fmt: skip
    sampler.random_state = rng.get_state()
    sampler.run_mcmc(begin, STEPS)
    draws = sampler.get_chain(discard=STEPS // 3, flat=True)
    log_tau = draws[:, 1] - FASTER - draws[:, 0]
    assert profile.log_tau == pytest.approx(log_tau.mean(), abs=0.3 * log_tau.std())
    assert profile.sd_log_tau == pytest.approx(log_tau.std(), rel=0.35)


def test_the_forms_that_jump_are_those_whose_step_comes_with_the_fall_and_at_once(binned):
    for effect in CATALOGUE.values():
        for form in effect.forms:
            setting = binned.settings[0]
            strengths = {s.name: s.centre or 1.0 for s in form.strengths(setting)}
            made = form.settings(strengths, setting) if form.mean is None else {}
            at_once = not made.get("step_time") and not made.get("step_width")
            assert form.jumps == bool(made.get("step_with_fall") and at_once)


def test_a_jump_that_is_well_seen_has_tau_from_its_profile(binned):
    base = fit_base(binned)
    form = EFFECT.forms[0]
    fitted = fit_effect(binned, base, [Part(EFFECT, form)], form.starts)
    assert has_jump(fitted) and not has_jump(base)
    weighed = compare_hypotheses(binned, base, {EFFECT.name: EFFECT}).find(EFFECT.name)
    profile = profile_tau(weighed.refit)
    assert weighed.log_tau == pytest.approx(profile.log_tau, abs=0.2 * profile.sd_log_tau)
    assert weighed.sd_log_tau == pytest.approx(profile.sd_log_tau, rel=0.15)
    assert weighed.refit.objective < fitted.objective + 0.1
