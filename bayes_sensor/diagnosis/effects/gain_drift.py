"""The sensitivity drifts: beta changes in time, ``beta (1 + g (t - t0))``, straight or bent.

beta is the sensitivity when the gas begins to flow.

Where the light fades, the whole voltage does, the baseline ``y0`` included.  A concentration that
drifts while the gas is on does to a linear sensor what a drift of beta does.
"""

from collections.abc import Mapping

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength
from bayes_sensor.diagnosis.effects.setting import Setting

ALIKE = 0.5
"""correlation between the records: lamps and films age one way"""


def _gain(s: Setting, own: bool) -> tuple[Strength, ...]:
    return (
        Strength("gain_drift", "1/s", "normal", 0.0, 0.02 / s.duration, per_experiment=own,
                 scaled=True, alike=ALIKE),
    )  # fmt: skip


def _bent(s: Setting) -> tuple[Strength, ...]:
    curve = Strength("gain_curve", "1/s^2", "normal", 0.0, 0.02 / s.duration**2,
                     per_experiment=True, scaled=True, alike=ALIKE)  # fmt: skip
    return (*_gain(s, True), curve)


def _twisted(s: Setting) -> tuple[Strength, ...]:
    twist = Strength("gain_twist", "1/s^3", "normal", 0.0, 0.04 / s.duration**3,
                     per_experiment=True, scaled=True, alike=ALIKE)  # fmt: skip
    return (*_bent(s), twist)


def _of_beta(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
    return dict(v)


def _of_the_light(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
    return {**v, "gain_of_all": 1.0}


EFFECT = Effect(
    name="gain_drift",
    family="gain",
    stage="readout",
    sentence="The sensitivity drifts during the records, or what is supplied does, which looks the "
    "same: {strength}.",
    forms=tuple(
        Form(strengths, settings, name=of + name)
        for of, settings in (("", _of_beta), ("light, ", _of_the_light))
        for name, strengths in (
            ("common", lambda s: _gain(s, False)),
            ("own", lambda s: _gain(s, True)),
            ("bent", _bent),
            ("twisted", _twisted),
        )
    ),
    plausible={"gain_drift": 1e-4},
    null={"gain_drift": 0.0, "gain_curve": 0.0, "gain_twist": 0.0},
    reference="temperature dependence of sorption; laser power",
    reveal="a longer plateau, the same step early and late in a record, and another instrument in "
    "the same gas",
)
