"""Records of this package in a file, and back: every field as it was, to the last digit.

A record (a frozen dataclass) is written as a tree of plain values with its arrays beside it, in one
NumPy archive.  Nothing in the file is executed: only records and functions of :data:`ROOMS` are
looked up, each field must have the type that its record declares, and records are made by their
constructors, which check what they get.  A hash of all of it tells what was edited.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from math import isfinite
from types import FunctionType
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.array_archive import load_archive, save_archive
from bayes_sensor.io.field_types import check_fields
from bayes_sensor.io.untrusted import refused

PACKAGE = "bayes_sensor"
ROOMS = (
    "campaign", "experiment", "rig", "io", "likelihood", "fit", "residuals", "posterior", "bounds",
    "checks", "diagnosis",
)  # fmt: skip
"""of the package, that have records to be saved"""
VERSION = 2
"""of the layout of the file"""
EVEN = 1000
"""length from which an evenly spaced array is looked for"""
MOST_EVEN = 1 << 27
KIND = "$"
"""key that says what a mapping of the tree stands for"""


def save_record(
    path: str | os.PathLike[str], record: Any, known: Mapping[str, Any] | None = None
) -> None:
    """Write a record.  ``known``: objects by name that the reader has, too, and are not written.

    Raises TypeError for what cannot be written, such as a function made inside another.
    """
    writer = _Writer({id(value): name for name, value in (known or {}).items()})
    tree = writer.tree(record)
    facts = {"version": VERSION, "sha256": _digest(tree, writer.arrays), "record": tree}
    save_archive(path, facts, writer.arrays)


def load_record(
    path: str | os.PathLike[str], what: str, known: Mapping[str, Any] | None = None
) -> Any:
    """What :func:`save_record` wrote; ``what`` it is, for the message.

    Raises
    ------
    CampaignError
        If the file is damaged, or was written by a version with other records.
    """
    facts, arrays = load_archive(path, what)
    try:
        if facts["version"] != VERSION:
            raise ValueError(f"version {facts['version']}")
        if facts["sha256"] != _digest(facts["record"], arrays):
            raise ValueError("it was changed since it was saved")
        return _Reader(arrays, known or {}).value(facts["record"])
    except (
        AttributeError, ImportError, IndexError, KeyError, OverflowError, RecursionError, TypeError,
        ValueError,
    ) as error:  # fmt: skip
        said = str(error) if isinstance(error, CampaignError) else repr(error)
        told = f"it cannot be read ({' '.join(said.split())[:160]})"
        raise refused(path, f"a saved {what} of this version", told) from None


def _digest(tree: Any, arrays: Mapping[str, np.ndarray]) -> str:
    """One hash of a record's plain values and its arrays."""
    found = hashlib.sha256(json.dumps(tree, sort_keys=True, allow_nan=False).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {array.shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()


class _Writer:
    """Makes the tree, and keeps each array once."""

    def __init__(self, known: Mapping[int, str]) -> None:
        self.known = known
        self.arrays: dict[str, np.ndarray] = {}
        self._places: dict[int, dict[str, Any]] = {}
        self._alive: list[Any] = []  # an id is of one object only while that lives

    def tree(self, value: Any) -> Any:
        if id(value) in self.known:
            return {KIND: "known", "name": self.known[id(value)]}
        if value is None or isinstance(value, bool | str):
            return value
        if isinstance(value, np.ndarray):
            return self._array(value)
        if isinstance(value, np.generic):
            return {KIND: "scalar", "array": self._array(np.asarray(value))}
        if isinstance(value, int):
            return value
        if isinstance(value, float):
            return value if isfinite(value) else {KIND: "float", "text": repr(value)}
        if isinstance(value, list):
            return [self.tree(each) for each in value]
        if isinstance(value, Mapping):
            items = [[self.tree(k), self.tree(v)] for k, v in value.items()]
            return {KIND: "mapping", "items": items}
        if isinstance(value, tuple) and hasattr(value, "_fields"):
            return self._made(value, dict(zip(value._fields, value, strict=True)))
        if isinstance(value, tuple | frozenset | set):
            kind = next(k for k in (tuple, frozenset, set) if isinstance(value, k))
            return {KIND: kind.__name__, "items": [self.tree(each) for each in value]}
        if isinstance(value, FunctionType) and "<" not in value.__qualname__:
            return {KIND: "function", "of": _name(value)}
        if is_dataclass(value) and not isinstance(value, type):
            return self._made(value, {f.name: getattr(value, f.name) for f in fields(value)})
        raise TypeError(f"a {type(value).__name__} cannot be saved")

    def _made(self, value: Any, content: Mapping[str, Any]) -> dict[str, Any]:
        if not type(value).__module__.startswith(f"{PACKAGE}."):
            raise TypeError(f"a {type(value).__name__} is no record of {PACKAGE}")
        made = {name: self.tree(each) for name, each in content.items()}
        return {KIND: "record", "of": _name(type(value)), "fields": made}

    def _array(self, value: np.ndarray) -> dict[str, Any]:
        if value.dtype.kind not in "biufcU":
            raise TypeError(f"an array of {value.dtype} cannot be saved")
        if id(value) not in self._places:
            self._alive.append(value)
            name = f"a{len(self.arrays)}"
            even = _even(value)
            if even is None:
                self.arrays[name] = value
                self._places[id(value)] = {KIND: "array", "name": name}
            else:
                self._places[id(value)] = {KIND: "even", "is": even}
        return self._places[id(value)]


class _Reader:
    """Makes records of the tree."""

    def __init__(self, arrays: Mapping[str, np.ndarray], known: Mapping[str, Any]) -> None:
        self.arrays = arrays
        self.known = known

    def value(self, tree: Any) -> Any:
        if isinstance(tree, list):
            return [self.value(each) for each in tree]
        if not isinstance(tree, dict):
            return tree
        return self._kinds[tree[KIND]](self, tree)

    def _array(self, tree: Mapping[str, Any]) -> np.ndarray:
        return self.arrays[tree["name"]]

    def _record(self, tree: Mapping[str, Any]) -> Any:
        kind = _found(tree["of"])
        if not (isinstance(kind, type) and (is_dataclass(kind) or hasattr(kind, "_fields"))):
            raise TypeError(f"{tree['of']} is no record")
        content = {name: self.value(each) for name, each in tree["fields"].items()}
        check_fields(kind, content)
        return kind(**content)

    def _function(self, tree: Mapping[str, Any]) -> Any:
        found = _found(tree["of"])
        if not isinstance(found, FunctionType):
            raise TypeError(f"{tree['of']} is no function")
        return found

    def _items(self, tree: Mapping[str, Any]) -> list[Any]:
        return [self.value(each) for each in tree["items"]]

    _kinds: Mapping[str, Callable[[_Reader, Mapping[str, Any]], Any]] = {
        "known": lambda self, tree: self.known[tree["name"]],
        "array": _array,
        "scalar": lambda self, tree: self.value(tree["array"])[()],
        "even": lambda self, tree: _spaced(*tree["is"]),
        "float": lambda self, tree: float(tree["text"]),
        "mapping": lambda self, tree: {self.value(k): self.value(v) for k, v in tree["items"]},
        "tuple": lambda self, tree: tuple(self._items(tree)),
        "set": lambda self, tree: set(self._items(tree)),
        "frozenset": lambda self, tree: frozenset(self._items(tree)),
        "record": _record,
        "function": _function,
    }


def _name(thing: Any) -> str:
    return f"{thing.__module__}:{thing.__qualname__}"


def _found(name: str) -> Any:
    """What this package calls so."""
    module, _, path = name.partition(":")
    package, *rooms = module.split(".")
    if package != PACKAGE or not rooms or rooms[0] not in ROOMS:
        raise TypeError(f"{name} is no record of {PACKAGE}")
    found: Any = import_module(module)
    for part in path.split("."):
        found = getattr(found, part)
    if getattr(found, "__module__", "") != module:
        raise TypeError(f"{name} is not defined there")
    return found


def _spaced(start: float, step: float, n: int) -> np.ndarray:
    if not 0 <= n <= MOST_EVEN:
        raise ValueError(f"{n} even times")
    return start + step * np.arange(n, dtype=float)


def _even(array: np.ndarray) -> list[Any] | None:
    """Start, step and length of times on a grid, where these give the array to the last digit."""
    if array.dtype != float or array.ndim != 1 or len(array) < EVEN or not np.isfinite(array).all():
        return None
    start = float(array[0])
    step = float(f"{(array[-1] - start) / (len(array) - 1):.12g}")
    made = _spaced(start, step, len(array))
    return [start, step, len(array)] if np.array_equal(made, array) else None
