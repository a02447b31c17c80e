"""The baseline jumps: after the pulse, or at another moment common to all records.

A coupling that shifts when the valve shuts, at once or within seconds, or a light that is
switched on.
"""

from collections.abc import Callable, Mapping

from bayes_sensor.gap.effect import Effect, Form, Setting, Settings, Strength

PLACES = (0.12, 0.25, 0.4, 0.6, 0.8, 0.9)
"""where else in the record a common jump is looked for, as a share of its length"""


def _step(own: bool, soft: bool = False) -> Callable[[Setting], tuple[Strength, ...]]:
    def strengths(s: Setting) -> tuple[Strength, ...]:
        size = Strength("step", "V", "normal", 0.0, 0.01 * s.signal_scale, per_experiment=own,
                        scaled=True)  # fmt: skip
        width = Strength("step_width", "s", "log_normal", s.time_scale, 0.8)
        return (size, width) if soft else (size,)

    return strengths


def _at(place: float) -> Settings:
    def settings(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
        t = s.experiment.t
        return {"step": v["step"], "step_time": float(t[0] + place * (t[-1] - t[0]))}

    return settings


def _after_pulse(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
    return {"step_with_fall": 1.0, **v}


EFFECT = Effect(
    name="baseline_step",
    family="baseline",
    sentence="The baseline after the pulse is not the one before it: {strength}.",
    forms=(
        Form(_step(False), _after_pulse, name="common", weight=0.3),
        Form(_step(True), _after_pulse, name="own", weight=0.3),
        Form(_step(False, soft=True), _after_pulse, name="common, slow", weight=0.1),
        Form(_step(True, soft=True), _after_pulse, name="own, slow", weight=0.1),
        *(
            Form(_step(False), _at(place), name=f"at {place:.0%}", weight=0.2 / len(PLACES))
            for place in PLACES
        ),
    ),
    plausible={"step": 0.01},
    null={"step": 0.0},
    reference="mechanical and optical coupling to the valve",
    reveal="the valve switched with the carrier gas alone",
)
