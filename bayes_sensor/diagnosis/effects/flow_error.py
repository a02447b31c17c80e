"""Each experiment's total flow is off by a factor of its own.

Controllers are set by hand and calibrated for another gas; an error common to all experiments
cannot be told from V and stays invisible.
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength

EFFECT = Effect(
    name="flow_error",
    family="flow",
    stage="flow",
    sentence="The flows are not what was set, in each experiment by its own factor: {strength}.",
    forms=(
        Form(
            lambda s: (
                Strength("flow_factor", "1", "log_normal", 1.0, 0.05, per_experiment=True,
                         limits=(0.2, 5.0), scaled=True),
            ),
            lambda v, s: {"flow_factor": v["flow_factor"]},
            starts=({"flow_factor": 1.0},),
        ),
    ),
    plausible={"flow_factor": 1.05},
    null={"flow_factor": 1.0},
    reference="accuracy of thermal mass-flow controllers",
    reveal="flows read from a calibrated meter",
)  # fmt: skip
