"""Any chain of lags: response and sensitivities against high-precision arithmetic."""

import time
from collections.abc import Iterator
from decimal import Decimal, localcontext

import numpy as np
import pytest

from bayes_sensor.rig.chain import (
    Drive,
    chain_response,
    impulse_response,
    lag_sensitivities,
    step_response,
    switch_sensitivities,
)
from bayes_sensor.rig.partial_fractions import partial_fractions, quick_step_response, sorted_apart
from bayes_sensor.rig.programme import Programme, RecordedInput

SPLIT = 55
"""decimal places by which equal lags are moved apart, which changes a response by as much"""


class Exact:
    """Responses of a chain of lags by partial fractions, right to 50 digits by default.

    With k equal lags the coefficients reach 10^(split (k - 1)); the precision has as many digits
    more.
    """

    def __init__(self, taus: np.ndarray | list[float], split: int = SPLIT) -> None:
        self.digits = split * (len(taus) + 1)
        with localcontext() as context:
            context.prec = self.digits
            apart = Decimal(10) ** -split
            self.taus = [Decimal(float(tau)) * (1 + j * apart) for j, tau in enumerate(taus)]
            self.weights = []
            for tau in self.taus:
                weight = Decimal(1)
                for other in self.taus:
                    if other != tau:
                        weight *= tau / (tau - other)
                self.weights.append(weight)

    def _sum(self, s: float, power: int, ahead: int) -> float:
        if s <= 0.0:
            return 0.0
        with localcontext() as context:
            context.prec = self.digits
            at = Decimal(float(s))
            total = [Decimal(0), Decimal(1), at - sum(self.taus)][ahead]
            for tau, weight in zip(self.taus, self.weights):
                total += (-1) ** ahead * weight * tau**power * (-at / tau).exp()
            return float(total)

    def step(self, s: float) -> float:
        """To a unit step."""
        return self._sum(s, 0, 1)

    def impulse(self, s: float) -> float:
        """To a unit impulse."""
        return self._sum(s, -1, 0)

    def ramp(self, s: float) -> float:
        """To a ramp of unit slope."""
        return self._sum(s, 1, 2)


def chains(n: int) -> Iterator[tuple[str, np.ndarray]]:
    """Chains of ``n`` lags (s), with a name."""
    rng = np.random.default_rng(n)
    yield "equal", np.full(n, 0.7)
    for gap in (1e-15, 1e-12, 1e-8, 1e-3, 0.03, 0.3):
        yield f"apart by {gap:g}", 0.7 * (1.0 + gap * np.arange(n))
    yield "over 1e6", np.geomspace(1e-3, 1e3, n)
    yield "two groups", np.where(np.arange(n) % 2, 1e-3, 1e3) * (1.0 + 1e-12 * np.arange(n))
    yield "rates evenly apart", 1.0 / np.arange(1.0, n + 1.0)
    for i in range(3):
        yield f"random {i}", 10.0 ** rng.uniform(-3.0, 3.0, n)
        near = 10.0 ** rng.uniform(-14.0, -1.0, n)
        yield f"random groups {i}", 10.0 ** rng.choice([-2.0, 0.0, 1.0], n) * (1.0 + near)


def times_for(taus: np.ndarray) -> np.ndarray:
    """Times (s) from 1e-9 of the shortest lag to 1e3 of the longest."""
    return np.geomspace(1e-9 * taus.min(), 1e3 * taus.max(), 45)


