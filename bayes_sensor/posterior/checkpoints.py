"""Unfinished ensembles on disk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.array_archive import check_array
from bayes_sensor.io.disk import write_bytes
from bayes_sensor.io.result_schema import read_result
from bayes_sensor.io.untrusted import read_arrays
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior.settings import Settings

MARKER = "checkpoint.json"
"""says what the chunks are of"""


class Checkpoint:
    """Chunks of ensembles on disk, each written whole or not at all."""

    def __init__(self, folder: Path | None, digest: str, resume: bool) -> None:
        self.folder, self.digest = folder, digest
        if folder is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        marker = folder / MARKER
        for rest in folder.glob(".ensemble-*"):  # of a run that was killed
            rest.unlink(missing_ok=True)
        try:
            known = read_result(marker)
        except CampaignError:  # none, or damaged by a power cut: begun anew
            known = None
        if not resume or known != {"digest": digest}:
            for old in folder.glob("ensemble-*.npz"):
                old.unlink()
            write_bytes(marker, json.dumps({"digest": digest}).encode())

    def _path(self, j: int, i: int) -> Path:
        assert self.folder is not None  # only reached with a folder
        return self.folder / f"ensemble-{j}-{i:05d}.npz"

    def _chunk(self, j: int, i: int, shape: tuple[int, int, int]) -> dict[str, Any] | None:
        """Chunk ``i`` of ensemble ``j``; None if it is missing, damaged or of another shape."""
        path = self._path(j, i)
        try:
            saved = read_arrays(path, "chains")
            for name, kinds, wanted in (
                ("chain", "f", shape), ("coords", "f", shape[1:]), ("log_prob", "f", shape[1:2]),
                ("acceptance", "f", ()), ("keys", "u", (624,)), ("position", "i", ()),
                ("has_gauss", "i", ()), ("gauss", "f", ()),
            ):  # fmt: skip
                check_array(path, saved, name, kinds, wanted)
        except CampaignError:
            return None
        return saved if 0 <= saved["position"] <= 624 else None

    def read(
        self, j: int, shape: Callable[[int], tuple[int, int, int]]
    ) -> list[tuple[FloatArray, Any, float]]:
        """Chain, state at its end and acceptance of each chunk of ensemble ``j`` that is saved.

        ``shape``: steps, walkers and dimensions of the chunk of a number.
        """
        found: list[tuple[FloatArray, Any, float]] = []
        while self.folder is not None:
            saved = self._chunk(j, len(found), shape(len(found)))
            if saved is None:
                break
            random = ("MT19937", saved["keys"], int(saved["position"]),
                      int(saved["has_gauss"]), float(saved["gauss"]))  # fmt: skip
            state = (saved["coords"], saved["log_prob"], random)
            found.append((saved["chain"], state, float(saved["acceptance"])))
        return found

    def write(self, j: int, i: int, chain: FloatArray, state: Any, rate: float) -> None:
        """Save chunk ``i`` of ensemble ``j`` with the state it ended in."""
        if self.folder is None:
            return
        import io

        coords, log_prob, random = state
        buffer = io.BytesIO()
        np.savez(
            buffer, chain=chain, coords=coords, log_prob=log_prob, acceptance=rate,
            keys=random[1], position=random[2], has_gauss=random[3], gauss=random[4],
        )  # fmt: skip
        write_bytes(self._path(j, i), buffer.getvalue())


def digest(
    problem: Problem,
    start: FloatArray,
    settings: Settings,
    seed: int,
    fineness: float,
    begin: FloatArray | None = None,
) -> str:
    """Digest of a run: data, model, priors, start, settings, seed, mesh and draws to begin from.

    The stopping rule is left out, so a run that was too short continues where it ended.
    """
    settings = replace(settings, max_steps=1, target_ess=1.0)
    hasher = hashlib.sha256()
    for e in problem.campaign:
        hasher.update(np.ascontiguousarray(e.values[e.used]).tobytes())
        hasher.update(repr((e.name, e.interval, e.total_flow, e.concentration)).encode())
    hasher.update(np.ascontiguousarray(start).tobytes())
    if begin is not None:
        hasher.update(np.ascontiguousarray(begin).tobytes())
    hasher.update(repr((problem.noise, problem.model, sorted(problem.priors.items()))).encode())
    hasher.update(repr((problem.assignments, sorted(problem.named_laws.items()))).encode())
    hasher.update(repr((settings, seed, fineness)).encode())
    return hasher.hexdigest()
