"""What a run warns of."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_sensor.analysis.job import Job


def decisive(job: Job) -> list[str]:
    """Caveats of the first line; they are printed before it."""
    found = list(job.fit.caveats)
    if job.posterior is not None:
        found += job.posterior.doubts
    elif job.residuals is not None and not job.residuals.adequate:
        found.append(job.residuals.doubt)
    return found


def warnings_of(job: Job, remarks: Sequence[str]) -> list[str]:
    """All warnings, what concerns the answer first; ``remarks``: on the campaign."""
    from bayes_sensor.io.check import SAME_FLOW

    # what concerns the last answer comes first, since a terminal shows only so many
    found = decisive(job)
    found += [] if job.posterior is None else job.posterior.warnings
    # the fit says it, with consequences
    found += [text for text in remarks if text != SAME_FLOW]
    found += job.fit.warnings
    found += job.left_out.values()
    if job.no_gap:
        found.append(f"not diagnosed: {job.no_gap}")
    return list(dict.fromkeys(found))