# --- one step


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6])
def test_step_and_impulse_responses_are_exact(n: int) -> None:
    for name, taus in chains(n):
        exact, s = Exact(taus), times_for(taus)
        rates = np.sort(1.0 / taus)
        step = np.array([exact.step(x) for x in s])
        impulse = np.array([exact.impulse(x) for x in s])
        found = [step_response(x, rates) for x in s]
        # 1e-12 is promised; found were up to 6e-15, six lags 0.3 apart
        np.testing.assert_allclose(found, step, atol=5e-14, rtol=0, err_msg=name)
        scale = taus.max()  # the impulse response of the slowest lag alone begins at 1 over it
        found = [impulse_response(x, rates) * scale for x in s]
        np.testing.assert_allclose(found, impulse * scale, atol=1e-13, rtol=1e-13, err_msg=name)
        found = chain_response(s + 3.0, taus, Drive.of([3.0], level=[1.0]))
        away = np.abs(impulse) * 4e-16 * (s + 3.0)  # rounding of s + 3
        assert (np.abs(found - step) <= 5e-14 + away).all(), name


@pytest.mark.parametrize(("n", "tolerance"), [(8, 1e-12), (10, 5e-12)])
def test_tanks_in_series_may_make_longer_chains(n: int, tolerance: float) -> None:
    # equal tanks lose nothing; 3 % apart, found were 8e-14 and 4e-13
    for taus, atol in ((np.full(n, 0.7), 2e-15), (0.7 * (1.0 + 0.03 * np.arange(n)), tolerance)):
        exact, s, rates = Exact(taus), times_for(taus), np.sort(1.0 / taus)
        expected = [exact.step(x) for x in s]
        found = [step_response(x, rates) for x in s]
        np.testing.assert_allclose(found, expected, atol=atol, rtol=0)


def test_textbook_partial_fractions_fail_where_the_chain_does_not() -> None:
    # negative control: the reference discriminates at the tolerance used above
    taus = np.array([0.7, 0.7 * (1 + 1e-8), 0.05, 0.3])
    c = np.empty(4)
    partial_fractions(taus, c)
    found = 1.0 - c @ np.exp(-1.3 / taus)
    assert abs(found - Exact(taus).step(1.3)) > 1e-10


def test_partial_fractions_serve_lags_that_are_apart() -> None:
    taus, c = np.array([0.8577, 0.0481, 0.388, 2.0]), np.empty(4)
    sorted_apart(taus)
    partial_fractions(taus, c)
    exact = Exact(taus)
    for s in (-1.0, 0.0, 0.01, 1.0, 30.0, 61.0):
        assert quick_step_response(s, taus, c) == pytest.approx(exact.step(s), abs=1e-12)
    near = np.array([0.5, 0.5, 0.5])
    sorted_apart(near)
    np.testing.assert_allclose(near, [0.5, 0.5005, 0.5010005])


# --- programmes of switches


@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("interval", [None, 0.05])
def test_a_programme_is_the_sum_of_its_steps(n: int, interval: float | None) -> None:
    programme = Programme.steps(
        [(1.0, 0.3), (1.02, 0.9), (4.0, 0.25), (9.503, 1.0), (20.0, 0.0)], rest=0.1
    )
    t = 0.05 * np.arange(801) if interval else np.sort(np.random.default_rng(0).uniform(0, 40, 300))
    some = np.arange(0, len(t), 31)
    for name, taus in chains(n):
        taus = np.minimum(taus, 30.0)
        exact = Exact(taus, split=20)
        expected = sum(
            h * np.array([exact.step(x) for x in t[some] - at])
            for at, h in zip(programme.times, programme.heights)
        )
        found = chain_response(t, taus, programme.drive, interval)
        # of t - t_j itself 4e-15 s are rounding
        atol = 2e-13 + 1e-14 / taus.min() * (taus.max() < 0.1)
        np.testing.assert_allclose(found[some], expected, atol=atol, rtol=0, err_msg=name)


