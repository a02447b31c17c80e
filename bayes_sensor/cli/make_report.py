"""The command that rebuilds a report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bayes_sensor.analysis.put_report import put_report
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli.terminal import progress_bar, say
from bayes_sensor.io.results import Results

if TYPE_CHECKING:
    from bayes_sensor.report import Choice


def check_choice(choice: Choice) -> None:
    """Raise CampaignError for a format or a length that there is not."""
    from bayes_sensor.report import FORMATS, PAGES

    for option, word, known in (
        ("--format", choice.form, tuple(FORMATS)), ("--pages", choice.pages, PAGES),
    ):  # fmt: skip
        if word not in known:
            raise CampaignError(
                f"{option} {word[:40]}: there is no such {option[2:].removesuffix('s')}; expected "
                f"one of {', '.join(known)}"
            )


def rebuild_report(folder: Path, quiet: bool, choice: Choice) -> None:
    """Write the report and figures/ again from what is saved."""
    from bayes_sensor.report import FORMATS, check_folder

    check_choice(choice)
    check_folder(folder)
    results = Results(folder)
    with results.locked(), progress_bar("report", quiet) as tell:
        put_report(results, tell, choice)
    say(f"report: {results.path(FORMATS[choice.form])}", quiet)
