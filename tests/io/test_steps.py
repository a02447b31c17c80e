"""Steps found in samples, against records whose steps are known, and records without any."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from bayes_sensor.io.steps import find_steps

T = np.round(0.01 * np.arange(6000), 6)


def response(steps: list[tuple[float, float]], lag: float, t: np.ndarray = T) -> np.ndarray:
    """(n,) First-order response to changes of height at times."""
    y = np.zeros(len(t))
    for start, height in steps:
        y += height * np.where(t > start, -np.expm1(-np.maximum(t - start, 0.0) / lag), 0.0)
    return y


def coloured(n: int, phi: float, sd: float, seed: int) -> np.ndarray:
    """(n,) AR(1) noise."""
    e = np.random.default_rng(seed).normal(0.0, sd * np.sqrt(1.0 - phi**2), n)
    return np.asarray(lfilter([1.0], [1.0, -phi], e))


@pytest.mark.parametrize("scale", [1e-9, 1.0, -3e6])
@pytest.mark.parametrize("lag", [0.02, 0.3, 3.0])
def test_a_pulse_is_two_steps(lag: float, scale: float) -> None:
    clean = response([(10.0, 1.0), (35.0, -1.0)], lag)
    noise = coloured(len(T), 0.9, 0.03, 1)
    up, down = find_steps(T, scale * (5.0 + clean + noise))
    for step, start, sign in ((up, 10.0, 1.0), (down, 35.0, -1.0)):
        assert step.height == pytest.approx(sign * scale, rel=0.05)
        # half way after lag * log(2); blocks of the search are 15 ms, noise adds to it
        assert step.half == pytest.approx(start + lag * np.log(2.0), abs=0.1 + 0.1 * lag)
        assert step.start <= step.tenth <= step.half <= step.end
        assert step.start <= start + 0.35 * lag + 0.05


def test_a_staircase_is_parted_at_its_plateaus_and_one_slow_rise_is_not() -> None:
    stairs = [(5.0, 1.0), (20.0, 0.6), (40.0, 0.8)]
    found = find_steps(T, response(stairs, 1.5) + coloured(len(T), 0.5, 0.02, 2))
    assert [round(step.height, 1) for step in found] == [1.0, 0.6, 0.8]
    (one,) = find_steps(T, response([(5.0, 1.0)], 20.0) + coloured(len(T), 0.5, 0.01, 3))
    assert one.sudden


def test_a_train_of_pulses_is_counted() -> None:
    edges = [(5.0 + 2.5 * i, (-1.0) ** i) for i in range(20)]
    found = find_steps(T, response(edges, 0.2) + coloured(len(T), 0.8, 0.03, 4))
    assert len(found) == 20
    assert all(a.height * b.height < 0 for a, b in pairwise(found))


@pytest.mark.parametrize("phi", [0.0, 0.9, 0.99, 0.998])
@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_shows_no_step(phi: float, seed: int) -> None:
    """Correlated over up to 5 s of 60 s."""
    assert find_steps(T, coloured(len(T), phi, 1.0, seed)) == ()


def test_a_spike_is_no_step_and_neither_is_a_constant() -> None:
    spike = np.where((T > 10.0) & (T < 10.2), 3.0, 0.0) + response([(20.0, 1.0)], 0.5)
    (step,) = find_steps(T, spike + coloured(len(T), 0.0, 0.01, 5))
    assert step.half == pytest.approx(20.0 + 0.5 * np.log(2.0), abs=0.1)
    assert find_steps(T, np.full(len(T), 0.3)) == ()
    assert find_steps(T[:10], T[:10]) == ()


def test_a_drift_is_not_sudden() -> None:
    (drift,) = find_steps(T, np.clip(T - 10.0, 0.0, 40.0))
    assert not drift.sudden


@pytest.mark.parametrize("seed", range(6))
def test_pulses_that_hardly_settle_are_counted_or_none_is_told(seed: int) -> None:
    """Where the signal moves for most of a record, its median change says nothing of the noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(5040.0)
    on = ((t - 120.0) % 480.0 < 240.0) & (t >= 120.0) & (t < 4920.0)
    for lag, counts in ((45.0, {20}), (60.0, {0, 20}), (90.0, {0, 20})):
        b = np.exp(-1.0 / lag)
        y = lfilter([1.0 - b], [1.0, -b], 600.0 * on) + lfilter(
            [2.4], [1.0, -0.6], rng.normal(size=len(t))
        )
        assert len(find_steps(t, y)) in counts
