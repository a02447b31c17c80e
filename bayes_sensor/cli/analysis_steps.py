"""Steps of the commands, in order: read, fit, residuals, posterior, bounds, delays, report."""

from __future__ import annotations

import io
import logging
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import STAGES, Campaign, CampaignError, counted
from bayes_sensor.cli.logged_notes import noted
from bayes_sensor.fit.traces import make_traces, save_traces
from bayes_sensor.io.json_files import plain, sha256
from bayes_sensor.io.results import Results, Stage
from bayes_sensor.io.run_record import campaign_record, digest, now, of_other_data, run_record

LOG = logging.getLogger(__name__)
Progress = Callable[[float, str], None]
CHECKPOINT = "checkpoint"
MOST_DRAWS = 4000
"""number of draws for the summary of response times"""
MOST_WARNINGS = 6
"""lines of warnings in a terminal"""
STEPS: dict[str, tuple[str, ...]] = {
    "analyze": (
        "fit",
        "residuals",
        "posterior",
        "predictive",
        "bounds",
        "delays",
        "gap",
        "report",
    ),
    "fit": ("fit", "residuals"),
    "posterior": ("fit", "posterior", "predictive"),
    "bounds": ("fit", "posterior", "bounds"),
    "delays": ("fit", "delays"),
    "gap": ("fit", "gap"),
}
SAVES: dict[str, tuple[str, ...]] = {
    "analyze": ("fit", "residuals", "posterior", "bounds", "delays", "gap", "report"),
    "fit": ("fit", "residuals"),
    "posterior": ("posterior",),
    "bounds": ("bounds",),
    "delays": ("delays",),
    "gap": ("gap",),
}


@contextmanager
def progress_bar(label: str, quiet: bool) -> Iterator[Progress]:
    """A bar on stderr; nothing if stderr is not a terminal."""
    if quiet or not sys.stderr.isatty():
        yield lambda fraction, text: None
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    # a descriptor of its own: it goes on while everything else is muted; names of experiments may
    # hold letters that it cannot show
    screen = os.fdopen(os.dup(2), "w", encoding=sys.stderr.encoding, errors="backslashreplace")
    bar = Progress(
        TextColumn("{task.description:<12}"),
        BarColumn(),
        TextColumn("{task.fields[word]}"),
        TimeElapsedColumn(),
        console=Console(file=screen),
        transient=True,
    )
    with screen, bar:
        task = bar.add_task(label, total=1.0, word="")
        yield lambda fraction, text: bar.update(task, completed=fraction, word=escape(text[:40]))


@contextmanager
def muted() -> Iterator[None]:
    """Suppresses output of this process and of those it starts; exceptions pass.

    emcee prints the arguments of any call that was stopped, also by Ctrl-C, in every process.
    """
    sink = io.StringIO()
    sys.stdout.flush()
    sys.stderr.flush()
    kept, null = [os.dup(1), os.dup(2)], os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 1)
        os.dup2(null, 2)
        with redirect_stdout(sink), redirect_stderr(sink):
            yield
    finally:
        for descriptor, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, descriptor)
            os.close(copy)
        os.close(null)


def say(text: str, quiet: bool) -> None:
    """A line on stdout unless quiet."""
    if not quiet:
        print(text, flush=True)


# --------------------------------------------------------------------------- reading


def load(path: Path) -> tuple[Campaign, Any, tuple[str, ...]]:
    """Campaign, rows of its understood content, and remarks."""
    from bayes_sensor.io.check import campaign_remarks, campaign_rows
    from bayes_sensor.io.readers import read_campaign

    campaign = read_campaign(path)
    return campaign, campaign_rows(campaign), campaign_remarks(campaign)


