"""Every real file through the commands, each with a limit of time and memory.

A file of the recorders has the campaign of ``study_recorders`` or, where that has none, the one
that a stranger would write first: a sensor alone, the signal and the times left to the reader.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas as pd
from drawing import TABLES

COMMANDS = ("check", "fit", "posterior", "gap")
MOST_SECONDS, MOST_BYTES = 900, 4 << 30
"""of a processor, and of address space, for one command"""
LONGEST = 200
"""characters kept of what a command says"""
SUFFIXES = (".csv", ".txt", ".mat", ".parquet")
SETTINGS = '[posterior]\nsampler = "independence"\n'
FIRST = """title = "first try"
[rig]
stages = ["sensor"]

[[experiment]]
name = "1"
file = "{file}"
"""


def files(folder: Path) -> Iterator[Path]:
    """The campaigns, and the data files that belong to none."""
    for part in sorted(p for p in folder.iterdir() if p.is_dir()):
        if (part / "campaign.toml").is_file():
            yield part / "campaign.toml"
        else:
            yield from sorted(p for p in part.iterdir() if p.suffix in SUFFIXES)


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (MOST_SECONDS, MOST_SECONDS + 5))
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))


def outcome(command: str, campaign: Path, out: Path, config: Path) -> dict[str, Any]:
    """Exit code, seconds of a processor, peak memory, warnings and words of one command."""
    words = [sys.executable, "-m", "bayes_sensor", command, str(campaign), "--config", str(config)]
    words += [] if command == "check" else ["--out", str(out)]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=_limited,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    ) as process:  # fmt: skip
        assert process.stdout is not None and process.stderr is not None
        said, error = process.stdout.read(), process.stderr.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    lines = [line for line in said.splitlines() if line]
    remarks = [line for line in lines if line.startswith(("warning:", "remark:"))]
    words = [line for line in lines if line not in remarks and not line.startswith("results:")]
    if process.returncode not in (0, 3):
        words = error.splitlines()[-1:] or ["stopped at the limit"]
    return {
        "exit_code": process.returncode,
        "seconds": used.ru_utime + used.ru_stime,
        "peak_MB": used.ru_maxrss / 1024,
        "traceback": int("Traceback" in error),
        "warnings": len(remarks),
        "said": (words[-1] if command == "check" else words[0]) if words else "",
    }


def tried(folder: Path, known: Mapping[str, str]) -> Iterator[dict[str, Any]]:
    """One row a file; ``known``: campaigns by the name of their file."""
    for path in files(folder):
        name = path.parent.name if path.suffix == ".toml" else path.name
        with TemporaryDirectory() as place:
            campaign = path
            if path.suffix != ".toml":
                (Path(place) / path.name).symlink_to(path)
                campaign = Path(place) / "campaign.toml"
                text = known.get(path.name, FIRST.format(file=path.name))
                campaign.write_text("allow_outside = true\n" + text, encoding="utf-8")
            config = Path(place) / "settings.toml"
            config.write_text(SETTINGS)
            found = {c: outcome(c, campaign, Path(place) / "out", config) for c in COMMANDS}
        each = list(found.values())
        yield {
            "file": name,
            "exit_codes": " ".join(str(row["exit_code"]) for row in each),
            **{f"{command}_s": row["seconds"] for command, row in found.items()},
            "peak_MB": max(row["peak_MB"] for row in each),
            "tracebacks": sum(row["traceback"] for row in each),
            "warnings": max(row["warnings"] for row in each),
            **{command: row["said"][:LONGEST] for command, row in found.items()},
        }


def write_table(folder: Path, known: Mapping[str, str]) -> None:
    """Write real_files.csv; a row as soon as it is known."""
    rows = []
    for row in tried(folder, known):
        rows.append(row)
        table = pd.DataFrame(rows)
        table.to_csv(TABLES / "real_files.csv", index=False, float_format="%.3g")
