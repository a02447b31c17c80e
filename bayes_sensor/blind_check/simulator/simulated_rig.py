"""The rig: a row of parts from the valve's command to the recorded voltage.

Each part is a function.  A cause replaces it, or follows it by another one.  With no cause the
parts make the cascade of three first-order lags: valve, manifold, sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayes_sensor.blind_check.simulator.case import Case, Step
from bayes_sensor.blind_check.simulator.numerics import lag, nodes, steady_lag, valve
from bayes_sensor.campaign import FloatArray

Course = Callable[[FloatArray], FloatArray]
"""something that changes with time: (n,) s to (n,)"""
Part = Callable[[FloatArray, FloatArray], FloatArray]
"""nodes (n,) s and what comes in (n,) to what goes out (n,)"""
Target = tuple[FloatArray, FloatArray]
"""(n - 1,) each: where the valve is drawn to, 0 shut and 1 open, at both ends of each interval"""
Stream = tuple[FloatArray, FloatArray]
"""(n,) each: concentration of the test gas over the set one, total flow in mL/s"""


class Rig:
    """One experiment on the rig; every part may be replaced."""

    def __init__(self, case: Case, step: Step, number: int = 0) -> None:
        self.case, self.step, self.number = case, step, number
        self.relative = case.relative_concentration(step)
        """concentration over the campaign's highest"""
        self.tau = case.tau
        self.marks: list[float] = []
        """s, true times besides t0 and tf at which something jumps"""
        self.command: Callable[[FloatArray], Target] = self._command
        self.valve: Callable[[FloatArray, Target], FloatArray] = self._valve
        """opening (n,), 0 to 1"""
        self.carrier: Course = lambda t: np.full(len(t), step.carrier_flow)
        """mL/s"""
        self.test_gas: Course = lambda t: np.full(len(t), step.test_gas_flow)
        """mL/s, at an open valve"""
        self.stream: Callable[[FloatArray, FloatArray], Stream] = self._stream
        """what the opening (n,) lets through"""
        self.manifold: Callable[[FloatArray, Stream], FloatArray] = self._manifold
        """gas (n,) at the sensor over the set concentration"""
        self.sensor: Part = lambda t, gas: steady_lag(t, gas, self.tau)
        """gas to normalised response"""
        self.readout: Part = lambda t, x: step.y0 + step.beta * x
        """normalised response to V"""
        self.receiver: Part = lambda t, y: y
        """V to V"""
        self.clock: Course = lambda t: t
        """true time of what the recorder calls t"""
        self.sample: Callable[[FloatArray, FloatArray, FloatArray], FloatArray] = (
            lambda t, y, true: np.interp(true, t, y)
        )
        """what is read of y (n,) at true times (k,)"""

    def _command(self, t: FloatArray) -> Target:
        switches = self.step.switches
        levels = np.array([0.0, *(switch.level for switch in switches)])
        middle = 0.5 * (t[1:] + t[:-1])
        target = levels[np.searchsorted([switch.at for switch in switches], middle)]
        return target, target

    def _valve(self, t: FloatArray, target: Target) -> FloatArray:
        if not self.case.has_valve:  # it follows at once
            return np.concatenate([target[0][:1], target[1]])
        return np.asarray(valve(t, *target, self.case.tau_v, 0.0))

    def _stream(self, t: FloatArray, opening: FloatArray) -> Stream:
        carrier, full = self.carrier(t), self.test_gas(t)
        inlet = opening * (full / (carrier + full)) / self.step.concentration
        # what does not pass the valve while it is shut is made up for by as much carrier gas
        return inlet, carrier + full * opening + self.step.test_gas_flow * (1.0 - opening)

    def _manifold(self, t: FloatArray, stream: Stream) -> FloatArray:
        inlet, flow = stream
        if not self.case.volume:
            return inlet
        return np.asarray(lag(t, inlet, self.case.V / (0.5 * (flow[1:] + flow[:-1])), 0.0))

    # ------------------------------------------------------------------ what several causes do

    def scale_test_gas(self, factor: Course) -> None:
        """Multiply the flow of the test gas."""
        before = self.test_gas
        self.test_gas = lambda t: before(t) * factor(t)

    def let_in(self, source: Course) -> None:
        """Add test gas (mL/s) to the stream that enters the manifold."""
        before = self.stream

        def stream(t: FloatArray, opening: FloatArray) -> Stream:
            inlet, flow = before(t, opening)
            return inlet + source(t) / flow / self.step.concentration, flow

        self.stream = stream

    def receive(self, change: Part) -> None:
        """Let the voltage pass one more part."""
        before = self.receiver
        self.receiver = lambda t, y: change(t, before(t, y))

    def add(self, course: Course) -> None:
        """Add a voltage to the signal."""
        self.receive(lambda t, y: y + course(t))

    def scale(self, change: Course) -> None:
        """Multiply the signal by 1 + ``change``."""
        self.receive(lambda t, y: y * (1.0 + change(t)))

    # ------------------------------------------------------------------ running it

    def recorded_time(self, true: float) -> float:
        """s, what the recorder calls the true time ``true``."""
        t = np.linspace(0.0, self.step.duration, 20001)
        clock = self.clock(t)
        # of a time that is recorded twice the first
        return true if clock is t else float(np.interp(true, np.maximum.accumulate(clock), t))

    def trace(self, times: FloatArray) -> Trace:
        """What happens in every part, on nodes that hold the true ``times`` (k,) s."""
        step, case = self.step, self.case
        events = [*(switch.at for switch in step.switches), *self.marks]
        t = nodes(times, events, min(case.tau_v, case.V / step.total_flow))
        opening = self.valve(t, self.command(t))
        stream = self.stream(t, opening)
        gas = self.manifold(t, stream)
        x = self.sensor(t, gas)
        return Trace(t, opening, *stream, gas, x, self.receiver(t, self.readout(t, x)))

    def voltage(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signal (k,) V and normalised response (k,) at recorder times (k,) s, without noise."""
        true = self.clock(times)
        trace = self.trace(true)
        return self.sample(trace.t, trace.y, true), np.interp(true, trace.t, trace.x)


@dataclass(frozen=True)
class Trace:
    """One experiment in every part of the rig, (n,) each."""

    t: FloatArray
    """s"""
    opening: FloatArray
    inlet: FloatArray
    """concentration before the manifold, over the set one"""
    flow: FloatArray
    """mL/s"""
    gas: FloatArray
    """concentration at the sensor, over the set one"""
    x: FloatArray
    """normalised response"""
    y: FloatArray
    """V, before the recorder"""
