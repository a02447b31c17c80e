"""The valve shuts more slowly, or faster, than it opens.

A solenoid opens against a spring with its coil and shuts by the spring alone, so that the two
time constants differ: ``tau_v`` opening, ``closing_ratio tau_v`` shutting.  A spring pushes the
less, the further it has relaxed, so that the latter may change on the way: with x1 the opening over
that at the step down, ``closing_ratio tau_v (1 + closing_bend (x1 - 1/2))``.
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength

RATIO = Strength("closing_ratio", "1", "log_normal", 1.0, 0.25, limits=(0.1, 10.0), scaled=True)
BEND = Strength("closing_bend", "1", "normal", 0.0, 0.3, limits=(-1.5, 1.5))
STARTS = ({"closing_ratio": 1.15}, {"closing_ratio": 0.87})

EFFECT = Effect(
    name="valve_asymmetry",
    family="asymmetry",
    stage="valve",
    exchanged="sorption_asymmetry",
    names_rivals=("valve by direction", "volume by direction"),
    sentence="The valve shuts with another time constant than it opens with: {strength}.",
    forms=(
        Form(lambda s: (RATIO,), lambda v, s: dict(v), weight=0.7, starts=STARTS),
        Form(
            lambda s: (RATIO, BEND), lambda v, s: dict(v), name="spring", weight=0.3, starts=STARTS
        ),
    ),
    plausible={"closing_ratio": 1.1},
    null={"closing_ratio": 1.0, "closing_bend": 0.0},
    reference="spring-return solenoid valves",
    reveal="a second total flow: a valve's ratio does not depend on it",
    reveal_with_flows="a displacement sensor on the valve, or the sensor behind another valve",
)
