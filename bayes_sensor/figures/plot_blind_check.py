"""The score card of the blind check on one page; every bar and point with its 95 % interval."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from bayes_sensor.blind_check.card import GOALS_AT
from bayes_sensor.blind_check.statistics import proportion
from bayes_sensor.figures.plot_gap import effect_words
from bayes_sensor.figures.style import (
    BLUE,
    DATA,
    GREEN,
    INK,
    MARKERS,
    MIDDLE,
    MODEL,
    ORANGE,
    PALE,
    SMALLEST,
    new_figure,
    style,
)

Part = Mapping[str, Any]
FEW = 3
"""campaigns under which a law of noise without an alarm has no bar of its own"""
ALONE = {"bic_named": "all, by BIC", "whiteness_alarmed": "all, by whiteness"}
"""methods beside the diagnosis that tell a null from something"""
BESIDE = 0.7, 0.2
"""place in a panel that has a diagonal"""


def score_card(card: Part) -> Figure:
    """Ten panels from ``score.json``: is anything seen, named, flagged, calibrated, mended.

    What has no panel stands as sentences beside the last two.
    """
    with style():
        shown = _laws(card["nulls"]["by_law"])
        # a line of type for every bar
        top = 0.75 + 0.105 * max(len(shown) + len(ALONE), 16)
        heights = [top, 2.35, 2.05, 4.3]
        figure = new_figure(sum(heights))
        rows: Any = figure.subfigures(4, 1, height_ratios=heights)
        left, right = rows[0].subplots(1, 2)
        _nulls(left, card["nulls"]["all"], shown)
        _wrong(right, card["confident_wrong"])
        effect, family, unknown = rows[1].subplots(1, 3)
        _against_d(effect, card["accuracy"], "top", "right effect")
        _against_d(family, card["accuracy"], "family", "right family")
        _flagged(unknown, card["unlisted"])
        roc, stated, closed = rows[2].subplots(1, 3)
        _roc(roc, card["unlisted"])
        _reliability(stated, card["calibration"]["verdict"])
        _closed(closed, card["closed_fraction"])
        panels, text = rows[3].subfigures(1, 2, width_ratios=[1, 2])
        held, tau = panels.subplots(2, 1)
        words = text.subplots()
        _set95(held, card["set95"]["listed"])
        _tau(tau, card["tau"])
        _sentences(words, card)
    return figure


def _rate(part: Part) -> float:
    return np.nan if part["rate"] is None else float(part["rate"])


def _errors(parts: Sequence[Part]) -> np.ndarray:
    """(2, n) lengths of the error bars below and above the rates."""
    rates = np.array([_rate(part) for part in parts])
    low = np.array([part["lo95"] for part in parts], dtype=float)
    high = np.array([part["hi95"] for part in parts], dtype=float)
    lengths: np.ndarray = np.nan_to_num(np.maximum(np.stack([rates - low, high - rates]), 0.0))
    return lengths


def _bars(axes: Axes, names: Sequence[str], parts: Sequence[Part], colour: str) -> None:
    y = np.arange(len(names))
    axes.barh(y, [_rate(part) for part in parts], 0.6, color=colour, lw=0)
    axes.errorbar(
        [_rate(part) for part in parts], y, xerr=_errors(parts), fmt="none", ecolor=INK,
        elinewidth=0.8,
    )  # fmt: skip
    labels = [f"{name} ({part['n']})" for name, part in zip(names, parts, strict=True)]
    axes.set_yticks(y, labels)
    axes.tick_params(axis="y", labelsize=SMALLEST)
    axes.yaxis.grid(False)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(0.0, None)


def _laws(by_law: Mapping[str, Part]) -> dict[str, Part]:
    """The laws of noise that have a bar; those of a few campaigns without an alarm share one."""
    few = [law for law, part in by_law.items()
           if part["alarmed"]["n"] < FEW and not part["alarmed"]["k"]]  # fmt: skip
    if len(few) == 1:  # it would share its bar with none
        few = []
    shown = {
        law.replace("ar1_", "ar1 + ").replace("_", "-").replace("ar1", "AR(1)"): part
        for law, part in by_law.items()
        if law not in few
    }
    if few:
        n = sum(by_law[law]["alarmed"]["n"] for law in few)
        none = proportion([False] * n)
        shown[f"{len(few)} other laws"] = {"alarmed": none, "named": none}
    return shown


def _nulls(axes: Axes, every: Part, laws: Mapping[str, Part]) -> None:
    alone = [every[key] for key in ALONE]
    alarmed = [every["alarmed"], *alone, *(part["alarmed"] for part in laws.values())]
    _bars(axes, ["all", *ALONE.values(), *laws], alarmed, PALE)
    # the whiteness test names nothing
    named = {0: every["named"], 1: every["bic_named"]}
    named |= {1 + len(alone) + i: part["named"] for i, part in enumerate(laws.values())}
    axes.barh(list(named), [_rate(part) for part in named.values()], 0.6, color=MODEL, lw=0)
    axes.set_title("nothing wrong, by noise")
    axes.set_xlabel("share of false alarms\n(red: a cause is named)")


def _no_case(axes: Axes, words: str = "no case", at: tuple[float, float] = (0.5, 0.5)) -> None:
    """Say in an empty panel why it is so; ``at``: share of the panel's width and height."""
    axes.text(
        *at, words, transform=axes.transAxes, ha="center", va="center", color=MIDDLE,
        fontsize=SMALLEST,
    )  # fmt: skip


