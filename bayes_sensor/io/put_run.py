"""What every command writes: its entry in run.json."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from bayes_sensor.io.results import StagingFolder
from bayes_sensor.io.run_record import now, run_record


class CommandClock:
    """When a command began, and how long it has taken."""

    def __init__(self) -> None:
        self.started = now()
        self._begin = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Seconds since it began."""
        return time.perf_counter() - self._begin


def put_run(
    stage: StagingFolder,
    command: str,
    clock: CommandClock,
    *,
    seed: int,
    settings: Any,
    seconds: Mapping[str, float] | None = None,
    exit_code: int = 0,
    warnings: Sequence[str] = (),
    campaign: str = "",
    files: Mapping[str, str] | None = None,
    basis: str = "",
    command_line: Sequence[str] | None = None,
    steps: Sequence[str] | None = None,
    **more: Any,
) -> None:
    """Put run.json with the entry of this command beside those of earlier ones.

    ``seconds``: by part, where that is not the whole command; ``steps``: those that are done, of a
    command that writes as it goes on.  What rests on no data (a simulation,
    a design) has no ``basis``.  ``more`` stands at the top.
    """
    entry = run_record(
        stage.results.json("run.json"), command, basis=basis, seed=seed, settings=settings,
        campaign=campaign, files=files or {}, started=clock.started,
        seconds={command: clock.seconds} if seconds is None else seconds,
        exit_code=exit_code, warnings=warnings, command_line=command_line,
        steps=steps,
    )  # fmt: skip
    stage.json("run.json", {**entry, **more})
