"""Where compiled code is kept, and which of it is out of date.

Numba keeps it beside the source or in the home directory, and refuses to compile where it may write
to neither, as in a container that runs under another account.  It compiles a function again once
the function's own file has changed, but not for a change of a function that it calls.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, MutableMapping
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

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


def forget_older(functions: Iterable[Any], modules: Iterable[ModuleType]) -> None:
    """Remove what is kept of compiled ``functions`` and older than the ``modules`` they call."""
    changed = max(os.stat(str(module.__file__)).st_mtime for module in modules)
    for function in functions:
        if not hasattr(function, "stats"):
            return  # compilation is switched off
        name = f"{function.__module__.rpartition('.')[2]}.{function.__name__}-*.nbi"
        for index in Path(function.stats.cache_path).glob(name):
            with suppress(OSError):  # another process has removed it, or nothing can be written
                if index.stat().st_mtime < changed:
                    index.unlink()
