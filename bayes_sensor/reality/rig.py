"""One experiment on the simulated rig, from the valve's command to the voltage.

Command -> coil and stroke of the valve -> flows -> manifold -> sensor -> ring resonance ->
receiver and filter -> recorder's clock.  Each knob left alone is an ideal part, and all of them
together give the cascade of three first-order lags.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from math import pi
from typing import Any

import numpy as np
from scipy.special import erfc

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality import stages
from bayes_sensor.reality.records import Case, Step

Course = Callable[[FloatArray], FloatArray]
"""something that changes with time: (n,) s to (n,)"""


@dataclass
class Knobs:
    """How one experiment's rig departs from ideal; the causes turn these."""

    # valve
    inertia: float = 0.0
    """mass of the valve in units of tau_v squared"""
    stroke_time: float = 0.0
    """s, from stop to stop at constant acceleration"""
    closing: float = 0.0
    stick_band: float = 0.0
    slow_opening: float = 0.0
    """share of the opening that follows slowly"""
    slow_opening_time: float = 3.0
    valve_factor: float = 1.0
    """of tau_v"""
    bounces: list[tuple[float, float]] = field(default_factory=list)
    """(s after the switch, s it lasts): the valve springs back"""
    dropped: list[tuple[float, float]] = field(default_factory=list)
    """(s, s it lasts): the coil lets the valve go"""
    sinking: float = 0.0
    """share of the stroke by which the plunger sinks back when it is only held"""
    sinking_after: float = 3.0
    """s after the switch"""
    ajar: float = 0.0
    """share of the stroke at which the valve comes to rest when it shuts"""
    ajar_until: float = 0.0
    """s, when it falls the rest of its way"""
    authority_lost: float = 0.0
    """share of the pressure that the hose takes when the valve is open"""
    grease: float = 0.0
    """drag that grease adds once it has set, in units of the valve's own"""
    grease_time: float = 20.0
    """s in which it sets"""
    grease_stroke: float = 0.2
    """share of the stroke over which it yields"""
    pilot: float = 1.0
    """share of the stroke that a servo valve's pilot hole is worth"""
    pilot_alone: float = 0.0
    """s for which it is open by itself"""
    tried: list[tuple[float, float]] = field(default_factory=list)
    """(s, s it lasts): the valve is opened out of turn"""
    snap: float = 0.0
    """share of the stroke that a bowed diaphragm does at once"""
    snap_up: float = 0.7
    """share of the pressure at which it snaps through"""
    snap_down: float = 0.3
    """likewise back"""
    check_cracks: float = 0.0
    """share of the pressure at which a check valve opens"""
    check_reseats: float = 0.0
    """likewise, at which it shuts"""
    wheel: Course | None = None
    """share of the stroke that a hand has turned the valve open, in place of the command"""
    swept: list[tuple[float, float, float]] = field(default_factory=list)
    """(s, s it lasts, concentration over the set one): other ports that a selector goes over"""
    slam: float = 0.0
    """share of the stroke from which on a closing plunger is sucked shut"""
    # flows
    following: float = 0.0
    """how far the test gas really stops when the valve is shut (1: total flow falls to carrier)"""
    made_up_late: tuple[float, float] = (0.0, 0.0)
    """s by which the carrier gas that makes up for the test gas is late, on and off"""
    mixing: bool = False
    """whether the inlet's concentration follows from the two flows while the valve moves"""
    carrier: list[Course] = field(default_factory=list)
    """factors of the carrier flow"""
    test_gas: list[Course] = field(default_factory=list)
    """factors of the test-gas flow"""
    unmixed: list[Course] = field(default_factory=list)
    """factors of the inlet's concentration"""
    seep: list[Course] = field(default_factory=list)
    """test gas from elsewhere, mL/s"""
    chill: float = 0.0
    """log of the vapour pressure that evaporation at full pressure would take away"""
    chill_time: float = 10.0
    """s in which a bath warms the evaporating liquid again"""
    stale: float = 0.0
    """share of the vapour that test gas standing in its hose has lost"""
    stale_volume: float = 10.0
    """mL of the hose"""
    stale_front: float = 2.0
    """mL over which fresh gas follows"""
    dissolved: float = 0.0
    """share of the test gas that water takes up when the valve opens"""
    dissolved_volume: float = 500.0
    """mL of test gas after which it takes up 1/e of that"""
    flow_factor: float = 1.0
    """true over set flow, both gases"""
    all_flow: list[Course] = field(default_factory=list)
    """factors of the flow of both gases"""
    # manifold and the hose before it
    saturated: float = np.inf
    """concentration, over the campaign's highest, above which vapour condenses"""
    film_time: float = 0.1
    """s in which the highest concentration brings as much as makes a closed film"""
    sticky: float = 0.0
    """gas that the hose's wall takes up, in units of V, where there is little"""
    sticky_bend: float = 2.0
    """by how much, relatively, the highest concentration leaves less to take up"""
    sticky_cells: int = 8
    laminar: float = 0.0
    """volume of a hose whose stream is laminar, in units of V"""
    flushed_back: float = 0.0
    """volume of the exhaust hose that the purge comes through, in units of V"""
    trap: float = 0.0
    """stirred volume before the manifold, in units of V"""
    pocket_fractions: tuple[float, ...] = ()
    pocket_exchange: tuple[float, ...] = ()
    """mL/s"""
    back_flow: float | None = None
    """of ``n_cells`` cells; None: one stirred volume"""
    n_cells: int = 4
    jet: float = 0.0
    """share of the flow that crosses the manifold without mixing"""
    swirl: float = 0.0
    """share of gas not yet mixed in a streak that goes round"""
    swirl_turns: float = 2.0
    """turns while the manifold's volume is exchanged once"""
    swirl_narrow: float = 2.0
    """how narrow the streak is: it passes as exp(swirl_narrow (cos - 1))"""
    swirl_begin: float = 0.0
    """turns at t0"""
    unmixed_layers: float = 0.0
    """stream over all that moves between the floor's layer and the ceiling's; 0: one volume"""
    floor: float = 0.4
    """share of V that is the floor's"""
    pit: float = 0.0
    """share of V that lies below the stream"""
    pit_falling: float = 10.0
    """mL/s that would fall into it from the set concentration above none"""
    pit_lifted: float = 1.0
    """mL/s that the stream brings out of it"""
    loop: float = 0.0
    """volume of hoses that lead from the manifold back into it, in units of V"""
    loop_pumped: float = 50.0
    """mL/s that are pumped through them"""
    left_over: float = 0.0
    """concentration in the manifold at the start, in units of this experiment's"""
    left_over_times: tuple[float, float] = (4.0, 20.0)
    bypass: float = 0.0
    bypass_delay: float = 1.0
    returned: float = 0.0
    """share of what leaves that the carrier's intake draws in again"""
    return_delay: float = 5.0
    """s"""
    return_time: float = 4.0
    """s in which the air about the intake is renewed"""
    layering: float = 0.0
    """by how much, relatively, the full step of gas slows down the exchange"""
    pairing: float = 0.0
    """per s, at which the set concentration reacts with itself"""
    corner: float = 0.0
    """share of V that is mixed with the rest while a fan runs only"""
    fan: Course | None = None
    """1 while it does, else 0"""
    riser: float = 0.0
    """share of the flow that is lost where the exhaust hose is full of the set concentration"""
    riser_volume: float = 100.0
    """mL of it"""
    stray: float = 0.0
    """share of the gas at the ring that is a neighbour's while it is his turn"""
    stray_turn: Course | None = None
    """1 while it is, else 0"""
    stray_level: float = 0.0
    """his concentration over the set one"""
    stray_flush: float = 0.1
    """s in which his gas comes and goes"""
    # sensor
    tau_factor: float = 1.0
    film_share: float = 0.0
    """share of the mean delay tau that is diffusion"""
    langmuir: float = 0.0
    """K times the highest concentration"""
    curved: bool = False
    """whether the isotherm's bend shows in the signal, too"""
    swelling: float = 0.0
    gate: float = 0.0
    """log of the sensor's rate when it is driven up, minus that when driven down; halved"""
    gate_width: float = 0.05
    coil: float = 0.0
    """volume of the duct along which the sensor lies, in units of V"""
    slow_sites: float = 0.0
    slow_sites_time: float = 10.0
    backlash: float = 0.0
    bound: float = 0.0
    """share of the response that sites which never let go can add"""
    bound_time: float = 30.0
    """s of full response in which those sites fill"""
    cages: float = 0.0
    """share of the highest response that cages which flip open add"""
    cages_at: float = 0.5
    """concentration at which half of them are open, over the campaign's highest"""
    cages_width: float = 0.05
    cages_time: float = 1.0
    """s"""
    damp: float = 0.0
    """share of the sites that water holds where there is no gas"""
    damp_time: float = 5.0
    """s in which water leaves its sites"""
    displacing: float = 0.0
    """Langmuir's constant times this experiment's concentration, of the gas against water"""
    sorption_heat: float = 0.0
    """log of the uptake that the whole response's heat takes away"""
    cooling_time: float = 3.0
    """s in which the coating loses that heat"""
    split: float = 0.0
    """share of the response from molecules that split"""
    split_time: float = 1.0
    """s in which half of them are gone from the highest concentration's"""
    converting: float = 0.0
    """share of the highest response that another phase of the whole coating adds"""
    converting_at: float = 0.2
    """concentration at which both phases are stable, over the campaign's highest"""
    converting_time: float = 10.0
    """s, twice what the highest concentration beyond that would need for all of it"""
    islands: float = 0.0
    """share of the highest response that a closed film of islands adds"""
    islands_vapour: float = 0.2
    """concentration at which islands neither grow nor shrink, over the campaign's highest"""
    islands_time: float = 1.0
    """s in which the highest concentration beyond that makes their radius 1"""
    impurity: float = 0.0
    """Langmuir's constant times an impurity, where all of it has come through its filter"""
    impurity_volume: float = 1000.0
    """mL of gas after which it comes through"""
    impurity_cells: int = 16
    """the more, the steeper is its front"""
    dried: float = 0.0
    """share of the response that is lost with the water which the test gas thins"""
    dried_volume: float = 500.0
    """mL of gas by which that comes later"""
    dried_cells: int = 2
    """the more, the steeper is its front"""
    rim: float = 0.0
    """share of the response from a glassy rim"""
    rim_time: float = 3.0
    """s in which the highest concentration's front goes through it"""
    rim_back: float = 1.0
    """s in which gas leaves it"""
    pores: float = 0.0
    """share of the highest response that full pores add"""
    pores_vapour: float = 0.7
    """relative pressure of the highest concentration"""
    pores_at: float = 0.4
    """relative pressure at which half of the pores have filled"""
    pores_width: float = 0.1
    """standard deviation of its logarithm among them"""
    bonds: float = 0.0
    """share of the highest response that bonds of uneven strength add"""
    bonds_bend: float = 2.0
    """log of how much more slowly the gas settles on all of them than on the first"""
    bonds_time: float = 1.0
    """s of a small change about the highest concentration"""
    glow: float = 0.0
    """share of the highest response a unit of warmth, in which burning grows by e"""
    glow_burns: float = 0.1
    """warmth that the highest concentration would make by burning if it stayed cold"""
    glow_brought: float = 10.0
    """likewise by burning all that diffusion brings"""
    glow_time: float = 1.0
    """s in which the coating loses its warmth"""
    flares: float = 0.0
    """share of the highest response that the heat of burning the highest concentration moves"""
    flares_oxidise: float = 3.0
    """s in which a burning metal oxidises"""
    flares_reduce: float = 2.0
    """s in which the highest concentration reduces it"""
    flares_from: float = 0.3
    """share of oxide below which the gas burns again"""
    flares_until: float = 0.7
    """likewise, above which it goes out"""
    flares_cooling: float = 0.3
    """s in which the coating loses its warmth"""
    blisters: float = 0.0
    """share of the highest response that a coating full of blisters takes away"""
    blisters_level: float = 0.2
    """concentration beyond that outside that it holds down, over the campaign's highest"""
    blisters_soak: float = 5.0
    """s in which gas dissolves below it"""
    blisters_time: float = 1.0
    """s in which blisters form and empty"""
    salt: float = 0.0
    """share of the highest response that the water of a salt adds"""
    salt_vapour: float = 0.7
    """water's activity in the highest concentration"""
    salt_dissolves: float = 0.4
    """likewise, above the salt's saturated solution"""
    salt_comes_out: float = 0.2
    """likewise, at which a supersaturated one crystallises"""
    salt_time: float = 0.2
    """s in which an activity of 1 brings as much water as there is salt"""
    chains: float = 0.0
    """share of the highest response that gas bound in chains adds"""
    chains_level: float = 0.2
    """concentration at which chains neither grow nor come apart, over the campaign's highest"""
    chains_seeds: float = 0.01
    """how much more slowly gas binds without a chain's end"""
    chains_time: float = 0.5
    """s in which the highest concentration beyond that lets chains grow by e"""
    stacked: float = 0.0
    """share of the response from gas that settles on itself"""
    stacked_time: float = 5.0
    """s in which as much of it leaves as the highest concentration has there"""
    unwashed: float = 0.0
    """share of the response that solvent in the pores takes away when the record begins"""
    washing: float = 0.0
    """per s, at which the highest concentration's response washes it out"""
    drop: Course | None = None
    """s in which gas gets into a drop on the ring, or out of it"""
    loosened: float = 0.0
    """share of the response that a loosened coating takes away"""
    loosening_time: float = 10.0
    """s in which a tight one begins to loosen"""
    loosening_bend: float = 2.0
    """log of how much faster it moves when the highest concentration has loosened it"""
    poisoning: float = 0.0
    """per s, at which sites die that the highest concentration has taken"""
    alive: float = 1.0
    """share of the sites that are left when the record begins"""
    reference: float = 0.0
    """share of the response that a reference ring under its cap takes away"""
    reference_time: float = 30.0
    """s, the cap's thickness squared over its diffusivity"""
    # readout
    shift: float = 0.0
    """resonance shift at the highest concentration in half-widths; 0: straight readout"""
    detuning: float = -0.8
    window: float = 0.0
    """half-widths, half of the window whose centre of mass is read"""
    window_begin: float = 0.0
    """half-widths from its middle to the line without gas"""
    window_shift: float = 0.0
    """half-widths by which the highest concentration shifts the line in it"""
    wander: list[Course] = field(default_factory=list)
    """half-widths by which the laser strays"""
    warming: float = 0.0
    """half-widths by which the light moves the line when all of it is absorbed"""
    warming_time: float = 1.0
    """s"""
    gain: list[Course] = field(default_factory=list)
    """relative changes of the optical power"""
    bending: float = 0.0
    """share of the light that is lost where the highest concentration meets none"""
    absorbed: float = 0.0
    """share of the light that the highest concentration absorbs in the inlet"""
    bow: float = 0.0
    """share of the light that is lost where a coating full of the highest one bows the chip"""
    bow_at: float = 0.0
    """bow of the most light, over that of the highest concentration"""
    bow_time: float = 5.0
    """s, the coating's thickness squared over its diffusivity"""
    glowing: float = 0.0
    """share of the light that comes by way of a phosphor"""
    glowing_time: float = 2.0
    """s, twice what it takes to follow a small change about its level"""
    glowing_level: float = 1.0
    """V, that level"""
    concentration_gain: list[Course] = field(default_factory=list)
    """relative changes of the response alone"""
    fringe: float = 0.0
    """V, amplitude of an interference"""
    fringe_turns: float = 0.0
    """by which the full response turns its phase"""
    fringe_phase: Course | None = None
    """turns"""
    mode_depth: float = 0.0
    """V that a second mode's line takes away"""
    mode_at: float = 0.4
    """concentration at which it does, over the campaign's highest"""
    mode_width: float = 0.05
    """half of its width, likewise"""
    dead_from: float = 0.0
    """concentration at which the line comes to lie on dead pixels, over the campaign's highest"""
    dead_width: float = 0.0
    """of them, likewise"""
    border_gap: float = 0.0
    """V by which the laser's mode above its border reads more"""
    borders: FloatArray = field(default_factory=lambda: np.zeros(1))
    """(m,) concentrations above which it takes that, over the campaign's highest"""
    decisions: FloatArray = field(default_factory=lambda: np.zeros(1))
    """(m,) s, from which on each of them holds"""
    sweep_gap: float = 0.0
    """V by which the two ways of a sweep differ at most"""
    sweep_rate: float = 5.0
    """Hz, forth and back"""
    sweep_from: float = 0.1
    """share of the sweep at which the line lies without gas"""
    sweep_reach: float = 0.5
    """share of it by which the highest concentration shifts the line"""
    sweep_begin: float = 0.0
    """turns"""
    pulsing: float = 0.0
    """V, the largest amplitude at which the ring pulses by itself"""
    pulsing_at: float = 0.5
    """concentration at which it does so most, over the campaign's highest"""
    pulsing_width: float = 0.2
    """half the width of where it does, likewise"""
    pulsing_rate: float = 3.0
    """Hz in the middle"""
    pulsing_pull: float = 0.0
    """by how much more, relatively, at the upper end"""
    pulsing_second: float = 0.0
    """share of its second harmonic"""
    pulsing_begin: float = 0.0
    """turns"""
    fastest: float = np.inf
    """V/s, which the reading follows at most"""
    countable: float = np.inf
    """V/s of fringes that are counted at most"""
    fringe_width: float = 0.1
    """V a fringe"""
    lock_time: float = 0.0
    """s, one over the angular frequency at which the laser's lock hunts"""
    lock_damping: float = 0.3
    """of that oscillation over critical"""
    creep: float = 0.0
    """share of its way by which the laser's piezo creeps on in a decade of time"""
    creep_first: float = 0.1
    """s, the first of four decades of that"""
    loop_width: float = 0.1
    """V by which a phase error of a quarter of a turn moves a loop's oscillator at once"""
    loop_time: float = 0.0
    """s in which it moves it by as much again"""
    loop_beat: float = 0.01
    """V s, by which the oscillator is off while its phase falls back by a radian"""
    offset: list[Course] = field(default_factory=list)
    """V, added"""
    # receiver and recorder
    leak_along: float = 0.0
    """V that leak into a lock-in amplifier, in phase with the light"""
    leak_across: float = 0.0
    """V likewise, a quarter of a turn off; not 0: the magnitude of all is read"""
    detector_time: float = 0.0
    """s in which a peak detector lets go of the voltage"""
    log_time: float = 0.0
    """s V, by which a logarithmic amplifier lags, over its input"""
    log_dark: float = 0.0
    """V, of its input in the dark"""
    rms_time: float = 0.0
    """s over which the receiver averages the square of the voltage"""
    heat: float = 0.0
    """V by which the amplifier's zero shifts at the most heat it can make"""
    heat_supply: float = 5.0
    """V, of the amplifier"""
    heat_time: float = 3.0
    """s"""
    rail: float = np.inf
    """V, the most that the amplifier gives"""
    rail_time: float = 1.0
    """s in which what is too much charges its loop"""
    rail_charge: float = 0.0
    """V, the most of that charge"""
    battery: Course | None = None
    """V, the most that the amplifier gives as its battery runs down"""
    crossover: float = 0.0
    """V of the amplifier's way for which neither of its output transistors conducts"""
    crossover_at: float = 1.0
    """V in the middle of that"""
    gain_control: float = 0.0
    """share of the level's logarithm that an automatic gain takes off"""
    gain_attack: float = 1.0
    """s in which it follows upwards"""
    gain_release: float = 10.0
    """s in which it follows downwards"""
    servo: float = 0.0
    """share of a change that the receiver pulls back"""
    servo_time: float = 30.0
    """s"""
    zero_leak: float = 0.0
    """share of the light at each zero that is subtracted until the next one"""
    zero_every: float = 10.0
    """s from one to the next"""
    zero_begin: float = 0.0
    """s, of one of them"""
    clamp_time: float = 0.0
    """s in which the capacitor before the receiver charges itself up"""
    clamp_every: float = 5.0
    """s from one time that it is emptied to the next"""
    clamp_begin: float = 0.0
    """s, of one of them"""
    range_up: float = 0.0
    """V, above which the recorder takes its upper range"""
    range_down: float = 0.0
    """V, below which it goes back"""
    range_gap: float = 0.0
    """V by which the upper range reads more"""
    blank_up: float = 0.0
    """V, above which a meter takes its upper range"""
    blank_down: float = 0.0
    """V, below which it goes back"""
    blank_lasts: float = 0.0
    """s for which its reading stands meanwhile"""
    distrust: float = 0.0
    """s for which a driver shows its last good reading while the signal is too steep"""
    distrust_band: float = 0.1
    """V by which it may differ"""
    distrust_within: float = 0.1
    """s, from what it was that long before"""
    lead: float = 0.0
    """s, by which a meter multiplies the slope that it adds"""
    lead_lag: float = 0.1
    """s behind which it takes the slope"""
    filter_time: float = 0.0
    """s, total delay of a four-pole anti-alias filter"""
    parabola: float = 0.0
    """s of readings through which a meter draws a parabola, whose middle it shows"""
    pen_late: float = 0.0
    """s by which a pen on a pivot is late at its largest swing"""
    pen_rest: float = 0.0
    """V in the middle of its arc"""
    pen_reach: float = 1.0
    """V of its largest swing"""
    pen_sine: float = 0.5
    """sine of that swing's angle"""
    repeats: FloatArray | None = None
    """(m,) s by which the records that are averaged are late"""
    average_window: float = 0.0
    """V by which a reading may be off a meter's running average before that begins anew"""
    average_time: float = 2.0
    """s of that average"""
    kept_band: float = 0.0
    """V by which a reading must differ from the last one that a historian kept, to be kept"""
    kept_longest: float = 10.0
    """s from one to the next of those that it keeps anyway"""
    kept_begin: float = 0.0
    """s, of one of them"""
    floor_climbs: float = 0.0
    """V/s by which the baseline that software subtracts climbs at most"""
    archive: float = 0.0
    """s of record that an archive packs into a block"""
    archive_kept: int = 3
    """cosines that it keeps of each"""
    archive_begin: float = 0.0
    """s, of one of them"""
    charge: float = 0.0
    """V s that a converter collects for each of its readings"""
    charge_begin: float = 0.0
    """share of one that it has when it is first looked at"""
    hold: float = 0.0
    """s for which an instrument's output stands still between its readings"""
    hold_begin: float = 0.0
    """s, of one of the readings"""
    readings: FloatArray | None = None
    """(m,) s, the only times at which a logger reads; it draws lines between them"""
    bit: float = 0.0
    """V that the recorder's missing bit is worth"""
    bit_zero: float = 0.0
    """V where its code is 0"""
    pair_gain: float = 0.0
    """relative, by which every other sample's converter reads more"""
    pair_zero: float = 0.0
    """V, likewise"""
    coarse_step: float = 1.0
    """V between the converter's coarse steps"""
    coarse_begin: float = 0.0
    """V, where one of them is"""
    coarse_gain: float = 0.0
    """relative, by which what lies above a coarse step reads more"""
    clock: Course | None = None
    """true time of what the recorder calls ``t``"""
    marks: list[float] = field(default_factory=list)
    """s, true times at which something else jumps"""


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
        pieces.append(event + stages.growing_steps(end - event, quick))
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
        inlet = stages.sticky_wall(t, inlet, held, bend, knobs.sticky_cells)
    if knobs.laminar > 0:
        inlet = stages.laminar(_integral(t, flow), inlet, knobs.laminar * case.V)
    if knobs.flushed_back > 0:
        # a plateau's gas is in the hose, as is in the inlet before the valve shuts
        through = stages.laminar(_integral(t, flow), inlet, knobs.flushed_back * case.V)
        inlet = np.where(t < step.tf, inlet, through)
    if knobs.trap > 0:
        inlet = stages.lag(t, inlet, knobs.trap * case.V / (0.5 * (flow[1:] + flow[:-1])), 0.0)
    if np.isfinite(knobs.saturated):
        relative = case.relative_concentration(step)
        inlet = stages.condensing(t, inlet, knobs.saturated / relative, knobs.film_time / relative)
    gas = _manifold(case, step, knobs, t, inlet, flow)
    if knobs.returned > 0:
        late = np.interp(t - knobs.return_delay, t, gas, left=0.0)
        drawn = stages.lag(t, late, np.full(len(t) - 1, knobs.return_time), 0.0)
        carried = knobs.returned * step.carrier_flow / step.total_flow
        gas = _manifold(case, step, knobs, t, inlet + carried * drawn, flow)
    if knobs.coil > 0:
        passed, volume = _integral(t, flow), knobs.coil * case.V
        had = _integral(passed, gas)  # what has passed, times how much gas is in it
        gas = (had - np.interp(passed - volume, passed, had)) / volume
    if knobs.stray_turn is not None:
        his = knobs.stray * knobs.stray_turn(t) * (knobs.stray_level - gas)
        gas = gas + stages.lag(t, his, np.full(len(t) - 1, knobs.stray_flush), 0.0)
    response = _sensor(case, step, knobs, t, gas)
    if knobs.impurity > 0:
        late = stages.retarded(t, gas, flow, knobs.impurity_volume, knobs.impurity_cells)
        response = response / (1.0 + knobs.impurity * late)
    if knobs.dried > 0:
        late = stages.retarded(t, gas, flow, knobs.dried_volume, knobs.dried_cells)
        response = response - knobs.dried * stages.steady_lag(t, late, case.tau)
    y = _readout(case, step, knobs, t, response, inlet, gas)
    if knobs.blank_lasts > 0:
        y = stages.blanked(t, y, knobs.blank_up, knobs.blank_down, knobs.blank_lasts)
    if knobs.distrust > 0:
        before = np.interp(t - knobs.distrust_within, t, y)
        y = stages.distrusted(t, y, before, knobs.distrust_band, knobs.distrust)
    if knobs.lead > 0:
        slope = (y - stages.steady_lag(t, y, knobs.lead_lag)) / knobs.lead_lag
        y = y + knobs.lead * slope
    if knobs.filter_time > 0:
        for _ in range(4):
            y = stages.steady_lag(t, y, 0.25 * knobs.filter_time)
    if knobs.parabola > 0:
        y = stages.parabola(t, y, knobs.parabola)
    if knobs.pen_late != 0:
        swing = np.clip(knobs.pen_sine * (y - knobs.pen_rest) / knobs.pen_reach, -1.0, 1.0)
        late = (1.0 - np.sqrt(1.0 - swing**2)) / (1.0 - np.sqrt(1.0 - knobs.pen_sine**2))
        y = np.interp(t, np.maximum.accumulate(t + knobs.pen_late * late), y)
    if knobs.repeats is not None:
        y = np.mean([np.interp(t - late, t, y) for late in knobs.repeats], axis=0)
    if knobs.average_window > 0:
        y = stages.windowed_average(t, y, knobs.average_time, knobs.average_window)
    if knobs.kept_band > 0:
        kept = stages.kept(t, y, knobs.kept_band, knobs.kept_longest, knobs.kept_begin)
        y = np.interp(t, t[kept], y[kept])
    if knobs.floor_climbs > 0:
        # the lowest of all lines that climb from a reading so far
        climbed = knobs.floor_climbs * t
        y = y - (np.minimum.accumulate(y - climbed) + climbed - y[0])
    if knobs.archive > knobs.archive_kept * step.interval:  # else there is nothing to throw away
        begin, length = knobs.archive_begin, knobs.archive
        y = stages.cosine_blocks(t, y, begin, length, knobs.archive_kept)
    light = np.maximum(y, 0.02 * np.max(y))  # some current leaks in the dark
    # where all fillings are shorter than the recorder's interval they are not told apart
    if knobs.charge > step.interval * max(float(np.min(light)), 0.0):
        y = stages.counted(t, light, knobs.charge, knobs.charge_begin)
    shown = true
    if knobs.hold > 0:
        shown = np.maximum(_last_turn(true, knobs.hold_begin, knobs.hold), t[0])
    seen = np.interp(shown, t, y)
    if knobs.readings is not None:
        seen = np.interp(true, knobs.readings, np.interp(knobs.readings, t, y))
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
        x = stages.heavy_valve(t, first, last, tau_v, knobs.inertia)
    elif knobs.grease > 0:
        sets, yields = knobs.grease_time, knobs.grease_stroke
        x = stages.greased_valve(t, first, last, tau_v, knobs.grease, sets, yields)
    else:
        x = stages.valve(t, first, last, tau_v, knobs.closing)
    if knobs.slow_opening > 0:
        slow = np.zeros_like(x)
        for factor in (0.6, 1.6):
            slow += 0.5 * stages.valve(t, first, last, factor * knobs.slow_opening_time, 0.0)
        x = (1.0 - knobs.slow_opening) * x + knobs.slow_opening * slow
    if knobs.stick_band > 0:
        x = stages.stick_slip(x, knobs.stick_band)
    if knobs.snap > 0:
        snapped = stages.two_ranges(x, knobs.snap_up, knobs.snap_down, 1.0) - x
        x = (1.0 - knobs.snap) * x + knobs.snap * snapped
    if knobs.check_cracks > 0:
        shut = 1.0 - knobs.check_reseats
        passing = stages.two_ranges(x, knobs.check_cracks, knobs.check_reseats, 1.0) - x
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
        inlet = inlet * np.exp(-stages.evaporating(t, opening, knobs.chill, knobs.chill_time))
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
    if knobs.pocket_fractions:
        gas = stages.pockets(
            t, inlet, flow, case.V, np.array(knobs.pocket_fractions),
            np.array(knobs.pocket_exchange), 0.0,
        )  # fmt: skip
    elif knobs.pit > 0:
        gas = stages.pit(t, inlet, flow, case.V, knobs.pit, knobs.pit_falling, knobs.pit_lifted)
    elif knobs.unmixed_layers > 0:
        eddies = 1.0 / knobs.unmixed_layers - 1.0
        gas = stages.two_layers(t, inlet, flow / case.V, knobs.floor, eddies)
    elif knobs.back_flow is not None:
        gas = stages.cells(t, inlet, flow, case.V, knobs.n_cells, knobs.back_flow)
    elif knobs.loop > 0:
        round_trip = knobs.loop * case.V / knobs.loop_pumped
        gas = stages.looped(t, inlet, flow, case.V, knobs.loop_pumped, round_trip)
    elif knobs.riser > 0:
        gas = stages.weighed_down(t, inlet, flow, case.V, knobs.riser_volume, knobs.riser)
    else:
        passage = case.V / (0.5 * (flow[1:] + flow[:-1]))
        if knobs.layering > 0:
            gas = stages.layers(t, inlet, passage, knobs.layering, 0.0)
        elif knobs.fan is not None:
            runs = knobs.fan(0.5 * (t[1:] + t[:-1]))
            gas = stages.fanned(t, inlet, passage, runs, knobs.corner)
        elif knobs.pairing > 0:
            gas = stages.pairing(t, inlet, passage, knobs.pairing)
            # the plateau is what it is: x + kappa x^2 = 1 with kappa the rate over the exchange's
            kappa = knobs.pairing * case.V / step.total_flow
            gas = gas * 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * kappa))
        else:
            gas = stages.lag(t, inlet, passage, 0.0)
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
        gas = stages.lag(t, gas, np.maximum(thick, 1e-6), float(gas[0]))  # or it is gone
    if knobs.film_share > 0:
        times, weights = stages.layered_film(tau * knobs.film_share)
        gas = stages.modal(t, gas, times, weights)
        tau *= 1.0 - knobs.film_share
    if tau <= 0:
        x = gas
    elif knobs.langmuir > 0:
        K = knobs.langmuir
        filled = stages.langmuir(t, relative * gas, tau, K, 0.0, 0.0, 1.0)
        if knobs.curved:
            x = filled * (1.0 + K * relative) / relative
        else:  # a reading that was calibrated against concentration
            x = filled / (1.0 - K * filled) / relative
    elif knobs.sorption_heat > 0:
        x = stages.warming_coating(t, gas, tau, knobs.sorption_heat, knobs.cooling_time)
    elif knobs.swelling != 0 or knobs.gate != 0:
        x = stages.langmuir(t, gas, tau, 0.0, knobs.swelling, knobs.gate, knobs.gate_width)
    else:
        x = stages.steady_lag(t, gas, tau)
    if knobs.slow_sites > 0:
        slow = np.zeros_like(x)
        for factor in (0.5, 1.8):
            K = 0.3
            time = factor * knobs.slow_sites_time
            site = stages.langmuir(t, relative * gas, time, K, 0.0, 0.0, 1.0)
            slow += 0.5 * site * (1.0 + K * relative) / relative
        x = (1.0 - knobs.slow_sites) * x + knobs.slow_sites * slow
    if knobs.split > 0:
        halves = stages.splitting(t, relative * gas, knobs.split_time)
        x = (1.0 - knobs.split) * x + knobs.split * halves / np.sqrt(relative)
    if knobs.rim > 0:
        rim = stages.glassy(t, gas, relative / knobs.rim_time, knobs.rim_back)
        x = (1.0 - knobs.rim) * x + knobs.rim * rim
    if knobs.backlash > 0:
        x = x + knobs.backlash * (stages.play(x, 0.25) - x)
    if knobs.bound > 0:
        dose = _integral(t, x)
        x = x - knobs.bound * np.expm1(-dose / knobs.bound_time)
    if knobs.cages > 0:
        beyond = (relative * gas - knobs.cages_at) / knobs.cages_width
        shut = 1.0 / (1.0 + np.exp(knobs.cages_at / knobs.cages_width))  # open without any gas
        open_ = (1.0 / (1.0 + np.exp(-beyond)) - shut) / (1.0 - shut)
        x = x + knobs.cages / relative * stages.steady_lag(t, open_, knobs.cages_time)
    if knobs.damp > 0:
        water = stages.displaced(t, knobs.displacing * x, knobs.damp, knobs.damp_time)
        x = x * (1.0 - water) / (1.0 - knobs.damp)
    if knobs.converting > 0:
        turned = stages.moving_fronts(
            t, relative * gas - knobs.converting_at, knobs.converting_time
        )
        x = x + knobs.converting / relative * turned
    if knobs.islands > 0:
        drive = relative * gas - knobs.islands_vapour
        x = x + knobs.islands / relative * stages.islands(t, drive, knobs.islands_time)
    if knobs.pores > 0:
        pressure = np.maximum(knobs.pores_vapour * relative * gas, 0.0)
        filled = np.log(np.maximum(stages.capillary(pressure), 1e-9) / knobs.pores_at)
        share = 0.5 * erfc(-filled / (np.sqrt(2.0) * knobs.pores_width))
        x = x + knobs.pores / relative * stages.steady_lag(t, share, case.tau)
    if knobs.bonds > 0:
        bound = stages.elovich(t, relative * gas, knobs.bonds_bend, knobs.bonds_time)
        x = x + knobs.bonds / relative * bound
    if knobs.glow > 0:
        burns, brought = knobs.glow_burns, knobs.glow_brought
        warmth = stages.burning(t, relative * gas, burns, brought, knobs.glow_time)
        x = x + knobs.glow / relative * warmth
    if knobs.flares > 0:
        warmth = stages.flaring(
            t, relative * gas, knobs.flares_oxidise, knobs.flares_reduce,
            knobs.flares_from, knobs.flares_until, knobs.flares_cooling,
        )  # fmt: skip
        x = x + knobs.flares / relative * warmth
    if knobs.blisters > 0:
        dissolved = stages.steady_lag(t, gas, knobs.blisters_soak)
        beyond = relative * (dissolved - gas) - knobs.blisters_level
        lifting = np.maximum(beyond, 0.0) / (1.0 - knobs.blisters_level)
        x = x - knobs.blisters / relative * stages.steady_lag(t, lifting, knobs.blisters_time)
    if knobs.salt > 0:
        water = stages.deliquescing(
            t, knobs.salt_vapour * relative * gas, knobs.salt_dissolves, knobs.salt_comes_out,
            knobs.salt_time,
        )  # fmt: skip
        full = knobs.salt_vapour / (1.0 - knobs.salt_vapour)
        x = x + knobs.salt / relative * water / full
    if knobs.chains > 0:
        bound = stages.chained(
            t, relative * gas, knobs.chains_level, knobs.chains_seeds, knobs.chains_time
        )
        x = x + knobs.chains / relative * bound
    if knobs.loosened > 0:
        bend = knobs.loosening_bend * relative
        x = x - knobs.loosened * stages.loosening(t, x, bend, knobs.loosening_time)
    if knobs.stacked > 0:
        # the highest of all lines that go down evenly from what has settled so far
        gone = t / (relative * knobs.stacked_time)
        x = x + knobs.stacked * (np.maximum.accumulate(x + gone) - gone - x)
    if knobs.unwashed > 0:
        x = x * (1.0 - knobs.unwashed * np.exp(-knobs.washing * relative * _integral(t, x)))
    if knobs.poisoning > 0:
        held = relative * _integral(t, x)
        x = knobs.alive * x * np.exp(-knobs.poisoning * held)
    if knobs.reference > 0:
        x = x - knobs.reference * stages.modal(t, gas, *stages.slab(knobs.reference_time))
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
        x = stages.blind(relative * x, knobs.dead_from, knobs.dead_width) / relative
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
        moved = stages.self_heating(t, at, knobs.detuning, knobs.warming, knobs.warming_time)
        signal = signal + (dip(at + moved) - dip(at)) / (full - rest)
    y: FloatArray = step.y0 + step.beta * signal
    if knobs.fringe_phase is not None:
        turns = knobs.fringe_turns * x + knobs.fringe_phase(t)
        y = y + knobs.fringe * np.sin(2.0 * pi * turns)
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
        y = stages.no_faster(t, y, knobs.fastest)
    if np.isfinite(knobs.countable):
        y = stages.miscounted(t, y, knobs.countable, knobs.fringe_width)
    if knobs.lock_time > 0:
        y = stages.oscillating_lag(t, y, knobs.lock_time, knobs.lock_damping)
    if knobs.loop_time > 0:
        width, time = knobs.loop_width, knobs.loop_time
        y = stages.phase_locked(t, y, width, time, knobs.loop_beat)
    if knobs.creep > 0:
        y = y - knobs.creep * stages.modal(t, y - y[0], *stages.decades(knobs.creep_first))
    for course in knobs.gain:
        y = y * (1.0 + course(t))
    if knobs.bending > 0:
        y = y * (1.0 - knobs.bending) ** ((relative * (inlet - gas)) ** 2)
    if knobs.absorbed > 0:
        y = y * (1.0 - knobs.absorbed) ** (relative * inlet)
    if knobs.bow > 0:
        bow = relative * stages.modal(t, gas, *stages.slab(knobs.bow_time)) - knobs.bow_at
        y = y * (1.0 - knobs.bow) ** (bow**2 - knobs.bow_at**2)
    if knobs.glowing > 0:
        light = np.maximum(y, 0.0) / knobs.glowing_level
        freed = stages.splitting(t, light, knobs.glowing_time)
        y = y + knobs.glowing * (knobs.glowing_level * freed**2 - y)
    for course in knobs.offset:
        y = y + course(t)
    if knobs.leak_across != 0:
        y = np.hypot(y + knobs.leak_along, knobs.leak_across)
    if knobs.detector_time > 0:
        y = stages.peak_detector(t, y, knobs.detector_time)
    if knobs.log_time > 0:
        light = np.maximum(y + knobs.log_dark, 1e-6)  # it has no logarithm below
        y = stages.log_amplifier(t, light, knobs.log_time) - knobs.log_dark
    if knobs.rms_time > 0:
        y = np.sqrt(stages.steady_lag(t, y * y, knobs.rms_time))
    if knobs.heat != 0:
        used = y / knobs.heat_supply
        power = 4.0 * used * (1.0 - used)
        y = y + knobs.heat * stages.steady_lag(t, power - power[0], knobs.heat_time)
    if np.isfinite(knobs.rail):
        y = stages.overloaded(t, y, knobs.rail, knobs.rail_time, knobs.rail_charge)
    if knobs.battery is not None:
        y = np.minimum(y, knobs.battery(t))
    if knobs.crossover > 0:
        away = y - knobs.crossover_at
        y = y - np.clip(away, -0.5 * knobs.crossover, 0.5 * knobs.crossover)
    if knobs.gain_control > 0:
        level = stages.envelope(t, np.maximum(y, 1e-6), knobs.gain_attack, knobs.gain_release)
        y = y * (level[0] / level) ** knobs.gain_control
    if knobs.servo > 0:
        y = y - knobs.servo * stages.steady_lag(t, y - y[0], knobs.servo_time)
    if knobs.zero_leak > 0:
        y = y - knobs.zero_leak * np.interp(_last_turn(t, knobs.zero_begin, knobs.zero_every), t, y)
    if knobs.clamp_time > 0:
        y = stages.clamped(t, y, knobs.clamp_time, knobs.clamp_every, knobs.clamp_begin)
    if knobs.range_gap != 0:
        y = stages.two_ranges(y, knobs.range_up, knobs.range_down, knobs.range_gap)
    return y
