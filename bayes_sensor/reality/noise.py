"""Noise of the simulated rig: sums of processes that are each drawn by their own recursion."""

from __future__ import annotations

from math import ceil, cos, exp, pi, sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import erfc, erfcx, gamma, j0, kv, spence

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.reality.records import Component, NoiseLaw

OPEN_LAWS = (
    "ar1", "white", "ar1_slow", "arma", "pink", "band_limited", "oscillating", "telegraph",
    "sliding_mean", "shot", "gusty", "double_sampling", "echo", "sparks",
    "turbulent", "zeroed_walk", "pulsing", "ac_coupled", "interpolated", "etalon",
    "molecules", "speckle", "whistling", "notched", "interleaved", "charging",
    "noise_shaping", "dusty", "roller_pump", "beam_crossing", "one_bit", "intermittent",
    "conducting", "latching", "waning", "rattling", "coded", "two_paced",
    "decimated", "mode_hopping", "drilling",
    "hunting_fan", "chattering_relay", "replugged_fibre",
    "two_fans", "slow_meter", "crackling_cable",
    "sparkling_codes", "weighed_readings", "dimmed_lamps",
    "overcorrecting_zero", "rectified_pickup", "glassy_dielectric",
    "worn_gear", "salty_electrode", "trembling_mirror",
    "flapping_damper", "startled_receiver", "bubbling_nozzle",
    "resting_ball", "drifting_balance", "sinking_crests",
    "median_of_three", "faded_phase", "charged_drops",
    "restarted_mean", "slowing_stream", "weak_reference",
    "dry_slide", "larger_of_two", "repeated_packets",
)  # fmt: skip
"""laws for every run; ``ar1`` and ``white`` are within the package's own noise model"""
RESERVE_LAWS = ("railed_microphone", "three_stages", "fitful_bearing")
"""kept out of every run but the last"""
HEAVY_TAILED = (
    "shot", "gusty", "sparks", "pulsing", "speckle", "interleaved", "dusty", "intermittent",
    "waning", "two_paced", "drilling", "crackling_cable", "sparkling_codes",
    "startled_receiver", "bubbling_nozzle", "drifting_balance", "median_of_three",
    "restarted_mean", "weak_reference", "repeated_packets", "fitful_bearing",
)  # fmt: skip
"""laws whose innovations have clearly more large values than a Gaussian's: pulses, changing
loudness, readings that are shown again, leaps, and quotients"""
MEDIAN_CORRELATION = (0.552838, 0.262352)
"""of the medians of three of white noise, a sample and two apart, by quadrature"""


