"""Every signal by the same tests: quiet in noise, found where planted, in any unit, on any clock.

A new signal is entered in ``PLANTED`` with what it looks for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from bayes_sensor.campaign import Campaign, Experiment
from bayes_sensor.diagnosis.data.preparation import PreparedCampaign, fit_base, prepare
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.signals import SIGNALS, look_for_signals
from bayes_sensor.diagnosis.signals.signal import Finding, Signal
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.rig.layout import Layout
from tests.support.planted_effects import measured

Adds = Callable[[Experiment, np.random.Generator], np.ndarray]
"""an experiment -> (n_t,) V that the signal puts beside its mean and noise"""
NULLS = 6
"""faultless campaigns; with a prior of .04 a signal is found in two of them in 2 % of all runs"""


def _sine(hertz: float, volts: float) -> Adds:
    return lambda e, rng: volts * np.sin(2.0 * np.pi * hertz * e.t + rng.uniform(0.0, 6.0))


def _tails(e: Experiment, rng: np.random.Generator) -> np.ndarray:
    return 0.015 * rng.standard_t(2.2, len(e.t)) * (rng.random(len(e.t)) < 0.2)


def _bursts(e: Experiment, rng: np.random.Generator) -> np.ndarray:
    on = np.mod(e.t + rng.uniform(), 1.25) < 0.6
    return 0.02 * on * np.sin(2.0 * np.pi * 40.0 * e.t)  # 60 Hz at a hundred samples a second


def _passing(e: Experiment, rng: np.random.Generator) -> np.ndarray:
    return 0.02 * np.sin(2.0 * np.pi * 7.3 * e.t) * (e.name == "2") * (e.t > 45.0) * (e.t < 53.0)


def _event(e: Experiment, rng: np.random.Generator) -> np.ndarray:
    return 0.06 * np.exp(-0.5 * ((e.t - 27.0) / 0.4) ** 2) * (e.name == "3")


def _at_a_switch(e: Experiment, rng: np.random.Generator) -> np.ndarray:
    since = e.t - e.commanded_on - 1.6
    return 0.15 * np.exp(-0.5 * (since / 0.06) ** 2) * (e.name in "24")


def _level(e: Experiment, rng: np.random.Generator) -> np.ndarray:
    return 0.04 * (e.t > 26.0) * (e.name == "1")


def _ringing(e: Experiment, rng: np.random.Generator) -> np.ndarray:
    made = np.zeros(len(e.t))
    for at in (e.commanded_on + 0.8, e.commanded_off + 0.5):
        since = np.maximum(e.t - at, 0.0)
        made += 0.06 * np.exp(-since / 0.8) * np.sin(2.0 * np.pi * 6.0 * since)
    return made


def _unsteady(e: Experiment, rng: np.random.Generator) -> np.ndarray:
    from scipy.signal import lfilter

    slow = lfilter([1.0], [1.0, -0.97], rng.standard_normal(len(e.t)))
    on = (e.t > e.commanded_on + 5.0) & (e.t < e.commanded_off)
    return 0.015 * on * slow / np.std(slow)


PLANTED: dict[str, Adds] = {
    "quantisation": lambda e, rng: np.round(e.values / 0.02) * 0.02 - e.values,
    "heavy_tails": _tails,
    "mains_pickup": _sine(50.0, 0.01),
    "bursts": _bursts,
    "line": _sine(17.3, 0.008),
    "swing": _sine(1.0 / 6.0, 0.004),
    "passing": _passing,
    "event": _event,
    "patch": _at_a_switch,
    "break": _level,
    "ringing": _ringing,
    "unsteady": _unsteady,
}


def prepared(campaign: Campaign) -> PreparedCampaign:
    fit = fit_least_squares(campaign, seed=1, euler=False, swarms=1)
    return prepare(campaign, Layout.of(campaign).flat(fit.theta_hat))


def findings(campaign: Campaign) -> dict[str, Finding]:
    """Every finding by name, in the residual of the model without effects."""
    made = prepared(campaign)
    return {f.name: f for f in look_for_signals(made.samples(fit_base(made.binned)), CATALOGUE)}


@lru_cache(maxsize=NULLS)
def quiet(seed: int) -> Campaign:
    return measured({}, seed=seed, interval=0.01)


@lru_cache(maxsize=NULLS)
def in_noise(seed: int) -> dict[str, Finding]:
    return findings(quiet(seed))


def planted(name: str) -> Campaign:
    campaign, rng = quiet(1), np.random.default_rng(4)
    return campaign.with_data({e.name: e.values + PLANTED[name](e, rng) for e in campaign})


@lru_cache(maxsize=len(SIGNALS))
def with_it(name: str) -> dict[str, Finding]:
    return findings(planted(name))


def test_every_signal_has_a_planted_one() -> None:
    assert {s.name for s in SIGNALS} == set(PLANTED)


@pytest.mark.slow
@pytest.mark.parametrize("signal", SIGNALS, ids=lambda s: s.name)
def test_in_noise_it_is_found_no_more_often_than_its_prior_says(signal: Signal) -> None:
    found = [in_noise(seed).get(signal.name) for seed in range(1, NULLS + 1)]
    likely = [f for f in found if f is not None and f.log_odds > 0.0]
    # Binomial: two of six with a chance of .04 each happen in 2 %
    assert len(likely) <= 1
    # evidence averages to one under noise: its mean is not above by more than one large value
    ratios = [np.exp(min(f.log_bayes_factor, 50.0)) for f in found if f is not None]
    assert np.median(ratios or [0.0]) < 1.5


@pytest.mark.parametrize("signal", SIGNALS, ids=lambda s: s.name)
def test_a_planted_one_is_found_and_described(signal: Signal) -> None:
    campaign, found = planted(signal.name), with_it(signal.name)[signal.name]
    assert found.log_odds > 3.0
    names = [e.name for e in campaign]
    assert found.sentence(names, "V").endswith(".") and found.place(names)
    assert set(signal.units) <= set(found.strength)


@pytest.mark.parametrize("signal", SIGNALS, ids=lambda s: s.name)
def test_units_of_the_signal_make_no_difference(signal: Signal) -> None:
    campaign = planted(signal.name)
    rescaled = campaign.with_data({e.name: 250.0 * e.values - 3.0 for e in campaign})
    before, after = with_it(signal.name)[signal.name], findings(rescaled)[signal.name]
    assert after.log_bayes_factor == pytest.approx(before.log_bayes_factor, rel=0.1, abs=0.5)


@pytest.mark.parametrize("signal", SIGNALS, ids=lambda s: s.name)
def test_the_clock_makes_no_difference(signal: Signal) -> None:
    campaign = planted(signal.name)
    later = replace(campaign, experiments=tuple(
        replace(e, t=e.t + 3600.0, commanded_on=e.commanded_on + 3600.0,
                commanded_off=e.commanded_off + 3600.0)
        for e in campaign
    ))  # fmt: skip
    before, after = with_it(signal.name)[signal.name], findings(later)[signal.name]
    assert after.log_bayes_factor == pytest.approx(before.log_bayes_factor, rel=0.1, abs=0.5)
    for a, b in zip(before.places, after.places):
        assert b.time - a.time == pytest.approx(3600.0, abs=0.5)


@pytest.mark.parametrize("signal", SIGNALS, ids=lambda s: s.name)
def test_masked_samples_elsewhere_make_little_difference(signal: Signal) -> None:
    campaign = planted(signal.name)
    masked = []
    for e in campaign:
        used = np.ones(len(e.t), dtype=bool)
        used[(e.t > 2.0) & (e.t < 2.5)] = False
        masked.append(replace(e, mask=used))
    found = findings(replace(campaign, experiments=tuple(masked)))[signal.name]
    assert found.log_odds > 2.0
