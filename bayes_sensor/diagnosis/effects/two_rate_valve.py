"""Part of the valve's opening follows slowly.

A seat that swells or a membrane that creeps lets most of the gas through at once and the rest
with a second, longer time constant; the same shares shut.  Seen from outside it is one response
with a slow part of the sensor (``slow_sorption``): the two have the same priors, so that data
which cannot separate them leave both.
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength

EFFECT = Effect(
    name="two_rate_valve",
    family="slow exchange",
    stage="valve",
    sentence="Part of the valve's opening follows slowly: {strength}.",
    forms=(
        Form(
            lambda s: (
                Strength("slow_valve_share", "1", "log_normal", 0.04, 1.0, limits=(1e-6, 0.9)),
                Strength("slow_valve_time", "s", "log_normal", 7.0 * s.time_scale, 1.0),
            ),
            lambda v, s: dict(v),
            starts=(
                {"slow_valve_share": 0.03, "slow_valve_time*": 4.0},
                {"slow_valve_share": 0.03, "slow_valve_time*": 15.0},
            ),
        ),
    ),
    plausible={"slow_valve_share": 0.05, "slow_valve_time": 5.0},
    null={"slow_valve_share": 0.0},
    same_response="slow_sorption",
    reference="creep of elastomer seats",
    reveal="a flow meter behind the valve, or the sensor exposed without the valve",
)
