"""The blind check at full size: 600 cases quickly, 60 of them at the full setting as well.

Cases, truths and verdicts are made as ``bayes-sensor blind-check`` makes them, with the causes and
noise laws that no earlier run saw (``reserve``); campaigns are not kept.  Seals can be opened only
once: ``blind_check_first.csv`` (every case) and ``blind_check_first_goals.csv`` keep what was found
then, and are not written again until another seed is run; ``blind_check_first.json`` and the figure
of that name are the card of that table.  The other tables say what the code finds in the same
campaigns.  ``blind_check_runs.csv`` keeps what every run reached when its seals were opened, each
with a reserve, a seed and a diagnosis of its own; ``blind_check_over_runs.csv`` sums it up.
``blind_check_earlier.csv.gz`` has every case of the sealed runs before the last, as far back as
they were scored as now; ``blind_check_together.csv`` counts the goals over these and the last,
``blind_check_verdicts.csv`` how often each kind of verdict was right, and
``blind_check_thresholds.csv`` what another threshold of "unlisted" would gain and cost.
How likely one run is to meet all of its goals is another study, ``study_odds``.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from drawing import PAPER, TABLES, plt, save
from matplotlib.figure import Figure

from bayes_sensor.blind_check import (
    card_table,
    diagnose_cases,
    draw_cases,
    make_card,
    open_seals,
    read_rows,
    table,
)
from bayes_sensor.blind_check.card import GOALS_AT, SMALL
from bayes_sensor.blind_check.check import complete_truth, diagnose, trimmed
from bayes_sensor.blind_check.oracle import SEPARABLE_ABOVE
from bayes_sensor.blind_check.score import VISIBLE, score_case
from bayes_sensor.blind_check.simulator import CAUSES
from bayes_sensor.blind_check.statistics import calibration, proportion
from bayes_sensor.diagnosis import diagnose_gap
from bayes_sensor.figures import png, svg
from bayes_sensor.figures.plot_blind_check import opened_seal, score_card
from bayes_sensor.io.disk import write_text
from bayes_sensor.io.json_files import read_json, write_json
from bayes_sensor.io.readers import read_campaign

N, SEED = 600, 20261214
"""the seed was never used before the run that is reported"""
N_FULL = 60
SURE = 0.9
"""probability of looking unlisted from which a campaign counts for the shares given back"""
THRESHOLDS = (0.5, 0.45, 0.4, 0.35, 0.3, 0.25, 0.2)
"""probabilities of looking unlisted; verdicts take the first"""
ACROSS = {
    "flagged": "unlisted flagged at", "fairly": "the same, or rightly unnamed, at",
    "family": "right family at",
}  # fmt: skip
"""goals that a lower threshold moves, by the names of their columns"""
ALIKE = 3.5
"""standard deviations; what lies nearer to an effect is taken for it"""
LIMITS = {"study": 10.0, "full": 60.0}
"""s of one processor that a diagnosis may take at each setting"""
EARLIER = TABLES / "blind_check_earlier.csv.gz"
FIGURES = TABLES.parent / "figures"
IN_REPORTS = PAPER.parent / "bayes_sensor" / "templates" / "blind_check.json"
"""the goals of the day, which every report of a gap shows"""
README, PAGE = PAPER.parent / "README.md", PAPER.parent / "docs" / "blind_check.md"
OPENS, CLOSES = "<!-- blind check: study_blind_check.py -->\n", "<!-- end of blind check -->\n"


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write blind_check*.csv, blind_check*.json and both score cards."""
    place = folder / "blind-check"
    parts = place / "parts"
    draw_cases(
        place, parts, N, SEED, reserve=True, keep=False, jobs=jobs, scheduler=scheduler,
        progress=progress,
    )  # fmt: skip
    # what is compiled once on a machine is no part of the time that a diagnosis takes
    diagnose(read_campaign(PAPER.parent / "data" / "withheld" / "campaign.toml"), 1, (), "study")
    diagnose_cases(place, place, parts, "study", jobs=jobs, scheduler=scheduler, progress=progress)
    frame = write_card(place)
    both = compare_settings(place, frame, jobs, scheduler, progress)
    both.to_csv(TABLES / "blind_check_settings.csv", index=False, float_format="%.4g")
    write_alike(both)
    draw_settings(both)
    write_seconds(place, place / "full")
    write_first()
    write_pages()
    keep_figure(withheld(), "opened_seal")


def scored(place: Path) -> list[dict[str, Any]]:
    """One row a case of a folder whose seals may be opened."""
    return [score_case(truth, verdict) for truth, verdict in open_seals(place)]


