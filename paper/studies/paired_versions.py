"""The same campaigns diagnosed by an earlier version of the package and by this one.

``python paper/studies/paired_versions.py --before DIR``, with ``DIR`` a checkout of the earlier
version.  The campaigns are drawn as the blind check draws its own and written to
``build/paired``; each version reads them in processes of its own.  What is there already is not
computed again.  ``paper/tables/paired_versions.csv`` has a row a question: in how many campaigns
each version was right, in how many only one of them, and McNemar's exact p-value of that difference
(Psychometrika 12, 1947, 153).  ``paper/tables/quoted_tau.csv`` has a row a verdict that names a
cause: how often tau's interval holds the truth with and without that cause in the model.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

SEED = 2411
PLANNED = 400
ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "paper" / "tables" / "paired_versions.csv"
QUOTED = TABLE.with_name("quoted_tau.csv")
VERSIONS = ("before", "now")
TOLERANCE = 0.1
"""by how much a closed fraction may be off"""

Row = Mapping[str, Any]
Question = tuple[str, Callable[[Row], bool], Callable[[Row], bool]]
"""what is asked, of which campaigns, and whether the answer is right"""


def main() -> None:
    """Parse, make, diagnose, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--before", type=Path, help="folder of the earlier version")
    parser.add_argument("--n", type=int, default=PLANNED, help="campaigns")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "paired")
    parser.add_argument("--diagnose", choices=VERSIONS, help=argparse.SUPPRESS)
    parser.add_argument("--part", type=int, default=0, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.diagnose:
        diagnose(asked.folder, asked.diagnose, asked.part, asked.jobs)
        return
    if asked.before is None:
        parser.error("--before: expected the folder of the earlier version")
    make(asked.folder, asked.n)
    for version, code in zip(VERSIONS, (asked.before.resolve(), ROOT), strict=True):
        parts = [
            subprocess.Popen(
                [sys.executable, __file__, "--folder", str(asked.folder), "--diagnose", version,
                 "--part", str(part), "--jobs", str(asked.jobs)],
                env={**os.environ, "PYTHONPATH": str(code)},
                cwd=asked.folder,
            )
            for part in range(asked.jobs)
        ]  # fmt: skip
        if any([process.wait() for process in parts]):
            raise SystemExit(f"the diagnosis by the version in {code} failed")
    compare(asked.folder, asked.n)
    quote(asked.folder, asked.n)


def _places(folder: Path) -> list[Path]:
    return sorted(place for place in folder.iterdir() if (place / "truth.json").is_file())


def make(folder: Path, n: int) -> None:
    """Write the campaigns, each with its truth."""
    from bayes_sensor.blind_check.plan import draw_truth, make_plan
    from bayes_sensor.blind_check.simulator import Case, make_campaign
    from bayes_sensor.io.writers import write_campaign

    for entry in make_plan(n, SEED, size="small"):
        place = folder / entry.name
        if not (place / "truth.json").is_file():
            truth = draw_truth(entry)
            write_campaign(make_campaign(Case.from_json(truth["recipe"])), place, formats="npz")
            (place / "truth.json").write_text(json.dumps(truth), encoding="utf-8")


def diagnose(folder: Path, version: str, part: int, parts: int) -> None:
    """Write the verdict on every campaign of a part, by the version that is imported."""
    from bayes_sensor.blind_check.diagnosing import no_verdict, trimmed
    from bayes_sensor.campaign import CampaignError
    from bayes_sensor.diagnosis import diagnose_gap
    from bayes_sensor.fit import fit_least_squares
    from bayes_sensor.io.readers import read_campaign

    for number, place in enumerate(_places(folder)[part::parts]):
        path = place / f"{version}.json"
        if path.is_file():
            continue
        truth = json.loads((place / "truth.json").read_text(encoding="utf-8"))
        out = truth["listed_as"] if truth["kind"] == "withheld" else []
        seed = truth["diagnosis_seed"]
        try:
            campaign = read_campaign(place / "campaign.toml")
            fit = fit_least_squares(campaign, seed=seed, euler=False, swarms=1)
            gap = diagnose_gap(
                campaign, fit, seed=seed, without=sorted({n for names in out for n in names}),
                bootstrap=0, separate=False, follow=False, hidden=False,
            )  # fmt: skip
            found = trimmed(gap.to_json())
        except CampaignError as error:
            found = no_verdict(str(error))
        path.write_text(json.dumps(found), encoding="utf-8")
        if part == 0:
            print(f"{version}: {number + 1} of {len(_places(folder)[::parts])}", flush=True)


def _is_seen(row: Row) -> bool:
    return row["d"] is not None and row["d"] >= 8.0 and row["on_mean"]


QUESTIONS: list[Question] = [
    ("nothing named where nothing is", lambda r: r["kind"] == "null", lambda r: not r["named"]),
    ("family right, listed, d >= 8", lambda r: r["kind"] == "listed" and _is_seen(r),
     lambda r: r["family_right"]),
    ("effect first, listed, d >= 8", lambda r: r["kind"] == "listed" and _is_seen(r),
     lambda r: r["top_right"]),
    ("no wrong name with confidence, all", lambda r: True, lambda r: not r["confident_wrong"]),
    ("no wrong name, all", lambda r: True, lambda r: not r["wrong_name"]),
    ("verdict right, unlisted, d >= 8",
     lambda r: r["kind"] in ("unlisted", "withheld") and r["d"] is not None and r["d"] >= 8.0,
     lambda r: r["verdict_right"]),
    (f"closed fraction within {TOLERANCE:g}, listed, d >= 8",
     lambda r: r["kind"] == "listed" and _is_seen(r) and r["closed_oracle"] is not None,
     lambda r: r["closed"] is not None and abs(r["closed"] - r["closed_oracle"]) <= TOLERANCE),
]  # fmt: skip


def compare(folder: Path, n: int) -> None:
    """Score both versions by the rules of this one, and write the table."""
    import pandas as pd
    from statsmodels.stats.contingency_tables import mcnemar

    from bayes_sensor.blind_check.score import score_case

    scored: dict[str, list[Row]] = {version: [] for version in VERSIONS}
    for place in _places(folder)[:n]:
        truth = json.loads((place / "truth.json").read_text(encoding="utf-8"))
        for version in VERSIONS:
            verdict = json.loads((place / f"{version}.json").read_text(encoding="utf-8"))
            scored[version].append(score_case(truth, verdict))
    rows = []
    for question, asked, is_right in QUESTIONS:
        pairs = [
            (is_right(old), is_right(new))
            for old, new in zip(scored["before"], scored["now"], strict=True)
            if asked(new) and asked(old)
        ]
        counts = [
            [sum(pair == (a, b) for pair in pairs) for b in (True, False)] for a in (True, False)
        ]
        rows.append({
            "question": question, "campaigns": len(pairs),
            "before": sum(counts[0]), "now": counts[0][0] + counts[1][0],
            "before_alone": counts[0][1], "now_alone": counts[1][0],
            "p_value": float(mcnemar(counts, exact=True).pvalue),
        })  # fmt: skip
    pd.DataFrame(rows).to_csv(TABLE, index=False, float_format="%.3g")


def quote(folder: Path, n: int) -> None:
    """Count how often the interval that a report quotes holds tau, and write the table."""
    import numpy as np
    import pandas as pd

    from bayes_sensor.blind_check.statistics import wilson
    from bayes_sensor.report.cause_left_out import left_out

    found = []
    for place in _places(folder)[:n]:
        tau = json.loads((place / "truth.json").read_text(encoding="utf-8"))["tau_s"]
        gap = json.loads((place / "now.json").read_text(encoding="utf-8"))
        cause = left_out({**gap, "hidden": {"lag": "tau"}}, None) if "verdict" in gap else None
        if cause is not None:
            low, _, high = cause.ends_s
            a, b = (gap["shrink"][f"tau_before_{end}_s"] for end in ("lo", "hi"))
            found.append((gap["verdict"]["kind"], a <= tau <= b, low <= tau <= high,
                          (high - low) / (b - a)))  # fmt: skip
    rows = []
    for kind in ("effect", "family", "unlisted"):
        _, without, with_it, widths = zip(*(row for row in found if row[0] == kind), strict=True)
        ends = dict(zip(("lo95", "hi95"), wilson(sum(with_it), len(with_it)), strict=True))
        rows.append({
            "verdict": kind, "campaigns": len(with_it), "without": sum(without),
            "with_cause": sum(with_it), "share": sum(with_it) / len(with_it), **ends,
            "relative_width": float(np.median(widths)),
        })  # fmt: skip
    pd.DataFrame(rows).to_csv(QUOTED, index=False, float_format="%.3g")


if __name__ == "__main__":
    main()
