"""Test gas is left from before: the record does not start from an empty manifold.

What is left leaves with the manifold's V/Q, or slowly where it comes off the walls.  It cannot be
less than nothing: a record that begins too low has another cause, such as a drift.
"""

from bayes_sensor.gap.effect import Effect, Form, Setting, Strength


def _carry(s: Setting, own: bool, slow: bool) -> tuple[Strength, ...]:
    found: tuple[Strength, ...] = (
        Strength("carry_over", "1", "normal", 0.0, 0.03, per_experiment=own,
                 limits=(0.0, 2.0), scaled=True, alike=0.5),
    )  # fmt: skip
    if slow:
        found += (
            Strength("carry_time", "s", "log_normal", 6.0 * s.time_scale, 1.0,
                     limits=(0.05 * s.time_scale, 60.0 * s.time_scale)),
        )  # fmt: skip
    return found


EFFECT = Effect(
    name="carry_over",
    family="initial state",
    sentence="Gas from before is still leaving when the records begin: {strength}.",
    forms=(
        Form(lambda s: _carry(s, False, False), lambda v, s: dict(v), name="common"),
        Form(lambda s: _carry(s, True, False), lambda v, s: dict(v), name="own"),
        Form(
            lambda s: _carry(s, True, True),
            lambda v, s: dict(v),
            name="slow",
            weight=0.5,
            starts=({"carry_time*": 4.0}, {"carry_time*": 20.0}),
        ),
    ),
    plausible={"carry_over": 0.02},
    null={"carry_over": 0.0},
    reference="flushing of a stirred volume",
    reveal="a longer flush before the record",
)
