"""The entry point of the command ``bayes-sensor`` and of ``python -m bayes_sensor``."""

import os
import signal
import sys
from contextlib import suppress
from types import FrameType

THREADS = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
)  # fmt: skip
"""what numpy's linear algebra reads when it is loaded.  Matrices are small here: more threads than
one only wait for each other, and where something else is running, ten times as long"""


def run() -> None:
    """Load the command and run it; Ctrl-C and its like are answered in one line from here on.

    The command brings its own answer, but loading it takes a few tenths of a second.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # SIGHUP is not on every system
        if number is not None and (name == "SIGINT" or signal.getsignal(number) != signal.SIG_IGN):
            signal.signal(number, _stop_at_once)
    for name in THREADS:
        os.environ.setdefault(name, "1")
    from bayes_sensor.cli import main

    main()


def _stop_at_once(number: int, _frame: FrameType | None) -> None:
    if sys.stderr is not None:
        words = b"stopped: interrupted before anything was begun; run the same command again\n"
        with suppress(OSError):  # the terminal has gone
            os.write(2, words)
    os._exit(128 + number)


if __name__ == "__main__":
    run()
