"""The baseline drifts: a straight line in time is added to the signal.

Laser power, temperature or fibre coupling; the same slope in every record where the rig warms up
alike, a slope of its own in each where it wanders; or a change that dies away exponentially, as of
an instrument that was switched on before the record began.
"""

from collections.abc import Mapping

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength
from bayes_sensor.diagnosis.effects.setting import Setting

ALIKE = 0.5
"""correlation between the records: a room warms up once a day"""


def _drift(s: Setting, own: bool) -> tuple[Strength, ...]:
    return (
        Strength("drift", "V/s", "normal", 0.0, 0.01 * s.signal_scale / s.duration,
                 per_experiment=own, scaled=True, alike=ALIKE),
    )  # fmt: skip


def _bent(s: Setting) -> tuple[Strength, ...]:
    curve = Strength("drift_curve", "V/s^2", "normal", 0.0,
                     0.01 * s.signal_scale / s.duration**2, per_experiment=True,
                     scaled=True, alike=ALIKE)  # fmt: skip
    return (*_drift(s, True), curve)


def _twisted(s: Setting) -> tuple[Strength, ...]:
    twist = Strength("drift_twist", "V/s^3", "normal", 0.0,
                     0.02 * s.signal_scale / s.duration**3, per_experiment=True,
                     scaled=True, alike=ALIKE)  # fmt: skip
    return (*_bent(s), twist)


def _warming(s: Setting) -> tuple[Strength, ...]:
    return (
        Strength("warm_up", "V", "normal", 0.0, 0.03 * s.signal_scale, per_experiment=True,
                 scaled=True, alike=0.8),
        Strength("warm_up_time", "s", "log_normal", s.duration, 0.7),
    )  # fmt: skip


def _warm(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
    begin = float(s.experiment.t[0])
    return {"step": v["warm_up"], "step_width": v["warm_up_time"], "step_time": begin}


EFFECT = Effect(
    name="baseline_drift",
    family="baseline",
    stage="readout",
    sentence="The baseline drifts during the records: {strength}.",
    forms=(
        Form(lambda s: _drift(s, False), lambda v, s: {"drift": v["drift"]}, name="common"),
        Form(lambda s: _drift(s, True), lambda v, s: {"drift": v["drift"]}, name="own"),
        Form(_bent, lambda v, s: dict(v), name="bent"),
        Form(_twisted, lambda v, s: dict(v), name="twisted"),
        Form(_warming, _warm, name="warm-up", weight=0.2),
    ),
    plausible={"drift": 1e-4},
    null={"drift": 0.0, "drift_curve": 0.0, "drift_twist": 0.0, "warm_up": 0.0},
    reference="drift of laser power and temperature",
    reveal="a record of the carrier gas alone, as long as an experiment",
)