def _levels(axes: Axes, levels: Sequence[float], empty: bool) -> None:
    """``empty``: nothing is drawn that could tell the axis how far it goes."""
    axes.set_xscale("log")
    if empty:
        axes.set_xlim(levels[0] / 1.2, levels[-1] * 1.2)
        _no_case(axes, "no case of known d", (0.5, 0.6))
    axes.set_xticks(levels, [f"{level:g}" for level in levels])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlabel("size d of the misfit (sd)")
    _shares(axes)


def _shares(axes: Axes) -> None:
    axes.set_ylim(-0.03, 1.03)
    axes.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0", "0.25", "0.5", "0.75", "1"])


def _line(
    axes: Axes, levels: Sequence[float], parts: Sequence[Part], label: str, colour: str,
    marker: str, shift: float, bars: bool = True,
) -> None:  # fmt: skip
    x = np.array(levels) * 2.0**shift
    axes.errorbar(
        x, [_rate(part) for part in parts], yerr=_errors(parts) if bars else None, label=label,
        color=colour, marker=marker, ms=4, lw=1.2 if bars else 0.8, elinewidth=0.8,
        ls="-" if bars else "--",
    )  # fmt: skip


def _against_d(axes: Axes, table: Sequence[Part], what: str, title: str) -> None:
    """``what``: ``top`` or ``family``; the oracle must choose, as "no abstaining" does."""
    levels = [row["d"] for row in table]
    for key, label, colour, marker, shift in (
        ("_or_quiet", "this diagnosis", BLUE, MARKERS[0], 0.0),
        ("", "no abstaining", MIDDLE, MARKERS[4], 0.1),
        ("_bic", "BIC", ORANGE, MARKERS[2], 0.0),
        ("_rss", "RSS", GREEN, MARKERS[3], -0.1),
    ):
        parts = [row[what + key] for row in table]
        _line(axes, levels, parts, label, colour, marker, shift, bars=key == "_or_quiet")
    oracle = [np.nan if row[f"{what}_oracle"] is None else row[f"{what}_oracle"] for row in table]
    axes.plot(levels, oracle, "--", color=INK, marker=MARKERS[1], ms=4, lw=0.8, label="oracle")
    _legend(axes)
    _levels(axes, levels, not any(row[what]["n"] for row in table))
    axes.set_ylabel("share of campaigns")
    axes.set_title(title)


def _legend(axes: Axes) -> None:
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.45, -0.3), ncols=2, fontsize=SMALLEST,
        columnspacing=0.8, handlelength=1.6, handletextpad=0.4,
    )  # fmt: skip


def _wrong(axes: Axes, wrong: Part) -> None:
    words = {
        "listed": "cause in the catalogue", "pair": "two such causes",
        "unlisted": "cause not in it", "withheld": "cause taken out",
        "withheld_outside_family": "same, other family", "bic_listed": "BIC, in the catalogue",
        "bic_unlisted": "BIC, not in it", "bic_withheld": "BIC, taken out",
    }  # fmt: skip
    _bars(axes, list(words.values()), [wrong[key] for key in words], DATA)
    axes.set_title("wrong name")
    axes.set_xlabel("share given a wrong cause\n(probability above 0.9)")


