"""The command line: parse, call, print.

``main`` turns every foreseeable failure into one line on stderr and an exit code: 0 done, 2 bad
input or usage, 3 finished but not converged, 130 interrupted.  Numerical rooms are imported only by
the command that needs them, so that ``--help`` is fast.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import time
from concurrent.futures import BrokenExecutor
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import typer

from bayes_sensor import __version__

DONE, BAD_INPUT, NOT_CONVERGED, INTERRUPTED = 0, 2, 3, 130

app = typer.Typer(
    name="bayes-sensor",
    help="Response times of gas sensors from step experiments: intervals and a test of the model.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

CampaignFile = Annotated[Path, typer.Argument(metavar="CAMPAIGN.toml", help="The campaign's file.")]
Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="Where the results go.")]
Seed = Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Same seed, same numbers.")]
Jobs = Annotated[int, typer.Option(min=1, max=256, help="Processes; numbers do not depend on it.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")]


def _settings_file(words: str) -> Any:
    return typer.Option("--config", metavar="OVERRIDES.toml", help=words)


Config = Annotated[Path | None, _settings_file("Settings that differ from default.")]
# every command takes the common options, so that a script may give all the same ones
UnusedSeed = Annotated[
    int, typer.Option("--seed", min=0, max=2**32 - 1, help="Taken; nothing is drawn here.")
]
UnusedJobs = Annotated[
    int, typer.Option("--jobs", min=1, max=256, help="Taken; one process does it.")
]
UnusedConfig = Annotated[Path | None, _settings_file("Checked; nothing in it acts here.")]
Resume = Annotated[
    bool, typer.Option("--resume", help="Go on with what an interrupted run left in DIR.")
]
Sampler = Annotated[
    str | None, typer.Option(help="emcee (default), independence or hmc.", show_default=False)
]
Walkers = Annotated[int | None, typer.Option(min=2, help="Walkers of each ensemble (emcee).")]
Steps = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Most steps of each ensemble (emcee), in hundreds; 300 are the fewest that tell "
        "whether it has converged, and are taken in any case.",
    ),
]
Chains = Annotated[int | None, typer.Option(min=2, help="Independent runs.")]


def _given(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _read_settings(config: Path | None) -> None:
    """Refuse wrong settings, also if the command does not use them."""
    if config is not None:
        from bayes_sensor.cli.overrides import read_overrides

        read_overrides(config)


def _run(command: str, campaign: Path, out: Path, **options: Any) -> None:
    from bayes_sensor.cli.analysis_steps import run

    raise typer.Exit(run(command, campaign, out, **options))


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"bayes-sensor {__version__}")
        raise typer.Exit()


@app.callback()
def common(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Version and exit."),
    ] = False,
) -> None:
    """Response times of gas sensors from step experiments: intervals and a test of the model."""


@app.command()
def analyze(
    campaign: CampaignFile,
    out: Out,
    seed: Seed = 1,
    jobs: Jobs = 1,
    quiet: Quiet = False,
    config: Config = None,
    resume: Resume = False,
    sampler: Sampler = None,
    walkers: Walkers = None,
    steps: Steps = None,
    chains: Chains = None,
) -> None:
    """Everything from the fit to the gap, with report and figures."""
    _run("analyze", campaign, out, seed=seed, jobs=jobs, quiet=quiet, config=config, resume=resume,
         posterior=_given(sampler=sampler, n_walkers=walkers, max_steps=steps, n_chains=chains),
         )  # fmt: skip


@app.command()
def fit(
    campaign: CampaignFile,
    out: Out,
    seed: Seed = 1,
    jobs: Jobs = 1,
    quiet: Quiet = False,
    config: Config = None,
    resume: Resume = False,
) -> None:
    """Particle swarm and refinement, residual diagnostics."""
    _run("fit", campaign, out, seed=seed, jobs=jobs, quiet=quiet, config=config,
         resume=resume)  # fmt: skip


@app.command()
def posterior(
    campaign: CampaignFile,
    out: Out,
    seed: Seed = 1,
    jobs: Jobs = 1,
    quiet: Quiet = False,
    config: Config = None,
    resume: Resume = False,
    sampler: Sampler = None,
    walkers: Walkers = None,
    steps: Steps = None,
    chains: Chains = None,
    with_effect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="With this effect in the model; repeatable, NAME:FORM for a form."
        ),
    ] = None,
) -> None:
    """MCMC; interrupted runs continue with --resume."""
    if with_effect:
        from bayes_sensor.diagnosis.effects.effect_model import check_effects

        check_effects(with_effect, "--with-effect")
    _run("posterior", campaign, out, seed=seed, jobs=jobs, quiet=quiet, config=config,
         resume=resume, options={"with_effects": tuple(with_effect or ())},
         posterior=_given(sampler=sampler, n_walkers=walkers, max_steps=steps, n_chains=chains),
         )  # fmt: skip


@app.command()
def bounds(
    campaign: CampaignFile,
    out: Out,
    seed: Seed = 1,
    jobs: Jobs = 1,
    quiet: Quiet = False,
    config: Config = None,
    resume: Resume = False,
    sampler: Sampler = None,
) -> None:
    """Every bound method side by side."""
    _run("bounds", campaign, out, seed=seed, jobs=jobs, quiet=quiet, config=config, resume=resume,
         posterior=_given(sampler=sampler))  # fmt: skip


@app.command()
def delays(
    campaign: CampaignFile,
    out: Out,
    seed: Seed = 1,
    jobs: Jobs = 1,
    quiet: Quiet = False,
    config: Config = None,
    resume: Resume = False,
) -> None:
    """Regressions of start and end delay on 1/Q."""
    _run("delays", campaign, out, seed=seed, jobs=jobs, quiet=quiet, config=config,
         resume=resume)  # fmt: skip


@app.command()
def gap(
    campaign: CampaignFile,
    out: Out,
    seed: Seed = 1,
    jobs: Jobs = 1,
    quiet: Quiet = False,
    config: Annotated[
        Path | None, _settings_file("Settings of its fit; [noise] does not act here.")
    ] = None,
    resume: Resume = False,
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
    from bayes_sensor.cli.simulate_campaigns import read_nominal
    from bayes_sensor.diagnosis.effects import check_names
    from bayes_sensor.diagnosis.effects.user_effects import read_effects

    without = [name.strip() for text in without or () for name in text.split(",")]
    check_names(without, "--without")
    own = [effect for path in own_effects or () for effect in read_effects(path)]
    _run("gap", campaign, out, seed=seed, jobs=jobs, quiet=quiet, config=config,
         resume=resume,
         options={"without": tuple(without), "effects": own, "bootstrap": bootstrap,
                  "nominal": read_nominal(nominal)})  # fmt: skip


@app.command()
def check(
    campaign: CampaignFile,
    seed: UnusedSeed = 1,
    jobs: UnusedJobs = 1,
    quiet: Quiet = False,
    config: Annotated[Path | None, _settings_file("Checked with the campaign.")] = None,
) -> None:
    """Load and validate only, print what was understood."""
    from bayes_sensor.cli.analysis_steps import print_check

    print_check(campaign, quiet, config)


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A results folder.")],
    seed: UnusedSeed = 1,
    jobs: UnusedJobs = 1,
    quiet: Quiet = False,
    config: UnusedConfig = None,
    form: Annotated[str, typer.Option("--format", help="html, pdf or md.")] = "html",
) -> None:
    """Rebuild the report from the saved results."""
    _read_settings(config)
    from bayes_sensor.cli.analysis_steps import rebuild_report

    rebuild_report(folder, quiet, form)


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
    config: Annotated[Path | None, _settings_file("Its [noise] is the noise law.")] = None,
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
        quantities=_given(tau=tau, tau_v=tau_v, V=volume, sigma0=sigma0, sigma1=sigma1,
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
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler to run on, tcp://host:port.")
    ] = None,
    resume: Resume = False,
    quiet: Quiet = False,
    config: Annotated[Path | None, _settings_file("Its [bounds]: methods and resamples.")] = None,
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
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler to run on, tcp://host:port.")
    ] = None,
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
    _read_settings(config)
    from bayes_sensor.cli import run_blind_check

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
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler to run on, tcp://host:port.")
    ] = None,
    resume: Resume = False,
    quiet: Quiet = False,
    config: Config = None,
    sampler: Sampler = None,
    walkers: Walkers = None,
    steps: Steps = None,
    chains: Chains = None,
) -> None:
    """Analyze many campaigns; one table, figure and index.

    A campaign that cannot be analysed becomes a row with its message.  Exit status: 0 all done, 3
    some failed or did not converge, 2 a bad list or nowhere to write.
    """
    from bayes_sensor.cli.run_fleets import analyse_fleet

    raise typer.Exit(
        analyse_fleet(
            Path(listing), out, seed=seed, jobs=jobs, scheduler=scheduler, config=config,
            posterior=_given(sampler=sampler, n_walkers=walkers, max_steps=steps, n_chains=chains),
            resume=resume, quiet=quiet,
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
            limits=_given(flow=flow, concentration=concentration, duration=duration),
            k=experiments, most=most, trigger=trigger, tau=tau, truth=truth, check=check,
            seed=seed, quiet=quiet, config=config,
        )
    )  # fmt: skip


@app.command()
def diffusion(
    out: Out,
    seed: UnusedSeed = 1,
    jobs: UnusedJobs = 1,
    quiet: Quiet = False,
    config: UnusedConfig = None,
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
    _read_settings(config)
    from bayes_sensor.cli.analysis_steps import solve_diffusion

    quantities = _given(
        outer_radius=outer_radius, d_zif8=d_zif8, d_pdms=d_pdms, thickness_zif8=thickness_zif8,
        thickness_pdms=thickness_pdms, ring_radius=ring_radius, probe_height=probe_height,
    )  # fmt: skip
    raise typer.Exit(solve_diffusion(out, quantities, tolerance, quiet))


def _advice(arguments: list[str]) -> str:
    """What to type after an interruption."""
    resumable = {"analyze", "posterior", "bounds", "blind-check", "coverage", "fleet"}
    if arguments and arguments[0] in resumable:
        more = [] if "--resume" in arguments else ["--resume"]
        import shlex

        return f"continue with: {shlex.join(['bayes-sensor', *arguments, *more])}"
    return "earlier results are as they were; run the same command again"


REPEAT_SECONDS = 1.0
"""after Ctrl-C, how often the interruption is repeated until it takes effect"""
SOON_SECONDS = 0.05
PATIENCE_SECONDS = 0.3
"""how often, and for how long, a running compiler is waited for"""


def _be_interruptible(arguments: list[str]) -> None:
    """Let Ctrl-C raise KeyboardInterrupt, now and again later.

    Python drops an exception that a signal raises inside a destructor or a callback of compiled
    code; a long run would then continue.  A compiler turns the exception into errors of its own.
    It may therefore finish its work; if that takes long, the process ends, as safely as if it had
    been killed.
    """
    pressed: list[float] = []

    def insist(_signal: int, frame: FrameType | None) -> None:
        if not hasattr(signal, "setitimer"):
            raise KeyboardInterrupt
        if not _is_compiling(frame):
            signal.setitimer(signal.ITIMER_REAL, REPEAT_SECONDS)
            raise KeyboardInterrupt
        pressed.append(time.monotonic())
        if pressed[-1] - pressed[0] > PATIENCE_SECONDS:
            from bayes_sensor.cli.logged_notes import aloud  # the compiler's caller may be muted

            aloud(_stopped(arguments))
            os._exit(INTERRUPTED)
        signal.setitimer(signal.ITIMER_REAL, SOON_SECONDS)

    signal.signal(signal.SIGINT, insist)
    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, insist)
    told = sys.unraisablehook

    def tell(lost: Any) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):  # that one comes again
            told(lost)

    sys.unraisablehook = tell


def _is_compiling(frame: FrameType | None) -> bool:
    while frame is not None:
        if str(frame.f_globals.get("__name__")).startswith(("numba.", "llvmlite.")):
            return True
        frame = frame.f_back
    return False


def _interruption_has_come() -> None:
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _open_streams() -> None:
    """Replace closed output streams, which are None in Python, by the null device."""
    for descriptor, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_WRONLY)
            if null != descriptor:
                os.dup2(null, descriptor)
                os.close(null)
            setattr(sys, name, os.fdopen(descriptor, "w", encoding="utf-8"))


def main(arguments: list[str] | None = None) -> None:
    """The entry point ``bayes-sensor``; ends the process with the exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    _open_streams()
    from bayes_sensor.cli.logged_notes import take_notes

    take_notes()
    import bayes_sensor.campaign  # noqa: F401  before Ctrl-C is an exception, see exit_code

    _be_interruptible(arguments)
    code = exit_code(arguments)
    atexit.register(_ignore_interruptions)  # the work is done, and its results are in place
    # worker processes are left to Python's farewell: loky's tracker tells of what it must tidy up
    if code == INTERRUPTED and "joblib.externals.loky" not in sys.modules:
        _leave_at_once(code)
    sys.exit(code)