def write_card(place: Path) -> pd.DataFrame:
    """Open the seals of a folder and write what they say; returns the table of cases."""
    frame = table(scored(place))
    frame.to_csv(TABLES / "blind_check_cases.csv", index=False, float_format="%.5g")
    # of what is kept: a cause may be 4 standard deviations large by its last digit alone
    card = make_card(read_rows(TABLES / "blind_check_cases.csv"))
    card_table(card).to_csv(TABLES / "blind_check.csv", index=False, float_format="%.4g")
    pd.DataFrame(card["goals"]).to_csv(
        TABLES / "blind_check_goals.csv", index=False, float_format="%.4g"
    )
    write_json(TABLES / "blind_check.json", card)
    keep_first(frame, pd.DataFrame(card["goals"]))
    write_look_alikes(frame)
    write_alarms(frame)
    keep_figure(score_card(card), "blind_check")
    return frame


def write_first() -> None:
    """Write the card of the day on which the seals were opened, from the table that it left.

    Intervals of the closed fraction held out are not in the table of every day, nor what is drawn
    of them; all else is.
    """
    card = make_card(read_rows(TABLES / "blind_check_first.csv"))
    write_json(TABLES / "blind_check_first.json", card)
    rules(card).to_csv(TABLES / "blind_check_rules.csv", index=False, float_format="%.4g")
    keep_figure(score_card(card), "blind_check_first")


def rules(card: Mapping[str, Any]) -> pd.DataFrame:
    """What the rules of the scoring let pass: shares as the goals count, and without the rule.

    An abstaining verdict is right where the oracle cannot separate: the goals take every one
    without a name for it, strictly only "none" is.  A listed effect that an unlisted cause comes
    near to is not charged as a wrong name; strictly it is.
    """
    pairs = [
        (f"right {word} at d = {row['d']:g}", row[f"{key}_or_abstained"], row[f"{key}_or_quiet"])
        for word, key in (("effect", "top"), ("family", "family"))
        for row in card["accuracy"]
        if row["d"] in GOALS_AT
    ]
    wrong = card["confident_wrong"]
    pairs += [
        (f"confident wrong name, {kind}", wrong[kind], wrong[f"{kind}_without_near"])
        for kind in ("listed", "unlisted")
    ]
    return pd.DataFrame([
        {"share": name, "n": loose["n"], "by_the_rule": loose["rate"], "strictly": strict["rate"],
         "lo95": strict["lo95"], "hi95": strict["hi95"]}
        for name, loose, strict in pairs
    ])  # fmt: skip


def write_seconds(*places: Path) -> None:
    """Write blind_check_seconds.csv from what every setting left in its folder.

    Verdicts from before the seconds were kept have none.
    """
    rows = []
    for place in places:
        if not (place / "seconds.json").is_file():
            continue
        found = read_json(place / "seconds.json")
        seconds, limit = pd.Series(found["seconds"], dtype=float), LIMITS[found["setting"]]
        rows.append({
            "setting": found["setting"], "cases": len(seconds), "median_s": seconds.median(),
            "q95_s": seconds.quantile(0.95), "largest_s": seconds.max(), "limit_s": limit,
            "above_limit": int((seconds > limit).sum()),
        })  # fmt: skip
    if rows:
        pd.DataFrame(rows).to_csv(
            TABLES / "blind_check_seconds.csv", index=False, float_format="%.4g"
        )


def write_alike(both: pd.DataFrame) -> None:
    """Write blind_check_alike.csv: in how many cases both settings say the same."""
    alike = proportion(both["same_verdict"])
    apart = (both["p_right_study"].astype(float) - both["p_right_full"].astype(float)).abs()
    row = {
        "cases": alike["n"], "alike": alike["k"], "lo95": alike["lo95"], "hi95": alike["hi95"],
        "median_change": apart.median(), "largest_change": apart.max(),
    }  # fmt: skip
    pd.DataFrame([row]).to_csv(TABLES / "blind_check_alike.csv", index=False, float_format="%.4g")


def keep_first(cases: pd.DataFrame, goals: pd.DataFrame) -> None:
    """Keep cases and goals of the day on which a seed's seals are opened, and of all runs."""
    path = TABLES / "blind_check_runs.csv"
    runs = pd.read_csv(path)
    if SEED not in set(runs["seed"]):
        put_away(int(runs["seed"].max()))
        cases.to_csv(TABLES / "blind_check_first.csv", index=False, float_format="%.5g")
        table_of_the_day = TABLES / "blind_check_first_goals.csv"
        goals.to_csv(table_of_the_day, index=False, float_format="%.4g")
        in_reports(len(cases), pd.read_csv(table_of_the_day))
        runs = pd.concat([runs, goals.assign(seed=SEED)])
        runs[["seed", *goals]].to_csv(path, index=False, float_format="%.4g")
    over_runs(runs).to_csv(TABLES / "blind_check_over_runs.csv", index=False, float_format="%.4g")
    write_together()


