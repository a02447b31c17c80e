"""Every way in which one experiment's rig may depart from ideal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from bayes_sensor.campaign import FloatArray

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
    heated: Course | None = None
    """gas that the wall of a heated hose holds, in units of V and of the stream's"""
    trap: float = 0.0
    """stirred volume before the manifold, in units of V"""
    standing: Course | None = None
    """share of V that standing water takes"""
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
    ripening: float = 0.0
    """share of what the ring feels that is made of two molecules in the manifold"""
    ripening_rate: float = 1.0
    """per s, at which the set concentration makes it"""
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
    tide: float = 0.0
    """volume by which the stream past the ring goes to and fro, in units of V"""
    tide_rate: float = 1.0
    """Hz"""
    tide_begin: float = 0.0
    """turns"""
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
    crystal: float = 0.0
    """share of the highest response that a crystal adds when it covers all"""
    crystal_level: float = 0.2
    """concentration at which it neither grows nor shrinks, over the campaign's highest"""
    crystal_wait: float = 1.0
    """s of the highest concentration beyond that level that pass without a nucleus"""
    crystal_time: float = 3.0
    """s of that in which it grows across"""
    starved: float = 0.0
    """share of the response from grains which gas must reach through a film that is at rest"""
    starved_bend: float = 5.0
    """Langmuir's constant of those grains times the highest concentration"""
    starved_time: float = 3.0
    """s in which the highest concentration would fill them through that film"""
    starved_flow: float = 50.0
    """mL/s of the stream of which that is so; the film is thinner as the root of the flow"""
    stacked: float = 0.0
    """share of the response from gas that settles on itself"""
    stacked_time: float = 5.0
    """s in which as much of it leaves as the highest concentration has there"""
    unwashed: float = 0.0
    """share of the response that solvent in the pores takes away when the record begins"""
    washing: float = 0.0
    """per s, at which the highest concentration's response washes it out"""
    avalanches: float = 0.0
    """share of the response that comes in avalanches"""
    pinned_at: FloatArray = field(default_factory=lambda: np.zeros(1))
    """(m,) responses at which they come to rest, over the campaign's highest"""
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
    grain: float = 0.0
    """rms, relative, of the light that a fibre of many modes passes as the line moves"""
    grain_waves: FloatArray = field(default_factory=lambda: np.zeros(1))
    """(m,) rad, by which the highest concentration turns each pair of modes"""
    grain_begins: FloatArray = field(default_factory=lambda: np.zeros(1))
    """(m,) rad, likewise without gas"""
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
    glimmer: float = 0.0
    """V of light from the coating, under the highest concentration and with all of its reagent"""
    glimmer_uses: float = 3.0
    """s in which that uses the reagent up"""
    glimmer_creeps: float = 30.0
    """s in which more of it creeps in"""
    glimmer_left: float = 1.0
    """share of it that is there when the record begins"""
    offset: list[Course] = field(default_factory=list)
    """V, added"""
    screen: float = 0.0
    """share of the light that a screen full of it shines back on the photodiode"""
    screen_time: float = 10.0
    """s that it shows"""
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
    flattened: float = 0.0
    """share of a record's slowest waves that software takes out"""
    flattened_waves: int = 1
    """how many of them"""
    link_every: float = 0.0
    """s from bit to bit of a link that only says up or down"""
    link_begin: float = 0.0
    """s, of one of them"""
    link_least: float = 0.01
    """V, the smallest of its steps"""
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
    whine: float = 0.0
    """V, amplitude of the converter's own tone"""
    whine_rate: float = 10.0
    """Hz, a V from where it has none"""
    whine_zero: float = 0.0
    """V, there"""
    whine_begin: float = 0.0
    """turns"""
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