def print_check(path: Path, quiet: bool, config: Path | None = None) -> None:
    """Print what was understood of a campaign; settings are checked against it."""
    from bayes_sensor.cli.overrides import fit_bounds, make_problem, read_overrides

    overrides = read_overrides(config)
    label = config.name if config is not None else "--config"
    _check_methods(overrides.bounds.methods, label)
    campaign, table, remarks = load(path)
    fit_bounds(make_problem(campaign, overrides, label), overrides, label)
    if quiet:
        return
    kind = "a design without data" if campaign.is_design else f"{campaign.n_samples} samples in use"
    print(f"{campaign.title}: {counted(len(campaign), 'experiment')}, {kind}")
    unit = campaign.signal_unit
    columns = [
        ("experiment", "experiment", "{}"),
        ("samples", "samples", "{}"),
        ("used", "used", "{}"),
        ("interval", "interval_s", "{:.4g} s"),
        ("Q (L/min)", "total_flow_L_min", "{:.4g}"),
        ("test gas (%)", "concentration_percent", "{:.3g}"),
        ("on (s)", "commanded_on_s", "{:.4f}"),
        ("off (s)", "commanded_off_s", "{:.4f}"),
        (f"baseline ({unit})", "baseline_V", "{:.4g}"),
        (f"step ({unit})", "step_V", "{:.4g}"),
        (f"noise ({unit})", "noise_V", "{:.3g}"),
    ]
    rows = [[title for title, _, _ in columns]]
    for row in table:
        rows.append([_cell(row[key], pattern) for _, key, pattern in columns])
    widths = [max(len(row[i]) for row in rows) for i in range(len(columns))]
    for row in rows:
        cells = [
            text.ljust(w) if i == 0 else text.rjust(w)
            for i, (text, w) in enumerate(zip(row, widths, strict=True))
        ]
        print("  ".join(cells).rstrip())
    print(f"rig: {', '.join(STAGES)}; which lag is the sensor: {campaign.sensor_is}")
    for name, info in campaign.side_information.items():
        print(f"known beforehand: {name} = {info.mean:g} +- {info.sd:g}")
    for remark in remarks:
        print(f"remark: {remark}")


def _cell(value: Any, pattern: str) -> str:
    if isinstance(value, float) and np.isnan(value):
        return "-"
    return pattern.format(value)


# --------------------------------------------------------------------------- the pipeline


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
    results: Results
    basis: str
    seconds: dict[str, float] = field(default_factory=dict)
    fit: Any = None
    residuals: Any = None
    posterior: Any = None
    predictive: Any = None
    bounds: Any = None
    delays: Any = None
    gap: Any = None
    no_gap: str = ""
    """reason why the gap could not be diagnosed, in a sentence"""
    options: Mapping[str, Any] = field(default_factory=dict)
    """options of single commands: with_effects, without, nominal, effects, bootstrap"""

    @contextmanager
    def timed(self, name: str) -> Iterator[Progress]:
        """A progress bar, and the time taken."""
        start = time.perf_counter()
        with progress_bar(name, self.quiet) as tell:
            yield tell
        self.seconds[name] = time.perf_counter() - start

    @property
    def checkpoint(self) -> Path:
        """Where unfinished ensembles are kept."""
        return self.results.own_folder(CHECKPOINT)


def _do_fit(job: Job) -> None:
    from bayes_sensor.cli.overrides import fit_bounds
    from bayes_sensor.fit import fit_least_squares

    asked = job.overrides.fit
    with job.timed("fit") as tell:
        job.fit = fit_least_squares(
            job.problem,
            seed=job.seed,
            swarms=asked.swarms,
            particles=asked.particles,
            bounds=fit_bounds(job.problem, job.overrides, job.label),
            euler=asked.euler and "fit" in SAVES[job.command],
            de=asked.differential_evolution,
            progress=tell,
        )


def _do_residuals(job: Job) -> None:
    from bayes_sensor.residuals import diagnose_residuals

    with job.timed("residuals"):
        job.residuals = diagnose_residuals(job.problem, job.fit)