def _flagged(axes: Axes, unlisted: Part) -> None:
    levels = [row["d"] for row in unlisted["flagged"]]
    empty = True
    for key, share, label, colour, marker, shift, bars in (
        ("flagged", "flagged", "never listed", BLUE, MARKERS[0], -0.06, True),
        ("withheld_flagged", "flagged", "taken out", ORANGE, MARKERS[1], 0.06, True),
        ("flagged", "within_reach", "oracle's reach", INK, MARKERS[2], 0.0, False),
    ):
        parts = [row[share] for row in unlisted[key]]
        known = [i for i, part in enumerate(parts) if part["n"]]
        empty = empty and not known
        _line(
            axes, [levels[i] for i in known], [parts[i] for i in known], label, colour, marker,
            shift, bars,
        )  # fmt: skip
    _levels(axes, levels, empty)
    axes.set_ylabel("share called unlisted")
    axes.set_title("unlisted cause")
    _legend(axes)


def _roc(axes: Axes, unlisted: Part) -> None:
    axes.plot([0, 1], [0, 1], color=MIDDLE, lw=0.7, ls=":")
    said = []
    for key, label, colour, style_ in (
        ("roc", "area", BLUE, "-"),
        ("roc_whiteness", "whiteness", ORANGE, "--"),
    ):
        roc = unlisted[key]
        if roc["area"] is None:
            continue
        axes.plot([0.0, *roc["false"], 1.0], [0.0, *roc["true"], 1.0], style_, color=colour, lw=1.2)
        said.append(f"{label} {roc['area']:.2f} ± {1.96 * roc['se']:.2f}")
    axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    _shares(axes)
    if not said:
        _no_case(axes, at=BESIDE)
    axes.set_xlabel("share of others flagged")
    axes.set_ylabel("share of unlisted flagged")
    axes.annotate(
        "\n".join(said), (0.99, 0.03), xycoords="axes fraction", ha="right", va="bottom",
        fontsize=SMALLEST,
    )  # fmt: skip
    axes.set_title("unlisted or not")


def _reliability(axes: Axes, calibration: Part) -> None:
    axes.plot([0, 1], [0, 1], color=MIDDLE, lw=0.7, ls=":")
    bins = calibration["bins"]
    parts = [entry["right"] for entry in bins]
    axes.errorbar(
        [entry["stated"] for entry in bins], [_rate(part) for part in parts],
        yerr=_errors(parts), fmt="o", ms=4, color=BLUE, elinewidth=0.8,
    )  # fmt: skip
    label = "stated probability"
    if calibration["ece"] is None:
        _no_case(axes, at=BESIDE)
    else:
        label += f"\nmean error {calibration['ece']:.4f}\n(by chance < {calibration['band95']:.4f})"
    axes.set_xlim(0, 1.02)
    axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    _shares(axes)
    axes.set_xlabel(label)
    axes.set_ylabel("share right")
    axes.set_title("verdicts")


def _closed(axes: Axes, table: Sequence[Part]) -> None:
    levels = [row["d"] for row in table]
    for key, label, colour, marker in (
        ("median_error", "error", BLUE, MARKERS[0]),
        ("median_error_held_out", "held out", ORANGE, MARKERS[1]),
    ):
        values = [np.nan if row[key] is None else row[key] for row in table]
        axes.plot(levels, values, color=colour, marker=marker, ms=4, label=label)
    for key, label, colour, marker, shift in (
        ("coverage", "interval holds", MIDDLE, MARKERS[2], 1.0),
        ("coverage_held_out", "held out, holds", GREEN, MARKERS[3], 1.05),
    ):
        parts = [row[key] for row in table if key in row]
        if not parts:  # verdicts that state no interval of what was held out
            continue
        axes.errorbar(
            [shift * level for level in levels], [_rate(part) for part in parts],
            yerr=_errors(parts), color=colour, marker=marker, ms=4, lw=0.8, elinewidth=0.8,
            ls="--", label=label,
        )  # fmt: skip
    _levels(axes, levels, not any(row["n"] for row in table))
    axes.set_ylabel("error, or share")
    axes.set_title("how much closes")
    _legend(axes)


def _set95(axes: Axes, table: Sequence[Part]) -> None:
    levels = [row["d"] for row in table]
    _line(axes, levels, [row["coverage"] for row in table], "", BLUE, MARKERS[0], 0.0)
    axes.axhline(0.95, color=MIDDLE, lw=0.7, ls=":")
    _levels(axes, levels, not any(row["coverage"]["n"] for row in table))
    axes.set_ylabel("share that hold it")
    axes.set_title("95 % set, listed causes")


