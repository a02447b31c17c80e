"""One experiment on the simulated rig, from the valve's command to the voltage.

Command -> coil and stroke of the valve -> flows -> manifold -> sensor -> ring resonance ->
receiver and filter -> recorder's clock.  Each knob left alone is an ideal part, and all of them
together give the cascade of three first-order lags.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import pi
from typing import Any

import numpy as np
from scipy.special import erfc

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.knobs import Knobs
from bayes_sensor.reality.records import Case, Step
from bayes_sensor.reality.stages import lags, manifold, readout, sensor, valve


def on_the_clock(knobs: Knobs, true: float, step: Step) -> float:
    """s, what the recorder calls the true time ``true``."""
    if knobs.clock is None:
        return true
    t = np.linspace(0.0, step.duration, 20001)
    # of a time that is recorded twice the first
    return float(np.interp(true, np.maximum.accumulate(knobs.clock(t)), t))


def both_sides(edges: Iterable[float]) -> list[float]:
    """s, just before and after each of the ``edges``, where what acts is cut off sharply."""
    return [side for at in edges for side in (at - 1e-6, at + 1e-6)]


def _driven_past(case: Case, step: Step, knobs: Knobs, up: float, down: float) -> list[float]:
    """s around where the driving pressure, a lag, comes up to one share and down to another."""
    tau_v = case.tau_v * knobs.valve_factor
    through = step.t0 - tau_v * float(np.log1p(-up))
    return both_sides((through, step.tf - tau_v * float(np.log(down))))


def nodes(step: Step, times: FloatArray, marks: list[float], quick: float) -> FloatArray:
    """(n,) s: the times asked for, every switch, and steps that are short after each switch.

    ``quick`` (s) is the fastest of the slow parts; steps stay below a hundredth of it while the
    response moves and grow in proportion to the time since the switch later.
    """
    first = min(float(times[0]), step.t0, *marks) - 1.0
    first = min(first, 0.0)
    last = float(times[-1])
    events = sorted({step.t0, step.tf, *marks})
    pieces = [times, np.array([first, *events])]
    for i, event in enumerate(events):
        end = events[i + 1] if i + 1 < len(events) else last
        pieces.append(event + lags.growing_steps(end - event, quick))
    grid = np.unique(np.concatenate(pieces))
    grid = grid[grid <= last]
    # times that differ by rounding only would make intervals of no length
    kept: FloatArray = grid[np.concatenate([[True], np.diff(grid) > 1e-9])]
    return kept


def voltage(
    case: Case, step: Step, knobs: Knobs, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Signal (n,) V and normalised response (n,) at recorder times ``times`` (n,) s, no noise."""
    true = times if knobs.clock is None else knobs.clock(times)
    marks = knobs.marks + [
        edge for at, lasts in knobs.dropped + knobs.tried for edge in (at, at + lasts)
    ]
    for switch in (step.t0, step.tf):
        marks += [switch + after for after, _ in knobs.bounces]
        marks += [switch + after + lasts for after, lasts in knobs.bounces]
        if knobs.stroke_time > 0:
            marks.append(switch + knobs.stroke_time)
        if knobs.bypass > 0:
            marks.append(switch + knobs.bypass_delay)
    if knobs.pilot_alone > 0:
        marks.append(step.t0 + knobs.pilot_alone)
    if knobs.snap > 0:
        marks += _driven_past(case, step, knobs, knobs.snap_up, knobs.snap_down)
    if knobs.check_cracks > 0:
        marks += _driven_past(case, step, knobs, knobs.check_cracks, knobs.check_reseats)
    if knobs.sinking > 0:
        marks.append(step.t0 + knobs.sinking_after)
    if knobs.ajar > 0:
        # where the falling plunger meets the grain, and where it falls on
        rests = step.tf - case.tau_v * knobs.valve_factor * float(np.log(knobs.ajar))
        marks += [at for at in (rests, knobs.ajar_until) if at < step.duration]
    quick = min(case.tau_v, case.V / step.total_flow)
    t = nodes(step, true, marks, quick)
    opening = _opening(case, step, knobs, t)
    inlet, flow = _flows(step, knobs, t, opening)
    if knobs.sticky > 0:
        held = knobs.sticky * case.V / (0.5 * (flow[1:] + flow[:-1])) / knobs.sticky_cells
        bend = knobs.sticky_bend * case.relative_concentration(step)
        inlet = manifold.sticky_wall(t, inlet, held, bend, knobs.sticky_cells)
    if knobs.laminar > 0:
        inlet = manifold.laminar(_integral(t, flow), inlet, knobs.laminar * case.V)
    if knobs.flushed_back > 0:
        # a plateau's gas is in the hose, as is in the inlet before the valve shuts
        through = manifold.laminar(_integral(t, flow), inlet, knobs.flushed_back * case.V)
        inlet = np.where(t < step.tf, inlet, through)
    if knobs.heated is not None:
        # what the wall holds is in balance with the stream: (held c)' V = flow (inlet - c)
        held = knobs.heated(t)
        times = case.V * (held[1:] + held[:-1]) / (flow[1:] + flow[:-1])
        inlet = lags.lag(t, held * inlet, times, 0.0) / held
    if knobs.trap > 0:
        inlet = lags.lag(t, inlet, knobs.trap * case.V / (0.5 * (flow[1:] + flow[:-1])), 0.0)
    if np.isfinite(knobs.saturated):
        relative = case.relative_concentration(step)
        inlet = manifold.condensing(
            t, inlet, knobs.saturated / relative, knobs.film_time / relative
        )
    gas = _manifold(case, step, knobs, t, inlet, flow)
    if knobs.returned > 0:
        late = np.interp(t - knobs.return_delay, t, gas, left=0.0)
        drawn = lags.lag(t, late, np.full(len(t) - 1, knobs.return_time), 0.0)
        carried = knobs.returned * step.carrier_flow / step.total_flow
        gas = _manifold(case, step, knobs, t, inlet + carried * drawn, flow)
    if knobs.coil > 0:
        passed, volume = _integral(t, flow), knobs.coil * case.V
        had = _integral(passed, gas)  # what has passed, times how much gas is in it
        gas = (had - np.interp(passed - volume, passed, had)) / volume
    if knobs.stray_turn is not None:
        his = knobs.stray * knobs.stray_turn(t) * (knobs.stray_level - gas)
        gas = gas + lags.lag(t, his, np.full(len(t) - 1, knobs.stray_flush), 0.0)
    if knobs.tide > 0:
        passed, turns = _integral(t, flow), knobs.tide_rate * t + knobs.tide_begin
        gas = np.interp(passed + knobs.tide * case.V * np.sin(2.0 * pi * turns), passed, gas)
    response = _sensor(case, step, knobs, t, gas)
    if knobs.starved > 0:
        relative, bend = case.relative_concentration(step), knobs.starved_bend
        thick = np.sqrt(knobs.starved_flow / (0.5 * (flow[1:] + flow[:-1])))
        held = sensor.starved(t, relative * gas, knobs.starved_time * thick, bend)
        full = relative * (1.0 + bend) / (1.0 + bend * relative)
        response = response + knobs.starved * (held / full - response)
    if knobs.impurity > 0:
        late = lags.retarded(t, gas, flow, knobs.impurity_volume, knobs.impurity_cells)
        response = response / (1.0 + knobs.impurity * late)
    if knobs.dried > 0:
        late = lags.retarded(t, gas, flow, knobs.dried_volume, knobs.dried_cells)
        response = response - knobs.dried * lags.steady_lag(t, late, case.tau)
    y = _readout(case, step, knobs, t, response, inlet, gas)
    if knobs.blank_lasts > 0:
        y = readout.blanked(t, y, knobs.blank_up, knobs.blank_down, knobs.blank_lasts)
    if knobs.distrust > 0:
        before = np.interp(t - knobs.distrust_within, t, y)
        y = readout.distrusted(t, y, before, knobs.distrust_band, knobs.distrust)
    if knobs.lead > 0:
        slope = (y - lags.steady_lag(t, y, knobs.lead_lag)) / knobs.lead_lag
        y = y + knobs.lead * slope
    if knobs.filter_time > 0:
        for _ in range(4):
            y = lags.steady_lag(t, y, 0.25 * knobs.filter_time)
    if knobs.parabola > 0:
        y = readout.parabola(t, y, knobs.parabola)
    if knobs.pen_late != 0:
        swing = np.clip(knobs.pen_sine * (y - knobs.pen_rest) / knobs.pen_reach, -1.0, 1.0)
        late = (1.0 - np.sqrt(1.0 - swing**2)) / (1.0 - np.sqrt(1.0 - knobs.pen_sine**2))
        y = np.interp(t, np.maximum.accumulate(t + knobs.pen_late * late), y)
    if knobs.repeats is not None:
        y = np.mean([np.interp(t - late, t, y) for late in knobs.repeats], axis=0)
    if knobs.average_window > 0:
        y = readout.windowed_average(t, y, knobs.average_time, knobs.average_window)
    if knobs.kept_band > 0:
        kept = readout.kept(t, y, knobs.kept_band, knobs.kept_longest, knobs.kept_begin)
        y = np.interp(t, t[kept], y[kept])
    if knobs.floor_climbs > 0:
        # the lowest of all lines that climb from a reading so far
        climbed = knobs.floor_climbs * t
        y = y - (np.minimum.accumulate(y - climbed) + climbed - y[0])
    if knobs.flattened > 0:
        y = y - knobs.flattened * readout.slowest_waves(t, y, step.duration, knobs.flattened_waves)
    if knobs.link_every > 0.1 * step.interval:  # else no reading knows of single bits
        first = knobs.link_begin - knobs.link_every
        ticks = np.arange(first, t[-1] + knobs.link_every, knobs.link_every)
        y = np.interp(t, ticks, readout.one_bit(np.interp(ticks, t, y), knobs.link_least))
    if knobs.archive > knobs.archive_kept * step.interval:  # else there is nothing to throw away
        begin, length = knobs.archive_begin, knobs.archive
        y = readout.cosine_blocks(t, y, begin, length, knobs.archive_kept)
    light = np.maximum(y, 0.02 * np.max(y))  # some current leaks in the dark
    # where all fillings are shorter than the recorder's interval they are not told apart
    if knobs.charge > step.interval * max(float(np.min(light)), 0.0):
        y = readout.counted(t, light, knobs.charge, knobs.charge_begin)
    shown = true
    if knobs.hold > 0:
        shown = np.maximum(_last_turn(true, knobs.hold_begin, knobs.hold), t[0])
    seen = np.interp(shown, t, y)
    if knobs.readings is not None:
        seen = np.interp(true, knobs.readings, np.interp(knobs.readings, t, y))
    if knobs.whine > 0:
        turns = knobs.whine_rate * _integral(t, np.abs(y - knobs.whine_zero))
        turns += knobs.whine_begin - float(np.interp(0.0, t, turns))
        seen = seen + knobs.whine * np.sin(2.0 * pi * np.interp(true, t, turns))
    if knobs.coarse_gain != 0:
        above = np.mod((seen - knobs.coarse_begin) / knobs.coarse_step, 1.0)
        seen = seen + knobs.coarse_gain * knobs.coarse_step * (above - 0.5)
    if knobs.bit > 0:
        seen = seen - knobs.bit * np.mod(np.floor((seen - knobs.bit_zero) / knobs.bit), 2.0)
    if knobs.pair_gain != 0:
        turn = np.where(np.rint(times / step.interval) % 2 == 0, -0.5, 0.5)
        seen = seen * (1.0 + knobs.pair_gain * turn) + knobs.pair_zero * turn
    return seen, np.interp(true, t, response)


