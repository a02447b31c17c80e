"""What the rooms log as a warning: said at once on stderr, and kept for run.json.

``aloud`` says a line on the stderr that the process began with, which ``muted`` does not reach.
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
    """Begin to keep and to say what is logged; a second call changes nothing."""
    global _first_stderr
    log = logging.getLogger("bayes_sensor")
    if not any(isinstance(handler, _Notes) for handler in log.handlers):
        # no stderr, or not a file: nothing is said
        with suppress(OSError, ValueError, AttributeError):
            _first_stderr = os.dup(sys.stderr.fileno())
        log.addHandler(_Notes(logging.WARNING))
        log.propagate = False


def aloud(line: str) -> None:
    """Say a line even while everything is muted."""
    if _first_stderr is not None:
        with suppress(OSError):  # nobody reads it any more
            os.write(_first_stderr, f"{line}\n".encode(errors="replace"))


def noted() -> list[str]:
    """What has been logged so far."""
    return list(_kept)
