"""How long a user waits: whole commands in fresh processes, part of ``make bench``.

Every command is run in turn within a round, and beside it a fixed job of numpy: the ratio to that
job can be compared with a later run on another machine.  Processor seconds count the command and
all processes that it started; wall seconds stand beside them where the goal is about waiting, and
want a machine of one's own.  What ``analyze`` says that a stage will take is measured here, too.
``--before DIR`` takes turns with another checkout of this project, run by the same Python; what
that one does not know is left out of its rows.  Writes paper/tables/benchmark_commands.csv.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from benchmark import CAMPAIGN, ROOT, Row, show, table
from study_fleet import SETTINGS

from bayes_sensor.analysis.job import STAGES
from bayes_sensor.cli import exit_code

TABLE = ROOT / "paper" / "tables" / "benchmark_commands.csv"
EXPECTED = ROOT / "bayes_sensor" / "cli" / "stage_seconds.json"
BUNDLED, SMALL = "analyze, bundled", "analyze, 3 experiments of 35 s at 100 Hz"
REPORT = "report, bundled"
FEW = 100
"""campaigns of the fleet on two processes"""
WITHHELD = ROOT / "data" / "withheld" / "campaign.toml"
TRAIN = """\
title = "200 pulses in one record"
[rig]
stages = ["valve", "sensor"]
[[experiment]]
name = "1"
commanded_on = [{on}]
commanded_off = [{off}]
delays = "shared"
interval = "20 ms"
duration = "2010 s"
"""
RELOADED = "import sys; sys.path.insert(0, {root!r}); from bayes_sensor.cli import main; main()"


@dataclass(frozen=True)
class Spent:
    """What one run of a command took."""

    processor: float
    """s, of all its processes"""
    wall: float
    """s"""
    first_interval: float
    """s of wall time until the first line with an interval of tau; NaN if there was none"""
    peak: float
    """MB, of its largest process"""


def numpy_job() -> float:
    """Processor seconds of a fixed job: sines, a sort and products of matrices."""
    begin = time.process_time()
    x = np.arange(4_000_000, dtype=float)
    np.sort(np.sin(x))
    a = x[:360_000].reshape(600, 600) / x[360_000]
    for _ in range(20):
        a = np.tanh(a @ a.T)
    assert np.isfinite(a).all()
    return time.process_time() - begin


def run(arguments: Sequence[str], root: Path = ROOT, cache: Path | None = None) -> Spent:
    """Run a command of the checkout ``root``; raises RuntimeError when it fails."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    command = [sys.executable, "-c", RELOADED.format(root=str(root)), *arguments]
    begin, first = time.perf_counter(), np.nan
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=errors, env=environment, cwd=root, text=True
        )
        assert process.stdout is not None  # asked for above
        for line in process.stdout:
            if "95 % interval" in line and np.isnan(first):
                first = time.perf_counter() - begin
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        errors.seek(0)
        if process.returncode not in (0, 3):  # 3: finished, but not converged
            raise RuntimeError(f"{' '.join(arguments)}: {errors.read()[-2000:]}")
    peak = usage.ru_maxrss / (1024.0 if sys.platform == "linux" else 1024.0**2)
    return Spent(usage.ru_utime + usage.ru_stime, wall, first, peak)


@dataclass(frozen=True)
class Job:
    """A command, with its goals; ``{out}`` in it is where the results go."""

    what: str
    command: tuple[str, ...]
    processor: float | None = None
    """s, goal"""
    wall: float | None = None
    """s, goal"""
    first: float | None = None
    """s until the first interval, goal"""


def jobs(folder: Path) -> list[Job]:
    """The commands and the goals set for them."""
    bundled, small = str(CAMPAIGN), str(folder / "small" / "campaign.toml")
    cause, analysed = str(WITHHELD), str(folder / "analysed")
    out, one = ("--out", "{out}"), ("--jobs", "1")
    return [
        Job(BUNDLED, ("analyze", bundled, *out, *one), 20.0, first=6.0),
        Job("analyze --jobs 2, bundled", ("analyze", bundled, *out, "--jobs", "2"), wall=12.0),
        Job("analyze --quick, bundled", ("analyze", bundled, *out, *one, "--quick"), first=6.0),
        Job(SMALL, ("analyze", small, *out, *one), 8.0,
            first=6.0),
        Job(REPORT, ("report", analysed, *one), 4.0),
        Job("fit, bundled", ("fit", bundled, *out), 1.0),
        Job("posterior by independence, bundled",
            ("posterior", bundled, *out, "--sampler", "independence")),
        Job("posterior by emcee, bundled", ("posterior", bundled, *out), 5.0),
        Job("bounds, bundled", ("bounds", bundled, *out), 5.0),
        Job("gap, bundled, nothing missing", ("gap", bundled, *out), 4.0),
        Job("gap, withheld, a cause", ("gap", cause, *out), 8.0),
        Job("analyze --quick, 10 kHz",
            ("analyze", str(folder / "fast" / "campaign.toml"), *out, *one, "--quick")),
        Job("analyze --quick, 50 experiments",
            ("analyze", str(folder / "many" / "campaign.toml"), *out, *one, "--quick")),
        Job("analyze --quick, 200 pulses in one record",
            ("analyze", str(folder / "train" / "campaign.toml"), *out, *one, "--quick")),
    ]  # fmt: skip


