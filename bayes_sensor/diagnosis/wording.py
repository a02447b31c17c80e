"""What the diagnosis says in sentences: of a verdict, its findings and what could not be told."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import ceil, floor, log
from typing import Any

import numpy as np

from bayes_sensor.diagnosis.closure import Closure
from bayes_sensor.diagnosis.data.binned_campaign import Sketch
from bayes_sensor.diagnosis.effects.effect import Effect, Setting
from bayes_sensor.diagnosis.evidence.form_mismatch import another_form
from bayes_sensor.diagnosis.evidence.hypotheses import Hypothesis, Weighing
from bayes_sensor.diagnosis.isolability import Separation
from bayes_sensor.diagnosis.location import CLEAR, Map
from bayes_sensor.diagnosis.signals.tails_and_converter import (
    FOUND,
    OF_UNLISTED_ORIGIN,
    UNITS,
    FullRate,
)
from bayes_sensor.diagnosis.verdict import (
    LIKELIER,
    NAMED,
    Standing,
    leaves_too_much,
    of_one_family,
    stands_beside,
)
from bayes_sensor.display import shown

MOSTLY = 0.7
"""share of a family's probability from which its leading member is stated alone"""
SURELY = 0.7
"""probability from which an unlisted cause is stated without saying how likely it is"""
TELLING = 1.2
"""times its usual size from which noise that is louder for a while is worth a note"""
WORTH_A_LOOK = log(2.0)
"""ln Bayes factor from which a finding is worth a note where nothing is said to be missing"""


def notes_on(sketch: Sketch) -> list[str]:
    """What the campaign cannot tell, in sentences."""
    campaign, spikes = sketch.campaign, sketch.floor.spikes
    notes = []
    if not any(e.has_fall for e in campaign):
        notes.append(
            "No step down was recorded: effects that differ between rise and fall cannot be seen."
        )
    if len(campaign) == 1:
        notes.append(
            "One experiment: nothing can be held out, and effects that depend on the flow look "
            "like those that do not."
        )
    elif campaign.same_flow:
        notes.append(
            "All experiments share one total flow: valve and manifold cannot be told apart."
        )
    if any(e.commanded_on is None for e in campaign):
        notes.append(
            "Not every experiment has a commanded time: misfits locked to the command, not to the "
            "response, are not looked for."
        )
    if spikes:
        notes.append(f"{spikes} samples beyond 6.5 standard deviations were taken for spikes.")
    spells = _louder_spells(sketch)
    if spells:
        more = f" and {len(spells) - 3} more" if len(spells) > 3 else ""
        notes.append(
            f"Noise is louder for a while in experiment {', '.join(spells[:3])}{more}: what stands "
            "out there counts less."
        )
    if sketch.order_known:
        than = "slower" if sketch.sensor else "faster"
        taken = (
            f"The sensor is taken to be {than} than the valve: a cascade cannot tell them apart."
        )
    else:
        taken = (
            "Nobody knows which lag is the sensor's and which the valve's: effects of the valve "
            "are tried on the longer one, effects of the sensor on the shorter one. Say in the "
            "campaign which one is the sensor's (sensor_is), or give side information on tau or "
            "tau_v."
        )
    notes.append(taken)
    return notes


def looks_most(full_rate: Sequence[FullRate], names: Sequence[str], unit: str) -> list[str]:
    """What comes nearest to an unlisted cause where none was stated, if it is worth a look.

    Events are rare, so that one that the data speak for may still pass for noise; whoever plots
    the residual will see it.
    """
    nearest = max(
        (f for f in full_rate if f.name in OF_UNLISTED_ORIGIN),
        key=lambda f: f.probability,
        default=None,
    )
    if nearest is None or nearest.log_bayes_factor < WORTH_A_LOOK:
        return []
    return [
        f"{_finding_words(nearest, names, unit)} That is put down to the noise "
        f"({100.0 * (1.0 - nearest.probability):.0f} %), but worth a look."
    ]


def whose(effect: Effect) -> str:
    """An effect, and where nobody knows whose the lags are the other that it may be."""
    name, other = effect.name, effect.exchanged
    if not other or effect.same_response != other:
        return name
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
    """What is said of a family; ``leading``: probability of its likeliest member.

    ``first``: that member in words, where they are more than its name.
    """
    leads = leading > MOSTLY * probability
    names = ", ".join(named)
    if probability < 0.5:
        one = (first or named[0]) if leads else f"one of {names}"
        return (
            f"No cause is likelier than not{place}; the likeliest is {one} "
            f"({100.0 * probability:.0f} %)."
        )
    if leads and other:
        pair = first or f"{named[0]}, or {other}, whose response is the same"
        return f"{pair}, explains the gap{place}."
    if leads:
        return (
            f"Most likely {named[0]} ({100.0 * leading:.0f} %) explains the gap{place}, but a "
            "cause outside the catalogue that looks the same is not excluded."
        )
    return f"One of {names} explains the gap{place}; this campaign does not tell them apart."


