"""The laws that noise is drawn from: their names, and the components of each."""

from __future__ import annotations

from math import exp, sqrt

import numpy as np

from bayes_sensor.campaign import CampaignError
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
    "railed_microphone", "three_stages", "fitful_bearing",
    "faded_echo", "wandering_spot", "fluttering_loop",
)  # fmt: skip
"""laws for every run; ``ar1`` and ``white`` are within the package's own noise model"""
RESERVE_LAWS = ("few_photons", "retuned_filter", "chaotic_laser")
"""kept out of every run but the last"""
HEAVY_TAILED = (
    "shot", "gusty", "sparks", "pulsing", "speckle", "interleaved", "dusty", "intermittent",
    "waning", "two_paced", "drilling", "crackling_cable", "sparkling_codes",
    "startled_receiver", "bubbling_nozzle", "drifting_balance", "median_of_three",
    "restarted_mean", "weak_reference", "repeated_packets", "fitful_bearing", "fluttering_loop",
    "few_photons",
)  # fmt: skip
"""laws whose innovations have clearly more large values than a Gaussian's: pulses, changing
loudness, readings that are shown again, leaps, quotients, gains that flutter, and small counts"""


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
    echoed, spotted = own.uniform(0.05, 0.2), own.uniform(0.1, 0.3)
    parts |= {
        # a receiver of scattered light with a logarithmic scale, far down on it whenever that fades
        "faded_echo": (
            Component(1.0 - echoed),
            Component(echoed, exp(own.uniform(np.log(0.03), np.log(0.5))), shape="fading"),
        ),
        # a beam whose spot wanders over a grainy mirror, and comes by the same grains again
        "wandering_spot": (
            Component(1.0 - spotted),
            Component(spotted, exp(own.uniform(np.log(0.05), np.log(1.0))), shape="landscape"),
        ),
        # an amplifier that is fed back its own output, by a share that a bad contact makes flutter
        "fluttering_loop": (
            Component(
                1.0, exp(own.uniform(np.log(2e-3), np.log(0.03))), shape="fluttering",
                depth=own.uniform(0.2, 0.27),
            ),
        ),
    }  # fmt: skip
    counted, chaotic = own.uniform(0.7, 0.95), own.uniform(0.4, 0.8)
    parts |= {
        # a counter that finds but a few photons, or none, in the time of a reading
        "few_photons": (
            Component(1.0 - counted, exp(own.uniform(np.log(0.02), np.log(0.2)))),
            Component(counted, shape="counts", rate=exp(own.uniform(np.log(0.3), np.log(1.5)))),
        ),
        # a receiver whose filter somebody turns between the records, quicker or slower
        "retuned_filter": (
            Component(
                1.0, exp(own.uniform(np.log(0.02), np.log(0.1))), shape="retuned",
                depth=exp(own.uniform(np.log(0.02), np.log(0.1))),
            ),
        ),
        # a laser that its own light, sent back, drives into chaos: each reading makes the next one
        "chaotic_laser": (
            Component(1.0 - chaotic, exp(own.uniform(np.log(0.02), np.log(0.2)))),
            Component(chaotic, shape="chaos", depth=own.uniform(0.55, 0.7)),
        ),
    }  # fmt: skip
    if name not in parts:
        raise CampaignError(f"noise law: expected one of {', '.join(parts)}, got '{name}'")
    return NoiseLaw(name, sigma0, sigma1, parts[name])
