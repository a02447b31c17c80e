"""NumPy archives that the results hold: arrays, and facts about them as JSON."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_sensor.io.disk import replacing
from bayes_sensor.io.untrusted import LARGEST_JSON, parse_json, read_arrays, refused

FACTS = "facts"
LARGEST = 1e100
"""of a number in an array: its square is one, too"""


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
    content = read_arrays(path, what)
    facts = content.pop(FACTS, None)
    if facts is None or facts.dtype != np.uint8 or facts.nbytes > LARGEST_JSON:
        raise refused(path, f"saved {what}", "there are no facts in the archive")
    return parse_json(facts.tobytes(), path), content


def check_array(
    path: str | os.PathLike[str],
    arrays: Mapping[str, np.ndarray],
    name: str,
    kinds: str,
    shape: tuple[int | None, ...],
) -> np.ndarray:
    """The array of a name; CampaignError for another kind of numbers or shape, or for no numbers.

    ``shape``: lengths, None for any but 0.
    """
    array = arrays.get(name)
    if array is None:
        raise refused(path, f"an array {name}", "there is none")
    alike = array.ndim == len(shape) and array.size > 0
    if not alike or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        wanted = " x ".join("any" if n is None else str(n) for n in shape)
        raise refused(path, f"an array {name} of shape {wanted}", f"it has {array.shape}")
    if array.dtype.kind not in kinds:
        raise refused(path, f"an array {name} of numbers", f"it holds {array.dtype}")
    if array.dtype.kind == "f" and not float(np.abs(array).max()) < LARGEST:  # nan is not, too
        raise refused(path, f"an array {name}", "a number in it is not finite, or out of range")
    return array
