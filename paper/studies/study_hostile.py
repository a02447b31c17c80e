"""Thousands of hostile and broken inputs to every reader: what becomes of each.

The inputs and the judge are those of ``tests/support/bad_inputs.py``: refused with exit code 2 and
one clear message, or read with the right numbers; anything else counts as a failure.  Most are read
in this process, one in ``EVERY`` by ``bayes-sensor check`` or ``fit`` in a process of its own with
limits on memory and time.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import PAPER, TABLES

from bayes_sensor.checks.study_chunks import run_chunks, study_key

sys.path.insert(0, str(PAPER.parent))
from tests.support.bad_inputs import (
    OUTCOMES,
    SECONDS,
    Misjudged,
    check_in_process,
    generate,
    judge,
    remove,
)

SEED = 97
N = 2160
EVERY = 120
"""one input in so many goes to a process of its own"""
MOST_BYTES = 2 << 30
"""of memory that reading may take"""
ADDRESS_SPACE = 6 << 30
"""bytes of addresses for a process of its own: libraries reserve more than they use"""
FAILED = len(OUTCOMES)


@dataclass(frozen=True)
class HostileStudy:
    """The task: bad input number i."""

    @property
    def key(self) -> str:
        """Everything that the numbers depend on, the generator's text included."""
        text = (PAPER.parent / "tests" / "support" / "bad_inputs.py").read_text()
        return study_key("hostile", SEED, EVERY, text)

    def __call__(self, i: int) -> dict[str, Any]:
        """``outcome``, ``reader``, ``kind``, ``message``, ``seconds``, ``peak_MB``, ``own``."""
        (bad,) = generate(SEED, 1, i)
        own = i % EVERY == 0 and bad.kind != "unreadable"
        peak = [0.0]

        def run(path: Path) -> tuple[int, str]:
            if not own:
                return check_in_process(path)
            code, stderr, peak[0] = in_own_process(path, fit=i % (2 * EVERY) == 0)
            return code, stderr

        begin = time.process_time()
        with tempfile.TemporaryDirectory() as place:
            Path(place).chmod(0o755)
            folder = Path(place) / str(i)
            try:
                outcome = judge(bad, folder / "campaign", run)
                found, message = OUTCOMES.index(outcome.kind), outcome.message
            except Misjudged as error:
                found, message = FAILED, str(error)
            remove(folder)
        if not own:
            peak[0] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        if peak[0] * 2**20 > MOST_BYTES:
            found, message = FAILED, f"takes {peak[0]:.0f} MB"
        return {
            "outcome": found,
            "reader": np.str_(bad.reader[:20].ljust(20)),
            "kind": np.str_(bad.kind[:60].ljust(60)),
            "message": np.str_(message[:300].ljust(300)),
            "seconds": time.process_time() - begin,
            "peak_MB": peak[0],
            "own": int(own),
        }


def in_own_process(path: Path, fit: bool) -> tuple[int, str, float]:
    """Exit code and stderr of ``check``, or of ``fit`` where it fails, and peak memory in MB.

    ``fit`` must leave no folder behind where it refuses.
    """

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
        resource.setrlimit(resource.RLIMIT_CPU, (int(3 * SECONDS), int(3 * SECONDS)))

    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "out"
        command = ["fit", str(path), "--out", str(out), "--quiet"] if fit else ["check", str(path)]
        environment = {**os.environ, "PYTHONPATH": str(PAPER.parent)}
        with tempfile.TemporaryFile("w+") as told:
            process = subprocess.Popen(
                [sys.executable, "-m", "bayes_sensor", *command],
                stdout=subprocess.DEVNULL, stderr=told, env=environment, preexec_fn=limit,
            )  # fmt: skip
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            told.seek(0)
            stderr = told.read()
        code = process.returncode
        if code == 2 and fit and out.exists() and any(out.rglob("*.json")):
            raise Misjudged("results were written although the input was refused")
    if fit and code in (0, 3):
        # what can be read may still not converge, and says so
        code, stderr = 0, ""
    return code, stderr, usage.ru_maxrss / 1024


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write hostile.csv (a row a reader), hostile_kinds.csv and the failures."""
    task = HostileStudy()
    results = run_chunks(
        task, N, folder / "hostile", task.key, jobs, chunk=60, scheduler=scheduler,
        progress=progress,
    )  # fmt: skip
    table = pd.DataFrame({k: results[k] for k in ("reader", "kind", "outcome", "message", "own")})
    for name in ("reader", "kind", "message"):
        table[name] = table[name].str.strip()
    counted(table, ["reader"], results).to_csv(TABLES / "hostile.csv", index=False)
    counted(table, ["reader", "kind"], results).to_csv(TABLES / "hostile_kinds.csv", index=False)
    for row in table[table["outcome"] == FAILED].itertuples():
        print(f"failed: number {row.Index}, {row.reader}, {row.kind}: {row.message}", flush=True)


def counted(table: pd.DataFrame, by: list[str], results: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """How many inputs of each sort ended how, with all of them together at the end."""
    names = [*OUTCOMES, "failed"]
    rows = []
    groups = [*table.groupby(by, sort=False)]
    for key, some in [*groups, (("all",) * len(by), table)]:
        counts = np.bincount(some["outcome"], minlength=len(names))
        rows.append(
            {
                **dict(zip(by, key, strict=True)), "inputs": len(some),
                **{name: int(n) for name, n in zip(names, counts, strict=True)},
                "own process": int(some["own"].sum()),
                "longest (s)": f"{results['seconds'][some.index].max():.2f}",
                "peak memory (MB)": f"{results['peak_MB'][some.index].max():.0f}",
            }
        )  # fmt: skip
    return pd.DataFrame(rows)
