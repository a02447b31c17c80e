"""What the diagnosis says in sentences: of a verdict, its findings and what could not be told."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import log
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.diagnosis.campaign_notes import notes_on
from bayes_sensor.diagnosis.closed_fraction import Closure
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.effects.effects_of_rig import OF_ANOTHER
from bayes_sensor.diagnosis.effects.setting import Setting
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison, Hypothesis
from bayes_sensor.diagnosis.evidence.form_mismatch import (
    leaves_excess,
    leaves_explanation_alone,
    simpler_explanation,
)
from bayes_sensor.diagnosis.isolability import Separation
from bayes_sensor.diagnosis.location import ExcessMap
from bayes_sensor.diagnosis.p_value_words import against_p_value, percent
from bayes_sensor.diagnosis.probabilities import Probabilities
from bayes_sensor.diagnosis.signals import SIGNALS
from bayes_sensor.diagnosis.signals.signal import FOUND, Finding
from bayes_sensor.diagnosis.verdict import NAMED, Judgement, of_one_family
from bayes_sensor.display import shown, time_unit

if TYPE_CHECKING:
    from bayes_sensor.campaign import Campaign
    from bayes_sensor.fit import Fit

MOSTLY = 0.7
"""share of a family's probability from which its leading member is stated alone"""
MANY_HELD = 0.25
"""share of the switch times at their bounds from which commands are in doubt"""
WORTH_A_LOOK = log(2.0)
"""ln Bayes factor from which a finding is worth a note where nothing is said to be missing"""


def nearest_finding(found: Conclusion) -> list[str]:
    """The likeliest finding of unlisted origin where the verdict is none, if it is worth a look.

    Events are rare, so that one that the data favour may still be put down to noise; a plot of the
    residual shows it.
    """
    unlisted = [f for f in found.findings if not f.signal.listed]
    nearest = max(unlisted, key=lambda f: f.probability, default=None)
    if found.judgement.kind != "none" or nearest is None:
        return []
    if nearest.log_bayes_factor < WORTH_A_LOOK:
        return []
    return [
        f"{found.in_words([nearest])[0]} That is put down to the noise "
        f"({100.0 * (1.0 - nearest.probability):.0f} %), but worth a look."
    ]


def less_likely(found: Conclusion) -> list[str]:
    """Findings that something else is stated beside, and that are worth a look."""
    if found.judgement.kind == "none":
        return []
    some = [f for f in found.findings if not f.signal.listed and f.log_odds > 0.0]
    return [
        f"Worth a look: {said} That is a cause of its own with a probability of "
        f"{percent(f.probability)}."
        for f, said in zip(some, found.in_words(some), strict=True)
        if f.probability <= FOUND
    ]


def with_alternative(effect: Effect) -> str:
    """The effect's name, with its counterpart where the lags cannot be assigned."""
    name, other = effect.name, effect.exchanged
    if not other or effect.same_response != other:
        return name
    if other == OF_ANOTHER:
        return f"{name} if the {LAGS[effect.stage]} lag is the sensor's, or {other}"
    rival = next(stage for stage in LAGS if stage != effect.stage)
    return (
        f"{name} if the {LAGS[effect.stage]} lag is the {effect.stage}'s, or {other} if it is the "
        f"{rival}'s"
    )


def family_words(
    named: Sequence[str],
    probability: float,
    leading: float,
    place: str,
    other: str,
    first: str = "",
) -> str:
    """The sentence on a family; ``leading``: probability of its likeliest member.

    ``first``: that member in words, where they are more than its name.
    """
    leads = leading > MOSTLY * probability
    names = ", ".join(named)
    sure = percent(probability)
    if probability < 0.5:
        one = (first or named[0]) if leads else f"one of {names}"
        return f"No cause has a probability above one half{place}; the likeliest is {one} ({sure})."
    if leads and other:
        alike = other if other == OF_ANOTHER else f"{other}, whose response is the same"
        pair = first or f"{named[0]}, or {alike}"
        return f"{pair}, explains the gap{place} ({sure})."
    if leads and len(named) == 1:
        return (
            f"Most likely {named[0]} ({sure}) explains the gap{place}, but a cause outside the "
            "catalogue that looks the same is not excluded."
        )
    if leads:
        return f"One of {names} explains the gap{place} ({sure}), most likely {named[0]}."
    return (
        f"One of {names} explains the gap{place} ({sure}); this campaign does not tell them apart."
    )


