"""The blind check at full size, with the causes and noise laws that are held in reserve.

Cases, truths and verdicts are made as ``bayes-sensor blind-check`` makes them; campaigns are not
kept.  ``blind_check_runs.csv`` has one row for each run, ``blind_check_together.csv`` their sums.
The first 24 rows were made by earlier code, with another simulator and causes of other sizes.
``blind_check_last.csv`` has the results of the last run, on the published rig and on others; its
goals stand in ``blind_check_goals.csv`` and in every report of a gap.  The score card
``figures/blind_check.svg`` is that of ten of the earlier runs.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import PAPER, TABLES
from matplotlib.figure import Figure

from bayes_sensor import __version__
from bayes_sensor.blind_check import (
    diagnose_cases,
    draw_cases,
    make_card,
    open_seals,
    wilson,
)
from bayes_sensor.blind_check.diagnosing import trimmed
from bayes_sensor.blind_check.score import SEPARABLE_ABOVE, level_of, score_case
from bayes_sensor.blind_check.simulator import OTHER_RIGS
from bayes_sensor.blind_check.truth import complete_truth
from bayes_sensor.diagnosis import diagnose_gap
from bayes_sensor.figures import png, svg
from bayes_sensor.figures.plot_blind_check import opened_seal
from bayes_sensor.io.disk import write_text
from bayes_sensor.io.json_files import read_json, write_json
from bayes_sensor.io.readers import read_campaign

N, SEED, SIZE = 120, 20261128, "small"
"""as many as there was time for, by the seconds of other cases; the seed was never used before"""
OF_EARLIER_RUNS, GOALS_AT = (8, 16), (10, 30)
"""detectabilities that causes were dealt with, and goals set for"""
LOCAL = 0.8
"""share of a cause's difference in one phase, from which it is local to that phase"""
RIGS = ("all", "published", "other")
IN_REPORTS = PAPER.parent / "bayes_sensor" / "templates" / "blind_check.json"
WITHHELD = PAPER.parent / "data" / "withheld"
Pair = tuple[Mapping[str, Any], Mapping[str, Any]]
"""truth and verdict"""


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write the tables and what reports show of it."""
    place = folder / "blind-check"
    parts = place / "parts"
    draw_cases(
        place, parts, N, SEED, reserve=True, size=SIZE, keep=False, jobs=jobs, scheduler=scheduler,
        progress=progress,
    )  # fmt: skip
    diagnose_cases(place, place, parts, "study", jobs=jobs, scheduler=scheduler, progress=progress)
    write_tables(place)
    keep_figure(withheld(), "opened_seal")


def write_tables(place: Path, note: str = "") -> None:
    """Write what the tables say of a finished run in the folder ``place``."""
    write_seconds(place)
    pairs = open_seals(place)
    rows = [score_case(truth, verdict) for truth, verdict in pairs]
    plan = read_json(place / "plan.json")
    found = last_run(pairs)
    found.to_csv(TABLES / "blind_check_last.csv", index=False, float_format="%.4g")
    goals = reached(found)
    pd.DataFrame(goals).to_csv(TABLES / "blind_check_goals.csv", index=False, float_format="%.4g")
    write_json(IN_REPORTS, {"campaigns": len(rows), "seed": plan["seed"], "goals": goals})
    path = TABLES / "blind_check_runs.csv"
    runs = pd.read_csv(path, dtype=str, keep_default_na=False)
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    this = {"run": len(runs) + 1, "date": today, "code": __version__, **counted(rows), "note": note}
    this = {name: str(value) for name, value in this.items()}
    runs = pd.concat([runs, pd.DataFrame([this])], ignore_index=True).fillna("")
    runs = runs[[name for name in runs if name != "note"] + ["note"]]
    runs.to_csv(path, index=False)
    together(runs).to_csv(TABLES / "blind_check_together.csv", index=False, float_format="%.4g")


# --------------------------------------------------------------------------- the last run


def last_run(pairs: Sequence[Pair]) -> pd.DataFrame:
    """What was found of the last run, on each of :data:`RIGS`: a row a goal."""
    of: dict[str, list[Pair]] = {
        "all": list(pairs),
        "published": [p for p in pairs if p[0]["size"] not in OTHER_RIGS],
        "other": [p for p in pairs if p[0]["size"] in OTHER_RIGS],
    }
    return pd.DataFrame([row for rig in RIGS for row in _of_rigs(rig, of[rig])])


def _of_rigs(rig: str, pairs: Sequence[Pair]) -> list[dict[str, Any]]:
    rows = [score_case(truth, verdict) for truth, verdict in pairs]
    card = make_card(rows)

    def share(what: str, goal: str, values: Sequence[Any]) -> dict[str, Any]:
        k, n = sum(bool(v) for v in values), len(values)
        low, high = wilson(k, n)
        return {"what": what, "goal": goal, "rig": rig, "count": k, "of": n,
                "value": k / n if n else None, "lo95": low, "hi95": high}  # fmt: skip

    def number(what: str, goal: str, value: Any, n: int, low: Any, high: Any) -> dict[str, Any]:
        return {"what": what, "goal": goal, "rig": rig, "count": None, "of": n, "value": value,
                "lo95": low, "hi95": high}  # fmt: skip

    def of(kind: str) -> list[dict[str, Any]]:
        return [row for row in rows if row["kind"] == kind]

    found = [
        share("null hypotheses named", "<= 0.005", [r["named"] for r in of("null")]),
    ]
    for words, kind, goal in (
        ("listed causes", "listed", "<= 0.02"),
        ("unlisted causes", "unlisted", "<= 0.05"),
        ("listed causes taken out", "withheld", ""),
    ):
        wrong = [r["confident_wrong"] for r in of(kind)]
        found.append(share(f"wrong names, {words}", goal, wrong))
    for d, least in zip(GOALS_AT, ("0.9", "0.95"), strict=True):
        at = [r for r in of("listed") if r["d_level"] == level_of(d)]
        first = [r["top_right"] for r in at]
        found.append(share(f"right effect first at d = {d}", f">= {least}", first))
    for d in GOALS_AT:
        at = [r for r in of("unlisted") if r["d_level"] == level_of(d)]
        flagged = [r["verdict"] == "unlisted" for r in at]
        found.append(share(f"unlisted causes found at d = {d}", "", flagged))
    stated = card["calibration"]["verdict"]
    band = None if stated["band95"] is None else f"<= {stated['band95']:.3g}"
    found.append(
        number(
            "calibration error of the verdict", band or "", stated["ece"], stated["n"], None, None
        )
    )
    at = [p for p in pairs if level_of(p[0]["d"]) == level_of(GOALS_AT[1])]
    located = [right for right in map(phase_found, at) if right is not None]
    found.append(share(f"right phase at d = {GOALS_AT[1]}", ">= 0.95", located))
    tau = card["tau"]
    found.append(
        number("error of ln tau, after over before", "<= 0.5", tau["ratio"], tau["n"],
               tau["ratio_lo95"], tau["ratio_hi95"])
    )  # fmt: skip
    held = [holds_tau(p) for p in pairs if p[0]["kind"] == "unlisted" and (p[0]["d"] or 0.0) >= 8.0]
    known = [each for each in held if each is not None]
    found.append(share("tau held after an unlisted verdict, d from 8", ">= 0.9", known))
    return found


def phase_found(pair: Pair) -> bool | None:
    """Whether most of the stated excess is in the phase that a local cause acts in.

    None where no single phase holds :data:`LOCAL` of the cause's difference, or nothing is stated.
    """
    truth, verdict = pair
    acts, stated = (_by_phase(rows) for rows in (truth["acts"], verdict["where"]))
    if not acts or not any(stated.values()) or max(acts.values()) < LOCAL * sum(acts.values()):
        return None
    return max(stated, key=stated.__getitem__) == max(acts, key=acts.__getitem__)


def _by_phase(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for row in rows:
        found[row["phase"]] = found.get(row["phase"], 0.0) + (row["share"] or 0.0)
    return found


def holds_tau(pair: Pair) -> bool | None:
    """Whether the 95 % interval with a discrepancy holds tau; None where none is stated."""
    truth, verdict = pair
    interval = verdict.get("tau_with_discrepancy_s")
    if verdict["verdict"]["kind"] != "unlisted" or not interval:
        return None
    return bool(interval["q2.5"] <= truth["tau_s"] <= interval["q97.5"])


def reached(found: pd.DataFrame) -> list[dict[str, Any]]:
    """The goals, whether they were reached on all rigs together, as the report shows them."""
    goals = []
    for row in found[(found["rig"] == "all") & (found["goal"] != "")].to_dict("records"):
        value = None if pd.isna(row["value"]) else float(row["value"])
        sign, bound = row["goal"].split()
        met = None
        if value is not None:
            met = bool(value <= float(bound) if sign == "<=" else value >= float(bound))
        low, high = (None if pd.isna(row[end]) else float(row[end]) for end in ("lo95", "hi95"))
        goals.append({"goal": row["what"], "wanted": row["goal"], "reached": value, "lo95": low,
                      "hi95": high, "met": met})  # fmt: skip
    return goals


# --------------------------------------------------------------------------- all runs


def counted(rows: Sequence[dict[str, Any]], goals_at: Sequence[int] = GOALS_AT) -> dict[str, int]:
    """What is kept of a run: counts of its scored cases, at the levels nearest to ``goals_at``."""
    of = {kind: [r for r in rows if r["kind"] == kind] for kind in ("null", "listed", "unlisted")}
    caused = [*of["listed"], *of["unlisted"]]
    found = {
        "campaigns": len(rows),
        "causes": len({name for r in rows for name in r["causes"].split("+")} - {""}),
        "noise_laws": len({r["law"] for r in rows}),
        "nulls": len(of["null"]),
        "nulls_named": sum(r["verdict"] == "effect" for r in of["null"]),
        "with_a_cause": len(caused),
        "wrong_names": sum(r["confident_wrong"] for r in caused),
    }
    for d in goals_at:
        listed = [r for r in of["listed"] if r["d_level"] == level_of(d)]
        found[f"listed_d{d}"] = len(listed)
        found[f"right_family_d{d}"] = sum(r["family_or_abstained"] for r in listed)
    for d in goals_at:
        unlisted = [r for r in of["unlisted"] if r["d_level"] == level_of(d)]
        flagged = sum(r["verdict"] == "unlisted" for r in unlisted)
        found[f"unlisted_d{d}"], found[f"found_d{d}"] = len(unlisted), flagged
        found[f"found_or_unnamed_d{d}"] = flagged + sum(
            r["verdict"] == "family" and r["isolability"] < SEPARABLE_ABOVE for r in unlisted
        )
    return found


def together(runs: pd.DataFrame) -> pd.DataFrame:
    """The sums over all runs, with Wilson's intervals; at all levels of d, and at each alone."""
    rows = []
    at = [d for d in sorted({*OF_EARLIER_RUNS, *GOALS_AT}) if f"listed_d{d}" in runs]
    for what, count, of in (
        ("null hypotheses named", "nulls_named", "nulls"),
        ("wrong names", "wrong_names", "with_a_cause"),
        ("right family", "right_family_d", "listed_d"),
        ("unknown causes found", "found_d", "unlisted_d"),
        ("unknown causes found or rightly unnamed", "found_or_unnamed_d", "unlisted_d"),
    ):
        sums, in_runs = {}, np.zeros(len(runs), dtype=bool)
        for d in [""] if count in runs else map(str, at):
            # a run has some of the levels; the rule of abstention came after the first runs
            some = runs[count + d].astype(str) != ""
            sums[d] = tuple(int(runs.loc[some, key + d].astype(int).sum()) for key in (count, of))
            in_runs |= some.to_numpy()
        k, n = (sum(each) for each in zip(*sums.values(), strict=True))
        low, high = wilson(k, n)
        shares = {
            f"at_d{d}": sums[str(d)][0] / sums[str(d)][1] if sums.get(str(d), (0, 0))[1] else None
            for d in at
        }
        rows.append({"what": what, "of": n, "count": k, "share": k / n, "lo95": low, "hi95": high,
                     **shares, "runs": int(in_runs.sum())})  # fmt: skip
    return pd.DataFrame(rows)


def write_seconds(place: Path) -> None:
    """Write blind_check_seconds.csv: processor time of a diagnosis, compilation included."""
    found = read_json(place / "seconds.json")
    seconds = pd.Series(found["seconds"], dtype=float)
    row = {
        "setting": found["setting"], "cases": len(seconds), "median_s": seconds.median(),
        "q95_s": seconds.quantile(0.95), "largest_s": seconds.max(),
    }  # fmt: skip
    path = TABLES / "blind_check_seconds.csv"
    pd.DataFrame([row]).to_csv(path, index=False, float_format="%.4g")


def keep_figure(figure: Figure, name: str) -> None:
    """Write figures/name.png and .svg in the report's style."""
    folder = PAPER / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / f"{name}.svg", svg(figure))
    (folder / f"{name}.png").write_bytes(png(figure))


def withheld() -> Figure:
    """Verdict and truth of the bundled campaign whose cause is sealed."""
    gap = diagnose_gap(read_campaign(WITHHELD / "campaign.toml")).to_json()
    truth = complete_truth(read_json(WITHHELD / "sealed.json"), "withheld")
    return opened_seal(gap, score_case(truth, trimmed(gap)))