def prepare(folder: Path) -> None:
    """Make the campaigns that the jobs read, and the results that ``report`` reads."""

    def simulate(name: str, *options: str) -> None:
        run(("simulate", *options, "--out", str(folder / name), "--quiet"))

    short = ("--experiments", "1,3,5", "--duration", "35 s", "--interval", "10 ms")
    simulate("small", *short)
    simulate(
        "fast",
        "--experiments",
        "1,4,7",
        "--duration",
        "30 s",
        "--interval",
        "100 us",
        "--format",
        "npz",
    )
    design = folder / "train.toml"
    switches = [f'"{10 * k + at} s"' for at in (5, 10) for k in range(200)]
    design.write_text(TRAIN.format(on=", ".join(switches[:200]), off=", ".join(switches[200:])))
    simulate("train", "--design", str(design))
    many = folder / "many.toml"
    blocks = [
        f'[[experiment]]\nname = "{k}"\ntotal_flow = "{3 + 6 * k / 49:.3f} L/min"\n'
        'concentration = "10 %"\ncommanded_on = "5 s"\ncommanded_off = "15 s"\n'
        'interval = "10 ms"\nduration = "30 s"\n'
        for k in range(50)
    ]
    many.write_text('title = "50 experiments"\n' + "\n".join(blocks))
    simulate("many", "--design", str(many))
    run(("analyze", str(CAMPAIGN), "--out", str(folder / "analysed"), "--quiet"))


def rows_of(job: Job, spent: list[Spent], numpy_s: float, label: str) -> list[Row]:
    """The rows of one job; ``numpy_s`` is the median of the fixed job."""
    busy = tuple(s.processor for s in spent)
    ratio = f"{np.median(busy) / numpy_s:.1f} numpy jobs"
    peak = f"peak {max(s.peak for s in spent):.0f} MB"
    what = job.what + label
    rows = [Row(what, "s", busy, most=job.processor, note=f"{ratio}; {peak}")]
    if job.wall is not None:
        rows.append(Row(f"{what}, wall", "s", tuple(s.wall for s in spent), most=job.wall))
    if job.first is not None:
        rows.append(Row(f"{what}, first interval of tau, wall", "s",
                        tuple(s.first_interval for s in spent), most=job.first))  # fmt: skip
    return rows


def warm(folder: Path, n: int, before: Path | None, write: bool) -> list[Row]:
    """Every job, compiled code cached; with ``before`` in turn with that checkout.

    ``write`` the expected times of stages.
    """
    stages: dict[str, dict[str, float]] = {}
    roots = {"": ROOT} | ({", before": before} if before else {})
    listed = jobs(folder)
    taken: dict[tuple[str, str], list[Spent]] = {}
    numpy_s = []
    for i in range(n + 1):  # the first fills the caches
        for job in listed:
            for label, root in roots.items():
                out = folder / "out"
                shutil.rmtree(out, ignore_errors=True)
                # each checkout has the bundled campaigns in the form that it reads
                here, there = str(ROOT / "data"), str(root / "data")
                command = [part.format(out=out).replace(here, there) for part in job.command]
                numpy_s.append(numpy_job())
                try:
                    spent = run(command, root)
                except RuntimeError as error:
                    if not label:
                        raise
                    print(f"{job.what}: not by the checkout before: {error}", file=sys.stderr)
                    continue
                if i or n == 0:
                    taken.setdefault((job.what, label), []).append(spent)
                if job.what in (SMALL, BUNDLED) and not label:
                    stages[job.what] = stages_of(out, spent)
                print(f"{job.what}{label}: {spent.processor:.1f} s", file=sys.stderr, flush=True)
    if write:
        write_expected(stages[SMALL], stages[BUNDLED], taken[REPORT, ""][-1].processor)
    median = float(np.median(numpy_s))
    rows = [
        row for job in listed for label in roots if (job.what, label) in taken
        for row in rows_of(job, taken[job.what, label], median, label)
    ]  # fmt: skip
    peaks = tuple(s.peak for (_, label), each in taken.items() if not label for s in each)
    return [
        Row("the fixed job of numpy", "s", tuple(numpy_s)), *rows,
        Row("peak memory, largest of all", "MB", (max(peaks),), most=600.0),
    ]  # fmt: skip


