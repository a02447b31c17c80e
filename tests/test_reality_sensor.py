"""Causes of the coating against closed forms, an ODE solver and their own promises."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import erfc, exp1

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality import Case, Step, clean_signals, draw_case, sample_times, without_causes
from bayes_sensor.reality.knobs import Knobs
from bayes_sensor.reality.rig import dip, voltage
from bayes_sensor.reality.simulator import prepared_rig
from bayes_sensor.reality.stages.lags import modal, retarded
from bayes_sensor.reality.stages.sensor import (
    burning,
    capillary,
    chained,
    deliquescing,
    elovich,
    flaring,
    glassy,
    islands,
    layered_film,
    loosening,
    moving_fronts,
    pinned,
)
from tests.reality_cases import case, solved


def test_the_swinging_column_obeys_its_length_and_stops() -> None:
    strength = 0.05
    rig = case(swinging_column=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    largest = max(step.test_gas_flow for step in rig.steps)
    for step in rig.steps:
        t = sample_times(step)
        (course,) = prepared_rig(rig)[step.name].concentration_gain
        swing = course(t)
        expected = (plain[step.name] - step.y0) * (1.0 + swing) + step.y0
        assert np.allclose(seen[step.name], expected, atol=2e-4 * step.beta)
        assert np.all(swing[t <= step.t0] == 0.0)
        assert np.abs(swing).max() <= strength * step.test_gas_flow / largest
        fine = step.t0 + np.linspace(1e-3, step.tf - step.t0 - 1e-3, 400_001)
        free = course(fine)
        turns = fine[1:][np.diff(np.sign(free)) != 0]
        half = np.diff(turns)
        assert np.ptp(half) < 1e-3  # damped, its period stays
        length = 2.0 * 9.81 * (half.mean() / np.pi) ** 2
        assert 0.2 < length < 0.8
        peaks = [np.abs(free[(fine > a) & (fine < b)]).max() for a, b in pairwise(turns)]
        decay = -half.mean() / np.diff(np.log(peaks))
        assert np.ptp(decay) < 0.02 * decay.mean() and 1.5 < decay.mean() < 8.0


def test_water_that_gives_way_and_a_ring_that_heats_itself_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    relative, exchange = rig.relative_concentration(step), step.total_flow / rig.V
    damp, load, slow = 0.3, 2.0, 3.0

    def with_water(u: float, x: FloatArray) -> list[float]:
        cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]
        # x[3] is how much less water there is than at the start
        water = damp - x[3]
        gas = (1.0 - water) * load * x[2] / (1.0 + load * x[2])  # on its sites, at once
        coming = damp / (1.0 - damp) * (1.0 - water - gas)
        return [*cascade, -(coming - water) / slow]

    t, states = solved(rig, with_water, 4)
    knobs = Knobs(damp=damp, damp_time=slow, displacing=load)
    seen = states[:, 2] * (1.0 - damp + states[:, 3]) / (1.0 - damp)
    assert np.abs(voltage(rig, step, knobs, t)[1] - seen).max() < 5e-5
    K = damp / (1.0 - damp)
    least = K / (1.0 + load + K)
    # on the plateau the water runs down to what the gas leaves it, and the response up
    assert 1.1 < seen.max() <= (1.0 - least) / (1.0 - damp)
    for knobs, each in zip(
        prepared_rig(case(displaced_water=0.2)).values(), rig.steps, strict=True
    ):
        assert knobs.damp == 0.2
        assert 1.0 < knobs.displacing / rig.relative_concentration(each) < 4.0

    detuning, reach = -0.8, 0.3 * relative
    for warming in (0.4, -0.4):

        def heating(u: float, x: FloatArray, warming=warming) -> list[float]:
            cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]
            absorbed = dip(detuning + reach * x[2] + x[3]) - dip(detuning)
            return [*cascade, (warming * absorbed - x[3]) / 1.2]

        t, states = solved(rig, heating, 4)
        y = voltage(rig, step, Knobs(warming=warming, warming_time=1.2), t)[0]
        at = detuning + reach * states[:, 2]
        read = (dip(at + states[:, 3]) - dip(at)) / (dip(detuning + reach) - dip(detuning))
        expected = step.y0 + step.beta * (states[:, 2] + read)
        assert np.abs(y - expected).max() < 1e-4 * step.beta
        # towards the line's centre the light runs ahead of the gas, away from it it gives in
        assert np.sign(read[np.abs(read).argmax()]) == np.sign(warming)
        last = np.searchsorted(t, step.tf) - 1
        moved = states[last, 3]
        assert moved == pytest.approx(warming * (dip(at[last] + moved) - dip(detuning)), abs=1e-3)


def test_a_coating_that_warms_as_it_takes_up_gas_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    heat, cooling = 0.3, 2.0

    def with_heat(u: float, x: FloatArray) -> list[float]:
        uptake = (x[1] * np.exp(-x[3]) - x[2]) / rig.tau
        cascade = [(u - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
        return [*cascade, uptake, heat * uptake - x[3] / cooling]

    t, states = solved(rig, with_heat, 4)
    x = voltage(rig, step, Knobs(sorption_heat=heat, cooling_time=cooling), t)[1]
    assert np.abs(x - states[:, 2]).max() < 5e-5
    plain = voltage(rig, step, Knobs(), t)[1]
    up, down = (t > step.t0 + 0.5) & (t < step.tf), t > step.tf + 0.5
    assert (x - plain)[up].min() < -0.05 and (x - plain)[down].max() > 0.02

    # a little heat in a coating that is quick: the warmth is heat times the gas through a
    # high-pass of the cooling time, and takes the gas there is times itself
    quick, little = replace(rig, tau=1e-3), 1e-3

    def high_pass(u: float, x: FloatArray) -> list[float]:
        cascade = [(u - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
        return [*cascade, (x[1] - x[2]) / quick.tau, (x[2] - x[3]) / cooling]

    t, states = solved(quick, high_pass, 4)
    gas, warmth = states[:, 2], states[:, 2] - states[:, 3]
    knobs = Knobs(sorption_heat=little, cooling_time=cooling)
    x, plain = (voltage(quick, step, some, t)[1] for some in (knobs, Knobs()))
    assert np.abs((plain - x) / little - gas * warmth).max() < 5e-3

    found = prepared_rig(case(heat_of_sorption=0.2))
    for each in rig.steps:
        knobs = found[each.name]
        assert knobs.sorption_heat == pytest.approx(0.2 * rig.relative_concentration(each))
        assert 1.0 <= knobs.cooling_time <= 8.0
    assert len({knobs.cooling_time for knobs in found.values()}) == 1


def test_fronts_go_down_as_the_root_of_time_and_meet() -> None:
    t = np.linspace(0.0, 60.0, 60_001)
    time_ = 10.0

    def turned(*pieces: tuple[float, float]) -> FloatArray:
        drive = np.full_like(t, -0.3)
        for begin, value in pieces:
            drive[t >= begin] = value
        return moving_fronts(t, drive, time_)

    # alone: root of 2 drive t / time, whole at time / (2 drive); then back from the surface on
    x = turned((2.0, 0.5), (20.0, -0.25))
    expected = np.sqrt(np.clip((t - 2.0) / 10.0, 0.0, 1.0))
    expected -= np.sqrt(np.clip((t - 20.0) / 20.0, 0.0, 1.0))
    assert np.abs(x - expected)[(t < 1.99) | (t > 2.1)].max() < 0.01
    assert x[t < 2.0].max() == 0.0 and x[-1] == 0.0
    # given up halfway: a second front follows and catches up with the first, and all is gone
    x = turned((2.0, 0.5), (4.5, -0.5))
    at = (t > 4.6) & (t < 6.9)
    assert np.abs(x[at] - (0.5 - np.sqrt((t[at] - 4.5) / 10.0))).max() < 0.01
    assert np.all(x[t > 7.01] == 0.0)
    # and on again before it has: the third front meets the second, then the first goes on as if
    # nothing had been, its way being held up for as long as the two were there
    x = turned((2.0, 0.5), (4.5, -0.5), (5.0, 0.5))
    assert np.all(x >= 0.0)
    after = (t > 5.6) & (t < 12.9)
    assert np.abs(x[after] ** 2 - (t[after] - 3.0) / 10.0).max() < 0.01
    assert np.all(x[t > 13.1] == 1.0)

    rig = case(converting_film=0.2)
    ideal = clean_signals(without_causes(rig))
    for step in rig.steps:
        knobs = prepared_rig(rig)[step.name]
        relative = rig.relative_concentration(step)
        gained = (clean_signals(rig)[step.name] - ideal[step.name]) / step.beta * relative
        assert gained.min() > -1e-9 and gained.max() <= 0.2 + 1e-9
        assert 0.1 < knobs.converting_at < 0.35 and 3.0 < knobs.converting_time < 30.0
        # on the plateau the square of the depth is straight; too little gas turns nothing
        t, plain = sample_times(step), voltage(rig, step, Knobs(), sample_times(step))[1]
        slow = Knobs(converting=0.2, converting_at=0.15, converting_time=60.0)
        depth = (voltage(rig, step, slow, t)[1] - plain) * relative / 0.2
        flat = (t > step.t0 + 8.0) & (t < step.tf)
        slope, _ = np.polyfit(t[flat], depth[flat] ** 2, 1)
        assert slope == pytest.approx(2.0 * (relative - 0.15) / 60.0, rel=0.01)
        none = Knobs(converting=0.2, converting_at=relative + 0.01)
        assert np.array_equal(voltage(rig, step, none, t)[1], plain)


def test_clouds_warm_the_cell_and_a_beat_passes_through_zero() -> None:
    strength = 0.2
    rig = case(sun_on_the_cell=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    times = []
    for step in rig.steps:
        (course,) = prepared_rig(rig)[step.name].concentration_gain
        t = np.arange(0.0, step.duration, 1e-3)
        warmth = -np.log1p(course(t)) / strength
        assert warmth.min() >= -1e-12 and warmth.max() <= 1.0 + 1e-12
        # warming towards 1 or cooling towards 0 at one rate, and nothing else
        rate, middle = np.diff(warmth) / 1e-3, 0.5 * (warmth[1:] + warmth[:-1])
        rising, falling = rate > 1e-6, rate < -1e-6
        found = np.concatenate(
            [(1.0 - middle[rising]) / rate[rising], -middle[falling] / rate[falling]]
        )
        times.append(np.median(found))
        assert np.mean(np.abs(found / times[-1] - 1.0) < 1e-3) > 0.99
        assert np.abs(np.diff(warmth)).max() < 1e-3 / 2.0  # it never jumps
        s = sample_times(step)
        gain = (seen[step.name] - step.y0) / (plain[step.name] - step.y0 + 1e-12)
        on = (s > step.t0 + 0.5) & (s < step.tf)
        assert np.abs(gain - 1.0 - course(s))[on].max() < 1e-6
        assert np.abs(seen[step.name] - plain[step.name])[s < step.t0].max() == 0.0
    assert np.ptp(times) < 1e-3 and 2.0 < times[0] < 15.0

    rig = case(beating_supply=0.05)
    size = 0.05 * np.mean([step.beta for step in rig.steps])
    rates, pulls, begins = [], [], []
    for step in rig.steps:
        (course,) = prepared_rig(rig)[step.name].offset
        t = np.arange(0.0, step.duration, 1e-4)
        y = course(t) / size
        assert 0.99 < np.abs(y).max() <= 1.0 + 1e-12
        # sin'' = -(angle')^2 sin + angle'' cos: where the sine is 0, its slope is the frequency
        zero = np.flatnonzero(np.diff(np.sign(y)) != 0)
        f = np.abs(np.diff(y))[zero] / 1e-4 / (2.0 * np.pi)
        first = f[:2].mean()
        assert 1.5 < first < 16.0
        assert f.min() < 0.5 * f.max() or f.min() < 1.0
        # its only jumps of frequency are at the commands, of one size either way
        jumps = []
        for command in (step.commanded_on, step.commanded_off):
            h = 1e-4
            fine = np.array([command - 2 * h, command - h, command, command + h, command + 2 * h])
            angle = np.unwrap(np.arcsin(np.clip(course(fine) / size, -1.0, 1.0)))
            slopes = np.diff(angle) / h / (2.0 * np.pi)
            jumps.append(abs(abs(slopes[2]) - abs(slopes[1])))
        pulls.append(max(jumps))
        rates.append(first)
        begins.append(y[0])
        s = sample_times(step)
        moved = clean_signals(rig)[step.name] - clean_signals(without_causes(rig))[step.name]
        assert np.allclose(moved, course(s), atol=1e-9)
    assert np.ptp(begins) > 0.01
    assert 0.15 < min(pulls) and max(pulls) < 3.1


def test_a_front_eats_its_way_evenly_into_the_glass() -> None:
    t = np.linspace(0.0, 40.0, 40_001)
    gas = np.where((t >= 5.0) & (t < 20.0), 0.6, 0.0)
    m = glassy(t, gas, 0.25, 1.5)
    up = np.minimum(0.6 * 0.25 * (t - 5.0), 0.6)  # through after 4 s
    expected = np.where(t < 5.0, 0.0, np.where(t < 20.0, up, 0.6 * np.exp(-(t - 20.0) / 1.5)))
    assert np.abs(m - expected).max() < 5e-4
    # weaker gas needs as much longer as it is weaker when the speed goes with the concentration
    half = glassy(t, np.where(t >= 5.0, 1.0, 0.0), 0.1, 1.5)
    assert t[half >= 1.0 - 1e-9][0] == pytest.approx(15.0, abs=0.01)

    strength = 0.2
    rig = case(glassy_rim=strength)
    found = prepared_rig(rig)
    assert len({(k.rim, k.rim_time, k.rim_back) for k in found.values()}) == 1
    assert 1.0 < found["1"].rim_time < 8.0
    assert 0.1 < found["1"].rim_back / found["1"].rim_time < 0.5
    for step in rig.steps:
        t, relative = sample_times(step), rig.relative_concentration(step)
        knobs = Knobs(rim=strength, rim_time=4.0, rim_back=1.0)
        x, plain = (voltage(rig, step, some, t)[1] for some in (knobs, Knobs()))
        rim = (x - (1.0 - strength) * plain) / strength
        settled = (t > step.t0 + 4.0) & (t < step.tf) & (rim < 0.99)
        if settled.sum() > 10:
            slope = np.polyfit(t[settled], rim[settled], 1)[0]
            assert slope == pytest.approx(relative / 4.0, rel=0.02)
        through = step.t0 + rig.tau_v + rig.V / step.total_flow + 4.0 / relative
        if through + 0.5 < step.tf:
            assert np.abs(x - plain)[(t > through + 0.5) & (t < step.tf)].max() < 5e-3
        down = t > step.tf + 4.5
        if rim[down][0] > 1e-3:
            rate = np.polyfit(t[down], np.log(np.maximum(rim[down], 1e-12)), 1)[0]
            assert rate < -0.5


def test_islands_spread_evenly_and_shrink_again() -> None:
    t = np.linspace(0.0, 60.0, 60_001)
    gas = np.where((t >= 5.0) & (t < 15.0), 0.8, 0.0)
    covered = islands(t, gas - 0.3, 4.0)
    r = np.clip(0.5 / 4.0 * (t - 5.0), 0.0, None)
    r = np.where(t < 15.0, r, np.maximum(1.25 - 0.3 / 4.0 * (t - 15.0), 0.0))
    assert np.abs(covered - (1.0 - np.exp(-(r**2)))).max() < 1e-3
    assert np.all(covered[t < 5.0] == 0.0) and np.all(covered[t > 32.0] == 0.0)
    assert np.all(islands(t, np.full(len(t), -0.1), 1.0) == 0.0)
    # they meet: after any time above their vapour pressure they take as long to go
    for end in (15.0, 30.0):
        met = islands(t, np.where(t < end, 0.7, -0.3), 1.0)
        assert met.max() == pytest.approx(1.0 - np.exp(-4.0))
        assert t[met > 0.0].max() - end == pytest.approx(2.0 / 0.3, abs=0.01)

    strength = 0.2
    rig = case(spreading_islands=strength)
    ((vapour, time_),) = {
        (knobs.islands_vapour, knobs.islands_time) for knobs in prepared_rig(rig).values()
    }
    assert 0.1 < vapour < 0.35 and 0.2 < time_ < 2.0
    for step in rig.steps:
        t, relative = sample_times(step), rig.relative_concentration(step)
        fine = np.linspace(0.0, step.duration, 60_001)
        # without the sensor's own delay the response is the gas
        quick = replace(rig, tau=1e-9)
        gas = voltage(quick, step, Knobs(), fine)[1]
        r, radius = 0.0, []
        for drive in (relative * gas - vapour) / time_ * (fine[1] - fine[0]):
            radius.append(r)
            r = min(max(r + drive, 0.0), 2.0)
        expected = strength / relative * (1.0 - np.exp(-np.square(radius)))
        x, plain = (
            voltage(rig, step, some, t)[1] for some in (prepared_rig(rig)[step.name], Knobs())
        )
        assert np.abs(x - plain - np.interp(t, fine, expected)).max() < 5e-3
        below = relative * gas.max() < vapour
        assert (np.abs(x - plain).max() == 0.0) == below


def test_an_impurity_comes_late_and_takes_its_share() -> None:
    t = np.linspace(0.0, 40.0, 40_001)
    one = np.ones(len(t))
    # n equal cells that are flushed at a constant flow: a gamma distribution of their passage
    out = retarded(t, one, 3.0 * one, 24.0, 12)
    rate = t * 3.0 / 24.0 * 12.0
    terms = np.cumprod(np.vstack([one, rate / np.arange(1, 12)[:, None]]), axis=0)
    assert np.abs(out - (1.0 - np.exp(-rate) * terms.sum(axis=0))).max() < 1e-6
    late = np.trapezoid(1.0 - out, t)
    assert late == pytest.approx(24.0 / 3.0, rel=1e-3)

    strength, passed = 0.25, []
    rig = case(late_impurity=strength)
    # so that it comes through everywhere
    long = replace(rig, steps=tuple(replace(p, tf=2e3 + p.t0, duration=2.1e3) for p in rig.steps))
    for step, own in zip(rig.steps, long.steps, strict=True):
        t = sample_times(step)
        knobs = prepared_rig(rig)[step.name]
        x, plain = (voltage(rig, step, some, t)[1] for some in (knobs, Knobs()))
        assert np.all(x <= plain + 1e-12)
        early = (t > step.t0) & ((t - step.t0) * step.total_flow < 0.2 * knobs.impurity_volume)
        assert early.sum() > 5 and np.all((plain - x)[early] <= 0.01 * plain[early])
        # Langmuir: what is left in the end at the set concentration
        s = np.linspace(step.t0, step.t0 + 400.0, 40_001)
        x, plain = (voltage(long, own, some, s)[1] for some in (knobs, Knobs()))
        full = strength / (1.0 - strength) * rig.relative_concentration(step)
        assert x[-1] == pytest.approx(1.0 / (1.0 + full), rel=1e-6)
        if rig.relative_concentration(step) == 1.0:
            assert x[-1] == pytest.approx(1.0 - strength, rel=1e-6)
        # the area above its front is the mean delay: the valve's, the manifold's and the filter's
        arrived = (plain[plain > 1e-3] / x[plain > 1e-3] - 1.0) / full
        late = np.sum(plain <= 1e-3) * 0.01 + np.trapezoid(1.0 - arrived, dx=0.01)
        passed.append((late - rig.tau_v - rig.V / step.total_flow) * step.total_flow)
    # the same volume everywhere, though not the same time
    assert passed == pytest.approx([knobs.impurity_volume] * len(passed), rel=0.01)


def test_pores_empty_at_the_square_of_the_pressure_at_which_they_filled() -> None:
    # up to 0.6, some way back, and down: full up to 0.6 until the root is below
    pressure = np.concatenate([np.linspace(0.0, 0.6, 601), np.linspace(0.6, 0.0, 601)])
    reach = capillary(pressure)
    assert np.array_equal(reach[:601], pressure[:601])
    down = pressure[601:]
    assert np.allclose(reach[601:], np.where(down > 0.36, 0.6, np.sqrt(down)))
    # a small turn within the loop changes nothing
    turn = np.array([0.0, 0.6, 0.4, 0.55, 0.4, 0.25, 0.4, 0.6])
    assert capillary(turn) == pytest.approx([0.0, 0.6, 0.6, 0.6, 0.6, 0.5, 0.5, 0.6])

    strength, late = 0.3, 0
    rig = case(capillary_condensation=strength)
    seen = clean_signals(rig)
    for step in rig.steps:
        t, relative = sample_times(step), rig.relative_concentration(step)
        knobs = prepared_rig(rig)[step.name]
        assert 0.5 < knobs.pores_vapour < 0.9 and 0.05 < knobs.pores_width < 0.2
        plain = (voltage(rig, step, Knobs(), t)[0] - step.y0) / step.beta
        more = ((seen[step.name] - step.y0) / step.beta - plain) * relative / strength
        assert more.min() > -1e-9 and more.max() < 1.0
        # on the plateau a log-normal share of the pores is full, for the pressure that is there
        z = np.log(knobs.pores_vapour * relative / knobs.pores_at) / knobs.pores_width
        full = 0.5 * erfc(-z / np.sqrt(2.0))
        end = t < step.tf
        assert more[end][-1] == pytest.approx(full, abs=1e-3)
        if full < 0.2:
            continue
        late += 1
        # half of it comes and goes at pressures of which one is the other's square, or as little
        # as there was when it was left
        half, rises, falls = 0.5 * full, end & (t > step.t0), t > step.tf
        top = knobs.pores_vapour * relative
        up = top * np.interp(half, more[rises], plain[rises])
        down = top * np.interp(-half, -more[falls], plain[falls])
        assert down == pytest.approx(up**2, rel=0.25)
        assert down < 0.8 * up
    assert late >= 1


def test_a_poisoned_coating_loses_sites_with_the_dose_against_an_ode_solver() -> None:
    strength = 0.5
    rig = case(poisoned_coating=strength)
    seen, alive = clean_signals(rig), 1.0
    doses = [rig.relative_concentration(step) * (step.tf - step.t0) for step in rig.steps]
    for k, step in enumerate(rig.steps):
        rate = np.log(2.0) / sum(doses) * rig.relative_concentration(step)

        def dying(u: float, x: FloatArray, step: Step = step, rate: float = rate) -> list[float]:
            cascade = [(u - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
            return [*cascade, (x[1] - x[2]) / rig.tau, -rate * x[2] * (1.0 + x[3])]

        _, states = solved(rig, dying, 4, k=k)  # x[3]: what has died in this record
        x = alive * states[:, 2] * (1.0 + states[:, 3])
        assert np.abs((seen[step.name] - step.y0) / step.beta - x).max() < 1e-3
        alive *= 1.0 + states[-1, 3]
    assert alive == pytest.approx(1.0 - strength, abs=2e-3)


def test_a_coating_ignites_and_goes_on_burning_below() -> None:
    strength, borders = 0.3, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"igniting_coating": strength})
        knobs, seen = prepared_rig(rig)["1"], clean_signals(rig)
        burns, brought, time = knobs.glow_burns, knobs.glow_brought, knobs.glow_time

        def steady(w: FloatArray, burns: float = burns, brought: float = brought) -> FloatArray:
            return w * (np.exp(-w) / burns + 1.0 / brought)  # the gas that keeps it as warm

        w = np.linspace(0.0, 2.0 * brought, 400_001)
        slopes = np.sign(np.diff(steady(w)))
        (up,) = np.flatnonzero((slopes[1:] < 0) & (slopes[:-1] > 0)) + 1
        (down,) = np.flatnonzero((slopes[1:] > 0) & (slopes[:-1] < 0)) + 1
        ignites, dies = float(steady(w)[up]), float(steady(w)[down])
        borders.append(ignites)
        assert dies < ignites
        # all of it at the highest concentration
        assert knobs.glow * np.interp(1.0, steady(w)[down:], w[down:]) == pytest.approx(
            strength, rel=1e-4
        )
        # slowly up and down again: it jumps where it must, and elsewhere on the way back
        t = np.linspace(0.0, 4000.0 * time, 400_001)
        g = 1.0 - np.abs(t / (2000.0 * time) - 1.0)
        warmth = burning(t, g, burns, brought, time)
        hot = warmth > 0.5 * (w[up] + w[down])
        assert g[np.argmax(hot)] == pytest.approx(ignites, abs=0.03)
        assert g[len(hot) - 1 - np.argmax(hot[::-1])] == pytest.approx(dies, abs=0.03)

        for k, step in enumerate(rig.steps):
            relative, exchange = rig.relative_concentration(step), step.total_flow / rig.V

            def glowing(
                u: float, x: FloatArray, rig: Case = rig, relative: float = relative,
                exchange: float = exchange, burns: float = burns, brought: float = brought,
                time: float = time,
            ) -> list[float]:  # fmt: skip
                heat = relative * x[1] / (np.exp(-x[3]) / burns + 1.0 / brought)
                cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1])]
                return [*cascade, (x[1] - x[2]) / rig.tau, (heat - x[3]) / time]

            _, states = solved(rig, glowing, 4, k=k)
            x = states[:, 2] + knobs.glow / relative * states[:, 3]
            assert np.abs((seen[step.name] - step.y0) / step.beta - x).max() < 1e-3
    assert 0.3 < min(borders) < max(borders) < 0.7


def test_a_catalyst_flares_and_goes_out_by_turns() -> None:
    strength, counts = 0.2, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"flaring_catalyst": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        knobs = found["1"]
        low, high = knobs.flares_from, knobs.flares_until
        oxidises, reduces = knobs.flares_oxidise, knobs.flares_reduce
        plain = clean_signals(without_causes(rig))
        for step in rig.steps:
            t, relative = sample_times(step), rig.relative_concentration(step)
            x = (plain[step.name] - step.y0) / step.beta
            # the gas as the coating's lag shows it, undone
            gas = relative * np.clip(x + rig.tau * np.gradient(x, t), 0.0, None)
            # turn by turn from what passes: of gas while it is out, of time while it burns
            passed = np.concatenate([[0.0], np.cumsum(0.5 * (gas[1:] + gas[:-1]) * np.diff(t))])
            edges, at, total = [], 0.0, passed[-1]
            while True:
                needs = np.interp(at, t, passed) + reduces * np.log(high / low)
                if needs >= total:
                    break
                lit = float(np.interp(needs, passed, t))
                at = lit + oxidises * np.log((1.0 - low) / (1.0 - high))
                edges.append((lit, at))
            counts.append(len(edges))
            burns = np.zeros(len(t), dtype=bool)
            for lit, out in edges:
                burns |= (t > lit) & (t < out)

            def warming(s: float, w: FloatArray, t: FloatArray = t, heat: FloatArray = gas * burns,
                        cooling: float = knobs.flares_cooling) -> FloatArray:  # fmt: skip
                return (np.interp(s, t, heat) - w) / cooling

            solution = solve_ivp(
                warming, (0.0, t[-1]), [0.0], t_eval=t, max_step=0.01, rtol=1e-6, atol=1e-8
            )
            added = (seen[step.name] - plain[step.name]) / step.beta * relative
            # a switch lies anywhere between two samples
            assert np.abs(added - strength * solution.y[0]).max() < 0.06 * strength
            assert added.max() < strength * relative + 1e-9 and added.min() > -1e-9
    assert max(counts) > 1 and min(counts) < max(counts)  # more gas, more turns

    # left alone with the gas its turns are even: closed form
    t = np.linspace(0.0, 200.0, 20_001)
    warmth = flaring(t, np.full(len(t), 0.5), 3.0, 2.0, 0.3, 0.7, 1e-3)
    lit = t[1:][np.diff((warmth > 0.25).astype(int)) == 1]
    period = 3.0 * np.log(0.7 / 0.3) + 4.0 * np.log(0.7 / 0.3)
    assert np.diff(lit) == pytest.approx(period, abs=0.021)
    assert lit[0] == pytest.approx(4.0 * np.log(0.7 / 0.3), abs=0.02)
    # and few nodes tell the same
    few = flaring(t[::100], np.full(201, 0.5), 3.0, 2.0, 0.3, 0.7, 1e-3)
    assert np.abs(few - warmth[::100]).max() < 1e-9


def test_a_long_fibre_reads_what_lies_along_it() -> None:
    strength = 1.3
    rig = case(long_fibre=strength)
    seen = clean_signals(rig)
    for k, step in enumerate(rig.steps):
        exchange = step.total_flow / rig.V

        def cascade(u: float, x: FloatArray, exchange: float = exchange) -> list[float]:
            return [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]

        # many short pieces, each a ring of its own, to which the gas comes the later
        t, states = solved(rig, cascade, 3, k=k)
        pieces, lasts = 400, strength / exchange
        ways = (np.arange(pieces) + 0.5) / pieces * lasts
        x = np.mean([np.interp(t - late, t, states[:, 2], left=0.0) for late in ways], axis=0)
        assert np.abs((seen[step.name] - step.y0) / step.beta - x).max() < 2e-4
        # the whole step is late by half of the way
        up = (t > step.t0) & (t < step.tf)
        shown = (seen[step.name][up] - step.y0) / step.beta
        late = np.trapezoid(1.0 - shown, t[up]) + t[up][0] - step.t0
        expected = rig.tau_v + (1.0 + 0.5 * strength) / exchange + rig.tau
        assert late == pytest.approx(expected, rel=3e-3)


def test_the_layered_film_is_a_delay_of_the_stated_mean_and_not_one_lag() -> None:
    times, weights = layered_film(0.05)
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)  # settles at the gas's concentration
    assert weights @ times == pytest.approx(0.05)
    t = np.concatenate([[-1e-6], np.linspace(0.0, 1.0, 4001)])
    x = modal(t, (t >= 0).astype(float), times, weights)
    assert np.all(np.diff(x) > -1e-10)  # rounding of the modes' sum
    # a film holds back at first: far less than the lag's 1 - exp(-0.1) after a tenth of its mean
    assert np.interp(0.005, t, x) < 0.3 * (1.0 - np.exp(-0.1))


def test_uneven_bonds_fill_and_empty_as_logarithms() -> None:
    # Elovich's law of release, from the full coverage down to nothing
    t = np.linspace(0.0, 60.0, 6001)
    g = np.where(t < 20.0, 1.0, 0.0)
    bound = elovich(t, g, 1.8, 0.7)
    assert bound[t < 20.0][-1] == pytest.approx(1.0, abs=1e-6)
    since = np.maximum(t - 19.995, 0.0)  # the gas goes between two nodes
    left = np.maximum(1.0 - np.log1p(since / 1.4) / 1.8, 0.0)
    assert bound[t > 20.1] == pytest.approx(left[t > 20.1], abs=3e-3)
    assert bound[-1] == 0.0
    # Temkin's isotherm, and none bound by too little gas
    for gas in (0.05, 0.3, 0.8):
        assert elovich(t, np.full(len(t), gas), 1.8, 0.7)[-1] == pytest.approx(
            max(1.0 + np.log(gas) / 3.6, 0.0), abs=1e-6
        )
    assert elovich(t, np.full(len(t), 0.02), 1.8, 0.7).max() == 0.0

    strength, bends = 0.2, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"uneven_bonds": strength})
        knobs, seen = prepared_rig(rig)["1"], clean_signals(rig)
        bends.append(knobs.bonds_bend)
        for k, step in enumerate(rig.steps):
            relative, exchange = rig.relative_concentration(step), step.total_flow / rig.V

            def binding(
                u: float, x: FloatArray, rig: Case = rig, relative: float = relative,
                exchange: float = exchange, b: float = knobs.bonds_bend,
                time: float = knobs.bonds_time,
            ) -> list[float]:  # fmt: skip
                settling = relative * x[1] * np.exp(b * (1.0 - x[3])) - np.exp(b * (x[3] - 1.0))
                if x[3] <= 0.0:
                    settling = max(settling, 0.0)
                cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1])]
                return [*cascade, (x[1] - x[2]) / rig.tau, 0.5 * settling / b / time]

            _, states = solved(rig, binding, 4, k=k)
            x = states[:, 2] + strength / relative * states[:, 3]
            assert np.abs((seen[step.name] - step.y0) / step.beta - x).max() < 1e-3
    assert 1.2 < min(bends) < max(bends) < 3.0


def test_blisters_come_only_where_gas_is_gone_too_fast_against_an_ode_solver() -> None:
    strength, levels, lifted = 0.3, set(), 0
    for seed in range(11, 23):
        rig = replace(draw_case(seed, size="small"), strengths={"blistering_coating": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        knobs = prepared_rig(rig)["1"]
        level, soaks, time = knobs.blisters_level, knobs.blisters_soak, knobs.blisters_time
        levels.add(level)
        for k, step in enumerate(rig.steps):
            t, relative = sample_times(step), rig.relative_concentration(step)
            less = (plain[step.name] - seen[step.name]) / step.beta * relative
            assert np.abs(less[t <= step.tf]).max() == 0.0
            assert less.min() >= 0.0 and less.max() < strength
            if relative <= level:
                assert less.max() == 0.0
                continue
            lifted += less.max() > 0.01 * strength
            if seed > 13:
                continue

            def blistering(
                u: float, x: FloatArray, exchange: float = step.total_flow / rig.V,
                relative: float = relative, rig: Case = rig, level: float = level,
                soaks: float = soaks, time: float = time,
            ) -> list[float]:  # fmt: skip
                cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1])]
                pressed = max(relative * (x[3] - x[1]) - level, 0.0) / (1.0 - level)
                return [*cascade, (x[1] - x[2]) / rig.tau, (x[1] - x[3]) / soaks,
                        (pressed - x[4]) / time]  # fmt: skip

            _, states = solved(rig, blistering, 5, k=k)
            assert np.abs(less - strength * states[:, 4]).max() < 2e-4
    assert lifted > 15 and 0.08 < min(levels) < 0.5 * max(levels) < 0.18


def watered(
    t: FloatArray, a: FloatArray, dissolves: float, comes_out: float, time: float
) -> FloatArray:
    """(n,) water on a salt under an activity ``a`` (n,), by an ODE solver from turn to turn."""
    out, begin, w, crystals = np.zeros(len(t)), float(t[0]), 0.0, True
    while begin < t[-1]:

        def taking_up(s: float, w: FloatArray, crystals: bool = crystals) -> list[float]:
            now = np.interp(s, t, a)
            if crystals:
                return [(now - dissolves) / time if w[0] > 0.0 or now > dissolves else 0.0]
            return [(now - w[0] / (1.0 + w[0])) / time]

        border = dissolves if crystals else comes_out

        def turns(s: float, w: FloatArray, border: float = border) -> float:
            return float(w[0] - border / (1.0 - border))

        turns.terminal, turns.direction = True, 1.0 if crystals else -1.0  # type: ignore[attr-defined]
        result = solve_ivp(
            taking_up, (begin, t[-1]), [w], events=turns, dense_output=True, max_step=0.01,
            rtol=1e-8, atol=1e-10,
        )  # fmt: skip
        inside = (t >= begin) & (t <= result.t[-1])
        out[inside] = result.sol(t[inside])[0]
        begin, w, crystals = float(result.t[-1]), float(result.y[0, -1]), not crystals
    return out


def test_a_salt_dissolves_at_one_moisture_and_comes_out_at_another_against_an_ode_solver() -> None:
    t = np.arange(0.0, 30.0, 2e-3)
    moist = 0.75 * np.where(t < 20.0, 1.0 - np.exp(-t), np.exp(20.0 - t))
    w = deliquescing(t, moist, 0.4, 0.2, 0.2)
    assert np.abs(w - watered(t, moist, 0.4, 0.2, 0.2)).max() < 2e-3
    # nothing before, Raoult's law in the end, and all gone at once when crystals have come out
    assert w[moist <= 0.4][t[moist <= 0.4] < 20.0].max() == 0.0
    assert w[np.searchsorted(t, 19.9)] == pytest.approx(3.0, rel=1e-2)
    drying = t > 20.0
    out_again = np.searchsorted(t, t[drying][w[drying] < 0.25][0])
    before, after = w[out_again - 4] - w[out_again - 2], w[out_again + 2] - w[out_again + 4]
    assert after > 2.0 * before
    # half a solution stays under what it would not have come from
    between = np.where(t < 2.0, 0.6, 0.3)
    assert deliquescing(t, between, 0.4, 0.2, 0.2)[-1] == pytest.approx(0.3 / 0.7, rel=1e-3)
    assert deliquescing(t, np.where(t < 2.0, 0.6, 0.15), 0.4, 0.2, 0.2)[-1] == 0.0
    assert deliquescing(t, np.full(len(t), 0.39), 0.4, 0.2, 0.2).max() == 0.0

    strength, never, levels = 0.3, 0, []
    for seed in range(11, 19):
        rig = replace(draw_case(seed, size="small"), strengths={"deliquescent_salt": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        knobs = prepared_rig(rig)["1"]
        vapour, borders = knobs.salt_vapour, (knobs.salt_dissolves, knobs.salt_comes_out)
        levels.append([vapour, borders[0] / vapour, borders[1] / borders[0]])
        for k, step in enumerate(rig.steps):
            relative = rig.relative_concentration(step)
            more = (seen[step.name] - plain[step.name]) / step.beta * relative
            if vapour * relative <= borders[0]:
                never += 1
                assert np.abs(more).max() == 0.0
                continue
            if seed > 12:
                continue

            def mixed(
                u: float, x: FloatArray, exchange: float = step.total_flow / rig.V, rig: Case = rig
            ) -> list[float]:
                return [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1])]

            t, states = solved(rig, mixed, 2, k=k)
            water = watered(t, vapour * relative * states[:, 1], *borders, knobs.salt_time)
            full = vapour / (1.0 - vapour)
            assert np.abs(more - strength * water / full).max() < 2e-3
    low, high = np.min(levels, axis=0), np.max(levels, axis=0)
    assert never >= 1 and np.all(low > [0.6, 0.3, 0.3]) and np.all(high < [0.8, 0.7, 0.7])


def test_a_glass_loosens_late_and_tightens_ever_more_slowly_against_an_ode_solver() -> None:
    # without gas: time w' = -w exp(bend w), an exponential integral
    t, bend, time = np.linspace(0.0, 60.0, 12_001), 2.5, 4.0
    gas = np.where(t < 30.0, 1.0, 0.0)
    w = loosening(t, gas, bend, time)
    left = w[t > 30.01]
    passed = time * (exp1(bend * left) - exp1(bend * left[0]))
    assert passed == pytest.approx(t[t > 30.01] - 30.015, abs=5e-3)
    # as far in both directions: up it begins slowly and arrives quickly, down the other way round
    up, down = w[t <= 30.0], 1.0 - w[t >= 30.005]
    first = [t[np.argmax(way > 0.2)] for way in (up, down)]
    last = [t[np.argmax(way > 0.9)] for way in (up, down)]
    assert first[0] > 3.0 * first[1] and last[1] > 1.5 * last[0]

    strength, drawn = 0.3, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"loosening_glass": strength})
        seen = clean_signals(rig)
        knobs = prepared_rig(rig)["1"]
        drawn.append((knobs.loosening_time, knobs.loosening_bend))
        for k, step in enumerate(rig.steps):
            bend = knobs.loosening_bend * rig.relative_concentration(step)

            def glass(
                u: float, x: FloatArray, step: Step = step, rig: Case = rig, bend: float = bend,
                time: float = knobs.loosening_time,
            ) -> list[float]:  # fmt: skip
                gas = [(u - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
                loosens = (x[2] - x[3]) * np.exp(bend * x[3]) / time
                return [*gas, (x[1] - x[2]) / rig.tau, loosens]

            _, states = solved(rig, glass, 4, k=k)
            x = states[:, 2] - strength * states[:, 3]
            assert np.abs((seen[step.name] - step.y0) / step.beta - x).max() < 2e-4
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [2.99, 0.99]) and np.all(high < [25.01, 3.01]) and np.all(high > 1.2 * low)


def test_a_drop_dries_record_after_record_and_is_gone() -> None:
    strength, places, whole = 2.0, [], 0
    for seed in range(11, 19):
        rig = replace(draw_case(seed, size="small"), strengths={"drying_drop": strength})
        # all else quick: the gas is let in and out by the drop alone
        rig = replace(rig, tau=1e-3, tau_v=1e-3, V=0.05)
        found, seen, plain = (
            prepared_rig(rig),
            clean_signals(rig),
            clean_signals(without_causes(rig)),
        )
        length = sum(step.duration for step in rig.steps)
        first = found["1"].drop
        assert first is not None
        thick = first(np.array([0.0, 20.0]))
        assert thick[0] == strength
        gone = 20.0 / (1.0 - thick[1] / strength)
        places.append(gone / length)
        for k, step in enumerate(rig.steps):
            begin = 30.0 * k
            if begin >= gone:
                assert np.array_equal(seen[step.name], plain[step.name])
                continue
            t = sample_times(step)
            # thick' = -slope and thick x' = 1 - x: what is missing goes as thick^(1/slope)
            still = np.maximum(gone - begin - np.array([step.t0, step.tf]), 0.0)
            left = np.maximum(gone - begin - t, 0.0)
            with np.errstate(divide="ignore", invalid="ignore"):
                missing = np.where(t < step.t0, 1.0, (left / still[0]) ** (gone / strength))
                x = 1.0 - np.where(still[0] > 0.0, missing, (t < step.t0) * 1.0)
                full = 1.0 - (still[1] / still[0]) ** (gone / strength) if still[0] > 0 else 1.0
                fallen = full * (left / still[1]) ** (gone / strength) if still[1] > 0 else 0.0 * t
            x = np.where(t < step.tf, x, fallen)
            steady = np.minimum(np.abs(t - step.t0), np.abs(t - step.tf)) > 0.03
            off = np.abs((seen[step.name] - step.y0) / step.beta - x)
            assert off[steady].max() < 0.03 and off[steady].mean() < 2e-3
            whole += 1
    assert 0.35 < min(places) < 0.6 < max(places) < 0.95 and whole >= 10


def test_chains_grow_from_seeds_late_and_all_at_once_against_an_ode_solver() -> None:
    # hardly any seeds: logistic curves, late by the logarithm of their number
    t, level, seeds = np.linspace(0.0, 120.0, 24_001), 0.25, 1e-6
    gas = np.where(t < 60.0, 0.75, 0.0)
    w = chained(t, gas, level, seeds, 1.5)
    rate = (0.75 - level) / 1.5
    half = np.log(1.0 / (seeds * 0.75 / (0.75 - level))) / rate
    assert t[np.argmax(w > 0.5)] == pytest.approx(half, abs=0.01)
    rising = (w > 0.02) & (w < 0.98) & (t < 60.0)
    odds = np.log(w[rising] / (1.0 - w[rising]))
    assert odds == pytest.approx(rate * (t[rising] - half), abs=0.01)
    falling = (w > 0.02) & (w < 0.98) & (t > 60.0)
    # as late as there were few gaps when the gas went
    odds, full = np.log(w[falling] / (1.0 - w[falling])), rate * (60.0 - half)
    assert odds == pytest.approx(full - level / 1.5 * (t[falling] - 60.0), abs=0.02)
    assert t[falling][0] > 75.0
    # at rest bonds and gaps balance: nearly none below the level, nearly all above
    long = np.linspace(0.0, 4000.0, 40_001)
    for held, least, most in ((0.2, 0.0, 0.05), (0.25, 0.5, 0.5), (0.3, 0.95, 1.0)):
        w = float(chained(long, np.full(len(long), held), level, 1e-2, 1.5)[-1])
        still = (held - level) * w * (1.0 - w) + 1e-2 * (held * (1.0 - w) - level * w)
        assert abs(still) < 1e-7 and least - 1e-6 <= w <= most + 1e-6

    strength, drawn, weak = 0.3, [], 0
    for seed in (11, 12, 13, 14, 15):
        rig = draw_case(seed, size="small")
        # one experiment that may stay below the level
        little = replace(rig.steps[0], test_gas_flow=0.04 * rig.steps[0].total_flow)
        rig = replace(rig, steps=(little, *rig.steps[1:]))
        rig = replace(rig, strengths={"cooperative_chains": strength})
        knobs, seen = prepared_rig(rig)["1"], clean_signals(rig)
        drawn.append((knobs.chains_level, knobs.chains_time, knobs.chains_seeds))
        for k, step in enumerate(rig.steps):
            relative = rig.relative_concentration(step)

            def chains(u: float, x: FloatArray, step=step, rig=rig, knobs=knobs, r=relative):
                gas = [(u - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
                had, g, w = knobs.chains_level, r * x[1], x[3]
                ends = w * (1.0 - w)
                grown = g * (ends + knobs.chains_seeds * (1.0 - w))
                freed = had * (ends + knobs.chains_seeds * w)
                return [*gas, (x[1] - x[2]) / rig.tau, (grown - freed) / knobs.chains_time]

            _, states = solved(rig, chains, 4, k=k)
            x = states[:, 2] + strength / relative * states[:, 3]
            assert np.abs((seen[step.name] - step.y0) / step.beta - x).max() < 1e-3
            if relative < 0.8 * knobs.chains_level:
                weak += 1
                assert states[:, 3].max() < 0.15
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [0.099, 0.099, 0.99e-3]) and np.all(high < [0.351, 1.01, 0.0301])
    assert np.all(high > 1.2 * low) and weak >= 1


def test_gas_that_lies_in_layers_leaves_evenly_and_the_longer_the_more_there_was() -> None:
    strength, times = 0.3, []
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"stacked_layers": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        time = prepared_rig(rig)["1"].stacked_time
        times.append(time)
        for step in rig.steps:
            t, relative = sample_times(step), rig.relative_concentration(step)
            x, y = (np.asarray(v[step.name] - step.y0) / step.beta for v in (plain, seen))
            rising = t < step.tf
            assert np.abs(y - x)[rising].max() < 1e-6
            # sample by sample: up with the gas, down by no more than the topmost layer
            z = np.empty(len(t))
            z[0] = x[0]
            for i in range(1, len(t)):
                z[i] = max(z[i - 1] - step.interval / (relative * time), x[i])
            assert np.abs(y - (1.0 - strength) * x - strength * z).max() < 2e-3 * strength
            # where the rest has gone it is a straight line, which ends by itself at none
            alone = (t > step.tf) & (x < 1e-4) & (y > 0.1 * strength)
            if np.count_nonzero(alone) > 20:
                slope = np.polyfit(t[alone], y[alone], 1)[0]
                assert slope == pytest.approx(-strength / (relative * time), rel=0.02)
                ends = t[(t > step.tf) & (y < 1e-4)]
                if len(ends):
                    assert relative * time < ends[0] - step.tf < relative * time + 3.0 * rig.tau_v
    assert 1.99 < min(times) < 5.0 < max(times) < 15.01


def test_solvent_is_washed_out_with_the_dose_and_the_first_experiment_misses_it_most() -> None:
    strength, drawn = 0.5, []
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"unwashed_pores": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        missing, doses, had = [], [], 0.0
        for step in rig.steps:
            relative = rig.relative_concentration(step)
            x, y = (np.asarray(v[step.name] - step.y0) / step.beta for v in (plain, seen))
            dose = had + relative * np.cumsum(x) * step.interval
            shows = x > 0.5
            missing.append(1.0 - y[shows] / x[shows])
            doses.append(dose[shows])
            # all that came in has left again: the cascade keeps a pulse's area
            had += relative * (step.tf - step.t0)
            assert dose[-1] == pytest.approx(had, rel=2e-3)
        left, dose = np.concatenate(missing), np.concatenate(doses)
        slope, first = np.polyfit(dose, np.log(left), 1)
        # one exponential of the dose over all experiments and rests
        assert np.exp(first) == pytest.approx(strength, rel=5e-3)
        assert np.abs(np.log(left) - first - slope * dose).max() < 0.02
        assert all(b[0] < a[0] for a, b in pairwise(missing))
        drawn.append(-1.0 / slope / (had / len(rig.steps)))
    assert 0.19 < min(drawn) < 0.6 < max(drawn) < 1.21


def test_a_reagent_glimmers_until_it_is_spent_and_creeps_in_again_against_an_ode_solver() -> None:
    strength, drawn = 0.3, []
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"glimmering_reagent": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        size, expected = strength * np.mean([step.beta for step in rig.steps]), 1.0
        for k, step in enumerate(rig.steps):
            knobs = prepared_rig(rig)[step.name]
            uses, creeps, left = knobs.glimmer_uses, knobs.glimmer_creeps, knobs.glimmer_left
            drawn.append((uses, creeps))
            relative = rig.relative_concentration(step)
            # the first record has all of it, the next ones what the one before has left
            assert left == pytest.approx(expected, abs=0.02)

            def spent(
                u: float, x: FloatArray, step: Step = step, rig: Case = rig, relative=relative,
                uses=uses, creeps=creeps,
            ) -> list[float]:  # fmt: skip
                gas = step.total_flow / rig.V * (x[0] - x[1])
                reagent = (1.0 - x[3]) / creeps - relative * x[2] * x[3] / uses
                return [(u - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau, reagent]

            _, states = solved(rig, spent, 4, k=k, begin=[0.0, 0.0, 0.0, left])
            light = seen[step.name] - plain[step.name]
            assert np.abs(light - size * relative * states[:, 2] * states[:, 3]).max() < 1e-4 * size
            expected = float(states[-1, 3])
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [0.99, 4.99]) and np.all(high < [8.01, 80.1]) and np.all(high > 1.5 * low)


def test_domains_rest_at_the_same_defects_but_leave_them_elsewhere_on_their_way_back() -> None:
    strength, gaps = 0.5, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"avalanching_crystal": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        rests: list[FloatArray] = []
        for step in rig.steps:
            relative = rig.relative_concentration(step)
            x, y = (relative * (v[step.name] - step.y0) / step.beta for v in (plain, seen))
            place = (y - (1.0 - strength) * x) / strength
            t = sample_times(step)
            assert np.all(np.abs(place)[t < step.t0] < 1e-9)
            # it stands, and where it does not it goes by whole avalanches, never back on its way
            moves = np.diff(place)
            leaps = np.abs(moves) > 1e-9
            assert np.count_nonzero(leaps) < 100 and np.any(leaps)
            up, down = np.flatnonzero(moves > 1e-9), np.flatnonzero(moves < -1e-9)
            assert np.all(t[up] < step.tf) and np.all(t[down] >= step.tf)
            # a defect lets go upwards when the next higher one is reached, downwards likewise
            assert np.all(place[up + 1] <= x[up + 1] - 0.01 + 1e-9)
            assert np.all(x[up] - 0.01 < place[up + 1] + 1e-9)
            assert np.all(place[down + 1] >= x[down + 1] - 0.01 - 1e-9)
            assert np.all(
                place[t > step.tf + 10.0 * rig.tau_v][-1:] == pytest.approx(0.0, abs=1e-9)
            )
            rests.append(np.unique(np.round(place, 7)))
        # the same places for all: those of lower plateaus are a part of the others'
        most = max(rests, key=lambda found: float(found[-1]))
        for found in rests:
            assert np.all(np.abs(found[:, None] - most).min(axis=1) < 1e-6)
        gaps += np.diff(prepared_rig(rig)["1"].pinned_at).tolist()
    assert 0.05 < np.mean(gaps) < 0.26 and np.std(gaps) == pytest.approx(np.mean(gaps), rel=0.4)
    # one place after the other, of which a slow enough way shows each
    x = np.concatenate([np.linspace(0.0, 1.0, 101), np.linspace(1.0, 0.0, 101)])
    at = np.array([0.005, 0.3, 0.45, 0.8, 5.0])
    out = pinned(x, at)
    way = [out[0], *(b for a, b in pairwise(out.tolist()) if a != b)]
    assert way == [0.005, 0.3, 0.45, 0.8, 0.45, 0.3, 0.005]
    assert out[30] == 0.3 and out[29] == 0.005 and out[101 + 54] == 0.8 and out[101 + 56] == 0.45


def test_a_crystal_waits_for_its_nucleus_and_grows_and_melts_evenly() -> None:
    strength, drawn, never, waits = 0.3, [], 0, []
    for seed in range(11, 19):
        rig = replace(draw_case(seed, size="small"), strengths={"late_nucleus": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        plain = clean_signals(without_causes(rig))
        level, time = found["1"].crystal_level, found["1"].crystal_time
        drawn.append((level, time))
        for step in rig.steps:
            t, relative = sample_times(step), rig.relative_concentration(step)
            wait = found[step.name].crystal_wait
            waits.append(wait)
            added = (seen[step.name] - plain[step.name]) / step.beta / strength * relative
            # the gas above the ring is ahead of the response by the sensor's own lag
            x = (plain[step.name] - step.y0) / step.beta
            gas = x + rig.tau * np.gradient(x, t)
            drive = relative * gas - level
            excess = np.cumsum(np.maximum(drive, 0.0)) * step.interval
            begun = np.searchsorted(excess, wait)
            if begun == len(t):
                assert np.abs(added).max() < 1e-5
                never += 1
                continue
            assert t[begun] > step.t0 and np.abs(added[: begun - 3]).max() < 1e-5
            # up by the excess over what it had to wait for, to all of it, and then down again
            grown = np.zeros(len(t))
            for i in range(begun, len(t)):
                grown[i] = np.clip(grown[i - 1] + drive[i] * step.interval / time, 0.0, 1.0)
            assert np.abs(added - grown).max() < 0.02
            middle = (t > t[begun] + 0.1) & (t < step.tf - 0.1) & (added < 0.98)
            if np.count_nonzero(middle) > 20 and drive[middle].min() > 0.98 * drive[middle].max():
                slope = np.polyfit(t[middle], added[middle], 1)[0]
                assert slope == pytest.approx((relative - level) / time, rel=0.05)
        # the one with the most gas is sure to have it
        top = max(rig.steps, key=lambda step: step.concentration)
        assert np.max(seen[top.name] - plain[top.name]) > 0.1 * strength * top.beta
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [0.149, 0.79]) and np.all(high < [0.451, 6.01]) and np.all(high > 1.3 * low)
    assert never >= 3 and np.std(waits) > 0.4 * np.mean(waits)


def test_starved_grains_against_an_ode_solver() -> None:
    strength, drawn = 0.4, []
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"starved_grains": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        weakest = min(step.total_flow for step in rig.steps)
        K, time = found["1"].starved_bend, found["1"].starved_time
        drawn.append((K, time))
        for k, step in enumerate(rig.steps):
            relative = rig.relative_concentration(step)
            own = time * np.sqrt(weakest / step.total_flow)

            def through_film(
                u: float, x: FloatArray, step: Step = step, rig: Case = rig, K: float = K,
                own: float = own, relative: float = relative,
            ) -> list[float]:  # fmt: skip
                # the load that c would give is (1 + K) c/(1 + K c)
                c = x[3] / (1.0 + K - K * x[3])
                gas = [step.total_flow / rig.V * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]
                return [(u - x[0]) / rig.tau_v, *gas, (relative * x[1] - c) / own]

            t, states = solved(rig, through_film, 4, k=k)
            full = relative * (1.0 + K) / (1.0 + K * relative)
            felt = (1.0 - strength) * states[:, 2] + strength * states[:, 3] / full
            x = (seen[step.name] - step.y0) / step.beta
            assert np.abs(x - felt).max() < 3e-4
            # half of the load takes less time to come than to go
            load = states[:, 3]
            half = 0.5 * load[t < step.tf].max()
            up = t[np.argmax(load > half)] - step.t0
            later = (t > step.tf) & (load < half)
            if later.any():
                assert t[later][0] - step.tf > 1.1 * up
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [1.99, 0.79]) and np.all(high < [12.1, 5.01]) and np.all(high > 1.3 * low)
