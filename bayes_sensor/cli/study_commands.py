"""The commands on many campaigns, simulated ones and the coating: options, and what they call.

Numerical rooms are imported only by the command that needs them, so that ``--help`` answers at
once.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_sensor.cli.application import app
from bayes_sensor.cli.options import (
    CampaignFile,
    Config,
    Jobs,
    Out,
    Quiet,
    Resume,
    Sampling,
    Scheduler,
    Seed,
    Unused,
    UnusedConfig,
    UnusedJobs,
    given,
    settings_file,
    with_groups,
)


@app.command()
def simulate(
    out: Out,
    campaign: Annotated[
        Path | None,
        typer.Argument(
            metavar="[CAMPAIGN.toml]",
            help="Design and, where it has data, truth (its own fit); default: seven experiments "
            "of the published rig.",
            show_default=False,
        ),
    ] = None,
    seed: Seed = 1,
    jobs: UnusedJobs = 1,
    quiet: Quiet = False,
    config: Annotated[Path | None, settings_file("Its [noise] is the noise law.")] = None,
    design: Annotated[
        Path | None, typer.Option(metavar="DESIGN.toml", help="A campaign file without data.")
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(metavar="THETA.json", help="Parameters as in fit.json or truth.json."),
    ] = None,
    tau: Annotated[str | None, typer.Option(help='True tau, such as "20 ms".')] = None,
    tau_v: Annotated[str | None, typer.Option(help='True tau_v, such as "850 ms".')] = None,
    volume: Annotated[str | None, typer.Option("--V", help='True V, such as "58 mL".')] = None,
    phi: Annotated[float | None, typer.Option(help="AR(1) coefficient at the interval.")] = None,
    sigma0: Annotated[str | None, typer.Option(help='Noise, such as "45 mV".')] = None,
    sigma1: Annotated[
        str | None, typer.Option(help='Extra noise at the highest concentration, "70 mV".')
    ] = None,
    duration: Annotated[
        str | None,
        typer.Option(help='Length of each record, "60 s"; commanded times move in proportion.'),
    ] = None,
    interval: Annotated[str | None, typer.Option(help='Sampling interval, "1 ms".')] = None,
    experiments: Annotated[
        str | None, typer.Option(help='Only these experiments of the design: "1,4,7".')
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[:FORM][=STRENGTH]", help="An effect of the catalogue; repeatable."
        ),
    ] = None,
    file_format: Annotated[
        str, typer.Option("--format", help="csv, picoscope-csv, mat or npz.")
    ] = "csv",
) -> None:
    """A campaign with known truth, to try things out.

    Writes data files, campaign.toml and truth.json.
    """
    from bayes_sensor.cli.simulate_campaigns import simulate_campaign

    simulate_campaign(
        out, campaign=campaign, seed=seed, quiet=quiet, design=design, truth=truth, phi=phi,
        quantities=given(tau=tau, tau_v=tau_v, V=volume, sigma0=sigma0, sigma1=sigma1,
                          duration=duration, interval=interval),
        only=experiments, file_format=file_format, effects=effect or (), config=config,
    )  # fmt: skip


@app.command()
def coverage(
    out: Out,
    campaigns: Annotated[
        int, typer.Option(min=1, max=1_000_000, help="Simulated campaigns of each setting.")
    ] = 1000,
    setting: Annotated[
        list[str] | None,
        typer.Option(help="iid, ar1_0.5, ar1_0.9, arma, slow_closing; repeatable, default all."),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option("--method", "--methods", help="As in bounds.json; repeatable, default all."),
    ] = None,
    seed: Seed = 1,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    resume: Resume = False,
    quiet: Quiet = False,
    config: Annotated[Path | None, settings_file("Its [bounds]: methods and resamples.")] = None,
) -> None:
    """How often each bound holds the truth, by simulation."""
    from bayes_sensor.cli.run_coverage import study_coverage

    raise typer.Exit(
        study_coverage(
            out, campaigns=campaigns, settings=setting or [], methods=method or [], seed=seed,
            jobs=jobs, scheduler=scheduler, resume=resume, quiet=quiet, config=config,
        )
    )  # fmt: skip


@app.command("blind-check")
def blind_check(
    out: Out,
    cases: Annotated[int, typer.Option(min=1, max=100_000, help="Simulated cases.")] = 60,
    seed: Seed = 1,
    setting: Annotated[
        str, typer.Option(help="full (as the command gap) or study (quicker).")
    ] = "full",
    cases_only: Annotated[
        bool, typer.Option("--cases-only", help="Draw campaigns and seal their truths.")
    ] = False,
    diagnose_only: Annotated[
        bool, typer.Option("--diagnose-only", help="Diagnose what is in DIR, record verdicts.")
    ] = False,
    score_only: Annotated[
        bool, typer.Option("--score-only", help="Open the seals and score the verdicts in DIR.")
    ] = False,
    reserve: Annotated[
        bool, typer.Option("--reserve", help="Also causes and noise kept for a final run.")
    ] = False,
    keep: Annotated[
        bool | None,
        typer.Option("--keep/--no-keep", help="Whether to keep campaigns; default: up to 100."),
    ] = None,
    size: Annotated[str, typer.Option(help="mixed, paper, varied or small.")] = "mixed",
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    resume: Resume = False,
    quiet: Quiet = False,
    config: UnusedConfig = None,
) -> None:
    """Score card of the gap diagnosis on withheld effects.

    The campaigns come from a simulator that shares nothing with the diagnosis.

    Campaigns of your own go into DIR/campaigns/NAME/, their truths into DIR/sealed/NAME.json.
    --diagnose-only first seals the truths: their SHA-256 goes into sealed.json, that of every
    campaign into campaigns.json. --score-only refuses files that were changed since.  A truth that
    is added after the verdicts is scored, too, but cannot be sealed; score.json lists it as
    sealed_late.
    """
    from bayes_sensor.analysis.overrides import read_overrides
    from bayes_sensor.cli import run_blind_check

    read_overrides(config)  # a mistake in it is refused, though nothing of it acts

    chosen = [
        name
        for name, wanted in (
            ("cases", cases_only), ("diagnose", diagnose_only), ("score", score_only)
        )
        if wanted
    ]  # fmt: skip
    if len(chosen) > 1:
        raise typer.BadParameter(
            "expected at most one of --cases-only, --diagnose-only and --score-only; leave all "
            "out to do the three in a row"
        )
    raise typer.Exit(
        run_blind_check.blind_check(
            out, cases=cases, seed=seed, setting=setting, only=chosen[0] if chosen else None,
            reserve=reserve, keep=keep, jobs=jobs, scheduler=scheduler, resume=resume,
            quiet=quiet, size=size,
        )
    )  # fmt: skip


@app.command()
@with_groups
def fleet(
    listing: Annotated[
        str,
        typer.Argument(
            metavar="LIST",
            help="Text file of campaign.toml paths, TOML with [[campaign]], folder or 'pattern'.",
        ),
    ],
    out: Out,
    seed: Seed = 1,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    resume: Resume = False,
    quiet: Quiet = False,
    config: Config = None,
    *,
    sampling: Sampling,
) -> None:
    """Analyze many campaigns; one table, figure and index.

    A campaign that cannot be analysed becomes a row with its message.  Exit status: 0 all done, 3
    some failed or did not converge, 2 a bad list or nowhere to write.
    """
    from bayes_sensor.cli.run_fleets import analyse_fleet

    raise typer.Exit(
        analyse_fleet(
            Path(listing), out, seed=seed, jobs=jobs, scheduler=scheduler, config=config,
            posterior=sampling.settings, resume=resume, quiet=quiet,
        )
    )  # fmt: skip


@app.command()
def design(
    campaign: CampaignFile,
    out: Out,
    target_tau: Annotated[
        str, typer.Option(help='Wanted half width of tau\'s 95 % interval, "5 ms".')
    ],
    flow: Annotated[
        tuple[str, str] | None,
        typer.Option(help='Lowest and highest total flow: "3 L/min" "12 L/min".'),
    ] = None,
    concentration: Annotated[
        tuple[str, str] | None, typer.Option(help='Lowest and highest: "5 %" "20 %".')
    ] = None,
    duration: Annotated[
        tuple[str, str] | None, typer.Option(help='Shortest and longest record: "30 s" "120 s".')
    ] = None,
    experiments: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Exactly so many, target reached or not.")
    ] = None,
    most: Annotated[int, typer.Option(min=1, max=1000, help="At most so many.")] = 40,
    trigger: Annotated[
        str | None, typer.Option(help='New switch times will be known to this sd, "2 ms".')
    ] = None,
    tau: Annotated[
        str | None, typer.Option(help="Plan for this tau; default: the posterior median.")
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(metavar="THETA.json", help="Plan for these parameters; no fit is made."),
    ] = None,
    check: Annotated[
        int, typer.Option(min=0, max=10_000, help="Simulate so many campaigns of the proposal.")
    ] = 0,
    seed: Seed = 1,
    jobs: UnusedJobs = 1,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """The next experiments to reach a wanted interval of tau."""
    from bayes_sensor.cli.plan_experiments import plan_experiments

    raise typer.Exit(
        plan_experiments(
            campaign, out, target=target_tau,
            limits=given(flow=flow, concentration=concentration, duration=duration),
            k=experiments, most=most, trigger=trigger, tau=tau, truth=truth, check=check,
            seed=seed, quiet=quiet, config=config,
        )
    )  # fmt: skip


@app.command()
@with_groups
def diffusion(
    out: Out,
    common: Unused,
    outer_radius: Annotated[str | None, typer.Option(help='Default "17.4 um".')] = None,
    d_zif8: Annotated[
        str | None, typer.Option("--d-zif8", help='Default "1.71e-10 m^2/s".')
    ] = None,
    d_pdms: Annotated[str | None, typer.Option("--d-pdms", help='Default "4.2e-9 m^2/s".')] = None,
    thickness_zif8: Annotated[
        str | None, typer.Option("--thickness-zif8", help='Default "1.5 um".')
    ] = None,
    thickness_pdms: Annotated[
        str | None, typer.Option("--thickness-pdms", help='Default "7.0 um".')
    ] = None,
    ring_radius: Annotated[str | None, typer.Option(help='Default "10 um".')] = None,
    probe_height: Annotated[str | None, typer.Option(help='Default "220 nm".')] = None,
    tolerance: Annotated[float, typer.Option(help="Relative, of the response times.")] = 5e-4,
) -> None:
    """Finite-element response of the coating."""
    from bayes_sensor.analysis.overrides import read_overrides
    from bayes_sensor.cli.solve_coating import solve_diffusion

    read_overrides(common.config)  # a mistake in it is refused, though nothing of it acts

    quantities = given(
        outer_radius=outer_radius, d_zif8=d_zif8, d_pdms=d_pdms, thickness_zif8=thickness_zif8,
        thickness_pdms=thickness_pdms, ring_radius=ring_radius, probe_height=probe_height,
    )  # fmt: skip
    raise typer.Exit(solve_diffusion(out, quantities, tolerance, common.quiet))


@app.command()
def restore(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="[CAMPAIGN.toml] RECORD",
            help="Where the lags come from (a campaign or a folder with its results; not with "
            "--lag), then the record; several records, or a folder of them, get a folder each.",
        ),
    ],
    out: Out,
    lag: Annotated[
        list[str] | None,
        typer.Option(metavar="LAG", help='A known lag, "40 +- 2 min"; repeatable for a chain.'),
    ] = None,
    signal: Annotated[str | None, typer.Option(help="Column of the signal.")] = None,
    time: Annotated[str | None, typer.Option(help="Column of the times.")] = None,
    interval: Annotated[
        str | None, typer.Option(help='Sampling interval of a file without times, "1 s".')
    ] = None,
    signal_unit: Annotated[str | None, typer.Option(help='Unit of the signal, "ppm".')] = None,
    at: Annotated[
        str,
        typer.Option(help="What is restored with a campaign: what entered the rig, or the sensor."),
    ] = "rig",
    flow: Annotated[
        str | None,
        typer.Option(help="Total flow of the record: the volume's lag then counts, too."),
    ] = None,
    non_negative: Annotated[
        bool, typer.Option("--non-negative", help="The input is known not to be negative.")
    ] = False,
    seed: Seed = 1,
    jobs: Jobs = 1,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Undo the lag: the input of a slow sensor, with bands, from a record of it."""
    from bayes_sensor.cli.restore_records import Wanted, restore_records

    wanted = Wanted(
        out, tuple(lag or ()), signal, time, interval, signal_unit, at, flow, non_negative, seed,
        jobs, quiet, config,
    )  # fmt: skip
    raise typer.Exit(restore_records(paths, wanted))
