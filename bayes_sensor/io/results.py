"""A results directory: complete files only, one writer at a time, and a record of every run.

Everything that the report shows is read back from here, so that it can be rebuilt without the
data.  Traces are kept as envelopes: the least and the greatest sample of each of some hundred
stretches, which looks the same as all samples and stays small.
"""

from __future__ import annotations

import logging
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.disk import (
    own_folder,
    remove,
    remove_links,
    write_bytes,
    write_text,
)
from bayes_sensor.io.folder_lock import Lock
from bayes_sensor.io.json_files import read_json, write_json

LOCK, RUN = ".lock", "run.json"

STAGE, COMPLETE, OLD, DROP = ".stage-", ".complete", ".old-", ".drop.json"
"""of a run's results: being written; complete, about to be moved; replaced; names to remove"""

VOID = (
    "posterior_without_effects.json", "predictive.json", "gap.json", "gap_where.csv",
    "gap_which.csv", "report.html", "fleet.svg", "fleet.png", "next.toml", "next_truth.json",
    "bounds.json", "bounds.csv", "delays.json", "fit_record.npz", "residuals_record.npz",
    "posterior_record.npz", "predictive_record.npz", "bounds_record.npz", "delays_record.npz",
    "gap_record.npz",
)  # fmt: skip
"""earlier results that a run may make void: nothing else is ever removed by name"""

FOLDERS = ("figures", "campaigns", "sealed", "verdicts")
"""folders among results: no other is ever moved or replaced"""

LOG = logging.getLogger(__name__)


@dataclass(eq=False)
class Stage:
    """Where a command writes before its results take their place."""

    folder: Path
    """the results directory"""
    inside: Path
    """a folder in it, of the same file system, removed at the end"""
    drop: list[str] = field(default_factory=list)
    """names of earlier results that the new ones make void, of :data:`VOID`"""

    def json(self, name: str, content: Any) -> None:
        """Put a JSON result."""
        write_json(self.inside / name, content)

    def text(self, name: str, content: str) -> None:
        """Put a text file."""
        write_text(self.inside / name, content)

    def binary(self, name: str, content: bytes) -> None:
        """Put a file, such as a picture."""
        write_bytes(self.inside / name, content)

    def path(self, name: str) -> Path:
        """Where another writer shall put ``name``."""
        return self.inside / name

    def complete(self) -> None:
        """Write down what to remove; ValueError for what no run may replace or remove."""
        folders = {p.name for p in self.inside.iterdir() if p.is_dir()}
        if unknown := sorted({*self.drop} - {*VOID} | folders - {*FOLDERS}):
            raise ValueError(f"{', '.join(unknown)}: not in VOID or FOLDERS of results.py; add it")
        if self.drop:
            write_json(self.inside / DROP, self.drop)


class Results:
    """A results directory.

    >>> folder = tempfile.mkdtemp()
    >>> with Results(folder).writing() as stage:
    ...     stage.json("fit.json", {"rms_V": 0.5})
    >>> Results(folder).json("fit.json")
    {'rms_V': 0.5}
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)

    def has(self, name: str) -> bool:
        """Whether a result was saved."""
        return (self.folder / name).is_file()

    def json(self, name: str) -> Any:
        """A saved JSON result, or None where there is none."""
        return read_json(self.folder / name) if self.has(name) else None

    def path(self, name: str) -> Path:
        """The path of a result."""
        return self.folder / name

    def own_folder(self, name: str) -> Path:
        """The path of a folder inside; CampaignError where a link stands in its place."""
        return own_folder(self.folder / name)

    @contextmanager
    def locked(self, patience: float = 0.0) -> Iterator[None]:
        """Make the directory where it is missing and hold it for this process alone.

        ``patience``: seconds to wait for another process that holds it.  A lock whose owner has
        ended holds nobody up, and what that owner had begun to put in place is put in place.

        Raises
        ------
        CampaignError
            If another process is writing there, or the directory cannot be made or written.
        """
        made = [p for p in (self.folder, *self.folder.parents) if not p.exists()]
        deadline = time.monotonic() + patience
        lock: Lock | None = None
        try:
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
                while not (lock := Lock(self.folder / LOCK)).held:
                    if time.monotonic() >= deadline:
                        raise CampaignError(
                            f"--out {self.folder}: another bayes-sensor is writing there "
                            f"({lock.owner}); expected a folder in use by one run: wait for it or "
                            f"choose another folder{lock.advice}"
                        )
                    time.sleep(0.2)
                self._put_in_place()
            except OSError as error:
                raise CampaignError(
                    f"--out {self.folder}: results cannot be written there "
                    f"({error.strerror or error}); expected a folder that can be written: "
                    "choose another"
                ) from None
            yield
        finally:
            if lock is not None:
                lock.release()
            for folder in made:  # whatever stayed empty goes again
                if folder.is_dir() and not any(folder.iterdir()):
                    folder.rmdir()

    @contextmanager
    def writing(self) -> Iterator[Stage]:
        """A stage to write to; what is on it replaces earlier results when the block ends well.

        An exception inside leaves the earlier results as they were.  From the moment when the
        stage is complete and renamed, a run that is killed has its results: whoever holds the
        directory next puts them in place.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        self._put_in_place()
        inside = Path(tempfile.mkdtemp(prefix=STAGE, dir=self.folder))
        stage = Stage(self.folder, inside)
        try:
            yield stage
            stage.complete()
            os.replace(inside, self.folder / COMPLETE)
            self._put_in_place()
        finally:
            shutil.rmtree(inside, ignore_errors=True)

    def _put_in_place(self) -> None:
        """Move what stands on a complete stage to its place; clear what a killed run left.

        The folder may be a stranger's.  Links are not followed; a folder is replaced only where it
        is one of :data:`FOLDERS`, a file removed only where it is one of :data:`VOID`.
        """
        for rest in (*self.folder.glob(f"{STAGE}*"), *self.folder.glob(f"{OLD}*")):
            if rest.is_dir() and not rest.is_symlink():
                remove(rest)
        complete = self.folder / COMPLETE
        if complete.is_symlink():
            complete.unlink()
        if not complete.is_dir():
            return
        remove_links(complete)
        sources = sorted(p for p in complete.iterdir() if not p.name.startswith("."))
        for source in (p for p in sources if p.name in FOLDERS and p.is_dir()):
            target = self.folder / source.name
            if target.is_dir() and not target.is_symlink():
                old = Path(tempfile.mkdtemp(prefix=OLD, dir=self.folder))
                os.replace(target, old / source.name)
                os.replace(source, target)
                remove(old)
            else:
                target.unlink(missing_ok=True)
                os.replace(source, target)
        # run.json last: it speaks of what is there
        for source in sorted((p for p in sources if p.is_file()), key=lambda p: p.name == RUN):
            os.replace(source, self.folder / source.name)
        for void in (self.folder / name for name in _void(complete / DROP)):
            if void.is_file() or void.is_symlink():
                void.unlink()
        remove(complete)


def _void(path: Path) -> list[str]:
    """The names in a list of what to remove; those that are not in :data:`VOID` are left out."""
    if not path.is_file():
        return []
    try:
        listed = read_json(path)
    except CampaignError as error:  # cut off by a power failure: nobody can mend it
        LOG.warning("earlier results that were to be removed may still be there: %s", error)
        return []
    return [name for name in VOID if isinstance(listed, list) and name in listed]
