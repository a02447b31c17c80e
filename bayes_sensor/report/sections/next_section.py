"""What to measure next."""

from __future__ import annotations

from functools import partial

from bayes_sensor import figures
from bayes_sensor.report.parts import Part, Picture, Section, Table, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import ms, number, typeset


def measure_next(saved: Saved) -> Section | None:
    """The interval of tau with additional knowledge or other experiments."""
    rows = (saved.bounds or {}).get("what_would_help")
    if not rows:
        return None
    rows = [{**row, "change": typeset(row["change"])} for row in rows]
    now, others = rows[0], [row for row in rows[1:] if row.get("gain") is not None]
    answer = ""
    if others:
        best = max(others, key=lambda row: row["gain"])
        answer = (
            f"Of the changes looked at, {best['change']} narrows the interval of τ most: from "
            f"± {number(ms(now['half_width95_s']), 2)} ms to ± "
            f"{number(ms(best['half_width95_s']), 2)} ms (95 %){see('what-would-help')}."
        )
    paragraphs = [
        "These are predictions of the bound under the fitted noise law, at the τ of this "
        "campaign. bayes-sensor design proposes experiments that reach a wanted interval."
    ]
    names = ("lo68_s", "hi68_s", "lo95_s", "hi95_s", "half_width95_s")
    content: list[Part] = [
        Picture(
            "what-would-help-figure",
            partial(figures.what_would_help, rows),
            "Predicted 95 % intervals of τ if one condition were changed.",
        ),
        Table(
            "what-would-help",
            "Predicted interval of τ (ms) if one condition were changed; the gain is the "
            "factor by which the 95 % interval becomes narrower.",
            ["change", "68 % low", "68 % high", "95 % low", "95 % high", "half width 95 %", "gain"],
            [
                [row["change"], *(ms(row.get(name)) for name in names), row.get("gain")]
                for row in rows
            ],
            digits=3,
            marked=[0],
        ),
    ]
    return Section("next", "What to measure next", answer, paragraphs, content)
