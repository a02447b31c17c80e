"""The last lines of a command: result, warnings, what was not reached, where the results are."""

from __future__ import annotations

import sys
from typing import Any

from bayes_sensor.analysis.job import Job
from bayes_sensor.analysis.job_warnings import decisive
from bayes_sensor.cli.terminal import say
from bayes_sensor.io.results import Results
from bayes_sensor.io.run_record import of_other_data

MOST_WARNINGS = 6
"""lines of warnings in a terminal"""


def print_summary(job: Job, results: Results) -> None:
    """The last lines: result, warnings, missed goals, folder."""
    from bayes_sensor.report import chain_words, headline, number

    command, quiet, code = job.command, job.quiet, job.exit_code
    gap = None if job.gap is None else job.gap.to_json()
    if command != "analyze":  # which has said them before the stage that they concern
        for sentence in decisive(job):
            say(f"warning: {sentence}", quiet)
    if command in ("analyze", "posterior", "bounds"):
        bounds = None if job.bounds is None else job.bounds[1]
        record = None if job.posterior is None else job.posterior.to_json()
        found = headline(record, bounds, job.overrides.record(), gap)
        if found is not None:
            say(str(found), quiet)
            if found.is_limit and found.limit and not found.hidden:
                say(f"zero is not excluded: tau < {found.limit} (95 %)", quiet)
            if record is not None and not found.hidden:
                say(chain_words(record, bool(found.without)), quiet)
    if command == "fit":
        say(f"{fit_words(job.fit)} (intervals: bounds or posterior)", quiet)
        if job.fit.n_lags is not None:
            say(f"lags: {job.fit.n_lags.sentence}", quiet)
    if command == "delays":
        for side in ("start", "end"):
            line = getattr(job.delays, side)
            if line is not None and line.slope is not None:
                out = f", without {', '.join(line.outliers)}" if line.outliers else ""
                say(
                    f"{side} delay = {number(line.intercept)} s + {number(line.slope)} L / Q, "
                    f"R2 = {line.r2:.4f}, n = {line.n}{out}",
                    quiet,
                )
            elif line is not None:
                say(f"{side}: {line.status}", quiet)
    if gap is not None:
        from bayes_sensor.diagnosis.how_far_words import how_far_lines

        if command == "gap":
            say(f"gap: {gap['verdict']['sentence']}", quiet)
        for line in how_far_lines(gap):
            say(line, quiet)
    # non-convergence is said below, on stderr
    unsaid = ("NOT converged", "not diagnosed")
    said = set(decisive(job))
    warnings = [w for w in job.warnings if not w.startswith(unsaid) and w not in said]
    for warning in warnings[:MOST_WARNINGS]:
        say(f"warning: {warning}", quiet)
    if len(warnings) > MOST_WARNINGS:
        place = "the report" if command == "analyze" else "run.json"
        say(f"warning: {len(warnings) - MOST_WARNINGS} more in {place}", quiet)
    if code == 3:
        status, hint = _unconverged(job)
        status = status.removeprefix("NOT converged: ").rstrip(".")  # a part of the sentence
        print(f"not converged: {status}{hint}; the results are marked so", file=sys.stderr)
    other = of_other_data(results.json("run.json"))
    if other:
        say(
            f"warning: {results.folder} also holds {', '.join(other)} of other data or "
            "settings; run them again, or use another --out",
            quiet,
        )
    if command != "analyze":
        say(f"results: {results.folder}", quiet)


def _unconverged(job: Job) -> tuple[str, str]:
    """What was not reached, and what may help."""
    if not job.fit.converged:
        return job.fit.status, ""
    if job.posterior is None:
        return (
            "no fast posterior, because no fast sampler can be trusted here",
            "; go on with --resume and without --quick",
        )
    return job.posterior.convergence, "; more --steps with --resume may help"


def fit_words(fit: Any) -> str:
    """The fitted lags and volume, and what is left of the signal."""
    from bayes_sensor.report import number

    return f"{_lags_of_fit(fit)}; RMS residual {number(fit.rms)} {fit.signal_unit}"


def _lags_of_fit(fit: Any) -> str:
    """The fitted lags and volume in words; a lag at the lower end of its search has no value."""
    from bayes_sensor.report import list_words, number, time_words

    estimates = fit.estimates()
    volumes = {name: estimates.pop(name) for name in [*estimates] if name.startswith("V_")}
    seen = {name: value for name, value in estimates.items() if value is not None}
    said = []
    for name, value in estimates.items():
        if name.startswith("tau"):
            kind, bracket, rest = name.partition("[")
            symbol = kind.removesuffix("_s") + bracket + rest
            said.append(
                f"{symbol} too short to be seen" if value is None
                else f"{symbol} = {time_words(value)}"
            )  # fmt: skip
    values = sorted(value for name, value in seen.items() if name.startswith("lag_"))
    lags = [time_words(value) for value in values]
    if lags:
        said.append(f"{'a lag' if len(lags) == 1 else 'lags'} of {list_words(lags)}")
    if len(seen) < len(estimates) and fit.order == "undecided":
        said.append("any other is too short to be seen" if seen else "no lag can be seen")
    if fit.order == "undecided":
        said[-1] += " (which is the sensor's is not known: say [rig] sensor_is)"
    said += [
        f"{name.removesuffix('_mL')} = {number(value)} mL"
        for name, value in volumes.items()
        if value is not None
    ]
    return ", ".join(said)
