"""Something else, of another kind: a parameter of the model that is not constant.

A smooth additive discrepancy sees what is left in the traces.  Many unlisted causes act inside the
model instead: a lag that depends on the flow, on the concentration, on the direction of the step,
or that changes from one experiment to the next (embedded discrepancy; Sargsyan, Najm and Ghanem
2015).  These rivals have no name of their own and count as unlisted.  Where a listed effect is
just such a dependence, the rival is left out for as long as that effect is in the catalogue: then
the dependence has a name.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from bayes_sensor.gap.effect import Effect, Form, Setting, Strength

WEIGHT = 0.35
"""share of "something else" that is embedded; the rest is additive"""
EXPONENT_SD = 0.15
"""spread of the exponent of a dependence on flow or concentration"""
RATIO_SD = 0.25
"""spread of the logarithm of a ratio between step down and step up"""


def _by_flow(setting: Setting) -> float:
    return setting.experiment.total_flow / setting.reference_flow


def _exponent(name: str) -> Strength:
    return Strength(name, "1", "normal", 0.0, EXPONENT_SD, limits=(-3.0, 3.0), scaled=True)


def _ratio(name: str, sd: float = RATIO_SD) -> Strength:
    return Strength(name, "1", "log_normal", 1.0, sd, limits=(0.05, 20.0), scaled=True)


def _power(target: str, name: str) -> Form:
    def settings(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
        return {target: _by_flow(s) ** v[name]}

    return Form(lambda s: (_exponent(name),), settings, starts=({name: 0.05}, {name: -0.05}))


def _direction(name: str) -> Form:
    return Form(lambda s: (_ratio(name),), lambda v, s: dict(v), starts=({name: 1.1}, {name: 0.9}))


def _by_experiment(target: str, sd: float) -> Form:
    name = f"{target}_of_its_own"
    own = Strength(name, "1", "log_normal", 1.0, sd, per_experiment=True, limits=(0.05, 20.0),
                   scaled=True)  # fmt: skip
    return Form(lambda s: (own,), lambda v, s: {target: v[name]})


_BY_CONCENTRATION = Form(
    lambda s: (_exponent("sensor_by_concentration"),),
    lambda v, s: {
        "sensor_factor": (s.experiment.concentration / 0.15) ** v["sensor_by_concentration"]
    },
    starts=({"sensor_by_concentration": 0.3}, {"sensor_by_concentration": -0.3}),
)

# name -> form and the listed effects that are this dependence
RIVALS: dict[str, tuple[Form, tuple[str, ...]]] = {
    "valve by flow": (_power("valve_factor", "valve_by_flow"), ()),
    "volume by flow": (_power("flow_factor", "volume_by_flow"), ()),
    "sensor by concentration": (_BY_CONCENTRATION, ()),
    "valve by experiment": (_by_experiment("valve_factor", 0.05), ()),
    "sensor by experiment": (_by_experiment("sensor_factor", 0.3), ()),
    "valve by direction": (_direction("closing_ratio"), ("valve_asymmetry",)),
    "volume by direction": (
        _direction("emptying_ratio"), ("flow_switching", "valve_asymmetry"),
    ),
    "sensor by direction": (_direction("release_ratio"), ("sorption_asymmetry",)),
}  # fmt: skip


def embedded_rivals(catalogue: Iterable[str], several_flows: bool, has_fall: bool) -> list[Effect]:
    """The rivals that a campaign can have and that no effect of the catalogue names."""
    known = set(catalogue)
    found = []
    for name, (form, named_by) in RIVALS.items():
        if known & set(named_by):
            continue
        if not several_flows and any(w in name for w in ("flow", "concentration", "experiment")):
            continue
        if "direction" in name and not has_fall:
            continue
        found.append(
            Effect(
                name=name,
                family="unlisted",
                sentence="",
                forms=(form,),
                plausible={},
                reference="",
                reveal="",
            )
        )
    return found
