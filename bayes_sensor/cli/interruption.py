"""Ctrl-C: stop at once, say how to go on, and leave results as they were."""

from __future__ import annotations

import atexit
import os
import shlex
import signal
import sys
import time
from contextlib import suppress
from types import FrameType
from typing import Any

INTERRUPTED = 130
"""the exit code"""
RESUMABLE = ("analyze", "posterior", "bounds", "blind-check", "coverage", "fleet")
REPEAT_SECONDS = 1.0
"""after Ctrl-C, how often the interruption is repeated until it takes effect"""
SOON_SECONDS = 0.05
PATIENCE_SECONDS = 0.3
"""how often, and for how long, a running compiler is waited for"""


def be_interruptible(arguments: list[str]) -> None:
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

            aloud(stopped(arguments))
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


def interruption_has_come() -> None:
    """Repeat it no more."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def ignore_interruptions() -> None:
    """Ignore Ctrl-C from here on, because nothing is left to stop."""
    interruption_has_come()
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def leave_at_once(code: int) -> None:
    """End the process without Python's own shutdown, which takes most of a second.

    Functions registered for the end of the process still run.
    """
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # closed, or nobody reads any more
            stream.flush()
    os._exit(code)


def advice(arguments: list[str]) -> str:
    """What to type after an interruption."""
    if arguments and arguments[0] in RESUMABLE:
        more = [] if "--resume" in arguments else ["--resume"]
        return f"continue with: {shlex.join(['bayes-sensor', *arguments, *more])}"
    return "earlier results are as they were; run the same command again"


def stopped(arguments: list[str]) -> str:
    """The line on stderr after an interruption."""
    return " ".join(f"stopped: interrupted; {advice(arguments)}".split())