def _last_turn(t: FloatArray, begin: float, every: float) -> FloatArray:
    """(n,) s, of what comes ``every`` so often, once at ``begin``: the last time up to ``t``."""
    turns: FloatArray = begin + np.floor((t - begin) / every) * every
    return turns


def _opening(case: Case, step: Step, knobs: Knobs, t: FloatArray) -> FloatArray:
    middle = 0.5 * (t[1:] + t[:-1])
    up = (middle > step.t0) & (middle < step.tf)
    for after, lasts in knobs.bounces:
        up &= ~((middle > step.t0 + after) & (middle < step.t0 + after + lasts))
        up |= (middle > step.tf + after) & (middle < step.tf + after + lasts)
    for at, lasts in knobs.dropped:
        up &= ~((middle > at) & (middle < at + lasts))
    for at, lasts in knobs.tried:
        up |= (middle > at) & (middle < at + lasts)
    first = last = up.astype(float)
    for at, lasts, level in knobs.swept:
        first = last = np.where((middle > at) & (middle < at + lasts), level, first)
    if knobs.wheel is not None or knobs.stroke_time > 0:
        z = knobs.wheel(t) if knobs.wheel is not None else _stroke(t, step, knobs.stroke_time)
        first, last = z[:-1], z[1:]
    if knobs.pilot_alone > 0:
        alone = (middle > step.t0) & (middle < step.t0 + knobs.pilot_alone)
        first, last = (np.where(alone, knobs.pilot * target, target) for target in (first, last))
    if knobs.sinking > 0:
        held = (middle > step.t0 + knobs.sinking_after) & (middle < step.tf)
        first, last = (target * (1.0 - knobs.sinking * held) for target in (first, last))
    tau_v = case.tau_v * knobs.valve_factor
    if knobs.inertia > 0:
        x = valve.heavy_valve(t, first, last, tau_v, knobs.inertia)
    elif knobs.grease > 0:
        sets, yields = knobs.grease_time, knobs.grease_stroke
        x = valve.greased_valve(t, first, last, tau_v, knobs.grease, sets, yields)
    else:
        x = valve.valve(t, first, last, tau_v, knobs.closing)
    if knobs.slow_opening > 0:
        slow = np.zeros_like(x)
        for factor in (0.6, 1.6):
            slow += 0.5 * valve.valve(t, first, last, factor * knobs.slow_opening_time, 0.0)
        x = (1.0 - knobs.slow_opening) * x + knobs.slow_opening * slow
    if knobs.stick_band > 0:
        x = valve.stick_slip(x, knobs.stick_band)
    if knobs.snap > 0:
        snapped = readout.two_ranges(x, knobs.snap_up, knobs.snap_down, 1.0) - x
        x = (1.0 - knobs.snap) * x + knobs.snap * snapped
    if knobs.check_cracks > 0:
        shut = 1.0 - knobs.check_reseats
        passing = readout.two_ranges(x, knobs.check_cracks, knobs.check_reseats, 1.0) - x
        x = passing * np.maximum(x - knobs.check_reseats, 0.0) / shut
    if knobs.ajar > 0:
        falling = np.exp(-np.maximum(t - knobs.ajar_until, 0.0) / tau_v)
        x = np.where(t > step.tf, np.maximum(x, knobs.ajar * falling), x)
    if knobs.slam > 0:
        x = np.where((t > step.tf) & (x < knobs.slam), 0.0, x)
    if knobs.authority_lost > 0:
        # pressure over the valve (flow/x)^2, over the hose flow^2, in the ratio of 1 - lost to lost
        x = x / np.sqrt(1.0 - knobs.authority_lost * (1.0 - x**2))
    return x


