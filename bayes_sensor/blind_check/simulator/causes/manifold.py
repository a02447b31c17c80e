"""The way of the gas from the valve to the sensor: hoses, volumes, walls."""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.random import Generator

from bayes_sensor.blind_check.simulator.case import Case
from bayes_sensor.blind_check.simulator.causes.cause import Causes, log_uniform
from bayes_sensor.blind_check.simulator.numerics import (
    connected_volumes,
    slowly_followed,
    steady_lag,
)
from bayes_sensor.blind_check.simulator.simulated_rig import Rig, Stream
from bayes_sensor.campaign import FloatArray

CAUSES = Causes()


def _typical_flow(case: Case) -> float:
    return float(np.median([step.total_flow for step in case.steps]))


@CAUSES.cause(("dead_volume",), "tail", "share of V", 0.35)
def wall_pockets(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Two pockets of the manifold trade gas with the stream, faster at larger flow.

    V (1 - sum f) x' = flow (u - x) + sum_j e_j (p_j - x),   f_j V p_j' = e_j (x - p_j)
    """
    time = log_uniform(rng, 0.8, 4.0)
    power = rng.choice([0.0, 0.5, 1.0])
    f = np.array([0.7 * s, 0.3 * s])
    main = rig.case.V * (1.0 - f.sum())
    e = f * rig.case.V / (time * np.array([0.8, 2.2]))
    e *= (rig.step.total_flow / _typical_flow(rig.case)) ** power
    through, between = np.zeros((3, 3)), np.zeros((3, 3))
    through[0, 0] = -1.0 / main
    between[0] = np.array([-e.sum(), *e]) / main
    between[1:, 0] = e / (f * rig.case.V)
    between[[1, 2], [1, 2]] = -between[1:, 0]

    def mixed(t: FloatArray, stream: Stream) -> FloatArray:
        fastest = max((stream[1].max() + e.sum()) / main, between[1:, 0].max())
        x = connected_volumes(t, *stream, through, between, 0.2 / fastest)
        return np.asarray(x[:, 0])

    rig.manifold = mixed


@CAUSES.cause(("axial_dispersion",), "mixing", "share", 0.7)
def back_mixing(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The manifold is a row of cells that mix imperfectly: flow forward, less flow back.

    Between cells 1/s times the flow goes forward, 1/s - 1 times backward; s -> 0 is one
    well-stirred volume, s = 1 would be tanks in series.
    """
    n = int(rng.integers(3, 7))
    back = (1.0 - s) / s
    through = np.diag(np.full(n - 1, 1.0 + back), -1) + np.diag(np.full(n - 1, back), 1)
    # what comes into a cell goes out of it; 1 comes into the first one from outside
    through -= np.diag(through.sum(axis=1) + np.eye(n)[0])
    through *= n / rig.case.V

    def mixed(t: FloatArray, stream: Stream) -> FloatArray:
        longest = rig.case.V / (n * stream[1].max() * (1.0 + 2.0 * back))
        x = connected_volumes(t, *stream, through, np.zeros((n, n)), longest)
        return np.asarray(x[:, -1])

    rig.manifold = mixed


@CAUSES.cause(("carry_over",), "start", "share of the step", 0.25, per_experiment=True)
def residue(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Gas from the experiment before still leaves the walls when the next one starts."""
    short, long = log_uniform(rng, 1.5, 6.0), log_uniform(rng, 8.0, 30.0)
    if rig.number == 0:
        return
    ratio = rig.case.steps[rig.number - 1].concentration / rig.step.concentration
    size = s * ratio * own.uniform(0.6, 1.4)
    clean = rig.manifold

    def gas(t: FloatArray, stream: Stream) -> FloatArray:
        since = np.maximum(t - max(float(t[0]), 0.0), 0.0)
        left = 0.6 * np.exp(-since / short) + 0.4 * np.exp(-since / long)
        return clean(t, stream) + size * left

    rig.manifold = gas


@CAUSES.cause((), "tail", "share", 0.3)
def late_bypass(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Part of the gas takes a detour and comes late."""
    volume = rng.uniform(0.5, 4.0) * rig.case.V
    fixed_time = rng.random() < 0.5  # or a detour of fixed volume
    late = volume / (_typical_flow(rig.case) if fixed_time else rig.step.total_flow)
    direct = rig.manifold

    def gas(t: FloatArray, stream: Stream) -> FloatArray:
        x = direct(t, stream)
        return (1.0 - s) * x + s * np.interp(t - late, t, x, left=0.0)

    rig.manifold = gas
    rig.marks += [rig.step.t0 + late, rig.step.tf + late]


@CAUSES.cause((), "tail", "share of V", 0.3, near=("dead_volume",))
def dead_leg(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The shut valve leaves a blind branch full of test gas, which diffuses out of it."""
    time = log_uniform(rng, 1.0, 10.0)
    volume = s * rig.case.V
    tf = rig.step.tf

    def out(t: FloatArray) -> FloatArray:
        since = np.maximum(t - tf, 0.0) / time
        # what a branch with one open end gives off, mode by mode, the valve not shut at once
        flux = sum(2.0 * np.exp(-((k + 0.5) ** 2) * pi**2 * (since + 0.01)) for k in range(12))
        return np.where(t > tf, volume / time * flux, 0.0)

    rig.let_in(out)


@CAUSES.cause((), "spike", "share of V", 0.1)
def trapped_plug(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Test gas trapped in the hose is pushed out ahead of the gas that pushes it."""
    volume, sits, reach = s * rig.case.V, rng.uniform(0.1, 0.6), rng.uniform(0.2, 1.0)
    # the hose empties from the command on; what it held sits between its end and the valve
    on, t0 = rig.step.commanded_on, rig.step.t0
    begin = on + sits * (t0 - on)
    end = begin + reach * (t0 - begin)

    def plug(t: FloatArray) -> FloatArray:
        done = np.clip((t - begin) / (end - begin), 0.0, 1.0)  # blurred on its way
        return 2.0 * volume / (end - begin) * np.sin(pi * done) ** 2

    rig.let_in(plug)
    rig.marks += [begin, end]


# ------------------------------------------------------------------- kept for the final run


@CAUSES.cause((), "tail", "share", 0.4, near=("dead_volume",), reserve=True)
def silicone_hose(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The hose is of silicone: gas soaks into its wall by diffusion, and comes back as slowly.

    Between the times that it takes to the wall's first layers and through all of it, what is
    missing falls as the root of time: lags an octave apart, each with a weight as T^-1/2.
    """
    shortest = log_uniform(rng, 0.3, 1.0)
    times = shortest * 2.0 ** np.arange(int(rng.integers(5, 8)))
    weights = times**-0.5 / np.sum(times**-0.5)
    clean = rig.manifold

    def gas(t: FloatArray, stream: Stream) -> FloatArray:
        x = clean(t, stream)
        soaked = sum(
            (w * steady_lag(t, x, float(T)) for w, T in zip(weights, times, strict=True)),
            np.zeros(len(t)),
        )
        return (1.0 - s) * x + s * soaked

    rig.manifold = gas


@CAUSES.cause((), "tail", "share", 0.4, reserve=True)
def heavy_gas_pool(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Test gas, heavier than the carrier, lies as a pool over part of the ring.

    Its surface rises and sinks at an even rate, in proportion to the flow, until it meets what
    streams above: it fills and empties in a straight line.
    """
    volume = rng.uniform(3.0, 15.0) * rig.case.V
    above = rig.manifold

    def gas(t: FloatArray, stream: Stream) -> FloatArray:
        x = above(t, stream)
        return (1.0 - s) * x + s * np.asarray(slowly_followed(t, x, stream[1] / volume))

    rig.manifold = gas
