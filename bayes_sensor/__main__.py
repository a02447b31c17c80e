"""The entry point of the command ``bayes-sensor`` and of ``python -m bayes_sensor``."""

import os
import signal
import sys
from types import FrameType


def run() -> None:
    """Load the command and run it; Ctrl-C is answered in one line from here on.

    The command brings its own answer to Ctrl-C, but loading it takes a few tenths of a second.
    """
    signal.signal(signal.SIGINT, _stop_at_once)
    from bayes_sensor.cli import main

    main()


def _stop_at_once(_signal: int, _frame: FrameType | None) -> None:
    if sys.stderr is not None:
        words = b"stopped: interrupted before anything was begun; run the same command again\n"
        os.write(2, words)
    os._exit(130)


if __name__ == "__main__":
    run()
