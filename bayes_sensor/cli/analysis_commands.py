"""The commands on one campaign: their options, and what they call.

Numerical rooms are imported only by the command that needs them, so that ``--help`` answers at
once.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from bayes_sensor.cli.application import app
from bayes_sensor.cli.options import (
    DEFAULT_JOBS,
    CampaignFile,
    CommandRun,
    Jobs,
    Quiet,
    Reported,
    Sampler,
    Sampling,
    Unused,
    UnusedConfig,
    UnusedJobs,
    UnusedSeed,
    given,
    settings_file,
    with_groups,
)


def _run(command: str, common: CommandRun, **more: Any) -> None:
    from bayes_sensor.cli.pipeline import run_command

    given_to_all = asdict(common)
    raise typer.Exit(run_command(command, given_to_all.pop("campaign"), **given_to_all, **more))


@dataclass(frozen=True)
class AnalyzeRun(CommandRun):
    """The same, on both of two cores."""

    jobs: Jobs = DEFAULT_JOBS


@app.command()
@with_groups
def analyze(
    run: AnalyzeRun,
    sampling: Sampling,
    reported: Reported,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Only fit, fast posterior and a short report."),
    ] = False,
) -> None:
    """Everything from the fit to the gap, with report and figures."""
    choice = reported.choice(jobs=run.jobs)
    _run("analyze", run, posterior=sampling.settings, report=choice, quick=quick)


@dataclass(frozen=True)
class OneProcessRun(CommandRun):
    """The same, of a command that one process does."""

    jobs: UnusedJobs = 1


@app.command()
@with_groups
def fit(run: OneProcessRun) -> None:
    """Particle swarm and refinement, residual diagnostics."""
    _run("fit", run)


@app.command()
@with_groups
def posterior(
    run: CommandRun,
    sampling: Sampling,
    with_effect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="With this effect in the model; repeatable, NAME:FORM for a form."
        ),
    ] = None,
    own_effects: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE.py", help="Effects of your own for --with-effect; the file is executed."
        ),
    ] = None,
    with_discrepancy: Annotated[
        bool,
        typer.Option(
            "--with-discrepancy",
            help="With a smooth discrepancy in the model, for a cause that is not listed.",
        ),
    ] = False,
) -> None:
    """MCMC; interrupted runs continue with --resume."""
    chosen: dict[str, Any] = {}
    if with_effect or own_effects:
        from bayes_sensor.diagnosis.effects.effect_model import chosen_effects

        chosen = chosen_effects(with_effect or (), _read_own(own_effects), "--with-effect")
    if with_effect and with_discrepancy:
        raise typer.BadParameter(
            "expected one of --with-effect and --with-discrepancy, but both are given: leave one "
            "out; a discrepancy stands for a cause that no effect explains"
        )
    options = {"with_effects": chosen, "with_discrepancy": with_discrepancy}
    _run("posterior", run, posterior=sampling.settings, options=options)


@app.command()
@with_groups
def bounds(run: CommandRun, sampler: Sampler = None) -> None:
    """Every bound method side by side."""
    _run("bounds", run, posterior=given(sampler=sampler))


@app.command()
@with_groups
def delays(run: OneProcessRun) -> None:
    """Regressions of start and end delay on 1/Q."""
    _run("delays", run)


def _read_own(files: list[Path] | None) -> list[Any]:
    from bayes_sensor.diagnosis.effects.user_effects import read_effects

    return [effect for path in files or () for effect in read_effects(path)]


@dataclass(frozen=True)
class GapRun(CommandRun):
    """The same, with words on what of the settings acts on the gap."""

    config: Annotated[
        Path | None, settings_file("Settings of its fit; [noise] does not act here.")
    ] = None


@app.command()
@with_groups
def gap(
    run: GapRun,
    without: Annotated[
        list[str] | None,
        typer.Option(metavar="EFFECT", help="Leave this effect out; repeatable, or A,B."),
    ] = None,
    nominal: Annotated[
        Path | None,
        typer.Option(
            metavar="THETA.json",
            help="The simulation before calibration, as fit.json or truth.json.",
        ),
    ] = None,
    own_effects: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE.py", help="Your own effects; the file is executed."),
    ] = None,
    bootstrap: Annotated[
        int,
        typer.Option(
            min=0, max=100_000, help="Simulated and refitted campaigns behind p-values; 0: none."
        ),
    ] = 60,
) -> None:
    """Where the model misses, and which effect explains it.

    Also how much each explanation explains, the resulting tau, and effects that may stay unseen.
    The page "How to read a gap report" of the documentation lists the effects.
    """
    from bayes_sensor.cli.read_parameters import read_nominal
    from bayes_sensor.diagnosis.effects import check_names

    left_out = [name.strip() for text in without or () for name in text.split(",")]
    check_names(left_out, "--without")
    options = {
        "without": tuple(left_out),
        "effects": _read_own(own_effects),
        "bootstrap": bootstrap,
        "nominal": read_nominal(nominal),
    }
    _run("gap", run, options=options)


@app.command()
@with_groups
def init(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="The folder of the recorder's exports.")
    ],
    common: Unused,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a campaign.toml that is there.")
    ] = False,
) -> None:
    """A first campaign.toml from a folder of exports.

    Every export is read, and experiments, commands and units are proposed. At a terminal you are
    asked for flows and what else cannot be known; Enter leaves it open. What is assumed and what is
    missing is marked in the file.
    """
    from bayes_sensor.cli.init_campaign import init_campaign

    init_campaign(folder, overwrite=overwrite, quiet=common.quiet)


@app.command()
def check(
    campaign: CampaignFile,
    plot: Annotated[
        bool,
        typer.Option("--plot", help="Write check.png beside it: records and what was understood."),
    ] = False,
    seed: UnusedSeed = 1,
    jobs: UnusedJobs = 1,
    quiet: Quiet = False,
    config: Annotated[Path | None, settings_file("Checked with the campaign.")] = None,
) -> None:
    """Load and validate only, print what was understood."""
    from bayes_sensor.cli.print_check import print_check

    print_check(campaign, quiet, config, plot=plot)


@app.command()
@with_groups
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A results folder.")],
    reported: Reported,
    form: Annotated[str, typer.Option("--format", help="html, pdf or md.")] = "html",
    seed: UnusedSeed = 1,
    jobs: Jobs = 1,
    quiet: Quiet = False,
    config: UnusedConfig = None,
) -> None:
    """Rebuild the report from the saved results."""
    from bayes_sensor.cli.make_report import rebuild_report

    rebuild_report(folder, quiet, reported.choice(form, jobs))
