"""JSON without NaN: values made plain, written whole, read with one clear message."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np

from bayes_sensor.io.disk import write_text
from bayes_sensor.io.untrusted import read_json

__all__ = ["json_text", "plain", "read_json", "sha256", "write_json"]


def plain(value: Any, where: str = "result") -> Any:
    """The value as JSON knows it: no array, no NaN, no infinity (both become None).

    >>> plain({"a": np.array([1.0, np.nan]), "b": np.int64(2)})
    {'a': [1.0, None], 'b': 2}

    Raises TypeError, naming the place, for anything else.
    """
    if value is None or isinstance(value, str | bool):
        return value
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(entry, f"{where}.{key}") for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), where)
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(entry, f"{where}[{i}]") for i, entry in enumerate(value)]
    raise TypeError(f"{where}: a {type(value).__name__} has no place in JSON")


def json_text(content: Any) -> str:
    """UTF-8 text of a result, with a closing line feed."""
    return json.dumps(plain(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_json(path: str | os.PathLike[str], content: Any) -> None:
    """Write a result as JSON, complete or not at all."""
    write_text(path, json_text(content))


def sha256(path: str | os.PathLike[str]) -> str:
    """Hash of a file's content."""
    digest = hashlib.sha256()
    with open(path, "rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