@pytest.mark.parametrize("interval", [1e-3, 0.04, 2.0])
@pytest.mark.parametrize("taus", [[0.8577, 0.388, 0.0481], [0.5] * 5, [3.0], [1e-4, 40.0]])
def test_on_a_grid_the_recurrence_gives_what_single_times_give(taus, interval) -> None:
    rng = np.random.default_rng(3)
    t = 7.3 + interval * np.arange(5000)
    times = np.sort(rng.uniform(t[0] - 20 * interval, t[-1] + 20 * interval, 60))
    times[7], times[30] = t[900], t[901]  # on samples
    times.sort()
    level, kicks = rng.uniform(-1, 1, 60), rng.uniform(-1, 1, 60)
    for drive, size in ((Drive.of(times, level=level), 2.0), (Drive.of(times, kicks=kicks), None)):
        expected = chain_response(t, taus, drive)
        found = chain_response(t, taus, drive, interval)
        size = size or 60.0 / min(taus)
        # time is rounded to 2e-12 s of 1e4 s, over which the fastest lag responds
        atol = (1e-13 + 4e-16 * t[-1] / min(taus)) * size
        np.testing.assert_allclose(found, expected, atol=atol, rtol=0)


def test_many_switches_cost_little_more_than_one_pulse() -> None:
    t, taus = 1e-3 * np.arange(120_000), [0.8577, 0.388, 0.0481]
    on = 0.5 + 0.59 * np.arange(200)
    many, one = Programme.pulses(on, on + 0.3).drive, Programme.pulse(20.0, 80.0).drive

    def seconds(drive: Drive) -> float:
        least = np.inf
        for _ in range(7):
            begin = time.perf_counter()
            chain_response(t, taus, drive, 1e-3)
            least = min(least, time.perf_counter() - begin)
        return least

    seconds(many)
    # 400 switches one by one would take 200 times as long; found 5
    assert seconds(many) < 30.0 * seconds(one)
    found = chain_response(t, taus, many, 1e-3)
    alone = sum(
        h * chain_response(t, taus, Drive.of([at], level=[1.0]), 1e-3)
        for at, h in zip(many.times, np.diff(many.level, prepend=0.0))
    )
    np.testing.assert_allclose(found, alone, atol=1e-12, rtol=0)


def test_times_may_stand_in_any_order() -> None:
    drive = Programme.pulses([1.0, 5.0], [3.0, 8.0]).drive
    t = np.linspace(0.0, 12.0, 101)
    shuffled = np.random.default_rng(1).permutation(101)
    expected = chain_response(t, [0.5, 2.0], drive)
    np.testing.assert_array_equal(
        chain_response(t[shuffled], [0.5, 2.0], drive), expected[shuffled]
    )
    assert chain_response(np.empty(0), [0.5], drive, 0.1).shape == (0,)
    assert chain_response(np.array([1.0, 5.0]), [0.5], drive)[0] == 0.0


# --- recorded inputs


@pytest.mark.parametrize("taus", [[0.9], [0.5, 0.5, 0.5], [0.01, 0.3, 2.0, 2.0, 1e-3, 7.0]])
@pytest.mark.parametrize("delay", [0.0, 0.25, 0.137, -0.31, 3.0])
def test_a_recorded_input_is_a_sequence_of_ramps(taus: list[float], delay: float) -> None:
    rng = np.random.default_rng(5)
    t = 0.1 * np.arange(200)
    values = 4.0 + np.cumsum(rng.normal(size=200)) * 0.1
    recorded = RecordedInput(t, values).later(delay)
    exact = Exact(taus, split=20)
    slopes = np.diff(np.diff(values) / np.diff(t), prepend=0.0, append=0.0)
    some = np.arange(5, 200, 49)
    expected = [
        sum(by * exact.ramp(x - at) for at, by in zip(recorded.times, slopes) if x > at)
        for x in t[some]
    ]
    for interval in (None, 0.1):
        found = chain_response(t, taus, recorded.drive, interval)[some]
        # 200 ramps, each rounded
        np.testing.assert_allclose(found, expected, atol=1e-12, rtol=0)
        slope = chain_response(t, taus, recorded.derivative, interval)
        moved = [
            chain_response(t, taus, recorded.later(by).drive, interval) for by in (1e-5, -1e-5)
        ]
        np.testing.assert_allclose(slope, (moved[1] - moved[0]) / 2e-5, atol=1e-4 / min(taus))