LAGS = {"valve": "longer", "sensor": "shorter"}
"""lag on which a stage's effects are tried where nobody knows whose it is"""
OTHER_PARTNERS = "the sensor behind another valve, or the valve with another sensor"
"""the measurement that tells whose a lag is"""


def _strength_words(
    strength: Mapping[str, Any], units: Mapping[str, str], labels: Mapping[str, str]
) -> str:
    parts = []
    for name, value in strength.items():
        label = labels.get(name, name.replace("_", " "))
        unit = units.get(name, "")
        unit = "" if unit in ("1", "") else f" {unit}"
        if isinstance(value, Mapping):
            ends = (f"{end(value.values()):.3g}" for end in (min, max))
            parts.append(f"{label} {' to '.join(dict.fromkeys(ends))}{unit}")
        else:
            parts.append(f"{label} {value:.3g}{unit}")
    return ", ".join(parts)


def effect_sentence(
    effect: Effect, strength: Mapping[str, Any], binned: Any, signal_unit: str
) -> str:
    """The effect's sentence with those of the strengths that are its own."""
    own = effect.units(binned.settings[0])
    units = {name: unit.replace("V", signal_unit) for name, unit in own.items()}
    shown_ones = {k: v for k, v in strength.items() if k in units}
    words = _strength_words(shown_ones, units, effect.labels)
    said = effect.sentence.replace("{strength}", words)
    if not binned.order_known and effect.stage in LAGS:
        said = said.replace(f"the {effect.stage}", f"the {LAGS[effect.stage]} lag")
    return said


WANDERS = (
    "What is left wanders at any time and in every record differently, as noise slower than these "
    "records can show does, too: a record of the carrier gas alone would tell."
)


def _likeness(comparison: Comparison, unit: str) -> str:
    """What an unlisted cause resembles; empty where no resemblance is likely."""
    shares = comparison.probabilities
    likely = int(np.argmax(shares))
    h = comparison.hypotheses[likely]
    if shares[likely] < 0.5:
        return ""
    wandering = sum(t.share for t in h.terms if t.beside and t.beside.name.startswith("drift"))
    if h.incomplete and not h.within and wandering > 0.5:
        return WANDERS
    if not h.within:
        return ""
    coords = h.refit.coords
    words = effect_sentence(coords.parts[-1].effect, h.refit.strength(), coords.binned, unit)
    return f"It acts as if {words}."


def units_of(effects: Iterable[Effect], setting: Setting, signal_unit: str) -> dict[str, str]:
    """Unit of every strength of effects and of signals; "1": it has none."""
    found: dict[str, str] = {}
    for signal in SIGNALS:
        found |= signal.units
    for effect in effects:
        found |= effect.units(setting)
    return {name: unit.replace("V", signal_unit) for name, unit in found.items()}


@dataclass(frozen=True, eq=False)
class Conclusion:
    """The results of a diagnosis that its sentence is made from."""

    judgement: Judgement
    comparison: Comparison
    probabilities: Probabilities
    best: Hypothesis
    """the explanation that the verdict stands for"""
    excess: ExcessMap
    closure: Closure
    findings: Sequence[Finding]
    separations: Sequence[Separation]
    envelope: tuple[float, float]
    """s, of tau, where nothing is named"""
    unit: str
    """of the signal"""

    @cached_property
    def phase(self) -> str:
        """The phase with most of the excess; empty where there is none."""
        phases: dict[str, float] = {}
        for c in self.excess.cells:
            phases[c.phase] = phases.get(c.phase, 0.0) + c.share
        return max(phases, key=lambda p: phases[p]) if any(phases.values()) else ""

    @property
    def place(self) -> str:
        """That phase, as a sentence goes on."""
        return f", mostly in the {self.phase}" if self.phase else ""

    @cached_property
    def unlisted(self) -> list[Finding]:
        """What is there and of unlisted origin, the clearest first."""
        found = [f for f in self.findings if not f.signal.listed and f.probability > FOUND]
        return sorted(found, key=lambda f: -f.log_bayes_factor)

    def in_words(self, findings: Iterable[Finding]) -> list[str]:
        """Their sentences."""
        names = [e.name for e in self.comparison.binned.campaign]
        return [f.sentence(names, self.unit) for f in findings]

    @property
    def beside(self) -> list[str]:
        """Sentences of the findings of unlisted origin that take nothing from the explanation."""
        base = self.comparison.base
        return self.in_words(
            f for f in self.unlisted if leaves_explanation_alone(f, self.best.refit, base)
        )


def verdict_sentence(found: Conclusion, fit: Fit) -> str:
    """The sentence of a verdict, after what in the fit casts doubt on it."""
    campaign = found.comparison.binned.campaign
    return _with_doubts(sentence(found), found.judgement.kind, fit, campaign)


