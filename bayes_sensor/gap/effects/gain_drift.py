"""The sensitivity drifts: beta changes linearly in time, ``beta (1 + g (t - middle))``."""

from bayes_sensor.gap.effect import Effect, Form, Setting, Strength


def _gain(s: Setting, own: bool) -> tuple[Strength, ...]:
    return (
        Strength("gain_drift", "1/s", "normal", 0.0, 0.02 / s.duration, per_experiment=own,
                 scaled=True),
    )  # fmt: skip


def _bent(s: Setting) -> tuple[Strength, ...]:
    curve = Strength("gain_curve", "1/s^2", "normal", 0.0, 0.02 / s.duration**2,
                     per_experiment=True, scaled=True)  # fmt: skip
    return (*_gain(s, True), curve)


def _twisted(s: Setting) -> tuple[Strength, ...]:
    twist = Strength("gain_twist", "1/s^3", "normal", 0.0, 0.04 / s.duration**3,
                     per_experiment=True, scaled=True)  # fmt: skip
    return (*_bent(s), twist)


EFFECT = Effect(
    name="gain_drift",
    family="gain",
    sentence="The sensitivity drifts during the records: {strength}.",
    forms=(
        Form(
            lambda s: _gain(s, False), lambda v, s: {"gain_drift": v["gain_drift"]}, name="common"
        ),
        Form(lambda s: _gain(s, True), lambda v, s: {"gain_drift": v["gain_drift"]}, name="own"),
        Form(_bent, lambda v, s: dict(v), name="bent"),
        Form(_twisted, lambda v, s: dict(v), name="twisted"),
    ),
    plausible={"gain_drift": 1e-4},
    null={"gain_drift": 0.0, "gain_curve": 0.0, "gain_twist": 0.0},
    reference="temperature dependence of sorption; laser power",
    reveal="a longer plateau, and the same step early and late in a record",
)
