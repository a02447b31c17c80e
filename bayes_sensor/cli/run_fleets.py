"""Many campaigns from the command line: analyse each independently; compare."""

from __future__ import annotations

import errno
import io
import os
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_sensor import __version__
from bayes_sensor.analysis.overrides import Overrides, read_overrides
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli.logged_notes import noted
from bayes_sensor.cli.pipeline import run_command
from bayes_sensor.cli.terminal import progress_bar, say
from bayes_sensor.fleet import FleetEntry, failed_row, read_list, row_of, table, write_comparison
from bayes_sensor.fleet.comparison import sentences
from bayes_sensor.fleet.outcome import fingerprint, unchanged
from bayes_sensor.io.disk import own_folder
from bayes_sensor.io.json_files import write_json
from bayes_sensor.io.put_run import CommandClock, put_run
from bayes_sensor.io.results import Results
from bayes_sensor.workers import WorkerDied, completed, dask_client

if TYPE_CHECKING:
    import pandas as pd

FOLDER = "campaigns"
"""of the campaigns' own results"""
OUTCOME = "outcome.json"
"""file beside a campaign's complete results: the row, and its inputs"""
PATIENCE = 600.0
"""seconds to wait for a worker that an interrupted run has left at the same campaign"""
NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EROFS}
"""errors that end the fleet, because they would fail for every campaign"""
COST = ("seconds", "processor_seconds", "peak_memory_MB")

_one_at_a_time = threading.Lock()
"""a Dask worker may have threads, but drawing and printing are shared by the whole process"""


@dataclass(frozen=True)
class FleetAnalysis:
    """The task of a fleet: ``analyze`` one campaign into its own folder."""

    config: Path | None
    seed: int
    resume: bool
    posterior: dict[str, Any]
    out: Path = Path()
    key: str = ""
    """digest of everything besides the data that the numbers depend on"""

    def __call__(self, entry: FleetEntry) -> dict[str, Any]:
        """``row`` of the table and ``cost``; errors of the campaign are in the row."""
        with _one_at_a_time:
            return self._analyse(entry)

    def _analyse(self, entry: FleetEntry) -> dict[str, Any]:
        begin, spent = time.perf_counter(), time.process_time()
        results = Results(self.out / FOLDER / entry.name)
        file = str(entry.file)
        if self.resume and (known := self._known(results, entry)) is not None:
            return known
        arguments = ["analyze", file, "--out", str(results.folder), "--seed", str(self.seed)]
        try:
            told = io.StringIO()
            with redirect_stdout(io.StringIO()), redirect_stderr(told):
                own_folder(results.folder)
                if results.json(OUTCOME) is not None:  # CampaignError where it is no outcome
                    results.path(OUTCOME).unlink()
                run_command(
                    "analyze", entry.file, results.folder, seed=self.seed, jobs=1, quiet=True,
                    config=self.config, resume=self.resume, posterior=self.posterior,
                    patience=PATIENCE, command_line=["bayes-sensor", *arguments],
                )  # fmt: skip
            message = told.getvalue().strip().splitlines()[-1:] or [""]
            report = f"{FOLDER}/{entry.name}/report.html"
            row = row_of(results, entry.name, file, report, message[0])
            files = fingerprint(entry.file)
        except CampaignError as error:
            return {"row": failed_row(entry.name, file, str(error)), "cost": _cost(begin, spent)}
        except OSError as error:
            if error.errno in NO_ROOM:
                raise
            return {"row": failed_row(entry.name, file, _bug(error)), "cost": _cost(begin, spent)}
        except Exception as error:
            # a mistake of ours, met by one campaign in the night, must not cost all the others
            return {"row": failed_row(entry.name, file, _bug(error)), "cost": _cost(begin, spent)}
        outcome = {"row": row, "cost": _cost(begin, spent)}
        write_json(results.path(OUTCOME), {**outcome, "key": self.key, "files": files})
        return outcome

    def _known(self, results: Results, entry: FleetEntry) -> dict[str, Any] | None:
        """The outcome of an earlier run on the same data with the same settings."""
        try:
            known = results.json(OUTCOME)
        except CampaignError:  # damaged: analysed again
            return None
        if not known or known["key"] != self.key or not results.has("report.html"):
            return None
        if known["row"]["file"] != str(entry.file) or not unchanged(entry.file, known["files"]):
            return None
        return {"row": known["row"], "cost": known["cost"]}


def _bug(error: BaseException) -> str:
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(place.filename).name}, line {place.lineno}"
    return (
        f"an unforeseen {type(error).__name__} ({str(error)[:200]}) in {where}; "
        "run analyze on this campaign alone to see all of it, and report it"
    )


def _cost(begin: float, spent: float) -> dict[str, Any]:
    """Time since ``begin``, processor time since ``spent`` and the process's peak memory so far."""
    try:
        import resource
        import sys

        unit = 1 if sys.platform == "darwin" else 1024
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
    except ImportError:  # Windows
        peak = float("nan")
    values = (time.perf_counter() - begin, time.process_time() - spent, peak)
    cost: dict[str, Any] = {k: round(v, 3) for k, v in zip(COST, values, strict=True)}
    return {
        **cost,
        "worker": f"{os.uname().nodename if hasattr(os, 'uname') else ''}:{os.getpid()}",
    }


