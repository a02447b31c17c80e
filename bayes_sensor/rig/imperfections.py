"""What may be wrong with a rig: the settings of its kernels.

A kernel takes one vector: the rig's own parameters, then the settings, of which each is one
imperfection.  With the neutral settings the rig is the ideal one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from bayes_sensor.campaign import FloatArray

GAS, SENSOR, READOUT = "gas", "sensor", "readout"
"""stages: what one of them changes leaves those before it as they are"""

# the first entries of the kernel's parameter vector, before the settings
TAU, TAU_V, TAU_M, Y0, BETA, T0, TF, CONCENTRATION, START, MIDDLE = range(10)
FIRST = 10
_stages = [SENSOR, GAS, GAS, READOUT, READOUT, GAS, GAS, GAS, SENSOR, READOUT]


class RigSetting(NamedTuple):
    """One imperfection that the rig may have."""

    neutral: float
    """the value at which it has none"""
    stage: str
    meaning: str
    """with its unit"""


SETTINGS: dict[str, RigSetting] = {}
"""by name, in the order of the kernel's parameter vector"""


def _setting(name: str, neutral: float, stage: str, meaning: str) -> int:
    """The place in the kernel's parameter vector of a setting that is new in the table."""
    SETTINGS[name] = RigSetting(neutral, stage, meaning)
    _stages.append(stage)
    return len(_stages) - 1