def _tau(axes: Axes, tau: Part) -> None:
    values = [np.nan if tau[key] is None else tau[key] for key in ("before", "after")]
    axes.bar([0, 1], values, 0.6, color=[PALE, DATA], edgecolor=INK, lw=0.6)
    axes.set_xticks([0, 1], ["without", "with"])
    if tau["before"] is None:
        axes.set_xlim(-0.5, 1.5)
        axes.set_ylim(0.0, 1.0)
        axes.set_yticks([])
        _no_case(axes)
    axes.xaxis.grid(False)
    axes.set_xlabel("the cause in the model")
    axes.set_ylabel("mean error of ln τ")
    axes.set_title("is τ mended")


def in_words(card: Part) -> list[str]:
    """What the card says of tau, places, hidden causes, closed fractions, sets and scores."""
    said = [_of_tau(card["tau"]), _of_places(card["localisation"]), *_of_hidden(card["envelope"])]
    said += [_of_closing(card["closed_fraction"]), _of_sets(card["set95"])]
    said += [_of_scores(card["scores"]), _of_rules(card)]
    return [words for words in said if words]


def _between(part: Part, key: str, digits: int = 2) -> str:
    """A value with its interval, if it has one."""
    words = f"{part[key]:.{digits}f}"
    if part[f"{key}_lo95"] is not None:
        words += f" ({part[f'{key}_lo95']:.{digits}f} to {part[f'{key}_hi95']:.{digits}f})"
    return words


def _k_of_n(part: Part) -> str:
    return f"{part['k']} of {part['n']}"


def _of_tau(tau: Part) -> str:
    if tau["before"] is None or tau["after"] is None:
        return ""
    words = (
        f"τ: in the {tau['n']} campaigns in which the cause was named, the estimate of τ is "
        f"wrong by a factor of {np.exp(tau['before']):.2f} on average before the cause is in "
        f"the model, and of {np.exp(tau['after']):.2f} after"
    )
    if tau["ratio_lo95"] is not None:
        words += (
            f". The error of ln τ falls to {100 * tau['ratio']:.0f} % (95 % interval "
            f"{100 * tau['ratio_lo95']:.0f} to {100 * tau['ratio_hi95']:.0f} %)"
        )
    if tau["ratio_told"] is not None:
        words += f"; where the fit is told the cause, to {100 * tau['ratio_told']:.0f} %"
    return words + "."


def _of_places(places: Part) -> str:
    if places["share"] is None:
        return ""
    by_shares = places.get("f1_oracle") is not None  # cards of earlier runs count flags of phases
    stated = f", stated in {places['n']} of {places['of']} campaigns" if by_shares else ""
    words = (
        f"Where{stated}: {100 * places['share']:.0f} % of the misfit that is found lies on average "
        "in the phases in which the cause acts"
    )
    if places["share_oracle"] is not None:
        words += f" (with the cause known {100 * places['share_oracle']:.0f} %)"
    words += ". Phases that hold nearly all of it" if by_shares else ". As flags of phases"
    if places["precision"] is not None:
        words += f": precision {places['precision']:.2f}, recall {places['recall']:.2f},"
    words += f" F1 {_between(places, 'f1')}"
    return words + (f", with the cause known {places['f1_oracle']:.2f}." if by_shares else ".")


def _of_hidden(envelope: Part) -> list[str]:
    hidden, nulls = envelope["hidden"], envelope["null"]
    said = []
    if hidden["n"]:
        words = (
            f"What hides: with a strong cause that leaves next to nothing (d < 3) the true τ lies "
            f"within the range that the diagnosis gives for it in {_k_of_n(hidden)} campaigns "
            f"(95 % interval {100 * hidden['lo95']:.0f} to {100 * hidden['hi95']:.0f} %)"
        )
        if envelope["drawn_stronger"]:
            words += f"; drawn to hide, but too strong: {envelope['drawn_stronger']} more"
        said.append(words + ".")
    if nulls["n"]:
        where = f"With nothing wrong it does in {_k_of_n(nulls)}."
        if not said:
            where = (
                "With nothing wrong the true τ lies within the range that the diagnosis gives for "
                f"it in {_k_of_n(nulls)} campaigns."
            )
        said.append(where)
    return [" ".join(said)] if said else []


def _of_closing(table: Sequence[Part]) -> str:
    known = [row for row in table if row["median_error_held_out"] is not None]
    if not known:
        return ""
    each = [f"{_between(row, 'median_error_held_out')} at d = {row['d']:g}" for row in known]
    return f"How far, held out: the closed fraction is off by, in median, {', '.join(each)}."


