"""The command line: parse, call, print.

``main`` turns every foreseeable failure into one line on stderr and an exit code: 0 done, 2 bad
input or usage, 3 finished but not converged, 130 interrupted, 143 terminated, 129 hung up.
"""

from __future__ import annotations

import atexit
import io
import os
import sys
from concurrent.futures import BrokenExecutor
from contextlib import suppress
from typing import Any

import typer

import bayes_sensor.cli.analysis_commands
import bayes_sensor.cli.study_commands  # noqa: F401
from bayes_sensor.cli.application import app
from bayes_sensor.cli.interruption import (
    INTERRUPTED,
    advice,
    be_interruptible,
    code_of_interruption,
    ignore_interruptions,
    interruption_has_come,
    leave_at_once,
    stopped,
)

__all__ = ["app", "main"]
DONE, BAD_INPUT = 0, 2


def _open_streams() -> None:
    """Output streams that take every text.

    Closed ones, which are None in Python, become the null device; a letter that a console's
    encoding does not have, as that of a Greek tau in cp1252, is written as an escape.
    """
    for descriptor, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_WRONLY)
            if null != descriptor:
                os.dup2(null, descriptor)
                os.close(null)
            setattr(sys, name, os.fdopen(descriptor, "w", encoding="utf-8"))
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def main(arguments: list[str] | None = None) -> None:
    """The entry point ``bayes-sensor``; ends the process with the exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    _open_streams()
    from bayes_sensor.cli.logged_notes import aloud, take_notes
    from bayes_sensor.compiled import say_when_compiling

    take_notes()
    if sys.stderr.isatty():
        say_when_compiling(aloud)
    import bayes_sensor.campaign  # noqa: F401  before Ctrl-C is an exception, see exit_code

    be_interruptible(arguments)
    code = exit_code(arguments)
    atexit.register(ignore_interruptions)  # the work is done, and its results are in place
    # worker processes are left to Python's farewell: loky's tracker tells of what it must tidy up
    if code > 128 and "joblib.externals.loky" not in sys.modules:
        leave_at_once(code)
    sys.exit(code)


def exit_code(arguments: list[str]) -> int:
    """Run a command in this process; what went wrong is one line on stderr."""
    usage_error: Any = typer.BadParameter.__bases__[0]
    from bayes_sensor.campaign import CampaignError

    try:
        code = app(args=arguments, prog_name="bayes-sensor", standalone_mode=False)
        sys.stdout.flush()
        if code == INTERRUPTED:  # how newer typer hands on Ctrl-C
            interruption_has_come()
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
        return _stop(arguments)
    except SystemError as error:
        # Ctrl-C inside compiled code can come out as the SystemError that it caused
        if not isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            raise
        return _stop(arguments)
    except BrokenExecutor as error:  # a worker of a step that is not repeated
        return _complain(
            f"a worker process ended unexpectedly, killed or out of memory ({error}); expected it "
            f"to finish: use fewer --jobs; {advice(arguments)}"
        )
    except BrokenPipeError:
        # whoever read our output has left; nothing more to say, and not at shutdown either
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except OSError as error:  # disk full, no permission: everything else is a mistake of ours
        if not _has_working_directory():
            return _complain(
                "the working directory: it has been removed; expected a folder that exists: change "
                "to another one"
            )
        where = f"{error.filename}: " if error.filename else ""
        return _complain(
            f"{where}the results cannot be written ({error.strerror or error}); check the free "
            "space and the permissions of --out"
        )


def _has_working_directory() -> bool:
    try:
        os.getcwd()
    except OSError:
        return False
    return True


def _stop(arguments: list[str]) -> int:
    """Say how to go on; the exit code."""
    interruption_has_come()
    _say_on_stderr(stopped(arguments))
    return code_of_interruption()


def _say_on_stderr(line: str) -> None:
    with suppress(OSError, ValueError):  # closed, or nobody reads any more
        print(line, file=sys.stderr, flush=True)


def _complain(message: str) -> int:
    shown = "".join(c if c.isprintable() else "\ufffd" for c in " ".join(message.split()))
    _say_on_stderr(f"error: {shown}")
    return BAD_INPUT