def _louder_spells(sketch: Sketch) -> list[str]:
    """Every experiment whose noise is louder for a while: when, and by how much."""
    found = []
    for b, times in zip(sketch.bins, sketch.floor.loudness, strict=True):
        loud = times > TELLING
        if np.any(loud):
            begins, ends = b.edges
            span = f"from {floor(begins[loud][0])} to {ceil(ends[loud][-1])} s"
            found.append(f"{b.experiment.name} ({span} up to {times.max():.1f} times)")
    return found


def moment(t: float) -> str:
    """A time ``t`` s on the record's clock, to a hundredth where four digits do not tell it.

    >>> moment(24.6699), moment(1000024.6699)
    ('24.67', '1000024.67')
    """
    return f"{t:.4g}" if abs(t) < 1e3 else f"{t:.2f}"


LAGS = {"valve": "longer", "sensor": "shorter"}
"""lag on which a stage's effects are tried where nobody knows whose it is"""
OTHER_PARTNERS = "the sensor behind another valve, or the valve with another sensor"
"""the measurement that tells whose a lag is"""
LABELS = {"mains_V": "amplitude", "mains_Hz": "frequency"}
"""of strengths whose names are those of their units"""


def _strength_words(strength: Mapping[str, Any], units: Mapping[str, str]) -> str:
    parts = []
    for name, value in strength.items():
        label = LABELS.get(name, name.replace("_", " "))
        unit = units.get(name, "")
        unit = "" if unit in ("1", "") else f" {unit}"
        if isinstance(value, Mapping):
            low, high = min(value.values()), max(value.values())
            parts.append(f"{label} {low:.3g} to {high:.3g}{unit}")
        else:
            parts.append(f"{label} {value:.3g}{unit}")
    return ", ".join(parts)


def _effect_words(
    effect: Effect, strength: Mapping[str, Any], sketch: Any, signal_unit: str
) -> str:
    """The effect's sentence with those of the strengths that are its own."""
    units = units_of([effect], sketch.settings[0], signal_unit)
    own = {k: v for k, v in strength.items() if k in units}
    said = effect.sentence.replace("{strength}", _strength_words(own, units))
    if not sketch.order_known and effect.stage in LAGS:
        said = said.replace(f"the {effect.stage}", f"the {LAGS[effect.stage]} lag")
    return said


WANDERS = (
    "What is left wanders at any time and in every record differently, as noise slower than these "
    "records can show does, too: a record of the carrier gas alone would tell."
)


OFTEN_NOISE = (
    "That may as well be noise of an odd kind: in blind checks every other such finding was."
)


def _likeness(weighing: Weighing, unit: str) -> str:
    """What a cause without a name acts like; empty where nothing of the kind is likely."""
    shares = weighing.probabilities
    likely = int(np.argmax(shares))
    h = weighing.hypotheses[likely]
    if shares[likely] < 0.5:
        return ""
    wandering = sum(t.share for t in h.terms if t.beside and t.beside.name.startswith("drift"))
    if h.incomplete and not h.within and wandering > 0.5:
        return WANDERS
    if not h.within:
        return ""
    plan = h.refit.plan
    words = _effect_words(plan.parts[-1].effect, h.refit.strength(), plan.sketch, unit)
    return f"It acts as if {words}."


def _finding_words(found: FullRate, names: Sequence[str], unit: str) -> str:
    """One sentence about something of unlisted origin."""
    s = found.strength
    if found.name == "line":
        return (
            f"There is a line of unlisted origin at {s['line_Hz']:.4g} Hz with an amplitude "
            f"of {1e3 * s['line_V']:.3g} m{unit}."
        )
    if found.name == "swing":
        return (
            f"The signal swings slowly, once in {1.0 / s['swing_Hz']:.3g} s, with an amplitude of "
            f"{1e3 * s['swing_V']:.3g} m{unit}."
        )
    if found.name == "passing":
        return (
            f"In experiment {names[int(s['passing_experiment'])]} there is, for a while or "
            f"throughout, a line at {s['passing_Hz']:.4g} Hz that others lack, with an amplitude "
            f"of {1e3 * s['passing_V']:.3g} m{unit}."
        )
    if found.name == "bursts":
        return (
            f"The mains come and go, once in {1.0 / s['bursts_Hz']:.3g} s, as of a heater that is "
            "fired in bursts."
        )
    if found.name == "ringing":
        return f"After the switches the signal rings at about {s['ringing_Hz']:.3g} Hz."
    if found.name == "event":
        return (
            f"In experiment {names[int(s['event_experiment'])]} something happens once, near "
            f"{moment(s['event_s'])} s: {s['event_ratio']:.2g} times the noise's usual size at "
            "that time scale."
        )
    if found.name == "unsteady":
        return (
            "With gas the signal is less steady than its noise on the baseline lets expect: below "
            f"about {s['unsteady_Hz']:.2g} Hz it has {1.0 + s['unsteady_excess']:.2g} times the "
            "power."
        )
    if found.name == "break":
        return (
            f"In experiment {names[int(s['break_experiment'])]} the level changes at about "
            f"{moment(s['break_s'])} s in a way of its own"
            f" ({s['break_ratio']:.2g} standard deviations)."
        )
    side = "after" if s["patch_since_s"] >= 0.0 else "before"
    return (
        "Single switches leave the model for moments, clearest in experiment "
        f"{names[int(s['patch_experiment'])]}, {abs(s['patch_since_s']):.2g} s {side} a switch."
    )


