"""Causes of ring, fibre and laser against closed forms and their own promises."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import hilbert, lfilter, welch
from scipy.special import erfc

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality import clean_signals, draw_case, sample_times, without_causes
from bayes_sensor.reality.knobs import Knobs
from bayes_sensor.reality.rig import centre_of_mass, dip, voltage
from bayes_sensor.reality.simulator import prepared_rig
from bayes_sensor.reality.stages.lags import decades, modal, slab
from bayes_sensor.reality.stages.readout import blind, shone_back
from bayes_sensor.reality.stages.sensor import splitting
from tests.reality_cases import assert_added_between_marks, case, offsets, solved


def test_the_drivers_warmth_is_two_lags_of_the_command() -> None:
    rig = case(warm_driver=0.08)
    size = 0.08 * np.mean([step.beta for step in rig.steps])
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    peaks = []
    for k, step in enumerate(rig.steps):
        t = sample_times(step)
        drift = seen[step.name] - plain[step.name]
        (course,) = prepared_rig(rig)[step.name].offset
        # once the driver is off it falls in two exponentials: any three samples obey one recursion
        y = course(step.commanded_off + np.arange(60.0))
        (a, b), *_ = np.linalg.lstsq(np.column_stack([y[1:-1], y[:-2]]), y[2:], rcond=None)
        driver, bench = np.sort(-1.0 / np.log(np.roots([1.0, -a, -b]).real))[::-1]
        assert 4.0 < driver < 20.0 and 0.5 < bench < 3.0

        def warming(u: float, x: FloatArray, driver=driver, bench=bench) -> list[float]:
            return [(u - x[0]) / driver, (x[0] - x[1]) / bench]

        inputs = [(0.0, 0.0), (step.commanded_on, 1.0), (step.commanded_off, 0.0)]
        _, states = solved(rig, warming, 2, k, inputs)
        scale = drift[np.abs(drift).argmax()] / states[:, 1].max()
        assert np.abs(drift - scale * states[:, 1]).max() < 2e-4 * size
        off = np.searchsorted(t, step.commanded_off)
        assert np.abs(drift).argmax() > off  # the heat is on its way when the driver is
        peaks.append(abs(drift[off]))
    assert max(peaks) == pytest.approx(size, rel=1e-3)


def test_the_fibre_creeps_back_from_every_click() -> None:
    strength = 0.1
    rig = case(jolted_fibre=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    laws = []
    for step in rig.steps:
        t = sample_times(step)
        left = seen[step.name] / plain[step.name] - 1.0
        assert np.abs(left[t < step.commanded_on - step.interval]).max() < 1e-12
        (course,) = prepared_rig(rig)[step.name].gain
        assert np.allclose(left, course(t), atol=1e-9)
        at = np.array([step.commanded_on, step.commanded_off])
        jumps = course(at - 1e-9) - course(at)
        # size/(1 + t/time)^power: its root is a straight line; time and power from three samples
        since = np.array([0.0, 1.0, 3.0])
        logs = np.log(course(at[0] + since) / course(at[:1]))
        powers = np.linspace(0.3, 2.0, 170_001)
        lines = [np.exp(-log / powers) - 1.0 for log in logs[1:]]
        power = powers[np.abs(lines[1] - 3.0 * lines[0]).argmin()]
        laws.append([*jumps, power, 1.0 / np.interp(power, powers, lines[0])])
        later = step.commanded_on + np.linspace(0.0, 5.0, 50)
        expected = -jumps[0] * (1.0 + (later - at[0]) / laws[-1][3]) ** -power
        assert np.allclose(course(later), expected, rtol=1e-3)
    on, off, power, time_ = np.mean(laws, axis=0)
    assert np.ptp(np.array(laws)[:, :2], axis=0).max() < 1e-6  # every click alike
    assert max(on, off) == pytest.approx(strength, abs=1e-6) and 0.5 <= min(on, off) / strength
    assert 0.5 <= power <= 1.5 and 0.2 <= time_ <= 3.0


def test_the_second_modes_line_is_crossed_at_one_concentration() -> None:
    strength = 0.15
    rig = case(second_mode=strength)
    size = strength * np.mean([step.beta for step in rig.steps])
    seen, places, widths, reached = clean_signals(rig), [], [], 0
    for step in rig.steps:
        t = sample_times(step)
        plain, x = voltage(rig, step, Knobs(), t)
        c, lost = rig.relative_concentration(step) * x, plain - seen[step.name]
        # one over what is lost is a parabola in the concentration, but for what was lost at rest
        knobs = prepared_rig(rig)[step.name]
        rest = size / (1.0 + (knobs.mode_at / knobs.mode_width) ** 2)
        inside = lost + rest > 0.2 * size
        if c.max() < knobs.mode_at - 3.0 * knobs.mode_width:  # too weak to come so far
            assert np.abs(lost).max() < 0.1 * size
        if inside.sum() < 20:
            continue
        a, b, d = np.polyfit(c[inside], size / (lost + rest)[inside], 2)
        places.append(-0.5 * b / a)
        widths.append(a**-0.5)
        assert d - 0.25 * b**2 / a == pytest.approx(1.0, abs=1e-4)  # all of it on the line
        reached += bool(inside[t < step.tf].any() and inside[t > step.tf].any())
        assert seen[step.name][0] == pytest.approx(step.y0)
    assert reached >= 1
    assert np.ptp(places) < 1e-4 and 0.15 < places[0] < 0.6
    assert np.ptp(widths) < 1e-4 and 0.03 < widths[0] < 0.12


def test_gas_breaks_through_the_reference_rings_cap() -> None:
    times, weights = slab(20.0)
    assert weights.sum() == pytest.approx(1.0)
    assert weights @ times == pytest.approx(10.0, rel=5e-3)  # mean delay of half the time
    t = np.concatenate([[-1e-6], np.linspace(0.0, 60.0, 6001)])
    x = modal(t, (t >= 0).astype(float), times, weights)
    z = np.sqrt(np.maximum(t, 1e-9) / 20.0)
    images = sum(2.0 * (-1.0) ** k * erfc((2 * k + 1) / (2.0 * z)) for k in range(6))
    # short-time series of the same problem, by images; few modes see the very first moment poorly
    assert np.abs(x - images)[t > 0.3].max() < 5e-3

    strength = 0.3
    rig = case(leaking_reference=strength)
    for step in rig.steps:
        t = sample_times(step)
        x, plain = (
            voltage(rig, step, some, t)[1] for some in (prepared_rig(rig)[step.name], Knobs())
        )
        time_ = prepared_rig(rig)[step.name].reference_time
        assert 8.0 < time_ < 80.0
        gone = (plain - x) / strength
        # before a twentieth of the time nothing has come through; later the sum of both steps
        assert np.abs(gone[t < step.t0 + 0.02 * time_]).max() < 5e-3
        delay = rig.tau_v + rig.V / step.total_flow + rig.tau

        def through(since: FloatArray, time_: float = time_) -> FloatArray:
            z = np.sqrt(np.maximum(since, 1e-9) / time_)
            terms = [2.0 * (-1.0) ** k * erfc((2 * k + 1) / (2.0 * z)) for k in range(8)]
            return np.where(since > 0.0, np.sum(terms, axis=0), 0.0)

        both = through(t - step.t0 - delay) - through(t - step.tf - delay)
        assert np.abs(gone - both).max() < 0.05
        assert gone[-1] > 0.05 and x[-1] < 0.0


def test_the_ring_pulses_within_a_range_of_concentrations() -> None:
    strength = 0.1
    rig = case(pulsing_ring=strength)
    found, seen = prepared_rig(rig), clean_signals(rig)
    size, begins = strength * np.mean([step.beta for step in rig.steps]), set()
    for step in rig.steps:
        knobs, t = found[step.name], sample_times(step)
        begins.add(knobs.pulsing_begin)
        assert knobs.pulsing == pytest.approx(size)
        plain, x = voltage(rig, step, Knobs(), t)
        pulse = seen[step.name] - plain
        away = (rig.relative_concentration(step) * x - knobs.pulsing_at) / knobs.pulsing_width
        inside = np.abs(away) < 1.0
        assert np.abs(pulse[~inside]).max() < 1e-6
        # a circle: the amplitude squared and the distance from the middle squared make 1
        most = size * np.sqrt(1.0 - away[inside] ** 2) * (1.0 + knobs.pulsing_second)
        assert np.all(np.abs(pulse[inside]) <= most + 1e-9)
    assert len(begins) == len(rig.steps)
    assert 0.35 < knobs.pulsing_at < 0.75 and 0.12 < knobs.pulsing_width < 0.3

    # held at a concentration it is a sine of the pulled frequency
    step = max(rig.steps, key=lambda each: each.concentration)
    still = Knobs(pulsing=0.1, pulsing_at=0.9, pulsing_width=0.2, pulsing_rate=3.0,
                  pulsing_pull=0.4, pulsing_begin=0.3)  # fmt: skip
    t = np.arange(step.tf - 4.0, step.tf, 1e-3)
    pulse = (voltage(rig, step, still, t)[0] - voltage(rig, step, Knobs(), t)[0]) / 0.1
    assert pulse.max() == pytest.approx(np.sqrt(0.75), abs=2e-3)
    ups = t[1:][(pulse[1:] > 0.0) & (pulse[:-1] <= 0.0)]
    assert np.diff(ups) == pytest.approx(1.0 / (3.0 * 1.2), abs=2e-3)
    # both harmonics: the mean square is half of 1 + share^2 of the first's
    both = replace(still, pulsing_second=0.4)
    pulse = (voltage(rig, step, both, t)[0] - voltage(rig, step, Knobs(), t)[0]) / 0.1
    turns = (t >= ups[0]) & (t < ups[-1])
    assert np.mean(pulse[turns] ** 2) == pytest.approx(0.5 * 0.75 * 1.16, rel=0.01)


def test_the_lift_passes_as_a_dipole() -> None:
    strength, asides = 0.1, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"passing_lift": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        for step in rig.steps:
            courses = prepared_rig(rig)[step.name].gain
            if not courses:
                assert np.array_equal(seen[step.name], plain[step.name])
                continue
            t = np.linspace(0.0, 4.0 * step.duration, 200_001)
            gain = courses[0](t)
            assert gain[0] == 0.0 and np.all(gain[t < 0.05 * step.duration] == 0.0)
            assert gain.max() <= strength and gain.min() >= -strength
            assert np.abs(np.diff(gain)).max() < 2e-3  # it starts and stops softly
            # the least light when it is right here, and at rest that of floors 3.5 m apart
            rest = gain[1:][np.diff(gain) == 0.0]
            first = 1.0 + gain.min() / strength  # the field where it stood, of that here
            possible = set()
            for floor in (1, 2, 3):
                aside = 3.5 * floor / np.sqrt(first ** (-2.0 / 3.0) - 1.0)
                fields = (1.0 + (3.5 * np.arange(4) / aside) ** 2) ** -1.5
                away = np.abs((first - rest / strength)[:, None] - fields)
                if 2.0 <= aside <= 6.0 and away.min(axis=1).max() < 1e-4:
                    possible.add(round(float(aside), 2))
            asides.append((seed, possible))
            s = sample_times(step)
            moved = seen[step.name] / plain[step.name] - 1.0
            assert np.abs(moved - courses[0](s)).max() < 1e-9
    assert len(asides) >= 6
    for seed in (11, 12, 13, 14):  # of all records of a rig one
        assert set.intersection(*(some for name, some in asides if name == seed))


def test_the_table_is_levelled_evenly_and_tilts_back() -> None:
    strength, rates = 0.1, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"leaning_visitor": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        for step in rig.steps:
            courses, marks = prepared_rig(rig)[step.name].gain, prepared_rig(rig)[step.name].marks
            if not courses:
                assert np.array_equal(seen[step.name], plain[step.name])
                continue
            t = np.linspace(0.0, 100.0, 400_001)
            gain = 1.0 + courses[0](t)
            assert gain[0] == 1.0 and gain[-1] == 1.0 and gain.min() >= 1.0 - strength - 1e-12
            tilt = np.sqrt(np.log(gain) / np.log(1.0 - strength))
            slope = np.diff(tilt) / (t[1] - t[0])
            jumps = np.flatnonzero(np.abs(np.diff(tilt)) > 0.05)
            assert len(jumps) in (2, 4)
            # between, never anything but rest and one rate
            steady = slope[slope < -1e-6]
            steady = steady[steady > -1.1]
            rates.append((seed, -1.0 / float(np.median(steady))))
            moves = np.delete(slope, jumps)
            at_rest, even = np.abs(moves) < 1e-6, np.abs(moves * rates[-1][1] + 1.0) < 1e-4
            assert np.sum(~(at_rest | even)) <= 2 * len(jumps)  # where it comes to rest
            first, back = jumps[0], jumps[1]
            weight = tilt[first + 1]
            assert 0.5 <= weight <= 1.0
            # letting go is a push of the same weight the other way
            assert tilt[back + 1] == pytest.approx(weight - tilt[back], abs=1e-3)
            edges = np.array([at for at in t[jumps + 1] if at < step.duration])
            assert np.allclose(np.asarray(marks)[1::2], edges, atol=1e-3)
            s = sample_times(step)
            away = np.min(np.abs(s[:, None] - edges), axis=1) > 1e-5 if len(edges) else s >= 0.0
            shown = seen[step.name] / plain[step.name] - 1.0
            assert np.abs(shown - courses[0](s))[away].max() < 1e-6
    assert len({seed for seed, _ in rates}) == 4
    for seed in (11, 12, 13, 14):
        own = [rate for name, rate in rates if name == seed]
        assert np.ptp(own) < 1e-3 * own[0] and 1.0 < own[0] < 8.0


def test_an_undecided_laser_hesitates_near_its_border_only() -> None:
    strength = 0.1
    rig = case(undecided_laser=strength)
    found, seen = prepared_rig(rig), clean_signals(rig)
    size = strength * np.mean([step.beta for step in rig.steps])
    borders = np.concatenate([knobs.borders for knobs in found.values()])
    for step in rig.steps:
        knobs, t = found[step.name], sample_times(step)
        gap = knobs.border_gap
        assert abs(gap) == pytest.approx(size)
        plain, x = voltage(rig, step, Knobs(), t)
        more = (seen[step.name] - plain) / gap
        upper = more > 0.5
        assert np.abs(more - upper).max() < 1e-9
        at = rig.relative_concentration(step) * x
        assert not upper[at < borders.min()].any() and upper[at > borders.max()].all()
        # between two decisions the mode depends on the response alone
        for low, high in pairwise(knobs.decisions):
            inside = (t >= low) & (t < high)
            if upper[inside].any() and not upper[inside].all():
                assert at[inside][upper[inside]].min() >= at[inside][~upper[inside]].max()
    # how often it is the upper mode, held at the middle and to either side: 1/(1 + exp(-away))
    drawn = prepared_rig(replace(draw_case(7), strengths={"undecided_laser": strength})).values()
    every = np.concatenate([knobs.borders for knobs in drawn])
    apart = np.concatenate([np.diff(knobs.decisions) for knobs in drawn])
    middle, width = np.median(every), every.std() / (np.pi / np.sqrt(3.0))
    assert 0.25 < middle < 0.85 and 0.025 < width < 0.14
    for away in (-2.0, -1.0, 1.0, 2.0):
        share = np.mean(every < middle + away * width)
        assert share == pytest.approx(1.0 / (1.0 + np.exp(-away)), abs=0.06)
    assert 0.08 < apart.mean() < 1.2 and apart.std() == pytest.approx(apart.mean(), rel=0.15)
    held = Knobs(border_gap=0.2, borders=np.array([0.2, 2.0]), decisions=np.array([0.0, 15.0]))
    rig = case()
    step = max(rig.steps, key=lambda each: each.concentration)
    t = np.array([0.5, 14.99, 15.01])
    more = voltage(rig, step, held, t)[0] - voltage(rig, step, Knobs(), t)[0]
    assert step.t0 < 12.0 and step.tf > 16.0
    assert more == pytest.approx([0.0, 0.2, 0.0], abs=1e-9)


def test_a_piezo_creeps_as_the_logarithm_of_time() -> None:
    times, weights = decades(0.1)
    assert times[0] == pytest.approx(0.1) and times[-1] == pytest.approx(1000.0)
    s = np.array([0.5, 5.0, 50.0])
    crept = [float(weights @ -np.expm1(-since / times)) for since in s]
    assert np.diff(crept) == pytest.approx([1.0, 1.0], abs=0.03)

    strength = 0.06
    rig = case(creeping_piezo=strength)
    seen = clean_signals(rig)
    ((first,),) = {(knobs.creep_first,) for knobs in prepared_rig(rig).values()}
    assert 0.05 < first < 0.5
    for step in rig.steps:
        t = sample_times(step)
        plain = voltage(rig, step, Knobs(), t)[0]
        missing = (plain - seen[step.name]) / step.beta
        assert np.abs(missing[t < step.t0]).max() < 1e-9
        assert missing.min() > -1e-9
        # a superposition of what each small rise has let creep since: a sum over the past
        expected, h = np.zeros(len(t)), step.interval
        moves = np.diff((plain - step.y0) / step.beta, prepend=0.0)
        for k in range(13):
            tau = first * 10.0 ** (k / 3.0)
            expected += lfilter([1.0], [1.0], np.cumsum(moves)) / 3.0
            expected -= lfilter([1.0], [1.0, -np.exp(-h / tau)], moves) / 3.0
        assert np.abs(missing - strength * expected).max() < 2e-3
        # on the plateau and on the way back it still goes on, by some of a decade
        late = (t > 0.5 * (step.t0 + step.tf)) & (t < step.tf)
        assert np.all(np.diff(missing[late]) > 0.0)
        assert missing[-1] > 0.01


def test_the_warmth_of_a_hand_diffuses_to_the_ring() -> None:
    strength, depths = 0.1, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"touching_hand": strength})
        size, touched = strength * np.mean([step.beta for step in rig.steps]), 0
        for step, course in offsets(rig, atol=1e-7):
            marks = prepared_rig(rig)[step.name].marks
            touched += 1
            on = marks[0]
            off = marks[1] if len(marks) > 1 else step.duration
            t = np.linspace(on, min(off, step.duration), 2001)
            warm = np.abs(course(t)) / size
            assert warm[0] < 1e-12 and warm.max() < 1.0 and np.all(np.diff(warm) >= -1e-12)
            assert np.all(course(np.linspace(0.0, on, 50)) == 0.0)
            # erfc(sqrt(a/t)): the ratio at two times has but one root in a
            a = np.geomspace(0.05, 4.0, 4001)
            ratio = erfc(np.sqrt(a / (0.4 * (t[-1] - on)))) / erfc(np.sqrt(a / (t[-1] - on)))
            depth = float(
                np.interp(-np.interp(0.4, np.linspace(0, 1, 2001), warm) / warm[-1], -ratio, a)
            )
            depths.append((seed, depth))
            own = warm[-1] / erfc(np.sqrt(depth / (t[-1] - on)))
            assert 0.5 - 1e-3 < own < 1.0 + 1e-3
            assert np.abs(warm[1:] - own * erfc(np.sqrt(depth / (t[1:] - on)))).max() < 1e-4
            # long after, what is left falls as time^-3/2
            late = np.abs(course(np.array([4e4, 1.6e5])))
            assert late[0] / late[1] == pytest.approx(8.0, rel=0.01)
        assert touched >= 1
    for seed in (11, 12, 13, 14):
        each = [depth for name, depth in depths if name == seed]
        assert np.ptp(each) < 5e-3 * each[0] and 0.1 < each[0] < 2.0


def test_footsteps_come_near_and_go_away() -> None:
    strength, once, closest = 0.2, 0, 0.0
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"passing_footsteps": strength})
        size = strength * np.mean([step.beta for step in rig.steps])
        assert any(knobs.offset for knobs in prepared_rig(rig).values())
        for step, course in offsets(rig, atol=1e-9):
            t = np.arange(-60.0, step.duration + 60.0, 5e-4)
            y = course(t) / size
            # each foot sets off e^(-t/T) sin(wt), where two samples tell the next one
            live = np.abs(y) > 1e-4
            rows = np.flatnonzero(live[2:] & live[1:-1] & live[:-2])
            design = np.column_stack([y[rows + 1], -y[rows]])
            half = np.abs(y[rows + 2] - design @ np.linalg.lstsq(design, y[rows + 2])[0])
            rows = rows[half < np.quantile(half, 0.9)]
            design = np.column_stack([y[rows + 1], -y[rows]])
            a, b = np.linalg.lstsq(design, y[rows + 2])[0]
            struck = np.abs(np.convolve(y, [1.0, -a, b])[: len(y)])
            damping = -5e-4 / (0.5 * np.log(b))
            frequency = np.arccos(a / (2.0 * np.sqrt(b))) / (2.0 * np.pi * 5e-4)
            assert 0.04 < damping < 0.2 and 6.0 < frequency < 25.0
            hits = struck / np.sin(2.0 * np.pi * frequency * 5e-4)
            feet = t[hits > 3e-4 * hits.max()]
            feet = feet[np.diff(feet, prepend=-1e3) > 2e-3]
            assert 20 <= len(feet) <= 82
            # walked once: one foot after the other, nearly evenly
            if len(feet) <= 41:
                once += 1
                assert 1.0 / 2.3 / 1.1 < np.median(np.diff(feet)) < 1.1 / 1.5
                assert np.ptp(np.diff(feet)) < 0.2 * np.median(np.diff(feet))
            ends = np.abs(y[(t < feet[0] + 1.0) | (t > feet[-1] - 1.0)]).max()
            assert ends < 0.25 * np.abs(y).max()
            closest = max(closest, np.abs(y).max())
    assert once >= 2 and 0.3 < closest < 2.0


def test_a_line_on_dead_pixels_is_found_where_it_was() -> None:
    y = np.array([0.0, 0.2, 0.35, 0.45, 0.55, 0.9, 0.52, 0.41, 0.45, 0.3, 0.5, 0.1])
    shown = blind(y, 0.4, 0.2)
    assert shown == pytest.approx([0.0, 0.2, 0.35, 0.35, 0.35, 0.9, 0.9, 0.9, 0.9, 0.3, 0.3, 0.1])

    strength, crossed = 0.2, 0
    rig = case(dead_pixels=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    for step in rig.steps:
        at = prepared_rig(rig)[step.name].dead_from
        assert 0.1 <= at <= 0.6
        t, relative = sample_times(step), rig.relative_concentration(step)
        place, shown = (
            relative * (some[step.name] - step.y0) / step.beta for some in (plain, seen)
        )
        within = (place > at + 1e-6) & (place < at + strength - 1e-6)
        outside = (place < at - 1e-6) | (place > at + strength + 1e-6)
        assert np.allclose(shown[outside], place[outside], atol=1e-9)
        up, down = within & (t < step.tf), within & (t > step.tf)
        assert up.sum() > 1 and np.allclose(shown[up], at, atol=5e-3)
        if place.max() > at + strength:
            crossed += 1
            assert np.allclose(shown[down], at + strength, atol=5e-3)
    assert crossed >= 1


def test_a_tube_lamp_flashes_until_it_burns_and_then_grows_brighter() -> None:
    strength, lit, counts = 0.1, 0, set()
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"flickering_tube_lamp": strength})
        size = strength * np.mean([step.beta for step in rig.steps])
        for _, course in offsets(rig, atol=5e-6):
            lit += 1
            t = np.arange(0.0, 400.0, 5e-4)
            light = course(t) / size
            edges = np.flatnonzero(np.diff((light > 0.0).astype(int)))
            assert light[0] == 0.0 and len(edges) % 2 == 1  # on for good in the end
            lengths, gaps = np.diff(t[edges])[::2], np.diff(t[edges][::2])
            counts.add(len(lengths))
            assert 2 <= len(lengths) <= 7
            assert np.all((lengths > 0.049) & (lengths < 0.251))
            assert np.all((gaps > 0.39) & (gaps < 1.31))
            # of its hundred or so swings a second, whole tenths of a second know nothing
            burns = light[edges[-1] + 1 :]
            mean = burns[: len(burns) // 200 * 200].reshape(-1, 200).mean(axis=1)
            swing = burns[-20_000:] / mean[-1] - 1.0
            assert 0.15 < swing.max() < 0.4 and swing.min() == pytest.approx(-swing.max(), rel=0.05)
            f, power = welch(swing, 2000.0, nperseg=20_000)
            assert f[power.argmax()] == pytest.approx(100.0, abs=0.2) or f[
                power.argmax()
            ] == pytest.approx(120.0, abs=0.2)
            # from 0.4 to 0.7 of its light to all of it, as one exponential
            assert 0.38 < mean[0] < 0.73 and mean[-1] == pytest.approx(1.0, abs=1e-3)
            left = np.log(1.0 - mean[:50])
            time_ = -0.1 / np.diff(left).mean()
            assert 4.9 < time_ < 30.5 and np.ptp(np.diff(left)) < 1e-3
    assert lit >= 3 and len(counts) > 1


def test_a_centre_of_mass_lags_at_the_edge_of_its_window() -> None:
    for z, window in ((0.0, 4.0), (1.3, 4.0), (-3.5, 5.0)):
        u = np.linspace(-window, window, 400_001)
        line = dip(u - z)
        expected = (u * line).sum() / line.sum()
        assert centre_of_mass(z, window) == pytest.approx(expected, abs=1e-4)

    strength, directions = 0.7, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"fixed_window": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        knobs = prepared_rig(rig)["1"]
        assert 3.0 < knobs.window < 10.0 and abs(knobs.window_begin) < 0.3 * knobs.window
        u = np.linspace(-knobs.window, knobs.window, 20_001)
        for step in rig.steps:
            x = (plain[step.name] - step.y0) / step.beta

            shift = strength * knobs.window * rig.relative_concentration(step)

            def middle(
                x: float, u: FloatArray = u, begin: float = knobs.window_begin, shift: float = shift
            ) -> Any:
                line = dip(u - begin - shift * x)
                return (u * line).sum() / line.sum()

            some = np.arange(0, len(x), 97)
            found = np.array([middle(x[i]) for i in some])
            expected = (found - middle(0.0)) / (middle(1.0) - middle(0.0))
            assert np.abs((seen[step.name][some] - step.y0) / step.beta - expected).max() < 2e-3
            directions.append(float(np.max((seen[step.name] - plain[step.name]) / step.beta)))
    assert max(directions) > 0.02  # ahead of the straight line below the plateau


def test_a_fibre_between_polarisers_turns_its_phase_evenly() -> None:
    strength, turned = 0.2, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"birefringent_fibre": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        plain = clean_signals(without_causes(rig))
        for step in rig.steps:
            (light,) = found[step.name].gain
            y = seen[step.name] / plain[step.name]
            assert y[0] == pytest.approx(1.0, abs=1e-12)
            assert np.allclose(y, 1.0 + light(sample_times(step)), atol=1e-9)
            # crossed axes: 1 + s cos over 1 + s cos at first; beyond its mean it is a sine
            t = np.linspace(0.0, 20.0 * step.duration, 40_001)
            wave = 1.0 + light(t)
            low, high = wave.min(), wave.max()
            assert (high - low) / (high + low) == pytest.approx(strength, rel=1e-3)
            phase = np.unwrap(np.angle(np.exp(1j * np.arccos(
                np.clip((2.0 * wave - high - low) / (high - low), -1.0, 1.0)
            ))))  # fmt: skip
            ways = np.abs(np.diff(phase))
            turned.append(np.median(ways) * 2000.0 / (2.0 * np.pi))
            assert np.mean(np.abs(ways - np.median(ways)) < 0.02 * np.median(ways)) > 0.9
    assert 0.29 < min(turned) and max(turned) < 3.1 and max(turned) > 2.0 * min(turned)


def test_a_beam_is_bent_while_fresh_gas_lies_beside_old() -> None:
    strength = 0.4
    rig = case(bent_beam=strength)
    seen, darkest = clean_signals(rig), []
    for k, step in enumerate(rig.steps):
        exchange = step.total_flow / rig.V

        def cascade(u: float, x: FloatArray, exchange: float = exchange) -> list[float]:
            return [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]

        t, states = solved(rig, cascade, 3, k=k)
        differs = rig.relative_concentration(step) * (states[:, 0] - states[:, 1])
        light = np.exp(np.log(1.0 - strength) * differs**2)  # a Gaussian in the way it goes off
        y = (step.y0 + step.beta * states[:, 2]) * light
        assert np.abs(seen[step.name] - y).max() < 1e-4 * step.beta
        darkest.append(light.min())
        # less light both ways, and all of it where the gas is mixed
        mixed = (t < step.t0) | ((t > step.tf - 0.5) & (t < step.tf))
        assert light[mixed].min() > 0.999
    # the more of it, the stronger the gas
    relative = [rig.relative_concentration(step) for step in rig.steps]
    assert np.argmin(darkest) == np.argmax(relative) and min(darkest) < 0.97


def test_a_choppers_openings_go_round_with_its_wheel() -> None:
    strength, wheels = 0.07, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"uneven_chopper": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        plain, turns = clean_signals(without_causes(rig)), []
        for step in rig.steps:
            (light,) = found[step.name].gain
            at = sample_times(step)
            assert np.allclose(seen[step.name], plain[step.name] * (1.0 + light(at)), atol=1e-9)
            t = np.linspace(0.0, 60.0, 600_001)
            w = light(t)
            assert np.abs(w).max() == pytest.approx(strength, rel=1e-2)
            assert abs(w.mean()) < 0.02 * strength
            # the opening that is most off passes once a turn
            sharp = np.flatnonzero(np.abs(w) > 0.98 * np.abs(w).max())
            passes = np.split(t[sharp], np.flatnonzero(np.diff(sharp) > 1) + 1)
            middles = np.array([part.mean() for part in passes[1:-1]])
            each = np.diff(middles)
            turns.append(1.0 / each.mean())
            assert 1e-3 < np.ptp(each) / each.mean() < 0.06  # hardly even
            # turn for turn the same openings
            quarter = middles[:-1, None] + np.outer(each, np.linspace(0.05, 0.95, 19))
            assert np.ptp(light(quarter[3:8]), axis=0).max() < 0.15 * strength
        assert np.ptp(turns) < 0.01 * np.mean(turns)
        wheels.append(np.mean(turns))
    assert 1.9 < min(wheels) and max(wheels) < 12.1 and max(wheels) > 1.3 * min(wheels)


def test_the_two_ways_of_a_sweep_differ_by_a_lens() -> None:
    strength, rates = 0.1, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"two_way_sweep": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        size = strength * np.mean([step.beta for step in rig.steps])
        for step in rig.steps:
            t, off = sample_times(step), seen[step.name] - plain[step.name]
            x = rig.relative_concentration(step) * (plain[step.name] - step.y0) / step.beta
            # a parabola of the line's place, half the size on either side in its middle
            lens = np.polynomial.Polynomial.fit(x, np.abs(off), 2)
            assert np.abs(off) == pytest.approx(lens(x), abs=1e-9)
            curved = lens.convert().coef
            middle = -0.5 * curved[1] / curved[2]
            assert lens(middle) == pytest.approx(0.5 * size, rel=1e-6)
            ends = np.sort(lens.roots())
            reach = 1.0 / (ends[1] - ends[0])  # of the whole sweep's, by the highest concentration
            assert 0.3 < reach < 0.7 and 0.05 < -ends[0] * reach < 0.3
            # by turns, for as long each
            turns = t[1:][np.diff(np.sign(off)) != 0.0]
            assert np.ptp(np.diff(turns)) < 2.1 * step.interval
            rates.append(0.5 / np.diff(turns).mean())
            assert abs(np.mean(np.sign(off))) < 0.02
    assert 2.0 < min(rates) < 0.8 * max(rates) and max(rates) < 15.0


def test_the_whole_lorentzian_is_read() -> None:
    rig = case()
    step = rig.steps[0]
    t = sample_times(step)
    straight, x = voltage(rig, step, Knobs(), t)
    y, _ = voltage(rig, step, Knobs(shift=0.6, detuning=-1.0), t)
    z = -1.0 + 0.6 * rig.relative_concentration(step) * x
    scaled = (1 / (1 + z**2) - 0.5) / (1 / (1 + z.max() ** 2) - 0.5)
    assert dip(-1.0) == 0.5
    # the plateau is reached to exp(-tens of time constants) only
    assert np.abs((y - step.y0) / step.beta - scaled).max() < 1e-5
    assert np.abs(y - straight).max() > 0.02 * step.beta


def test_a_clamp_slips_when_the_strain_is_too_much() -> None:
    strength, ways, lasting = 0.1, set(), []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"slipping_clamp": strength})
        size = strength * np.mean([step.beta for step in rig.steps])
        seen = 0
        for step, strain in offsets(rig, atol=1e-6):
            seen += 1
            t = np.linspace(0.0, step.duration, 300_001)
            pull = strain(t) / size
            change = np.diff(pull)
            rate = np.median(change) / t[1]
            ways.add(np.sign(rate))
            slips = np.flatnonzero(np.abs(change / t[1] - rate) > 1e-6 * abs(rate) + 1e-9)
            # everywhere the same slope, but where it comes back to rest from another strain
            assert np.all(change[slips] * rate < 0.0)
            assert np.abs(pull[slips + 1]).max(initial=0.0) <= abs(rate) * t[1] * 1.001
            strains = np.abs(pull[slips])
            assert np.all((strains > 0.399) & (strains < 1.6))
            assert len(strains) < 3 or np.ptp(strains) > 0.1
            assert np.abs(pull).max() < 1.6
            lasting.append(1.0 / abs(rate))
        assert seen == len(rig.steps)
    assert ways == {-1.0, 1.0}
    assert 1.5 < min(lasting) < 0.5 * max(lasting) < 16.7


def test_gas_in_the_inlet_takes_light_before_it_is_at_the_ring_against_an_ode_solver() -> None:
    strength = 0.2
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"light_across_inlet": strength})
        seen = clean_signals(rig)
        for k, step in enumerate(rig.steps):

            def cascade(
                u: float, x: FloatArray, exchange: float = step.total_flow / rig.V, rig=rig
            ) -> list[float]:
                first = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1])]
                return [*first, (x[1] - x[2]) / rig.tau]

            t, states = solved(rig, cascade, 3, k=k)
            light = (1.0 - strength) ** (rig.relative_concentration(step) * states[:, 0])
            y = seen[step.name]
            assert np.abs(y - light * (step.y0 + step.beta * states[:, 2])).max() < 1e-4
            # it sinks before it rises, and rises before it falls
            assert y[(t > step.t0) & (t < step.t0 + 1.0)].min() < step.y0
            end = y[np.searchsorted(t, step.tf) - 1]
            assert y[(t > step.tf) & (t < step.tf + 0.5)].max() > 1.001 * end
            assert y[-1] == pytest.approx(step.y0, abs=1e-3)


def test_a_stage_searches_when_the_signal_falls_and_finds_back() -> None:
    strength, drops, periods = 0.4, [], []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"searching_stage": strength})
        plain, seen = clean_signals(without_causes(rig)), clean_signals(rig)
        for step in rig.steps:
            (lost,) = prepared_rig(rig)[step.name].gain
            t = sample_times(step)
            expected = plain[step.name] * (1.0 + lost(t))
            assert np.abs(seen[step.name] - expected).max() < 1e-4
            fine = step.tf + np.linspace(0.0, 25.0, 500_001)
            gone = lost(fine)
            assert -strength < gone.min() < -0.3 * strength and gone.max() <= 1e-12
            begin = fine[np.flatnonzero(gone < -1e-9)[0]]
            assert np.all(lost(np.linspace(0.0, begin - 1e-3, 1000)) == 0.0)
            y = np.interp([step.tf, begin], t, plain[step.name])
            drops.append(1.0 - y[1] / y[0])
            # through its best place twice a turn, from one side to the other, always less far
            off = np.sqrt(np.log1p(gone.clip(max=0.0)) / np.log1p(-strength))
            best = np.flatnonzero((off[1:-1] < off[:-2]) & (off[1:-1] <= off[2:])) + 1
            best = best[fine[best] > begin + 0.05]
            half = np.diff([begin, *fine[best]])
            end = fine[np.flatnonzero(off > 1e-6)[-1]]
            turns = round((end - begin) / (2.0 * half[0]))
            periods.append((end - begin) / turns)
            assert 2 <= turns <= 5
            assert half[: 2 * turns - 1] == pytest.approx(0.5 * periods[-1], rel=2e-2)
            far = [off[(fine > a) & (fine < b)].max() for a, b in pairwise(
                [begin, *(begin + 0.5 * periods[-1] * np.arange(1, 2 * turns + 1))]
            )]  # fmt: skip
            assert np.all(np.diff(far) < 0.0) and far[0] < 1.0
            assert np.all(lost(fine[fine > end + 0.1]) == 0.0)
        # always after the same share of the way
        assert np.ptp(drops[-len(rig.steps) :]) < 0.02
    assert 0.04 < min(drops) < max(drops) < 0.32
    assert 0.6 < min(periods) < max(periods) < 3.1


def test_a_chip_bows_as_the_gas_gets_through_its_coating() -> None:
    strength, places, times = 0.3, [], []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"bowing_chip": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        knobs = prepared_rig(rig)["1"]
        places.append(knobs.bow_at)
        times.append(knobs.bow_time)
        for k, step in enumerate(rig.steps):

            def mixed(
                u: float, x: FloatArray, exchange: float = step.total_flow / rig.V, rig=rig
            ) -> list[float]:
                return [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1])]

            t, states = solved(rig, mixed, 2, k=k)
            # reflections at both faces of a slab (Crank), each step of the gas by itself
            late = np.maximum(t + 0.5 * (t[1] - t[0]), 1e-9) / knobs.bow_time
            through = sum(2.0 * (-1.0) ** j * erfc((j + 0.5) / np.sqrt(late)) for j in range(12))
            swollen = np.convolve(np.diff(states[:, 1], prepend=0.0), through)[: len(t)]
            bow = rig.relative_concentration(step) * swollen
            light = (1.0 - strength) ** ((bow - knobs.bow_at) ** 2 - knobs.bow_at**2)
            assert np.abs(seen[step.name] - plain[step.name] * light).max() < 4e-3 * step.beta
            if 0.1 < knobs.bow_at and k == 0:
                assert np.any(seen[step.name] > plain[step.name] + 1e-4)
    assert 0.0 < min(places) < 0.15 < max(places) < 0.3 and 1.0 < min(times) < max(times) < 15.0


def test_an_earthquakes_waves_come_the_later_the_faster_they_are() -> None:
    strength, found = 0.1, []
    for seed in range(11, 19):
        rig = replace(draw_case(seed, size="small"), strengths={"distant_earthquake": strength})
        shaken = list(offsets(rig, 1e-6))
        begins = dict(zip([s.name for s in rig.steps], np.cumsum([0.0, 30.0, 30.0]), strict=True))
        t = np.arange(-150.0, 250.0, 0.02)
        trains = [course(t - begins[step.name]) for step, course in shaken]
        # one train for all records; where there is none it is over, or has not come
        assert all(np.allclose(train, trains[0], atol=1e-12) for train in trains)
        envelope = np.abs(hilbert(trains[0]))
        size = strength * np.mean([step.beta for step in rig.steps])
        assert envelope.max() == pytest.approx(size, rel=1e-3)
        for step in rig.steps:
            if step.name not in [s.name for s, _ in shaken]:
                inside = (t >= begins[step.name]) & (t < begins[step.name] + step.duration)
                assert np.abs(trains[0][inside]).max() < 1e-9
        # its spectrum: a Gaussian band, each of whose frequencies is evenly later
        omega = 2.0 * np.pi * np.fft.rfftfreq(len(t), t[1] - t[0])
        spectrum = np.fft.rfft(trains[0])
        middle = omega[np.argmax(np.abs(spectrum))]
        strong = np.abs(spectrum) > 0.05 * np.abs(spectrum).max()
        off = omega[strong] - middle
        loud = np.log(np.abs(spectrum[strong]))
        curve = np.polyfit(off, loud, 2)
        assert np.abs(np.polyval(curve, off) - loud).max() < 1e-3
        band = np.sqrt(-0.5 / curve[0])
        turned = np.unwrap(np.angle(spectrum[strong] * np.exp(1j * omega[strong] * -t[0])))
        phase = np.polyfit(off, turned, 2)
        assert np.abs(np.polyval(phase, off) - turned).max() < 1e-2
        delay = -2.0 * phase[0]
        lasts = np.sqrt(1.0 + (delay * band**2) ** 2)
        assert delay > 0.0
        arrives = t[np.argmax(envelope)]
        assert -2.0 < arrives < 92.0
        # turned back by what they are late they are the shock again: so much shorter and higher
        shock = np.zeros(len(spectrum), dtype=complex)
        shock[strong] = spectrum[strong] * np.exp(0.5j * delay * off**2)
        short = np.abs(hilbert(np.fft.irfft(shock, len(t))))
        assert short.max() == pytest.approx(size * np.sqrt(lasts), rel=2e-2)
        found.append((2.0 * np.pi / middle, band / middle, lasts))
    low, high = np.min(found, axis=0), np.max(found, axis=0)
    assert np.all(low > [1.4, 0.14, 1.4]) and np.all(high < [6.3, 0.32, 4.1])
    assert np.all(high > 1.3 * low)


def test_a_phosphor_glows_where_two_charges_meet_against_an_ode_solver() -> None:
    # from rest at any level it stays there, and in the dark it fades as one over time squared
    t = np.linspace(0.0, 20.0, 4001)
    assert splitting(t, np.full(len(t), 0.3), 2.0) == pytest.approx(np.sqrt(0.3))
    dark = splitting(t, np.where(t == 0.0, 0.8, 0.0), 2.0) ** 2
    begun = dark[1]
    faded = begun / (1.0 + np.sqrt(begun) * (t - t[1]) / 2.0) ** 2
    assert dark[1:] == pytest.approx(faded[1:], rel=1e-6)

    strength, times = 0.4, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"glowing_phosphor": strength})
        seen = clean_signals(rig)
        time, level = prepared_rig(rig)["1"].glowing_time, np.mean([s.beta for s in rig.steps])
        times.append(time)
        for k, step in enumerate(rig.steps):

            def glow(
                u: float, x: FloatArray, step=step, rig=rig, time=time, level=level
            ) -> list[float]:
                gas = [(u - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
                light = step.y0 + step.beta * x[2]
                # the number of charges, over that at the mean step
                return [*gas, (x[1] - x[2]) / rig.tau, (light / level - x[3] ** 2) / time]

            rest = np.sqrt(step.y0 / level)
            _, states = solved(rig, glow, 4, k=k, begin=[0.0, 0.0, 0.0, rest])
            y = step.y0 + step.beta * states[:, 2]
            expected = (1.0 - strength) * y + strength * level * states[:, 3] ** 2
            assert np.abs(seen[step.name] - expected).max() < 1e-3
    assert 0.5 < min(times) < max(times) < 6.0 and max(times) > 1.5 * min(times)


def test_drops_cool_a_lid_as_heat_spreads_into_a_half_space() -> None:
    # a plane that was touched once, by finite differences: cells a tenth of the depth, D = 1
    n, width, h = 1200, 0.1, 0.004  # depth 1, hence a = 1/4
    cold = np.zeros(n)
    cold[0] = 1.0
    kernel = []
    for _ in range(60_000):
        flow = np.diff(cold) * (h / width**2)
        cold[:-1] += flow
        cold[1:] -= flow
        kernel.append(0.5 * (cold[9] + cold[10]))  # at a depth of 1
    at = (np.arange(len(kernel)) + 1.0) * h / 0.25  # in units of a
    shape = np.array(kernel) / np.max(kernel)
    assert at[np.argmax(shape)] == pytest.approx(2.0, abs=0.1)

    strength, found, signs = 0.1, [], set()
    for seed in range(11, 18):
        rig = replace(draw_case(seed, size="small"), strengths={"dripping_ceiling": strength})
        size, knobs = strength * np.mean([s.beta for s in rig.steps]), prepared_rig(rig)
        dripping = list(offsets(rig, 1e-5))
        falls = np.array(sorted(
            30.0 * (int(step.name) - 1) + mark
            for step, _ in dripping for mark in knobs[step.name].marks
        ))  # fmt: skip
        # from the first drop on without an end, and none before
        assert [step.name for step, _ in dripping] == [
            step.name for step in rig.steps if 30.0 * int(step.name) > falls[0]
        ]
        t = np.arange(0.0, 90.0, 0.02)
        whole = np.zeros(len(t))
        for step, course in dripping:
            begin = 30.0 * (int(step.name) - 1)
            own = (t >= begin) & (t < begin + 30.0)
            whole[own] = course(t[own] - begin)
        assert np.abs(whole[t < falls[0]]).max(initial=0.0) == 0.0
        signs.add(np.sign(whole[np.argmax(np.abs(whole))]))
        # long after the last drop only what is lost counts, and the root of time
        last = dripping[-1][1](np.array([990.0, 1010.0]))
        lost = np.log(last[0] / last[1]) / 20.0 - 0.5 / (1000.0 - (falls[-1] - begin))

        def left(deep: float, whole=whole, falls=falls, t=t, lost=lost):
            drops = np.column_stack([
                np.interp((t - fall) / deep, at, shape, left=0.0)
                * np.exp(-lost * np.maximum(t - fall, 0.0)) for fall in falls
            ])  # fmt: skip
            weights, *_ = np.linalg.lstsq(drops, whole, rcond=None)
            return np.abs(drops @ weights - whole).max(), weights

        tried = np.geomspace(0.12, 1.9, 60)
        deep = tried[np.argmin([left(d)[0] for d in tried])]
        tried = deep * np.linspace(0.95, 1.05, 21)
        deep = tried[np.argmin([left(d)[0] for d in tried])]
        off, weights = left(deep)
        assert off < 0.03 * size
        early = weights[falls < 85.0] / size  # of a late one too little is seen
        assert 0.57 < np.abs(early).min() and np.abs(early).max() < 1.03
        gaps = np.diff(falls)
        assert gaps.max() < 1.7 * gaps.min()
        found.append((deep, gaps.mean(), 1.0 / lost))
    low, high = np.min(found, axis=0), np.max(found, axis=0)
    assert (
        np.all(low > [0.14, 2.2, 3.9])
        and np.all(high < [1.6, 19.0, 31.0])
        and np.all(high > 1.5 * low)
    )
    assert signs == {-1.0, 1.0}


def test_a_sunbeam_is_what_a_gap_uncovers_of_a_disc() -> None:
    def chords(below: FloatArray) -> FloatArray:
        """Share of a disc of diameter 1 below a line, by summing its chords."""
        fine = np.linspace(-0.5, 0.5, 40_001)
        sums = np.cumsum(np.sqrt(np.maximum(0.25 - fine**2, 0.0)))
        return np.interp(below, fine, sums / sums[-1], left=0.0, right=1.0)

    strength, drawn = 0.2, []
    for seed in range(21, 29):
        rig = replace(draw_case(seed, size="paper"), strengths={"creeping_sunbeam": strength})
        size, found = strength * np.mean([s.beta for s in rig.steps]), prepared_rig(rig)
        t = np.arange(0.0, 840.0, 0.25)
        light = np.zeros(len(t))
        for k, step in enumerate(rig.steps):
            own = (t >= 120.0 * k) & (t < 120.0 * (k + 1))
            for course in found[step.name].offset:
                light[own] = course(t[own] - 120.0 * k) / size
        # no jump anywhere, where a record ends neither
        assert np.abs(np.diff(light)).max() < 0.25 * 1.3 / 64.0
        assert light.min() >= 0.0 and light.max() <= 1.0 + 1e-12

        def off(guess: FloatArray, t: FloatArray = t, light: FloatArray = light) -> FloatArray:
            comes, wide, across = guess
            return chords((t - comes) / across) - chords((t - comes - wide) / across) - light

        shows = t[light > 0.0]
        for across in (70.0, 90.0, 110.0, 125.0):
            begin = [shows[0] + 0.5 * across, max(np.ptp(shows) - across, 30.0), across]
            fit = least_squares(off, begin, x_scale=[10.0, 10.0, 10.0])
            if np.abs(fit.fun).max() < 1e-3:
                break
        assert np.abs(fit.fun).max() < 1e-3
        if shows[-1] < t[-1]:  # both edges have passed
            drawn.append((fit.x[0] / 840.0, fit.x[1] / fit.x[2], fit.x[2]))
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [0.049, 0.49, 63.9]) and np.all(high < [0.601, 3.01, 128.1])
    assert np.all(high > 1.2 * low)
    # and it is added to the signal as it is
    rig = case(creeping_sunbeam=strength)
    assert len(list(offsets(rig, 1e-5))) >= 1


def test_a_starting_compressor_dims_a_lamp_as_its_current_runs_down() -> None:
    strength, drawn, apart = 0.3, [], []
    sag = 1.0 - (1.0 - strength) ** (1.0 / 3.4)
    for seed in range(11, 21):
        rig = replace(draw_case(seed, size="paper"), strengths={"compressor_on_mains": strength})
        found = prepared_rig(rig)
        runs = []
        for k, step in enumerate(rig.steps):
            (course,) = found[step.name].gain
            t = np.arange(0.0, step.duration, 2e-3)
            light = 1.0 + course(t)
            assert light.min() >= 1.0 - strength - 1e-12 and light.max() <= 1.0 + 1e-12
            # the current, as the filament sees it, by the lamp's law
            v = (1.0 - light ** (1.0 / 3.4)) / sag
            edges = sorted(found[step.name].marks)
            runs += [120.0 * k + at for at in edges]
            for on, end in pairwise(edges):
                own = (t > on + 5e-3) & (t < end - 5e-3)
                since, seen = t[own] - on, v[own]
                if end - on < 9.0 or seen[0] > seen[-1]:
                    continue  # a rest, or the current has not run down
                # filament v' = i - v with i = running + (1 - running) exp(-t/up)
                running = float(seen[-1])
                # of the late course's logarithm, which no longer knows of the filament
                late = (since > 1.0) & (seen > running + 1e-4)
                up = -1.0 / np.polyfit(since[late], np.log(seen[late] - running), 1)[0]
                slope = np.gradient(seen, since)
                i = running + (1.0 - running) * np.exp(-since / up)
                quick = since < 0.2
                filament = float(slope[quick] @ (i - seen)[quick] / (slope[quick] @ slope[quick]))
                off = filament * slope[1:-1] - (i - seen)[1:-1]
                assert np.abs(off).max() < 0.01
                # and when it stops the light comes back in the filament's time
                back = (t > end) & (t < end + 2.0 * filament)
                rate = np.polyfit(t[back], np.log(v[back]), 1)[0]
                assert -1.0 / rate == pytest.approx(filament, rel=0.02)
                drawn.append((running, up, filament))
        apart.append(np.diff(runs).mean() * 2.0)  # from one start to the next
    assert len(drawn) > 20
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [0.099, 0.29, 0.039]) and np.all(high < [0.251, 1.52, 0.123])
    assert np.all(high > 1.1 * low) and 5.0 < min(apart) and max(apart) < 36.0

    # of all the light the same share, that of a baseline too
    rig = case(compressor_on_mains=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    for step in rig.steps:
        (course,) = prepared_rig(rig)[step.name].gain
        ratio = seen[step.name] / plain[step.name]
        assert np.abs(ratio - 1.0 - course(sample_times(step))).max() < 2e-3


def test_a_lamp_sways_as_a_pendulum_of_its_length_from_one_record_to_the_next() -> None:
    strength, drawn = 0.2, []
    for seed in range(11, 19):
        rig = replace(draw_case(seed, size="paper"), strengths={"swaying_lamp": strength})
        size, found = strength * np.mean([s.beta for s in rig.steps]), prepared_rig(rig)
        h, bumps = 0.05, []
        t = np.arange(0.0, 120.0 * len(rig.steps), h)
        light = np.zeros(len(t))
        for k, step in enumerate(rig.steps):
            own = (t >= 120.0 * k) & (t < 120.0 * (k + 1))
            for course in found[step.name].offset:
                light[own] = course(t[own] - 120.0 * k) / size
            bumps += [120.0 * k + at for at in found[step.name].marks]
        assert len(bumps) == 3 and np.all(light[t < bumps[0]] == 0.0)
        # a damped pendulum, of whose light any three readings obey one recursion, but at a bump
        free = np.ones(len(t) - 2, dtype=bool)
        for at in bumps:
            free &= np.abs(t[1:-1] - at) > 2.0 * h
        free &= t[1:-1] > bumps[0]
        columns = np.column_stack([light[1:-1], light[:-2]])[free]
        (a, b), *_ = np.linalg.lstsq(columns, light[2:][free], rcond=None)
        assert np.abs(columns @ [a, b] - light[2:][free]).max() < 1e-9
        pole = np.log(np.roots([1.0, -a, -b])[0]) / h
        length, rests = 9.81 / np.abs(pole) ** 2, -1.0 / pole.real
        drawn.append((length, rests))
        # the first swing, to be exact its sine before it has lost any
        swings = (t > bumps[0]) & (t < bumps[0] + 3.0) & (t < bumps[1])
        s = t[swings] - bumps[0]
        expected = np.exp(-s / rests) * np.sin(np.abs(pole.imag) * s)
        assert light[swings] == pytest.approx(expected, abs=1e-6)
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [0.49, 14.9]) and np.all(high < [2.21, 60.1]) and np.all(high > 1.5 * low)
    # and it is added to the signal as it is
    assert len(list(offsets(case(swaying_lamp=strength), 1e-4))) >= 2


def test_a_fibre_of_many_modes_passes_the_same_light_whenever_the_line_is_there_again() -> None:
    strength, slopes, values = 0.1, [], []
    for seed in range(11, 21):
        rig = replace(draw_case(seed, size="small"), strengths={"grainy_fibre": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        level, light = [], []
        for step in rig.steps:
            relative = rig.relative_concentration(step)
            level.append(relative * (plain[step.name] - step.y0) / step.beta)
            light.append(seen[step.name] / plain[step.name])
            assert np.abs(light[-1][: round(step.t0 / step.interval)] - 1.0).max() < 1e-12
        x, passed = np.concatenate(level), np.concatenate(light)
        knobs = prepared_rig(rig)["1"]
        waves, begins = knobs.grain_waves, knobs.grain_begins
        # one curve over the level for all ways of all experiments
        order = np.argsort(x)
        near = np.diff(x[order]) < 1e-4
        steepest = strength * np.sqrt(2.0 / len(waves)) * np.abs(waves).sum()
        assert np.abs(np.diff(passed[order]))[near].max() < steepest * 1e-4 + 1e-9
        # whose value at any level, over all that it might have been, has the rms it says
        places = np.linspace(0.0, 4.0, 400)
        curve = np.cos(np.multiply.outer(places, waves) + begins).sum(axis=1)
        values.append(np.mean(curve**2) * 2.0 / len(waves))
        slopes.append(float(np.sqrt(np.mean(waves**2))))
    assert np.mean(values) == pytest.approx(1.0, abs=0.3)
    assert 1.0 / 0.3 * 0.6 < min(slopes) < max(slopes) < 1.0 / 0.05 * 1.4
    assert max(slopes) > 1.5 * min(slopes)


def test_a_screen_shines_back_the_mean_of_what_it_shows_its_own_light_and_all() -> None:
    strength, times = 0.25, []
    for seed in range(11, 23):
        rig = replace(draw_case(seed, size="small"), strengths={"chart_on_screen": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        time = prepared_rig(rig)["1"].screen_time
        times.append(time)
        for step in rig.steps:
            t = sample_times(step)
            z, y = seen[step.name] - step.y0, plain[step.name] - step.y0
            whole = np.concatenate([[0.0], np.cumsum(0.5 * (z[1:] + z[:-1])) * step.interval])
            shown = (whole - np.interp(t - time, t, whole)) / time
            # steps of 10 ms between samples while the response moves leave 1e-4
            assert np.abs(z - y - strength * shown).max() < 3e-4 * step.beta
            if step.tf + time + 12.0 * rig.tau_v + 12.0 * rig.V / step.total_flow < step.duration:
                # of all that was shown nothing is on the screen any more but its own after-image
                assert z[-1] < strength**2 * step.beta
    assert 3.99 < min(times) < 12.0 < max(times) < 40.01
    # light that stays comes back to what a loop of that gain makes of it
    t = np.linspace(-1.0, 60.0, 6101)
    y = 0.3 + (t >= 0.0)
    assert shone_back(t, y, 0.25, 5.0)[-1] == pytest.approx(0.3 + 1.0 / 0.75, abs=1e-3)


def test_a_screens_slides_stand_evenly_once_no_key_has_been_touched() -> None:
    strength, drawn = 0.2, []
    for seed in range(11, 17):
        rig = replace(draw_case(seed, size="small"), strengths={"slideshow_screen": strength})
        size, own = strength * np.mean([s.beta for s in rig.steps]), []
        for step, course in offsets(rig, 2e-4):
            t = np.arange(0.0, step.duration, 1e-3)
            shown = course(t) / size
            assert np.abs(shown).max() <= 1.0
            moving = np.abs(np.diff(shown)) > 1e-9
            starts = t[:-1][moving & ~np.concatenate([[False], moving[:-1]])]
            ends = t[1:][moving & ~np.concatenate([moving[1:], [False]])]
            # nothing before the first, and from there on one after the other as evenly as a clock
            assert np.all(shown[t < starts[0]] == 0.0)
            stands = np.diff(starts)
            assert np.all(np.abs(stands - np.mean(stands)) < 3e-3)
            fades = (ends - starts)[:-1]
            assert np.all(np.abs(fades - fades[0]) < 3e-3)
            for low, high in zip(starts[:-1], ends[:-1], strict=True):
                inside = (t > low + 2e-3) & (t < high - 2e-3)
                assert np.ptp(np.diff(shown[inside])) < 1e-9
            own.append((starts[0], np.mean(stands), fades[0]))
        assert len(own) == len(rig.steps)
        # one computer, the same in every record, but for its pictures
        assert np.ptp(own, axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=3e-3)
        idle, stands, fades = own[0]
        assert 0.04 < fades / stands < 0.51
        drawn.append((idle, stands))
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [1.49, 1.99]) and np.all(high < [12.01, 12.01])
    assert np.all(high > 1.3 * low)


def test_a_lid_rolls_ever_faster_and_is_at_rest_at_once() -> None:
    strength, drawn, sizes = 0.2, [], []
    for seed in range(11, 17):
        rig = replace(draw_case(seed, size="paper"), strengths={"rolling_lid": strength})
        size, found = strength * np.mean([s.beta for s in rig.steps]), prepared_rig(rig)
        h = 1e-3
        t = np.arange(0.0, 120.0, h)
        shaken = np.zeros(len(t) * len(rig.steps))
        for k, step in enumerate(rig.steps):
            for course in found[step.name].offset:
                shaken[k * len(t) : (k + 1) * len(t)] = course(t) / size
        # every stretch in which it moves
        whole = np.flatnonzero(np.abs(shaken) > 1e-12)
        gaps = np.flatnonzero(np.diff(whole) > 500)
        begins = whole[np.concatenate([[0], gaps + 1])]
        ends = whole[np.concatenate([gaps, [len(whole) - 1]])]
        assert 1 <= len(begins) <= len(rig.steps) // 2 + 1
        peaks = []
        for first, last in zip(begins, ends, strict=True):
            y = shaken[first : last + 1]
            if first == 0 or last == len(shaken) - 1 or len(y) * h > 8.1:
                continue
            # it crosses zero every half turn: 1.2 rate lasts (1 - left^(5/6))
            up = np.flatnonzero(np.sign(y[1:]) != np.sign(y[:-1]))
            crossings = (up + y[up] / (y[up] - y[up + 1])) * h
            lasts = len(y) * h
            left = np.clip(1.0 - crossings / lasts, 0.0, 1.0)
            turns = 0.5 * np.arange(1, len(crossings) + 1)
            progress = 1.2 * lasts * (1.0 - left ** (5.0 / 6.0))
            kept = left > 0.02
            rate, begin = np.polyfit(progress[kept], turns[kept], 1)
            assert np.abs(np.polyval([rate, begin], progress[kept]) - turns[kept]).max() < 0.1
            assert abs(begin) < 0.1
            # as hard to the end as in the beginning
            early, late = y[: len(y) // 3], y[-len(y) // 3 :]
            assert np.abs(early).max() == pytest.approx(np.abs(late).max(), rel=0.03)
            peaks.append(np.abs(y).max())
            drawn.append((rate, lasts))
        sizes += peaks
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [2.4, 0.99]) and np.all(high < [8.1, 8.01]) and np.all(high > 1.5 * low)
    assert max(sizes) == pytest.approx(1.0, rel=0.02) and min(sizes) > 0.49
    # and it is added to the signal as it is, but for what the grid makes of its last moment
    assert_added_between_marks(case(rolling_lid=strength))


def test_a_tower_sways_at_its_own_rate_and_gusts_keep_it_going() -> None:
    strength, sizes, rates, quality = 0.1, [], [], []
    for seed in range(11, 31):
        rig = replace(draw_case(seed, size="paper"), strengths={"tower_in_the_wind": strength})
        size, found = strength * np.mean([s.beta for s in rig.steps]), prepared_rig(rig)
        h = 0.1
        parts = []
        for step in rig.steps:
            (course,) = found[step.name].offset
            parts.append(course(np.arange(0.0, step.duration, h)) / size)
        tilt = np.concatenate(parts)
        sizes.append(np.mean(tilt**2))
        # no leap where one record ends and the next one begins
        steps = np.abs(np.diff(tilt))
        assert steps[len(parts[0]) - 1 :: len(parts[0])].max() < steps.max() + 1e-12
        power = np.abs(np.fft.rfft(tilt)) ** 2
        f = np.arange(len(power)) / (h * len(tilt))
        rate = f[power.argmax()]
        rates.append(rate)
        # nearly all of it within a twentieth or a tenth of its own rate, and not all in one line
        near = np.abs(f - rate) < 0.25 * rate
        assert power[near].sum() > 0.85 * power.sum()
        mean = (f * power)[near].sum() / power[near].sum()
        width = np.sqrt(((f - mean) ** 2 * power)[near].sum() / power[near].sum()) / rate
        quality.append(width)
        # swings grow and fade
        envelope = np.abs(hilbert(tilt))[200:-200]
        assert envelope.max() > 1.8 * np.median(envelope)
    # of the mean square, each of some independent swings
    assert np.mean(sizes) == pytest.approx(1.0, abs=0.2)
    assert 0.09 < min(rates) < 0.2 < max(rates) < 0.52
    assert 0.01 < min(quality) and max(quality) < 0.15
    # and it is added to the signal as it is
    assert len(list(offsets(case(tower_in_the_wind=strength), 1e-4))) == 3
