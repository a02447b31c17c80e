"""The report as the last step of a run."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from bayes_sensor.analysis.job import Progress
from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.results import Results

if TYPE_CHECKING:
    from bayes_sensor.report import Choice


def put_report(results: Results, tell: Progress, choice: Choice | None = None) -> None:
    """Write the report of what the folder holds, with its figures, into the folder."""
    from bayes_sensor.report import write_report

    with results.writing() as stage:
        write_report(results.folder, stage.inside, choice, tell)


@contextmanager
def last_step(results: Results) -> Iterator[None]:
    """Context of a report after a run: if it fails, the message says that all other results are in
    place."""
    again = f"all other results are in place, and bayes-sensor report {results.folder} makes it"
    unforeseen = True
    try:
        yield
        unforeseen = False
    except CampaignError as error:
        unforeseen = False
        raise CampaignError(f"the report was not made: {error}; {again}") from None
    except OSError as error:  # no room, say
        unforeseen = False
        said = f"{error.strerror or error}; the report was not made; {again}"
        raise OSError(error.errno, said, error.filename) from None
    except KeyboardInterrupt:  # who pressed it is told how to go on
        unforeseen = False
        raise
    finally:
        if unforeseen:
            print(f"error: the report was not made; {again}", file=sys.stderr)
