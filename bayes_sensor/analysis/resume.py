"""``analyze --resume``: what an analysis that was begun earlier has finished is not computed again.

Emcee's unfinished ensembles go on by themselves, from :mod:`bayes_sensor.posterior.checkpoints`.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from bayes_sensor import __version__
from bayes_sensor.analysis.job import Job
from bayes_sensor.analysis.saved_records import data_digest, read_record
from bayes_sensor.campaign import CampaignError

LOG = logging.getLogger(__name__)


def take_up_finished(job: Job) -> bool:
    """Take over what an unfinished run of the same job has left, if ``job`` resumes.

    Returns whether results may be written one by one: into a folder that holds none of an earlier
    run, or whose results are those of the run that goes on.  Others stay until they are replaced
    as a whole.
    """
    if job.command != "analyze" or job.results is None:
        return False
    run = job.results.json("run.json")
    if not isinstance(run, Mapping):
        return True
    entry = run.get("commands", {}).get("analyze")
    if not job.resume or not isinstance(entry, Mapping) or not _is_same(job, entry):
        return False
    digest = data_digest(job.problem.campaign)
    for name in entry["steps"]:
        try:
            taken = _take_over(job, name, digest)
        except CampaignError as error:  # damaged: it is computed again
            LOG.warning("--resume: %s", error)
            taken = False
        if not taken:
            break  # what comes later rests on it
        job.done.append(name)
    if "posterior" not in job.done and "fast" in job.done and not job.quick:
        job.done.remove("fast")  # the other sampler begins from it
    seconds = entry.get("seconds", {})
    job.seconds |= {name: seconds[name] for name in job.done if name in seconds}
    return True


def _is_same(job: Job, entry: Mapping[str, Any]) -> bool:
    same = entry.get("basis_sha256") == job.basis and entry.get("seed") == job.seed
    same = same and entry.get("settings") == job.overrides.record() and not job.options
    version = entry.get("versions", {}).get("bayes-sensor")
    return bool(same and version == __version__ and isinstance(entry.get("steps"), list))


def _take_over(job: Job, name: str, digest: str) -> bool:
    """Put the saved result of a step into ``job``; whether there is one."""
    assert job.results is not None
    if name == "lags" or (name == "fast" and not job.quick):
        return True  # the fit's record has the number of lags
    kept = "posterior" if name == "fast" else name
    found = read_record(job.results.folder, kept, job.problem.campaign, digest)
    if found is None:
        return False
    if name == "fast":
        job.posterior = found
    if name == "bounds":
        record = job.results.json("bounds.json")
        found = None if record is None else (found, record)
    setattr(job, name, found)
    return found is not None
