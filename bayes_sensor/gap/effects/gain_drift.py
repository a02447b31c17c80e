"""The sensitivity drifts: beta changes linearly in time, ``beta (1 + g (t - middle))``."""

from bayes_sensor.gap.effect import Effect, Form, Setting, Strength


def _gain(s: Setting, own: bool) -> tuple[Strength, ...]:
    return (
        Strength("gain_drift", "1/s", "normal", 0.0, 0.02 / s.duration, per_experiment=own,
                 scaled=True),
    )  # fmt: skip


EFFECT = Effect(
    name="gain_drift",
    family="gain",
    sentence="The sensitivity drifts during the records: {strength}.",
    forms=(
        Form(
            lambda s: _gain(s, False), lambda v, s: {"gain_drift": v["gain_drift"]}, name="common"
        ),
        Form(lambda s: _gain(s, True), lambda v, s: {"gain_drift": v["gain_drift"]}, name="own"),
    ),
    plausible={"gain_drift": 1e-4},
    null={"gain_drift": 0.0},
    reference="temperature dependence of sorption; laser power",
    reveal="a longer plateau, and the same step early and late in a record",
)