def draw_law(name: str, rng: np.random.Generator, sigma: float) -> NoiseLaw:
    """A law of one kind with correlations and sizes of its own; ``sigma`` (V) is its total rms.

    Between a fifth and all of the variance at the highest concentration is there at zero
    concentration, too.
    """
    quiet = rng.uniform(0.2, 1.0)
    sigma0, sigma1 = sigma * sqrt(quiet), sigma * sqrt(1.0 - quiet)
    short = exp(rng.uniform(np.log(5e-4), np.log(2e-2)))  # s
    share = exp(rng.uniform(np.log(0.004), np.log(0.03)))
    octaves = 2.0 ** np.arange(-6, 8)  # s
    parts = {
        "white": (Component(1.0),),
        "ar1": (Component(1.0, short),),
        "ar1_slow": (
            Component(1.0 - share, short),
            Component(share, exp(rng.uniform(np.log(0.4), np.log(2.5)))),
        ),
        "arma": (
            Component(0.35 + 0.3 * share, exp(rng.uniform(np.log(0.01), np.log(0.08)))),
            Component(0.65 - 0.3 * share),
        ),
        "pink": (
            Component(1.0 - share, short),
            *(Component(share / len(octaves), float(time)) for time in octaves),
        ),
        "band_limited": (Component(1.0, 2.0 * short, shape="smooth"),),
        "oscillating": (
            Component(1.0 - 5.0 * share, short),
            Component(5.0 * share, rng.uniform(0.05, 0.4), rng.uniform(2.0, 12.0)),
        ),
        "telegraph": (
            Component(1.0 - share, short),
            Component(share, exp(rng.uniform(np.log(0.1), np.log(3.0))), shape="telegraph"),
        ),
    }
    # from a generator of their own: what is drawn after the law stays what it was without these
    (own,) = rng.spawn(1)
    averaged = own.uniform(0.5, 0.9)
    parts |= {
        "sliding_mean": (
            Component(1.0 - averaged),
            Component(averaged, exp(own.uniform(np.log(0.01), np.log(0.08))), shape="window"),
        ),
        "shot": (
            Component(0.4),
            Component(0.6, short, shape="shot", rate=exp(own.uniform(np.log(0.1), np.log(2.0)))),
        ),
        "gusty": (
            Component(
                1.0, short, shape="gusts", depth=own.uniform(0.5, 0.95),
                gust_time=exp(own.uniform(np.log(0.1), np.log(4.0))),
            ),
        ),
    }  # fmt: skip
    slow, sparking = own.uniform(0.05, 0.2), own.uniform(0.3, 0.6)
    parts |= {
        "double_sampling": (
            Component(1.0 - slow, shape="difference", depth=own.uniform(0.4, 0.9)),
            Component(slow, exp(own.uniform(np.log(0.02), np.log(0.3)))),
        ),
        "echo": (
            Component(
                1.0, exp(own.uniform(np.log(2e-3), np.log(2e-2))),
                1.0 / exp(own.uniform(np.log(6e-3), np.log(4e-2))),
                shape="echo", depth=own.uniform(0.3, 0.8),
            ),
        ),
        "sparks": (
            Component(1.0 - sparking, short),
            Component(
                sparking, exp(own.uniform(np.log(3e-3), np.log(3e-2))),
                exp(own.uniform(np.log(20.0), np.log(200.0))), shape="sparks",
                rate=exp(own.uniform(np.log(0.05), np.log(0.5))),
            ),
        ),
    }  # fmt: skip
    stirred = own.uniform(0.05, 0.3)
    parts |= {
        # density fluctuations of a turbulent stream carried past the ring
        "turbulent": (
            Component(1.0 - stirred, short),
            Component(stirred, exp(own.uniform(np.log(0.02), np.log(0.3))), shape="turbulent"),
        ),
        # an instrument that wanders and sets its zero anew by the clock
        "zeroed_walk": (
            Component(1.0 - share, short),
            Component(share, exp(own.uniform(np.log(0.5), np.log(10.0))), shape="zeroed"),
        ),
        # a rotating machine nearby: the loudness goes round with it
        "pulsing": (
            Component(
                1.0, short, exp(own.uniform(np.log(0.3), np.log(8.0))), shape="pulsing",
                depth=own.uniform(0.5, 0.95),
            ),
        ),
    }  # fmt: skip
    drawn, fringes = own.uniform(0.3, 0.6), own.uniform(0.03, 0.15)
    parts |= {
        # a capacitor between the stages of an amplifier lets nothing slow through
        "ac_coupled": (
            Component(1.0, short, 1.0 / exp(own.uniform(np.log(0.3), np.log(8.0))), "coupled"),
        ),
        # an instrument slower than the recorder, which draws straight lines between its readings
        "interpolated": (
            Component(1.0 - drawn),
            Component(drawn, exp(own.uniform(np.log(5e-3), np.log(6e-2))), shape="interpolated"),
        ),
        # light that goes to and fro between two faces whose distance trembles
        "etalon": (
            Component(1.0 - fringes, short),
            Component(
                fringes, exp(own.uniform(np.log(0.1), np.log(2.0))), shape="fringes",
                depth=own.uniform(0.2, 0.7),
            ),
        ),
    }  # fmt: skip
    counted, whistled = own.uniform(0.05, 0.3), own.uniform(0.05, 0.2)
    parts |= {
        # how many molecules are in the light's spot: they come and go by diffusion
        "molecules": (
            Component(1.0 - counted, short),
            Component(counted, exp(own.uniform(np.log(0.02), np.log(0.3))), shape="diffusing"),
        ),
        # the brightness of a grain of laser light that a restless surface scatters
        "speckle": (Component(1.0, short, shape="speckle"),),
        # a leak that whistles, every time at another pitch
        "whistling": (
            Component(1.0 - whistled, short),
            Component(
                whistled, exp(own.uniform(np.log(0.1), np.log(1.0))),
                exp(own.uniform(np.log(3.0), np.log(20.0))), shape="whistling",
                depth=own.uniform(0.3, 0.8),
            ),
        ),
    }  # fmt: skip
    lagging = own.uniform(0.05, 0.2)
    parts |= {
        # a hum eliminator between receiver and recorder takes out one frequency
        "notched": (
            Component(
                1.0, exp(own.uniform(np.log(0.03), np.log(0.3))),
                exp(own.uniform(np.log(4.0), np.log(25.0))), shape="notched",
            ),
        ),
        # two converters take turns, and one of them is the noisier
        "interleaved": (
            Component(1.0 - lagging, shape="interleaved", depth=own.uniform(0.5, 0.9)),
            Component(lagging, exp(own.uniform(np.log(0.02), np.log(0.3)))),
        ),
        # a plastic hose charges itself evenly and discharges at random
        "charging": (
            Component(1.0 - share, short),
            Component(share, exp(own.uniform(np.log(0.3), np.log(4.0))), shape="charging"),
        ),
    }  # fmt: skip
    shaped, dimmed, pumped = own.uniform(0.4, 0.8), own.uniform(0.5, 0.8), own.uniform(0.05, 0.2)
    parts |= {
        # a converter that passes its rounding on, twice, to the readings that follow
        "noise_shaping": (
            Component(1.0 - shaped, exp(own.uniform(np.log(2e-3), np.log(3e-2)))),
            Component(shaped, shape="shaped"),
        ),
        # specks of dust that the stream carries through a beam
        "dusty": (
            Component(1.0 - dimmed),
            Component(
                dimmed, exp(own.uniform(np.log(5e-3), np.log(5e-2))), shape="motes",
                rate=exp(own.uniform(np.log(0.1), np.log(0.4))),
            ),
        ),
        # a pump squeezes its hose with one roller after the other, as evenly as its motor turns
        "roller_pump": (
            Component(1.0 - pumped, short),
            Component(
                pumped, exp(own.uniform(np.log(0.5), np.log(8.0))),
                exp(own.uniform(np.log(1.0), np.log(8.0))), shape="strokes",
                depth=own.uniform(0.3, 0.6),
            ),
        ),
    }  # fmt: skip
    crossing, stepping = own.uniform(0.05, 0.3), own.uniform(0.5, 0.85)
    parts |= {
        # clouds in the stream that are carried through a beam of Gaussian profile
        "beam_crossing": (
            Component(1.0 - crossing, short),
            Component(crossing, exp(own.uniform(np.log(0.01), np.log(0.2))), shape="bell"),
        ),
        # a converter of one bit, which goes up or down by one step, and leaks
        "one_bit": (
            Component(1.0 - stepping),
            Component(stepping, exp(own.uniform(np.log(1e-3), np.log(3e-2))), shape="bits"),
        ),
        # a loudness that is the product of many influences
        "intermittent": (
            Component(
                1.0, short, shape="lognormal", depth=own.uniform(0.4, 0.7),
                gust_time=exp(own.uniform(np.log(0.05), np.log(2.0))),
            ),
        ),
    }  # fmt: skip
    conducted, latched = own.uniform(0.05, 0.25), own.uniform(0.02, 0.06)
    parts |= {
        # warmth that comes and goes along a bar, at whose end the light is read
        "conducting": (
            Component(1.0 - conducted, short),
            Component(
                conducted, exp(own.uniform(np.log(0.05), np.log(1.0))), shape="conducting"
            ),
        ),
        # a defect that needs two knocks to switch, either way
        "latching": (
            Component(1.0 - latched, short),
            Component(latched, exp(own.uniform(np.log(0.1), np.log(1.5))), shape="latching"),
        ),
        # a receiver that is not yet as quiet, or no longer, as it will be, or was
        "waning": (Component(1.0, short, shape="waning", depth=own.uniform(0.75, 0.95)),),
    }  # fmt: skip
    rattled, coded = own.uniform(0.05, 0.25), own.uniform(0.15, 0.3)
    parts |= {
        # a fibre that lies loose in its groove and wanders from wall to wall
        "rattling": (
            Component(1.0 - rattled, short),
            Component(rattled, exp(own.uniform(np.log(0.05), np.log(1.0))), shape="stops"),
        ),
        # the bus of the room's lamps, whose every bit goes up and down or down and up
        "coded": (
            Component(1.0 - coded, short),
            Component(coded, exp(own.uniform(np.log(1.5e-3), np.log(6e-3))), shape="coded"),
        ),
        # a stream whose eddies are as strong, but many times as quick, by turns
        "two_paced": (
            Component(
                1.0, exp(own.uniform(np.log(0.06), np.log(0.2))), shape="paces",
                depth=own.uniform(0.05, 0.12),
                gust_time=exp(own.uniform(np.log(0.2), np.log(3.0))),
            ),
        ),
    }  # fmt: skip
    decimated, hopping = own.uniform(0.3, 0.7), own.uniform(0.05, 0.15)
    parts |= {
        # a receiver whose digital filter is steep, before a recorder that is faster
        "decimated": (
            Component(1.0 - decimated),
            Component(decimated, exp(own.uniform(np.log(4e-3), np.log(3e-2))), shape="cut_off"),
        ),
        # a laser of many modes: the longer it has kept to one, the longer it will
        "mode_hopping": (
            Component(1.0 - hopping),
            Component(
                hopping, exp(own.uniform(np.log(0.05), np.log(0.4))), shape="settling",
                depth=own.uniform(0.5, 0.9),
            ),
        ),
        # somebody drills into the wall next door, once for a while
        "drilling": (
            Component(
                1.0, short, shape="drilled", rate=own.uniform(0.1, 0.4), depth=own.uniform(0.6, 0.9)
            ),
        ),
    }  # fmt: skip
    fanned, chattering = own.uniform(0.05, 0.2), own.uniform(0.05, 0.2)
    parts |= {
        # a fan whose speed swings about what it is set to: its hum goes up and down
        "hunting_fan": (
            Component(1.0 - fanned, short),
            Component(
                fanned, exp(own.uniform(np.log(0.5), np.log(5.0))),
                exp(own.uniform(np.log(5.0), np.log(30.0))), shape="hunting",
                depth=own.uniform(0.05, 0.3), gust_time=exp(own.uniform(np.log(0.7), np.log(6.0))),
            ),
        ),
        # a relay without hysteresis, whose coil current is near where it lets go
        "chattering_relay": (
            Component(1.0 - chattering),
            Component(
                chattering, exp(own.uniform(np.log(0.03), np.log(1.0))), shape="chattering"
            ),
        ),
        # a fibre that is plugged in anew before each record, better or worse
        "replugged_fibre": (
            Component(1.0, short, shape="replugged", depth=own.uniform(0.6, 0.9)),
        ),
    }  # fmt: skip
    beating, held, crackling = own.uniform(0.05, 0.2), own.uniform(0.1, 0.25), own.uniform(0.4, 0.7)
    parts |= {
        # two fans of one make, which never turn quite as fast: their hum swells and fades
        "two_fans": (
            Component(1.0 - beating, short),
            Component(
                beating, exp(own.uniform(np.log(1.0), np.log(10.0))),
                exp(own.uniform(np.log(4.0), np.log(25.0))), shape="beating",
                depth=own.uniform(0.01, 0.08),
            ),
        ),
        # a meter that renews its output more seldom than the recorder reads it
        "slow_meter": (
            Component(1.0 - held),
            Component(held, exp(own.uniform(np.log(0.02), np.log(0.25))), shape="held"),
        ),
        # a high-voltage cable of bad insulation: discharges in trains
        "crackling_cable": (
            Component(1.0 - crackling),
            Component(
                crackling, short, shape="trains", rate=exp(own.uniform(np.log(0.1), np.log(0.5))),
                depth=exp(own.uniform(np.log(5.0), np.log(20.0))),
                gust_time=exp(own.uniform(np.log(0.1), np.log(1.0))),
            ),
        ),
    }  # fmt: skip
    sparkling, weighed = own.uniform(0.3, 0.6), own.uniform(0.5, 0.9)
    dimmed = own.uniform(0.05, 0.2)
    parts |= {
        # a converter that now and then misreads one of its bits
        "sparkling_codes": (
            Component(1.0 - sparkling, short),
            Component(
                sparkling, shape="sparkling", rate=exp(own.uniform(np.log(1e-3), np.log(0.02)))
            ),
        ),
        # a driver that smooths its readings by weights of 1, 2 and 1
        "weighed_readings": (
            Component(1.0 - weighed, exp(own.uniform(np.log(0.01), np.log(0.1)))),
            Component(weighed, shape="binomial"),
        ),
        # lamps that a dimmer turns on and off, for a pulse's length that never stays
        "dimmed_lamps": (
            Component(1.0 - dimmed),
            Component(dimmed, exp(own.uniform(np.log(5e-3), np.log(0.1))), shape="dimmed"),
        ),
    }  # fmt: skip
    corrected, rectified = own.uniform(0.4, 0.8), own.uniform(0.1, 0.35)
    dielectric = own.uniform(0.05, 0.3)
    parts |= {
        # a converter that sets its zero anew after each reading, by more than it was off
        "overcorrecting_zero": (
            Component(1.0 - corrected, exp(own.uniform(np.log(0.01), np.log(0.1)))),
            Component(corrected, shape="overcorrected", depth=own.uniform(0.4, 0.9)),
        ),
        # pickup that a poor contact rectifies: it goes one way only
        "rectified_pickup": (
            Component(1.0 - rectified),
            Component(
                rectified, exp(own.uniform(np.log(0.02), np.log(0.3))), shape="rectified"
            ),
        ),
        # a cable's insulation, whose dipoles turn after fluctuations of every pace
        "glassy_dielectric": (
            Component(1.0 - dielectric, short),
            Component(
                dielectric, exp(own.uniform(np.log(0.01), np.log(0.3))), shape="stretched",
                depth=own.uniform(0.3, 0.5),
            ),
        ),
    }  # fmt: skip
    geared, salty, trembling = own.uniform(0.1, 0.3), own.uniform(0.6, 0.9), own.uniform(0.05, 0.15)
    tooth, teeth = exp(own.uniform(np.log(5e-3), np.log(0.04))), int(own.integers(8, 25))
    parts |= {
        # a pump's gear wheel, whose every tooth knocks as hard as it did a turn before, or nearly
        "worn_gear": (
            Component(1.0 - geared),
            Component(
                geared, tooth, shape="teeth", gust_time=teeth * tooth, depth=own.uniform(0.6, 0.95)
            ),
        ),
        # an electrode that ions reach by diffusion: a current's noise over the root of its pace
        "salty_electrode": (
            Component(1.0 - salty, exp(own.uniform(np.log(0.02), np.log(0.2)))),
            Component(salty, shape="diffused", depth=own.uniform(0.1, 0.3)),
        ),
        # a mirror at its best place, from which light is lost either way as it swings
        "trembling_mirror": (
            Component(1.0 - trembling),
            Component(
                trembling, exp(own.uniform(np.log(0.1), np.log(1.0))),
                exp(own.uniform(np.log(1.5), np.log(10.0))), shape="squared",
            ),
        ),
    }  # fmt: skip
    flapping, startled, bubbling = (
        own.uniform(0.05, 0.25), own.uniform(0.75, 0.95), own.uniform(0.6, 0.8)
    )  # fmt: skip
    lagging = exp(own.uniform(np.log(0.05), np.log(1.0)))
    parts |= {
        # a ventilation flap that the wind throws open and shut, and air that warms and cools behind
        "flapping_damper": (
            Component(1.0 - flapping, short),
            Component(
                flapping, lagging, shape="flapping", gust_time=own.uniform(1.3, 4.0) * lagging
            ),
        ),
        # a receiver that sets its range by its last reading: after a large one it is coarse
        "startled_receiver": (
            Component(startled, shape="startled", depth=own.uniform(0.4, 0.55)),
            Component(1.0 - startled, exp(own.uniform(np.log(0.02), np.log(0.2)))),
        ),
        # bubbles of one size, each of which must first form at the nozzle and then let go of it
        "bubbling_nozzle": (
            Component(1.0 - bubbling),
            Component(
                bubbling, exp(own.uniform(np.log(4e-3), np.log(4e-2))), shape="bubbles",
                rate=exp(own.uniform(np.log(0.3), np.log(0.8))),
            ),
        ),
    }  # fmt: skip
    resting, balanced, crests = (
        own.uniform(0.05, 0.25), own.uniform(0.6, 0.9), own.uniform(0.04, 0.12)
    )  # fmt: skip
    parts |= {
        # a check valve's ball that the stream throws off its seat and its weight brings back
        "resting_ball": (
            Component(1.0 - resting, short),
            Component(resting, exp(own.uniform(np.log(0.1), np.log(2.0))), shape="resting"),
        ),
        # two photodiodes that cancel the laser's noise as long as they get as much light
        "drifting_balance": (
            Component(
                balanced, short, shape="balanced",
                gust_time=exp(own.uniform(np.log(0.1), np.log(3.0))),
            ),
            Component(1.0 - balanced),
        ),
        # a level meter that leaps to every crest and sinks evenly until a higher one comes
        "sinking_crests": (
            Component(1.0 - crests, short),
            Component(crests, exp(own.uniform(np.log(0.2), np.log(2.0))), shape="crests"),
        ),
    }  # fmt: skip
    middle, faded, charged = own.uniform(0.5, 0.9), own.uniform(0.05, 0.2), own.uniform(0.3, 0.7)
    parts |= {
        # a driver that shows the middle one of its last three readings, against wild ones
        "median_of_three": (
            Component(middle, shape="median"),
            Component(1.0 - middle, exp(own.uniform(np.log(0.02), np.log(0.2)))),
        ),
        # an interferometer that reads the phase of scattered light, lost whenever that fades
        "faded_phase": (
            Component(1.0 - faded),
            Component(faded, exp(own.uniform(np.log(0.05), np.log(1.0))), shape="phase"),
        ),
        # a spray of charged droplets past the receiver's input: each one way first, then the other
        "charged_drops": (
            Component(1.0 - charged),
            Component(
                charged, exp(own.uniform(np.log(3e-3), np.log(0.04))), shape="passing",
                rate=exp(own.uniform(np.log(5.0), np.log(15.0))),
            ),
        ),
    }  # fmt: skip
    averaged, slowing, referred = (
        own.uniform(0.7, 0.95), own.uniform(0.3, 0.7), own.uniform(0.65, 0.9)
    )  # fmt: skip
    parts |= {
        # a meter that shows the mean since it was triggered last, which happens at random
        "restarted_mean": (
            Component(averaged, exp(own.uniform(np.log(0.02), np.log(0.2))), shape="restarted"),
            Component(1.0 - averaged),
        ),
        # a stream whose blower is run down or up: its eddies pass ever more slowly or quickly
        "slowing_stream": (
            Component(1.0 - slowing),
            Component(
                slowing, exp(own.uniform(np.log(0.3), np.log(2.0))), shape="slowing",
                depth=exp(own.uniform(np.log(0.01), np.log(0.05))),
            ),
        ),
        # a receiver that divides by the loudness of a reference of which it has few readings
        "weak_reference": (
            Component(referred, shape="referred", rate=float(own.integers(5, 8))),
            Component(1.0 - referred, exp(own.uniform(np.log(0.02), np.log(0.2)))),
        ),
    }  # fmt: skip
    sliding, larger, repeated = (
        own.uniform(0.05, 0.25), own.uniform(0.3, 0.7), own.uniform(0.7, 0.95)
    )  # fmt: skip
    parts |= {
        # a slide on dry rails, shaken: friction is as strong at any speed, and its speed is read
        "dry_slide": (
            Component(1.0 - sliding, short),
            Component(sliding, exp(own.uniform(np.log(0.1), np.log(2.0))), shape="dry"),
        ),
        # two receivers on one line by way of diodes: it has the higher one's voltage
        "larger_of_two": (
            Component(1.0 - larger),
            Component(larger, exp(own.uniform(np.log(0.02), np.log(0.3))), shape="larger"),
        ),
        # readings come by radio, and where a packet is lost the one before is shown again
        "repeated_packets": (
            Component(repeated, shape="repeated", depth=own.uniform(0.5, 0.8)),
            Component(1.0 - repeated, exp(own.uniform(np.log(0.02), np.log(0.2)))),
        ),
    }  # fmt: skip
    railed, staged, leaps = (
        own.uniform(0.05, 0.25), own.uniform(0.3, 0.8), exp(own.uniform(np.log(0.05), np.log(0.5)))
    )  # fmt: skip
    parts |= {
        # a bench that rumbles more than the amplifier of its microphone can give, either way
        "railed_microphone": (
            Component(1.0 - railed),
            Component(
                railed, exp(own.uniform(np.log(0.03), np.log(0.5))), shape="clipped",
                depth=own.uniform(0.3, 1.0),
            ),
        ),
        # a receiver of three equal stages, behind which the converter adds noise of its own
        "three_stages": (
            Component(1.0 - staged),
            Component(staged, exp(own.uniform(np.log(4e-3), np.log(4e-2))), shape="thrice"),
        ),
        # a mirror on a sticky bearing, which trembles as ever but gets on by fits and starts
        "fitful_bearing": (
            Component(
                1.0, exp(own.uniform(np.log(0.01), np.log(0.1))), shape="fitful", gust_time=leaps
            ),
        ),
    }  # fmt: skip
    if name not in parts:
        raise CampaignError(f"noise law: expected one of {', '.join(parts)}, got '{name}'")
    return NoiseLaw(name, sigma0, sigma1, parts[name])


