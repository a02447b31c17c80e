"""The flows of carrier and test gas, and what they make together at the valve."""

from __future__ import annotations

from itertools import pairwise
from math import pi

import numpy as np
from numpy.random import Generator

from bayes_sensor.blind_check.simulator.causes.cause import Causes, log_uniform, random_sign
from bayes_sensor.blind_check.simulator.simulated_rig import Rig, Stream
from bayes_sensor.campaign import FloatArray

CAUSES = Causes()


@CAUSES.cause(("flow_switching",), "fall", "share of the test gas", 1.0)
def flow_follows_valve(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The test gas stops when its valve shuts, gradually as the valve does; so does its flow."""
    mixing = rng.random() < 0.5  # the concentration follows from the flows while the valve moves
    step = rig.step

    def stream(t: FloatArray, opening: FloatArray) -> Stream:
        carrier, full = rig.carrier(t), rig.test_gas(t)
        test = full * opening
        flow = carrier + test + (1.0 - s) * (step.test_gas_flow * (1.0 - opening))
        share = test / flow if mixing else opening * (full / (carrier + full))
        return share / step.concentration, flow

    rig.stream = stream


@CAUSES.cause(("flow_settling",), "tail", "relative", 0.6)
def controller_settling(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The test gas's controller settles after its line opens; the flow is off meanwhile."""
    time = log_uniform(rng, 0.4, 3.0)
    omega = rng.uniform(0.0, 0.7) / time
    sign = random_sign(rng)

    def settle(t: FloatArray) -> FloatArray:
        since = np.maximum(t - rig.step.t0, 0.0)
        bump = np.exp(-since / time) * np.cos(omega * since)
        return np.where(t >= rig.step.t0, 1.0 + 0.8 * sign * s * bump, 1.0)

    rig.scale_test_gas(settle)


@CAUSES.cause(("flow_error",), "flow", "relative", 0.15, per_experiment=True)
def controller_offsets(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Flows differ from their set points: an offset of the controller and one a setting."""
    low = min(step.total_flow for step in rig.case.steps)
    offset = 0.5 * rng.standard_normal() * low  # the same mL/s everywhere: more at small flows
    size = offset / rig.step.total_flow + own.standard_normal()
    factor = float(np.exp(s * np.clip(size, -2.5, 2.5)))
    set_to = rig.stream

    def stream(t: FloatArray, opening: FloatArray) -> Stream:
        inlet, flow = set_to(t, opening)
        return inlet, flow * factor

    rig.stream = stream


@CAUSES.cause((), "plateau", "share lost", 0.4)
def emptying_bottle(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The bottle's pressure falls while test gas flows; its flow gives way ever faster."""
    begin = rng.uniform(0.0, 0.7)
    order = rng.uniform(1.5, 4.0)
    t0, length = rig.step.t0, rig.step.tf - rig.step.t0

    def left(t: FloatArray) -> FloatArray:
        used = np.clip(((t - t0) / length - begin) / (1.0 - begin), 0.0, 1.0)
        return 1.0 - s * used**order

    rig.scale_test_gas(left)


@CAUSES.cause((), "ripple", "relative", 0.3, fast=True)
def neighbours_pump(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """A pump on the same exhaust modulates the test-gas flow, stroke by stroke."""
    frequency = log_uniform(rng, 0.25, 2.5)
    phase = own.uniform(0.0, 2.0 * pi)

    def strokes(t: FloatArray) -> FloatArray:
        angle = 2.0 * pi * frequency * t + phase
        return 1.0 + s * (np.sin(angle) + 0.4 * np.sin(2.0 * angle + 1.0))

    rig.scale_test_gas(strokes)
    rig.marks += list(np.arange(0.0, rig.step.duration, 0.04 / frequency)[1:])


@CAUSES.cause((), "delay", "s", 4.0, near=("flow_settling",))
def soft_start(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The test gas's controller ramps its set point up evenly when the line opens: a soft start.

    The ramp lasts ``s`` in every experiment, or has one slope and lasts ``s`` at the largest flow.
    The valve shuts as ever, so that the fall knows nothing of it.
    """
    largest, one_slope = max(step.test_gas_flow for step in rig.case.steps), rng.random() < 0.5
    t0 = rig.step.t0
    lasts = s * (rig.step.test_gas_flow / largest if one_slope else 1.0)
    rig.scale_test_gas(lambda t: np.where(t >= t0, np.minimum((t - t0) / lasts, 1.0), 1.0))
    rig.marks.append(t0 + lasts)


# ------------------------------------------------------------------- kept for the final run


@CAUSES.cause((), "plateau", "relative", 0.5, reserve=True)
def hunting_controller(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The test gas's controller hunts: its needle sticks, so that the flow creeps up and falls.

    A saw tooth around the set point, of one period in all experiments and a phase in each.
    """
    period, creeps = log_uniform(rng, 2.5, 14.0), rng.uniform(0.6, 0.95)
    begin = own.random()

    def saw(t: FloatArray) -> FloatArray:
        part = np.mod(t / period + begin, 1.0)
        return 1.0 + s * (2.0 * np.minimum(part / creeps, (1.0 - part) / (1.0 - creeps)) - 1.0)

    rig.scale_test_gas(saw)
    turns = np.arange(-1.0, rig.step.duration / period + 1.0)
    edges = np.concatenate([turns - begin, turns + creeps - begin]) * period
    rig.marks += edges[(edges > 0.0) & (edges < rig.step.duration)].tolist()


@CAUSES.cause((), "spike", "relative", 2.0, near=("flow_settling",), reserve=True)
def pent_up_line(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Test gas that its controller has pressed into the line behind the shut valve rushes out.

    The pressure falls as the line empties through its choked outlet: as 1/(1 + t/T)^2.
    """
    time = log_uniform(rng, 0.3, 3.0)
    ups = [switch.at for switch in rig.step.switches if switch.level > 0.0][:1]
    ups += [b.at for a, b in pairwise(rig.step.switches) if a.level == 0.0 < b.level]

    def surge(t: FloatArray) -> FloatArray:
        factor = np.ones(len(t))
        for at in ups:
            factor = np.where(
                t >= at, 1.0 + s / (1.0 + np.maximum(t - at, 0.0) / time) ** 2, factor
            )
        return factor

    rig.scale_test_gas(surge)
