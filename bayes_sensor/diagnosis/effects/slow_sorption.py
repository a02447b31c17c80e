"""A second, slow sorption mode: part of the sensor's response follows late.

Two kinds of sites, or a slow second layer; seen from outside it is one response with the slow
part of a valve (``two_rate_valve``), and no step experiment separates the two.  Sites that differ
have a spread of time constants.
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength, spread_of_times
from bayes_sensor.diagnosis.effects.setting import Setting


def _strengths(s: Setting) -> tuple[Strength, ...]:
    return (
        Strength("slow_site_share", "1", "log_normal", 0.04, 1.0, limits=(1e-6, 0.9)),
        Strength("slow_site_time", "s", "log_normal", 7.0 * s.time_scale, 1.0),
    )


def _spread(s: Setting) -> tuple[Strength, ...]:
    return (*_strengths(s), spread_of_times("slow_site_spread"))


_STARTS = (
    {"slow_site_share": 0.03, "slow_site_time*": 4.0},
    {"slow_site_share": 0.03, "slow_site_time*": 15.0},
)

EFFECT = Effect(
    name="slow_sorption",
    family="slow exchange",
    stage="sensor",
    sentence="Part of the sensor's response follows slowly: {strength}.",
    forms=(
        Form(_strengths, lambda v, s: dict(v), starts=_STARTS),
        Form(_spread, lambda v, s: dict(v), name="spread", weight=0.5, starts=_STARTS),
    ),
    plausible={"slow_site_share": 0.03, "slow_site_time": 10.0},
    null={"slow_site_share": 0.0},
    same_response="two_rate_valve",
    reference="two-site sorption",
    reveal="the sensor exposed behind another valve, or the valve with another sensor",
)
