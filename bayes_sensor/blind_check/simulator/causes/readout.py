"""Ring, fibre and laser: what is read of the resonance, and what else moves it or the light."""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.random import Generator

from bayes_sensor.blind_check.simulator.causes.cause import Causes, log_uniform, random_sign
from bayes_sensor.blind_check.simulator.simulated_rig import Course, Rig
from bayes_sensor.campaign import FloatArray

CAUSES = Causes()


@CAUSES.cause(("optical_nonlinearity",), "fall", "half-widths", 0.5)
def lorentzian_flank(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The dip moves past the laser: the whole Lorentzian, not its tangent, is read."""
    at = float(rng.choice([rng.uniform(-2.0, -1.2), rng.uniform(0.15, 0.3)]))
    shift, step = s * rig.relative, rig.step

    def dip(z: FloatArray | float) -> FloatArray:
        """Depth of the Lorentzian at a detuning of ``z`` half-widths, 1 at its centre."""
        return np.asarray(1.0 / (1.0 + np.square(z)))

    def read(t: FloatArray, x: FloatArray) -> FloatArray:
        rest, full = dip(at), dip(at + shift)
        return step.y0 + step.beta * ((dip(at + shift * x) - rest) / (full - rest))

    rig.readout = read


def _thermal_course(rng: Generator, duration: float) -> Course:
    """A drift of unit size: warming up, or half a swing of the room's temperature."""
    if rng.random() < 0.6:
        time = rng.uniform(0.3, 2.0) * duration
        end = 1.0 - float(np.exp(-duration / time))
        return lambda t: (1.0 - np.exp(-np.maximum(t, 0.0) / time)) / end
    period, phase = rng.uniform(1.2, 3.0) * duration, rng.uniform(0.0, 2.0 * pi)
    return lambda t: np.sin(2.0 * pi * t / period + phase) - np.sin(phase)


@CAUSES.cause(("gain_drift",), "drift", "relative", 0.1, per_experiment=True)
def fading_laser(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The optical power, and with it the whole voltage, fades or recovers."""
    shared = rng.standard_normal()
    size = s * float(0.8 * shared + 0.6 * own.standard_normal())
    course = _thermal_course(own, rig.step.duration)
    rig.scale(lambda t: size * course(t))


@CAUSES.cause(("baseline_drift",), "drift", "share of the step", 0.1, per_experiment=True)
def thermal_drift(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The resonance drifts with the room's temperature."""
    largest, shared = s * rig.case.mean_step, rng.standard_normal()
    size = largest * float(0.7 * shared + own.standard_normal())
    course = _thermal_course(own, rig.step.duration)
    rig.add(lambda t: size * course(t))


@CAUSES.cause(("baseline_step",), "drift", "share of the step", 0.1, per_experiment=True)
def knocked_fibre(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The alignment moves once and stays: at the end of the pulse, or at a time of its own."""
    after_pulse = rng.random() < 0.6
    width, sign = log_uniform(rng, 0.05, 1.0), random_sign(rng)
    when = rng.uniform(0.1, 0.9)
    size = sign * s * rig.case.mean_step * own.uniform(0.5, 1.5)
    at = rig.step.tf + 2.0 * width if after_pulse else when * rig.step.duration
    rig.add(lambda t: size * (0.5 * (1.0 + np.tanh((t - at) / width))))
    rig.marks.append(float(at))


@CAUSES.cause((), "drift", "relative", 0.1, per_experiment=True)
def mode_hop(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The laser hops to another mode and back: its power differs for a while."""
    if own.random() < 0.3:
        return
    begin = own.uniform(rig.step.t0, rig.step.tf - 3.0)
    end = begin + log_uniform(own, 1.0, 10.0)
    size = s * random_sign(own)
    rig.scale(lambda t: np.where((t >= begin) & (t < end), size, 0.0))
    rig.marks += [begin, end]


@CAUSES.cause((), "spike", "share of the step", 0.3, per_experiment=True)
def passing_bubble(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Droplets pass the ring now and then: the signal dips and recovers."""
    n = int(own.integers(1, 4))
    at = own.uniform(0.05, 0.95, n) * rig.step.duration
    size = s * abs(rig.step.beta) * own.uniform(0.4, 1.0, n)
    lasts = np.exp(own.uniform(np.log(0.3), np.log(3.0), n))

    def dips(t: FloatArray) -> FloatArray:
        since = np.maximum(t[:, None] - at, 0.0) / lasts
        return np.asarray((since * np.exp(1.0 - since)) @ -size)

    rig.add(dips)
    rig.marks += at.tolist()


@CAUSES.cause((), "drift", "share of the step", 0.15, near=("baseline_step",), per_experiment=True)
def room_lamp(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Somebody turns the room's lamp on for a while, and its light falls on the photodiode.

    A fluorescent tube: at once most of its light, the rest as it warms up.
    """
    certain, at_once = int(rng.integers(len(rig.case.steps))), rng.uniform(0.5, 0.9)
    time = log_uniform(rng, 2.0, 15.0)
    on = own.uniform(0.05, 0.7) * rig.step.duration
    off = on + log_uniform(own, 0.05, 0.5) * rig.step.duration
    if rig.number != certain and own.random() < 0.4:
        return

    def light(t: FloatArray) -> FloatArray:
        warm = 1.0 - (1.0 - at_once) * np.exp(-np.maximum(t - on, 0.0) / time)
        return s * rig.case.mean_step * np.where((t >= on) & (t < off), warm, 0.0)

    rig.add(light)
    rig.marks += [on, off]


# ------------------------------------------------------------------- kept for the final run


@CAUSES.cause((), "level", "share of the step", 0.2, near=("optical_nonlinearity",), reserve=True)
def fringes(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """A connector reflects: a fringe of its cavity lies on what is read of the moving resonance.

    One and a half to five fringes pass as the signal goes from its baseline to the highest plateau.
    """
    many, phase = rng.uniform(1.5, 5.0), rng.uniform(0.0, 2.0 * pi)
    shift, size, clear = rig.relative, s * rig.case.mean_step, rig.readout

    def read(t: FloatArray, x: FloatArray) -> FloatArray:
        fringe = np.sin(2.0 * pi * many * shift * x + phase) - np.sin(phase)
        return np.asarray(clear(t, x) + size * fringe)

    rig.readout = read


@CAUSES.cause((), "drift", "relative", 0.4, per_experiment=True, reserve=True)
def swaying_fibre(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """A door slams, the fibre sways, and its polarisation with it: the light swings and calms.

    In one experiment for certain, in others perhaps; a swing or less in a second.
    """
    certain = int(rng.integers(len(rig.case.steps)))
    at = own.uniform(0.05, 0.85) * rig.step.duration
    frequency, lasts = log_uniform(own, 0.15, 1.0), log_uniform(own, 2.0, 12.0)
    if rig.number != certain and own.random() < 0.6:
        return

    def sway(t: FloatArray) -> FloatArray:
        since = np.maximum(t - at, 0.0)
        return s * np.exp(-since / lasts) * np.sin(2.0 * pi * frequency * since)

    rig.scale(sway)
    rig.marks.append(at)
