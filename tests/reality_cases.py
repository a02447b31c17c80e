"""A small simulated rig and its exact solutions, for the tests of the independent reality."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality import Case, Step, clean_signals, draw_case, sample_times, without_causes
from bayes_sensor.reality.knobs import Course
from bayes_sensor.reality.simulator import prepared_rig


def case(**strengths: float) -> Case:
    """A small rig, the same for every call."""
    return replace(draw_case(11, size="small"), strengths=strengths)


def offsets(rig: Case, atol: float) -> Iterator[tuple[Step, Course]]:
    """Every step with an offset of its own, which is what is added to the signal, to ``atol`` V.

    The other steps' signals must be those without the cause.
    """
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    for step in rig.steps:
        courses = prepared_rig(rig)[step.name].offset
        if courses:
            added = courses[0](sample_times(step))
            assert np.allclose(seen[step.name] - plain[step.name], added, atol=atol)
            yield step, courses[0]
        else:
            assert np.array_equal(seen[step.name], plain[step.name])


def assert_added_between_marks(rig: Case) -> None:
    """A rig's offsets are added to its signal as they are, but for what the grid makes of marks."""
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    added = 0
    for step in rig.steps:
        knobs, t = prepared_rig(rig)[step.name], sample_times(step)
        for course in knobs.offset:
            gap = np.min([np.abs(t - at) for at in [*knobs.marks, np.inf]], axis=0)
            off = seen[step.name] - plain[step.name] - course(t)
            assert np.abs(off[gap > 1e-4]).max() < 1e-4
            added += 1
    assert added >= 1


def on_its_clock(rig: Case) -> Iterator[tuple[Step, FloatArray, FloatArray]]:
    """Every step with the times (n,) s that its record bears and those when it was measured."""
    for step in rig.steps:
        clock = prepared_rig(rig)[step.name].clock
        assert clock is not None
        t = sample_times(step)
        yield step, t, clock(t)


def solved(
    rig: Case,
    right_side,
    n_states: int,
    k: int = 0,
    inputs: Sequence[tuple[float, Any]] = (),
    begin: Sequence[float] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Times and states of an ODE that scipy solves piece by piece between the switches.

    ``inputs``: (s from which it holds, what ``right_side`` is given) of every piece; the valve's
    command if there are none.  ``begin``: the states (n_states,) before it, all 0 if not given.
    """
    step = rig.steps[k]
    t = sample_times(step)
    states = np.zeros((len(t), n_states))
    y = np.zeros(n_states) if begin is None else np.asarray(begin, dtype=float)
    inputs = inputs or [(0.0, 0.0), (step.t0, 1.0), (step.tf, 0.0)]
    edges = [at for at, _ in inputs] + [step.duration]
    for low, high, u in zip(edges[:-1], edges[1:], [u for _, u in inputs], strict=True):
        inside = (t >= low) & (t < high)
        result = solve_ivp(
            lambda s, x, u=u: right_side(u, x), (low, high), y, method="DOP853", rtol=1e-10,
            atol=1e-12, dense_output=True, max_step=0.05,
        )  # fmt: skip
        states[inside] = result.sol(t[inside]).T
        y = result.y[:, -1]
    return t, states