def put_away(seed: int) -> None:
    """Put the cases of the run before, of that ``seed``, to those of earlier ones, once."""
    others, last = (
        pd.read_csv(path, dtype=str, keep_default_na=False)
        for path in (EARLIER, TABLES / "blind_check_first.csv")
    )
    both = pd.concat([others[others["seed"] != str(seed)], last.assign(seed=str(seed))])
    # the time in a gzip header would make it another file every time
    both.to_csv(EARLIER, index=False, compression={"method": "gzip", "mtime": 0})


def write_together() -> None:
    """Write blind_check_together.csv: the goals over the cases of all sealed runs that are kept.

    And blind_check_verdicts.csv: how often each kind of verdict held, of the last and of all.
    """
    earlier, last = read_rows(EARLIER), read_rows(TABLES / "blind_check_first.csv")
    rows = [*earlier, *last]
    runs = len({row["seed"] for row in earlier}) + 1
    card = make_card(rows)
    pd.DataFrame(card["goals"]).assign(runs=runs, campaigns=len(rows)).to_csv(
        TABLES / "blind_check_together.csv", index=False, float_format="%.4g"
    )
    pd.DataFrame([
        {"verdict": kind, "runs": n, "said": found["said"], **found["right"]}
        for n, some in ((1, make_card(last)), (runs, card))
        for kind, found in some["calibration"]["by_verdict"].items()
    ]).to_csv(TABLES / "blind_check_verdicts.csv", index=False, float_format="%.4g")  # fmt: skip
    thresholds(rows).to_csv(TABLES / "blind_check_thresholds.csv", index=False, float_format="%.4g")


