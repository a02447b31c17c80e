"""Test gas is left from before: the record does not start from an empty manifold.

What is left leaves with the manifold's V/Q, or slowly where it comes off the walls: then with a
spread of time constants, for walls are of several materials and hold gas at several depths.  It may
be another share in every record; or as large a share of what flowed in the record before, of which
the first has none.  It cannot be less than nothing: a record that begins too low has another cause,
such as a drift.
"""

from collections.abc import Callable, Mapping

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength, spread_of_times
from bayes_sensor.diagnosis.effects.setting import Setting

Strengths = Callable[[Setting], tuple[Strength, ...]]


def _slow(s: Setting) -> tuple[Strength, ...]:
    time = Strength(
        "carry_time", "s", "log_normal", 6.0 * s.time_scale, 1.0,
        limits=(0.05 * s.time_scale, 60.0 * s.time_scale),
    )  # fmt: skip
    return (time,)


def _spread(s: Setting) -> tuple[Strength, ...]:
    return (*_slow(s), spread_of_times("carry_spread"))


def _share(own: bool, leaving: Strengths = lambda _: ()) -> Strengths:
    """A share, in every record another or in all the same, and the times in which it leaves."""
    size = Strength("carry_over", "1", "normal", 0.0, 0.03, per_experiment=own,
                    limits=(0.0, 2.0), scaled=True, alike=0.5)  # fmt: skip
    return lambda s: (size, *leaving(s))


def _of_its_own(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
    return dict(v)


def _of_before(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
    # the setting is a share of the record's own step, the strength one of the step before it
    ratio = s.concentration_before / s.experiment.concentration
    return {**v, "carry_over": v["carry_over"] * ratio}


_STARTS = ({"carry_time*": 4.0}, {"carry_time*": 20.0})

EFFECT = Effect(
    name="carry_over",
    family="initial state",
    stage="manifold",
    sentence="Gas from before is still leaving when the records begin: {strength}.",
    forms=tuple(
        Form(strengths, settings, name=name, weight=weight, starts=starts)
        for name, weight, strengths, settings, starts in (
            ("common", 1.0, _share(False), _of_its_own, ({},)),
            ("own", 1.0, _share(True), _of_its_own, ({},)),
            ("slow", 0.25, _share(True, _slow), _of_its_own, _STARTS),
            ("slow, spread", 0.25, _share(True, _spread), _of_its_own, _STARTS),
            ("of the record before", 0.5, _share(False), _of_before, ({},)),
            ("of the record before, slow", 0.5, _share(False, _slow), _of_before, _STARTS),
        )
    ),
    plausible={"carry_over": 0.02},
    null={"carry_over": 0.0},
    reference="flushing of a stirred volume",
    reveal="a longer flush before the record",
)
