"""What a fleet costs: one process, two of this machine, a Dask cluster of two workers.

Twelve small campaigns (three experiments of 15 s at 100 Hz) are analysed whole, report included, in
the three ways; the results must be the same bit for bit.  Processor time is compared, since wall
time depends on who else uses the machine; the load is stated beside.  From these and from one
campaign of the published size follows what ten thousand campaigns would take.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pandas as pd
from drawing import TABLES
from study_faults import call, state

N, SEED, MANY = 12, 1, 10_000
ROOT = Path(__file__).resolve().parent.parent.parent
TAUS_MS = (20, 35, 48, 60, 80, 100, 120, 150, 150, 180, 200, 260)
WAYS = ("serial", "--jobs 2", "Dask, 2 workers")
SETTINGS = """\
[fit]
swarms = 1
[posterior]
sampler = "independence"
[bounds]
methods = ["crlb_iid", "crlb_ar1", "sandwich_ar1", "profile", "posterior"]
step_study = false
explain = false
"""
"""of the small campaigns: what a fleet needs, the quick sampler and no bootstrap"""


def prepare(place: Path) -> Path:
    """The campaigns and their list."""
    small = ["--experiments", "1,4,6", "--duration", "15 s", "--interval", "10 ms", "--quiet"]
    noise = ["--sigma0", "5 mV", "--sigma1", "3 mV"]
    for number, tau in enumerate(TAUS_MS, 1):
        folder = place / "lab" / f"sensor {number:02d}"
        if not (folder / "campaign.toml").is_file():
            done = call("simulate", "--out", str(folder), *small, *noise, "--tau", f"{tau} ms",
                        "--seed", str(number))  # fmt: skip
            assert done.returncode == 0, done.stderr
    (place / "settings.toml").write_text(SETTINGS)
    return place / "lab"


def measured(way: str, lab: Path, out: Path, *settings: str) -> dict[str, Any]:
    """One way: wall time, processor time and memory of the workers, load of the machine."""
    shutil.rmtree(out, ignore_errors=True)
    arguments = ["fleet", str(lab), "--out", str(out), "--seed", str(SEED), "--quiet", *settings]
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    with ExitStack() as stack:
        if way.startswith("Dask"):
            from distributed import LocalCluster

            cluster = stack.enter_context(
                LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
            )
            arguments += ["--scheduler", cluster.scheduler_address]
        elif way != "serial":
            arguments += way.split()
        begin = time.perf_counter()
        done = call(*arguments)
        wall = time.perf_counter() - begin
    assert done.returncode in (0, 3), done.stderr
    cost = list(json.loads((out / "run.json").read_text())["cost"].values())
    spent = [c["processor_seconds"] for c in cost]
    size = sum(p.stat().st_size for p in out.rglob("*") if p.is_file())
    return {
        "way": way,
        "campaigns": len(cost),
        "workers": len({c["worker"] for c in cost}),
        "wall_s": wall,
        "processor_s": sum(spent),
        "processor_s_per_campaign": sum(spent) / len(spent),
        "first_campaign_s": max(spent),
        "peak_memory_MB": max(c["peak_memory_MB"] for c in cost),
        "disk_MB": size / 1e6,
        "load_before": load,
    }


def estimate(row: dict[str, Any], what: str, workers: int, per: float, MB: float) -> dict[str, Any]:
    """Ten thousand campaigns from the processor time and disk of one."""
    return {
        "way": what, "campaigns": MANY, "workers": workers,
        "wall_s": MANY * per / workers, "processor_s": MANY * per,
        "processor_s_per_campaign": per, "first_campaign_s": None,
        "peak_memory_MB": row["peak_memory_MB"], "disk_MB": MANY * MB, "load_before": None,
        "same_as_serial": "estimate: processor time of one campaign, a processor for each worker",
    }  # fmt: skip


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> pd.DataFrame:
    """The table; ways already measured are kept in ``folder``."""
    place = Path(folder) / "fleet"
    lab = prepare(place)
    kept = place / "rows.json"
    rows: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() else {}
    out = place / "out"
    for done, way in enumerate((*WAYS, "published size")):
        progress(done, len(WAYS) + 1)
        if way in rows:
            continue
        if way == "published size":
            one = place / "published"
            one.mkdir(exist_ok=True)
            (one / "list.txt").write_text(f"{ROOT / 'data' / 'reference'}\n")
            rows[way] = measured("serial", one / "list.txt", out)
        else:
            rows[way] = measured(way, lab, out, "--config", str(place / "settings.toml"))
            found = state(out)
            reference = rows.setdefault("reference", found)
            rows[way]["same_as_serial"] = "yes" if found == reference else "no"
        kept.write_text(json.dumps(rows))
        write(rows)
    progress(len(WAYS) + 1, len(WAYS) + 1)
    return write(rows)


def write(rows: dict[str, Any]) -> pd.DataFrame:
    """The table of what has been measured so far, and the estimates that follow from it."""
    small = rows["serial"]
    table = [rows[way] for way in WAYS if way in rows]
    per = (small["processor_s"] - small["first_campaign_s"]) / (N - 1)  # the first one loads
    table.append(estimate(small, "small, 2 workers", 2, per, small["disk_MB"] / N))
    table.append(estimate(small, "small, 100 workers", 100, per, small["disk_MB"] / N))
    if (large := rows.get("published size")) is not None:
        words = "published size, default settings"
        table.append({**large, "way": f"{words}, serial", "same_as_serial": "not compared"})
        spent, size = large["processor_s"], large["disk_MB"]
        table.append(estimate(large, f"{words}, 100 workers", 100, spent, size))
    frame = pd.DataFrame(table)
    for column in frame.select_dtypes("number").columns:
        frame[column] = frame[column].map(lambda v: float(f"{v:.3g}") if v == v else v)
    frame = frame.astype({"campaigns": int, "workers": int})
    TABLES.mkdir(parents=True, exist_ok=True)
    frame.to_csv(TABLES / "fleet.csv", index=False, lineterminator="\n")
    return frame
