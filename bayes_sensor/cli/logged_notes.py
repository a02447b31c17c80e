"""Logged warnings: printed at once on stderr, and kept for run.json.

``aloud`` prints a line on the original stderr of the process, which ``muted`` does not change.
"""

from __future__ import annotations

import logging
import os
import sys
from contextlib import suppress

_kept: list[str] = []
_first_stderr: int | None = None


class _Notes(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        _kept.append(text)
        aloud(f"note: {text}")


def take_notes() -> None:
    """Begin to keep and print logged warnings; a second call changes nothing."""
    global _first_stderr
    log = logging.getLogger("bayes_sensor")
    if not any(isinstance(handler, _Notes) for handler in log.handlers):
        # no stderr, or not a file: nothing is said
        with suppress(OSError, ValueError, AttributeError):
            _first_stderr = os.dup(sys.stderr.fileno())
        log.addHandler(_Notes(logging.WARNING))
        log.propagate = False


def aloud(line: str) -> None:
    """Print a line even while everything is muted."""
    if _first_stderr is not None:
        with suppress(OSError):  # nobody reads it any more
            os.write(_first_stderr, f"{line}\n".encode(errors="replace"))


def noted() -> list[str]:
    """The warnings logged so far."""
    return list(_kept)
