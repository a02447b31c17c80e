"""The total flow falls to the carrier's alone as the valve shuts.

Where the valve sits in the test gas's line, shutting it takes that flow away: the manifold fills
at Q = Q_N2 + Q_CO2 and empties at Q_N2.  With the valve's state x1 the flow is
Q_N2 + Q_CO2 x1 and what enters is Q_CO2 x1, so that ``V x2' = Q x1 - (Q_N2 + Q_CO2 x1) x2``.  Where
the gases are mixed before the valve, what enters has its concentration at any flow:
``V x2' = (Q_N2 + Q_CO2 x1) (x1 - x2)``.  At full strength there is no free parameter; a fraction
between 0 (a by-pass keeps the flow) and 1 nests it.  Source: the paper's drawing of the rig
(solenoid upstream of the controller).
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength

SHARE = Strength("flow_switching", "1", "normal", 0.6, 0.4, limits=(0.0, 1.3))

EFFECT = Effect(
    name="flow_switching",
    family="asymmetry",
    names_rivals=("volume by direction",),
    stage="flow",
    sentence=(
        "The fall is slower than the rise by the ratio the carrier flow predicts: the total flow "
        "drops when the test gas's valve shuts."
    ),
    forms=(
        Form(lambda s: (), lambda v, s: {"flow_switching": 1.0}, name="full", weight=0.4),
        Form(
            lambda s: (SHARE,),
            lambda v, s: dict(v),
            name="partial",
            weight=0.25,
            starts=({"flow_switching": 0.6},),
        ),
        Form(
            lambda s: (),
            lambda v, s: {"flow_switching": 1.0, "premixed": 1.0},
            name="full, mixed before",
            weight=0.2,
        ),
        Form(
            lambda s: (SHARE,),
            lambda v, s: {**v, "premixed": 1.0},
            name="partial, mixed before",
            weight=0.15,
            starts=({"flow_switching": 0.6},),
        ),
    ),
    plausible={"flow_switching": 1.0},
    null={"flow_switching": 0.0},
    reference="conservation of volume in the manifold; the paper, Fig. 4",
    reveal="a flow meter behind the manifold while the valve shuts",
)