def test_a_recorded_input_at_uneven_times() -> None:
    rng = np.random.default_rng(6)
    at = np.cumsum(rng.uniform(0.01, 0.4, 150))
    recorded = RecordedInput(at, rng.uniform(0, 1, 150))
    t, taus = np.sort(rng.uniform(-1, at[-1] + 5, 40)), [0.3, 1.1, 0.3]
    exact = Exact(taus, split=20)
    slopes = np.diff(np.diff(recorded.values) / np.diff(at), prepend=0.0, append=0.0)
    expected = [sum(by * exact.ramp(x - a) for a, by in zip(at, slopes) if x > a) for x in t]
    np.testing.assert_allclose(chain_response(t, taus, recorded.drive), expected, atol=1e-12)
    # on a grid that is not that of the recording, the same by single times
    t = 0.1 * np.arange(100)
    np.testing.assert_array_equal(
        chain_response(t, taus, recorded.drive, 0.1), chain_response(t, taus, recorded.drive)
    )


# --- sensitivities


@pytest.mark.parametrize("interval", [None, 0.05])
@pytest.mark.parametrize(
    "taus", [[0.9], [0.5, 0.5], [0.8577, 0.388, 0.0481], [0.5, 0.5 * (1 + 1e-12), 2.0, 0.02, 0.5]]
)
def test_sensitivities_are_exact(taus: list[float], interval: float | None) -> None:
    programme = Programme.pulses([1.0, 6.0], [3.003, 9.0])
    t = 0.05 * np.arange(300)
    some = np.arange(3, 300, 23)
    by_lag = lag_sensitivities(t, taus, programme.derivative, interval)[some]
    for j, tau in enumerate(taus):
        step = Decimal(10) ** -20  # the difference quotient is right to 40 digits
        found = []
        for sign in (1, -1):
            moved = Exact(taus)
            with localcontext() as context:
                context.prec = moved.digits
                moved.taus[j] = moved.taus[j] + sign * step
                moved.weights = []
                for one in moved.taus:
                    weight = Decimal(1)
                    for other in moved.taus:
                        if other != one:
                            weight *= one / (one - other)
                    moved.weights.append(weight)
                values = []
                for x in t[some]:
                    total = Decimal(0)
                    for at, h in zip(programme.times, programme.heights):
                        s = Decimal(float(x - at))
                        if s > 0:
                            total += Decimal(h)
                            for one, weight in zip(moved.taus, moved.weights):
                                total -= Decimal(h) * weight * (-s / one).exp()
                    values.append(total)
                found.append(values)
        expected = [float((up - down) / (2 * step)) for up, down in zip(*found)]
        # in 1/s: a sensitivity reaches 0.4 over its lag
        np.testing.assert_allclose(by_lag[:, j], expected, atol=2e-13 / tau, rtol=1e-12)
    exact = Exact(taus)
    by_time = switch_sensitivities(t, taus, programme.times, programme.heights, interval)[some]
    for column, at, h in zip(by_time.T, programme.times, programme.heights):
        expected = [-h * exact.impulse(x - at) for x in t[some]]
        np.testing.assert_allclose(column, expected, atol=1e-12 / min(taus), rtol=1e-12)


@pytest.mark.parametrize("interval", [None, 0.1])
def test_sensitivities_to_lags_of_a_recorded_input(interval: float | None) -> None:
    t = 0.1 * np.arange(150)
    recorded = RecordedInput(t, np.sin(t) + 2.0).later(0.23)
    taus = np.array([0.3, 0.3, 1.7])
    found = lag_sensitivities(t, taus, recorded.derivative, interval)
    for j in range(3):
        step = 1e-4 * taus[j] * np.eye(3)[j]
        near = [chain_response(t, taus + k * step, recorded.drive) for k in (-2, -1, 1, 2)]
        # fourth order: the error is about the step to the fourth over the lag to the fifth
        expected = (8 * (near[2] - near[1]) - (near[3] - near[0])) / (12 * step[j])
        np.testing.assert_allclose(found[:, j], expected, atol=1e-10)
