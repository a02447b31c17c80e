"""One run of an analysis: what it computes, what it saves, and what is known so far.

The command line and :func:`bayes_sensor.analyze` both take these steps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.results import Results
from bayes_sensor.likelihood.held_values import refuse_held

Progress = Callable[[float, str], None]
"""called with the fraction done and a word"""
Bar = Callable[[str], AbstractContextManager[Progress]]
"""shows the progress of the step of a name"""

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


def no_bar(name: str) -> AbstractContextManager[Progress]:
    """Shows nothing."""
    return nullcontext(lambda fraction, text: None)


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
    results: Results | None
    """where the results go; None: nowhere"""
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
    left_out: dict[str, str] = field(default_factory=dict)
    """why a step of :attr:`command` was not taken, by step, in a sentence"""
    options: Mapping[str, Any] = field(default_factory=dict)
    """options of single commands: with_effects, without, nominal, effects, bootstrap"""
    compare_published: bool = False
    """whether to compute what concerns the published sensor, whatever the campaign says"""
    bar: Bar = no_bar
    warnings: tuple[str, ...] = ()
    """sentences, what concerns the answer first"""
    muted: Callable[[], AbstractContextManager[None]] = nullcontext
    """keeps what samplers print from the screen"""

    @contextmanager
    def timed(self, name: str) -> Iterator[Progress]:
        """A progress bar, and the time taken."""
        start = time.perf_counter()
        with self.bar(name) as tell:
            yield tell
        self.seconds[name] = time.perf_counter() - start

    def carried(self, name: str) -> bool:
        """Whether a step carries the parameters that are held; if not ``analyze`` leaves it out.

        Raises CampaignError where the step is what the command is for.
        """
        try:
            refuse_held(self.problem, name)
        except CampaignError as error:
            if self.command != "analyze":
                raise
            self.left_out[name] = str(error)
        return name not in self.left_out

    @property
    def checkpoint(self) -> Path | None:
        """Where unfinished ensembles are kept; None where nothing is written."""
        return None if self.results is None else self.results.own_folder(CHECKPOINT)

    @property
    def exit_code(self) -> int:
        """3 where the fit or the posterior has not converged, else 0."""
        bad = self.fit is not None and not self.fit.converged
        bad = bad or (self.posterior is not None and not self.posterior.converged)
        return 3 if bad else 0
