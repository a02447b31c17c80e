"""Ctrl-C and its like: stop at once, say how to go on, and leave results as they were.

The like are SIGTERM, by which a batch system or a service stops a program, and SIGHUP, by which a
terminal that is closed does; a program that was told to ignore it, as by ``nohup``, goes on.
"""

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
"""the exit code after Ctrl-C; after another signal it is 128 and the signal's number"""
WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}
"""the signals that stop a run, and what is said of it"""
_first: list[int] = []
"""the signal that came first"""
RESUMABLE = ("analyze", "posterior", "bounds", "blind-check", "coverage", "fleet")
REPEAT_SECONDS = 1.0
"""after Ctrl-C, how often the interruption is repeated until it takes effect"""
SOON_SECONDS = 0.05
PATIENCE_SECONDS = 0.3
"""how often, and for how long, a running compiler is waited for"""


def be_interruptible(arguments: list[str]) -> None:
    """Let Ctrl-C and its like raise KeyboardInterrupt, now and again later.

    Python drops an exception that a signal raises inside a destructor or a callback of compiled
    code; a long run would then continue.  A compiler turns the exception into errors of its own.
    It may therefore finish its work; if that takes long, the process ends, as safely as if it had
    been killed.
    """
    pressed: list[float] = []

    def insist(number: int, frame: FrameType | None) -> None:
        if not _first:  # the others are repetitions
            _first.append(number)
        if not hasattr(signal, "setitimer"):
            raise KeyboardInterrupt
        if not _is_compiling(frame):
            signal.setitimer(signal.ITIMER_REAL, REPEAT_SECONDS)
            raise KeyboardInterrupt
        pressed.append(time.monotonic())
        if pressed[-1] - pressed[0] > PATIENCE_SECONDS:
            from bayes_sensor.cli.logged_notes import aloud  # the compiler's caller may be muted

            aloud(stopped(arguments))
            os._exit(code_of_interruption())
        signal.setitimer(signal.ITIMER_REAL, SOON_SECONDS)

    for stopping in _stopping():
        signal.signal(stopping, insist)
    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, insist)
    told = sys.unraisablehook

    def tell(lost: Any) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):  # that one comes again
            told(lost)

    sys.unraisablehook = tell


def _stopping() -> list[signal.Signals]:
    """The signals that stop a run here; Ctrl-C always does."""
    known = [signal.Signals[name] for name in WORDS if name in signal.Signals.__members__]
    return [s for s in known if s == signal.SIGINT or signal.getsignal(s) != signal.SIG_IGN]


def code_of_interruption() -> int:
    """The exit code after the signal that came."""
    return 128 + _first[0] if _first else INTERRUPTED


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
    """Ignore Ctrl-C and its like from here on, because nothing is left to stop."""
    interruption_has_come()
    for stopping in _stopping():
        signal.signal(stopping, signal.SIG_IGN)


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
    word = WORDS[signal.Signals(_first[0]).name if _first else "SIGINT"]
    return " ".join(f"stopped: {word}; {advice(arguments)}".split())
