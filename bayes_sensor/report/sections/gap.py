"""Where the gap between model and measurement lies, what explains it, what may hide."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_sensor import figures
from bayes_sensor.report.parts import Part, Pictures, Section, Table, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import list_words, ms, number, p_equals, sentence

MOST_CELLS = 40
UNSEEN = 3.0
"""detectability below which an effect could hide"""


def gap(saved: Saved, pictures: Pictures) -> Section | None:
    """Budget, where, which, how far, and what may hide."""
    record = saved.gap
    if record is None:
        return None
    budget, verdict = record["budget"], record["verdict"]
    shown, factor = saved.small_unit
    answer = sentence(verdict["sentence"]).removesuffix(".") + see("which") + "."
    paragraphs = [
        f"Model and measurement differ by {number(factor * budget['excess_rms_V'])} {shown} RMS "
        f"above the noise floor of {number(factor * budget['noise_floor_rms_V'])} {shown} "
        f"(d = {number(budget['excess_d'])} standard deviations, p "
        f"{p_equals(budget['p_value'])}){see('budget-table', 'where')}."
    ]
    paragraphs += _shrink(record, shown, factor)
    paragraphs += _envelope(record)
    content: list[Part] = [
        pictures.add(
            "gap-budget",
            figures.gap_budget(record, saved.unit),
            "The budget: RMS residual of the nominal simulation (where nominal values are given), "
            "of the calibrated model and with the effect, down to the noise floor; right, only "
            "what exceeds that floor.",
        ),
        _budget_table(record, shown, factor),
        pictures.add(
            "gap-map",
            figures.gap_map(record["where"], saved.unit),
            "Where the gap lies: excess over the noise floor by experiment and phase of the step. "
            "Numbers: share of the whole; framed: p below 5 %.",
        ),
        _where_table(record, shown, factor),
        pictures.add(
            "gap-ranking",
            figures.gap_ranking(record["which"]),
            "What explains it: probabilities of the explanations and of their families. Hatched: "
            "no effect at all, and something that is not in the catalogue.",
        ),
        _which_table(record),
    ]
    if record["hidden"]["effects"]:
        tau = record["shrink"].get("tau_before_s")
        content += [
            pictures.add(
                "gap-hidden",
                figures.gap_hidden(record["hidden"], tau),
                "What may hide: how visible each effect would be at its plausible strength, and "
                "how far it would move τ. Left of the dashed line this campaign could not have "
                "seen it.",
            ),
            _hidden_table(record),
        ]
    return Section("gap", "Where is the gap, and what causes it", answer, paragraphs, content)


def _shrink(record: Mapping[str, Any], shown: str, factor: float) -> list[str]:
    shrink = record["shrink"]
    if shrink.get("withheld") or shrink.get("fraction_closed") is None:
        return [
            "The gap is too small, or nothing was named, so no fraction of it can be said to close."
        ]
    said = (
        f"Once the effect is in the model the excess falls from "
        f"{number(factor * shrink['before_excess_rms_V'])} to "
        f"{number(factor * shrink['after_excess_rms_V'])} {shown}: "
        f"{100 * shrink['fraction_closed']:.0f} % of the gap closes"
    )
    if shrink.get("fraction_closed_lo") is not None:
        said += (
            f" (95 % interval {100 * shrink['fraction_closed_lo']:.0f} to "
            f"{100 * shrink['fraction_closed_hi']:.0f} %)"
        )
    if shrink.get("held_out_fraction_closed") is not None:
        said += f", and {100 * shrink['held_out_fraction_closed']:.0f} % on data that were left out"
    said += see("budget-table") + "."
    before, after = shrink.get("tau_before_s"), shrink.get("tau_after_s")
    if before is not None and after is not None:
        said += (
            f" The least-squares τ moves from {number(1e3 * before)} to {number(1e3 * after)} ms."
        )
    return [said, "A large closed fraction alone proves no cause: a wrong effect often closes most "
            "of a gap. The ranking weighs the explanations against each other."]  # fmt: skip


def _envelope(record: Mapping[str, Any]) -> list[str]:
    hidden = record["hidden"]
    unseen = [row for row in hidden["effects"] if row["d"] is not None and row["d"] < UNSEEN]
    if not unseen:
        return []
    unseen.sort(key=lambda row: -abs(row["tau_shift_s"] or 0.0))
    names = list_words([_words(row["effect"]) for row in unseen], most=5)
    said = f"Present at plausible strength, {names} would leave no trace that these data could show"
    low, high = hidden.get("tau_envelope_s") or (None, None)
    if low is not None and high is not None:
        said += (
            f"; over all that may hide, τ lies between {number(ms(low))} and {number(ms(high))} ms"
        )
    return [said + see("hidden") + "."]


def _words(effect: str) -> str:
    return effect.replace("_", " ").replace("+", " + ")


def _budget_table(record: Mapping[str, Any], shown: str, factor: float) -> Table:
    budget, shrink = record["budget"], record["shrink"]

    def scaled(value: float | None) -> float | None:
        return None if value is None else factor * value

    rows: list[list[Any]] = [
        [f"RMS, nominal simulation ({shown})", scaled(budget.get("nominal_rms_V"))],
        [f"RMS, calibrated ({shown})", scaled(budget["calibrated_rms_V"])],
        [f"RMS, noise floor ({shown})", scaled(budget["noise_floor_rms_V"])],
        [f"excess over the floor ({shown})", scaled(budget["excess_rms_V"])],
        ["excess, d (standard deviations)", budget["excess_d"]],
        ["p-value", budget["p_value"]],
        [f"excess with the effect ({shown})", scaled(shrink.get("after_excess_rms_V"))],
        ["fraction closed", shrink.get("fraction_closed")],
        ["fraction closed, 95 % low", shrink.get("fraction_closed_lo")],
        ["fraction closed, 95 % high", shrink.get("fraction_closed_hi")],
        ["fraction closed, held out", shrink.get("held_out_fraction_closed")],
        ["τ without the effect (ms)", ms(shrink.get("tau_before_s"))],
        ["τ with the effect (ms)", ms(shrink.get("tau_after_s"))],
    ]
    return Table("budget-table", "The budget in numbers.", ["quantity", "value"], rows)


def _where_table(record: Mapping[str, Any], shown: str, factor: float) -> Table:
    found = [r for r in record["where"] if (r["share"] or 0.0) > 0 or (r["p_value"] or 1.0) < 0.05]
    rows = sorted(found, key=lambda row: -(row["share"] or 0.0))[:MOST_CELLS]
    caption = "Where the excess lies, the largest share first."
    left_out = len(record["where"]) - len(rows)
    if left_out > 0:
        caption += f" {left_out} more cells, with less or nothing above the floor, are in gap.json."
    return Table(
        "where",
        caption,
        ["experiment", "phase", "from (s)", "to (s)", f"excess ({shown})", "share", "p-value"],
        [
            [
                row["experiment"], row["phase"], row["t_start_s"], row["t_end_s"],
                None if row["excess_rms_V"] is None else factor * row["excess_rms_V"],
                row["share"], row["p_value"],
            ]
            for row in rows
        ],
        digits=3,
    )  # fmt: skip


def _which_table(record: Mapping[str, Any]) -> Table:
    named = set(record["verdict"]["effects"])
    rows = sorted(record["which"], key=lambda row: -row["probability"])
    return Table(
        "which",
        "The explanations that were compared; their probabilities sum to one.",
        [
            "effect", "family", "probability", "d", "strength", "τ with it (ms)",
            "fraction closed", "confusable with",
        ],
        [
            [
                _words(row["effect"]), _words(row["family"] or ""), row["probability"], row["d"],
                _strength(row.get("strength")), ms(row["tau_s"]), row["fraction_closed"],
                ", ".join(_words(name) for name in row.get("confusable_with") or []),
            ]
            for row in rows
        ],
        digits=3,
        marked=[i for i, row in enumerate(rows) if row["effect"] in named],
    )  # fmt: skip


def _strength(strength: Any) -> str:
    if not isinstance(strength, Mapping):
        return ""
    return ", ".join(
        f"{name} = {number(value) if isinstance(value, int | float) else value}"
        for name, value in strength.items()
    )


def _hidden_table(record: Mapping[str, Any]) -> Table:
    rows = sorted(record["hidden"]["effects"], key=lambda row: (row["d"] is None, row["d"]))
    return Table(
        "hidden",
        "What may hide: detectability d after refitting, and the shift of τ, at plausible "
        f"strength. Below d = {UNSEEN:g} an effect could be there unseen.",
        ["effect", "d", "shift of τ (ms)", "could hide"],
        [
            [
                _words(row["effect"]), row["d"], ms(row["tau_shift_s"]),
                None if row["d"] is None else bool(row["d"] < UNSEEN),
            ]
            for row in rows
        ],
        digits=3,
    )  # fmt: skip
