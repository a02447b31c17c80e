"""A stagnant pocket exchanges with the manifold.

A blind fitting of volume ``share V`` trades gas with the manifold with an exchange time T:
``V x2' = Q (x1 - x2) + (share V/T)(p - x2)``, ``p' = (x2 - p)/T``.  T is fixed where diffusion
exchanges the gas, and inversely proportional to the flow where the stream does.
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength
from bayes_sensor.diagnosis.effects.setting import Setting


def _strengths(s: Setting) -> tuple[Strength, ...]:
    return (
        Strength("pocket_share", "1", "log_normal", 0.05, 1.0, limits=(1e-6, 3.0)),
        Strength("pocket_time", "s", "log_normal", 2.5 * s.time_scale, 0.8),
    )


_STARTS = (
    {"pocket_share": 0.04, "pocket_time*": 1.2},
    {"pocket_share": 0.04, "pocket_time*": 4.0},
    {"pocket_share": 0.04, "pocket_time*": 12.0},
)

EFFECT = Effect(
    name="dead_volume",
    family="slow exchange",
    stage="manifold",
    sentence="A stagnant pocket trades gas with the manifold: {strength}.",
    forms=(
        Form(_strengths, lambda v, s: dict(v), name="exchange by diffusion", starts=_STARTS),
        Form(
            _strengths,
            lambda v, s: {
                "pocket_share": v["pocket_share"],
                "pocket_time": v["pocket_time"] * s.reference_flow / s.experiment.total_flow,
            },
            name="exchange by the stream",
            starts=_STARTS,
        ),
    ),
    plausible={"pocket_share": 0.05, "pocket_time": 2.0},
    null={"pocket_share": 0.0},
    reference="mobile-immobile exchange (Coats and Smith 1964)",
    reveal="a second total flow, or the blind fittings filled",
    reveal_with_flows="the blind fittings filled",
)
