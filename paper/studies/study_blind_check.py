"""The blind check at full size: 600 cases, with the causes and noise laws that are held in reserve.

Cases, truths and verdicts are made as ``bayes-sensor blind-check`` makes them; campaigns are not
kept.  ``blind_check_runs.csv`` has one row for each run, ``blind_check_together.csv`` their sums.
The first 24 rows were made by earlier code, with another simulator.  The goals of the last run
stand in ``blind_check_goals.csv`` and in every report of a gap.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from drawing import PAPER, TABLES
from matplotlib.figure import Figure

from bayes_sensor import __version__
from bayes_sensor.blind_check import diagnose_cases, draw_cases, open_seals, score, wilson
from bayes_sensor.blind_check.diagnosing import trimmed
from bayes_sensor.blind_check.score import SEPARABLE_ABOVE, score_case
from bayes_sensor.blind_check.truth import complete_truth
from bayes_sensor.diagnosis import diagnose_gap
from bayes_sensor.figures import png, svg
from bayes_sensor.figures.plot_blind_check import opened_seal, score_card
from bayes_sensor.io.disk import write_text
from bayes_sensor.io.json_files import read_json, write_json
from bayes_sensor.io.readers import read_campaign

N, SEED = 600, 20261215
"""the seed was never used before"""
GOALS_AT = (8, 16)
IN_REPORTS = PAPER.parent / "bayes_sensor" / "templates" / "blind_check.json"
WITHHELD = PAPER.parent / "data" / "withheld"


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write the tables, the score card and what reports show of it."""
    place = folder / "blind-check"
    parts = place / "parts"
    draw_cases(
        place, parts, N, SEED, reserve=True, keep=False, jobs=jobs, scheduler=scheduler,
        progress=progress,
    )  # fmt: skip
    diagnose_cases(place, place, parts, "study", jobs=jobs, scheduler=scheduler, progress=progress)
    write_seconds(place)
    card, rows = score(open_seals(place))
    pd.DataFrame(card["goals"]).to_csv(
        TABLES / "blind_check_goals.csv", index=False, float_format="%.4g"
    )
    write_json(IN_REPORTS, {"campaigns": N, "seed": SEED, "goals": card["goals"]})
    path = TABLES / "blind_check_runs.csv"
    runs = pd.read_csv(path, dtype={"note": str}, keep_default_na=False)
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    this = {"run": len(runs) + 1, "date": today, "code": __version__, **counted(rows), "note": ""}
    runs = pd.concat([runs, pd.DataFrame([this])], ignore_index=True)
    runs.to_csv(path, index=False)
    together(runs).to_csv(TABLES / "blind_check_together.csv", index=False, float_format="%.4g")
    keep_figure(score_card(card), "blind_check")
    keep_figure(withheld(), "opened_seal")


def counted(rows: Sequence[dict[str, Any]]) -> dict[str, int]:
    """What is kept of a run: counts of its scored cases."""
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
    for d in GOALS_AT:
        listed = [r for r in of["listed"] if r["d_level"] == d]
        found[f"listed_d{d}"] = len(listed)
        found[f"right_family_d{d}"] = sum(r["family_or_abstained"] for r in listed)
    for d in GOALS_AT:
        unlisted = [r for r in of["unlisted"] if r["d_level"] == d]
        flagged = sum(r["verdict"] == "unlisted" for r in unlisted)
        found[f"unlisted_d{d}"], found[f"found_d{d}"] = len(unlisted), flagged
        found[f"found_or_unnamed_d{d}"] = flagged + sum(
            r["verdict"] == "family" and r["isolability"] < SEPARABLE_ABOVE for r in unlisted
        )
    return found


def together(runs: pd.DataFrame) -> pd.DataFrame:
    """The sums over all runs, with Wilson's intervals; d: 8 and 16 together, and each alone."""
    rows = []
    for what, count, of in (
        ("null hypotheses named", "nulls_named", "nulls"),
        ("wrong names", "wrong_names", "with_a_cause"),
        ("right family", "right_family_d", "listed_d"),
        ("unknown causes found", "found_d", "unlisted_d"),
        ("unknown causes found or rightly unnamed", "found_or_unnamed_d", "unlisted_d"),
    ):
        names = [""] if count in runs else [str(d) for d in GOALS_AT]
        # the rule of abstention for unlisted causes came after the first runs
        some = runs[runs[f"{count}{names[0]}"].astype(str) != ""]
        sums = {name: (some[count + name].astype(int).sum(), some[of + name].astype(int).sum())
                for name in names}  # fmt: skip
        k, n = (int(sum(each)) for each in zip(*sums.values(), strict=True))
        low, high = wilson(k, n)
        shares = {f"at_d{d}": sums[str(d)][0] / sums[str(d)][1] if str(d) in sums else None
                  for d in GOALS_AT}  # fmt: skip
        rows.append({"what": what, "of": n, "count": k, "share": k / n, "lo95": low, "hi95": high,
                     **shares, "runs": len(some)})  # fmt: skip
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