def autocorrelation(law: NoiseLaw, n: int, interval: float) -> FloatArray:
    """(n,) autocorrelation of the noise at lags 0, 1, .. n - 1 samples."""
    lags = np.arange(n, dtype=float) * interval
    total = np.zeros(n)
    for part in law.components:
        if part.time == 0.0:
            total[0] += part.share
            if part.shape == "difference" and n > 1:
                total[1] -= part.share * part.depth / (1.0 + part.depth**2)
            elif part.shape == "shaped":
                total[1:3] += part.share * np.array([-4.0, 1.0])[: n - 1] / 6.0
            elif part.shape == "binomial":
                total[1:3] += part.share * np.array([4.0, 1.0])[: n - 1] / 6.0
            elif part.shape == "median":
                total[1:3] += part.share * np.array(MEDIAN_CORRELATION)[: n - 1]
            elif part.shape == "overcorrected":
                total[1:] += part.share * (-part.depth) ** np.arange(1.0, n)
            elif part.shape == "repeated":
                total[1:] += part.share * part.depth ** np.arange(1.0, n)
            elif part.shape == "diffused":
                total[1:] += part.share * _antipersistent(part.depth, n)[1:]
            continue
        own = np.exp(-lags / part.time)
        if part.shape == "smooth":
            own *= 1.0 + lags / part.time
        elif part.shape == "window":
            own = np.maximum(1.0 - lags / part.time, 0.0)
        elif part.shape == "gusts":
            strong, calm = _gusts(part)
            mean, swing = 0.5 * (strong + calm), 0.5 * (strong - calm)
            own *= mean**2 + swing**2 * np.exp(-lags / part.gust_time)
        elif part.shape == "lognormal":
            own *= np.exp(part.depth**2 * np.expm1(-lags / part.gust_time))
        elif part.shape == "bell":
            own = np.exp(-((lags / part.time) ** 2))
        elif part.shape == "echo":
            around = np.exp(-np.abs(lags - 1.0 / part.frequency) / part.time)
            beyond = np.exp(-(lags + 1.0 / part.frequency) / part.time)
            own = (1.0 + part.depth**2) * own + part.depth * (around + beyond)
            own /= _echo_variance(part)
        elif part.shape == "turbulent":
            own = _von_karman(lags / part.time)
        elif part.shape == "zeroed":
            own = np.maximum(1.0 - lags / part.time, 0.0) ** 2
        elif part.shape == "pulsing":
            swell = 0.5 * part.depth**2
            own *= (1.0 + swell * np.cos(2.0 * pi * part.frequency * lags)) / (1.0 + swell)
        elif part.shape == "coupled":
            slow = _coupling_time(part)
            own = (slow * own - part.time * np.exp(-lags / slow)) / (slow - part.time)
        elif part.shape == "interpolated":
            own = _hat_with_hat(lags / part.time)
        elif part.shape in ("fringes", "strokes"):
            turn = 2.0 * pi * part.frequency * lags
            own = sum(
                weight * own ** (k * k) * np.cos(k * turn)
                for k, weight in enumerate(_orders(part), start=1)
            )
        elif part.shape == "motes":
            own = _discs(lags / part.time)
        elif part.shape == "conducting":
            own = erfcx(np.sqrt(lags / part.time))
        elif part.shape == "latching":
            own *= np.cos(lags / part.time)
        elif part.shape == "stops":
            own = _stopped_correlation(lags / part.time)
        elif part.shape == "coded":
            bits = lags / part.time
            own = np.where(bits < 0.5, 1.0 - 3.0 * bits, np.minimum(bits - 1.0, 0.0))
        elif part.shape == "paces":
            own = _paced_correlation(part, lags)
        elif part.shape == "cut_off":
            own = np.sinc(lags / part.time)
        elif part.shape == "settling":
            own = (1.0 + lags / part.time) ** -part.depth
        elif part.shape == "hunting":
            swing = 2.0 * part.depth * part.frequency * part.gust_time
            own *= np.cos(2.0 * pi * part.frequency * lags)
            own *= j0(swing * np.sin(pi * lags / part.gust_time))
        elif part.shape == "beating":
            turn = 2.0 * pi * part.frequency * lags
            own *= np.cos(turn) * np.cos(part.depth * turn)
        elif part.shape == "held":
            own = np.maximum(1.0 - lags / part.time, 0.0)
        elif part.shape == "trains":
            alone, together = _train_shares(part)
            train = part.gust_time * np.exp(-lags / part.gust_time) - part.time * own
            own = alone * own + together * train / (part.gust_time - part.time)
        elif part.shape == "dimmed":
            own = _dimmed_correlation(lags / part.time)
        elif part.shape == "rectified":
            own = _rectified_correlation(own)
        elif part.shape == "teeth":
            own = _toothed_correlation(part, lags)
        elif part.shape == "flapping":
            level = part.gust_time * np.exp(-lags / part.gust_time)
            own = (level - part.time * own) / (part.gust_time - part.time)
        elif part.shape == "bubbles":
            own = _bubbling_covariance(part.rate, lags / part.time)
            own /= _bubbling_covariance(part.rate, np.zeros(1))
        elif part.shape == "resting":
            own = _resting_correlation(lags / part.time)
        elif part.shape == "balanced":
            own *= np.exp(-lags / part.gust_time)
        elif part.shape == "crests":
            own = 1.0 - spence(own) / (pi**2 / 6.0)
        elif part.shape == "phase":
            own = _phase_correlation(own)
        elif part.shape == "restarted":
            own = _restarted_correlation(exp(-interval / part.time), n)
        elif part.shape == "dry":
            own = _dry_correlation(lags / part.time)
        elif part.shape == "larger":
            # of half their sum, and half the modulus of their difference
            own = (0.5 * own + (0.5 - 1.0 / pi) * _rectified_correlation(own)) / (1.0 - 1.0 / pi)
        elif part.shape == "clipped":
            own = _clipped_correlation(part.depth, own)
        elif part.shape == "thrice":
            own *= 1.0 + lags / part.time + (lags / part.time) ** 2 / 3.0
        elif part.shape == "fitful":
            own = (1.0 + part.gust_time / part.time) ** (-lags / part.gust_time)
        elif part.shape == "slowing":
            own = _slowing_correlation(part, lags)
        elif part.shape == "passing":
            own = (1.0 - 0.5 * (lags / part.time) ** 2) * np.exp(-0.25 * (lags / part.time) ** 2)
        elif part.shape == "squared":
            own = (own * np.cos(2.0 * pi * part.frequency * lags)) ** 2
        elif part.shape == "stretched":
            own = np.exp(-((lags / part.time) ** part.depth))
        elif part.shape == "chattering":
            own = 2.0 / pi * np.arcsin(own)
        elif part.shape == "diffusing":
            own = 1.0 / (1.0 + lags / part.time)
        elif part.shape == "notched":
            own = _notched_correlation(part, n, interval)
        elif part.shape == "whistling":
            # pitches between (1 - depth) and (1 + depth) times the middle one, any as likely
            own *= np.cos(2.0 * pi * part.frequency * lags)
            own *= np.sinc(2.0 * part.depth * part.frequency * lags)
        elif part.frequency:
            own *= np.cos(2.0 * pi * part.frequency * lags)
        total += part.share * own
    return total


