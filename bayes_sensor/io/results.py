"""A results directory: complete files only, one writer at a time, and a record of every run.

``run.json`` holds a hash of every file that a run has written.  What is not there, or was changed
since, is somebody's own and is neither replaced nor removed.

Everything that the report shows is read back from here, so that it can be rebuilt without the
data.  Traces are kept as envelopes: the least and the greatest sample of each of some hundred
stretches, which looks the same as all samples and stays small.
"""

from __future__ import annotations

import logging
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
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
from bayes_sensor.io.json_files import read_json, sha256, write_json
from bayes_sensor.io.run_record import is_other_campaign

LOCK, RUN, CAMPAIGN = ".lock", "run.json", "campaign.json"

WRITTEN = "written_sha256"
"""key of run.json: hashes by path in the folder"""

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

WRITES = {
    "fit": ("campaign.json", "campaign_record.npz", "fit.json", "fit_record.npz", "traces.npz",
            "samples.npz"),
    "residuals": ("residuals.json", "residuals_record.npz"),
    "posterior": ("posterior.json", "posterior.nc", "posterior_record.npz", "predictive.json",
                  "predictive_record.npz", "posterior_without_effects.json", "coating.json"),
    "bounds": ("bounds.json", "bounds.csv", "bounds_record.npz"),
    "delays": ("delays.json", "delays_record.npz"),
    "gap": ("gap.json", "gap_where.csv", "gap_which.csv", "gap_record.npz"),
    "report": ("report.html", "figures"),
    "coverage": ("coverage.csv", "coverage.json", "coverage.svg", "coverage.png"),
    "fleet": ("fleet.csv", "fleet.json", "index.html", "fleet.svg", "fleet.png"),
    "design": ("design.json", "design.toml", "next.toml", "next_truth.json"),
}  # fmt: skip
"""names that a long step writes, so that one that is somebody's own is told before it begins"""

READ = ("posterior.json",)
"""what a posterior sets its own beside"""

UNFINISHED = ("checkpoint.json", "study.json", "ensemble-*.npz", "chunk-*.npz", ".ensemble-*",
              ".chunk-*")  # fmt: skip
"""in folders of unfinished parts"""

LOG = logging.getLogger(__name__)


@dataclass(eq=False)
class StagingFolder:
    """Where a command writes before its results take their place."""

    results: Results
    """the results directory"""
    inside: Path
    """a folder in it, of the same file system, removed at the end"""
    drop: list[str] = field(default_factory=list)
    """names of earlier results that the new ones make void, of :data:`VOID`"""

    @property
    def folder(self) -> Path:
        """Of the results directory."""
        return self.results.folder

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
        """Write down what to remove and what was written.

        Raises ValueError for what no run may replace or remove, and CampaignError where what would
        be replaced is somebody's own.
        """
        folders = {p.name for p in self.inside.iterdir() if p.is_dir()}
        if unknown := sorted({*self.drop} - {*VOID} | folders - {*FOLDERS}):
            raise ValueError(f"{', '.join(unknown)}: not in VOID or FOLDERS of results.py; add it")
        if self.drop:
            write_json(self.inside / DROP, self.drop)
        names = {p.name for p in self.inside.iterdir() if not p.name.startswith(".")}
        self.results.check_free(names)
        gone = {*names, *self.drop}
        kept = {k: v for k, v in self.results.written().items() if k.split("/")[0] not in gone}
        places = (self.inside / RUN, self.folder / RUN)
        run = next((read_json(place) for place in places if place.is_file()), None)
        if isinstance(run, dict):
            run[WRITTEN] = kept | {k: v for k, v in _hashes(self.inside).items() if k != RUN}
            self.json(RUN, run)


def _hashes(folder: Path, within: str = "") -> dict[str, str]:
    """Hashes of the files of a folder, or of those in one inside, by path; links have none."""
    found = {}
    for place, folders, files in os.walk(folder / within):
        folders.sort()
        for path in (Path(place, name) for name in sorted(files)):
            name = path.relative_to(folder).as_posix()
            if not name.startswith("."):
                regular = stat.S_ISREG(path.lstat().st_mode)
                found[name] = sha256(path) if regular else ""
    return found