def _do_posterior(job: Job) -> None:
    from bayes_sensor.posterior import sample_posterior

    methods = job.overrides.bounds.methods
    if job.command == "bounds" and methods is not None:
        from bayes_sensor.bounds import METHODS

        if not any(METHODS[name].needs_posterior for name in methods):
            return
    with job.timed("posterior") as tell, muted():
        job.posterior = sample_posterior(
            _problem_with_effects(job),
            job.fit,
            seed=job.seed,
            sampler=job.overrides.posterior.sampler,
            settings=job.overrides.sampler_settings(),
            jobs=job.jobs,
            checkpoint=job.checkpoint,
            resume=job.resume,
            progress=_watching(job, tell),
        )


def _watching(job: Job, tell: Progress) -> Progress:
    """``tell``, with a message if ``--resume`` finds ensembles that cannot be continued."""
    marker = job.checkpoint / "run.json"
    if not (job.resume and marker.is_file() and any(job.checkpoint.glob("ensemble-*.npz"))):
        return tell
    before = [marker.read_bytes()]

    def watched(fraction: float, text: str) -> None:
        if before and marker.read_bytes() != before[0]:  # the sampler has begun anew
            before.clear()
            LOG.warning(
                "--resume: the unfinished run in %s is of other data or settings, such as another "
                "--seed, and is not used", job.checkpoint,
            )  # fmt: skip
        tell(fraction, text)

    return watched


def _do_predictive(job: Job) -> None:
    from bayes_sensor.checks.predictive import check_predictive, checked

    if job.options.get("with_effects"):
        return  # replicates are drawn from the cascade
    with job.timed("predictive"):
        job.predictive = check_predictive(job.posterior, seed=job.seed)
    job.posterior = checked(job.posterior, job.predictive)


WHOSE_COATING = "which lag is the sensor's is not known, so no diffusivity can be told from it"


