"""Write the report of what a results folder holds."""

from __future__ import annotations

from pathlib import Path

from bayes_sensor.analysis.put_report import put_report
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli.terminal import progress_bar, say
from bayes_sensor.io.results import Results


def rebuild_report(folder: Path, quiet: bool, form: str = "html") -> None:
    """Write the report and figures/ again from what is saved."""
    from bayes_sensor.report import FORMATS, read_results

    if form not in FORMATS:
        raise CampaignError(
            f"--format {form[:40]}: there is no such format; expected one of {', '.join(FORMATS)}"
        )
    read_results(folder)
    results = Results(folder)
    with results.locked(), progress_bar("report", quiet) as tell:
        put_report(results, tell, form)
    say(f"report: {results.path(FORMATS[form])}", quiet)
