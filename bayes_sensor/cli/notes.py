"""What the rooms log as a warning: said at once on stderr, and kept for run.json."""

from __future__ import annotations

import logging
import os
import sys

_kept: list[str] = []


class _Notes(logging.Handler):
    """Writes to the stderr that the process began with, which ``muted`` does not reach."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        try:
            self.descriptor: int | None = os.dup(sys.stderr.fileno())
        except (OSError, ValueError, AttributeError):  # no stderr, or not a file
            self.descriptor = None

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        _kept.append(text)
        if self.descriptor is not None:
            os.write(self.descriptor, f"note: {text}\n".encode(errors="replace"))


def take_notes() -> None:
    """Begin to keep and to say what is logged; a second call changes nothing."""
    log = logging.getLogger("bayes_sensor")
    if not any(isinstance(handler, _Notes) for handler in log.handlers):
        log.addHandler(_Notes())
        log.propagate = False


def noted() -> list[str]:
    """What has been logged so far."""
    return list(_kept)