def _ignore_interruptions() -> None:
    """Ignore Ctrl-C from here on, because nothing is left to stop."""
    _interruption_has_come()
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _leave_at_once(code: int) -> None:
    """End the process without Python's own shutdown, which takes most of a second.

    Functions registered for the end of the process still run.
    """
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # closed, or nobody reads any more
            stream.flush()
    os._exit(code)


def exit_code(arguments: list[str]) -> int:
    """Run a command in this process; what went wrong is one line on stderr."""
    usage_error: Any = typer.BadParameter.__bases__[0]
    from bayes_sensor.campaign import CampaignError

    try:
        code = app(args=arguments, prog_name="bayes-sensor", standalone_mode=False)
        sys.stdout.flush()
        if code == INTERRUPTED:  # how newer typer hands on Ctrl-C
            _interruption_has_come()
            raise KeyboardInterrupt
        return code if isinstance(code, int) else DONE
    except usage_error as error:
        context = getattr(error, "ctx", None)
        path = context.command_path if context is not None else "bayes-sensor"
        if not arguments:
            print(error.format_message(), file=sys.stderr)  # the help
            return BAD_INPUT
        message = " ".join(error.format_message().split())
        return _complain(f"{message.rstrip('.')}; see {path} --help")
    except CampaignError as error:
        return _complain(str(error))
    except (typer.Abort, KeyboardInterrupt):
        _interruption_has_come()
        print(_stopped(arguments), file=sys.stderr)
        return INTERRUPTED
    except SystemError as error:
        # Ctrl-C inside compiled code can come out as the SystemError that it caused
        if not isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            raise
        _interruption_has_come()
        print(_stopped(arguments), file=sys.stderr)
        return INTERRUPTED
    except BrokenExecutor as error:  # a worker of a step that is not repeated
        return _complain(
            f"a worker process ended unexpectedly, killed or out of memory ({error}); expected it "
            f"to finish: use fewer --jobs; {_advice(arguments)}"
        )
    except BrokenPipeError:
        # whoever read our output has left; nothing more to say, and not at shutdown either
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except OSError as error:  # disk full, no permission: everything else is a mistake of ours
        where = f"{error.filename}: " if error.filename else ""
        return _complain(
            f"{where}the results cannot be written ({error.strerror or error}); check the free "
            "space and the permissions of --out"
        )


def _complain(message: str) -> int:
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    return BAD_INPUT


def _stopped(arguments: list[str]) -> str:
    return " ".join(f"stopped: interrupted; {_advice(arguments)}".split())
