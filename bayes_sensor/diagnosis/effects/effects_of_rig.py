"""The effects that a rig can have: those of its stages, in the forms that its input allows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.diagnosis.effects.effect import Effect, Form
from bayes_sensor.diagnosis.effects.setting import Setting
from bayes_sensor.rig.layout import Layout
from bayes_sensor.rig.rig import Rig
from bayes_sensor.rig.switching import Switching

ALWAYS = ("sensor", "readout", "record", "before", "")
"""stages that every rig has"""
ALL = frozenset({*ALWAYS, "command", "valve", "flow", "manifold"})
"""those of the published rig"""
WORDS = {
    "valve": "a stage called valve",
    "flow": "a stage that is a volume, which a flow sweeps",
    "manifold": "a stage that is a volume",
    "command": "an input that is switched, not a recorded one",
}
"""what an effect of a stage needs"""
MISSING_STAGE = "a stage that is not in the rig"
"""what has the response of a low-pass"""
INPUT_TAKES_TIME = "The input does not jump, but takes a finite time to change: {strength}."
RECORD_THE_INPUT = "a record of the input itself, by a faster instrument"
LONGER_STEP = "a step that lasts longer, and the sensor by another principle in the same gas"
"""words of effects where no stage is a valve"""
OF_ANOTHER = "the same in another stage"
"""what an effect of the sensor's lag may be of, where no stage is a valve"""
PUBLISHED_ONLY = ("closing_bend",)
"""settings that the kernel of other rigs does not have"""


@dataclass(frozen=True)
class Possible:
    """What effects of a campaign may act on."""

    stages: frozenset[str]
    """as :attr:`Effect.stage` has them; ``before``: what was there before a record"""
    any_rig: bool
    """whether it is another rig, or another programme, than pulses on the published one"""
    falls: bool
    """whether a switch leads down"""
    several_lags: bool = True
    """whether another lag than the sensor's is there, which may do what the sensor's does"""

    @classmethod
    def of(cls, campaign: Campaign) -> Possible:
        """Of a campaign's rig and its inputs."""
        layout = Layout.of(campaign)
        if layout.is_published:
            return cls(ALL, False, any(layout.has_fall))
        return cls.on(layout.rig, layout.switching)

    @classmethod
    def on(cls, rig: Rig, inputs: Sequence[Switching]) -> Possible:
        """On a chain of stages.

        A flow needs a volume that it sweeps, a command an input that is switched.
        """
        found = set(ALWAYS)
        if any(stage.name == "valve" for stage in rig.stages):
            found.add("valve")
        if rig.needs_flow:
            found |= {"flow", "manifold"}
        if all(each.recorded is None for each in inputs):
            found.add("command")
        falls = any(height < 0.0 for each in inputs for height in each.heights)
        return cls(frozenset(found), True, falls, rig.n_lags > 1)

    def stage_of(self, effect: Effect) -> str:
        """What an effect acts on; gas that is left from before may be in any stage."""
        return "before" if effect.family == "initial state" else effect.stage

    def effects(self, catalogue: Mapping[str, Effect], setting: Setting) -> dict[str, Effect]:
        """Those of a catalogue that may act, in the forms that may."""
        if not self.any_rig:
            return dict(catalogue)
        found = {}
        for name, effect in catalogue.items():
            if self.stage_of(effect) not in self.stages:
                continue
            forms = tuple(form for form in effect.forms if self.has(form, setting))
            if forms or not effect.forms:
                found[name] = self.named_on(replace(effect, forms=forms))
        return found

    def named_on(self, effect: Effect) -> Effect:
        """An effect in words, and with look-alikes, of the stages that there are."""
        if effect.name == "daq_filter":  # one more lag, wherever it is
            effect = replace(effect, same_response=MISSING_STAGE)
        if "valve" in self.stages:
            return effect
        if effect.stage == "command":
            effect = replace(effect, sentence=INPUT_TAKES_TIME, reveal=RECORD_THE_INPUT)
        if effect.name == "slow_sorption":
            effect = replace(effect, reveal=effect.reveal if self.several_lags else LONGER_STEP)
        if effect.same_response == MISSING_STAGE:
            return effect
        instead = OF_ANOTHER if self.several_lags else ""
        return replace(
            effect,
            same_response=instead if effect.same_response else "",
            exchanged=instead if effect.exchanged else "",
        )

    def has(self, form: Form, setting: Setting) -> bool:
        """Whether the kernel and the input have what a form acts on."""
        strengths = {s.name: s.value(0.0) for s in form.strengths(setting)}
        settings = form.settings(strengths, setting)
        if self.any_rig and any(name in PUBLISHED_ONLY for name in settings):
            return False
        return not settings.get("step_with_fall") or self.falls

    def check(self, effect: Effect, form: Form, setting: Setting) -> None:
        """Raise CampaignError where an effect cannot act in a form."""
        stage = self.stage_of(effect)
        if stage not in self.stages:
            raise CampaignError(
                f"effect {effect.name} needs {WORDS.get(stage, f'a {stage}')}, but this rig or "
                "programme has none; leave it out"
            )
        if self.any_rig and not self.has(form, setting):
            raise CampaignError(
                f"effect {effect.name} cannot act in the form '{form.name}' on this rig; give "
                "another form, or leave it out"
            )
