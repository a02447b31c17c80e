"""The command diffusion: response of the coating by finite elements."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli.put_figure import put_figure
from bayes_sensor.cli.terminal import progress_bar, say
from bayes_sensor.io.put_run import CommandClock, put_run
from bayes_sensor.io.results import Results


def _as_options(message: str) -> str:
    """A message on a coating with its fields written as options of the command line."""
    from bayes_sensor.coating import Coating

    for name in (item.name for item in fields(Coating)):
        option = "--" + name.replace("_", "-")
        message = message.replace(f'{name} = "', f'{option} "').replace(name, option)
    return message


def solve_diffusion(out: Path, quantities: Mapping[str, str], tolerance: float, quiet: bool) -> int:
    """Solve the coating and write diffusion.json with its figure; the exit code."""
    from bayes_sensor import figures
    from bayes_sensor.coating import Coating, solve

    clock = CommandClock()
    try:
        coating = Coating().with_quantities(**quantities)
    except ValueError as error:
        raise CampaignError(_as_options(str(error))) from None
    if not 1e-7 < tolerance < 0.1:
        raise CampaignError(
            f"--tolerance: expected between 1e-7 and 0.1, got {tolerance}; try 5e-4"
        )
    results = Results(out)
    with results.locked():
        with progress_bar("diffusion", quiet) as tell:
            tell(0.1, "finite elements")
            response = solve(coating, tolerance)
        record = response.to_json()
        code = 3 if record.get("status") else 0
        with results.writing() as stage:
            stage.json("diffusion.json", record)
            put_figure(stage, "diffusion", figures.diffusion(record))
            put_run(
                stage, "diffusion", clock, seed=0, settings={**quantities, "tolerance": tolerance},
                exit_code=code, warnings=[record["status"]] if record.get("status") else [],
            )  # fmt: skip
    say(
        f"63.2 % after {record['tau63_ms']:.3g} ms, 90 % after {record['t90_ms']:.3g} ms, "
        f"nearest single lag {record['tau_fit_ms']:.3g} ms",
        quiet,
    )
    if code == 3:
        print(f"not converged: {record['status']}", file=sys.stderr)
    say(f"results: {out}{os.sep}diffusion.json", quiet)
    return code