def stages_of(out: Path, spent: Spent) -> dict[str, float]:
    """Processor seconds of each stage of an analysis that wrote ``out``.

    Stages are timed by the clock; the share of a processor that each had is that of the whole run.
    """
    steps = json.loads((out / "run.json").read_text())["commands"]["analyze"]["seconds"]
    share = spent.processor / spent.wall
    return {
        stage: share * sum(steps.get(step, 0.0) for step in names)
        for stage, names in STAGES.items()
    }


def write_expected(small: Mapping[str, float], bundled: Mapping[str, float], report: float) -> None:
    """What ``analyze`` tells of its stages: seconds of any campaign, and of each experiment.

    ``report``: s, of that command; its figures are as many for every campaign.
    """
    few, many = 3, 7
    found = {}
    for stage in STAGES:
        more = max(bundled[stage] - small[stage], 0.0) / (many - few)
        least = max(small[stage] - few * more, 0.0)
        found[stage] = {"s": round(least, 1), "s_per_experiment": round(more, 2)}
    found["report"] = {"s": round(report, 1), "s_per_experiment": 0.0}
    EXPECTED.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def compiling(folder: Path) -> list[Row]:
    """A fresh machine: the whole analysis with nothing compiled, less the same compiled."""
    cache = folder / "cache"
    command = ("analyze", str(folder / "small" / "campaign.toml"), "--out", str(folder / "cold"))
    spent = []
    for _ in range(2):
        shutil.rmtree(folder / "cold", ignore_errors=True)
        spent.append(run((*command, "--jobs", "1"), cache=cache).processor)
    note = "analyze of the small campaign with nothing compiled, less the same compiled"
    return [Row("compiling on a fresh machine", "s", (spent[0] - spent[1],), most=30.0, note=note)]


def fleets(folder: Path, n: int) -> list[Row]:
    """Campaigns an hour of many small ones: some on two processes, all on a Dask cluster."""
    settings = folder / "settings.toml"
    settings.write_text(SETTINGS)
    short = ("--experiments", "1,4,7", "--duration", "15 s", "--interval", "10 ms", "--quiet")
    places = []
    for k in range(n):
        place = folder / "fleet" / f"{k}"
        assert exit_code(["simulate", *short, "--seed", str(k), "--out", str(place)]) == 0
        places.append(str(place / "campaign.toml"))
    rows = []
    with ExitStack() as stack:
        ways = {"2 processes": (places[:FEW], ("--jobs", "2"))}
        try:
            from dask.distributed import Client, LocalCluster
        except ImportError:
            print("dask.distributed is not installed: its row is left out", file=sys.stderr)
        else:
            cluster = stack.enter_context(
                LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
            )
            stack.enter_context(Client(cluster))
            ways["Dask, 2 workers"] = places, ("--scheduler", cluster.scheduler_address)
        for way, (chosen, options) in ways.items():
            out, listing = folder / f"fleet {way}", folder / f"{way}.txt"
            listing.write_text("\n".join(chosen))
            command = ("fleet", str(listing), "--out", str(out), "--config", str(settings))
            wall = run((*command, *options, "--quiet")).wall
            done = pd.read_csv(out / "fleet.csv")
            ready = int((done["status"] != "failed").sum())
            costs = json.loads((out / "run.json").read_text())["cost"]
            peak = max(cost["peak_memory_MB"] for cost in costs.values())
            note = f"{ready} of {len(chosen)} done; at most {peak:.0f} MB a worker"
            rows.append(Row(f"fleet of small campaigns, {way}", "campaigns an hour",
                            (3600.0 * len(chosen) / wall,), note=note))  # fmt: skip
    return rows


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3, help="after one that fills the caches")
    parser.add_argument("--fleet", type=int, default=1000, help="campaigns of the fleet")
    parser.add_argument("--before", type=Path, help="another checkout, run in turn")
    parser.add_argument("--quick", action="store_true", help="one round, nothing written")
    asked = parser.parse_args()
    n, in_fleet = (1, 4) if asked.quick else (asked.rounds, asked.fleet)
    load = [os.getloadavg()[0]]
    rows: list[Row] = []

    def keep(more: list[Row]) -> None:  # what follows may take long, or be stopped
        rows.extend(more)
        here = (*load, os.getloadavg()[0])
        note = f"{os.cpu_count()} cores; before and after: wall times want less than one a core"
        done = [*rows, Row("load average of the machine", "1", here, note=note)]
        if not asked.quick:
            table(done).to_csv(TABLE, index=False, float_format="%.4g")
        show(done, "whole commands in fresh processes")

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        keep(warm(folder, n, asked.before and asked.before.resolve(), not asked.quick))
        keep(compiling(folder))
        keep(fleets(folder, in_fleet))
    if not asked.quick:
        print(f"written: {TABLE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
