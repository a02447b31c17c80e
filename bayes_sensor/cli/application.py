"""The program ``bayes-sensor``: its name, its version, and what commands are added to."""

from __future__ import annotations

from typing import Annotated

import typer

from bayes_sensor import __version__

app = typer.Typer(
    name="bayes-sensor",
    help="Response times of gas sensors from step experiments: intervals and a test of the model.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


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
