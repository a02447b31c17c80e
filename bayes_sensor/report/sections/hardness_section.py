"""Why the time constant is hard to measure."""

from __future__ import annotations

from functools import partial

from bayes_sensor import figures
from bayes_sensor.report.parts import Part, Picture, Section, Table, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import ms, number, sentence, typeset

KNOWN_WORDS = {
    "nothing": "nothing",
    "t0": "every start of the step",
    "tf": "every end of the step",
    "t0, tf": "every switch time",
    "V": "the volume",
    "tau_v": "the valve's time constant",
    "V, tau_v": "the volume and the valve's time constant",
    "t0, tf, V, tau_v": "all of these",
}
MOST_ROWS = 12
ALIKE = 0.95
"""multiple correlation with the switch times above which both look almost the same"""


def hardness(saved: Saved) -> Section | None:
    """Collinearity with the switch times, and the bound if they were known."""
    record = (saved.bounds or {}).get("what_makes_tau_hard")
    if not record:
        reason = (saved.bounds or {}).get("not_explained")
        return reason and Section("hardness", "What makes it hard", sentence(typeset(reason)))
    known = record["sd_tau_if_known_s"]
    now, timed = known.get("nothing"), known.get("t0, tf") or known.get("t0")
    switches = record["collinearity"]["switches"]
    answer = (
        "A slower sensor and a later switch change the response in almost the same way"
        if switches > ALIKE
        else f"Moving the switch times imitates {100 * switches**2:.0f} % of what τ does to the "
        "trace"
    ) + f"{see('tau-hard', 'weakest')}."
    if now and timed:
        answer += (
            f" At τ = {number(1e3 * record['tau_s'])} ms one standard deviation of τ is "
            f"{number(1e3 * now)} ms; it would be {number(1e3 * timed)} ms if the switch times "
            f"were known{see('known-table')}."
        )
    paragraphs = [sentence(typeset(text)) for text in record["sentences"]]
    if now and timed:
        paragraphs.append(
            "These are bounds at one value of τ, which show what limits the measurement; quote "
            f"the posterior's interval{see('posterior-shared')}."
        )
    if record.get("status", "ok") != "ok":
        paragraphs.append(sentence(record["status"]))
    weakest = sorted(record["weakest"].items(), key=lambda item: -abs(item[1]))
    content: list[Part] = [
        Picture(
            "tau-hard",
            partial(figures.tau_hard, record),
            "Why τ is hard: the drop of the likelihood against τ, and that of a Gaussian with the "
            "same sd; the bound against the true τ; the bound if something else were known; and "
            "the direction with the least information.",
        ),
        Table(
            "known-table",
            "The bound on τ (one standard deviation) if other quantities were known beforehand.",
            ["known beforehand", "sd of τ (ms)", "times the present one"],
            [
                [KNOWN_WORDS.get(name, name), ms(sd), sd / now if sd is not None and now else None]
                for name, sd in known.items()
            ],
            digits=3,
        ),
        Table(
            "weakest",
            "The direction with the least information, in parameters scaled to equal information, "
            "and the correlation of each with τ; the strongest entries.",
            ["parameter", "entry", "correlation with τ"],
            [
                [figures.parameter_words(name)[0], entry, record["correlation_with_tau"].get(name)]
                for name, entry in weakest[:MOST_ROWS]
            ],
            digits=3,
        ),
    ]
    return Section("hardness", "What makes it hard", answer, paragraphs, content)