def _coating(job: Job) -> dict[str, Any]:
    """Response times of sensor and chain; for ``analyze`` also the diffusivity that follows from
    tau.

    If it is not known which lag is the sensor's, there is a row for each, with its probability.
    """
    from bayes_sensor.rig.response_times import response_time_table

    undecided = job.posterior.naming.order == "undecided"
    tau, tau_v, volume = (job.posterior.of(name) for name in ("tau_s", "tau_v_s", "V_mL"))
    some = slice(None, None, max(1, len(tau) // MOST_DRAWS))
    flows = [e.total_flow for e in job.problem.campaign]
    rows = response_time_table(tau[some], tau_v[some], volume[some], flows).to_dict("records")
    if undecided:
        rows[:1] = [_sensor_row(each) for each in job.posterior.assignments]
    found = None
    if job.command == "analyze" and not undecided:
        # three seconds that a posterior alone need not wait for
        from bayes_sensor.coating import infer_d_zif8

        found = infer_d_zif8(tau, seed=job.seed).to_json()
    left_out = {"d_zif8_left_out": WHOSE_COATING} if undecided else {}
    return {"response_times": rows, "d_zif8": found, **left_out}


def _sensor_row(assignment: Mapping[str, Any]) -> dict[str, Any]:
    """Response times of the sensor, if its lag is that of an assignment of the posterior."""
    from bayes_sensor.rig.response_times import response_times

    ends = {"": "q50", "_lo": "q2.5", "_hi": "q97.5"}
    # of one lag they rise with it, so that their quantiles are those of its quantiles
    found = response_times([np.array([assignment["tau_s"][key] for key in ends.values()])])
    times = {
        f"{name}{end}_s": float(value)
        for name in ("t10", "t63", "t90", "rise")
        for end, value in zip(ends, getattr(found, name), strict=True)
    }
    about = {key: assignment[key] for key in ("sensor_is", "probability")}
    return {"system": "sensor", "total_flow_L_per_min": None, **about, **times}


def _do_bounds(job: Job) -> None:
    from bayes_sensor.bounds import compare_bounds

    asked = job.overrides.bounds
    with job.timed("bounds") as tell:
        compared = compare_bounds(
            job.problem,
            job.fit,
            job.posterior,
            methods=asked.methods,
            seed=job.seed,
            progress=tell,
            n_resamples=asked.resamples,
        )
        record = compared.to_json()
        record["naive"] = naive_bounds(job)
        record["step_study"] = _study(job) if asked.step_study else None
        record["what_makes_tau_hard"] = record["what_would_help"] = None
        record["not_explained"] = None
        theta = _named_theta(job) if asked.explain else None
        if asked.explain and theta is None:
            record["not_explained"] = NOT_EXPLAINED
        elif theta is not None:
            tell(0.95, "what makes tau hard")
            record["what_makes_tau_hard"] = _hardness(job, theta, compared)
            record["what_would_help"] = _help(job, theta)
    job.bounds = (compared, record)


NOT_EXPLAINED = (
    "which lag is the sensor's is not known, so what makes tau hard and what would help is not "
    "told; say [rig] sensor_is in the campaign"
)


def reference_theta(job: Job) -> Any:
    """Point at which the classical bounds are compared, lags by size: the posterior's medians, else
    the fit."""
    vector = np.array(job.fit.theta_hat, dtype=float)
    if job.posterior is not None:
        vector = np.median(job.posterior.draws, axis=0)
    return vector


def _naming(job: Job) -> Any:
    """The assignment of the lags, from the draws if there are any, else from the fit."""
    return (job.fit if job.posterior is None else job.posterior).naming


def _named_theta(job: Job) -> dict[str, Any] | None:
    """The reference point by name; None if it is not known which lag is the sensor's."""
    from bayes_sensor.fit.side_information import named_parameters

    naming, theta = _naming(job), reference_theta(job)
    if naming.order == "undecided":
        return None
    nested: dict[str, Any] = job.problem.layout.nested(theta)
    return {**nested, **named_parameters(naming, theta)}


def naive_bounds(job: Job) -> dict[str, Any]:
    """One standard deviation of tau, tau_v, V by the classical bounds at one common point.

    The bounds of ``methods`` are computed at each method's estimate, which may be tau = 0.  These
    are computed at the posterior's median, so that they can be compared.
    """
    from bayes_sensor.bounds import METHODS, cramer_rao

    vector, sigma = reference_theta(job), float(job.fit.rms)
    names, factors = zip(*_naming(job).labels, strict=True)
    found: dict[str, Any] = {
        "at": plain(dict(zip(names, vector[:3] * factors, strict=True))),
        "sigma_V": sigma,
    }
    for name, method in METHODS.items():
        if method.cramer_rao is None:
            continue
        try:
            bound = cramer_rao(job.problem, vector, sigma, **method.cramer_rao)
            found[name] = plain(dict(zip(names, bound.sd[:3] * factors, strict=True)))
        except CampaignError:  # forward Euler is unstable for a tau below half a sample
            found[name] = None
    return found


def _study(job: Job) -> list[dict[str, Any]] | None:
    from bayes_sensor.bounds import step_study
    from bayes_sensor.rig.layout import SHARED

    try:
        table = step_study(job.problem, reference_theta(job), float(job.fit.rms))
    except CampaignError:
        return None
    names, factors = zip(*_naming(job).labels, strict=True)
    table[list(SHARED)] *= np.array(factors)
    table = table.rename(columns=dict(zip(SHARED, names, strict=True)))
    rows: list[dict[str, Any]] = table.to_dict(orient="records")
    return rows


def _hardness(job: Job, theta: dict[str, Any], compared: Any) -> dict[str, Any]:
    from bayes_sensor.bounds import explain_tau

    told = explain_tau(job.problem, theta, likelihood=compared.likelihood)
    record: dict[str, Any] = told.to_json()
    return record


def _help(job: Job, theta: dict[str, Any]) -> list[dict[str, Any]]:
    from bayes_sensor.design import what_if

    rows: list[dict[str, Any]] = what_if(job.problem, theta).to_dict("records")
    return rows


def _do_delays(job: Job) -> None:
    from bayes_sensor.checks.delays import regress_delays

    with job.timed("delays"):
        job.delays = regress_delays(job.problem, job.fit, job.posterior or _saved_spreads(job))


class SavedSpreads:
    """Posterior standard deviations read back from ``posterior.json``."""

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.parameters = parameters

    def sd(self, name: str) -> float:
        """Posterior standard deviation of a flat name."""
        return float(self.parameters[name]["sd"])


def _saved_posterior(job: Job) -> dict[str, Any] | None:
    """``posterior.json`` of the results folder, if it has the same data and settings."""
    run = job.results.json("run.json")
    saved: dict[str, Any] | None = job.results.json("posterior.json")
    commands = {} if run is None else run["commands"]
    entries = [commands[name] for name in ("posterior", "analyze") if name in commands]
    if saved is None or not entries:
        return None
    newest = max(entries, key=lambda entry: entry["finished"])  # which has written it
    return saved if newest["basis_sha256"] == job.basis else None


def _saved_spreads(job: Job) -> SavedSpreads | None:
    """Spreads of a posterior that was saved and had converged."""
    saved = _saved_posterior(job)
    return SavedSpreads(saved["parameters"]) if saved is not None and saved["converged"] else None


def _problem_with_effects(job: Job) -> Any:
    """The problem of the posterior: with the effects that were asked for in its model."""
    names = job.options.get("with_effects") or ()
    if not names:
        return job.problem
    from bayes_sensor.diagnosis.effects.effect_model import with_effects
    from bayes_sensor.rig.layout import Layout

    theta = Layout.of(job.problem.campaign).flat(job.fit.theta_hat[: job.problem.layout.n_mean])
    return with_effects(job.problem, names, theta)


def _do_gap(job: Job) -> None:
    from bayes_sensor.diagnosis import diagnose_gap

    try:
        with job.timed("gap") as tell:
            job.gap = diagnose_gap(
                job.problem.campaign,
                job.fit,
                seed=job.seed,
                jobs=job.jobs,
                progress=tell,
                **{k: v for k, v in job.options.items() if k != "with_effects"},
            )
    except CampaignError as error:
        if job.command != "analyze":
            raise
        job.no_gap = str(error)  # records too short for it; what was found before is kept


_DO: dict[str, Callable[[Job], None]] = {
    "fit": _do_fit,
    "residuals": _do_residuals,
    "posterior": _do_posterior,
    "predictive": _do_predictive,
    "bounds": _do_bounds,
    "delays": _do_delays,
    "gap": _do_gap,
}


def _put(job: Job, stage: Stage) -> None:
    """Write the results of this command."""
    from bayes_sensor.fit.samples import make_samples, save_samples

    saves = SAVES[job.command]
    unit = {"signal_unit": job.problem.campaign.signal_unit}
    if "fit" in saves:
        record = job.fit.to_json()
        if job.residuals is not None and not job.residuals.adequate:
            record["warnings"] = [*record["warnings"], job.residuals.doubt]
        stage.json("fit.json", record)
        save_traces(stage.path("traces.npz"), make_traces(job.problem, job.fit))
        save_samples(stage.path("samples.npz"), make_samples(job.problem, job.fit))
    if "residuals" in saves:
        stage.json("residuals.json", job.residuals.to_json())
    if "posterior" in saves:
        record = job.posterior.to_json()
        record.pop("seconds", None)  # times are in run.json: the same run gives the same file
        effects = list(job.options.get("with_effects") or ())
        record["with_effects"] = effects
        before = _saved_posterior(job)
        if not effects or before is None:
            stage.drop.append("posterior_without_effects.json")  # nothing to stand beside
        elif not before.get("with_effects"):
            # the posterior without effects is kept, so that both can be compared
            stage.json("posterior_without_effects.json", before)
        stage.json("posterior.json", record)
        job.posterior.save(stage.path("posterior.nc"))
        if job.predictive is not None:
            stage.json("predictive.json", {**job.predictive.to_json(), **unit})
        else:
            stage.drop.append("predictive.json")  # it speaks of another posterior
        stage.json("coating.json", {**_coating(job), **unit})
    if "bounds" in saves:
        compared, record = job.bounds
        stage.json("bounds.json", record)
        compared.to_csv(stage.path("bounds.csv"))
    if "delays" in saves:
        stage.json("delays.json", {**job.delays.to_json(), **unit})
    if job.no_gap:
        stage.drop += ["gap.json", "gap_where.csv", "gap_which.csv"]
    elif "gap" in saves:
        stage.json("gap.json", job.gap.to_json())
        for name in ("where", "which"):
            stage.text(f"gap_{name}.csv", getattr(job.gap, name).to_csv(index=False))


def run(
    command: str,
    campaign_path: Path,
    out: Path,
    *,
    seed: int,
    jobs: int,
    quiet: bool,
    config: Path | None,
    resume: bool = False,
    posterior: Mapping[str, Any] | None = None,
    options: Mapping[str, Any] | None = None,
    patience: float = 0.0,
    command_line: Sequence[str] | None = None,
) -> int:
    """Run a command and write its results; the exit code.

    ``patience``: seconds to wait for another run that holds ``out``.
    """
    from bayes_sensor.cli.overrides import fit_bounds, make_problem, read_overrides

    started = now()
    label = config.name if config is not None else "--config"
    # everything that can be wrong with the input is found before anything is written
    overrides = read_overrides(config, posterior)
    _check_methods(overrides.bounds.methods, label)
    begin = time.perf_counter()
    campaign, table, remarks = load(campaign_path)
    read_seconds = time.perf_counter() - begin
    if campaign.is_design:
        raise CampaignError(
            f"{campaign_path.name}: this is a design without data, but {command} needs measured "
            "experiments; give every experiment a file, or run simulate first"
        )
    problem = make_problem(campaign, overrides, label)
    fit_bounds(problem, overrides, label)
    record = campaign_record(campaign, remarks, table)
    basis = digest(record, {"noise": overrides.noise.model_dump(), "priors": overrides.priors})
    files = _files(campaign_path, campaign, config)
    results = Results(out)
    if command == "gap" and overrides.noise != type(overrides.noise)():
        LOG.warning(
            "%s: [noise] does not act on gap, which takes the noise of every record from it", label
        )
    with results.locked(patience):
        results.own_folder(CHECKPOINT)  # refused now rather than after the fit
        job = Job(
            command, problem, overrides, label, seed, jobs, quiet, resume, results, basis,
            {"read": read_seconds}, options=options or {},
        )  # fmt: skip
        for name in STEPS[command]:
            if name in _DO:
                _DO[name](job)
        code = _exit_code(job)
        with results.writing() as stage:
            stage.json("campaign.json", record)
            _put(job, stage)
            entry = run_record(
                results.json("run.json"),
                command,
                basis=basis,
                seed=seed,
                settings=overrides.record(),
                campaign=str(campaign_path),
                files=files,
                started=started,
                seconds=job.seconds,
                exit_code=code,
                warnings=[*_warnings(job, remarks), *noted()],
                command_line=command_line,
            )
            stage.json("run.json", {**entry, "signal_unit": campaign.signal_unit})
            if "report" in SAVES[command]:
                stage.drop.append("report.html")  # it speaks of other results
        if "report" in SAVES[command]:  # all else is in place by now, whatever becomes of it
            with job.timed("report") as tell, last_step(results):
                put_report(results, tell)
        if code == 0 and job.posterior is not None:
            import shutil

            shutil.rmtree(job.checkpoint, ignore_errors=True)
    _summary(job, remarks, code)
    return code


def _check_methods(methods: Sequence[str] | None, label: str) -> None:
    if methods is None:
        return
    import difflib

    from bayes_sensor.bounds import METHODS

    for name in methods:
        if name not in METHODS:
            close = difflib.get_close_matches(name, list(METHODS), n=1)
            hint = f'write "{close[0]}"' if close else f"known are {', '.join(METHODS)}"
            raise CampaignError(f"{label}: [bounds] methods: unknown method '{name[:80]}'; {hint}")


def _files(path: Path, campaign: Campaign, config: Path | None) -> dict[str, str]:
    files = {path.name: sha256(path)}
    names = [Path(e.source).name for e in campaign]
    for e, name in zip(campaign, names, strict=True):
        if e.source:  # with their folders where two files are called alike
            files[e.source if names.count(name) > 1 else name] = e.sha256
    if config is not None:
        files[config.name] = sha256(config)
    return files


def _exit_code(job: Job) -> int:
    bad = not job.fit.converged
    bad = bad or (job.posterior is not None and not job.posterior.converged)
    return 3 if bad else 0


def _decisive(job: Job) -> list[str]:
    """Caveats of the first line; they are printed before it."""
    found = list(job.fit.caveats)
    if job.posterior is not None:
        found += job.posterior.doubts
    elif job.residuals is not None and not job.residuals.adequate:
        found.append(job.residuals.doubt)
    return found


def _warnings(job: Job, remarks: Sequence[str]) -> list[str]:
    from bayes_sensor.io.check import SAME_FLOW

    # what concerns the last answer comes first, since a terminal shows only so many
    found = _decisive(job)
    found += [] if job.posterior is None else job.posterior.warnings
    found += [text for text in remarks if text != SAME_FLOW]  # the fit says it, with consequences
    found += job.fit.warnings
    if job.no_gap:
        found.append(f"not diagnosed: {job.no_gap}")
    return list(dict.fromkeys(found))


def put_report(results: Results, tell: Progress, form: str = "html") -> None:
    """Write the report of what the folder holds, with its figures, into the folder."""
    from bayes_sensor.report import write_report

    with results.writing() as stage:
        write_report(results.folder, stage.inside, form, tell)


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


def _summary(job: Job, remarks: Sequence[str], code: int) -> None:
    """The last lines: result, warnings, missed goals, folder."""
    from bayes_sensor.report import chain_words, headline, number

    command, quiet = job.command, job.quiet
    for sentence in _decisive(job):
        say(f"warning: {sentence}", quiet)
    if command in ("analyze", "posterior", "bounds"):
        bounds = None if job.bounds is None else job.bounds[1]
        record = None if job.posterior is None else job.posterior.to_json()
        found = headline(record, bounds, job.overrides.record())
        if found is not None:
            say(str(found), quiet)
            if found.is_limit and found.limit and not found.hidden:
                say(f"zero is not excluded: tau < {found.limit} (95 %)", quiet)
            if record is not None and not found.hidden:
                say(chain_words(record), quiet)
    if command == "fit":
        unit = job.fit.signal_unit
        say(
            f"{_lags_of_fit(job.fit)}; RMS residual {number(job.fit.rms)} {unit} (intervals: "
            "bounds or posterior)",
            quiet,
        )
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
    if job.gap is not None:
        say(f"gap: {job.gap.verdict.sentence}", quiet)
    elif job.no_gap:
        say(f"not diagnosed: {job.no_gap}", quiet)
    # non-convergence is said below, on stderr
    unsaid = ("NOT converged", "not diagnosed")
    said = set(_decisive(job))
    warnings = [w for w in _warnings(job, remarks) if not w.startswith(unsaid) and w not in said]
    for warning in warnings[:MOST_WARNINGS]:
        say(f"warning: {warning}", quiet)
    if len(warnings) > MOST_WARNINGS:
        place = "the report" if command == "analyze" else "run.json"
        say(f"warning: {len(warnings) - MOST_WARNINGS} more in {place}", quiet)
    if code == 3:
        status = job.fit.status if not job.fit.converged else job.posterior.convergence
        hint = "" if not job.fit.converged else "; more --steps with --resume may help"
        status = status.removeprefix("NOT converged: ").rstrip(".")  # a part of the sentence
        print(f"not converged: {status}{hint}; the results are marked so", file=sys.stderr)
    other = of_other_data(job.results.json("run.json"))
    if other:
        say(
            f"warning: {job.results.folder} also holds {', '.join(other)} of other data or "
            "settings; run them again, or use another --out",
            quiet,
        )
    say(f"{'report' if command == 'analyze' else 'results'}: {_place(job)}", quiet)


def _lags_of_fit(fit: Any) -> str:
    """The fitted lags and volume in words; a lag at the lower end of its search has no value."""
    from bayes_sensor.report import number, time_words

    estimates = fit.estimates()
    volume = estimates.pop("V_mL", None)
    seen = {name: value for name, value in estimates.items() if value is not None}
    said = []
    for name, symbol in (("tau_s", "tau"), ("tau_v_s", "tau_v")):
        if name in estimates:
            value = estimates[name]
            said.append(
                f"{symbol} too short to be seen" if value is None
                else f"{symbol} = {time_words(value)}"
            )  # fmt: skip
    lags = [time_words(value) for name, value in seen.items() if name.startswith("lag_")]
    if lags:
        said.append(f"{'a lag' if len(lags) == 1 else 'lags'} of {' and '.join(lags)}")
    if len(seen) < len(estimates) and fit.order == "undecided":
        said.append("any other is too short to be seen" if seen else "no lag can be seen")
    if fit.order == "undecided":
        said[-1] += " (which is the sensor's is not known: say [rig] sensor_is)"
    if volume is not None:
        said.append(f"V = {number(volume)} mL")
    return ", ".join(said)


def _place(job: Job) -> Path:
    name = "report.html" if job.command == "analyze" else ""
    return job.results.path(name) if name else job.results.folder


# --------------------------------------------------------------------------- other commands


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

    started, begin = now(), time.perf_counter()
    try:
        try:
            coating = Coating().with_quantities(**quantities)
        except ValueError as error:
            raise CampaignError(_as_options(str(error))) from None
        if not 1e-7 < tolerance < 0.1:
            raise ValueError(
                f"--tolerance: expected between 1e-7 and 0.1, got {tolerance}; try 5e-4"
            )
    except ValueError as error:
        raise CampaignError(str(error)) from None
    results = Results(out)
    with results.locked():
        with progress_bar("diffusion", quiet) as tell:
            tell(0.1, "finite elements")
            response = solve(coating, tolerance)
        record = response.to_json()
        code = 3 if record.get("status") else 0
        with results.writing() as stage:
            stage.json("diffusion.json", record)
            figure = figures.diffusion(record)
            stage.text("diffusion.svg", figures.svg(figure))
            stage.binary("diffusion.png", figures.png(figure))
            stage.json(
                "run.json",
                run_record(
                    results.json("run.json"),
                    "diffusion",
                    basis="",
                    seed=0,
                    settings={**quantities, "tolerance": tolerance},
                    campaign="",
                    files={},
                    started=started,
                    seconds={"diffusion": time.perf_counter() - begin},
                    exit_code=code,
                    warnings=[record["status"]] if record.get("status") else [],
                ),
            )
    say(
        f"63.2 % after {record['tau63_ms']:.3g} ms, 90 % after {record['t90_ms']:.3g} ms, "
        f"nearest single lag {record['tau_fit_ms']:.3g} ms",
        quiet,
    )
    if code == 3:
        print(f"not converged: {record['status']}", file=sys.stderr)
    say(f"results: {out}{os.sep}diffusion.json", quiet)
    return code
