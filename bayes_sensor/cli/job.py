"""One run of a command on a campaign: what it computes, what it saves, and what is known so far."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayes_sensor.cli.terminal import Progress, progress_bar
from bayes_sensor.io.results import Results

CHECKPOINT = "checkpoint"
STEPS: dict[str, tuple[str, ...]] = {
    "analyze": (
        "fit",
        "residuals",
        "posterior",
        "predictive",
        "bounds",
        "delays",
        "gap",
        "report",
    ),
    "fit": ("fit", "residuals"),
    "posterior": ("fit", "posterior", "predictive"),
    "bounds": ("fit", "posterior", "bounds"),
    "delays": ("fit", "delays"),
    "gap": ("fit", "gap"),
}
SAVES: dict[str, tuple[str, ...]] = {
    "analyze": ("fit", "residuals", "posterior", "bounds", "delays", "gap", "report"),
    "fit": ("fit", "residuals"),
    "posterior": ("posterior",),
    "bounds": ("bounds",),
    "delays": ("delays",),
    "gap": ("gap",),
}


@dataclass(eq=False)
class Job:
    """One run of a command."""

    command: str
    problem: Any
    overrides: Any
    label: str
    seed: int
    jobs: int
    quiet: bool
    resume: bool
    results: Results
    basis: str
    seconds: dict[str, float] = field(default_factory=dict)
    fit: Any = None
    residuals: Any = None
    posterior: Any = None
    predictive: Any = None
    bounds: Any = None
    delays: Any = None
    gap: Any = None
    no_gap: str = ""
    """reason why the gap could not be diagnosed, in a sentence"""
    options: Mapping[str, Any] = field(default_factory=dict)
    """options of single commands: with_effects, without, nominal, effects, bootstrap"""
    compare_published: bool = False
    """whether to compute what concerns the published sensor, whatever the campaign says"""

    @contextmanager
    def timed(self, name: str) -> Iterator[Progress]:
        """A progress bar, and the time taken."""
        start = time.perf_counter()
        with progress_bar(name, self.quiet) as tell:
            yield tell
        self.seconds[name] = time.perf_counter() - start

    @property
    def checkpoint(self) -> Path:
        """Where unfinished ensembles are kept."""
        return self.results.own_folder(CHECKPOINT)