def units_of(effects: Iterable[Effect], setting: Setting, signal_unit: str) -> dict[str, str]:
    """Unit of every strength of the effects and of what is found at full rate; "1": it has none."""
    found = {s.name: s.unit for e in effects for form in e.forms for s in form.strengths(setting)}
    return {name: unit.replace("V", signal_unit) for name, unit in {**UNITS, **found}.items()}


def sentence(
    kind: str,
    named: Sequence[str],
    probability: float,
    weighing: Weighing,
    stand: Standing,
    best: Hypothesis,
    located: Map,
    catalogue: Mapping[str, Effect],
    separations: Sequence[Separation],
    closed: Closure,
    full_rate: Sequence[FullRate],
    envelope: tuple[float, float],
    unit: str,
) -> str:
    """What a verdict says: what explains the gap, how sure that is, and what would show it.

    ``best``: the explanation that the verdict stands for; ``envelope`` s: of tau, where nothing is
    named; ``unit``: of the signal.
    """
    phases: dict[str, float] = {}
    for c in located.cells:
        phases[c.phase] = phases.get(c.phase, 0.0) + c.share
    worst = max(phases, key=lambda p: phases[p]) if any(phases.values()) else None
    place = f", mostly in the {worst}" if worst else ""
    if kind == "none":
        low, high = (shown(1e3 * t, 2) for t in envelope)
        nothing = "Nothing is missing beyond the noise floor."
        if probability < 0.5:
            nothing = (
                "No cause is likely enough to be stated, and nothing may be missing beyond the "
                f"noise floor ({100.0 * probability:.0f} %)."
            )
        if located.p_value < CLEAR:
            nothing = (
                "No cause is likely enough to be stated, and nothing may be missing beyond the "
                f"noise floor ({100.0 * probability:.0f} %); yet noise alone would seldom leave as "
                f"much (p = {shown(located.p_value, 2)})."
            )
        lag = "tau" if best.refit.plan.sketch.order_known else "the shorter lag"
        return (
            f"{nothing} Effects that this campaign cannot see may still hide: with them {lag} "
            f"could lie anywhere from {low} to {high} ms."
        )
    sketch = best.refit.plan.sketch
    names = [e.name for e in sketch.campaign]
    findings = [f for f in full_rate if f.name in OF_UNLISTED_ORIGIN and f.probability > FOUND]
    findings.sort(key=lambda f: -f.log_bayes_factor)  # the clearest first
    found = [_finding_words(f, names, unit) for f in findings]
    if kind == "unlisted" and probability < 0.5 and stand.looks_unlisted <= LIKELIER:
        return " ".join([undecided_words(place, stand), *found])
    if kind == "unlisted":
        words = []
        by_mean = worst is not None and located.shared_by != "findings"
        closing = ""
        if best.effects and stand.looks_by_mean < 0.5 and closed.fraction is not None:
            causes = " and ".join(whose(catalogue[name]) for name in best.effects)
            closing = (
                f"{causes} would close {100.0 * closed.fraction:.0f} % of the gap{place}, yet "
            )
        if closing and leaves_too_much(best, weighing.base):
            leave = "leaves" if len(best.effects) == 1 else "leave"
            words.append(
                f"{closing}{leave} {best.leftover:.0f} standard deviations of misfit: the cause is "
                f"not listed ({100.0 * probability:.0f} %), or the noise is not what it seems."
            )
        elif closing and findings:
            words.append(
                f"{closing}more is seen, which no effect of the catalogue makes "
                f"({100.0 * probability:.0f} %)."
            )
        elif by_mean or not findings:
            seems = "misses" if probability > SURELY else "seems to miss"
            sure = "" if probability > SURELY else f" ({100.0 * probability:.0f} %)"
            words.append(
                f"The model {seems} the measurement{place}, and no effect of the catalogue "
                f"explains it well: the cause is not listed{sure}."
            )
        words += found
        if findings and stand.looks_by_mean < 0.5:
            words.append(OFTEN_NOISE)
        return " ".join([*words, _likeness(weighing, unit)]).rstrip()
    besides = [
        text
        for f, text in zip(findings, found, strict=True)
        if stands_beside(f, best.refit, weighing.base)
    ]
    if kind == "family":
        helps = next((s for s in separations if s.addition), None)
        first = whose(catalogue[named[0]])
        first = "" if first == named[0] else first
        reveal = OTHER_PARTNERS if first else catalogue[named[0]].reveal
        advice = (
            f"To tell {helps.effect} from {helps.rival}: {helps.addition}."
            if helps
            else f"What would show it: {reveal}."
        )
        beside = [
            _effect_words(catalogue[f.name], f.strength, sketch, unit)
            for f in full_rate
            if f.name in catalogue and f.probability > NAMED
        ]
        other = catalogue[named[0]].same_response
        if of_one_family(best, catalogue):
            a, b = (whose(catalogue[name]) for name in best.effects)
            said = (
                f"{a} and {b} together explain the gap best{place}: two causes of one family, or "
                "one that acts otherwise than the catalogue's."
            )
        else:
            leading = family_words(named, probability, stand.effects[named[0]], place, other, first)
            said = " ".join([leading, *form_words(weighing, named)])
        return " ".join([said, advice, *beside, *besides])
    words = []
    by_name = {f.name: f for f in full_rate}
    fitted = best.refit.strength()
    for n in named:
        strength = fitted if catalogue[n].on_mean else by_name[n].strength
        words.append(_effect_words(catalogue[n], strength, sketch, unit))
    beside = second_words(named, stand, catalogue)
    alone = set(best.effects) <= set(named)
    if closed.fraction is not None and closed.low is not None and closed.high is not None:
        closes = (
            f"{'It closes' if alone else 'Together they close'} {100.0 * closed.fraction:.0f} % of "
            f"the gap (95 % interval {100.0 * closed.low:.0f} to {100.0 * closed.high:.0f} %)."
        )
        beside = [closes, *beside] if alone else [*beside, closes]
    return " ".join([*words, *beside, *besides])


