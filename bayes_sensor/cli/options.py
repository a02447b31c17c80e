"""The options that several commands take, each declared once.

A command declares a group of them by one parameter, such as ``run: Run``, and :func:`with_groups`
spells the group out for the parser.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""that this process may use"""
DEFAULT_JOBS = min(2, CORES)
"""processes of a whole analysis: one diagnoses the gap while the other samples"""

CampaignFile = Annotated[Path, typer.Argument(metavar="CAMPAIGN.toml", help="The campaign's file.")]
Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="Where the results go.")]
Seed = Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Same seed, same numbers.")]
Jobs = Annotated[int, typer.Option(min=1, max=256, help="Processes; numbers do not depend on it.")]
Scheduler = Annotated[str | None, typer.Option(help="Dask scheduler to run on, tcp://host:port.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")]
Resume = Annotated[
    bool, typer.Option("--resume", help="Go on with what an interrupted run left in DIR.")
]
Sampler = Annotated[
    str | None,
    typer.Option(
        help="emcee, independence or hmc.  [default: emcee; of bounds independence, or another "
        "where that cannot be trusted]",
        show_default=False,
    ),
]


def settings_file(words: str, **more: Any) -> Any:
    """The option ``--config`` with a help text of the command's own."""
    return typer.Option("--config", metavar="OVERRIDES.toml", help=words, **more)


Config = Annotated[Path | None, settings_file("Settings that differ from default.")]

# Every command takes the common options, so that a script may give all the same ones; those that
# do nothing for a command are not offered in its help.
UnusedSeed = Annotated[
    int, typer.Option("--seed", min=0, max=2**32 - 1, hidden=True, help="Nothing is drawn here.")
]
UnusedJobs = Annotated[
    int, typer.Option("--jobs", min=1, max=256, hidden=True, help="One process does it.")
]


def _checked(config: Path | None) -> Path | None:
    """Refuse a mistake in the settings, though nothing of them acts."""
    if config is not None:
        from bayes_sensor.analysis.overrides import read_overrides

        read_overrides(config)
    return config


UnusedConfig = Annotated[
    Path | None, settings_file("Checked; nothing in it acts.", hidden=True, callback=_checked)
]


@dataclass(frozen=True)
class CommandRun:
    """What every command that analyses a campaign takes."""

    campaign: CampaignFile
    out: Out
    seed: Seed = 1
    jobs: Jobs = 1
    quiet: Quiet = False
    config: Config = None
    resume: Resume = False


@dataclass(frozen=True)
class Unused:
    """The common options of a command that only says what it does."""

    seed: UnusedSeed = 1
    jobs: UnusedJobs = 1
    quiet: Quiet = False
    config: UnusedConfig = None


@dataclass(frozen=True)
class Sampling:
    """How the posterior is sampled."""

    sampler: Sampler = None
    walkers: Annotated[
        int | None, typer.Option(min=2, help="Walkers of each ensemble (emcee).")
    ] = None
    steps: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Most steps of each ensemble (emcee), in hundreds; 300 are the fewest that tell "
            "whether it has converged, and are taken in any case.",
        ),
    ] = None
    chains: Annotated[int | None, typer.Option(min=2, help="Independent runs.")] = None

    @property
    def settings(self) -> dict[str, Any]:
        """What was given, by the names of the section [posterior]."""
        return given(sampler=self.sampler, n_walkers=self.walkers, max_steps=self.steps,
                     n_chains=self.chains)  # fmt: skip


@dataclass(frozen=True)
class Reported:
    """What the report holds."""

    pages: Annotated[
        str, typer.Option(help="short (the answer; the rest folded behind it), or full.")
    ] = "short"
    no_figures: Annotated[bool, typer.Option("--no-figures", help="Text and tables.")] = False
    png: Annotated[bool, typer.Option("--png", help="Save figures as PNG, too.")] = False
    compare_published: Annotated[
        bool, typer.Option("--compare-published", help="Beside the published sensor's results.")
    ] = False

    def choice(self, form: str = "html", jobs: int = 1) -> Any:
        """The same as the report takes it."""
        from bayes_sensor.cli.make_report import check_choice
        from bayes_sensor.report import Choice

        made = Choice(form, self.pages, not self.no_figures, self.png, self.compare_published, jobs)
        check_choice(made)
        return made


def given(**values: Any) -> dict[str, Any]:
    """The options that were given: those that are not None."""
    return {name: value for name, value in values.items() if value is not None}


def with_groups(function: Callable[..., None]) -> Callable[..., None]:
    """A command whose parameters that are dataclasses are spelled out, one option a field.

    >>> list(inspect.signature(with_groups(lambda: None)).parameters)
    []
    """
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    parameters = []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name not in groups:
            parameters.append(_keyword(parameter.name, hints[parameter.name], parameter.default))
            continue
        group = groups[parameter.name]
        types = get_type_hints(group, include_extras=True)
        for item in fields(group):
            default = inspect.Parameter.empty if item.default is MISSING else item.default
            parameters.append(_keyword(item.name, types[item.name], default))

    @wraps(function)
    def command(**options: Any) -> None:
        for name, group in groups.items():
            options[name] = group(**{item.name: options.pop(item.name) for item in fields(group)})
        function(**options)

    command.__annotations__ = {p.name: p.annotation for p in parameters}
    vars(command)["__signature__"] = inspect.Signature(parameters)
    return command


def _keyword(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )
