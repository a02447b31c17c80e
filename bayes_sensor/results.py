"""A results directory: complete files only, one writer at a time, and a record of every run.

Everything that the report shows is read back from here, so that it can be rebuilt without the
data.  Traces are kept as envelopes: the least and the greatest sample of each of some hundred
stretches, which looks the same as all samples and stays small.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import platform
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from math import isfinite
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from bayes_sensor import __version__
from bayes_sensor.campaign import STAGES, Campaign, CampaignError, FloatArray
from bayes_sensor.disk import own_folder, remove, remove_links, replacing, write_bytes, write_text
from bayes_sensor.folder_lock import Lock
from bayes_sensor.likelihood import Problem, as_problem, mean_and_variance
from bayes_sensor.model import local_parameters

LOCK, RUN = ".lock", "run.json"
STAGE, COMPLETE, OLD, DROP = ".stage-", ".complete", ".old-", ".drop.json"
"""of a run's results: being written; complete, about to be moved; replaced; names to remove"""
VOID = (
    "posterior_without_effects.json", "predictive.json", "gap.json", "gap_where.csv",
    "gap_which.csv", "report.html", "fleet.svg", "fleet.png", "next.toml", "next_truth.json",
)  # fmt: skip
"""earlier results that a run may make void: nothing else is ever removed by name"""
FOLDERS = ("figures", "campaigns", "sealed", "verdicts")
"""folders among results: no other is ever moved or replaced"""
BINS_WHOLE = 600
"""stretches of an envelope over a whole record"""
BINS_SWITCH = 260
"""stretches of an envelope around a switch"""
RUN_VERSION = 1

LOG = logging.getLogger(__name__)

# --------------------------------------------------------------------------- JSON


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


def read_json(path: str | os.PathLike[str]) -> Any:
    """The content of a saved result; CampaignError says what is wrong with the file."""
    path = Path(path)
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CampaignError(
            f"{path}: there is no such file; expected a saved result: run the command that makes it"
        ) from None
    except (OSError, ValueError) as error:
        raise CampaignError(
            f"{path}: expected a saved result in JSON, but it cannot be read ({error}); "
            "give a file such as fit.json, or run the command that makes it again"
        ) from None


