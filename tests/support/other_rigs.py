"""Small campaigns of other rigs than the published one, with their truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayes_sensor.campaign import Campaign, Commands, Experiment, FloatArray
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.ties import tie_parameters

LENGTH, INTERVAL = 120.0, 0.2
T = np.arange(0.0, LENGTH, INTERVAL)


@dataclass(frozen=True)
class Case:
    """A design, the lags and volumes by flat name, and what is known of the noise."""

    design: Campaign
    shared: dict[str, float]
    """with those that are tied, whose values are given here apart from any tie"""
    phi: float = 0.5
    sigma0: float = 0.01
    sigma1: float = 0.01

    @property
    def theta(self) -> FloatArray:
        """(n_theta,) the truth."""
        layout = Problem(self.design).layout
        values = {"y0_V": 0.3, "beta_V": 1.5, "t0_s": 20.33, "tf_s": 70.21, "phi": self.phi,
                  "sigma0_V": self.sigma0, "sigma1_V": self.sigma1}  # fmt: skip
        theta = np.array(
            [self.shared.get(name, values.get(name.split("[")[0], 0.3)) for name in layout.names]
        )
        for e, switching, k in zip(self.design, layout.switching, range(99), strict=False):
            if e.commands is not None and switching.moves and not any(switching.offsets):
                theta[layout.switches(k)] = e.commands.times + 0.33
        return theta

    def simulated(self, seed: int = 1) -> Campaign:
        """Data drawn at the truth."""
        return simulate(self.design, self.theta, seed=seed)


def experiment(
    name: str,
    flow: float | None = None,
    off: float | None = 70.0,
    commands: Commands | None = None,
    record: str = "",
    sensor: str = "",
) -> Experiment:
    """A planned experiment."""
    carrier, test_gas = (None, None) if flow is None else (0.9 * flow, 0.1 * flow)
    on = 20.0 if commands is None else None
    return Experiment(
        name, T, None, carrier, test_gas, INTERVAL, on, off if on else None, commands=commands,
        record=record, sensor=sensor,
    )  # fmt: skip


def _sensor() -> Case:
    pair = experiment("1", off=None), experiment("2")
    return Case(Campaign("a sensor alone", pair, stages=("sensor",)), {"tau_s": 8.0})


def _filter() -> Case:
    pair = experiment("1"), experiment("2")
    rig = Campaign("filter, sensor", pair, sensor_is="slower", stages=("filter", "sensor"))
    return Case(rig, {"tau_s": 6.0, "tau_filter_s": 1.5})


def _cell() -> Case:
    pair = experiment("1", 50.0), experiment("2", 100.0)
    rig = Campaign("cell, sensor", pair, stages=("cell", "sensor"))
    return Case(rig, {"tau_s": 5.0, "V_cell_mL": 150.0})


def _four_lags() -> Case:
    both = experiment("1", 50.0), experiment("2", 100.0), experiment("3", 200.0)
    rig = Campaign(
        "four stages",
        both,
        sensor_is="slower",
        stages=("valve", "manifold", "probe: lag", "sensor"),
    )
    return Case(rig, {"tau_s": 6.0, "tau_v_s": 0.7, "tau_probe_s": 2.0, "V_mL": 150.0})


def _stairs() -> Case:
    steps = Commands(np.array([15.0, 40.0, 65.0, 90.0]), np.array([0.25, 0.6, 1.0, 0.0]))
    one = (experiment("1", commands=steps),)
    return Case(Campaign("a staircase", one, stages=("sensor",)), {"tau_s": 5.0})


def _train() -> Case:
    times = np.sort(np.concatenate([np.arange(8.0, 110.0, 12.0), np.arange(13.0, 115.0, 12.0)]))
    pulses = Commands(times, (np.arange(len(times)) % 2 == 0).astype(float), delays="shared")
    one = (experiment("1", commands=pulses),)
    rig = Campaign("a pulse train", one, sensor_is="slower", stages=("filter", "sensor"))
    return Case(rig, {"tau_s": 1.5, "tau_filter_s": 0.4})


def _two_sensors() -> Case:
    pair = tuple(experiment(f"1,{s}", record="1", sensor=s) for s in "AB")
    rig = Campaign("two sensors", pair, stages=("valve", "sensor"))
    return Case(rig, {"tau_s[A]": 2.0, "tau_s[B]": 9.0, "tau_v_s": 0.7})


def _tied_sensors() -> Case:
    pair = tuple(experiment(f"1,{s}", record="1", sensor=s) for s in "AB")
    rig = Campaign("two sensors of one make", pair, sensor_is="slower", stages=("valve", "sensor"))
    rig = tie_parameters(rig, {"tau[B]": "tau[A]"}, "tie")
    return Case(rig, {"tau_s": 5.0, "tau_v_s": 0.7})


def _scaled_sensors() -> Case:
    three = tuple(experiment(f"1,{s}", 80.0, record="1", sensor=s) for s in "ABC")
    rig = Campaign("three sensors", three, stages=("cell", "filter", "sensor"))
    rig = tie_parameters(rig, {"tau[B]": "2.5 * tau[A]", "tau_filter": "tau[C]"}, "tie")
    return Case(
        rig,
        {"tau_s[A]": 3.0, "tau_s[B]": 7.5, "tau_s[C]": 1.2, "tau_filter_s": 1.2, "V_cell_mL": 60.0},
    )


def _equal_stages() -> Case:
    both = experiment("1", 50.0), experiment("2", 100.0), experiment("3", 200.0)
    rig = Campaign(
        "two filters and two cells alike", both, sensor_is="slower",
        stages=("filter", "cell", "line", "probe: lag", "sensor"),
    )  # fmt: skip
    rig = tie_parameters(rig, {"tau_probe": "tau_filter", "V_line": "V_cell"}, "tie")
    return Case(
        rig,
        {"tau_s": 6.0, "tau_filter_s": 0.9, "tau_probe_s": 0.9, "V_cell_mL": 80.0,
         "V_line_mL": 80.0},
    )  # fmt: skip


def _recorded() -> Case:
    at = np.arange(0.0, LENGTH, 0.5)
    levels = np.interp(at, [0.0, 20.0, 24.0, 60.0, 70.0, LENGTH], [0.0, 0.0, 1.0, 1.0, 0.2, 0.2])
    one = (experiment("1", commands=Commands(at, levels, recorded=True)),)
    return Case(Campaign("a recorded input", one, stages=("sensor",)), {"tau_s": 5.0})


CASES: dict[str, Callable[[], Case]] = {
    "sensor": _sensor,
    "filter and sensor": _filter,
    "cell and sensor": _cell,
    "four stages": _four_lags,
    "staircase": _stairs,
    "pulse train": _train,
    "two sensors": _two_sensors,
    "recorded input": _recorded,
    "sensors of one lag": _tied_sensors,
    "sensors of lags in proportion": _scaled_sensors,
    "equal stages": _equal_stages,
}