def notes(found: Conclusion) -> list[str]:
    """What could not be told, and what is worth a look, in sentences."""
    return [*notes_on(found.comparison.binned), *nearest_finding(found), *less_likely(found)]


def sentence(found: Conclusion) -> str:
    """What a verdict says: what explains the gap, how sure that is, and what would show it."""
    doubts = against_p_value(found.judgement, found.excess.p_value, found.probabilities)
    said = {"none": _nothing, "unlisted": _unlisted, "family": _family, "effect": _effects}
    return " ".join([*said[found.judgement.kind](found), *doubts])


def _nothing(found: Conclusion) -> list[str]:
    """The sentence where nothing exceeds the noise floor."""
    probability = found.judgement.probability
    per_s, unit = time_unit(found.envelope[1])
    low, high = (shown(per_s * t, 2) for t in found.envelope)
    nothing = f"Nothing is missing that this campaign could show ({percent(probability)})."
    if probability < 0.5:
        nothing = (
            "No cause is likely enough to be stated, and nothing may be missing beyond the noise "
            f"floor ({percent(probability)})."
        )
    return [
        f"{nothing} Effects that this campaign cannot show may still be there: with them "
        f"{found.comparison.binned.stated_lag} could be anywhere from {low} to {high} {unit}."
    ]


def _unlisted(found: Conclusion) -> list[str]:
    """The sentences on an unlisted cause."""
    probability, comparison, best = found.judgement.probability, found.comparison, found.best
    place, by_samples = found.place, found.in_words(found.unlisted)
    sure = f" ({percent(probability)})"
    if probability < 0.5:
        words = [undecided_words(place, found.probabilities)]
    elif best.effects and leaves_excess(best, comparison.base) and found.closure.fraction:
        effects = [comparison.catalogue[name] for name in best.effects]
        causes = " and ".join(with_alternative(effect) for effect in effects)
        words = [
            f"{causes} would close {percent(found.closure.fraction)} of the gap{place}, yet "
            f"{best.leftover:.0f} standard deviations of misfit are left: the cause is not "
            f"listed{sure}, or the noise floor is wrong."
        ]
    elif found.probabilities.looks("none") > 0.5 and by_samples:
        words = [f"Single samples show a cause that is not listed{sure}."]
    else:
        words = [
            f"The model misses the measurement{place}, and no effect of the catalogue explains it "
            f"well: the cause is not listed{sure}."
        ]
    likeness = _likeness(comparison, found.unit)
    return [*words, *by_samples, *([likeness] if likeness else [])]


def _family(found: Conclusion) -> list[str]:
    """The sentences on a family."""
    _, named, _, probability = found.judgement
    catalogue, best, place = found.comparison.catalogue, found.best, found.place
    leading = catalogue[named[0]]
    first = with_alternative(leading)
    first = "" if first == leading.name else first
    helps = next((s for s in found.separations if s.addition), None)
    flows = not found.comparison.binned.campaign.same_flow
    advice = (
        f"To tell {helps.effect} from {helps.rival}: {helps.addition}."
        if helps
        else f"What would show it: {OTHER_PARTNERS if first else leading.advice(flows)}."
    )
    if of_one_family(best, catalogue):
        a, b = (with_alternative(catalogue[name]) for name in best.effects)
        said = [
            f"{a} and {b} together explain the gap best{place}: two causes of one family, or "
            "one that acts otherwise than the catalogue's."
        ]
    else:
        likeliest = found.probabilities.effects[named[0]]
        words = family_words(named, probability, likeliest, place, leading.same_response, first)
        said = [words, *form_words(found.comparison, named)]
        said += instead_words(named, found.probabilities, catalogue)
    on_noise = [
        effect_sentence(catalogue[f.name], f.strength, found.comparison.binned, found.unit)
        for f in found.findings
        if f.name in catalogue and f.probability > NAMED
    ]
    return [*said, advice, *on_noise, *found.beside]