def sha256(path: str | os.PathLike[str]) -> str:
    """Hash of a file's content."""
    digest = hashlib.sha256()
    with open(path, "rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


# --------------------------------------------------------------------------- traces


@dataclass(frozen=True, eq=False)
class Envelope:
    """A stretch of a trace in ``n`` bins; where there are few samples, each is its own bin."""

    t: FloatArray
    """(n,) s, middle of each bin"""
    low: FloatArray
    """(n,) V, least used sample"""
    high: FloatArray
    """(n,) V, greatest"""
    model: FloatArray
    """(n,) V, mean of the fitted model"""
    residual_low: FloatArray
    """(n,) V"""
    residual_high: FloatArray
    """(n,) V"""
    residual: FloatArray
    """(n,) V, mean of measurement minus model"""
    sd: FloatArray
    """(n,) V, the noise law's standard deviation"""


@dataclass(frozen=True, eq=False)
class Trace:
    """What the figures of one experiment need."""

    name: str
    total_flow: float
    """mL/s"""
    concentration: float
    """between 0 and 1"""
    t0: float
    """s, fitted start of the step"""
    tf: float | None
    commanded_on: float | None
    commanded_off: float | None
    rms: float
    """V"""
    whole: Envelope
    rise: Envelope
    fall: Envelope | None
    signal_unit: str = "V"


_COLUMNS = ("t", "low", "high", "model", "residual_low", "residual_high", "residual", "sd")


def envelope(
    t: FloatArray, y: FloatArray, model: FloatArray, sd: FloatArray, n_bins: int
) -> Envelope:
    """Least, greatest and mean of samples (n_t,) in at most ``n_bins`` bins of equal duration.

    >>> t = np.arange(6.0)
    >>> envelope(t, t, np.zeros(6), np.ones(6), 3).high.tolist()
    [1.0, 3.0, 5.0]
    """
    if len(t) <= n_bins:
        start = np.arange(len(t))
    else:
        place = ((t - t[0]) / (t[-1] - t[0]) * n_bins).astype(int).clip(0, n_bins - 1)
        start = np.flatnonzero(np.diff(place, prepend=-1))
    count = np.diff(np.append(start, len(t)))
    r = y - model
    means = [np.add.reduceat(v, start) / count for v in (t, model, r, sd)]
    return Envelope(
        means[0],
        np.minimum.reduceat(y, start),
        np.maximum.reduceat(y, start),
        means[1],
        np.minimum.reduceat(r, start),
        np.maximum.reduceat(r, start),
        means[2],
        means[3],
    )


def make_traces(campaign: Campaign | Problem, fit: Any) -> list[Trace]:
    """The traces of every experiment at ``fit.theta_hat``."""
    problem = as_problem(campaign)
    layout = problem.layout
    vector = layout.flat(fit.theta_hat)
    traces = []
    for k, e in enumerate(problem.campaign):
        model, variance = mean_and_variance(problem, vector, k)
        _, _, t0, tf = local_parameters(vector, layout, e.name)
        span = float(2.2 * (vector[0] + vector[1] + vector[2] / e.total_flow))
        used = e.used
        samples = (e.t[used], e.values[used], model[used], np.sqrt(variance[used]))

        traces.append(
            Trace(
                e.name,
                e.total_flow,
                e.concentration,
                t0,
                tf,
                e.commanded_on,
                e.commanded_off,
                float(np.sqrt(np.mean((samples[1] - samples[2]) ** 2))),
                envelope(*samples, BINS_WHOLE),
                _around(samples, t0, e.commanded_on, span),
                None if tf is None else _around(samples, tf, e.commanded_off, span),
                problem.campaign.signal_unit,
            )
        )
    return traces


def _around(
    samples: tuple[FloatArray, ...], edge: float, commanded: float | None, span: float
) -> Envelope:
    """The stretch around a switch, from the command where that is near."""
    t = samples[0]
    begin = edge - 0.35 * span
    if commanded is not None and 0.0 <= edge - commanded < 1.5 * span:
        begin = min(begin, commanded - 0.1 * span)
    a, b = (int(v) for v in np.searchsorted(t, [begin, edge + 1.9 * span]))
    if b - a < 8:
        a, b = max(0, min(a, len(t) - 8)), len(t)
    y, model, sd = (values[a:b] for values in samples[1:])
    return envelope(t[a:b], y, model, sd, BINS_SWITCH)


def save_traces(path: str | os.PathLike[str], traces: Sequence[Trace]) -> None:
    """Write traces as a NumPy archive in single precision."""
    arrays: dict[str, Any] = {}
    facts = []
    for k, trace in enumerate(traces):
        facts.append(
            {
                name: getattr(trace, name)
                for name in (
                    "name", "total_flow", "concentration", "t0", "tf", "commanded_on",
                    "commanded_off", "rms", "signal_unit",
                )
            }
        )  # fmt: skip
        for part in ("whole", "rise", "fall"):
            piece = getattr(trace, part)
            if piece is not None:
                table = np.stack([getattr(piece, column) for column in _COLUMNS])
                # seven digits do not hold the time of day, nor that since an epoch
                arrays[f"{k}_{part}_start"] = start = table[0, :1].copy()
                table[0] -= start
                arrays[f"{k}_{part}"] = table.astype(np.float32)
    text = json.dumps(plain(facts), allow_nan=False)
    arrays["facts"] = np.frombuffer(text.encode("utf-8"), dtype=np.uint8)
    with replacing(path) as new, new.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def load_traces(path: str | os.PathLike[str]) -> list[Trace]:
    """What :func:`save_traces` wrote."""
    try:
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            content = {name: archive[name] for name in archive.files}
        facts = json.loads(content["facts"].tobytes().decode("utf-8"))
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise CampaignError(
            f"{path}: expected saved traces, but they cannot be read ({error}); "
            "run the command that made them again"
        ) from None
    traces = []
    for k, fact in enumerate(facts):
        parts: dict[str, Any] = dict.fromkeys(("whole", "rise", "fall"))
        for part in parts:
            if f"{k}_{part}" in content:
                table = content[f"{k}_{part}"].astype(float)
                table[0] += content.get(f"{k}_{part}_start", 0.0)
                parts[part] = Envelope(*table)
        traces.append(Trace(**fact, **parts))
    return traces


# --------------------------------------------------------------------------- the run's record


def versions() -> dict[str, str]:
    """Versions of Python and of everything that the numbers depend on."""
    found = {"python": platform.python_version(), "bayes-sensor": __version__}
    for name in (
        "numpy", "scipy", "numba", "pandas", "statsmodels", "emcee", "arviz",
        "scikit-fem", "matplotlib", "pydantic", "typer",
    ):  # fmt: skip
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def now() -> str:
    """The time in UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")


def campaign_record(
    campaign: Campaign, remarks: Sequence[str], rows: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The content of ``campaign.json``: what was understood of the input, with file hashes.

    ``rows``: one per experiment, as check.campaign_rows makes them.
    """
    source = Path(campaign.source) if campaign.source else None
    return {
        "title": campaign.title,
        "source": str(source) if source else "",
        "sha256": sha256(source) if source and source.is_file() else "",
        "signal_unit": campaign.signal_unit,
        "reference_interval_s": campaign.reference_interval,
        "same_flow": campaign.same_flow,
        "stages": list(STAGES),
        "sensor_is": campaign.sensor_is,
        "n_samples": campaign.n_samples,
        "side_information": {
            name: {"mean": info.mean, "sd": info.sd}
            for name, info in campaign.side_information.items()
        },
        "remarks": list(remarks),
        "experiments": [
            {**row, "file": Path(e.source).name if e.source else "", "sha256": e.sha256}
            for row, e in zip(rows, campaign, strict=True)
        ],
    }


def digest(campaign: Mapping[str, Any], settings: Any) -> str:
    """One hash of the data files, the campaign file and the settings: what a result rests on."""
    parts = {
        "campaign": campaign.get("sha256"),
        "files": [e.get("sha256") for e in campaign.get("experiments", [])],
        "settings": settings,
    }
    text = json.dumps(plain(parts), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


# --------------------------------------------------------------------------- the directory


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


def of_other_data(run: Mapping[str, Any]) -> list[str]:
    """Commands in ``run.json`` whose results rest on other data or settings than the newest's."""
    bases = {name: entry["basis_sha256"] for name, entry in run["commands"].items()}
    newest = bases.get(run["last"])
    # what rests on no data (a simulation, a design) has no basis
    return [name for name, basis in bases.items() if newest and basis not in ("", newest)]


def run_record(
    earlier: Any,
    command: str,
    *,
    basis: str,
    seed: int,
    settings: Any,
    campaign: str,
    files: Mapping[str, str],
    started: str,
    seconds: Mapping[str, float],
    exit_code: int,
    warnings: Sequence[str],
    command_line: Sequence[str] | None = None,
) -> dict[str, Any]:
    """The content of ``run.json`` after a command: one entry per command, the newest of each.

    ``command_line``: where it is not that of this process.
    """
    commands = dict(earlier.get("commands", {})) if isinstance(earlier, Mapping) else {}
    commands[command] = {
        "started": started,
        "finished": now(),
        "seconds": {k: round(float(v), 3) for k, v in seconds.items()},
        "exit_code": exit_code,
        "converged": exit_code == 0,
        "seed": seed,
        "settings": settings,
        "campaign": campaign,
        "files_sha256": dict(files),
        "basis_sha256": basis,
        "versions": versions(),
        "platform": f"{platform.system()} {platform.machine()}",
        "command_line": list(command_line or ["bayes-sensor", *sys.argv[1:]]),
        "warnings": list(warnings),
    }
    return {"version": RUN_VERSION, "last": command, "commands": commands}
