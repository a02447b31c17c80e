"""What stands before the headline because it decides whether that stands, and what to keep in mind.

A remark that several experiments or methods share is said once.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from bayes_sensor.figures.method_words import method_words, quoted
from bayes_sensor.io.run_record import of_other_data
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import list_words, sentence, typeset

MOST_OF_SUBJECT = 24
"""characters of what a remark is about, where several are told together"""
CONCERNED = (
    "This concerns every interval that depends on the noise law: the posterior, the profile and "
    "the Cramér-Rao bounds."
)


def _take_as_they_are() -> str:
    from bayes_sensor.residuals import TAKE_AS_THEY_ARE  # slow to import

    return TAKE_AS_THEY_ARE


def doubts(saved: Saved) -> list[str]:
    """Failed checks of the noise law, as in the warnings of every interval."""
    found = list((saved.posterior or {}).get("doubts", []))
    record = saved.residuals
    if record is not None and not record["adequate"]:
        found.append(f"{record['verdict']} {record.get('recommendation') or _take_as_they_are()}")
    return found


def alerts(saved: Saved) -> list[tuple[str, str]]:
    """(kind, sentence) for the top of the page.

    ``bad`` for caveats of the headline, which the page shows before it; the rest are notes.
    """
    bad = [sentence(text) for text in _decisive(saved)]
    return [*(("bad", text) for text in bad), *(("note", text) for text in _notes(saved, bad))]


def _decisive(saved: Saved) -> Iterable[str]:
    """What decides whether the headline stands."""
    if saved.restored is not None:
        yield from saved.restored["warnings"]
    fit, posterior, residuals, predictive = (
        saved.fit, saved.posterior, saved.residuals, saved.predictive,
    )  # fmt: skip
    if fit is not None:
        yield from (typeset(caveat) for caveat in fit.get("caveats") or [])
        if not fit["converged"]:
            yield f"The least-squares fit did not converge. {fit['status']}"
    if posterior is not None and not posterior["converged"]:
        status = posterior.get("convergence", posterior["status"])
        yield (
            f"The posterior did not converge, so its intervals must not be quoted ({status}). "
            "Continue it with --resume and more steps."
        )
    n = len(saved.campaign["experiments"])
    if saved.missed > n / 2:
        yield (
            f"The model misses {saved.missed} of {n} traces by more than AR(1) noise explains: it "
            "leaves something out, or the noise is another. The intervals below take both as "
            "right; what they leave out is in none of them."
        )
    if residuals is not None and not residuals["adequate"]:
        recommendation = residuals.get("recommendation") or _take_as_they_are()
        yield f"{residuals['verdict']} {CONCERNED} {recommendation}"
    elif predictive is not None and predictive["failed"]:
        yield f"{sentence(typeset(predictive['status']))} {CONCERNED} {_take_as_they_are()}"
    if stale := of_other_data(saved.run):
        yield (
            f"The results of {list_words(stale)} rest on other data or settings than those of "
            f"{saved.run['last']}; run them again before comparing."
        )


def _notes(saved: Saved, bad: list[str]) -> list[str]:
    """Remarks, each said once, and none that is in an alert."""
    texts = list(saved.campaign.get("remarks", []))
    for part in (saved.fit, saved.posterior):
        texts += part.get("warnings", []) if part else []
    texts += _of_quoted_bound(saved)
    known = [_plain(text) for text in (*bad, *doubts(saved))]
    found: dict[str, list[tuple[str, str]]] = {}
    """whose it is and its words, by the words without numbers"""

    def add(who: str, words: str) -> None:
        rows = found.setdefault(re.sub(r"[\d.]+", "0", words), [])
        if (who, words) not in rows:
            rows.append((who, words))

    for text in texts:
        if not any(_plain(text) in told for told in known):
            match = _OF_EXPERIMENT.match(text)
            add(*((match[1], match[2]) if match else ("", text)))
    return _same_of_several([_together(rows) for rows in found.values()])


def _same_of_several(texts: list[str]) -> list[str]:
    """Sentences of which only the subject differs as one: "V is small", "t0 is small"."""
    found: dict[str, list[str]] = {}
    for text in texts:
        subject, _, rest = text.partition(" is ")
        short = len(subject) <= MOST_OF_SUBJECT and rest and ":" not in subject
        found.setdefault(f" is {rest}" if short else "", []).append(subject if short else text)
    single = found.pop("", [])
    made = []
    for rest, subjects in found.items():
        later = [f"the {s[4:]}" if s.startswith("The ") else s for s in subjects[1:]]
        verb = " is " if len(subjects) == 1 else " are "
        made.append(list_words([subjects[0], *later]) + verb + rest.removeprefix(" is "))
    return single + made


def _of_quoted_bound(saved: Saved) -> list[str]:
    """What is wrong with the bound in the headline; of all others the table of methods says it."""
    name = quoted(saved.bounds)
    if saved.posterior is not None or saved.bounds is None or name is None:
        return []
    status = saved.bounds["methods"][name].get("status", "ok")
    for doubt in doubts(saved):  # an alert says it once for all
        status = status.replace(doubt, "")
    status = status.strip("; ")
    return [] if status in ("", "ok") else [f"{method_words(saved.bounds, name).label}: {status}"]


_OF_EXPERIMENT = re.compile(r"[Ee]xperiment ('.*?')(?: \([^)]*\))?: (.*)", re.DOTALL)


def _plain(text: str) -> str:
    """A text for comparison, whatever symbols and capitals it has."""
    return typeset(text).strip().removesuffix(".").casefold()


def _numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"\d+(?:\.\d+)?", text)]


def _together(rows: list[tuple[str, str]]) -> str:
    """One sentence for all that share a remark."""
    whose = [who for who, _ in rows if who]
    first, words = rows[0]
    if " up to " in words:  # the worst of all
        first, words = max(rows, key=lambda row: _numbers(row[1]))
    if not whose:
        return sentence(typeset(words))
    label = list_words(whose)
    if label.startswith("'"):
        label = f"Experiment{'s' if len(whose) > 1 else ''} {label}"
    if len({text for _, text in rows}) > 1:  # alike, but for numbers
        words = f"{words.removesuffix('.')} (numbers of {first})"
    return sentence(f"{label}: {typeset(words)}")
