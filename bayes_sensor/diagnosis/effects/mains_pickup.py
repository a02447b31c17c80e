"""The mains couple into the signal: lines at 50 or 60 Hz and their harmonics.

Averaging over bins hides them; the test is made at full rate
(:mod:`bayes_sensor.diagnosis.signals.tails_and_converter`), with the frequency estimated.
"""

from bayes_sensor.diagnosis.effects.effect import Effect

EFFECT = Effect(
    name="mains_pickup",
    family="interference",
    stage="record",
    sentence="The mains couple into the signal: {strength}.",
    forms=(),
    plausible={"mains_V": 0.01, "mains_Hz": 50.0},
    null={"mains_V": 0.0},
    reference="line spectra; Percival and Walden 1993, ch. 10",
    reveal="a battery-powered receiver, or a record without gas",
    on_mean=False,
)
