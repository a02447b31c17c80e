"""What ``analyze`` prints as it goes on: its stages, and a line for each as it completes."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from typing import Any

from bayes_sensor.analysis.job import STAGES, Job
from bayes_sensor.analysis.job_warnings import decisive
from bayes_sensor.cli.terminal import say
from bayes_sensor.io.results import Results


@cache
def _expected() -> dict[str, dict[str, float]]:
    # processor seconds of a stage with compiled code in place; a busy machine takes longer
    text = files("bayes_sensor.cli").joinpath("stage_seconds.json").read_text(encoding="utf-8")
    found: dict[str, dict[str, float]] = json.loads(text)
    return found


def expected_seconds(stage: str, n_experiments: int) -> float:
    """About how long a stage takes, in s, from runs of ``make bench``."""
    of_stage = _expected()[stage]
    return of_stage["s"] + of_stage["s_per_experiment"] * n_experiments


class StageLines:
    """Prints the stages of a job before it begins, and each one's line when it is complete."""

    def __init__(self, results: Results) -> None:
        self.results = results
        self.said: set[str] = set()

    def begun(self, job: Job) -> None:
        """Print the stages with the time that each is expected to take."""
        if job.command != "analyze":
            return
        n = len(job.problem.campaign)
        words = [f"{stage} {expected_seconds(stage, n):.0f} s" for stage in job.stages]
        say(f"stages, about: {', '.join(words)}", job.quiet)

    def finished(self, stage: str, job: Job) -> None:
        """Print the line of a stage, after what it must not be read without."""
        if job.command != "analyze":
            return
        for sentence in decisive(job):
            if sentence not in self.said:
                say(f"warning: {sentence}", job.quiet)
                self.said.add(sentence)
        n = len(job.problem.campaign)
        taken = sum(job.seconds.get(step, 0.0) for step in STAGES[stage])
        times = f"{taken:.1f} s of about {expected_seconds(stage, n):.0f} s"
        say(f"{stage} ({times}): {_LINES[stage](job, self.results)}", job.quiet)


def fit_line(job: Job) -> str:
    """The estimates, without intervals."""
    from bayes_sensor.cli.summary_lines import fit_words

    return fit_words(job.fit)


def checks_line(job: Job) -> str:
    """Whether the noise law holds, and how many lags the data support."""
    found = [job.residuals.verdict]
    if job.fit.n_lags is not None:
        found.append(job.fit.n_lags.sentence)
    return "; ".join(sentence.rstrip(".") for sentence in found)


def posterior_line(job: Job) -> str:
    """tau with its interval, or the lags with theirs."""
    from bayes_sensor.report import headline

    if job.posterior is None:
        return "none: no fast sampler can be trusted here"
    found = headline(job.posterior.to_json(), None, job.overrides.record())
    agreement = job.posterior.agreement
    said = "" if agreement is None else f"{agreement.sentence(job.posterior.sampler)}; "
    return f"{said}{found}"


def bounds_line(job: Job) -> str:
    """What the classical bound alone would have said, and how many methods there are."""
    if job.bounds is None:
        return job.left_out.get("bounds", "none")
    from bayes_sensor.campaign import counted
    from bayes_sensor.report import headline

    record = None if job.posterior is None else job.posterior.to_json()
    found = headline(record, job.bounds[1], job.overrides.record())
    said = f"{counted(len(job.bounds[0].methods), 'method')} side by side"
    return f"{said}; {found.naive}" if found is not None and found.naive else said


def gap_line(job: Job) -> str:
    """The verdict."""
    if job.gap is not None:
        return str(job.gap.verdict.sentence)
    return f"not diagnosed: {job.no_gap}" if job.no_gap else job.left_out.get("gap", "none")


_LINES: dict[str, Callable[[Job, Results], Any]] = {
    "fit": lambda job, results: fit_line(job),
    "fast posterior": lambda job, results: posterior_line(job),
    "checks": lambda job, results: checks_line(job),
    "posterior": lambda job, results: posterior_line(job),
    "bounds": lambda job, results: bounds_line(job),
    "gap": lambda job, results: gap_line(job),
    "report": lambda job, results: results.path("report.html"),
}