def thresholds(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """What would be flagged, and what lost, were "unlisted" stated from another probability on.

    A listed cause whose family is the likeliest, but that would be called unlisted instead, counts
    as right where the oracle cannot tell its family either, as the goals do.  ``nulls``: share of
    the faultless campaigns that would be called unlisted.  The first threshold is the diagnosis's
    own: what was stated stands, also where something else was likelier than unlisted after all.
    """
    found = []
    stated = THRESHOLDS[0]
    for threshold in THRESHOLDS:
        moved = []
        for row in rows:
            flagged = row["verdict"] == "unlisted"
            if threshold < stated and not flagged and row["looks_unlisted"] > threshold:
                vague = row["kind"] != "null" and row["isolability_family"] < SEPARABLE_ABOVE
                row = {**row, "verdict": "unlisted", "family_or_abstained": vague}
            moved.append(row)
        goals = {goal["goal"]: goal for goal in make_card(moved)["goals"]}
        nulls = [row for row in moved if row["kind"] == "null"]
        found.append({
            "threshold": threshold,
            **{
                f"{name}_{level:g}": goals[f"{goal} d = {level:g}"]["reached"]
                for level in GOALS_AT
                for name, goal in ACROSS.items()
            },
            "nulls": sum(row["verdict"] == "unlisted" for row in nulls) / len(nulls),
        })  # fmt: skip
    return pd.DataFrame(found)


def in_reports(campaigns: int, goals: pd.DataFrame) -> None:
    """Keep the goals with the package, as they stand in the table."""
    rows = json.loads(goals.to_json(orient="records", double_precision=15))
    write_json(IN_REPORTS, {"campaigns": campaigns, "seed": SEED, "goals": rows})


def over_runs(runs: pd.DataFrame) -> pd.DataFrame:
    """One row a goal: in how many sealed runs it was counted and met, and what they reached.

    The bound of the calibration error is another in every run.
    """
    rows = []
    last = runs[runs["seed"] == runs["seed"].max()]
    for goal in last["goal"]:
        some = runs[runs["goal"] == goal]
        wanted, reached = some["wanted"].unique(), some["reached"].astype(float)
        rows.append({
            "goal": goal, "wanted": wanted[0] if len(wanted) == 1 else "inside",
            "runs": len(some), "runs_met": int(some["met"].astype(bool).sum()),
            "lowest": reached.min(), "median": reached.median(), "highest": reached.max(),
        })  # fmt: skip
    return pd.DataFrame(rows)


def write_look_alikes(cases: pd.DataFrame) -> None:
    """Put this run's row into blind_check_look_alikes.csv, one for every run that was opened.

    The share of unlisted causes of d > 4 that would lie nearer than ``ALIKE`` to an effect of the
    catalogue at d = 8 and at 16: what ``MIMIC`` of the verdict rests on.
    """
    seen = cases[(cases["kind"] == "unlisted") & (cases["d"].astype(float) > 4.0)]
    away = seen["isolability"].astype(float) / seen["d"].astype(float)
    row = {"seed": SEED, "campaigns": len(away)}
    row |= {f"share_d{d}": float((away * d < ALIKE).mean()) for d in (8, 16)}
    path = TABLES / "blind_check_look_alikes.csv"
    others = pd.read_csv(path).query("seed != @SEED") if path.exists() else pd.DataFrame()
    both = pd.concat([others, pd.DataFrame([row])]).sort_values("seed")
    both.to_csv(path, index=False, float_format="%.4g")


def write_alarms(cases: pd.DataFrame) -> None:
    """Put this run's rows into blind_check_alarms.csv: what surely looked unlisted, and by what.

    How many of them have no unlisted cause is what ``MISTAKEN`` of the verdict rests on.  Runs
    from before the verdicts held it were diagnosed anew.
    """
    seen = cases[(cases["kind"] != "withheld") & (cases["looks_unlisted"].astype(float) > SURE)]
    by_mean = seen["unlisted_by_mean"].astype(float) > SURE
    rows = seen[["case", "kind", "causes", "law", "looks_unlisted"]].assign(
        seed=SEED, by=by_mean.map({True: "mean", False: "samples"})
    )
    path = TABLES / "blind_check_alarms.csv"
    others = pd.read_csv(path, keep_default_na=False).query("seed != @SEED")
    both = pd.concat([others, rows])[others.columns].sort_values(["seed", "case"])
    both.to_csv(path, index=False, float_format="%.3f")


def markdown_table(goals: pd.DataFrame, together: pd.DataFrame, over: pd.DataFrame) -> str:
    """Every goal beside what was reached that day and in all sealed runs, in Markdown.

    Intervals are Wilson's at 95 %.
    """
    runs, campaigns = together.loc[0, ["runs", "campaigns"]]
    lines = [
        f"| claim | goal | reached | met | last {runs} runs together, {campaigns} campaigns | met "
        "| met alone in |",
        "|---|---|---|---|---|---|---|",
    ]
    met_in = over.set_index("goal")
    for row, all_of_it in zip(goals.itertuples(), together.itertuples(), strict=True):
        counted = met_in.loc[row.goal]
        said = [row.goal, row.wanted, *_reached(row), *_reached(all_of_it, row.wanted)]
        lines.append(f"| {' | '.join(said)} | {counted['runs_met']} of {counted['runs']} runs |")
    return "\n".join(lines) + "\n"


def _reached(row: Any, wanted: str | None = None) -> tuple[str, str]:
    """What a goal's row reached with its interval, and whether that is met.

    Where the goal is another than what is ``wanted`` elsewhere, it stands with it.
    """
    between = "" if pd.isna(row.lo95) else f" ({row.lo95:.2g} to {row.hi95:.2g})"
    other = f" ({row.wanted})" if wanted is not None and row.wanted != wanted else ""
    # all digits of the table: a goal missed by little must not look as if it was met
    return f"{row.reached:.4g}{between}{other}", "yes" if row.met else "no"


def changed(cases: pd.DataFrame, first: pd.DataFrame) -> str:
    """One sentence: how many verdicts are not those of the day when the seals were opened."""
    both = cases.merge(first, on="case", suffixes=("", "_first"), validate="one_to_one")
    kinds = both["verdict"] != both["verdict_first"]
    names = ~kinds & (both["said"].map(_sorted) != both["said_first"].map(_sorted))
    if not kinds.any() and not names.any():
        return f"Run again, the code of that day gives the same {len(both)} verdicts."
    return (
        f"Of {len(both)} verdicts the code as it was last run gives {int(kinds.sum())} of another "
        f"kind and {int(names.sum())} with other names."
    )


def _sorted(said: str) -> str:
    return "+".join(sorted(said.split("+")))


def write_pages() -> None:
    """Put goals and card of the day into the README, and all that was counted into the docs."""
    goals, together, over, alike = (
        pd.read_csv(TABLES / f"blind_check_{name}.csv")
        for name in ("first_goals", "together", "over_runs", "alike")
    )
    cases = pd.read_csv(TABLES / "blind_check_cases.csv", keep_default_na=False)
    first = pd.read_csv(TABLES / "blind_check_first.csv", keep_default_na=False)
    card = read_json(TABLES / "blind_check.json")
    between_marks(README, [
        markdown_table(goals, together, over),
        "![The score card of the day on which the seals were opened]"
        "(paper/figures/blind_check_first.png)\n",
        *bullets([
            strictly(), excused(), by_verdict(), left_out(first), out_of_reach(first), odds(),
        ]),
    ])  # fmt: skip
    counted = [
        named_nulls(cases), alarmed_nulls(cases), left_out(cases), overlooked(cases),
        of_the_reserve(cases), out_of_reach(cases), too_sure(cases), but_for_one_law(cases),
        being_told(card["tau"]), hiding(card["envelope"]), weak_ones(card),
        where_it_acts(card["localisation"]), of_p_values(card["p_value"]), since_then(),
        at_both_settings(alike.iloc[0]), in_time(),
    ]  # fmt: skip
    between_marks(PAGE, [
        textwrap.fill(f"{changed(cases, first)} In these verdicts:", 112) + "\n",
        *bullets(counted),
    ])  # fmt: skip


def bullets(said: Sequence[str]) -> list[str]:
    """Lines of a Markdown list of what there is to say."""
    made = [
        textwrap.fill(words, 112, initial_indent="- ", subsequent_indent="  ")
        for words in said
        if words
    ]
    return [*made, ""]


def between_marks(path: Path, made: Sequence[str]) -> None:
    """Put lines between this study's marks in a text."""
    text = path.read_text(encoding="utf-8")
    begin, end = text.index(OPENS) + len(OPENS), text.index(CLOSES)
    write_text(path, text[:begin] + "\n".join(made) + text[end:])


def strictly() -> str:
    """One sentence: the right family where only a verdict of none abstains."""
    found = pd.read_csv(TABLES / "blind_check_rules.csv").set_index("share")
    goals = pd.read_csv(TABLES / "blind_check_first_goals.csv").set_index("goal")
    words = []
    for level in GOALS_AT:
        name = f"right family at d = {level:g}"
        share, bound = found.strictly[name], float(goals.wanted[name].split()[1])
        words.append(f"{share:.3f} at d = {level:g} ({'met' if share >= bound else 'not met'})")
    return (
        "Every sealed run had the diagnosis of its day, and causes and noise laws that none before "
        "had; together stand those since the oracle is the present one. The figure is of the same "
        "day as the table. The goals take every verdict without a name for "
        "abstaining; if only one of none is, which is how the figure counts, the right family is "
        f"found in {' and '.join(words)}."
    )


def excused() -> str:
    """One sentence: what is not charged as a wrong name because it comes near to the cause."""
    card = read_json(TABLES / "blind_check_first.json")["confident_wrong"]
    unlisted = [cause for cause in CAUSES.values() if not cause.listed]
    near = sum(bool(cause.near) for cause in unlisted)
    loose, strict = card["unlisted"], card["unlisted_without_near"]
    return (
        f"For {near} of the {len(unlisted)} unlisted causes of the simulator a listed effect that "
        f"they come near to is not charged as a wrong name: {loose['k']} of {loose['n']} were "
        f"given one with confidence, {strict['k']} if that is charged as well."
    )


def by_verdict() -> str:
    """One sentence: how often each kind of verdict held in all sealed runs that are kept."""
    found = pd.read_csv(TABLES / "blind_check_verdicts.csv")
    found = found[found["runs"] == found["runs"].max()].set_index("verdict")
    words = {
        "effect": "a named effect", "family": "a family", "none": "nothing to be seen",
        "unlisted by the mean": "something unlisted", "unlisted by samples": "the same by a line, "
        "an event or the like alone",
    }  # fmt: skip
    held = [
        f"{name} in {found.rate[kind]:.0%} of {found.n[kind]} verdicts ({found.said[kind]:.0%})"
        for kind, name in words.items()
        if kind in found.index
    ]
    text = f"Of the last {found.runs.iloc[0]} runs' verdicts held (in brackets: said on average): "
    return (text + ", ".join(held) + ".").replace("%", " %")


def hiding(envelope: Mapping[str, Any]) -> str:
    """One sentence: how often the envelope of tau holds the truth where the cause hides."""
    hidden, nulls, below = (envelope[key] for key in ("hidden", "null", "d_below_3"))
    stronger = envelope["drawn_stronger"]
    return (
        f"Hidden causes: strong ones that leave less than d = 3 can shift tau, and the envelope "
        f"that comes with the verdict holds the true tau in {hidden['k']} of {hidden['n']} "
        f"({hidden['lo95']:.2f} to {hidden['hi95']:.2f}"
        + (f"; {stronger} more drawn to hide turned out stronger" if stronger else "")
        + f"), on faultless campaigns in {nulls['k']} of {nulls['n']}, and over everything weaker "
        f"than d = 3 in {below['k']} of {below['n']}."
    )


def weak_ones(card: Mapping[str, Any]) -> str:
    """What the 95 % sets hold, and how far off the held-out fraction is."""
    sets, closed = card["set95"], card["closed_fraction"]
    small = sets["listed"][0]
    far = [
        f"{row['median_error_held_out']:.2f} at d = {row['d']:g}"
        for row in closed
        if row["median_error_held_out"] is not None
    ]
    return (
        f"The 95 % set holds the right explanation in {_share(sets['coverage'])}, a listed cause "
        f"in {_share(sets['by_kind']['listed']['coverage'])}, at d = {small['d']:g} in "
        f"{_share(small['coverage'])}. Held out, the closed fraction is off by {', '.join(far)} in "
        "median."
    )


def of_p_values(part: Mapping[str, Any]) -> str:
    """One sentence: how often the p-value of the gap is small, with and without a cause."""
    at = {row["d"]: row for row in part["seen"]}
    seen = ", ".join(f"{_share(at[d]['whole'])} at d = {d:g}" for d in (4.0, *GOALS_AT))
    by_size = ", ".join(_share(at[d]["size"]) for d in (4.0, *GOALS_AT))
    return (
        f"The p-value of the gap is below {SMALL:g} in {_share(part['null'])} faultless campaigns; "
        f"of those with a cause that bins show in {seen} (of the excess alone, without the courses "
        f"of listed effects: {by_size})."
    )


def where_it_acts(places: Mapping[str, Any]) -> str:
    """One sentence: how often and how rightly it is said where the model misses."""
    return (
        f"Where a cause acts was said in {places['n']} of {places['of']} campaigns with d >= "
        f"{VISIBLE:g}: {100 * places['share']:.0f} % of the misfit was put into the phases in "
        f"which it does (with the cause known {100 * places['share_oracle']:.0f} %), F1 of the "
        f"phases {places['f1']:.2f} (with the cause known {places['f1_oracle']:.2f})."
    )


def _share(part: Mapping[str, Any]) -> str:
    return f"{part['k']} of {part['n']}"


def at_both_settings(alike: pd.Series) -> str:
    """One sentence: how many verdicts the full setting shares with the quick one."""
    return (
        f"Of {alike['cases']:.0f} campaigns diagnosed at the full setting as well, "
        f"{alike['alike']:.0f} have the same verdict at both."
    )


def in_time() -> str:
    """One sentence: how long diagnoses took, where that was kept."""
    path = TABLES / "blind_check_seconds.csv"
    if not path.is_file():
        return ""
    words = [
        f"{row.median_s:.1f} s in median and {row.largest_s:.1f} s at most at the {row.setting} "
        f"setting ({row.above_limit} of {row.cases} above {row.limit_s:g} s)"
        for row in pd.read_csv(path).itertuples()
    ]
    return f"On one processor a diagnosis takes {', '.join(words)}."


def since_then() -> str:
    """One sentence: which goals the code and the oracle as last run put otherwise."""
    then, now = (
        pd.read_csv(TABLES / f"blind_check_{name}goals.csv").set_index("goal")
        for name in ("first_", "")
    )
    moved = now.index[(now["reached"] - then["reached"]).abs() >= 5e-3]
    words = [
        f"{goal} {now.reached[goal]:.3f} ({'met' if now.met[goal] else 'not met'})"
        for goal in moved
    ]
    if not words:
        return ""
    return (
        "By the code and the oracle as they are now, mended on campaigns of this very run, which "
        f"says nothing about others: {'; '.join(words)}."
    )


def named_nulls(cases: pd.DataFrame) -> str:
    """One sentence: under which laws of noise faultless campaigns were given a name."""
    nulls = cases[cases["kind"] == "null"]
    named = nulls[nulls["verdict"] == "effect"]
    counts = [
        f"{law} {len(named[named['law'] == law])} of {len(nulls[nulls['law'] == law])}"
        + f" ({', '.join(sorted(set(some['said'])))})"
        for law, some in named.groupby("law")
    ]
    if not counts:
        return f"Nulls named: none of {len(nulls)}, under {nulls['law'].nunique()} laws of noise."
    rest = nulls[~nulls["law"].isin(set(named["law"]))]
    return f"Nulls named, by law of noise: {'; '.join(counts)}; others 0 of {len(rest)}."


def alarmed_nulls(cases: pd.DataFrame) -> str:
    """One sentence: under which laws of noise faultless campaigns were called unlisted."""
    nulls = cases[cases["kind"] == "null"]
    called = nulls[nulls["verdict"] == "unlisted"]
    return f"Nulls called unlisted: {_counted(called, nulls, 'law')}."


def left_out(cases: pd.DataFrame) -> str:
    """One sentence: wrong names where the true effect had been taken out of the catalogue."""
    cases = cases[cases["kind"] == "withheld"]
    wrong = cases[cases["confident_wrong"].astype(str) == "True"]
    outside = wrong[wrong["wrong_outside_family"].astype(str) == "True"]
    were = "was" if len(wrong) == 1 else "were"
    return (
        f"Of {len(cases)} campaigns whose effect was taken out of the catalogue, {len(wrong)} "
        f"{were} given another name with more than .9, {len(outside)} of them from outside its "
        "family."
    )


def overlooked(cases: pd.DataFrame) -> str:
    """One sentence: which unlisted causes passed for noise although they were strong."""
    strong = cases[(cases["kind"] == "unlisted") & (cases["d_level"].astype(float) >= 8)]
    passed = strong[strong["verdict"] == "none"]
    return f"Unlisted causes of d >= 8 that passed for noise: {_counted(passed, strong, 'causes')}."


def of_the_reserve(cases: pd.DataFrame) -> str:
    """One sentence: how many unlisted causes were flagged, new ones and others, at the goals' d."""
    unlisted = cases[cases["kind"] == "unlisted"]
    unlisted = unlisted[unlisted["d_level"].astype(float).isin(GOALS_AT)]
    unseen = unlisted["causes"].isin([name for name, cause in CAUSES.items() if cause.reserve])
    if not unseen.any():
        return ""
    counts = [
        f"{int((some['verdict'] == 'unlisted').sum())} of {len(some)}"
        for some in (unlisted[unseen], unlisted[~unseen])
    ]
    return (
        f"Of the unlisted causes at d = 8 and 16 that no run had seen, {counts[0]} were flagged, "
        f"of those of earlier runs {counts[1]}."
    )


def _counted(some: pd.DataFrame, of: pd.DataFrame, by: str) -> str:
    counts = some[by].value_counts()
    names = sorted(counts.index, key=lambda name: (-counts[name], name))
    each = [f"{name} {counts[name]} of {(of[by] == name).sum()}" for name in names]
    return f"{len(some)} of {len(of)}" + (f" ({', '.join(each)})" if each else "")


def out_of_reach(cases: pd.DataFrame) -> str:
    """How many unlisted causes no method can flag: they look like an effect of the catalogue."""
    unlisted = cases[cases["kind"] == "unlisted"]
    words, reach = [], []
    for level in GOALS_AT:
        here = unlisted[unlisted["d_level"].astype(float) == level]
        apart = here[here["isolability"].astype(float) >= SEPARABLE_ABOVE]
        flagged = int((apart["verdict"] == "unlisted").sum())
        words.append(
            f"of {len(here)} unlisted causes at d = {level:g}, {len(here) - len(apart)} lie nearer "
            f"than {SEPARABLE_ABOVE:g} to an effect of the catalogue, and {flagged} of the other "
            f"{len(apart)} were flagged"
        )
        reach.append(f"{len(apart) / max(len(here), 1):.2f}")
    joined = "; ".join(words)
    return (
        f"{joined[0].upper()}{joined[1:]}. An oracle that flags just what it can tell apart would "
        f"reach {' and '.join(reach)}."
    )


def odds() -> str:
    """One sentence: how likely one run is to meet all goals, as ``study_odds`` last counted it."""
    table = pd.read_csv(TABLES / "blind_check_odds.csv").set_index(["diagnosis", "goal"])
    outright, by_the_rule = "all, unlisted ones outright", "all, unlisted ones by the rule"
    stands, best = (table.met_in[name] for name in ("as it stands", "as good as the oracle"))
    said = (
        "One run has some forty campaigns for a goal, too few to settle it. Runs drawn anew from "
        f"the campaigns of all of these meet every goal in {stands[outright]:.1%} of the draws, "
        f"with unlisted causes by the rule in {stands[by_the_rule]:.0%}. They would in "
        f"{best[outright]:.0%} and {best[by_the_rule]:.0%} were every verdict as good as the "
        "oracle's, every probability true and tau always as near as a fit comes that is told the "
        "cause."
    )
    return said.replace("%", " %")


def too_sure(cases: pd.DataFrame) -> str:
    """One sentence: how many of the surest verdicts are wrong."""
    p = pd.to_numeric(cases["p_said"])
    wrong = cases["verdict_right"].astype(str) == "False"
    unlisted = (cases["verdict"] == "unlisted") & (p > 0.8)
    others = (cases["verdict"] != "unlisted") & (p > 0.9)
    return (
        f"Of {unlisted.sum()} campaigns called unlisted with more than .8, "
        f"{(unlisted & wrong).sum()} had no unlisted cause; of {others.sum()} other verdicts with "
        f"more than .9, {(others & wrong).sum()} were wrong."
    )


def but_for_one_law(cases: pd.DataFrame) -> str:
    """One sentence: calibration and alarm without the law that raised the most false alarms.

    A cause outside the catalogue is flagged for the wrong reason where the noise alone would be.
    """
    alarmed = cases[(cases["kind"] == "null") & (cases["verdict"] == "unlisted")]
    if alarmed.empty:
        return ""
    law = alarmed["law"].value_counts().idxmax()
    left = cases[(cases["law"] != law) & (cases["kind"] != "hidden")]
    rest = [
        {"p": float(p), "right": str(right) == "True"}
        for p, right in left[["p_said", "verdict_right"]].to_numpy()
    ]
    found = calibration(rest, "p", "right")
    flagged = []
    for level in GOALS_AT:
        at = left[(left["kind"] == "unlisted") & (pd.to_numeric(left["d_level"]) == level)]
        flagged.append(f"{(at['verdict'] == 'unlisted').sum()} of {len(at)} at d = {level:.0f}")
    return (
        f"Without the {(cases['law'] == law).sum()} campaigns under {law} the calibration error is "
        f"{found['ece']:.3f}, where chance allows {found['band95']:.3f}, and the unlisted causes "
        f"flagged are {' and '.join(flagged)}."
    )


def being_told(tau: Mapping[str, Any]) -> str:
    """One sentence: the error of tau where the cause was seen and named, and if told the cause."""
    return (
        f"The error of ln tau falls from {tau['before']:.2f} to {tau['after']:.2f} where the cause "
        f"was seen and named ({tau['n']} campaigns); a fit that is told the cause has "
        f"{tau['told']:.2f}: the rest is noise."
    )


def keep_figure(figure: Figure, name: str) -> None:
    """Write figures/name.png and .svg in the report's style."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    write_text(FIGURES / f"{name}.svg", svg(figure))
    (FIGURES / f"{name}.png").write_bytes(png(figure))


def withheld() -> Figure:
    """Verdict and truth of the bundled campaign whose cause is sealed."""
    folder = PAPER.parent / "data" / "withheld"
    gap = diagnose_gap(read_campaign(folder / "campaign.toml")).to_json()
    truth = complete_truth(read_json(folder / "sealed.json"), "withheld")
    return opened_seal(gap, score_case(truth, trimmed(gap)))


def compare_settings(
    place: Path,
    frame: pd.DataFrame,
    jobs: int,
    scheduler: str | None,
    progress: Callable[[int, int], None],
) -> pd.DataFrame:
    """The first cases of the plan diagnosed at the full setting, beside what the quick one said."""
    few = place / "full"
    (few / "sealed").mkdir(parents=True, exist_ok=True)
    plan = json.loads((place / "plan.json").read_text())
    plan["cases"] = plan["cases"][:N_FULL]
    write_json(few / "plan.json", plan)
    names = [case["case"] for case in plan["cases"]]
    for name in names:
        write_text(few / "sealed" / f"{name}.json", (place / "sealed" / f"{name}.json").read_text())
    seals = read_json(place / "sealed.json")
    write_json(few / "sealed.json", {name: seals[name] for name in names})
    diagnose_cases(
        few, few, few / "parts", "full", jobs=jobs, scheduler=scheduler, progress=progress
    )
    rows = scored(few)
    keys = ["case", "verdict", "said", "p_said", "p_none", "p_unlisted", "p_right", "tau_after_s"]
    full = table(rows)[[*keys, "closed"]]
    quick = frame[frame["case"].isin(names)][[*keys, "kind", "d", "closed"]]
    both = quick.merge(full, on="case", suffixes=("_study", "_full"))
    alike = both["said_study"].map(_sorted) == both["said_full"].map(_sorted)
    both["same_verdict"] = alike & (both["verdict_study"] == both["verdict_full"])
    return both


def draw_settings(both: pd.DataFrame) -> None:
    """Probability of the right answer under both settings."""
    figure, axis = plt.subplots(figsize=(3.2, 3.0), layout="constrained")
    axis.plot([0, 1], [0, 1], color="0.6", lw=0.6)
    same = both["same_verdict"].to_numpy(dtype=bool)
    for which, marker, label in ((same, "o", "same verdict"), (~same, "s", "another verdict")):
        some = both[which]
        axis.plot(some["p_right_study"], some["p_right_full"], marker, label=label)
    axis.set_xlabel("P(right answer), study setting")
    axis.set_ylabel("full setting")
    axis.legend(loc="lower right")
    save(figure, "blind_check_settings")
