"""Files written whole, and never written, moved or removed through a symbolic link.

A folder may come from anyone: from an archive, a shared disk, a run of another account.  What it
holds decides about nothing outside of it.
"""

from __future__ import annotations

import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bayes_sensor.campaign import CampaignError


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A new file beside ``path``; it takes the place of ``path`` when the block ends well.

    The name ``path`` never holds a half.  The new file is made by this call (``O_EXCL``), under a
    name that cannot be foreseen, so no link leads anywhere else; where ``path`` is a link, the link
    is replaced and not what it points to.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "a.txt"
    >>> with replacing(path) as new:
    ...     _ = new.write_text("whole")
    >>> path.read_text(), len(list(path.parent.iterdir()))
    ('whole', 1)
    """
    path = Path(path)
    new = path.with_name(f".{path.name}.{secrets.token_hex(6)}.part")
    new.open("xb").close()
    try:
        yield new
        os.replace(new, path)
    finally:
        new.unlink(missing_ok=True)


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file, complete or not at all."""
    with replacing(path) as new:
        new.write_bytes(content)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file in UTF-8 with line feeds, complete or not at all.

    What is no letter, such as a byte of a file's name that its system cannot decode, is escaped.
    """
    with replacing(path) as new:
        new.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def own_folder(path: Path) -> Path:
    """``path``, a folder inside another that may be missing still.

    Raises CampaignError where a link stands in its place: what is written and removed in there
    would be somewhere else.
    """
    if path.is_symlink():
        raise CampaignError(
            f"{path}: expected a folder, but it is a symbolic link to {os.readlink(path)}, and "
            "links inside a results folder are not followed; remove the link"
        )
    return path


def remove(path: Path) -> None:
    """Remove a file, a folder with all it holds, or a link but not what it points to."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def remove_links(folder: Path) -> None:
    """Remove from a folder, at any depth, what is neither a file nor a folder of its own."""
    for place, folders, files in os.walk(folder):  # goes through no link
        for path in (Path(place, name) for name in [*folders, *files]):
            mode = path.lstat().st_mode
            if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
                path.unlink()
