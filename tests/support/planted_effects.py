"""Small campaigns with a known effect, for the tests of the diagnosis."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.signal import lfilter

from bayes_sensor.campaign import Campaign, Experiment
from bayes_sensor.diagnosis import Gap, diagnose_gap, signals
from bayes_sensor.diagnosis.effects.simulate_effects import simulate_with_effects

FLOWS = ((4.0, 0.5), (2.5, 0.5), (8.0, 1.0), (5.0, 1.0))
"""L/min: carrier and test gas"""
SIGNALS = {signal.name: signal for signal in signals.SIGNALS}
"""by name"""


def noise(n: int, rng: np.random.Generator, kind: str, slow: float = 0.3) -> np.ndarray:
    """(n,) of some spectrum, at a hundred samples a second; ``slow``: size of a slow part."""
    e = rng.standard_normal(n)
    if kind == "white":
        return e
    if kind == "ar1":
        return lfilter([1.0], [1.0, -0.9], e)
    if kind == "slow":
        return e + slow * lfilter([0.1], [1.0, -0.99], rng.standard_normal(n))
    if kind == "walk":
        return e + 0.02 * np.cumsum(rng.standard_normal(n))
    if kind == "paced":
        # as strong but ten times as slow by turns, for some seconds each
        turns = np.cumsum(rng.random(n) < 1.0 / 250.0) % 2 == int(rng.integers(2))
        made = np.zeros(n)
        for i, phi in enumerate(np.where(turns, 0.95, 0.55)[1:], start=1):
            made[i] = phi * made[i - 1] + np.sqrt(1.0 - phi**2) * e[i]
        return made
    # a resonance at 6 Hz
    root = 0.97 * np.exp(2j * np.pi * 6.0 * 0.01)
    return lfilter([0.1], [1.0, -2.0 * root.real, abs(root) ** 2], e) + 0.2 * e


def design(n: int = 4, interval: float = 0.01, fall: bool = True) -> Campaign:
    """The published rig in records of 60 s, steps near 12 and 35 s, without data."""
    t = np.arange(round(60.0 / interval)) * interval
    experiments = []
    for k in range(n):
        carrier, gas = (q * 1000.0 / 60.0 for q in FLOWS[k % len(FLOWS)])
        on = 11.0 + 0.7 * k
        experiments.append(
            Experiment(str(k + 1), t, None, carrier, gas, interval, on, on + 23.0 if fall else None)
        )
    return Campaign("gap", tuple(experiments), sensor_is="faster")


def theta(campaign: Campaign, sigma: float = 0.012, phi: float = 0.4) -> dict[str, object]:
    """Parameters near the published ones; noise that makes plausible effects visible."""
    own = {}
    for k, e in enumerate(campaign):
        values = {"y0_V": 0.2, "beta_V": 1.6 + 0.15 * k, "t0_s": e.commanded_on + 0.8}
        if e.has_fall:
            values["tf_s"] = e.commanded_off + 0.5
        own[e.name] = values
    return {
        "tau_s": 0.06, "tau_v_s": 0.8577, "V_mL": 58.23, "phi": phi, "sigma0_V": sigma,
        "sigma1_V": sigma, "experiments": own,
    }  # fmt: skip


def measured(
    effects: dict[str, float | None],
    seed: int = 1,
    sigma: float = 0.012,
    n: int = 4,
    interval: float = 0.01,
) -> Campaign:
    """A simulated campaign in which the effects act."""
    plan = design(n, interval)
    return simulate_with_effects(plan, theta(plan, sigma), effects, seed=seed)[0]


@lru_cache(maxsize=32)
def diagnosed(effect: str, strength: float | None = None, seed: int = 1) -> Gap:
    """The diagnosis of a campaign with one effect (or ``none``), kept between tests."""
    effects = {} if effect == "none" else {effect: strength}
    return diagnose_gap(measured(effects, seed), seed=seed, bootstrap=0, separate=False)