class Results:
    """A results directory.

    >>> folder = tempfile.mkdtemp()
    >>> with Results(folder).writing() as stage:
    ...     stage.json("a.json", {"rms_V": 0.5})
    >>> Results(folder).json("a.json")
    {'rms_V': 0.5}
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)

    def has(self, name: str) -> bool:
        """Whether anything stands in the place of a result; reading it says whether it is one."""
        return os.path.lexists(self.folder / name)

    def json(self, name: str) -> Any:
        """A saved JSON result, checked, or None where there is none."""
        from bayes_sensor.io.result_schema import read_result  # slow to import

        return read_result(self.folder / name) if self.has(name) else None

    def path(self, name: str) -> Path:
        """The path of a result."""
        return self.folder / name

    def own_folder(self, name: str) -> Path:
        """The path of a folder inside; CampaignError where a link stands in its place."""
        return own_folder(self.folder / name)

    def written(self) -> dict[str, str]:
        """Hashes by path of what runs have written here; a run of an older version has not told,
        and what has the name of a result is taken for its own."""
        if not self.has(RUN):
            return {}
        told = self.json(RUN).get(WRITTEN)
        if told is not None:
            return dict(told)
        names = {*VOID, *FOLDERS, *(name for each in WRITES.values() for name in each)}
        return {k: v for k, v in _hashes(self.folder).items() if k.split("/")[0] in names}

    def check_free(self, names: Iterable[str]) -> None:
        """Raise CampaignError where one of these names is somebody's own."""
        there = [name for name in sorted(names) if self.has(name) and name != RUN]
        known = self.written() if there else {}
        for name in there:
            path = self.folder / name
            own = path.is_symlink() or not (path.is_dir() or path.is_file())
            found = _hashes(self.folder, name) if path.is_dir() else {name: ""}
            if path.is_file() and not own:
                found = {name: sha256(path)}
            other = name if own else next((k for k, v in found.items() if known.get(k) != v), "")
            if other:
                raise CampaignError(
                    f"--out {self.folder}: it holds a {other} that no run wrote, or that was "
                    "changed since; expected a folder in which nothing of yours is replaced: "
                    "choose another, or move that away"
                )

    def check_campaign(self, campaign: Mapping[str, Any]) -> None:
        """Raise CampaignError where the folder holds results of another campaign.

        ``campaign``: as campaign_record makes it.
        """
        earlier = self.json(CAMPAIGN)
        if earlier is not None and is_other_campaign(earlier, campaign):
            whose = earlier["source"] or f"'{earlier['title']}'"
            raise CampaignError(
                f"--resume: {self.folder} holds results of another campaign ({whose}); expected "
                "those of this one: name its folder, or leave --resume out to replace them"
            )

    def clear(self, name: str) -> None:
        """Remove a folder of unfinished parts, without what somebody else has put there."""
        for place, _, _ in os.walk(self.own_folder(name), topdown=False):  # goes through no link
            inside = Path(place)
            if any((inside / marker).is_file() for marker in UNFINISHED[:2]):
                for path in (path for kind in UNFINISHED for path in inside.glob(kind)):
                    if not path.is_dir() or path.is_symlink():
                        path.unlink()
            with suppress(OSError):  # not empty
                inside.rmdir()

    @contextmanager
    def locked(self, patience: float = 0.0, steps: Collection[str] = ()) -> Iterator[None]:
        """Make the directory where it is missing and hold it for this process alone.

        ``patience``: seconds to wait for another process that holds it.  A lock whose owner has
        ended holds nobody up, and what that owner had begun to put in place is put in place.
        ``steps`` of :data:`WRITES` that shall write here.

        Raises
        ------
        CampaignError
            If another process is writing there, the directory cannot be made or written, or
            somebody's own file is in the way.
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
                for name in (RUN, *(READ if "posterior" in steps else ())):
                    self.json(name)  # damaged, it is told now rather than after the run
                self.check_free(name for step in steps for name in WRITES.get(step, ()))
            except OSError as error:
                raise CampaignError(
                    f"--out {self.folder}: results cannot be written there "
                    f"({'it is a file' if self.folder.is_file() else error.strerror or error}); "
                    "expected a folder that can be written: choose another"
                ) from None
            yield
        finally:
            if lock is not None:
                lock.release()
            for folder in made:  # whatever stayed empty goes again
                if folder.is_dir() and not any(folder.iterdir()):
                    folder.rmdir()

    @contextmanager
    def writing(self) -> Iterator[StagingFolder]:
        """A stage to write to; what is on it replaces earlier results when the block ends well.

        An exception inside leaves the earlier results as they were.  From the moment when the
        stage is complete and renamed, a run that is killed has its results: whoever holds the
        directory next puts them in place.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        self._put_in_place()
        inside = Path(tempfile.mkdtemp(prefix=STAGE, dir=self.folder))
        stage = StagingFolder(self, inside)
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
        void = _void(complete / DROP)
        self.check_free(p.name for p in sources if p.is_file() or p.name in FOLDERS)
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
        for source in (p for p in sources if p.is_file() and p.name != RUN):
            os.replace(source, self.folder / source.name)
        for name in (name for name in void if (self.folder / name).is_file()):
            with suppress(CampaignError):  # somebody's own stays
                self.check_free([name])
                (self.folder / name).unlink()
        if (complete / RUN).is_file():  # last: it speaks of what is there
            os.replace(complete / RUN, self.folder / RUN)
        remove(complete)


def _void(path: Path) -> list[str]:
    """The names in a list of what to remove; those that are not in :data:`VOID` are left out."""
    if not path.is_file():
        return []
    try:
        listed = Results(path.parent).json(path.name)
    except CampaignError as error:  # cut off by a power failure: nobody can mend it
        LOG.warning("earlier results that were to be removed may still be there: %s", error)
        return []
    return [name for name in VOID if name in listed]
