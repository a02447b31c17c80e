"""A low-pass in front of the converter acts on the signal and on its noise.

On the mean it is one more lag, much faster than the others; on the noise it is what any
autocorrelation may be, so that the noise cannot name it.
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength

EFFECT = Effect(
    name="daq_filter",
    family="fast shape",
    stage="record",
    sentence="A low-pass in the acquisition slows the signal: {strength}.",
    forms=(
        Form(
            lambda s: (
                Strength("filter", "s", "log_normal", 0.02 * s.time_scale, 1.0,
                         limits=(1e-4 * s.time_scale, 2.0 * s.time_scale)),
            ),
            lambda v, s: {"filter": v["filter"]},
            starts=({"filter*": 0.02}, {"filter*": 0.1}),
        ),
    ),
    plausible={"filter": 0.015},
    null={"filter": 0.0},
    reference="photoreceiver and anti-alias filters",
    reveal="the receiver's response to a switched light",
)  # fmt: skip
