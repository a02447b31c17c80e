"""NumPy archives that the results hold: arrays, and facts about them as JSON."""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.disk import replacing

FACTS = "facts"


def save_archive(path: str | os.PathLike[str], facts: Any, arrays: Mapping[str, Any]) -> None:
    """Write ``arrays`` by name and ``facts``, plain numbers and texts, into one file."""
    text = np.frombuffer(json.dumps(facts, allow_nan=False).encode("utf-8"), dtype=np.uint8)
    content: dict[str, Any] = {**arrays, FACTS: text}
    with replacing(path) as new, new.open("wb") as stream:
        np.savez_compressed(stream, **content)


def load_archive(path: str | os.PathLike[str], what: str) -> tuple[Any, dict[str, np.ndarray]]:
    """Facts and arrays that :func:`save_archive` wrote; ``what`` they are, for the message.

    Raises CampaignError for a file that is damaged or holds something else.
    """
    try:
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            content = {name: archive[name] for name in archive.files}
        facts = json.loads(content.pop(FACTS).tobytes().decode("utf-8"))
    except (
        OSError, ValueError, KeyError, EOFError, AttributeError, TypeError, NotImplementedError,
        RuntimeError, zlib.error, BadZipFile,
    ) as error:  # fmt: skip
        raise unreadable(path, what, error) from None
    return facts, content


def unreadable(path: str | os.PathLike[str], what: str, error: Exception) -> CampaignError:
    """The error for an archive that cannot be read."""
    return CampaignError(
        f"{path}: expected saved {what}, but they cannot be read ({error}); "
        "run the command that made them again"
    )