# A setting with new physics is one line here and what the kernel does with it.
CLOSING = _setting(
    "closing_ratio", 1.0, GAS, "valve time constant when shutting over that when opening"
)
CLOSING_BEND = _setting(
    "closing_bend", 0.0, GAS, "how much that constant falls from the first of the way to the last"
)
INERTIA = _setting("inertia", 0.0, GAS, "kappa in kappa tau_v^2 x'' + tau_v x' + x = u")
STROKE = _setting("stroke", 0.0, GAS, "s, time in which the valve's command goes from shut to open")
BEND = _setting("stroke_bend", 0.0, GAS, "0: evenly .. 1: accelerating evenly, from rest")
SLOW_V = _setting("slow_valve_share", 0.0, GAS, "share of the valve's opening that follows slowly")
SLOW_V_TIME = _setting("slow_valve_time", 1.0, GAS, "s, time constant of that share")
SETTLING = _setting(
    "settling_share", 0.0, GAS, "inlet concentration is low by this share right after opening"
)
SETTLING_TIME = _setting("settling_time", 1.0, GAS, "s, in which that deficit decays")
SETTLING_SWING = _setting("settling_swing", 0.0, GAS, "rad/s, with which it swings while it decays")
SWITCHING = _setting(
    "flow_switching", 0.0, GAS, "share of the test-gas flow that stops when the valve shuts"
)
PREMIXED = _setting(
    "premixed", 0.0, GAS, "1: what then enters keeps the concentration that the valve gives it"
)
FLOW = _setting("flow_factor", 1.0, GAS, "true total flow over the set one")
POCKET = _setting("pocket_share", 0.0, GAS, "volume of a stagnant pocket over V")
POCKET_TIME = _setting("pocket_time", 1.0, GAS, "s, exchange time of the pocket")
TANK = _setting("tank_share", 0.0, GAS, "share of V that forms a second tank in series")
RELEASE = _setting(
    "release_ratio", 1.0, SENSOR, "sensor time constant of release over that of uptake"
)
RELEASE_WIDTH = _setting(
    "release_width", 0.0, SENSOR, "distance from equilibrium, of the step, over which that changes"
)
SLOW_S = _setting(
    "slow_site_share", 0.0, SENSOR, "share of the sensor's response that follows slowly"
)
SLOW_S_TIME = _setting("slow_site_time", 1.0, SENSOR, "s, time constant of that share")
SLOW_S_SPREAD = _setting(
    "slow_site_spread",
    1.0,
    SENSOR,
    "half of that share is this much slower or faster, in equal parts",
)
COATING = _setting(
    "coating", 0.0, SENSOR, "0 single lag .. 1 diffusion through the layered coating"
)
FILTER = _setting("filter", 0.0, SENSOR, "s, time constant of a low-pass before the converter")
FILTER_SECOND = _setting(
    "filter_second", 0.0, SENSOR, "s, time constant of that low-pass' second pole; 0: it has one"
)
FILTER_BUTTERWORTH = _setting(
    "filter_butterworth", 0.0, SENSOR, "s, 1/omega of a Butterworth low-pass of two poles there"
)
CURVATURE = _setting(
    "curvature", 0.0, READOUT, "1/V, k in v + k v (v - beta) + m v (v^2 - beta^2), v = beta x3"
)
CUBIC = _setting("cubic", 0.0, READOUT, "1/V^2, m in the same")
DRIFT = _setting("drift", 0.0, READOUT, "V/s, slope of the baseline")
DRIFT_CURVE = _setting("drift_curve", 0.0, READOUT, "V/s^2, bend of the baseline")
DRIFT_TWIST = _setting("drift_twist", 0.0, READOUT, "V/s^3, change of that bend")
STEP = _setting("step", 0.0, READOUT, "V, step of the baseline")
STEP_TIME = _setting("step_time", 0.0, READOUT, "s, when it begins")
STEP_WITH_FALL = _setting("step_with_fall", 0.0, READOUT, "1: that time counts from the step down")
STEP_WIDTH = _setting("step_width", 0.0, READOUT, "s, time constant with which it settles")
GAIN = _setting("gain_drift", 0.0, READOUT, "1/s, relative change of beta with time after t0")
GAIN_CURVE = _setting("gain_curve", 0.0, READOUT, "1/s^2, bend of that change")
GAIN_TWIST = _setting("gain_twist", 0.0, READOUT, "1/s^3, change of that bend")
GAIN_OF_ALL = _setting(
    "gain_of_all", 0.0, READOUT, "1: what changes is the whole voltage, y0 included"
)
CARRY = _setting(
    "carry_over", 0.0, SENSOR, "share of beta still in the manifold when the record starts"
)
CARRY_TIME = _setting("carry_time", 0.0, SENSOR, "s, in which it leaves; 0: the manifold's own V/Q")
CARRY_SPREAD = _setting(
    "carry_spread", 1.0, SENSOR, "half of it leaves this much slower or faster, in equal parts"
)
VALVE_FACTOR = _setting("valve_factor", 1.0, GAS, "valve time constant over the common one")
SENSOR_FACTOR = _setting("sensor_factor", 1.0, SENSOR, "sensor time constant over the common one")
EMPTYING = _setting(
    "emptying_ratio", 1.0, GAS, "manifold time constant after the step down over that before"
)
LATE = _setting(
    "late_share", 0.0, GAS, "share of the gas that comes later, and goes later, than the rest"
)
LATE_RISE = _setting("late_rise", 0.0, GAS, "s, by which it comes later")
LATE_FALL = _setting("late_fall", 0.0, GAS, "s, by which it goes later")

INDEX = {name: i for i, name in enumerate(SETTINGS)}
NEUTRAL = np.array([setting.neutral for setting in SETTINGS.values()])
READOUT_SETTINGS = frozenset(
    i for i, setting in enumerate(SETTINGS.values()) if setting.stage == READOUT
)
"""places among the settings of those that leave the response as it is"""
OF_THE_GAS = np.flatnonzero(np.array(_stages) == GAS)
BEFORE_THE_READOUT = np.flatnonzero(np.array(_stages) != READOUT)
"""places in the parameter vector of what changes the gas, and of what changes the response"""


def settings_vector(settings: Mapping[str, float]) -> FloatArray:
    """(n_settings,) the neutral settings with those given replaced.  Raises KeyError."""
    vector = NEUTRAL.copy()
    for name, value in settings.items():
        vector[INDEX[name]] = value
    return vector
