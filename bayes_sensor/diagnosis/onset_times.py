"""Where and when an effect with a time of its own sets in: a step, or a change of level."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.data.bins import PHASES
from bayes_sensor.diagnosis.evidence.refit import Refit
from bayes_sensor.diagnosis.excess_shares import added_by
from bayes_sensor.diagnosis.probabilities import FAINT
from bayes_sensor.diagnosis.signals.signal import FOUND, Finding
from bayes_sensor.diagnosis.verdict import Judgement
from bayes_sensor.rig.imperfections import TF


def onset_times(
    judgement: Judgement, best: Refit, base: Refit, findings: Sequence[Finding]
) -> tuple[dict[str, Any], ...]:
    """``experiment``, ``phase`` and ``time_s`` of every place where the stated cause sets in.

    Of effects whose settings hold a moment, in the experiments in which they are seen; for an
    unlisted cause, of the changes of level in single records.
    """
    binned = base.coords.binned
    found = []
    if judgement.kind in ("effect", "family"):
        found = [(k, t) for k, t in _of_steps(best, base) if _shows(best, base, k)]
    if judgement.kind == "unlisted" and not found:
        found = [
            (place.experiment, place.time)
            for f in findings
            if f.signal.sets_in and f.probability > FOUND
            for place in f.places
        ]
    return tuple(_place(binned, k, t) for k, t in sorted(found))


def _of_steps(fitted: Refit, base: Refit) -> list[tuple[int, float]]:
    """Number of the experiment and s, of every step in the parts of a refit."""
    found = []
    coords, first = fitted.coords, len(base.coords.parts)
    for k in range(len(coords.binned.bins)):
        strengths = coords.values(fitted.x, k)
        p, _ = coords.rig(fitted.x, k)
        for part, values in list(zip(coords.parts, strengths, strict=True))[first:]:
            made = part.form.settings(values, coords.binned.settings[k])
            after = float(p[TF]) if made.get("step_with_fall") else 0.0
            at = after + made.get("step_time", 0.0)
            if made.get("step") and at > float(coords.binned.campaign.experiments[k].t[0]):
                found.append((k, at))
    return found


def _shows(fitted: Refit, base: Refit, k: int) -> bool:
    """Whether what a refit adds could be seen in experiment ``k``."""
    binned = base.coords.binned
    seen = binned.whitened(added_by(fitted, base))[binned.rows[k]]
    return float(seen @ seen) >= FAINT**2


def _place(binned: BinnedCampaign, k: int, time: float) -> dict[str, Any]:
    b = binned.bins[k]
    begins, _ = b.edges
    at = max(int(np.searchsorted(begins, time, side="right")) - 1, 0)
    return {
        "experiment": b.experiment.name, "phase": PHASES[int(b.phase[at])], "time_s": float(time),
    }  # fmt: skip
