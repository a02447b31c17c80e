"""The tables of the gap."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_sensor.figures import effect_words
from bayes_sensor.figures.plot_gap import lag_of
from bayes_sensor.report.parts import Shown, Table, p_value
from bayes_sensor.report.words import list_words, ms, number, powers, scaled

MOST_CELLS = 40
FEW_CELLS = 8
MOST_EXPLANATIONS = 25
FEW_EXPLANATIONS = 8
NEGLIGIBLE = 0.0005
"""probability below which an explanation is only in gap.json, beyond the first few"""
ENDINGS = ("V", "s", "Hz")
"""units at the end of a name, which the value repeats"""
MEASURES = {"V": "amplitude", "s": "time", "Hz": "frequency"}
"""words for names that differ only in their ending"""
CLEAR = 0.05
"""p-value below which a difference is more than noise"""
LEAST_SHARE = 0.005
"""share of the excess from which a cell is listed"""
UNSEEN = 3.0
"""detectability below which an effect could hide"""


def budget_table(record: Mapping[str, Any], shown: str, factor: float) -> Table:
    """The budget and its remainder."""
    budget, shrink = record["budget"], record["shrink"]
    with_effect = {} if shrink.get("withheld") else shrink
    rival = with_effect.get("rival")
    of, lag = lag_of(record["hidden"])
    rows: dict[str, Any] = {
        f"RMS, nominal simulation ({shown})": scaled(budget.get("nominal_rms_V"), factor),
        f"RMS, calibrated ({shown})": scaled(budget["calibrated_rms_V"], factor),
        f"RMS, noise floor ({shown})": scaled(budget["noise_floor_rms_V"], factor),
        f"excess over the floor ({shown})": scaled(budget["excess_rms_V"], factor),
        "excess, d (standard deviations)": budget["excess_d"],
        "p-value": p_value(budget["p_value"]),
        "p-value of the size alone": p_value(budget.get("p_value_of_size")),
        "p-value of the largest listed course": p_value(budget.get("p_value_of_form")),
        f"excess with the effect ({shown})": scaled(with_effect.get("after_excess_rms_V"), factor),
        "fraction closed": shrink.get("fraction_closed"),
        "fraction closed, 95 % low": shrink.get("fraction_closed_lo"),
        "fraction closed, 95 % high": shrink.get("fraction_closed_hi"),
        "fraction closed, held out": shrink.get("held_out_fraction_closed"),
        "fraction closed, held out, 95 % low": shrink.get("held_out_fraction_closed_lo"),
        "fraction closed, held out, 95 % high": shrink.get("held_out_fraction_closed_hi"),
        f"{lag} without the effect (ms)": ms(shrink.get(f"{of}_before_s")),
        f"{lag} with the effect (ms)": ms(with_effect.get(f"{of}_after_s")),
        f"{lag} with the effect, 95 % low (ms)": ms(with_effect.get(f"{of}_after_lo_s")),
        f"{lag} with the effect, 95 % high (ms)": ms(with_effect.get(f"{of}_after_hi_s")),
        "best rival outside the family": effect_words(rival) if rival else None,
        "fraction that the rival closes": with_effect.get("rival_fraction_closed"),
    }
    return Table(
        "budget-table",
        "The budget in numbers. The excess is seen in averages over bins, where the noise is much "
        "smaller than in single samples: it is not the difference of the two RMS values. d "
        "contains all of it; the p-value compares it with noise alone.",
        ["quantity", "value"],
        [[name, value] for name, value in rows.items() if value is not None],
        digits=3,
    )


def where_table(record: Mapping[str, Any], shown: str, factor: float) -> Table:
    """The cells with an excess."""
    found = [
        row for row in record["where"]
        if (row["share"] or 0.0) >= LEAST_SHARE or (row["p_value"] or 1.0) < CLEAR
    ]  # fmt: skip
    rows = sorted(found, key=lambda row: -(row["share"] or 0.0))[:MOST_CELLS]
    caption = "Where the excess lies, the largest share first."
    if record.get("where_shared_by") == "explanations":
        caption += " Excess and share are what the explanations put there; p-values are measured."
    if not rows:  # nothing is shared out: the largest cells, as chance made them
        rows = sorted(record["where"], key=lambda row: -(row["excess_rms_V"] or 0.0))[:FEW_CELLS]
        caption = "No cell exceeds the noise floor by more than chance; the largest are shown."
    left_out = len(record["where"]) - len(rows)
    if left_out > 0:
        caption += f" {left_out} more cells, with less or nothing above the floor, are in gap.json."
    return Table(
        "where",
        caption,
        ["experiment", "phase", "from (s)", "to (s)", f"excess ({shown})", "share (%)", "p-value"],
        [
            [
                row["experiment"], row["phase"], row["t_start_s"], row["t_end_s"],
                scaled(row["excess_rms_V"], factor), scaled(row["share"], 100.0),
                p_value(row["p_value"]),
            ]
            for row in rows
        ],
        digits=3,
    )  # fmt: skip


def which_table(record: Mapping[str, Any]) -> Table:
    """The explanations, the likeliest first."""
    of, lag = lag_of(record["hidden"])
    units = record.get("strength_units", {})
    named = set(record["verdict"]["effects"])
    ranked = sorted(record["which"], key=lambda row: -row["probability"])
    worth = sum(row["probability"] >= NEGLIGIBLE for row in ranked)
    rows = ranked[: min(MOST_EXPLANATIONS, max(FEW_EXPLANATIONS, worth))]
    caption = "The explanations that were compared; their probabilities sum to one."
    if len(ranked) > len(rows):
        rest = sum(row["probability"] for row in ranked[len(rows) :])
        caption += f" {len(ranked) - len(rows)} more, {_together(rest)}, are in gap.json."
    return Table(
        "which",
        caption,
        [
            "effect", "family", "probability", "d", "strength", f"{lag} with it (ms)",
            "closed (%)", "confusable with",
        ],
        [
            [
                effect_words(row["effect"]), effect_words(row["family"] or ""),
                p_value(row["probability"]), row["d"], strength_words(row.get("strength"), units),
                ms(row[f"{of}_s"]), _percent(row["fraction_closed"]),
                list_words([effect_words(name) for name in row.get("confusable_with") or []], 5),
            ]
            for row in rows
        ],
        digits=3,
        marked=[i for i, row in enumerate(rows) if row["effect"] in named],
    )  # fmt: skip


def _together(probability: float) -> str:
    return f"of {probability:.2g} together" if probability >= 0.001 else "below 0.001 together"


def _percent(fraction: float | None) -> Shown | None:
    return None if fraction is None else Shown(100.0 * fraction, f"{100.0 * fraction:.0f}")


def strength_words(strength: Any, units: Mapping[str, str]) -> str:
    """Strengths and values in a row, with their units ("1" for none).

    >>> strength_words({"closing_ratio": 1.1, "mains_V": 0.01}, {"mains_V": "mV"})
    'closing ratio = 1.10, mains = 0.0100 mV'
    >>> strength_words({"mains_V": 0.01, "mains_Hz": 50.0}, {"mains_V": "V", "mains_Hz": "Hz"})
    'mains amplitude = 0.0100 V, mains frequency = 50.0 Hz'
    """
    if not isinstance(strength, Mapping):
        return ""
    parts = {name: name.rpartition("_") for name in strength}
    short = {
        name: label if label and last in ENDINGS else name
        for name, (label, _, last) in parts.items()
    }
    said = []
    for name, value in strength.items():
        own = units.get(name, "1")
        label = effect_words(short[name])
        if list(short.values()).count(short[name]) > 1 and short[name] != name:
            label += f" {MEASURES[parts[name][2]]}"
        said.append(f"{label} = {_value(value)}" + ("" if own == "1" else f" {own}"))
    return ", ".join(said)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):  # one value an experiment
        each = [v for v in value.values() if isinstance(v, int | float)]
        return f"{_one(min(each))} to {_one(max(each))}" if each else "–"
    return _one(value) if isinstance(value, int | float) else str(value)


def _one(value: float) -> str:
    return powers(value) if 0.0 < abs(value) < 1e-4 else number(value)


def hidden_table(record: Mapping[str, Any]) -> Table:
    """What may hide."""
    units = record.get("strength_units", {})
    of, lag = lag_of(record["hidden"])
    rows = sorted(record["hidden"]["effects"], key=lambda row: (row["d"] is None, row["d"]))
    return Table(
        "hidden",
        f"What may hide: detectability d after refitting, the error of {lag} when the effect is "
        f"there and left out, and {lag} in this campaign with it in the model, at plausible "
        "strength. "
        f"Below d = {UNSEEN:g} an effect could be there unseen, unless the data contradict it: "
        f"with it in the model no value of {lag} fits them. What is hidden so well may be stronger "
        f"than plausible: the last interval of {lag} leaves the strength to the data.",
        [
            "effect", "strength", "d", f"error of {lag} (ms)", f"{lag} with it (ms)", "95 % low",
            "95 % high", "could hide", "strength free: low", "strength free: high",
        ],
        [
            [
                effect_words(row["effect"]), strength_words(row.get("strength"), units), row["d"],
                *(ms(row.get(f"{of}_{of_it}_s")) for of_it in ("shift", "with_it", "low", "high")),
                _hides(row), ms(row.get(f"{of}_free_low_s")), ms(row.get(f"{of}_free_high_s")),
            ]
            for row in rows
        ],
        digits=3,
    )  # fmt: skip


def _hides(row: Mapping[str, Any]) -> str | None:
    if row.get("contradicted"):
        return "no: contradicted by the data"
    return None if row["d"] is None else "yes" if row["d"] < UNSEEN else "no"


def other_tables(record: Mapping[str, Any]) -> list[Table]:
    """Escalation, pairs that need another measurement, and tests at full rate."""
    units = record.get("strength_units", {})
    return [
        Table(
            "gap-rounds",
            "The diagnosis repeated with the named effects in the model.",
            ["in the model", "probability", "d left", "p left", "unlisted rest"],
            [
                [
                    ", ".join(effect_words(name) for name in row["added"]), row["probability"],
                    row["d_left"], p_value(row["p_left"]), bool(row["unlisted_left"]),
                ]
                for row in record.get("rounds") or []
            ],
            digits=3,
        ),
        Table(
            "gap-separate",
            "Pairs that this campaign cannot tell apart, and the measurement that would. "
            "Isolability: standard deviations between the two; three are needed.",
            ["effect", "rival", "isolability", "measurement", "isolability with it"],
            [
                [
                    effect_words(row["effect"]), effect_words(row["rival"]), row["isolability"],
                    row["addition"], row["isolability_with_it"],
                ]
                for row in record.get("separate") or []
            ],
            digits=3,
        ),
        Table(
            "gap-full-rate",
            "Tests on every sample, for what averaging would hide. A positive logarithm of the "
            "Bayes factor is evidence for it.",
            ["effect", "log Bayes factor", "probability", "strength", "experiment", "d"],
            [
                [
                    effect_words(row["name"]), row["log_bayes_factor"],
                    p_value(row["probability"]), strength_words(row.get("strength"), units),
                    row.get("experiment") or "", row["d"],
                ]
                for row in record.get("full_rate") or []
            ],
            digits=3,
        ),
    ]  # fmt: skip