def _of_sets(sets: Part) -> str:
    if sets["mean_size"] is None:
        return ""
    listed = sets["by_kind"].get("listed")
    words = (
        f"The 95 % set, of {_between(sets, 'mean_size', 1)} explanations on average, holds the "
        f"right one in {_k_of_n(sets['coverage'])} campaigns"
    )
    if listed and listed["coverage"]["n"]:
        words += f", of listed causes in {_k_of_n(listed['coverage'])}"
        small = [row for row in sets["listed"][:2] if row["coverage"]["n"]]
        words += "".join(f", at d = {row['d']:g} in {_k_of_n(row['coverage'])}" for row in small)
    return words + "."


def _of_scores(scores: Part) -> str:
    if scores["all"]["brier"] is None:
        return ""
    return (
        f"Probabilities: Brier score {_between(scores['all'], 'brier')}, log score "
        f"{_between(scores['all'], 'log_score')} nat, hidden causes apart."
    )


def _of_rules(card: Part) -> str:
    """How the goals count the right family, beside the figure's count."""
    at = [row for row in card["accuracy"] if row["d"] in GOALS_AT and row["family"]["n"]]
    each = [
        f"{row['family_or_quiet']['rate']:.3f} instead of {row['family_or_abstained']['rate']:.3f} "
        f"at d = {row['d']:g}"
        for row in at
    ]
    if not each:
        return ""
    return (
        "Abstaining: only a verdict of none does here, the goals count every one without a name: "
        f"right family {', '.join(each)}."
    )


def _sentences(axes: Axes, card: Part) -> None:
    axes.set_axis_off()
    # no line may begin with a sign of percent, or end within "d = 8"
    said = (
        words.replace(" %", "\u00a0%")
        .replace("d = ", "d\u00a0=\u00a0")
        .replace("d < ", "d\u00a0<\u00a0")
        for words in in_words(card)
    )
    text = "\n\n".join(textwrap.fill(words, 70) for words in said)
    axes.text(0.02, 1.0, text, transform=axes.transAxes, va="top", fontsize=7.5)


def opened_seal(gap: Part, row: Part) -> Figure:
    """What a diagnosis said of a withheld campaign, and what was true.

    ``gap``: gap.json; ``row``: the case's row of ``cases.csv``.
    """
    right = set(str(row["listed_as"]).replace("+", "|").split("|"))
    with style():
        figure = new_figure(2.9)
        left, middle, far = figure.subplots(1, 3, width_ratios=(1.5, 0.8, 0.8))
        best = sorted(gap["which"], key=lambda entry: -(entry["probability"] or 0.0))[:7]
        y = np.arange(len(best))
        colours = [GREEN if set(e["effect"].split("+")) & right else DATA for e in best]
        left.barh(y, [entry["probability"] for entry in best], 0.65, color=colours, lw=0)
        left.set_yticks(y, [effect_words(entry["effect"]) for entry in best])
        left.tick_params(axis="y", labelsize=SMALLEST)
        left.yaxis.grid(False)
        left.invert_yaxis()
        left.set_xlim(0, 1.02)
        left.set_xlabel("probability")
        left.set_title("cause (green: the truth)")
        closed, oracle = row["closed"], row["closed_oracle"]
        if closed is not None:
            error = np.abs(np.array([[closed - row["closed_lo"]], [row["closed_hi"] - closed]]))
            middle.errorbar([0], [closed], yerr=error, fmt=MARKERS[0], color=BLUE, elinewidth=0.9)
        if oracle is not None:
            middle.axhline(oracle, color=GREEN, lw=1.2, ls="--")
        middle.set_ylim(0, 1.15)
        middle.set_xticks([0], ["gap closed"])
        middle.set_xlim(-0.6, 0.6)
        middle.set_ylabel("share, 95 % interval")
        middle.set_title("how far")
        shrink = gap["shrink"]
        values = [1e3 * shrink[key] for key in ("tau_before_s", "tau_after_s")]
        far.plot([0], values[:1], MARKERS[1], color=MIDDLE)
        low, high = shrink.get("tau_after_lo_s"), shrink.get("tau_after_hi_s")
        bar = None if low is None or high is None else [[values[1] - 1e3 * low],
                                                        [1e3 * high - values[1]]]  # fmt: skip
        far.errorbar([1], values[1:], yerr=bar, fmt=MARKERS[0], color=BLUE, elinewidth=0.9)
        if row["tau_true_s"] is not None:
            far.axhline(1e3 * row["tau_true_s"], color=GREEN, lw=1.2, ls="--")
        far.set_xticks([0, 1], ["without", "with"])
        far.set_xlim(-0.6, 1.6)
        far.set_ylabel("τ (ms), 95 % interval")
        far.set_title("τ")
    return figure
