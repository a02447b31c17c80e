"""Where compiled code is kept, and which of it is out of date.

Numba keeps it beside the source or in the home directory, and refuses to compile where it may write
to neither, as in a container that runs under another account.  It compiles a function again once
the date of the function's own file has changed; here for another text of that file, another
constant and another function that it calls, and for nothing else.
"""

from __future__ import annotations

import os
from collections.abc import Callable, MutableMapping
from functools import cache
from hashlib import blake2b
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])
VARIABLE = "NUMBA_CACHE_DIR"


def ensure_numba_cache_dir(
    environ: MutableMapping[str, str] = os.environ, package: Path = Path(__file__).parent
) -> None:
    """Set ``NUMBA_CACHE_DIR`` where it is not set and neither usual place can be written to."""
    if VARIABLE in environ or _may_write(package / "__pycache__"):
        return
    home = environ.get("HOME", "")
    caches = environ.get("XDG_CACHE_HOME") or (str(Path(home) / ".cache") if home else "")
    if caches and _may_write(Path(caches) / "numba"):
        return
    import tempfile  # seldom needed, and slow to load

    place = own_folder(Path(tempfile.gettempdir()))
    environ[VARIABLE] = str(place or tempfile.mkdtemp())


def _may_write(folder: Path) -> bool:
    """Whether files can be put there, once it and what it lies in are made."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def own_folder(temporary: Path) -> Path | None:
    """One that is kept from run to run and that nobody else may write to.

    Compiled code is run: None where another account has made it, or may write to it.
    """
    user = os.getuid() if hasattr(os, "getuid") else None
    own = temporary / f"bayes_sensor-{user}"
    try:
        own.mkdir(mode=0o700, exist_ok=True)
        found = own.lstat()
    except OSError:
        return None
    alone = user is None or (found.st_uid == user and not found.st_mode & 0o077)
    return own if alone and own.is_dir() and not own.is_symlink() else None


_listeners: list[Callable[[str], None]] = []


def say_when_compiling(say: Callable[[str], None]) -> None:
    """Have ``say`` tell, once, that a function has to be compiled because none is kept."""
    _listeners.append(say)


def _listen(say: Callable[[str], None]) -> None:
    from numba.core import event

    told: list[str] = []

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            module = event.data["dispatcher"].py_func.__module__
            if not told and module.startswith("bayes_sensor."):
                told.append(module)
                say(
                    "compiling numerical functions: once for each version, a minute or two if all "
                    "of them are needed; later runs start at once"
                )

        def on_end(self, event: Any) -> None:
            """What took how long is not told."""

    register: Any = event.register
    register("numba:compile", Listener())


def compiled(*, inside: bool = False, **options: Any) -> Callable[[F], F]:
    """A decorator: the function compiled by numba, and kept on disk until what it says changes.

    ``inside``: only compiled functions call it; an entry for Python would be a quarter of its time
    to compile.  A helper that should vanish in its callers takes ``forceinline``: numba's own
    inlining compiles it again at every call.  Other ``options`` are numba's.
    """
    import numba  # slow to load

    while _listeners:
        _listen(_listeners.pop())

    def compile_later(function: F) -> F:
        options.update(cache=True, no_cfunc_wrapper=True, no_cpython_wrapper=inside)
        made: Any = numba.njit(**({"error_model": "numpy"} | options))(function)
        if not hasattr(made, "py_func"):
            return function  # compilation is switched off
        made.source = _source(function)
        kept = made._cache._cache_file
        # Numba would look at the function's own file alone, and at its date.
        kept._source_stamp = made.source
        kept._load_index = _empty_if_outdated(kept._load_index)
        return made  # type: ignore[no-any-return]

    return compile_later


def _empty_if_outdated(load: Callable[[], dict[Any, str]]) -> Callable[[], dict[Any, str]]:
    """What loads the index of kept code; nothing is kept where it names classes that are no more.

    Numba unpickles the types of arguments before it compares the source.
    """

    def loaded() -> dict[Any, str]:
        try:
            return load()
        except (AttributeError, ImportError):  # an earlier version had the class
            return {}

    return loaded


def _source(function: Callable[..., Any]) -> str:
    """What a compiled function depends on: its file, the constants and the functions it names."""
    digest = blake2b(_text(function.__code__.co_filename), digest_size=16)
    for name in sorted(function.__code__.co_names):
        value = function.__globals__.get(name)
        if callable(value):
            value = getattr(value, "source", value.__name__)
        if not isinstance(value, ModuleType):
            digest.update(f"{name} {value!r}".encode())
    return digest.hexdigest()


@cache
def _text(file: str) -> bytes:
    return Path(file).read_bytes()
