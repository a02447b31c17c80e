"""The coating: how it takes up the gas and gives it back."""

from __future__ import annotations

from itertools import pairwise
from math import sqrt

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.causes.cause import Causes, Rig, _begins, _between, _mean_step, _sign
from bayes_sensor.reality.records import Case

CAUSES = Causes()
cause = CAUSES.cause


@cause(("sensor_diffusion",), "delay", "share of tau", 1.0)
def layered_coating(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Part of the sensor's delay is diffusion through a film of two layers."""
    for knobs in rig.values():
        knobs.film_share = s


@cause(("sorption_asymmetry",), "fall", "log of the rates", 1.2)
def gated_pores(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Pores open under load and close behind it: uptake is faster than release, or slower."""
    sign = 1.0 if rng.random() < 0.7 else -1.0
    width = _between(rng, 0.002, 0.012)
    for knobs in rig.values():
        knobs.gate, knobs.gate_width = sign * s, width


@cause((), "fall", "K c", 3.0, near=("sorption_asymmetry",))
def site_kinetics(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Langmuir kinetics read on a calibrated scale: the more gas, the faster the sensor."""
    for knobs in rig.values():
        knobs.langmuir = s


@cause((), "fall", "log of the rates", 2.0, near=("sorption_asymmetry",))
def swelling_film(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The coating swells: the more it has taken up, the faster it takes up and gives off."""
    sign = _sign(rng)
    for knobs in rig.values():
        knobs.swelling = sign * s


@cause(("optical_nonlinearity", "sorption_asymmetry"), "fall", "K c", 1.0)
def saturating_sites(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Langmuir kinetics seen as they are: the isotherm's bend shows in the voltage, too."""
    for knobs in rig.values():
        knobs.langmuir, knobs.curved = s, True


@cause(("slow_sorption",), "tail", "share", 0.2)
def slow_sites(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Some sites fill and empty slowly, with a spread of times and a bent isotherm."""
    time = _between(rng, 3.0, 15.0)
    for knobs in rig.values():
        knobs.slow_sites, knobs.slow_sites_time = s, time


@cause((), "ageing", "relative, an experiment", 0.4, per_experiment=True)
def ageing_coating(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The sensor slows down from experiment to experiment."""
    sign = 1.0 if rng.random() < 0.8 else -1.0
    for k, knobs in enumerate(rig.values()):
        knobs.tau_factor = float(np.exp(sign * np.log1p(s) * k))


@cause((), "fall", "share", 0.3)
def sensor_hysteresis(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Uptake and release do not follow one line: part of the response has backlash."""
    for knobs in rig.values():
        knobs.backlash = s


@cause((), "tail", "share", 0.2, near=("slow_sorption",), per_experiment=True)
def sites_that_keep(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Some sites bind the gas for good; experiment by experiment fewer of them are free."""
    time = _between(rng, 20.0, 200.0)
    free = s
    for step in case.steps:
        relative = case.relative_concentration(step)
        knobs = rig[step.name]
        knobs.bound, knobs.bound_time = free / relative, time / relative
        free *= float(np.exp(-(step.tf - step.t0) / knobs.bound_time))


@cause((), "plateau", "share lost", 0.3)
def condensation(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Water condenses on the ring while test gas flows, blocks it in part, and dries off later."""
    onset, speed = rng.uniform(0.15, 0.7), rng.uniform(0.03, 0.12)
    drying = _between(rng, 2.0, 12.0)
    for step in case.steps:
        length = step.tf - step.t0
        size = s * rng.uniform(0.6, 1.4)

        def blocked(
            t: FloatArray,
            t0: float = step.t0,
            tf: float = step.tf,
            length: float = length,
            size: float = size,
        ) -> FloatArray:
            grown = 1.0 / (1.0 + np.exp(-((np.minimum(t, tf) - t0) / length - onset) / speed))
            return -size * grown * np.exp(-np.maximum(t - tf, 0.0) / drying)

        rig[step.name].concentration_gain.append(blocked)


@cause((), "level", "share of the highest step", 0.3, near=("slow_sorption",))
def flipping_cages(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Above some concentration the crystal's cages flip open, in their own time, and take up more.

    The gate of ZIF-8 (Fairen-Jimenez et al., J. Am. Chem. Soc. 133, 8900, 2011); the weaker
    experiments may never reach it.
    """
    at, width = rng.uniform(0.35, 0.75), _between(rng, 0.03, 0.08)
    time = _between(rng, 0.3, 3.0)
    for knobs in rig.values():
        knobs.cages, knobs.cages_at, knobs.cages_width, knobs.cages_time = s, at, width, time


@cause((), "ripple", "relative", 0.08, fast=True)
def swinging_column(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Each switch sets the water of the relief bubbler swinging; the ring feels partial pressure.

    A column of length l between two open ends swings at omega^2 = 2 g/l; 5 cm of water are half a
    per cent of the pressure, and of what the coating takes up.
    """
    omega, damping = sqrt(2.0 * 9.81 / rng.uniform(0.2, 0.8)), _between(rng, 1.5, 8.0)
    largest = max(step.test_gas_flow for step in case.steps)
    for step in case.steps:
        size = s * step.test_gas_flow / largest

        def pressure(
            t: FloatArray, t0: float = step.t0, tf: float = step.tf, size: float = size
        ) -> FloatArray:
            up, down = np.maximum(t - t0, 0.0), np.maximum(t - tf, 0.0)
            rising = np.exp(-up / damping) * np.sin(omega * up)
            return np.asarray(size * (rising - np.exp(-down / damping) * np.sin(omega * down)))

        rig[step.name].concentration_gain.append(pressure)


@cause((), "plateau", "share lost", 0.2, per_experiment=True)
def peeling_coating(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Swollen with gas, the coating comes off in flakes: each takes a share of the response along.

    It does not come back; the next experiment begins with what is left.
    """
    certain = int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        times = np.sort(rng.uniform(0.1, 1.0, int(rng.integers(1, 4))))
        at = step.t0 + times * (step.tf - step.t0)
        left = np.append(1.0, np.cumprod(1.0 - s * rng.uniform(0.3, 1.0, len(at))))
        if k != certain and rng.random() < 0.5:
            continue

        def lost(t: FloatArray, at: FloatArray = at, left: FloatArray = left) -> FloatArray:
            return np.asarray(left[np.searchsorted(at, t, side="right")] - 1.0)

        rig[step.name].concentration_gain.append(lost)
        rig[step.name].marks += [edge for flake in at.tolist() for edge in (flake - 1e-6, flake)]


@cause((), "plateau", "share of the sites", 0.4, near=("slow_sorption",))
def displaced_water(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The carrier is damp: water holds the share ``s`` of the sites until the gas displaces it.

    Both compete for free sites (Langmuir); the gas settles at once with the water, which comes and
    goes slowly.  While it goes the response grows; without gas nobody sees it come back.
    """
    time, load = _between(rng, 2.0, 15.0), _between(rng, 1.0, 4.0)
    for step in case.steps:
        knobs = rig[step.name]
        knobs.damp, knobs.damp_time = s, time
        knobs.displacing = load * case.relative_concentration(step)


@cause((), "tail", "log of the uptake", 0.4, near=("slow_sorption",))
def heat_of_sorption(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Gas that settles warms the coating, which then holds less; leaving, it cools it and is kept.

    Non-isothermal sorption (Ruthven, Lee and Yucel, AIChE J. 26, 16, 1980): the more gas, the
    warmer.  The last of the way is as slow as the heat that goes into the chip.
    """
    time = _between(rng, 1.0, 8.0)
    for step in case.steps:
        knobs = rig[step.name]
        knobs.sorption_heat, knobs.cooling_time = s * case.relative_concentration(step), time


@cause((), "tail", "share", 0.3, near=("slow_sorption",))
def splitting_molecules(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """On some sites the molecules split; the halves must meet again before they can leave.

    They settle at the root of the concentration (Sieverts' law) and leave in pairs: what is left
    falls as one over time, and fills the more slowly, the less gas there is.  At the highest
    concentration such sites make the share ``s`` of the response.
    """
    time = _between(rng, 0.2, 2.0)
    for step in case.steps:
        knobs, root = rig[step.name], sqrt(case.relative_concentration(step))
        knobs.split, knobs.split_time = s / ((1.0 - s) * root + s), time


@cause((), "tail", "share of the highest step", 0.3, near=("slow_sorption",))
def converting_film(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Above some concentration the coating turns into another phase, below it back again.

    As a hydride does: behind a sharp front, which gas must reach through what has turned already.
    It goes as the root of time and stops at the bottom; the way back starts at the surface anew.
    """
    level, time = rng.uniform(0.1, 0.35), _between(rng, 3.0, 30.0)
    for knobs in rig.values():
        knobs.converting, knobs.converting_at, knobs.converting_time = s, level, time


@cause((), "plateau", "log of the uptake", 0.25, near=("gain_drift",), per_experiment=True)
def sun_on_the_cell(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The sun shines on the cell whenever no cloud is before it; warm, the coating takes up less.

    Uptake falls exponentially with temperature (van 't Hoff), which follows the sun in the cell's
    time.  Without gas nobody notices.
    """
    time, lasting = _between(rng, 2.0, 15.0), _between(rng, 4.0, 20.0)
    for step in case.steps:
        edges, sun = [0.0, lasting * rng.random()], [float(rng.random() < 0.5)]
        while edges[-1] < step.duration:
            edges.append(edges[-1] + lasting * rng.uniform(0.3, 1.7))
        warmth = [sun[0]]  # at every edge
        for begin, end in pairwise(edges):
            warmth.append(sun[-1] + (warmth[-1] - sun[-1]) * float(np.exp((begin - end) / time)))
            sun.append(1.0 - sun[-1])

        def less(
            t: FloatArray,
            edges: tuple[float, ...] = tuple(edges),
            sun: tuple[float, ...] = tuple(sun),
            warmth: tuple[float, ...] = tuple(warmth),
        ) -> FloatArray:
            k = np.maximum(np.searchsorted(edges, t, side="right") - 1, 0)
            left = np.exp(-np.maximum(t - np.take(edges, k), 0.0) / time)
            level = np.take(sun, k)
            return np.asarray(np.expm1(-s * (level + (np.take(warmth, k) - level) * left)))

        rig[step.name].concentration_gain.append(less)


@cause((), "tail", "share", 0.3, near=("slow_sorption",))
def glassy_rim(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The coating has dried to a thick glassy rim, into which the gas eats its way evenly.

    Case II transport (Thomas and Windle, Polymer 23, 529, 1982): the front's speed is the
    swelling's, which goes with the concentration, so that this share of the response rises in a
    straight line and stops when the rim is through.  From the soft rim the gas leaves by diffusion.
    """
    time, quicker = _between(rng, 1.0, 8.0), rng.uniform(0.1, 0.5)
    for knobs in rig.values():
        knobs.rim, knobs.rim_time, knobs.rim_back = s, time, quicker * time


@cause((), "tail", "share of the highest step", 0.3, near=("slow_sorption",))
def spreading_islands(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """On the coating the gas condenses in islands, which spread evenly until they have met.

    Above their vapour pressure they grow, below it they shrink, each in proportion to what is too
    much or missing; 1 - exp(-radius^2) is covered (Avrami, J. Chem. Phys. 8, 212, 1940).  So little
    comes at first, and when the gas has gone most of it stays for a while.
    """
    vapour, time = _between(rng, 0.1, 0.35), _between(rng, 0.2, 2.0)
    for knobs in rig.values():
        knobs.islands, knobs.islands_vapour, knobs.islands_time = s, vapour, time


@cause((), "plateau", "share displaced", 0.35)
def late_impurity(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas brings an impurity along, which a filter before the ring holds back for long.

    As in a chromatograph it comes through after the same volume of gas, sooner at larger flow, or
    not at all while the test gas lasts.  On the ring it competes for the sites (Langmuir): ``s`` of
    the response is gone at the highest concentration once all of it has arrived.
    """
    typical = float(np.median([p.total_flow * (p.tf - p.t0) for p in case.steps]))
    volume, n_cells = typical * _between(rng, 0.12, 0.6), int(rng.integers(10, 31))
    for step in case.steps:
        knobs = rig[step.name]
        knobs.impurity = s / (1.0 - s) * case.relative_concentration(step)
        knobs.impurity_volume, knobs.impurity_cells = volume, n_cells


@cause((), "fall", "share of the highest step", 0.4, near=("sorption_asymmetry",))
def capillary_condensation(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """In the coating's pores vapour condenses, in narrow ones first, and leaves them far later.

    An open pore fills from its wall, a full one empties from its ends, whose meniscus is the more
    bent: at the square of the relative pressure at which it filled (Cohan, J. Am. Chem. Soc. 60,
    433, 1938).  All of them together add the share ``s`` of the highest response.
    """
    vapour, width = rng.uniform(0.5, 0.9), _between(rng, 0.05, 0.2)
    at = vapour * rng.uniform(0.3, 0.75)
    for knobs in rig.values():
        knobs.pores, knobs.pores_vapour = s, vapour
        knobs.pores_at, knobs.pores_width = at, width


@cause((), "plateau", "share lost", 0.6)
def poisoned_coating(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Something in the test gas poisons the coating: sites that hold it die, and do not come back.

    Each as likely at any time, so that what is left falls exponentially with the dose; all
    experiments together cost the share ``s``.
    """
    doses = [case.relative_concentration(step) * (step.tf - step.t0) for step in case.steps]
    rate = -np.log1p(-s) / sum(doses)
    had = 0.0
    for step, dose in zip(case.steps, doses, strict=True):
        rig[step.name].poisoning, rig[step.name].alive = float(rate), float(np.exp(-rate * had))
        had += dose


@cause((), "level", "share of the highest step", 0.4, near=("slow_sorption",))
def igniting_coating(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The coating is a catalyst on which the gas burns: beyond some concentration it ignites.

    Burning goes exponentially with its warmth until it takes all that diffusion brings (Frank-
    Kamenetskii, Diffusion and Heat Transfer in Chemical Kinetics, 1969).  Just beyond, the heat
    takes long to run away; once hot it goes on burning below.  Heat moves the line, at the highest
    concentration by ``s`` of the response.
    """
    ignites, time = rng.uniform(0.3, 0.7), _between(rng, 0.5, 4.0)
    brought = rng.uniform(4.5, 8.0) / ignites
    # with warmth = gas/(exp(-warmth)/burns + 1/brought) the gas is at its most where it ignites
    product = ignites * brought
    warmth = 0.5 * (product - sqrt(product**2 - 4.0 * product))
    burns = brought * (warmth - 1.0) * float(np.exp(-warmth))
    hottest = brought
    for _ in range(100):
        hottest = 1.0 / (float(np.exp(-hottest)) / burns + 1.0 / brought)
    for knobs in rig.values():
        knobs.glow, knobs.glow_time = s / hottest, time
        knobs.glow_burns, knobs.glow_brought = burns, brought


@cause((), "plateau", "share of the highest step", 0.3)
def flaring_catalyst(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The coating is a metal on which the gas burns and goes out, by turns, as long as it lasts.

    While it burns the metal oxidises, until it no longer can; then the gas reduces the oxide, the
    sooner, the more there is, until it burns again (Sales, Turner and Maple, Surf. Sci. 114, 381,
    1982).  The heat moves the line, at the highest concentration by up to ``s`` of the response.
    """
    oxidises, reduces = _between(rng, 1.0, 6.0), _between(rng, 0.8, 4.0)
    low, high = rng.uniform(0.2, 0.4), rng.uniform(0.6, 0.8)
    cooling = _between(rng, 0.1, 1.0)
    for knobs in rig.values():
        knobs.flares, knobs.flares_cooling = s, cooling
        knobs.flares_oxidise, knobs.flares_reduce = oxidises, reduces
        knobs.flares_from, knobs.flares_until = low, high


@cause((), "mixing", "of V", 2.0, near=("axial_dispersion",))
def long_fibre(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """In place of a ring a coil of coated fibre is read, which lies along the stream in a duct.

    What is read is the mean of all its turns, and the gas gets to the last of them only when it has
    filled the duct of ``s`` V, without mixing on its way.
    """
    for knobs in rig.values():
        knobs.coil = s


@cause((), "tail", "share of the highest step", 0.3, near=("slow_sorption",))
def uneven_bonds(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Some sites bind the gas firmly, others loosely, and it takes the firmest that are free.

    The fuller they are, the more slowly it settles, exp(-b coverage), and the sooner it leaves
    (Elovich's kinetics); coverage goes as the logarithm of the concentration (Temkin's isotherm),
    and when the gas has gone as that of time.  ``s`` is added at the highest concentration.
    """
    bend, time = rng.uniform(1.2, 3.0), _between(rng, 0.4, 4.0)
    for knobs in rig.values():
        knobs.bonds, knobs.bonds_bend, knobs.bonds_time = s, bend, time


@cause((), "tail", "share of the highest step", 0.4)
def blistering_coating(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Deep below the coating gas is dissolved; when that outside has gone it lifts it in blisters.

    As rubber does when it is decompressed too fast: blisters form for what is dissolved beyond
    what the gas outside and the coating's strength hold down, and empty again in their own time.
    A lifted coating leaves the ring less than it had without gas, by ``s`` at most.  The weaker
    experiments may never see any.
    """
    level, soaks = rng.uniform(0.08, 0.35), _between(rng, 2.0, 10.0)
    time = _between(rng, 0.3, 2.0)
    for knobs in rig.values():
        knobs.blisters, knobs.blisters_level = s, level
        knobs.blisters_soak, knobs.blisters_time = soaks, time


@cause((), "tail", "share of the highest step", 0.4, near=("slow_sorption",))
def deliquescent_salt(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Salt in the coating takes up a moist test gas's water until it is a solution, and dries late.

    It dissolves where there is more moisture than above its saturated solution, and the solution
    comes to Raoult's law.  Drying it is supersaturated until, far below, crystals come out (Tang
    and Munkelwitz, Atmos. Environ. 27A, 467, 1993): from then on it dries at once.  At the highest
    concentration its water adds ``s``; of the weaker ones the salt may never know.
    """
    vapour, time = rng.uniform(0.6, 0.8), _between(rng, 0.05, 0.5)
    dissolves = vapour * rng.uniform(0.3, 0.7)
    comes_out = dissolves * rng.uniform(0.3, 0.7)
    for knobs in rig.values():
        knobs.salt, knobs.salt_vapour, knobs.salt_time = s, vapour, time
        knobs.salt_dissolves, knobs.salt_comes_out = dissolves, comes_out


@cause((), "plateau", "share lost", 0.4)
def loosening_glass(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Full of gas the glassy coating slowly loosens, and thins out what the light sees.

    The looser it already is, the faster it moves: it loosens late and then all at once, and when
    the gas has gone it tightens at first quickly and then hardly any more (Kovacs, Fortschr.
    Hochpolym.-Forsch. 3, 394, 1963).  In the end it takes the share ``s`` of the response.
    """
    time, bend = _between(rng, 3.0, 25.0), rng.uniform(1.0, 3.0)
    for knobs in rig.values():
        knobs.loosened, knobs.loosening_time, knobs.loosening_bend = s, time, bend


@cause((), "ageing", "s", 3.0, per_experiment=True)
def drying_drop(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The cell was rinsed before the campaign, and a flat drop is left lying on the ring.

    Gas must fill and leave all of it through its surface, which takes ``s`` at first and the less,
    the thinner it is; it dries evenly, record after record, and at some time it is gone.
    """
    begins = _begins(case)
    gone = rng.uniform(0.35, 0.95) * float(begins[-1])
    for begin, step in zip(begins.tolist(), case.steps, strict=False):

        def thick(t: FloatArray, begin: float = begin) -> FloatArray:
            return np.asarray(s * np.maximum(1.0 - (begin + t) / gone, 0.0))

        if begin < gone:
            rig[step.name].drop = thick
            if gone < begin + step.duration:
                rig[step.name].marks.append(gone - begin)


@cause((), "tail", "share of the highest step", 0.4, near=("slow_sorption",))
def cooperative_chains(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Amines in the coating's pores bind the gas in chains, each link of which eases the next one.

    Chains grow at their ends above some concentration and come apart there below it, so that the
    isotherm is a step (McDonald et al., Nature 519, 303, 2015).  A few seeds must first be there,
    on the way up, and a few gaps on the way down: either way is a logistic curve, late and then
    all at once, the later the less the gas is beyond.  ``s`` is added where all is bound.
    """
    level, time = rng.uniform(0.1, 0.35), _between(rng, 0.1, 1.0)
    seeds = _between(rng, 1e-3, 3e-2)
    for knobs in rig.values():
        knobs.chains, knobs.chains_level = s, level
        knobs.chains_seeds, knobs.chains_time = seeds, time


@cause((), "tail", "share", 0.4, near=("slow_sorption", "sorption_asymmetry"))
def stacked_layers(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Gas settles on itself on part of the coating, and only what lies on top can leave.

    That many molecules at any time, however many wait below: their share ``s`` of the response goes
    down evenly (desorption of order zero), and the longer, the more gas there was.  It settles as
    fast as it comes, which is why a rise does not show it.
    """
    time = _between(rng, 2.0, 15.0)
    for knobs in rig.values():
        knobs.stacked, knobs.stacked_time = s, time


@cause((), "plateau", "share of the response", 0.7)
def unwashed_pores(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A fresh coating's pores still hold the solvent it was made in, which test gas washes out.

    ``s`` of the response is missing at first, and any molecule of it is as likely to go at any
    time that gas is there: the first experiment sees most of that, the others ever less.
    """
    doses = [case.relative_concentration(step) * (step.tf - step.t0) for step in case.steps]
    rate, had = 1.0 / (_between(rng, 0.2, 1.2) * float(np.mean(doses))), 0.0
    for step, dose in zip(case.steps, doses, strict=True):
        knobs = rig[step.name]
        knobs.unwashed, knobs.washing = s * float(np.exp(-rate * had)), rate
        had += dose


@cause((), "plateau", "share of the step", 0.4)
def glimmering_reagent(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A reagent in the coating glimmers as the gas oxidises it, and some of that light is received.

    By ``s`` at the highest concentration as long as all of the reagent is there; gas uses it up,
    and all the time more of it creeps in from below.  What is spent is missing in the next record.
    """
    uses, creeps, left = _between(rng, 1.0, 8.0), _between(rng, 5.0, 80.0), 1.0
    for step in case.steps:
        knobs = rig[step.name]
        knobs.glimmer, knobs.glimmer_left = s * _mean_step(case), left
        knobs.glimmer_uses, knobs.glimmer_creeps = uses, creeps
        rate = 1.0 / creeps + case.relative_concentration(step) / uses
        late = case.tau_v + case.V / step.total_flow + case.tau  # as a plain pulse comes and goes
        left = 1.0 + (left - 1.0) * float(np.exp(-(step.t0 + late) / creeps))
        balance = 1.0 / (creeps * rate)
        left = balance + (left - balance) * float(np.exp(-rate * (step.tf - step.t0)))
        left = 1.0 + (left - 1.0) * float(np.exp(-(step.duration - step.tf - late) / creeps))


@cause((), "level", "share of the response", 0.9)
def avalanching_crystal(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The coating is a crystal whose domains turn with the gas, by avalanches.

    A wall between them clings to a defect until the gas has pulled it to the next one, and then
    goes there of a sudden (Barkhausen).  Where the defects are never changes, but on its way back
    it leaves them elsewhere.  ``s`` of the response is the domains'.
    """
    mean = _between(rng, 0.06, 0.25)
    gaps = rng.exponential(mean, int(np.ceil(20.0 / mean)))
    places = 0.01 + np.concatenate([[0.0], np.cumsum(gaps)])  # or it never quite gets back there
    for knobs in rig.values():
        knobs.avalanches, knobs.pinned_at = s, places


@cause(
    (), "plateau", "share of the highest step", 0.4, near=("slow_sorption",), per_experiment=True,
    reserve=True,
)  # fmt: skip
def late_nucleus(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """With the coating's water the gas makes a hydrate, once chance has made a first crystal of it.

    Beyond some concentration a nucleus is as likely at any time, in proportion to what is too much
    (Toschev, Milchev and Stoyanov, J. Cryst. Growth 13, 123, 1972).  From there on the crystal
    grows evenly across the ring, where it adds the share ``s``, and melts as evenly when the gas
    has gone.  Some experiments are over before it begins, weak ones never come so far.
    """
    level = rng.uniform(0.15, 0.45)
    mean, time = _between(rng, 2.0, 12.0), _between(rng, 0.8, 6.0)
    highest = max(case.steps, key=lambda step: step.concentration)
    for step in case.steps:
        wait = mean * float(rng.standard_exponential())
        if step is highest:  # one has it for certain
            wait = min(wait, 0.4 * (1.0 - level) * (step.tf - step.t0))
        knobs = rig[step.name]
        knobs.crystal, knobs.crystal_level = s, level
        knobs.crystal_wait, knobs.crystal_time = wait, time


@cause((), "tail", "share", 0.4, near=("slow_sorption", "sorption_asymmetry"), reserve=True)
def starved_grains(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Grains in the coating are so greedy that they must wait for the gas, which is at rest above.

    A film of it lets through what its concentration differs by, from the stream's to that above the
    grains, which is hardly any until they are full (Helfferich, Ion Exchange, 1962): their share
    ``s`` of the response rises in a straight line, later the less gas there is, and is long in
    giving the last of it back.  The film is thinner by the root of the flow (Schlichting,
    Boundary-Layer Theory, 1979).
    """
    bend, time = _between(rng, 2.0, 12.0), _between(rng, 0.8, 5.0)
    weakest = min(step.total_flow for step in case.steps)
    for knobs in rig.values():
        knobs.starved, knobs.starved_bend = s, bend
        knobs.starved_time, knobs.starved_flow = time, weakest
