"""The baseline jumps: after the pulse, or at another moment common to all records.

A coupling that shifts when the valve shuts, at once or within seconds, or a light that is
switched on.
"""

from collections.abc import Callable, Mapping

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength
from bayes_sensor.diagnosis.effects.setting import Setting

PLACES = tuple({"step_place": 0.02 + 0.02 * i} for i in range(49))
"""where in the record a common jump is looked for first, as a share of its length"""
DELAYS = tuple({"step_delay*": 0.3 * 1.3**i} for i in range(20))
"""time scales after the fall where one is looked for first"""


def _step(own: bool, soft: bool = False) -> Callable[[Setting], tuple[Strength, ...]]:
    def strengths(s: Setting) -> tuple[Strength, ...]:
        size = Strength("step", "V", "normal", 0.0, 0.01 * s.signal_scale, per_experiment=own,
                        scaled=True, alike=0.8)  # fmt: skip
        width = Strength("step_width", "s", "log_normal", s.time_scale, 0.8)
        return (size, width) if soft else (size,)

    return strengths


def _anywhere(own: bool) -> Callable[[Setting], tuple[Strength, ...]]:
    place = Strength("step_place", "1", "normal", 0.5, 0.3, limits=(0.005, 0.995))
    return lambda s: (*_step(own)(s), _edge(s), place)


def _some_time_after(own: bool) -> Callable[[Setting], tuple[Strength, ...]]:
    def strengths(s: Setting) -> tuple[Strength, ...]:
        delay = Strength("step_delay", "s", "log_normal", 5.0 * s.time_scale, 1.2)
        return (*_step(own)(s), _edge(s), delay)

    return strengths


def _edge(s: Setting) -> Strength:
    return Strength("step_width", "s", "log_normal", 0.1 * s.time_scale, 1.2)


def _at_place(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
    t = s.experiment.t
    at = float(t[0] + v["step_place"] * (t[-1] - t[0]))
    return {"step": v["step"], "step_width": v["step_width"], "step_time": at}


def _after_delay(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
    at = v["step_delay"]
    return {
        "step": v["step"], "step_width": v["step_width"], "step_with_fall": 1.0, "step_time": at,
    }  # fmt: skip


def _after_pulse(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
    return {"step_with_fall": 1.0, **v}


EFFECT = Effect(
    name="baseline_step",
    family="baseline",
    stage="readout",
    sentence="The baseline steps to another level and stays there: {strength}.",
    forms=(
        Form(_step(False), _after_pulse, name="common", weight=0.3, jumps=True),
        Form(_step(True), _after_pulse, name="own", weight=0.3, jumps=True),
        Form(_step(False, soft=True), _after_pulse, name="common, slow", weight=0.1),
        Form(_step(True, soft=True), _after_pulse, name="own, slow", weight=0.1),
        *(
            Form(
                strengths(own),
                settings,
                name=f"own, {name}" if own else name,
                weight=0.05,
                grid=tuple({"step*": 1e-4, **begin} for begin in begins),
            )
            for strengths, settings, name, begins in (
                (_anywhere, _at_place, "at any time", PLACES),
                (_some_time_after, _after_delay, "some time after the fall", DELAYS),
            )
            for own in (False, True)
        ),
    ),
    plausible={"step": 0.01},
    null={"step": 0.0},
    reference="mechanical and optical coupling to the valve",
    reveal="the valve switched with the carrier gas alone",
)
