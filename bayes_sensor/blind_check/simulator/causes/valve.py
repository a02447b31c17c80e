"""The valve: how it opens and shuts."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from bayes_sensor.blind_check.simulator.causes.cause import Causes, log_uniform
from bayes_sensor.blind_check.simulator.numerics import (
    heavy_valve,
    steady_lag,
    stick_slip,
    valve,
)
from bayes_sensor.blind_check.simulator.simulated_rig import Rig, Target
from bayes_sensor.campaign import FloatArray

CAUSES = Causes()


@CAUSES.cause(("valve_asymmetry",), "fall", "relative", 0.6)
def closing_spring(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """A spring that weakens as it relaxes shuts the valve more slowly (or faster) than it opens."""
    sign = 1.0 if rng.random() < 0.7 else -1.0
    rig.valve = lambda t, target: np.asarray(valve(t, *target, rig.case.tau_v, sign * s))


@CAUSES.cause(("valve_second_order",), "delay", "tau_v squared", 0.6)
def heavy_plunger(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The plunger and the gas it pushes have mass, and their drag grows with speed."""
    rig.valve = lambda t, target: np.asarray(heavy_valve(t, *target, rig.case.tau_v, s))


@CAUSES.cause(("two_rate_valve",), "tail", "share", 0.25)
def seat_creep(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The last part of the valve's opening creeps, with a spread of times."""
    time = log_uniform(rng, 2.0, 8.0)
    quick = rig.valve

    def opening(t: FloatArray, target: Target) -> FloatArray:
        slow = 0.5 * valve(t, *target, 0.6 * time, 0.0)
        slow += 0.5 * valve(t, *target, 1.6 * time, 0.0)
        return (1.0 - s) * quick(t, target) + s * slow

    rig.valve = opening


@CAUSES.cause(("finite_stroke",), "delay", "s", 0.8)
def plunger_stroke(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The plunger accelerates evenly from stop to stop."""
    step = rig.step

    def stroke(t: FloatArray) -> Target:
        up = np.clip((t - step.t0) / s, 0.0, 1.0) ** 2
        z = up - np.clip((t - step.tf) / s, 0.0, 1.0) ** 2
        return z[:-1], z[1:]

    rig.command = stroke
    rig.marks += [step.t0 + s, step.tf + s]


@CAUSES.cause((), "valve", "share of the stroke", 0.4)
def sticking_valve(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The valve sticks and slips: it moves in jumps."""
    smooth, band = rig.valve, s * log_uniform(own, 0.7, 1.4)
    rig.valve = lambda t, target: np.asarray(stick_slip(smooth(t, target), band))


@CAUSES.cause((), "valve", "s", 0.6)
def bouncing_valve(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The valve springs back once, at either end."""
    after = rng.uniform(0.1, 0.8)
    command, (t0, tf) = rig.command, (rig.step.t0 + after, rig.step.tf + after)

    def bounced(t: FloatArray) -> Target:
        middle = 0.5 * (t[1:] + t[:-1])
        shut = (middle > t0) & (middle < t0 + s)
        open_ = (middle > tf) & (middle < tf + s)
        first, last = (np.where(open_, 1.0, np.where(shut, 0.0, z)) for z in command(t))
        return first, last

    rig.command = bounced
    rig.marks += [t0, tf, t0 + s, tf + s]


@CAUSES.cause((), "tail", "share of the stroke", 0.2, per_experiment=True)
def grain_in_seat(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """A grain of dust lies in the seat: the valve comes to rest on it, ajar, and test gas leaks.

    Sooner or later the stream carries the grain off and the plunger falls the rest of its way; some
    grains stay until after the record.
    """
    certain = int(rng.integers(len(rig.case.steps)))
    size, lies = s * own.uniform(0.5, 1.0), log_uniform(own, 2.0, 20.0)
    if rig.number != certain and own.random() < 0.4:
        return
    tight, tf, gone = rig.valve, rig.step.tf, rig.step.tf + lies

    def ajar(t: FloatArray, target: Target) -> FloatArray:
        x = tight(t, target)
        falling = np.exp(-np.maximum(t - gone, 0.0) / rig.case.tau_v)
        return np.where(t > tf, np.maximum(x, size * falling), x)

    rig.valve = ajar
    # where the falling plunger meets the grain, and where it falls on
    meets = tf - rig.case.tau_v * float(np.log(size))
    rig.marks += [at for at in (meets, gone) if at < rig.step.duration]


# ------------------------------------------------------------------- kept for the final run


@CAUSES.cause((), "plateau", "share of the stroke", 0.4, reserve=True)
def warming_coil(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The coil warms while it holds the valve open; its pull weakens and the plunger sags.

    Between the pulses it cools, as slowly.
    """
    time = log_uniform(rng, 4.0, 30.0)
    cold = rig.valve

    def opening(t: FloatArray, target: Target) -> FloatArray:
        current = np.concatenate([target[0][:1], target[1]])
        return cold(t, target) * (1.0 - s * steady_lag(t, current, time))

    rig.valve = opening


@CAUSES.cause((), "tail", "share of the stroke", 0.4, near=("two_rate_valve",), reserve=True)
def pilot_stage(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """A pilot opens first; the rest of the stroke waits until pressure has built up behind it.

    Both shut together.
    """
    wait = log_uniform(rng, 0.4, 2.5)
    ups, level = [], 0.0
    for switch in rig.step.switches:
        if switch.level > level:
            ups.append((switch.at, switch.level - level))
        level = switch.level
    command = rig.command

    def in_two(t: FloatArray) -> Target:
        middle = 0.5 * (t[1:] + t[:-1])
        late = np.zeros(len(middle))
        for at, height in ups:
            late += s * height * ((middle > at) & (middle < at + wait))
        first, last = command(t)
        return np.maximum(first - late, 0.0), np.maximum(last - late, 0.0)

    rig.command = in_two
    rig.marks += [at + wait for at, _ in ups]
