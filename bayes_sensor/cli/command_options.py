"""The options of commands that take many, each command's in one record."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from bayes_sensor.cli.options import (
    CampaignFile,
    Config,
    Jobs,
    Out,
    Quiet,
    Resume,
    Scheduler,
    Seed,
    UnusedConfig,
    UnusedJobs,
    given,
    settings_file,
)


@dataclass(frozen=True)
class Simulation:
    """The options of simulate."""

    out: Out
    campaign: Annotated[
        Path | None,
        typer.Argument(
            metavar="[CAMPAIGN.toml]",
            help="Design and, where it has data, truth (its own fit); default: seven experiments "
            "of the published rig.",
            show_default=False,
        ),
    ] = None
    seed: Seed = 1
    jobs: UnusedJobs = 1
    quiet: Quiet = False
    config: Annotated[Path | None, settings_file("Its [noise] is the noise law.")] = None
    design: Annotated[
        Path | None, typer.Option(metavar="DESIGN.toml", help="A campaign file without data.")
    ] = None
    truth: Annotated[
        Path | None,
        typer.Option(metavar="THETA.json", help="Parameters as in fit.json or truth.json."),
    ] = None
    tau: Annotated[str | None, typer.Option(help='True tau, such as "20 ms".')] = None
    tau_v: Annotated[str | None, typer.Option(help='True tau_v, such as "850 ms".')] = None
    volume: Annotated[str | None, typer.Option("--V", help='True V, such as "58 mL".')] = None
    phi: Annotated[float | None, typer.Option(help="AR(1) coefficient at the interval.")] = None
    sigma0: Annotated[str | None, typer.Option(help='Noise, such as "45 mV".')] = None
    sigma1: Annotated[
        str | None, typer.Option(help='Extra noise at the highest concentration, "70 mV".')
    ] = None
    duration: Annotated[
        str | None,
        typer.Option(help='Length of each record, "60 s"; commanded times move in proportion.'),
    ] = None
    interval: Annotated[str | None, typer.Option(help='Sampling interval, "1 ms".')] = None
    experiments: Annotated[
        str | None, typer.Option(help='Only these experiments of the design: "1,4,7".')
    ] = None
    effect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[:FORM][=STRENGTH]", help="An effect of the catalogue; repeatable."
        ),
    ] = None
    file_format: Annotated[
        str, typer.Option("--format", help="csv, picoscope-csv, mat or npz.")
    ] = "csv"

    @property
    def quantities(self) -> dict[str, str]:
        """What was given with a unit, by its symbol."""
        return given(
            tau=self.tau, tau_v=self.tau_v, V=self.volume, sigma0=self.sigma0, sigma1=self.sigma1,
            duration=self.duration, interval=self.interval,
        )  # fmt: skip


@dataclass(frozen=True)
class CoverageStudy:
    """The options of coverage."""

    out: Out
    campaigns: Annotated[
        int, typer.Option(min=1, max=1_000_000, help="Simulated campaigns of each setting.")
    ] = 1000
    setting: Annotated[
        list[str] | None,
        typer.Option(help="iid, ar1_0.5, ar1_0.9, arma, slow_closing; repeatable, default all."),
    ] = None
    method: Annotated[
        list[str] | None,
        typer.Option("--method", "--methods", help="As in bounds.json; repeatable, default all."),
    ] = None
    seed: Seed = 1
    jobs: Jobs = 1
    scheduler: Scheduler = None
    resume: Resume = False
    quiet: Quiet = False
    config: Annotated[Path | None, settings_file("Its [bounds]: methods and resamples.")] = None


@dataclass(frozen=True)
class BlindCheck:
    """The options of blind-check."""

    out: Out
    cases: Annotated[int, typer.Option(min=1, max=100_000, help="Simulated cases.")] = 60
    seed: Seed = 1
    setting: Annotated[str, typer.Option(help="full (as the command gap) or study (quicker).")] = (
        "full"
    )
    cases_only: Annotated[
        bool, typer.Option("--cases-only", help="Draw campaigns and seal their truths.")
    ] = False
    diagnose_only: Annotated[
        bool, typer.Option("--diagnose-only", help="Diagnose what is in DIR, record verdicts.")
    ] = False
    score_only: Annotated[
        bool, typer.Option("--score-only", help="Open the seals and score the verdicts in DIR.")
    ] = False
    reserve: Annotated[
        bool, typer.Option("--reserve", help="Also causes and noise kept for a final run.")
    ] = False
    keep: Annotated[
        bool | None,
        typer.Option("--keep/--no-keep", help="Whether to keep campaigns; default: up to 100."),
    ] = None
    size: Annotated[str, typer.Option(help="mixed, paper, varied or small.")] = "mixed"
    jobs: Jobs = 1
    scheduler: Scheduler = None
    resume: Resume = False
    quiet: Quiet = False
    config: UnusedConfig = None

    @property
    def only(self) -> str | None:
        """The one stage that is wanted; None for all three."""
        flags = {"cases": self.cases_only, "diagnose": self.diagnose_only, "score": self.score_only}
        chosen = [name for name, wanted in flags.items() if wanted]
        if len(chosen) > 1:
            raise typer.BadParameter(
                "expected at most one of --cases-only, --diagnose-only and --score-only; leave all "
                "out to do the three in a row"
            )
        return chosen[0] if chosen else None


@dataclass(frozen=True)
class Planning:
    """The options of design."""

    campaign: CampaignFile
    out: Out
    target_tau: Annotated[
        str, typer.Option(help='Wanted half width of tau\'s 95 % interval, "5 ms".')
    ]
    flow: Annotated[
        tuple[str, str] | None,
        typer.Option(help='Lowest and highest total flow: "3 L/min" "12 L/min".'),
    ] = None
    concentration: Annotated[
        tuple[str, str] | None, typer.Option(help='Lowest and highest: "5 %" "20 %".')
    ] = None
    duration: Annotated[
        tuple[str, str] | None, typer.Option(help='Shortest and longest record: "30 s" "120 s".')
    ] = None
    experiments: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Exactly so many, target reached or not.")
    ] = None
    most: Annotated[int, typer.Option(min=1, max=1000, help="At most so many.")] = 40
    trigger: Annotated[
        str | None, typer.Option(help='New switch times will be known to this sd, "2 ms".')
    ] = None
    tau: Annotated[
        str | None, typer.Option(help="Plan for this tau; default: the posterior median.")
    ] = None
    truth: Annotated[
        Path | None,
        typer.Option(metavar="THETA.json", help="Plan for these parameters; no fit is made."),
    ] = None
    check: Annotated[
        int, typer.Option(min=0, max=10_000, help="Simulate so many campaigns of the proposal.")
    ] = 0
    seed: Seed = 1
    jobs: UnusedJobs = 1
    quiet: Quiet = False
    config: Config = None


@dataclass(frozen=True)
class Restoring:
    """The options of restore."""

    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="[CAMPAIGN.toml] RECORD",
            help="Where the lags come from (a campaign or a folder with its results; not with "
            "--lag), then the record; several records, or a folder of them, get a folder each.",
        ),
    ]
    out: Out
    lag: Annotated[
        list[str] | None,
        typer.Option(metavar="LAG", help='A known lag, "40 +- 2 min"; repeatable for a chain.'),
    ] = None
    signal: Annotated[str | None, typer.Option(help="Column of the signal.")] = None
    time: Annotated[str | None, typer.Option(help="Column of the times.")] = None
    interval: Annotated[
        str | None, typer.Option(help='Sampling interval of a file without times, "1 s".')
    ] = None
    signal_unit: Annotated[str | None, typer.Option(help='Unit of the signal, "ppm".')] = None
    at: Annotated[
        str,
        typer.Option(help="What is restored with a campaign: what entered the rig, or the sensor."),
    ] = "rig"
    flow: Annotated[
        str | None,
        typer.Option(help="Total flow of the record: the volume's lag then counts, too."),
    ] = None
    sensor: Annotated[
        str | None, typer.Option(help="Whose record it is, with a campaign of several sensors.")
    ] = None
    non_negative: Annotated[
        bool, typer.Option("--non-negative", help="The input is known not to be negative.")
    ] = False
    seed: Seed = 1
    jobs: Jobs = 1
    quiet: Quiet = False
    config: Config = None
