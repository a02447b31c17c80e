"""From the light to the record: receiver, converter, clock, and what is picked up on the way."""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.random import Generator

from bayes_sensor.blind_check.simulator.case import Case
from bayes_sensor.blind_check.simulator.causes.cause import Causes, log_uniform, random_sign
from bayes_sensor.blind_check.simulator.numerics import steady_lag, two_ranges
from bayes_sensor.blind_check.simulator.simulated_rig import Rig
from bayes_sensor.campaign import FloatArray

CAUSES = Causes()


@CAUSES.cause((), "line", "relative", 0.2, per_experiment=True, fast=True)
def loose_contact(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """A plug is loose: now and then it crackles, and the signal breaks down for split seconds."""
    gaps: list[tuple[float, float]] = []
    for _ in range(int(own.integers(1, 4))):
        at = own.uniform(0.02, 0.9) * rig.step.duration
        for _ in range(int(own.integers(3, 12))):
            lasts = log_uniform(own, 0.03, 0.4)
            gaps.append((at, at + lasts))
            at += lasts + own.exponential(0.4)

    def broken(t: FloatArray) -> FloatArray:
        open_ = np.zeros(len(t), dtype=bool)
        for begin, end in gaps:
            open_ |= (t >= begin) & (t < end)
        return -s * open_

    rig.scale(broken)
    rig.marks += [edge for gap in gaps for edge in gap]


@CAUSES.cause(("mains_pickup",), "line", "share of the step", 0.05, fast=True)
def mains_hum(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The mains and its third harmonic, with a frequency that is never quite 50 or 60 Hz."""
    frequency = rng.choice([50.0, 60.0]) + 0.03 * rng.standard_normal()
    third, size = rng.uniform(0.0, 0.5), s * rig.case.mean_step
    first_phase, third_phase = own.uniform(0.0, 2.0 * pi, 2)

    def hum(t: FloatArray) -> FloatArray:
        angle = 2.0 * pi * frequency * t
        wave = np.sin(angle + first_phase) + third * np.sin(3.0 * angle + third_phase)
        return np.asarray(size * wave)

    rig.add(hum)


@CAUSES.cause(("daq_filter",), "delay", "s", 0.08)
def anti_alias_filter(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """A four-pole filter before the converter."""
    for _ in range(4):
        rig.receive(lambda t, y: steady_lag(t, y, 0.25 * s))


@CAUSES.cause((), "level", "share of the step", 0.15)
def range_change(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The recorder changes its range on the way up, and back lower down; the two do not agree."""
    step, rest = rig.case.mean_step, float(np.mean([each.y0 for each in rig.case.steps]))
    up = rest + rng.uniform(0.35, 0.65) * step
    down = up - rng.uniform(0.1, 0.25) * step
    gap = random_sign(rng) * s * step
    rig.receive(lambda t, y: np.asarray(two_ranges(y, up, down, gap)))


@CAUSES.cause((), "level", "share of the step", 0.3, near=("optical_nonlinearity",))
def clipped_range(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The converter's range ends ``s`` of the mean step below the highest plateau, which is cut."""
    top = max(step.y0 + step.beta for step in rig.case.steps) - s * rig.case.mean_step
    rig.receive(lambda t, y: np.minimum(y, top))


@CAUSES.cause((), "delay", "s", 0.5)
def held_readings(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The instrument renews its output now and then only; between, the recorder sees it stand."""
    begin = s * own.random()

    def held(t: FloatArray, y: FloatArray, true: FloatArray) -> FloatArray:
        last = begin + np.floor((true - begin) / s) * s
        return np.asarray(np.interp(np.maximum(last, t[0]), t, y))

    rig.sample = held


@CAUSES.cause((), "clock", "s", 1.0, per_experiment=True)
def lost_samples(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The recorder loses a block of samples while the signal moves, and does not say so."""
    flow = float(np.mean([step.total_flow for step in rig.case.steps]))
    reach = 1.5 * (rig.case.tau_v + rig.case.V / flow)
    gaps = []
    for switch in (rig.step.t0, rig.step.tf):
        if own.random() < 0.6:
            gaps.append((switch + own.uniform(0.1, 1.0) * reach, s * own.uniform(0.4, 1.0)))

    def clock(t: FloatArray) -> FloatArray:
        true = t.copy()
        for at, lasts in gaps:
            true += lasts * (true >= at)
        return true

    rig.clock = clock
    rig.marks += [edge for at, lasts in gaps for edge in (at, at + lasts)]


# ------------------------------------------------------------------- kept for the final run


@CAUSES.cause((), "drift", "record lengths over its time", 2.0, reserve=True)
def coupling_capacitor(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The input was left on AC: a capacitor passes changes and lets the level leak away.

    The plateau sinks, and what follows the pulse lies below where it began.
    """
    time = max(step.duration for step in rig.case.steps) / s
    rig.receive(lambda t, y: y[0] + (y - steady_lag(t, y, time)))


@CAUSES.cause((), "delay", "s", 1.5, near=("daq_filter",), reserve=True)
def smoothed_export(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The export puts a running mean over the record, centred: it knows what comes."""

    def averaged(t: FloatArray, y: FloatArray, true: FloatArray) -> FloatArray:
        area = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t))])
        low, high = np.maximum(true - 0.5 * s, t[0]), np.minimum(true + 0.5 * s, t[-1])

        def until(at: FloatArray) -> FloatArray:
            # within an interval the signal is a straight line, its integral a parabola
            i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
            part = at - t[i]
            slope = (y[i + 1] - y[i]) / (t[i + 1] - t[i])
            return np.asarray(area[i] + part * (y[i] + 0.5 * slope * part))

        return np.asarray((until(high) - until(low)) / (high - low))

    rig.sample = averaged


# --------------------------------------------------------------------------- the noise alone


@CAUSES.cause(("heavy_tails",), "noise", "times sigma beyond 1", 8.0, noise=True)
def wild_samples(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Some samples of the noise are wild; the mean stays (see :func:`tail_mixture`)."""


@CAUSES.cause(("quantisation",), "noise", "sigma0 a step", 3.0, noise=True)
def coarse_range(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The recorder's range is too wide, its step coarse; see :func:`converter_step`."""


def tail_mixture(case: Case) -> tuple[float, float]:
    """(share of wild innovations, how many times as large they are) of a case."""
    strength = case.strengths.get("wild_samples", 0.0)
    if strength == 0.0:
        return 0.0, 1.0
    share = CAUSES["wild_samples"].generator(case).uniform(0.003, 0.03)
    return float(share), 1.0 + strength


def converter_step(case: Case) -> float:
    """V, the recorder's step."""
    strength = case.strengths.get("coarse_range", 0.0)
    return max(case.lsb, strength * case.noise.sigma0)
