"""Fields of a record against the types that it declares."""

from __future__ import annotations

import types
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import (
    AfterValidator,
    ConfigDict,
    InstanceOf,
    TypeAdapter,
    ValidationError,
    with_config,
)
from typing_extensions import TypedDict

STRICT = ConfigDict(arbitrary_types_allowed=True, strict=True)
PLAIN = (bool, int, float, complex, str, bytes, list, dict, tuple, set, frozenset, object)


def check_fields(kind: type, content: Mapping[str, Any]) -> None:
    """Raise TypeError where a field of ``content`` has not the type that ``kind`` declares.

    Arrays are held to their type of number.  A field whose type is known to type checkers alone is
    left to the constructor of ``kind``.
    """
    try:
        _adapter(kind).validate_python(dict(content))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part)[:40] for part in first["loc"])
        raise TypeError(f"{kind.__name__}.{place}: {first['msg']}") from None


@cache
def _adapter(kind: type) -> TypeAdapter[Any]:
    hints: dict[str, Any] = {}
    for name, hint in getattr(kind, "__annotations__", {}).items():
        alone = {"__annotations__": {name: hint}, "__module__": kind.__module__}
        with suppress(NameError):
            hints |= get_type_hints(type(kind.__name__, (), alone))
    checkable = {name: _checkable(hint) for name, hint in hints.items()}
    made: Any = TypedDict(kind.__name__, checkable, total=False)  # type: ignore[misc]
    return TypeAdapter(with_config(STRICT)(made))


def _checkable(hint: Any) -> Any:
    """The type as pydantic can check it without making values anew."""
    origin: Any = get_origin(hint)
    parts = get_args(hint)
    if origin is np.ndarray:
        (number,) = get_args(parts[1]) or (Any,)
        return Annotated[np.ndarray, AfterValidator(_of_numbers(number))]
    if origin is Literal or hint in (Any, None, types.NoneType) or hint in PLAIN:
        return hint
    instance: Any = InstanceOf
    if origin is Callable or hint is Callable:
        return instance[types.FunctionType]
    if origin in (Union, types.UnionType):
        members: Any = tuple(_checkable(each) for each in parts)
        return Union[members]  # noqa: UP007  made here
    if origin is not None:
        return origin[tuple(each if each is ... else _checkable(each) for each in parts)]
    return instance[hint] if isinstance(hint, type) else hint


def _of_numbers(number: Any) -> Callable[[np.ndarray], np.ndarray]:
    def check(array: np.ndarray) -> np.ndarray:
        if isinstance(number, type) and not np.issubdtype(array.dtype, number):
            raise ValueError(f"an array of {number.__name__} was expected, not of {array.dtype}")
        return array

    return check