def _stroke(t: FloatArray, step: Step, lasts: float) -> FloatArray:
    """(n,) position of the plunger: constant acceleration from one stop to the other."""
    up = np.clip((t - step.t0) / lasts, 0.0, 1.0) ** 2
    return up - np.clip((t - step.tf) / lasts, 0.0, 1.0) ** 2


def _flows(
    step: Step, knobs: Knobs, t: FloatArray, opening: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Inlet concentration over the set one, and total flow (mL/s), (n,) each."""
    carrier = np.full(len(t), step.carrier_flow)
    full = np.full(len(t), step.test_gas_flow)
    for factor in knobs.carrier:
        carrier = carrier * factor(t)
    for factor in knobs.test_gas:
        full = full * factor(t)
    # what does not pass the valve's branch while it is shut is made up by as much carrier gas
    test = full * opening
    other = opening  # of the valve that the carrier gas in place of the test gas comes through
    if any(knobs.made_up_late):
        on, off = (np.interp(t - late, t, opening) for late in knobs.made_up_late)
        other = np.where(t < 0.5 * (step.t0 + step.tf), on, off)
    made_up = (1.0 - knobs.following) * (step.test_gas_flow * (1.0 - other))
    if knobs.mixing:
        inlet = test / (carrier + test + made_up) / step.concentration
    else:
        share = full / (carrier + full)
        inlet = opening * share / step.concentration
    flow = carrier + test + made_up
    if knobs.chill > 0:
        inlet = inlet * np.exp(-manifold.evaporating(t, opening, knobs.chill, knobs.chill_time))
    if knobs.stale > 0:
        dosed = _integral(t, test)
        behind = (dosed - knobs.stale_volume) / knobs.stale_front
        inlet = inlet * (1.0 - 0.5 * knobs.stale * erfc(behind))
    if knobs.dissolved > 0:
        passed = _integral(t, test)
        inlet = inlet * (1.0 - knobs.dissolved * np.exp(-passed / knobs.dissolved_volume))
    for factor in knobs.unmixed:
        inlet = inlet * factor(t)
    for source in knobs.seep:
        inlet = inlet + source(t) / flow / step.concentration
    for factor in knobs.all_flow:
        flow = flow * factor(t)
    return inlet, flow * knobs.flow_factor


def _manifold(
    case: Case, step: Step, knobs: Knobs, t: FloatArray, inlet: FloatArray, flow: FloatArray
) -> FloatArray:
    if knobs.jet > 0:
        flow = (1.0 - knobs.jet) * flow  # what is left to flush the manifold
    if knobs.standing is not None:
        flow = flow / (1.0 - knobs.standing(t))  # for each mL of gas that V has still room for
    if knobs.pocket_fractions:
        gas = manifold.pockets(
            t, inlet, flow, case.V, np.array(knobs.pocket_fractions),
            np.array(knobs.pocket_exchange), 0.0,
        )  # fmt: skip
    elif knobs.pit > 0:
        gas = manifold.pit(t, inlet, flow, case.V, knobs.pit, knobs.pit_falling, knobs.pit_lifted)
    elif knobs.unmixed_layers > 0:
        eddies = 1.0 / knobs.unmixed_layers - 1.0
        gas = manifold.two_layers(t, inlet, flow / case.V, knobs.floor, eddies)
    elif knobs.back_flow is not None:
        gas = manifold.cells(t, inlet, flow, case.V, knobs.n_cells, knobs.back_flow)
    elif knobs.loop > 0:
        round_trip = knobs.loop * case.V / knobs.loop_pumped
        gas = manifold.looped(t, inlet, flow, case.V, knobs.loop_pumped, round_trip)
    elif knobs.riser > 0:
        gas = manifold.weighed_down(t, inlet, flow, case.V, knobs.riser_volume, knobs.riser)
    else:
        passage = case.V / (0.5 * (flow[1:] + flow[:-1]))
        if knobs.layering > 0:
            gas = manifold.layers(t, inlet, passage, knobs.layering, 0.0)
        elif knobs.fan is not None:
            runs = knobs.fan(0.5 * (t[1:] + t[:-1]))
            gas = manifold.fanned(t, inlet, passage, runs, knobs.corner)
        elif knobs.pairing > 0:
            gas = manifold.pairing(t, inlet, passage, knobs.pairing)
            # the plateau is what it is: x + kappa x^2 = 1 with kappa the rate over the exchange's
            kappa = knobs.pairing * case.V / step.total_flow
            gas = gas * 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * kappa))
        elif knobs.ripening > 0:
            gas = lags.lag(t, inlet, passage, 0.0)
            ripe = manifold.ripening(t, gas, passage, knobs.ripening_rate)
            # the plateau is what it is: kappa (1 - x)^2 = x with kappa the rate over the exchange's
            kappa = knobs.ripening_rate * case.V / step.total_flow
            full = 1.0 + 0.5 * (1.0 - np.sqrt(1.0 + 4.0 * kappa)) / kappa
            gas = gas + knobs.ripening * (ripe / full - gas)
        else:
            gas = lags.lag(t, inlet, passage, 0.0)
    if knobs.jet > 0:
        gas = (1.0 - knobs.jet) * gas + knobs.jet * inlet
    if knobs.swirl > 0:
        passed = _integral(t, flow)
        exchanged = (passed - np.interp(step.t0, t, passed)) / case.V
        turned = knobs.swirl_turns * exchanged + knobs.swirl_begin
        streak = np.exp(knobs.swirl_narrow * (np.cos(2.0 * pi * turned) - 1.0))
        gas = gas + knobs.swirl * streak * (inlet - gas)
    if knobs.bypass > 0:
        late = np.interp(t - knobs.bypass_delay, t, gas, left=0.0)
        gas = (1.0 - knobs.bypass) * gas + knobs.bypass * late
    if knobs.left_over != 0:
        short, long = knobs.left_over_times
        since = np.maximum(t - max(float(t[0]), 0.0), 0.0)
        gas = gas + knobs.left_over * (0.6 * np.exp(-since / short) + 0.4 * np.exp(-since / long))
    return gas


def _sensor(case: Case, step: Step, knobs: Knobs, t: FloatArray, gas: FloatArray) -> FloatArray:
    tau = case.tau * knobs.tau_factor
    relative = case.relative_concentration(step)
    if knobs.drop is not None:
        thick = knobs.drop(0.5 * (t[1:] + t[:-1]))
        gas = lags.lag(t, gas, np.maximum(thick, 1e-6), float(gas[0]))  # or it is gone
    if knobs.film_share > 0:
        times, weights = sensor.layered_film(tau * knobs.film_share)
        gas = lags.modal(t, gas, times, weights)
        tau *= 1.0 - knobs.film_share
    if tau <= 0:
        x = gas
    elif knobs.langmuir > 0:
        K = knobs.langmuir
        filled = sensor.langmuir(t, relative * gas, tau, K, 0.0, 0.0, 1.0)
        if knobs.curved:
            x = filled * (1.0 + K * relative) / relative
        else:  # a reading that was calibrated against concentration
            x = filled / (1.0 - K * filled) / relative
    elif knobs.sorption_heat > 0:
        x = sensor.warming_coating(t, gas, tau, knobs.sorption_heat, knobs.cooling_time)
    elif knobs.swelling != 0 or knobs.gate != 0:
        x = sensor.langmuir(t, gas, tau, 0.0, knobs.swelling, knobs.gate, knobs.gate_width)
    else:
        x = lags.steady_lag(t, gas, tau)
    if knobs.slow_sites > 0:
        slow = np.zeros_like(x)
        for factor in (0.5, 1.8):
            K = 0.3
            time = factor * knobs.slow_sites_time
            site = sensor.langmuir(t, relative * gas, time, K, 0.0, 0.0, 1.0)
            slow += 0.5 * site * (1.0 + K * relative) / relative
        x = (1.0 - knobs.slow_sites) * x + knobs.slow_sites * slow
    if knobs.split > 0:
        halves = sensor.splitting(t, relative * gas, knobs.split_time)
        x = (1.0 - knobs.split) * x + knobs.split * halves / np.sqrt(relative)
    if knobs.rim > 0:
        rim = sensor.glassy(t, gas, relative / knobs.rim_time, knobs.rim_back)
        x = (1.0 - knobs.rim) * x + knobs.rim * rim
    if knobs.backlash > 0:
        x = x + knobs.backlash * (sensor.play(x, 0.25) - x)
    if knobs.bound > 0:
        dose = _integral(t, x)
        x = x - knobs.bound * np.expm1(-dose / knobs.bound_time)
    if knobs.cages > 0:
        beyond = (relative * gas - knobs.cages_at) / knobs.cages_width
        shut = 1.0 / (1.0 + np.exp(knobs.cages_at / knobs.cages_width))  # open without any gas
        open_ = (1.0 / (1.0 + np.exp(-beyond)) - shut) / (1.0 - shut)
        x = x + knobs.cages / relative * lags.steady_lag(t, open_, knobs.cages_time)
    if knobs.damp > 0:
        water = sensor.displaced(t, knobs.displacing * x, knobs.damp, knobs.damp_time)
        x = x * (1.0 - water) / (1.0 - knobs.damp)
    if knobs.converting > 0:
        turned = sensor.moving_fronts(
            t, relative * gas - knobs.converting_at, knobs.converting_time
        )
        x = x + knobs.converting / relative * turned
    if knobs.islands > 0:
        drive = relative * gas - knobs.islands_vapour
        x = x + knobs.islands / relative * sensor.islands(t, drive, knobs.islands_time)
    if knobs.pores > 0:
        pressure = np.maximum(knobs.pores_vapour * relative * gas, 0.0)
        filled = np.log(np.maximum(sensor.capillary(pressure), 1e-9) / knobs.pores_at)
        share = 0.5 * erfc(-filled / (np.sqrt(2.0) * knobs.pores_width))
        x = x + knobs.pores / relative * lags.steady_lag(t, share, case.tau)
    if knobs.bonds > 0:
        bound = sensor.elovich(t, relative * gas, knobs.bonds_bend, knobs.bonds_time)
        x = x + knobs.bonds / relative * bound
    if knobs.glow > 0:
        burns, brought = knobs.glow_burns, knobs.glow_brought
        warmth = sensor.burning(t, relative * gas, burns, brought, knobs.glow_time)
        x = x + knobs.glow / relative * warmth
    if knobs.flares > 0:
        warmth = sensor.flaring(
            t, relative * gas, knobs.flares_oxidise, knobs.flares_reduce,
            knobs.flares_from, knobs.flares_until, knobs.flares_cooling,
        )  # fmt: skip
        x = x + knobs.flares / relative * warmth
    if knobs.blisters > 0:
        dissolved = lags.steady_lag(t, gas, knobs.blisters_soak)
        beyond = relative * (dissolved - gas) - knobs.blisters_level
        lifting = np.maximum(beyond, 0.0) / (1.0 - knobs.blisters_level)
        x = x - knobs.blisters / relative * lags.steady_lag(t, lifting, knobs.blisters_time)
    if knobs.salt > 0:
        water = sensor.deliquescing(
            t, knobs.salt_vapour * relative * gas, knobs.salt_dissolves, knobs.salt_comes_out,
            knobs.salt_time,
        )  # fmt: skip
        full = knobs.salt_vapour / (1.0 - knobs.salt_vapour)
        x = x + knobs.salt / relative * water / full
    if knobs.chains > 0:
        bound = sensor.chained(
            t, relative * gas, knobs.chains_level, knobs.chains_seeds, knobs.chains_time
        )
        x = x + knobs.chains / relative * bound
    if knobs.crystal > 0:
        drive = relative * gas - knobs.crystal_level
        grown = sensor.crystallising(t, drive, knobs.crystal_wait, knobs.crystal_time)
        x = x + knobs.crystal / relative * grown
    if knobs.loosened > 0:
        bend = knobs.loosening_bend * relative
        x = x - knobs.loosened * sensor.loosening(t, x, bend, knobs.loosening_time)
    if knobs.stacked > 0:
        # the highest of all lines that go down evenly from what has settled so far
        gone = t / (relative * knobs.stacked_time)
        x = x + knobs.stacked * (np.maximum.accumulate(x + gone) - gone - x)
    if knobs.unwashed > 0:
        x = x * (1.0 - knobs.unwashed * np.exp(-knobs.washing * relative * _integral(t, x)))
    if knobs.avalanches > 0:
        rests = sensor.pinned(relative * x, knobs.pinned_at) - knobs.pinned_at[0]
        x = x + knobs.avalanches * (rests / relative - x)
    if knobs.poisoning > 0:
        held = relative * _integral(t, x)
        x = knobs.alive * x * np.exp(-knobs.poisoning * held)
    if knobs.reference > 0:
        x = x - knobs.reference * lags.modal(t, gas, *lags.slab(knobs.reference_time))
    return x


def _integral(t: FloatArray, rate: FloatArray) -> FloatArray:
    """(n,) what has come by ``t`` (n,) at a rate (n,) that is straight between."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])


def dip(z: FloatArray | float) -> Any:
    """Depth of the Lorentzian dip at a detuning of ``z`` half-widths, 1 at its centre."""
    return 1.0 / (1.0 + np.square(z))


def centre_of_mass(z: FloatArray | float, window: float) -> Any:
    """Of the Lorentzian at ``z`` half-widths, as far as it lies between -/+ ``window``."""
    area = np.arctan(window - z) + np.arctan(window + z)
    cut = 0.5 * np.log((1.0 + np.square(window - z)) / (1.0 + np.square(window + z)))
    return z + cut / area


def _readout(
    case: Case, step: Step, knobs: Knobs, t: FloatArray, x: FloatArray, inlet: FloatArray,
    gas: FloatArray,
) -> FloatArray:  # fmt: skip
    """(n,) V; ``inlet`` and ``gas`` (n,): there and in the manifold, over the set one."""
    relative = case.relative_concentration(step)
    for course in knobs.concentration_gain:
        x = x * (1.0 + course(t))
    if knobs.dead_width > 0:
        x = readout.blind(relative * x, knobs.dead_from, knobs.dead_width) / relative
    if knobs.shift > 0:
        rest, full = dip(knobs.detuning), dip(knobs.detuning + knobs.shift * relative)
        signal = (dip(knobs.detuning + knobs.shift * relative * x) - rest) / (full - rest)
    elif knobs.window > 0:
        ends = knobs.window_begin + knobs.window_shift * np.array([0.0, relative])
        rest, full = centre_of_mass(ends, knobs.window)
        at = knobs.window_begin + knobs.window_shift * relative * x
        signal = (centre_of_mass(at, knobs.window) - rest) / (full - rest)
    else:
        signal = x
    if knobs.wander:
        stray = np.sum([course(t) for course in knobs.wander], axis=0)
        reach = 0.3 * relative  # half-widths that the test gas shifts the line
        rest, full = dip(knobs.detuning), dip(knobs.detuning + reach)
        at = knobs.detuning + reach * x
        signal = signal + (dip(at + stray) - dip(at)) / (full - rest)
    if knobs.warming != 0:
        reach = 0.3 * relative  # as for a laser that strays
        rest, full = dip(knobs.detuning), dip(knobs.detuning + reach)
        at = knobs.detuning + reach * x
        moved = readout.self_heating(t, at, knobs.detuning, knobs.warming, knobs.warming_time)
        signal = signal + (dip(at + moved) - dip(at)) / (full - rest)
    y: FloatArray = step.y0 + step.beta * signal
    if knobs.fringe_phase is not None:
        turns = knobs.fringe_turns * x + knobs.fringe_phase(t)
        y = y + knobs.fringe * np.sin(2.0 * pi * turns)
    if knobs.grain > 0:
        turned = (relative * x)[:, None] * knobs.grain_waves + knobs.grain_begins
        passed = np.cos(turned) - np.cos(knobs.grain_begins)
        y = y * (1.0 + knobs.grain * np.sqrt(2.0 / len(knobs.grain_waves)) * passed.sum(axis=1))
    if knobs.mode_depth > 0:
        away = (relative * x - knobs.mode_at) / knobs.mode_width
        y = y - knobs.mode_depth * (dip(away) - dip(knobs.mode_at / knobs.mode_width))
    if knobs.border_gap != 0:
        border = knobs.borders[np.maximum(np.searchsorted(knobs.decisions, t, "right") - 1, 0)]
        y = y + knobs.border_gap * (relative * x > border)
    if knobs.sweep_gap > 0:
        place = np.clip(knobs.sweep_from + knobs.sweep_reach * relative * x, 0.0, 1.0)
        up = np.mod(knobs.sweep_rate * t + knobs.sweep_begin, 1.0) < 0.5
        y = y + np.where(up, 2.0, -2.0) * knobs.sweep_gap * place * (1.0 - place)
    if knobs.pulsing > 0:
        away = np.clip((relative * x - knobs.pulsing_at) / knobs.pulsing_width, -1.0, 1.0)
        rate = knobs.pulsing_rate * (1.0 + knobs.pulsing_pull * away)
        angle = 2.0 * pi * (knobs.pulsing_begin + _integral(t, rate))
        wave = np.sin(angle) + knobs.pulsing_second * np.sin(2.0 * angle)
        y = y + knobs.pulsing * np.sqrt(1.0 - away**2) * wave
    if np.isfinite(knobs.fastest):
        y = readout.no_faster(t, y, knobs.fastest)
    if np.isfinite(knobs.countable):
        y = readout.miscounted(t, y, knobs.countable, knobs.fringe_width)
    if knobs.lock_time > 0:
        y = readout.oscillating_lag(t, y, knobs.lock_time, knobs.lock_damping)
    if knobs.loop_time > 0:
        width, time = knobs.loop_width, knobs.loop_time
        y = readout.phase_locked(t, y, width, time, knobs.loop_beat)
    if knobs.creep > 0:
        y = y - knobs.creep * lags.modal(t, y - y[0], *lags.decades(knobs.creep_first))
    for course in knobs.gain:
        y = y * (1.0 + course(t))
    if knobs.bending > 0:
        y = y * (1.0 - knobs.bending) ** ((relative * (inlet - gas)) ** 2)
    if knobs.absorbed > 0:
        y = y * (1.0 - knobs.absorbed) ** (relative * inlet)
    if knobs.bow > 0:
        bow = relative * lags.modal(t, gas, *lags.slab(knobs.bow_time)) - knobs.bow_at
        y = y * (1.0 - knobs.bow) ** (bow**2 - knobs.bow_at**2)
    if knobs.glowing > 0:
        light = np.maximum(y, 0.0) / knobs.glowing_level
        freed = sensor.splitting(t, light, knobs.glowing_time)
        y = y + knobs.glowing * (knobs.glowing_level * freed**2 - y)
    if knobs.glimmer > 0:
        uses, creeps = knobs.glimmer_uses, knobs.glimmer_creeps
        left = sensor.reagent(t, relative * x, uses, creeps, knobs.glimmer_left)
        y = y + knobs.glimmer * relative * x * left
    for course in knobs.offset:
        y = y + course(t)
    if knobs.screen > 0:
        y = readout.shone_back(t, y, knobs.screen, knobs.screen_time)
    if knobs.leak_across != 0:
        y = np.hypot(y + knobs.leak_along, knobs.leak_across)
    if knobs.detector_time > 0:
        y = readout.peak_detector(t, y, knobs.detector_time)
    if knobs.log_time > 0:
        light = np.maximum(y + knobs.log_dark, 1e-6)  # it has no logarithm below
        y = readout.log_amplifier(t, light, knobs.log_time) - knobs.log_dark
    if knobs.rms_time > 0:
        y = np.sqrt(lags.steady_lag(t, y * y, knobs.rms_time))
    if knobs.heat != 0:
        used = y / knobs.heat_supply
        power = 4.0 * used * (1.0 - used)
        y = y + knobs.heat * lags.steady_lag(t, power - power[0], knobs.heat_time)
    if np.isfinite(knobs.rail):
        y = readout.overloaded(t, y, knobs.rail, knobs.rail_time, knobs.rail_charge)
    if knobs.battery is not None:
        y = np.minimum(y, knobs.battery(t))
    if knobs.crossover > 0:
        away = y - knobs.crossover_at
        y = y - np.clip(away, -0.5 * knobs.crossover, 0.5 * knobs.crossover)
    if knobs.gain_control > 0:
        level = readout.envelope(t, np.maximum(y, 1e-6), knobs.gain_attack, knobs.gain_release)
        y = y * (level[0] / level) ** knobs.gain_control
    if knobs.servo > 0:
        y = y - knobs.servo * lags.steady_lag(t, y - y[0], knobs.servo_time)
    if knobs.zero_leak > 0:
        y = y - knobs.zero_leak * np.interp(_last_turn(t, knobs.zero_begin, knobs.zero_every), t, y)
    if knobs.clamp_time > 0:
        y = readout.clamped(t, y, knobs.clamp_time, knobs.clamp_every, knobs.clamp_begin)
    if knobs.range_gap != 0:
        y = readout.two_ranges(y, knobs.range_up, knobs.range_down, knobs.range_gap)
    return y
