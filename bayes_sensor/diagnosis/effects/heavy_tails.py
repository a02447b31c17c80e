"""The noise has heavier tails than a Gaussian: Student-t innovations, or rare large ones.

Tested on the innovations of the noise at full rate
(:mod:`bayes_sensor.diagnosis.signals.tails_and_converter`).
"""

from bayes_sensor.diagnosis.effects.effect import Effect

EFFECT = Effect(
    name="heavy_tails",
    family="noise law",
    stage="record",
    sentence="The noise has heavier tails than a Gaussian: {strength}.",
    forms=(),
    plausible={"tail_dof": 4.0},
    null={"tail_dof": float("inf")},
    reference="Lange, Little and Taylor, J. Am. Stat. Assoc. 84, 1989",
    reveal="a record without gas, long enough to see the tails",
    on_mean=False,
)
