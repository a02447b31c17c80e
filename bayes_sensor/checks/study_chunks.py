"""Long runs of one task over many simulated campaigns, in parts that are kept.

An interrupted run goes on from them; the numbers are the same for any number of processes.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.disk import write_bytes
from bayes_sensor.io.result_schema import read_result
from bayes_sensor.io.untrusted import read_arrays, refused
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.workers import WorkerDied, completed, dask_client

Task = Callable[[int], Mapping[str, Any]]
"""number of the campaign to its result: named numbers and arrays of one shape for all campaigns"""
LOG = logging.getLogger(__name__)
PACKAGE = Path(__file__).parents[1]
NO_NUMBERS = ("figures", "report")
"""rooms of the package that no result of a task depends on; messages of cli are such results"""
DIGEST = "written_sha256"
"""array of a part's file that no task may have"""


def seed_of(stream: np.random.SeedSequence) -> int:
    """An integer that identifies the stream."""
    return int(stream.generate_state(1)[0])


def study_key(*parts: Any) -> str:
    """A digest of a study's settings and design: of everything that its numbers depend on."""
    from bayes_sensor import __version__

    hasher = hashlib.sha256(__version__.encode())
    for part in parts:
        if isinstance(part, Problem):
            for e in part.campaign:
                hasher.update(repr((e.name, e.t[0], len(e.t), e.interval, e.carrier_flow)).encode())
                hasher.update(repr((e.test_gas_flow, e.commanded_on, e.commanded_off)).encode())
                hasher.update(e.used.tobytes())
            part = (part.noise, part.model, sorted(part.given_priors.items()))
        hasher.update(repr(part).encode())
    return hasher.hexdigest()[:16]


def run_chunks(
    task: Task,
    n: int,
    folder: str | Path,
    key: str,
    jobs: int = 1,
    chunk: int = 10,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, np.ndarray]:
    """The results of ``task(0) .. task(n - 1)``, stacked along a first axis, by name.

    Every ``chunk`` of tasks becomes one small file in ``folder``, written whole or not at all; a
    later call with the same ``key`` and the same code (see :func:`code_digest`) goes on from those
    files.  Files of another key or of other code are removed, with a warning in the log.  The log
    also warns if the code was changed during the run.  ``jobs`` processes of this machine, or with
    ``scheduler`` (``tcp://host:port``) a Dask cluster; the numbers depend on neither.  The work of
    a process that died is repeated.

    Raises CampaignError if a part ended several processes.
    """
    folder = Path(folder)
    with ExitStack() as stack:
        client = None
        if scheduler is not None:  # before anything is written: it may not answer
            client = stack.enter_context(dask_client(scheduler))
        folder.mkdir(parents=True, exist_ok=True)
        for rest in folder.glob(".chunk-*"):  # of a run that was killed
            rest.unlink(missing_ok=True)
        code = code_digest(task)
        begun = CODE_AT_START.setdefault(task.__module__, code)
        # this process may have loaded what was there before: never to be taken for either alone
        label = code if code == begun else f"{begun}+{code}"
        _claim(folder, {"key": key, "chunk": chunk, "code": label})
        spans = [(a, min(a + chunk, n)) for a in range(0, n, chunk)]
        found = {(a, b): _load(_file(folder, (a, b)), b - a) for a, b in spans}
        parts = {span: part for span, part in found.items() if part is not None}
        todo = [span for span in spans if span not in parts]
        done = n - sum(b - a for a, b in todo)
        tell = progress or (lambda done, n: None)
        tell(done, n)
        lost = ""
        for k, result in completed(partial(_run, task), todo, jobs, client):
            span = todo[k]
            if isinstance(result, WorkerDied):
                lost = f"campaigns {span[0]} to {span[1] - 1} of the study: {result}"
                continue  # said when all others are done and kept
            buffer = io.BytesIO()
            np.savez_compressed(buffer, **{**result, DIGEST: np.array(_digest(result))})
            write_bytes(_file(folder, span), buffer.getvalue())
            parts[span] = result
            done += span[1] - span[0]
            tell(done, n)
    if lost:
        raise CampaignError(lost)
    if code_digest(task) != begun:
        LOG.warning(
            "%s: the code was changed while this ran, and the results may be of both states; "
            "run it again", folder,
        )  # fmt: skip
    return _alike({span: parts[span] for span in spans}, folder)


CODE_AT_START: dict[str, str] = {}
"""module of a task to the digest of the code when this process first ran one of it"""


def code_digest(task: Task) -> str:
    """A digest of the sources that ``task`` depends on: the package's and its own."""
    hasher = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        place = path.relative_to(PACKAGE)
        # editors leave links of hidden names that lead nowhere
        if place.parts[0] not in NO_NUMBERS and not place.name.startswith("."):
            hasher.update(f"{place.as_posix()}\0".encode() + path.read_bytes())
    own = getattr(sys.modules.get(task.__module__), "__file__", None)
    if own is not None:  # typed at a prompt it has none
        hasher.update(Path(own).read_bytes())
    return hasher.hexdigest()[:16]


def _claim(folder: Path, settings: dict[str, Any]) -> None:
    """Remove from ``folder`` the parts of studies with other settings."""
    marker = folder / "study.json"
    try:
        known = read_result(marker)
    except CampaignError:  # none, or damaged by a power cut
        known = None
    if known != settings:
        parts = list(folder.glob("chunk-*.npz"))
        for old in parts:
            old.unlink()
        if parts:
            code = known["code"] if known else None
            LOG.warning(
                "%s: %d finished parts are of other %s and are not used; all is computed anew",
                folder, len(parts), "settings" if code == settings["code"] else "code",
            )  # fmt: skip
        write_bytes(marker, json.dumps(settings).encode())


def _load(path: Path, n: int) -> dict[str, np.ndarray] | None:
    """A finished part of ``n`` tasks; None if it is missing, damaged or not what was written."""
    try:
        saved = read_arrays(path, "parts of a study")
    except CampaignError:
        return None
    digest = saved.pop(DIGEST, None)
    whole = digest is not None and str(digest) == _digest(saved)
    return saved if whole and all(a.ndim and len(a) == n for a in saved.values()) else None


def _digest(part: Mapping[str, np.ndarray]) -> str:
    """Of all names and numbers of a part."""
    hasher = hashlib.sha256()
    for name in sorted(part):
        array = np.ascontiguousarray(part[name])
        hasher.update(repr((name, array.dtype.str, array.shape)).encode() + array.tobytes())
    return hasher.hexdigest()


def _alike(
    parts: dict[tuple[int, int], dict[str, np.ndarray]], folder: Path
) -> dict[str, np.ndarray]:
    """All parts one after the other; CampaignError where they do not hold the same."""
    kinds = [{k: (a.dtype.kind, a.shape[1:]) for k, a in part.items()} for part in parts.values()]
    if any(kind != kinds[0] for kind in kinds):
        raise refused(folder, "parts of one study", "they do not hold the same")
    return {name: np.concatenate([part[name] for part in parts.values()]) for name in kinds[0]}


def _run(task: Task, span: tuple[int, int]) -> dict[str, np.ndarray]:
    results = [task(i) for i in range(*span)]
    return {name: np.stack([np.asarray(r[name]) for r in results]) for name in results[0]}


def _file(folder: Path, span: tuple[int, int]) -> Path:
    return folder / f"chunk-{span[0]:06d}-{span[1]:06d}.npz"