def _effects(found: Conclusion) -> list[str]:
    """The sentences on the one or two effects that are named."""
    _, named, _, probability = found.judgement
    catalogue = found.comparison.catalogue
    by_name = {f.name: f for f in found.findings}
    fitted = found.best.refit.strength()
    words = []
    for n in named:
        strength = fitted if catalogue[n].on_mean else by_name[n].strength
        words.append(effect_sentence(catalogue[n], strength, found.comparison.binned, found.unit))
    words.append(f"The probability that this is the whole story is {percent(probability)}.")
    second = second_words(named, found.probabilities, catalogue)
    alone = set(found.best.effects) <= set(named)
    closed = found.closure
    if closed.fraction is not None and closed.low is not None and closed.high is not None:
        closes = (
            f"{'It closes' if alone else 'Together they close'} {100.0 * closed.fraction:.0f} % of "
            f"the gap (95 % interval {100.0 * closed.low:.0f} to {100.0 * closed.high:.0f} %)."
        )
        second = [closes, *second] if alone else [*second, closes]
    return [*words, *second, *found.beside]


def form_words(comparison: Comparison, named: Sequence[str]) -> list[str]:
    """The sentence on a leftover that may be the shape error of a named effect."""
    likely = comparison.hypotheses[int(np.argmax(comparison.probabilities))]
    form = simpler_explanation(likely, comparison)
    if form is None or not set(form.effects) <= set(named):
        return []
    others = [name for name in likely.effects if name not in form.effects]
    instead = f" {others[0]} beside it" if others else " something else beside it"
    return [
        f"What {' and '.join(form.effects)} leaves, {100.0 * form.left:.0f} % of the gap's size, "
        f"may be{instead}, or the effect's true form differs a little from the catalogue's."
    ]


def _with_doubts(said: str, kind: str, fit: Fit, campaign: Campaign) -> str:
    """A verdict's sentence after what in the fit casts doubt on it.

    Switch times may sit at the earliest that their commands allow; or the fit has found no step,
    so that the model explains nothing.
    """
    held = [n for n in fit.at_bound if n.startswith(("t0_s", "tf_s"))]
    switches = sum(1 + e.has_fall for e in campaign)
    if len(held) > MANY_HELD * switches:
        said = (
            f"{len(held)} of {switches} switch times sit at the earliest that their commands "
            f"allow: check these, since what follows takes them as right. {said}"
        )
    if fit.step_seen:
        return said
    unseen = "No step is seen beyond what the model misses, in any experiment"
    if kind == "none":
        return f"{unseen}: whether anything is missing cannot be told."
    return f"{unseen}, so do not rely on what follows. {said}"


def second_words(
    named: Sequence[str], combined: Probabilities, catalogue: Mapping[str, Effect]
) -> list[str]:
    """The sentence on the likeliest of the other families, beside the effects that are named."""
    own = {catalogue[n].family for n in named}
    others = {f: p for f, p in combined.families.items() if f not in own}
    other = max(others, key=lambda f: others[f], default=None)
    if other is None or others[other] < 0.5:
        return []
    members = [n for n in catalogue if catalogue[n].family == other]
    leading = max(members, key=lambda n: combined.effects[n])
    alike, words = catalogue[leading].same_response, with_alternative(catalogue[leading])
    if alike and words == leading:
        words += f" or {alike}, whose response is the same"
    return [
        f"Beside it something else is likely, of the family {other} ({100.0 * others[other]:.0f} "
        f"%), most likely {words}."
    ]


def instead_words(
    named: Sequence[str], combined: Probabilities, catalogue: Mapping[str, Effect]
) -> list[str]:
    """The sentence on the likeliest effect of another family in place of those that are named.

    Empty where an unlisted cause is likelier.
    """
    own = {catalogue[n].family for n in named}
    shares: dict[str, float] = {}
    for row, p in combined.rows.items():
        effects = [catalogue[n] for n in row.split("+") if n in catalogue]
        if not own & {effect.family for effect in effects}:
            for effect in effects:
                if effect.on_mean:
                    shares[effect.name] = shares.get(effect.name, 0.0) + p
    rival = max(shares, key=lambda name: shares[name], default=None)
    if rival is None or shares[rival] <= max(combined.unlisted, combined.none):
        return []
    return [f"If it is not that, {with_alternative(catalogue[rival])} ({percent(shares[rival])})."]


def undecided_words(place: str, combined: Probabilities) -> str:
    """The sentence where no explanation is likelier than one half, or several families are."""
    likely = [f for f, p in combined.families.items() if p > 0.5]
    if likely:
        each = ", ".join(f"{f} {100.0 * combined.families[f]:.0f} %" for f in likely)
        return (
            f"Something is missing{place}, but which is not clear: an effect of the family is "
            f"likely ({each}), but a cause outside the catalogue may have a part in it "
            f"({100.0 * combined.unlisted:.0f} %)."
        )
    return (
        f"Something may be missing{place}. No answer (no cause, a family of effects, an unlisted "
        "cause) has a probability above one half."
    )