def draw_noise(
    law: NoiseLaw,
    n: int,
    interval: float,
    rng: np.random.Generator,
    tails: tuple[float, float] = (0.0, 1.0),
) -> FloatArray:
    """(n,) one stretch of unit variance.

    ``tails`` = (p, k): a share p of the first component's innovations is k times as large, all
    scaled back to unit variance.
    """
    total = np.zeros(n)
    for i, part in enumerate(law.components):
        own = _draw_part(part, n, interval, rng, tails if i == 0 else (0.0, 1.0))
        total += sqrt(part.share) * own
    return total


def _innovations(n: int, rng: np.random.Generator, tails: tuple[float, float]) -> FloatArray:
    e = rng.standard_normal(n)
    p, k = tails
    if p > 0:
        e = np.where(rng.random(n) < p, k * e, e) / sqrt(1.0 - p + p * k**2)
    return e


def _draw_part(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    if part.shape == "difference":
        e = _innovations(n + 1, rng, tails)
        return (e[1:] - part.depth * e[:-1]) / sqrt(1.0 + part.depth**2)
    if part.shape == "shaped":
        return np.diff(_innovations(n + 2, rng, tails), 2) / sqrt(6.0)
    if part.shape == "binomial":
        return np.convolve(_innovations(n + 2, rng, tails), [1.0, 2.0, 1.0], "valid") / sqrt(6.0)
    if part.shape == "median":
        e = _innovations(n + 2, rng, tails)
        shown: FloatArray = np.median([e[:-2], e[1:-1], e[2:]], axis=0)
        return shown / sqrt(1.0 - sqrt(3.0) / pi)
    if part.shape == "overcorrected":
        alternating: FloatArray = _remembering(_innovations(n, rng, tails), -part.depth)
        return alternating
    if part.shape == "diffused":
        return _embedded(_antipersistent(part.depth, n + 1), rng)
    if part.shape == "referred":
        e = _innovations(n, rng, tails)
        loud = np.sqrt(rng.chisquare(part.rate, n) / (part.rate - 2.0))
        return e / loud
    if part.shape == "repeated":
        e = _innovations(n, rng, tails)
        fresh = rng.random(n) >= part.depth
        fresh[0] = True
        return e[_last_marked(fresh)]
    if part.shape == "startled":
        return _startled(_innovations(n + 60, rng, tails), part.depth)[60:]
    if part.shape == "sparkling":
        off = np.where(rng.random(n) < part.rate, 1.0 / sqrt(part.rate), 0.0)
        return np.where(rng.random(n) < 0.5, off, -off)
    if part.shape == "interleaved":
        louder = np.where((np.arange(n) + rng.integers(2)) % 2 == 0, *_gusts(part))
        return louder * _innovations(n, rng, tails)
    if part.time == 0.0:
        return _innovations(n, rng, tails)
    decay = exp(-interval / part.time)
    if part.shape == "telegraph":
        return _telegraph(decay, n, rng)
    if part.shape == "window":
        return _window(part.time, n, interval, rng)
    if part.shape == "shot":
        return _shot(part, n, interval, rng)
    if part.shape == "sparks":
        return _sparks(part, n, interval, rng)
    if part.shape == "echo":
        return _echo(part, n, interval, rng, tails)
    if part.shape == "turbulent":
        R = _von_karman(np.arange(n + 1, dtype=float) * interval / part.time)
        return _embedded(R, rng)
    if part.shape == "diffusing":
        R = 1.0 / (1.0 + np.arange(n + 1, dtype=float) * interval / part.time)
        return _embedded(R, rng)
    if part.shape == "conducting":
        return _embedded(erfcx(np.sqrt(np.arange(n + 1, dtype=float) * interval / part.time)), rng)
    if part.shape == "latching":
        return _latching(interval / part.time, n, rng)
    if part.shape == "stops":
        return _between_stops(interval / part.time, n, rng)
    if part.shape == "coded":
        return _coded(interval / part.time, n, rng)
    if part.shape == "paces":
        return _paced(part, n, interval, rng, tails)
    if part.shape == "cut_off":
        return _cut_off(interval / part.time, n, rng)
    if part.shape == "settling":
        return _settling(part, n, interval, rng)
    if part.shape == "hunting":
        return _hunting(part, n, interval, rng)
    if part.shape == "beating":
        return _beating(part, n, interval, rng)
    if part.shape == "held":
        at = np.arange(n) * (interval / part.time) + rng.random()
        levels: FloatArray = rng.standard_normal(int(at[-1]) + 1)
        return levels[at.astype(np.int64)]
    if part.shape == "trains":
        return _trains(part, n, interval, rng)
    if part.shape == "dimmed":
        return _dimmed(interval / part.time, n, rng)
    if part.shape == "rectified":
        modulus: FloatArray = np.abs(_remembering(rng.standard_normal(n), decay))
        return (modulus - sqrt(2.0 / pi)) / sqrt(1.0 - 2.0 / pi)
    if part.shape == "teeth":
        return _teeth(part, n, interval, rng)
    if part.shape == "flapping":
        return _flapping(part, n, interval, rng)
    if part.shape == "bubbles":
        return _bubbles(part, n, interval, rng)
    if part.shape == "resting":
        return _resting(interval / part.time, n, rng)
    if part.shape == "dry":
        return _dry(interval / part.time, n, rng)
    if part.shape == "larger":
        higher: FloatArray = np.max(_remembering(rng.standard_normal((2, n)), decay), axis=0)
        return (higher - 1.0 / sqrt(pi)) / sqrt(1.0 - 1.0 / pi)
    if part.shape == "clipped":
        within: FloatArray = np.clip(
            _remembering(rng.standard_normal(n), decay), -part.depth, part.depth
        )
        return within / sqrt(_clipped_variance(part.depth))
    if part.shape == "thrice":
        # long enough to be the same on a circle as on a line, to rounding
        s = np.arange(max(n, ceil(40.0 * part.time / interval)) + 1) * (interval / part.time)
        return _embedded(np.exp(-s) * (1.0 + s + s**2 / 3.0), rng)[:n]
    if part.shape == "fitful":
        passed = rng.gamma(interval / part.gust_time, part.gust_time / part.time, n)
        kicks = _innovations(n, rng, tails)
        kicks[1:] *= np.sqrt(-np.expm1(-2.0 * passed[1:]))
        fits: FloatArray = _forgetting(np.exp(-passed), kicks)
        return fits
    if part.shape == "crests":
        return _sinking(interval / part.time, n, rng)
    if part.shape == "phase":
        light = rng.standard_normal(n) + 1j * rng.standard_normal(n)
        phase: FloatArray = np.angle(_remembering(light, decay))
        return phase * (sqrt(3.0) / pi)
    if part.shape == "passing":
        return _passing(part, n, interval, rng)
    if part.shape == "restarted":
        return _restarted(decay, _innovations(n, rng, tails), rng)
    if part.shape == "slowing":
        return _slowing(part, n, interval, rng, tails)
    if part.shape == "squared":
        turn = np.exp(2j * pi * part.frequency * interval)
        kicks = rng.standard_normal(n) + 1j * rng.standard_normal(n)
        away: FloatArray = _remembering(kicks, decay, turn).real
        return (1.0 - away**2) / sqrt(2.0)
    if part.shape == "stretched":
        # convex, as a mixture of exponentials is
        lags = np.arange(n + 1, dtype=float) * interval
        return _embedded(np.exp(-((lags / part.time) ** part.depth)), rng)
    if part.shape == "chattering":
        return np.where(_remembering(rng.standard_normal(n), decay) > 0.0, 1.0, -1.0)
    if part.shape == "bell":
        return _bell(part.time, n, interval, rng)
    if part.shape == "bits":
        return _bits(decay, n, rng)
    if part.shape == "speckle":
        return _speckle(part.time, n, interval, rng)
    if part.shape == "whistling":
        return _whistling(part, n, interval, rng)
    if part.shape == "notched":
        return _notched(part, n, interval, rng, tails)
    if part.shape == "charging":
        return _charging(part.time, n, interval, rng)
    if part.shape == "zeroed":
        return _zeroed(part.time, n, interval, rng)
    if part.shape == "coupled":
        return _coupled(part, n, interval, rng, tails)
    if part.shape == "interpolated":
        return _drawn_lines(part.time, n, interval, rng)
    if part.shape in ("fringes", "strokes"):
        return _fringes(part, n, interval, rng)
    if part.shape == "motes":
        return _motes(part, n, interval, rng)
    if part.shape == "smooth":
        # exact sampling of the critically damped process (x, v): x'' = -2 x'/T - x/T^2 + noise
        return _smooth(part.time, n, interval, rng)
    e = _innovations(n, rng, tails)
    if part.frequency == 0.0 or part.shape == "pulsing":
        x: FloatArray = _remembering(e, decay)
        if part.shape == "gusts":
            x *= np.where(_telegraph(exp(-interval / part.gust_time), n, rng) > 0, *_gusts(part))
        elif part.shape == "lognormal":
            x *= _loudness(part, n, interval, rng)
        elif part.shape == "balanced":
            x *= _remembering(rng.standard_normal(n), exp(-interval / part.gust_time))
        elif part.shape == "waning":
            x *= _waning(part.depth, n, rng)
        elif part.shape == "drilled":
            x *= _drilled(part, n, rng)
        elif part.shape == "replugged":
            x *= sqrt(1.0 + part.depth * rng.uniform(-1.0, 1.0))
        elif part.shape == "pulsing":
            turns = part.frequency * interval * np.arange(n) + rng.random()
            x *= (1.0 + part.depth * np.cos(2.0 * pi * turns)) / sqrt(1.0 + 0.5 * part.depth**2)
        return x
    turn = np.exp(2j * pi * part.frequency * interval)
    turning: FloatArray = _remembering(e + 1j * rng.standard_normal(n), decay, turn).real
    return turning


def _remembering(e: Any, decay: float, turn: complex = 1.0) -> Any:
    """First-order recursion, stationary from the first sample, on independent ``e`` (.., n)."""
    kicks = np.array(e)
    kicks[..., 1:] *= sqrt(1.0 - decay**2)
    return lfilter([1.0], [1.0, -decay * turn], kicks)


def _gusts(part: Component) -> tuple[float, float]:
    """Standard deviations where it is loud and where it is not."""
    return sqrt(1.0 + part.depth), sqrt(1.0 - part.depth)


def _telegraph(decay: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) 1 or -1; ``decay`` is its correlation from sample to sample."""
    flips = rng.random(n) < 0.5 * (1.0 - decay)
    return np.where((np.cumsum(flips) + rng.integers(2)) % 2 == 0, 1.0, -1.0)


def _latching(knocks: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) 1 or -1, the other one after every second of the ``knocks`` that come in an interval.

    Four states in a ring, two of them up: of the ring's modes the two that turn by a quarter are
    seen, hence exp(-lag/time) cos(lag/time) with the mean time from knock to knock.
    """
    state = rng.integers(4) + np.cumsum(rng.poisson(knocks, n))
    return np.where(state % 4 < 2, 1.0, -1.0)


def _stopped_correlation(lags: FloatArray) -> FloatArray:
    """Of a random walk between two stops; lags in units of its slowest mode's time."""
    total = np.zeros_like(lags)
    for k in range(1, 60, 2):
        total += 96.0 / (pi * k) ** 4 * np.exp(-(k**2) * lags)
    return total


def _between_stops(interval: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) random walk between two stops that throw it back, anywhere as likely.

    A free walk, folded; with ``interval`` in units of its time the distance of its stops has the
    modes exp(-k^2 lag) of odd k, in shares of 96/(pi k)^4.
    """
    walk = sqrt(2.0 * interval) / pi * rng.standard_normal(n)
    walk[0] = 2.0 * rng.random()
    folded = np.abs(np.mod(np.cumsum(walk), 2.0) - 1.0)  # of stops at 0 and 1
    place: FloatArray = sqrt(12.0) * (folded - 0.5)
    return place


def _coded(bits: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) 1 or -1: bits at random, ``bits`` of them an interval, the other sign in second halves.

    Manchester's code; the first sample lies anywhere in its bit.
    """
    at = np.arange(n) * bits + rng.random()
    number = at.astype(np.int64)
    signs = np.where(rng.random(int(number[-1]) + 1) < 0.5, 1.0, -1.0)
    return np.where(at - number < 0.5, 1.0, -1.0) * signs[number]


def _paces(part: Component) -> tuple[float, float, float]:
    """(mean of both rates, half their difference, changes to the other one) per s."""
    slow, quick = 1.0 / part.time, 1.0 / (part.depth * part.time)
    return 0.5 * (quick + slow), 0.5 * (quick - slow), 0.5 / part.gust_time


def _paced_correlation(part: Component, lags: FloatArray) -> FloatArray:
    """Mean of exp(-(own time passed)): two states, of which the quick one forgets more."""
    mean, half, change = _paces(part)
    root = sqrt(half**2 + change**2)
    late, soon = np.exp(-(mean + change - root) * lags), np.exp(-(mean + change + root) * lags)
    own: FloatArray = 0.5 * ((1.0 + change / root) * late + (1.0 - change / root) * soon)
    return own


def _paced(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    """(n,) Ornstein-Uhlenbeck process whose own time passes quickly or slowly, by turns."""
    mean, half, change = _paces(part)
    changes = np.sort(rng.uniform(0.0, n * interval, rng.poisson(change * n * interval)))
    edges = np.concatenate([[0.0], changes, [n * interval]])
    sign = 1.0 if rng.random() < 0.5 else -1.0
    rates = mean + half * sign * np.where(np.arange(len(edges) - 1) % 2 == 0, 1.0, -1.0)
    passed = np.concatenate([[0.0], np.cumsum(rates * np.diff(edges))])
    own = np.diff(np.interp(np.arange(n) * interval, edges, passed), prepend=0.0)
    kicks = _innovations(n, rng, tails)
    kicks[1:] *= np.sqrt(-np.expm1(-2.0 * own[1:]))
    x: FloatArray = _forgetting(np.exp(-own), kicks)
    return x


@njit(cache=True)
def _forgetting(decays: FloatArray, kicks: FloatArray) -> FloatArray:  # pragma: no cover
    """(n,) first-order recursion whose ``decays`` (n,) differ; the first one does not count."""
    x = kicks.copy()
    for i in range(1, len(x)):
        x[i] += decays[i] * x[i - 1]
    return x


def _waning(depth: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) loudness whose square runs evenly from 1 + ``depth`` to 1 - ``depth``, or back."""
    course = depth * (1.0 - (2.0 * np.arange(n) + 1.0) / n)
    return np.sqrt(1.0 + (course if rng.random() < 0.5 else -course))


def _drilled(part: Component, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) loudness, larger in one stretch: the record's end goes on at its beginning.

    So every sample is as likely to be within, and of unit mean square.
    """
    within = np.mod(np.arange(n) / n + rng.random(), 1.0) < part.rate
    loud = 1.0 + part.depth * (1.0 - part.rate) / part.rate
    return np.sqrt(np.where(within, loud, 1.0 - part.depth))


def _cut_off(step: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) white noise of which nothing is left beyond ``step``/2 turns a sample.

    From sines on a stretch several times as long, whose repetition is out of reach; the last of
    them counts in part.  A recorder that is too slow for them sees only some of the samples.
    """
    finer = 1 + int(step)
    total = 1 << ceil(np.log2(8.0 * n * finer + 400.0 * finer / step))
    last = 0.5 * step / finer * total  # in turns a stretch
    power = np.clip(last + 0.5 - np.arange(total // 2 + 1), 0.0, 1.0)
    white = np.fft.rfft(rng.standard_normal(total))
    x: FloatArray = np.fft.irfft(np.sqrt(power) * white, total)[: n * finer : finer]
    return x * sqrt(total / (power[0] + 2.0 * power[1:].sum()))


def _settling(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) independent levels; the share (1 + t/time)^-(1 + ``depth``) of them lasts beyond t.

    At any instant the share (1 + t/time)^-depth lasts another t (renewal theory), which is the
    autocorrelation, as a new level has nothing of the one before.
    """
    length = n * interval / part.time
    edges = [float(rng.random() ** (-1.0 / part.depth) - 1.0)]
    while edges[-1] < length:
        more = rng.random(256) ** (-1.0 / (1.0 + part.depth)) - 1.0
        edges += (edges[-1] + np.cumsum(more)).tolist()
    at = np.arange(n) * (interval / part.time)
    levels: FloatArray = rng.standard_normal(len(edges) + 1)
    return levels[np.searchsorted(edges, at, side="right")]


def _hunting(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) a tone whose frequency swings evenly by the share ``depth``, once in ``gust_time``.

    Its phase walks at random besides, so that of the tone exp(-lag/time) is remembered; of the
    swing, begun anywhere, Bessel's J0 is (Abramowitz and Stegun, 1964, Eq. 9.1.18).
    """
    walk = sqrt(2.0 * interval / part.time) * rng.standard_normal(n)
    walk[0] = 2.0 * pi * rng.random()
    at = interval * np.arange(n)
    swing = np.sin(2.0 * pi * (at / part.gust_time + rng.random()))
    phase = 2.0 * pi * part.frequency * at + part.depth * part.frequency * part.gust_time * swing
    tone: FloatArray = sqrt(2.0) * np.cos(phase + np.cumsum(walk))
    return tone


def _beating(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) sum of two tones as loud, whose phases walk at random, each for itself."""
    walks = sqrt(2.0 * interval / part.time) * rng.standard_normal((2, n))
    walks[:, 0] = 2.0 * pi * rng.random(2)
    pitches = part.frequency * (1.0 + part.depth * np.array([[-1.0], [1.0]]))
    phases = 2.0 * pi * pitches * interval * np.arange(n) + np.cumsum(walks, axis=1)
    both: FloatArray = np.cos(phases).sum(axis=0)
    return both


def _train_shares(part: Component) -> tuple[float, float]:
    """Of the variance: of pulses on their own, and of their coming together."""
    together = 0.5 * part.depth * part.time / (part.time + part.gust_time)
    return 1.0 / (1.0 + together), together / (1.0 + together)


def _trains(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) trains of pulses, less their mean: heights, and times since the begin, exponential.

    The variance is that of as many pulses at random (Campbell's theorem), and that of the trains'
    mean courses besides (Neyman and Scott, J. R. Stat. Soc. B 20, 1, 1958).
    """
    early = 12.0 * part.gust_time + 20.0 * part.time
    before = ceil(early / interval)
    lasting = (before + n) * interval
    begins = rng.uniform(0.0, lasting, rng.poisson(part.rate * lasting / part.gust_time))
    at = np.repeat(begins, rng.poisson(part.depth, len(begins)))
    at = (at + rng.exponential(part.gust_time, len(at))) / interval  # in samples
    at = at[at < before + n - 1]
    seen = at.astype(np.int64) + 1
    heights = rng.exponential(size=len(at))
    x = _dying_out(seen, (seen - at) * interval, heights, part.time, n, before, interval)
    mean = part.rate * part.depth * part.time / part.gust_time
    return (x - mean) / sqrt(mean / _train_shares(part)[0])


def _dimmed_correlation(lags: FloatArray) -> FloatArray:
    """Of pulses that begin evenly and last anything up to a period; lags in periods.

    Both of two instants a < b of one period are lit in 1 - b of all cases, those of two periods in
    (1 - a)(1 - b); a is anywhere, half is the mean and a quarter the variance.
    """
    f = np.mod(lags, 1.0)
    same = np.where(lags < 1.0, 0.5 * (1.0 - f) ** 2, (1.0 - f**3) / 3.0 - 0.5 * f * (1.0 - f**2))
    return np.asarray(4.0 * (same + 0.5 * f**2 * (1.0 - f) + f**3 / 3.0) - 1.0)


def _dimmed(periods: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) 1 or -1: ``periods`` of them an interval, each lit from its begin for a time at random.

    The first sample lies anywhere in its period.
    """
    at = np.arange(n) * periods + rng.random()
    number = at.astype(np.int64)
    return np.where(at - number < rng.random(int(number[-1]) + 1)[number], 1.0, -1.0)


def _rectified_correlation(r: FloatArray) -> FloatArray:
    """Of the modulus of Gaussian noise whose own correlation is ``r``.

    The mean of |x y| is 2/pi (sqrt(1 - r^2) + r arcsin r), of |x| it is sqrt(2/pi).
    """
    return np.asarray((np.sqrt(1.0 - r**2) + r * np.arcsin(r) - 1.0) / (0.5 * pi - 1.0))


def _antipersistent(H: float, n: int) -> FloatArray:
    """(n,) autocorrelation of the steps of fractional Brownian motion, a sample each.

    Their spectrum goes as f^(1 - 2 ``H``) (Mandelbrot and Van Ness, SIAM Rev. 10, 422, 1968).
    """
    k = np.arange(n, dtype=float)
    R: FloatArray = 0.5 * ((k + 1.0) ** (2.0 * H) + np.abs(k - 1.0) ** (2.0 * H)) - k ** (2.0 * H)
    return R


def _toothed_correlation(part: Component, lags: FloatArray) -> FloatArray:
    """Of levels that stand for a ``time`` and come again every ``gust_time``, ``depth`` of them."""
    turn = np.floor(lags / part.gust_time)
    late = lags - turn * part.gust_time
    here = np.maximum(1.0 - late / part.time, 0.0)
    there = np.maximum(1.0 - (part.gust_time - late) / part.time, 0.0)
    return np.asarray(part.depth**turn * (here + part.depth * there))


def _teeth(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) level of one tooth after the other, each of which remembers itself from turn to turn.

    The first sample lies anywhere in its tooth.
    """
    teeth = round(part.gust_time / part.time)
    at = np.arange(n) * (interval / part.time) + rng.random()
    number = at.astype(np.int64)
    turns = int(number[-1]) // teeth + 1
    levels = _remembering(rng.standard_normal((teeth, turns)), part.depth)
    knocks: FloatArray = levels[number % teeth, number // teeth]
    return knocks


@njit(cache=True)
def _startled(e: FloatArray, depth: float) -> FloatArray:  # pragma: no cover - compiled
    """(n,) white noise whose variance is 1 - ``depth`` and ``depth`` times the last one squared.

    Of independent ``e`` (n,) (Engle, Econometrica 50, 987, 1982); of unit variance in the mean.
    """
    z = e.copy()
    for i in range(1, len(z)):
        z[i] *= sqrt(1.0 - depth + depth * z[i - 1] ** 2)
    return z


def _flapping(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) two levels, of correlation exp(-lag/``gust_time``), behind a lag of ``time``.

    Followed exactly from turn to turn, from long before; of variance gust_time/(gust_time + time)
    where the levels are 1 and -1.
    """
    early, lasting = 30.0 * part.time, n * interval
    count = rng.poisson(0.5 * (lasting + early) / part.gust_time)
    turns = np.concatenate([[-early], np.sort(rng.uniform(-early, lasting, count))])
    levels = np.where((np.arange(count + 1) + rng.integers(2)) % 2 == 0, 1.0, -1.0)
    left = np.exp(-np.diff(turns, prepend=-early) / part.time)
    # at every turn what the level before has made of it
    kicks = np.concatenate([[0.0], levels[:-1] * (1.0 - left[1:])])
    begun = _forgetting(left, kicks)
    at = np.arange(n) * interval
    k = np.searchsorted(turns, at, side="right") - 1
    x: FloatArray = levels[k] + (begun[k] - levels[k]) * np.exp(-(at - turns[k]) / part.time)
    return x * sqrt(1.0 + part.time / part.gust_time)


def _bubbling_covariance(rate: float, lags: FloatArray) -> FloatArray:
    """Of unit pulses that die out and come ``rate`` in a time; lags in units of that.

    Waits of two exponential stages: after one the next is missing, rate (1 - exp(-4 rate lag)) is
    how densely others come (Cox and Lewis, The Statistical Analysis of Series of Events, 1966).
    """
    gap = 4.0 * rate
    missing = (gap * np.exp(-lags) - np.exp(-gap * lags)) / (gap**2 - 1.0)
    return np.asarray(0.5 * rate * np.exp(-lags) - rate**2 * missing)


def _bubbles(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) equal pulses that die out in a ``time`` and wait for each other, less their mean."""
    before = ceil(30.0 * part.time / interval)
    lasting = (before + n) * interval / part.time
    stages = 2.0 * part.rate * lasting
    waits = rng.exponential(0.5 / part.rate, ceil(stages + 8.0 * sqrt(stages) + 40.0))
    ends = np.cumsum(waits)[rng.integers(2) :: 2]  # the first one finds itself in either stage
    at = ends[ends < lasting] * part.time / interval  # in samples
    seen = at.astype(np.int64) + 1
    x = _dying_out(seen, (seen - at) * interval, 1.0, part.time, n, before, interval)
    return (x - part.rate) / sqrt(float(_bubbling_covariance(part.rate, np.zeros(1))[0]))


def _resting_correlation(lags: FloatArray) -> FloatArray:
    """Of a random walk that drifts on to a stop; lags in units of its variance over drift squared.

    Abate and Whitt, Adv. Appl. Prob. 19, 560, 1987; what is beyond 80 is less than rounding.
    """
    t = np.minimum(lags, 80.0)
    root = np.sqrt(t)
    beyond, density = 0.5 * erfc(root / sqrt(2.0)), np.exp(-0.5 * t) / sqrt(2.0 * pi)
    return np.asarray(2.0 * (1.0 - 2.0 * t - t**2) * beyond + 2.0 * root * (1.0 + t) * density)


def _resting(step: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) height above a stop of what drifts on to it and is thrown about, less its mean.

    Of unit drift and variance it is exponentially distributed, of mean 1/2.
    """
    return 2.0 * _above_a_stop(step, n, rng)[0] - 1.0


def _above_a_stop(
    step: float, n: int, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Height (n,) of what drifts on to a stop, and whether it touched it since the last sample.

    The stop has pushed it up by as much as the free walk would have come below, whose lowest place
    between two samples is drawn exactly: of a bridge from 0 to d, (d - sqrt(d^2 + 2 e step))/2 with
    e exponential.
    """
    free = sqrt(step) * rng.standard_normal(n) - step
    lowest = 0.5 * (free - np.sqrt(free**2 + 2.0 * step * rng.exponential(size=n)))
    free[0] = lowest[0] = 0.0
    begin = rng.exponential(0.5)
    walk = begin + np.cumsum(free)
    below = walk - free + lowest
    pushed = np.minimum(np.minimum.accumulate(below), 0.0)
    return walk - pushed, np.diff(pushed, prepend=0.0) < 0.0


def _clipped_variance(level: float) -> float:
    """Of a unit Gaussian that is cut off at ``level``, up and down."""
    beyond, density = erfc(level / sqrt(2.0)), exp(-0.5 * level**2) / sqrt(2.0 * pi)
    return float(1.0 - beyond - 2.0 * level * density + level**2 * beyond)


def _clipped_correlation(level: float, own: FloatArray, n_angles: int = 60) -> FloatArray:
    """Of two that are cut off at ``level`` and correlate by ``own`` (n,) before.

    The second derivative of their covariance by that is the density of both at one of the levels
    (Price, IRE Trans. Inf. Theory 4, 69, 1958), the first one at 0 the share that is within.
    """
    nodes, weights = np.polynomial.legendre.leggauss(n_angles)
    # correlations as sines of angles: the density's pole at 1 goes
    whole = np.arcsin(np.minimum(own, 1.0))
    angle = 0.5 * whole[:, None] * (nodes + 1.0)
    r = np.sin(angle)
    same, other = np.exp(-(level**2) / (1.0 + r)), np.exp(-(level**2) / np.maximum(1.0 - r, 1e-15))
    bent = (own[:, None] - r) * (same - other) @ weights * 0.5 * whole / pi
    within = 1.0 - erfc(level / sqrt(2.0))
    return np.asarray((within**2 * own + bent) / _clipped_variance(level))


def _dry_correlation(lags: FloatArray) -> FloatArray:
    """Of a speed under dry friction; lags in units of its variance over the friction squared.

    2 exp(-t/2) times the integral of (1 + s - s^3/3) exp(-s) over a Gaussian of variance t, from 0
    on: what has not yet come to rest (Touchette, Van der Straeten and Just, J. Phys. A 43, 445002,
    2010); what is beyond 80 is less than rounding.
    """
    t = np.minimum(lags, 80.0)
    root = np.sqrt(t)
    beyond, density = 0.5 * erfc(root / sqrt(2.0)), np.exp(-0.5 * t) / sqrt(2.0 * pi)
    still = beyond * (1.0 - t + t**2 + t**3 / 3.0)
    return np.asarray(2.0 * (still + density * root * (1.0 - (2.0 * t + t**2) / 3.0)))


def _dry(step: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) speed that is thrown about and driven to rest by dry friction, the same at any speed.

    Its modulus is that of what drifts on to a stop; whenever that is touched it goes on either way.
    Of unit friction and variance it is exponentially distributed to both sides, of variance 1/2.
    """
    modulus, touched = _above_a_stop(step, n, rng)
    signs = np.where(rng.random(n) < 0.5, 1.0, -1.0)
    touched[0] = True
    speed: FloatArray = modulus * signs[_last_marked(touched)]
    return sqrt(2.0) * speed


def _sinking(step: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) highest of the crests that came at random, each sunk by its age, less its mean.

    Heights above any level are exponential, hence Gumbel's distribution, of variance pi^2/6; after
    a time it is the larger one of what is left and of new crests, and correlated as the
    dilogarithm tells (Tiago de Oliveira, Statistical Extremes and Applications, 1984).
    """
    crests = rng.gumbel(size=n)
    crests[1:] += np.log(-np.expm1(-step))
    age = step * np.arange(n)
    level: FloatArray = np.maximum.accumulate(crests + age) - age
    return (level - np.euler_gamma) / sqrt(pi**2 / 6.0)


def _phase_correlation(r: FloatArray) -> FloatArray:
    """Of the phase between -pi and pi of light whose field remembers ``r``.

    As a Fourier series of the phase it is 1 - 3 |d|/pi + 3/2 (d/pi)^2 in the mean over differences
    d, with both of their moments known (Middleton, Statistical Communication Theory, 1960, 9.1).
    """
    turned = np.arcsin(r) / pi
    return np.asarray(1.5 * turned * (1.0 + turned) - 0.75 * spence(1.0 - r**2) / pi**2)


def _passing(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) what charges of either sign and any size induce that fly past: s exp(-s^2/2) each.

    s is the time from when they are nearest, ``rate`` of them come in a ``time``.
    """
    reach = ceil(6.0 * part.time / interval)
    total = n + 2 * reach
    at = rng.uniform(0.0, total, rng.poisson(part.rate * total * interval / part.time))
    charges = rng.standard_normal(len(at))
    nearest = at.astype(np.int64)
    x = np.zeros(total + 2 * reach + 1)
    for k in range(2 * reach + 1):
        s = (nearest + k - reach - at) * (interval / part.time)
        x += np.bincount(nearest + k, charges * s * np.exp(-0.5 * s**2), len(x))
    # of the mean square, sqrt(pi)/2 a pulse (Campbell's theorem)
    return x[2 * reach : 2 * reach + n] / sqrt(0.5 * sqrt(pi) * part.rate)


def _restarted_correlation(decay: float, n: int) -> FloatArray:
    """(n,) of means that each go on with the share ``decay`` of a chance.

    Means of k and of k + lag readings share k of them, their covariance is 1/(k + lag); k of them
    there are with (1 - decay) decay^(k - 1), so that all of it is what is left of a logarithm.
    """
    whole = -np.log1p(-decay)
    k = np.arange(1.0, float(n))
    return np.asarray(1.0 - np.concatenate([[0.0], np.cumsum(decay**k / k)]) / whole)


def _last_marked(marked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n,) index of the last one that is ``marked`` (n,), as the first must be, up to each."""
    last: NDArray[np.int64] = np.maximum.accumulate(np.where(marked, np.arange(len(marked)), 0))
    return last


def _restarted(decay: float, e: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(n,) mean of independent ``e`` (n,) since a restart, as there is none with ``decay``.

    The first one stands for the mean of as many as there would have been.
    """
    n = len(e)
    begins = rng.random(n) >= decay
    begins[0] = True
    at = np.flatnonzero(begins)
    last = _last_marked(begins)
    since = np.arange(n) - last + 1.0
    earlier = float(rng.geometric(1.0 - decay)) - 1.0
    before = sqrt(earlier) * float(rng.standard_normal())
    sums = np.cumsum(e)
    sums -= sums[last] - e[last]
    first = slice(0, at[1] if len(at) > 1 else n)
    sums[first] += before
    since[first] += earlier
    shown: FloatArray = sums / since * sqrt(decay / ((1.0 - decay) * -np.log1p(-decay)))
    return shown


def _slowing_correlation(part: Component, lags: FloatArray) -> FloatArray:
    """Mean of exp(-rate lag) over rates between 1/time and 1/(depth time), any as likely."""
    slow = lags / part.time
    wide = np.maximum((1.0 / part.depth - 1.0) * slow, 1e-12)
    return np.asarray(-np.exp(-slow) * np.expm1(-wide) / wide)


def _slowing(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    """(n,) Ornstein-Uhlenbeck process whose rate goes evenly from one end to the other, or back.

    Its variance stays what it is; only how soon it forgets does not.
    """
    course = (np.arange(n) + 0.5) / n
    if rng.random() < 0.5:
        course = 1.0 - course
    own = (1.0 + (1.0 / part.depth - 1.0) * course) * interval / part.time
    kicks = _innovations(n, rng, tails)
    kicks[1:] *= np.sqrt(-np.expm1(-2.0 * own[1:]))
    x: FloatArray = _forgetting(np.exp(-own), kicks)
    return x


def _loudness(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) exponential of an Ornstein-Uhlenbeck process of rms ``depth``, of unit mean square."""
    decay = exp(-interval / part.gust_time)
    level = _remembering(rng.standard_normal(n), decay)
    loudness: FloatArray = np.exp(part.depth * level - part.depth**2)
    return loudness


def _bits(decay: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) sum of steps up or down of equal size, of which ``decay`` is left a sample later."""
    before = ceil(20.0 / -np.log(decay)) if decay > 0.0 else 0
    steps = np.where(rng.random(n + before) < 0.5, 1.0, -1.0)
    x: FloatArray = lfilter([sqrt(1.0 - decay**2)], [1.0, -decay], steps)[before:]
    return x


def _bell(time: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) of autocorrelation exp(-(lag/``time``)^2), by circulant embedding.

    On a stretch so long that nothing is left of it at the end, where the embedding is exact but for
    rounding.
    """
    lags = np.arange(max(n, ceil(8.0 * time / interval)) + 1, dtype=float) * interval
    return _embedded(np.exp(-((lags / time) ** 2)), rng)[:n]


def _window(time: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) white noise integrated over the ``time`` before each sample.

    Such a window spans m whole intervals and the last part of one more, so that each interval's
    integral is drawn in two parts.
    """
    whole = int(time // interval)
    part = time - whole * interval
    late = sqrt(part) * rng.standard_normal(n + whole)
    both = late + sqrt(max(interval - part, 0.0)) * rng.standard_normal(n + whole)
    sums = np.concatenate([[0.0], np.cumsum(both)])
    moving: FloatArray = (sums[whole + 1 :] - sums[1 : n + 1] + late[:n]) / sqrt(time)
    return moving


def _shot(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) pulses that come at random and die out, of exponentially distributed heights.

    Their mean, ``rate`` times the mean height, is taken off (Campbell's theorem: the variance is
    ``rate``/2 times the mean squared height).
    """
    before, seen, late = _arrivals(part, n, interval, rng)
    heights = rng.exponential(size=len(seen))
    x = _dying_out(seen, late, heights, part.time, n, before, interval)
    return (x - part.rate) / sqrt(part.rate)


def _dying_out(
    seen: NDArray[np.int64],
    late: FloatArray,
    heights: FloatArray | float,
    time: float,
    n: int,
    before: int,
    interval: float,
) -> FloatArray:
    """(n,) sum of pulses that die out in a ``time``, from ``before`` samples earlier on.

    ``seen`` (m,): the samples that show them first, so ``late`` (m,) s after they came.
    """
    arriving = np.bincount(seen, heights * np.exp(-late / time), before + n)[: before + n]
    x: FloatArray = lfilter([1.0], [1.0, -exp(-interval / time)], arriving)[before:]
    return x


def _arrivals(
    part: Component, n: int, interval: float, rng: np.random.Generator
) -> tuple[int, NDArray[np.int64], FloatArray]:
    """Samples before the first one, where pulses are seen first (m,), and how late (m,) s."""
    before = ceil(20.0 * part.time / interval)
    total = n + before
    count = rng.poisson(part.rate * total * interval / part.time)
    at = rng.uniform(0.0, total, count)  # in samples; a pulse is seen from the next sample on
    seen = at.astype(np.int64)
    return before, seen, (seen + 1 - at) * interval


def _sparks(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) pulses that come at random and ring out, of exponential heights and any phase.

    Campbell's theorem: their variance is ``rate``/4 times the mean squared height.
    """
    before, seen, late = _arrivals(part, n, interval, rng)
    turn = -1.0 / part.time + 2j * pi * part.frequency
    phases = 2j * pi * rng.random(len(seen))
    struck = rng.exponential(size=len(seen)) * np.exp(phases + turn * late)
    arriving = np.zeros(n + before, dtype=complex)
    np.add.at(arriving, seen, struck)
    x: FloatArray = lfilter([1.0], [1.0, -np.exp(turn * interval)], arriving)[before:].real
    return x / sqrt(0.5 * part.rate)


def _echo_variance(part: Component) -> float:
    """Of a process of unit variance together with its echo."""
    return 1.0 + part.depth**2 + 2.0 * part.depth * exp(-1.0 / (part.frequency * part.time))


def _echo(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    """(n,) Ornstein-Uhlenbeck process and its echo, whose samples lie between those of the first.

    The process is stepped from each sample to the echo's time between it and the next, and on.
    """
    delay = 1.0 / part.frequency
    whole = int(delay // interval)
    rest = min(max(delay - whole * interval, 0.0), interval)
    first, second = exp(-(interval - rest) / part.time), exp(-rest / part.time)
    e = _innovations(n + whole + 1, rng, tails)
    between = sqrt(1.0 - first**2) * _innovations(n + whole + 1, rng, tails)
    kicks = sqrt(1.0 - second**2) * e
    kicks[1:] += second * between[:-1]
    kicks[0] = e[0]
    x: FloatArray = lfilter([1.0], [1.0, -first * second], kicks)
    echo = first * x + between
    both: FloatArray = x[whole + 1 :] + part.depth * echo[:n]
    return both / sqrt(_echo_variance(part))


def _von_karman(lags: FloatArray) -> FloatArray:
    """Autocorrelation of a turbulent stream's fluctuations along it; lags in units of ``time``.

    2^(2/3)/Gamma(1/3) l^(1/3) K_1/3(l), with the spectrum (1 + (2 pi f)^2)^(-5/6) (von Karman,
    Proc. Natl. Acad. Sci. 34, 530, 1948).
    """
    total = np.ones_like(lags)
    later = lags > 0
    total[later] = 2.0 ** (2.0 / 3.0) / gamma(1.0 / 3.0) * np.cbrt(lags[later])
    total[later] *= kv(1.0 / 3.0, lags[later])
    return total


def _embedded(R: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(n,) by circulant embedding, exact as the autocorrelation ``R`` (n + 1,) is convex

    Dietrich and Newsam, SIAM J. Sci. Comput. 18, 1088, 1997.
    """
    n = len(R) - 1
    spectrum = np.fft.rfft(np.concatenate([R, R[-2:0:-1]])).real
    white = np.fft.rfft(rng.standard_normal(2 * n))
    x: FloatArray = np.fft.irfft(np.sqrt(np.maximum(spectrum, 0.0)) * white, 2 * n)[:n]
    return x


def _zeroed(period: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) random walk that starts anew from zero every ``period`` (s), the first time anywhere.

    Its variance is the time since then, period/2 in the mean; walks apart do not correlate, hence
    (1 - lag/period)^2.
    """
    at = np.arange(n) * interval + period * rng.random()
    number = np.floor(at / period)
    first = np.concatenate([[True], np.diff(number) > 0])
    steps = np.where(first, np.sqrt(at - number * period), sqrt(interval)) * rng.standard_normal(n)
    walk = np.cumsum(steps)
    begun = (walk - steps)[first]
    x: FloatArray = (walk - begun[np.cumsum(first) - 1]) / sqrt(0.5 * period)
    return x


def _coupling_time(part: Component) -> float:
    """s of the capacitor; the noise itself is always faster."""
    return max(1.0 / (2.0 * pi * part.frequency), 1.5 * part.time)


def _coupled(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    """(n,) Ornstein-Uhlenbeck process through a high-pass filter of one pole.

    That is a lag of white noise less another, slower lag of the same white noise.
    """
    slow = _coupling_time(part)
    a, b = 1.0 / part.time, 1.0 / slow
    rates = np.array([a, b])
    # lags r exp(-r s) of unit white noise: covariance r q/(r + q), and what an interval adds to it
    sums = np.add.outer(rates, rates)
    stationary = np.outer(rates, rates) / sums
    added = stationary * -np.expm1(-sums * interval)
    e = np.array([_innovations(n, rng, tails), rng.standard_normal(n)])
    kicks = np.linalg.cholesky(added) @ e
    kicks[:, 0] = np.linalg.cholesky(stationary) @ e[:, 0]
    fast: FloatArray = lfilter([1.0], [1.0, -exp(-a * interval)], kicks[0])
    late: FloatArray = lfilter([1.0], [1.0, -exp(-b * interval)], kicks[1])
    passed: FloatArray = (fast - late) / sqrt(0.5 * (a - b) ** 2 / (a + b))
    return passed


def _hat_with_hat(lags: FloatArray) -> FloatArray:
    """Autocorrelation of straight lines between independent values at unit distance.

    The hat function with itself, a cubic B-spline, over its value at 0.
    """
    near = 1.0 - 1.5 * lags**2 + 0.75 * lags**3
    far = 0.25 * np.maximum(2.0 - lags, 0.0) ** 3
    return np.where(lags < 1.0, near, far)


def _drawn_lines(time: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) straight lines between independent readings ``time`` apart, the first one anywhere.

    Between readings two share the work: the variance is 2/3 of theirs in the mean.
    """
    at = np.arange(n) * (interval / time) + rng.random()
    readings = rng.standard_normal(int(at[-1]) + 2)
    lines: FloatArray = np.interp(at, np.arange(len(readings)), readings) / sqrt(2.0 / 3.0)
    return lines


def _orders(part: Component) -> FloatArray:
    """Shares of the variance (30,) of the fringes' harmonics."""
    weights = part.depth ** (2.0 * np.arange(1, 31))
    shares: FloatArray = weights / weights.sum()
    return shares


def _fringes(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) sum of depth^k cos(k phase) over k = 1, 2, .., with a phase that walks at random.

    Each passage between the faces adds to the phase and takes its share of the light (Airy).  The
    phase's variance grows by 2/``time``, hence exp(-k^2 lag/time); the voltage has its bounds.
    With ``frequency`` the phase turns evenly besides: pulses, all alike.
    """
    walk = sqrt(2.0 * interval / part.time) * rng.standard_normal(n)
    walk[0] = 2.0 * pi * rng.random()
    phase = 2.0 * pi * part.frequency * interval * np.arange(n) + np.cumsum(walk)
    r = part.depth
    light = 0.5 * (1.0 - r**2) / (1.0 - 2.0 * r * np.cos(phase) + r**2) - 0.5
    fringes: FloatArray = light / sqrt(0.5 * r**2 / (1.0 - r**2))
    return fringes


def _discs(distance: FloatArray) -> FloatArray:
    """Area that two discs share whose centres are ``distance`` diameters apart, over one disc's."""
    d = np.minimum(distance, 1.0)
    shared: FloatArray = (np.arccos(d) - d * np.sqrt(1.0 - d**2)) * 2.0 / pi
    return shared


def _motes(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) less the number of specks in a round beam, which each cross on a straight line.

    Where they cross is anywhere: their ways through the beam are a disc's chords, and their number
    is Poisson's, of mean and variance pi/4 times ``rate``; at two times it is correlated as two
    discs overlap.
    """
    lasting = n * interval + part.time
    enter = rng.uniform(-part.time, n * interval, rng.poisson(part.rate * lasting / part.time))
    leave = enter + part.time * np.sqrt(1.0 - rng.random(len(enter)) ** 2)
    # the first sample that sees each of them, and the first that no longer does
    edges = [np.clip(np.ceil(at / interval), 0, n).astype(int) for at in (enter, leave)]
    come, gone = (np.bincount(edge, minlength=n + 1)[:n] for edge in edges)
    mean = 0.25 * pi * part.rate
    dimmed: FloatArray = (mean - np.cumsum(come - gone)) / sqrt(mean)
    return dimmed


def _speckle(time: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) brightness of light whose field is the sum of many waves, less its mean.

    The field is a complex Ornstein-Uhlenbeck process, its square exponentially distributed and
    correlated as exp(-lag/time) (Goodman, Speckle Phenomena in Optics, 2007).
    """
    field = _remembering(rng.standard_normal((2, n)), exp(-0.5 * interval / time))
    brightness: FloatArray = 0.5 * np.sum(field**2, axis=0) - 1.0
    return brightness


def _whistling(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) a tone that breaks off after exponentially distributed times, for one of another pitch.

    The new one begins anywhere in its turn.
    """
    breaks = rng.random(n) < -np.expm1(-interval / part.time)
    breaks[0] = True
    tone = np.cumsum(breaks) - 1
    count = int(tone[-1]) + 1
    pitches = part.frequency * (1.0 + part.depth * rng.uniform(-1.0, 1.0, count))
    since = (np.arange(n) - np.flatnonzero(breaks)[tone]) * interval
    turns = pitches[tone] * since + rng.random(count)[tone]
    whistle: FloatArray = sqrt(2.0) * np.cos(2.0 * pi * turns)
    return whistle


def _all_pass(part: Component, interval: float) -> tuple[list[float], list[float]]:
    """Coefficients (3,) above and below of a filter that turns ``frequency`` by half a turn.

    It lets all frequencies pass; how soon it forgets is ``time``.
    """
    r2 = exp(-2.0 * interval / part.time)
    middle = -(1.0 + r2) * cos(2.0 * pi * part.frequency * interval)
    return [r2, middle, 1.0], [1.0, middle, r2]


def _notched_correlation(part: Component, n: int, interval: float) -> FloatArray:
    """(n,) autocorrelation of white noise with what an all-pass filter A makes of it.

    |1 + A|^2 = 2 + A + A* with |A| = 1, hence at lags beyond 0 half the answer of A to one pulse
    over 1 + its first sample (Regalia, Mitra and Vaidyanathan, Proc. IEEE 76, 19, 1988).
    """
    above, below = _all_pass(part, interval)
    pulse = np.zeros(n)
    pulse[0] = 1.0
    R: FloatArray = 0.5 * lfilter(above, below, pulse) / (1.0 + above[0])
    R[0] = 1.0
    return R


def _notched(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    """(n,) white noise without ``frequency``, where it and what an all-pass makes of it cancel."""
    above, below = _all_pass(part, interval)
    before = ceil(20.0 * part.time / interval)
    e = _innovations(n + before, rng, tails)
    both: FloatArray = (e + lfilter(above, below, e))[before:]
    return both / sqrt(2.0 * (1.0 + above[0]))


def _charging(time: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) straight rise since the last of the breakdowns, which come at random, less its mean.

    The time since then is exponentially distributed, and correlated as exp(-lag/time): after a
    breakdown nothing is known of before.
    """
    at = np.arange(n) * interval
    breakdowns = np.sort(rng.uniform(0.0, n * interval, rng.poisson(n * interval / time)))
    last = np.concatenate([[-rng.exponential(time)], breakdowns])
    since: FloatArray = at - last[np.searchsorted(breakdowns, at, side="right")]
    return since / time - 1.0


def _smooth(time: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    h = interval / time
    e = exp(-h)
    # state (x, v time): x(h) = e [(1 + h) x + h v], v(h) = e [-h x + (1 - h) v]; unit variances
    step = e * np.array([[1.0 + h, h], [-h, 1.0 - h]])
    added = np.linalg.cholesky(np.eye(2) - step @ step.T + 1e-15 * np.eye(2))
    kicks = added @ rng.standard_normal((2, n))
    start = rng.standard_normal(2)
    # x_i - 2 e x_(i-1) + e^2 x_(i-2) = kicks seen through the first row of step
    drive = np.empty(n)
    drive[0] = start[0]
    if n > 1:
        second = step @ start + kicks[:, 1]
        drive[1] = second[0] - 2.0 * e * start[0]
        drive[2:] = kicks[0, 2:] - step[1, 1] * kicks[0, 1:-1] + step[0, 1] * kicks[1, 1:-1]
    x: FloatArray = lfilter([1.0], [1.0, -2.0 * e, e * e], drive)
    return x