def form_words(weighing: Weighing, named: Sequence[str]) -> list[str]:
    """What is said of a leftover that the form of what is named may make."""
    likely = weighing.hypotheses[int(np.argmax(weighing.probabilities))]
    form = another_form(likely, weighing)
    if form is None or not set(form.effects) <= set(named):
        return []
    others = [name for name in likely.effects if name not in form.effects]
    instead = f" {others[0]} beside it" if others else " something else beside it"
    return [
        f"What {' and '.join(form.effects)} leaves, {100.0 * form.left:.0f} % of the gap's size, "
        f"may be{instead}, or no more than a form that is not quite the catalogue's."
    ]


def without_a_step(kind: str, said: str) -> str:
    """What a verdict says where the fit has found no step, so that the model explains nothing."""
    unseen = "No step is seen beyond what the model misses, in any experiment"
    if kind == "none":
        return f"{unseen}: whether anything is missing cannot be told."
    return f"{unseen}, so what follows says little. {said}"


def held_by_commands(held: int, switches: int, said: str) -> str:
    """What a verdict says where switch times sit at the earliest that their commands allow."""
    return (
        f"{held} of {switches} switch times sit at the earliest that their commands allow: check "
        f"these, since what follows takes them as right. {said}"
    )


def second_words(
    named: Sequence[str], stand: Standing, catalogue: Mapping[str, Effect]
) -> list[str]:
    """What is likely beside the effects that are named: the likeliest of the other families."""
    own = {catalogue[n].family for n in named}
    others = {f: p for f, p in stand.families.items() if f not in own}
    other = max(others, key=lambda f: others[f], default=None)
    if other is None or others[other] < 0.5:
        return []
    members = [n for n in catalogue if catalogue[n].family == other]
    leading = max(members, key=lambda n: stand.effects[n])
    alike, words = catalogue[leading].same_response, whose(catalogue[leading])
    if alike and words == leading:
        words += f" or {alike}, whose response is the same"
    return [
        f"Beside it something else is likely, of the family {other} ({100.0 * others[other]:.0f} "
        f"%), most likely {words}."
    ]


def undecided_words(place: str, stand: Standing) -> str:
    """What is said where nothing is likelier than not, or only several families each."""
    likely = [f for f, p in stand.families.items() if p > 0.5]
    if likely:
        each = ", ".join(f"{f} {100.0 * stand.families[f]:.0f} %" for f in likely)
        return (
            f"Something is missing{place}, but which is not clear: an effect of the family is "
            f"likely ({each}), and so nearly is that a cause outside the catalogue has a part in "
            f"it ({100.0 * stand.unlisted:.0f} %)."
        )
    return (
        f"Something may be missing{place}, but neither that nothing is, nor any family of "
        "effects, nor an unlisted cause is likelier than not."
    )
