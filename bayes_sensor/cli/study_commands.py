"""The commands on many campaigns, simulated ones and the coating: options, and what they call.

Numerical rooms are imported only by the command that needs them, so that ``--help`` answers at
once.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_sensor.cli.application import app
from bayes_sensor.cli.command_options import (
    BlindCheck,
    CoverageStudy,
    Planning,
    Restoring,
    Simulation,
)
from bayes_sensor.cli.options import (
    Config,
    Jobs,
    Out,
    Quiet,
    Resume,
    Sampling,
    Scheduler,
    Seed,
    Unused,
    given,
    with_groups,
)


@app.command()
@with_groups
def simulate(wanted: Simulation) -> None:
    """A campaign with known truth, to try things out.

    Writes data files, campaign.toml and truth.json.
    """
    from bayes_sensor.cli.simulate_campaigns import simulate_campaign

    simulate_campaign(wanted)


@app.command()
@with_groups
def coverage(wanted: CoverageStudy) -> None:
    """How often each bound holds the truth, by simulation."""
    from bayes_sensor.cli.run_coverage import study_coverage

    study_coverage(wanted)


@app.command("blind-check")
@with_groups
def blind_check(wanted: BlindCheck) -> None:
    """Score card of the gap diagnosis on withheld effects.

    The campaigns come from a simulator that shares nothing with the diagnosis.

    Campaigns of your own go into DIR/campaigns/NAME/, their truths into DIR/sealed/NAME.json.
    --diagnose-only first seals the truths: their SHA-256 goes into sealed.json, that of every
    campaign into campaigns.json. --score-only refuses files that were changed since.  A truth that
    is added after the verdicts is scored, too, but cannot be sealed; score.json lists it as
    sealed_late.
    """
    only = wanted.only
    from bayes_sensor.cli import run_blind_check

    run_blind_check.blind_check(wanted, only)


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
    from bayes_sensor.cli.run_fleets import FleetAnalysis, analyse_fleet

    task = FleetAnalysis(config, seed, resume, sampling.settings)
    raise typer.Exit(
        analyse_fleet(Path(listing), out, task, jobs=jobs, scheduler=scheduler, quiet=quiet)
    )


@app.command()
@with_groups
def design(wanted: Planning) -> None:
    """The next experiments to reach a wanted interval of tau."""
    from bayes_sensor.cli.plan_experiments import plan_experiments

    raise typer.Exit(plan_experiments(wanted))


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
    from bayes_sensor.cli.solve_coating import solve_diffusion

    quantities = given(
        outer_radius=outer_radius, d_zif8=d_zif8, d_pdms=d_pdms, thickness_zif8=thickness_zif8,
        thickness_pdms=thickness_pdms, ring_radius=ring_radius, probe_height=probe_height,
    )  # fmt: skip
    raise typer.Exit(solve_diffusion(out, quantities, tolerance, common.quiet))


@app.command()
@with_groups
def restore(wanted: Restoring) -> None:
    """Undo the lag: the input of a slow sensor, with bands, from a record of it."""
    from bayes_sensor.cli.restore_records import restore_records

    raise typer.Exit(restore_records(wanted))
