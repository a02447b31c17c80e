"""Two thousand damaged results folders, and what every command makes of them.

The damages and the judge are those of ``tests/support/bad_folders.py``: a folder is refused with
exit code 2 and one message, or used as it stands; anything else counts as a failure: a traceback,
more than twenty seconds, more memory than the limit, a file written or read outside, code executed.
"""

from __future__ import annotations

import contextlib
import io
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import PAPER, TABLES

from bayes_sensor.checks.study_chunks import run_chunks, study_key

sys.path.insert(0, str(PAPER.parent))
from tests.support.bad_folders import draw, try_case

SEED, N = 63, 2000
MORE_MEMORY = 1 << 30
"""bytes that a command may take beyond the peak of all before it"""
ADDRESS_SPACE = 8 << 30
"""bytes of addresses beyond those in use: libraries reserve more than they take"""
QUICK = """\
[fit]
swarms = 1
particles = 10
euler = false
[posterior]
n_chains = 2
n_walkers = 32
burn_in = 40
chunk = 20
max_steps = 120
[bounds]
resamples = 20
"""
COMMANDS = {
    "analysed": (*["report"] * 8, "report --pages full", *["bs.load"] * 6, *["restore"] * 2,
                 "posterior --resume", "delays"),
    "blind": (*["blind-check --score-only"] * 6, "report", "report",
              "blind-check --cases-only --resume"),
    "fleet": ("fleet --resume",) * 4,
    "coverage": ("coverage --resume",),
}  # fmt: skip
"""by base; repeated the more often, the more it reads"""
OUTCOMES = ("refused", "used", "failed")


def call(*arguments: str | Path) -> tuple[int, str]:
    """Exit code and stderr of a command in this process."""
    from bayes_sensor.cli import exit_code

    told = io.StringIO()
    with contextlib.redirect_stderr(told), contextlib.redirect_stdout(io.StringIO()):
        code = exit_code([str(a) for a in arguments])
    return code, told.getvalue()


def prepare(place: Path) -> dict[str, Path]:
    """The undamaged folders."""
    bases = {name: place / name for name in COMMANDS}
    if not (place / "done").exists():
        c, quick = place / "c" / "campaign.toml", place / "quick.toml"
        quick.write_text(QUICK)
        small = ["--experiments", "1,6", "--duration", "12 s", "--interval", "20 ms", "--quiet"]
        noise = ["--sigma0", "5 mV", "--sigma1", "3 mV", "--tau", "150 ms"]
        call("simulate", "--out", c.parent, *small, *noise)
        call("analyze", c, "--out", bases["analysed"], "--config", quick, "--quiet")
        blind = ["--cases", "2", "--size", "small", "--setting", "study", "--quiet"]
        call("blind-check", "--out", bases["blind"], *blind)
        few = ["--campaigns", "2", "--setting", "iid", "--method", "crlb_ar1", "--quiet"]
        call("coverage", "--out", bases["coverage"], *few)
        out = bases["fleet"]
        shutil.copytree(c.parent, out / "inputs")
        (out / "list.toml").write_text('[[campaign]]\nfile = "inputs/campaign.toml"\nname = "c"\n')
        call("fleet", out / "list.toml", "--out", out, "--config", quick, "--quiet")
        for base in bases.values():  # what no command reads back
            for folder in ("figures", "campaigns/c/figures"):
                shutil.rmtree(base / folder, ignore_errors=True)
            for kind in ("*.html", "*.svg", "*.png"):
                for file in base.glob(kind):
                    file.unlink()
        (place / "done").touch()
    return bases


