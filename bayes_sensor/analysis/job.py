"""One run of an analysis: what it computes, what it saves, and what is known so far.

The command line and :func:`bayes_sensor.analyze` both take these steps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import cached_property
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
        "fast",
        "lags",
        "residuals",
        "posterior",
        "predictive",
        "bounds",
        "delays",
        "gap",
        "report",
    ),
    "fit": ("fit", "lags", "residuals"),
    "posterior": ("fit", "posterior", "predictive"),
    "bounds": ("fit", "posterior", "bounds"),
    "delays": ("fit", "delays"),
    "gap": ("fit", "gap"),
}
SAVES: dict[str, tuple[str, ...]] = {
    "analyze": ("fit", "fast", "residuals", "posterior", "bounds", "delays", "gap", "report"),
    "fit": ("fit", "residuals"),
    "posterior": ("posterior",),
    "bounds": ("bounds",),
    "delays": ("delays",),
    "gap": ("gap",),
}
STAGES: dict[str, tuple[str, ...]] = {
    "fit": ("fit",),
    "fast posterior": ("fast",),
    "checks": ("lags", "residuals"),
    "posterior": ("posterior", "predictive"),
    "bounds": ("bounds", "delays"),
    "gap": ("gap",),
    "report": ("report",),
}
"""of ``analyze``: the steps after which something is said and written"""
QUICK = ("fit", "fast posterior", "checks", "report")
"""stages of a quick analysis"""


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
    basis: str = ""
    """hash of what is computed: campaign and settings; empty: not known yet"""
    seconds: dict[str, float] = field(default_factory=dict)
    fit: Any = None
    residuals: Any = None
    posterior: Any = None
    """the best that there is so far"""
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
    fast: Any = None
    """posterior by a fast sampler; None where that was given up"""
    quick: bool = False
    """whether to end with the fast posterior"""
    done: list[str] = field(default_factory=list)
    """steps that are taken, by this run or by one that it continues"""
    ahead: Callable[[], Any] | None = None
    """waits for a diagnosis of the gap that another process has begun"""
    bar: Bar = no_bar
    warnings: tuple[str, ...] = ()
    """sentences, what concerns the answer first"""
    muted: Callable[[], AbstractContextManager[None]] = nullcontext
    """keeps what samplers print from the screen"""

    @cached_property
    def campaign_json(self) -> dict[str, Any]:
        """The contents of ``campaign.json``."""
        from bayes_sensor.analysis.read_input import read_input
        from bayes_sensor.io.run_record import campaign_record

        campaign, table, remarks = read_input(self.problem.campaign)
        return campaign_record(campaign, remarks, table)

    @property
    def of_published_sensor(self) -> bool:
        """Whether to compute what concerns the published sensor: as the campaign's coating says, or
        where the comparison is asked for."""
        asked = bool(self.problem.campaign.coating) or self.compare_published
        return asked and bool(self.problem.layout.is_published)

    @property
    def stages(self) -> dict[str, tuple[str, ...]]:
        """The steps of the command in groups: after each, something is said and written."""
        steps = [name for name in STEPS[self.command] if not self._is_needless(name)]
        if self.command != "analyze":
            return {self.command: tuple(steps)}
        kept = {
            stage: tuple(name for name in names if name in steps)
            for stage, names in STAGES.items()
            if not self.quick or stage in QUICK
        }
        return {stage: names for stage, names in kept.items() if names}

    def _is_needless(self, name: str) -> bool:
        from bayes_sensor.posterior.samplers import FASTEST

        # the sampler that was asked for is the fast one itself
        asked = name == "fast" and not self.quick
        return asked and self.overrides.posterior.sampler == FASTEST

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
        bad = bad or (self.quick and self.posterior is None)
        return 3 if bad else 0
