"""The entry point of the command ``bayes-sensor`` and of ``python -m bayes_sensor``."""

import os
import signal
import sys
from types import FrameType

THREADS = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
)  # fmt: skip
"""what numpy's linear algebra reads when it is loaded.  Matrices are small here: more threads than
one only wait for each other, and where something else is running, ten times as long"""


def run() -> None:
    """Load the command and run it; Ctrl-C is answered in one line from here on.

    The command brings its own answer to Ctrl-C, but loading it takes a few tenths of a second.
    """
    signal.signal(signal.SIGINT, _stop_at_once)
    for name in THREADS:
        os.environ.setdefault(name, "1")
    from bayes_sensor.cli import main

    main()


def _stop_at_once(_signal: int, _frame: FrameType | None) -> None:
    if sys.stderr is not None:
        words = b"stopped: interrupted before anything was begun; run the same command again\n"
        os.write(2, words)
    os._exit(130)


if __name__ == "__main__":
    run()