def run_fleet(
    listing: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    seed: int = 1,
    jobs: int = 1,
    scheduler: str | None = None,
    config: str | os.PathLike[str] | None = None,
    posterior: dict[str, Any] | None = None,
    resume: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> pd.DataFrame:
    """Analyse every campaign of a list; the comparison table, a row a campaign.

    Writes ``fleet.csv``, ``fleet.json``, the figure and ``index.html`` into ``out``, and what
    ``analyze`` gives into ``out/campaigns/NAME``.  Each campaign is analysed with the same seed:
    its numbers are those of ``analyze`` alone, whatever its place in the list.

    Parameters
    ----------
    listing
        a text file of paths, a TOML file, a folder or a pattern: see ``bayes_sensor.fleet``.
    jobs, scheduler
        processes of this machine, or the address of a Dask scheduler whose workers see the same
        files; the numbers depend on neither.
    config, posterior
        settings that differ from default, as ``--config`` and the sampler's options.
    resume
        keep what ``out`` holds of the same data, seed and settings; failed campaigns are tried
        again.

    Raises
    ------
    CampaignError
        If the list, the settings or ``out`` cannot be used.  A bad campaign is a row with
        ``status`` "failed" and its message.
    """
    path = None if config is None else Path(config)
    rows, _ = _run(
        Path(listing), Path(out), FleetAnalysis(path, seed, resume, posterior or {}), jobs,
        scheduler, progress or (lambda fraction, text: None),
    )  # fmt: skip
    return table(rows)


def _run(
    listing: Path,
    out: Path,
    task: FleetAnalysis,
    jobs: int,
    scheduler: str | None,
    tell: Callable[[float, str], None],
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The rows and their comparison."""
    clock = CommandClock()
    settings: Overrides = read_overrides(task.config, task.posterior)
    entries = read_list(listing)
    results = Results(out)
    task = replace(  # what a worker can use, wherever it runs
        task, out=Path(os.path.abspath(out)),
        config=None if task.config is None else Path(os.path.abspath(task.config)),
        key=repr((__version__, task.seed, sorted(settings.record().items()))),
    )  # fmt: skip
    with ExitStack() as stack:
        client = None
        if scheduler is not None:  # before anything is written: it may not answer
            client = stack.enter_context(dask_client(scheduler))
        stack.enter_context(results.locked(steps=["fleet"]))
        results.own_folder(FOLDER)
        outcomes = _outcomes(task, entries, jobs, client, tell)
        rows = [outcome["row"] for outcome in outcomes]
        _check_visible(out, rows, scheduler)
        with results.writing() as stage:
            compared = write_comparison(stage, rows, __version__)
            costs = {o["row"]["campaign"]: o["cost"] for o in outcomes}
            put_run(
                stage, "fleet", clock, seed=task.seed, settings=settings.record(),
                campaign=str(listing),
                seconds={
                    "fleet": clock.seconds,
                    **{name: cost.get("seconds", 0.0) for name, cost in costs.items()},
                },
                exit_code=exit_code(compared), warnings=noted(), cost=costs,
            )  # fmt: skip
    return rows, compared


def _outcomes(
    task: FleetAnalysis,
    entries: Sequence[FleetEntry],
    jobs: int,
    client: Any,
    tell: Callable[[float, str], None],
) -> list[dict[str, Any]]:
    """One a campaign, in the order of the list."""
    here = [FleetEntry(e.name, Path(os.path.abspath(e.file))) for e in entries]
    found: dict[int, dict[str, Any]] = {}
    bad = 0
    tell(0.0, f"0 of {len(entries)} campaigns")
    for i, result in completed(task, here, min(jobs, len(here)), client):
        if isinstance(result, WorkerDied):
            result = {
                "row": failed_row(entries[i].name, str(here[i].file), str(result)),
                "cost": {},
            }
        found[i] = result
        bad += result["row"]["status"] == "failed"
        tell(len(found) / len(entries), f"{len(found)} of {len(entries)}, {bad} failed")
    return [found[i] for i in range(len(entries))]


def _check_visible(out: Path, rows: Sequence[dict[str, Any]], scheduler: str | None) -> None:
    for row in rows:
        if row["report"] and not (out / row["report"]).is_file():
            raise CampaignError(
                f"--scheduler {scheduler}: the workers' results are not in {out}; expected workers "
                "that see the same folders: put --out on a disk that all machines share"
            )


def exit_code(compared: dict[str, Any]) -> int:
    """0 where every campaign is done, else 3."""
    return 0 if compared["done"] == compared["n"] else 3


def analyse_fleet(
    listing: Path, out: Path, task: FleetAnalysis, *, jobs: int, scheduler: str | None, quiet: bool
) -> int:
    """Run the command; the exit code."""
    with progress_bar("fleet", quiet) as tell:
        rows, compared = _run(listing, out, task, jobs, scheduler, tell)
    for text in sentences(compared):
        say(text, quiet)
    for row in [row for row in rows if row["status"] == "failed"][:MOST_SHOWN]:
        say(f"failed: {row['campaign']}: {row['message']}", quiet)
    if compared["failed"] > MOST_SHOWN:
        say(f"failed: {compared['failed'] - MOST_SHOWN} more in fleet.csv", quiet)
    say(f"index: {Results(out).path('index.html')}", quiet)
    return exit_code(compared)


MOST_SHOWN = 6
"""failed campaigns that are named in a terminal"""