def runner(place: Path) -> Callable[[str, Path], tuple[int, str]]:
    """Runs a command of :data:`COMMANDS` on a folder."""
    c, quick = place / "c" / "campaign.toml", place / "quick.toml"
    few = ["--campaigns", "2", "--setting", "iid", "--method", "crlb_ar1"]

    def run(command: str, out: Path) -> tuple[int, str]:
        import bayes_sensor as bs
        from bayes_sensor.cli import run_fleets

        made = ["--out", out, "--config", quick, "--quiet"]
        if command == "bs.load":
            result = bs.load(out)
            result.summary(), repr(result), [part for part in (result.fit, result.gap) if part]
            return 0, ""
        if command == "fleet --resume":
            # an analysis that is not known as done is not computed anew but copied
            def copied(_: str, file: Path, folder: Path, **__: Any) -> int:
                shutil.copytree(place / "fleet" / "campaigns" / "c", folder, dirs_exist_ok=True)
                return 0

            kept, run_fleets.run_command = run_fleets.run_command, copied
            try:
                return call("fleet", out / "list.toml", *made, "--resume")
            finally:
                run_fleets.run_command = kept
        arguments: dict[str, list[Any]] = {
            "report": ["report", out, "--no-figures", "--quiet"],
            "report --pages full": ["report", out, "--pages", "full", "--quiet"],
            "restore": ["restore", out, c.parent / "exp1.csv", "--out", out / "new", "--quiet"],
            "posterior --resume": ["posterior", c, *made, "--resume"],
            "delays": ["delays", c, *made],
            "coverage --resume": ["coverage", *few, "--out", out, "--quiet", "--resume"],
            "blind-check --score-only": ["blind-check", "--score-only", "--out", out, "--quiet"],
            "blind-check --cases-only --resume": [
                "blind-check", "--cases-only", "--cases", "2", "--size", "small", "--out", out,
                "--quiet", "--resume",
            ],
        }  # fmt: skip
        return call(*arguments[command])

    return run


@dataclass(frozen=True)
class FoldersStudy:
    """The task: damaged folder number i."""

    place: Path

    @property
    def key(self) -> str:
        """Everything that the outcomes depend on, the generator's text included."""
        text = (PAPER.parent / "tests" / "support" / "bad_folders.py").read_text()
        return study_key("folders", SEED, COMMANDS, text)

    def __call__(self, i: int) -> dict[str, Any]:
        """``outcome``, ``command``, ``kind``, ``message``, ``seconds``."""
        rng = np.random.default_rng([SEED, i])
        bases = {name: self.place / name for name in COMMANDS}
        case = draw(bases, COMMANDS, rng)
        begin, message = time.process_time(), ""
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limits = resource.getrlimit(resource.RLIMIT_AS)
        most = pages * resource.getpagesize() + ADDRESS_SPACE
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with tempfile.TemporaryDirectory() as scratch:
            resource.setrlimit(resource.RLIMIT_AS, (most, limits[1]))
            try:
                outcome = try_case(case, bases, runner(self.place), Path(scratch) / "x", rng)
            except (Exception, SystemExit) as error:
                outcome = "failed"
                message = f"{case.file}: {type(error).__name__}: {error}"
            finally:
                resource.setrlimit(resource.RLIMIT_AS, limits)
        more = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak)
        if more > MORE_MEMORY:
            outcome, message = "failed", f"{case.file}: it takes {more >> 20} MB"
        return {
            "outcome": OUTCOMES.index(outcome),
            "command": np.str_(case.command[:40].ljust(40)),
            "kind": np.str_(case.kind[:20].ljust(20)),
            "message": np.str_(message[:300].encode("ascii", "replace").decode().ljust(300)),
            "seconds": time.process_time() - begin,
        }


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> pd.DataFrame:
    """Compute, then write folders.csv, a row a command."""
    place = Path(folder).resolve() / "folders"
    place.mkdir(parents=True, exist_ok=True)
    prepare(place)
    task = FoldersStudy(place)
    found = run_chunks(
        task, N, place / "parts", task.key, jobs, chunk=40, scheduler=scheduler, progress=progress
    )
    table = pd.DataFrame(
        {k: found[k] for k in ("command", "kind", "outcome", "message", "seconds")}
    )
    for name in ("command", "kind", "message"):
        table[name] = table[name].str.strip()
    rows = []
    for command, some in [*table.groupby("command"), ("all", table)]:
        counts = np.bincount(some["outcome"], minlength=len(OUTCOMES))
        rows.append(
            {
                "command": command, "folders": len(some),
                **dict(zip(OUTCOMES, map(int, counts), strict=True)),
                "longest_s": f"{some['seconds'].max():.1f}",
            }
        )  # fmt: skip
    for row in table[table["outcome"] == 2].itertuples():
        print(f"failed: number {row.Index}, {row.command}, {row.kind}: {row.message}", flush=True)
    made = pd.DataFrame(rows)
    made.to_csv(TABLES / "folders.csv", index=False, lineterminator="\n")
    return made
