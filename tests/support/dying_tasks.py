"""A task that kills its own process; on its own so that a worker has little to load."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any


class Dying:
    """Squares; kills its own process at some calls, the first time or always."""

    def __init__(self, folder: Path, once: int = -1, always: int = -1) -> None:
        self.folder, self.once, self.always = folder, once, always

    def __call__(self, i: int) -> Any:
        mark = self.folder / f"died-{i}"
        if i == self.always or (i == self.once and not mark.exists()):
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return i * i


class DyingStudy(Dying):
    """The same as the task of a study."""

    def __call__(self, i: int) -> dict[str, float]:
        return {"x": float(super().__call__(i))}
