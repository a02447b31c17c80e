"""The rows of `which` in gap.json: explanations, their probability, tau and closed fraction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import exp
from typing import Any

import numpy as np

from bayes_sensor.diagnosis.closed_fraction import Closure
from bayes_sensor.diagnosis.closure import closed_by
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison, Hypothesis
from bayes_sensor.diagnosis.evidence.refit import Refit
from bayes_sensor.diagnosis.probabilities import Probabilities
from bayes_sensor.diagnosis.signals.signal import Finding


def explanation_rows(
    comparison: Comparison,
    probabilities: Probabilities,
    findings: Sequence[Finding],
    closed: Closure,
    look_alikes: Mapping[str, Sequence[str]],
) -> list[dict[str, Any]]:
    """One row for none, for unlisted, and for each effect or pair; the most probable first."""
    base, catalogue = comparison.base, comparison.catalogue
    by_name = {f.name: f for f in findings}
    none = comparison.find()
    made = []
    for key, p in sorted(probabilities.rows.items(), key=lambda item: -item[1]):
        names = Probabilities.members(key)
        families = {catalogue[n].family for n in names}
        row: dict[str, Any] = {
            "effect": key,
            "family": families.pop() if len(families) == 1 else None,
            "probability": p,
            "d": None,
            "strength": {},
            "tau_s": None,
            "fraction_closed": None,
            "confusable_with": list(look_alikes.get(key, ())),
            "rss_V2": None,
            "bic": None,
            "log_evidence_ratio": None,
            "misfit_left_sd": None,
        }
        if key == "none":
            row.update(_measures(none, none, base, closed), d=0.0)
        elif names:
            _fill(row, names, comparison, none, by_name, closed)
        made.append(row)
    return made


def _fill(
    row: dict[str, Any],
    names: Sequence[str],
    comparison: Comparison,
    none: Hypothesis,
    by_name: Mapping[str, Finding],
    closed: Closure,
) -> None:
    on_mean = [n for n in names if comparison.catalogue[n].on_mean]
    strength: dict[str, Any] = {}
    if on_mean:
        h = comparison.find(*on_mean)
        row.update(_measures(h, none, comparison.base, closed))
        strength.update(h.refit.strength())
    for n in names:
        if n in by_name:
            strength.update(by_name[n].strength)
            if not on_mean:
                row["d"] = by_name[n].d
                row["log_evidence_ratio"] = by_name[n].log_bayes_factor
                row["tau_s"] = exp(none.log_tau)
    row["strength"] = strength


def _measures(h: Hypothesis, none: Hypothesis, base: Refit, closed: Closure) -> dict[str, Any]:
    binned = base.coords.binned
    n = binned.n_bins
    volts = [
        binned.floor.cholesky[k] @ h.refit.residual[rows] for k, rows in enumerate(binned.rows)
    ]
    rss = float(sum(np.sum(b.count * v**2) for b, v in zip(binned.bins, volts, strict=True)))
    return {
        "d": float(np.sqrt(max(none.refit.misfit - h.refit.misfit, 0.0))),
        "tau_s": exp(h.log_tau),
        "fraction_closed": closed_by(base, h.refit, closed) if h.effects else None,
        "rss_V2": rss,
        "bic": float(n * np.log(max(rss, 1e-300) / n) + h.refit.coords.size * np.log(n)),
        "log_evidence_ratio": h.log_z - none.log_z,
        "misfit_left_sd": h.leftover,
    }
