"""The calibration map: how often something is what it looks like.

Evidences compare models, and no model here is exact: some unlisted causes look like a listed
effect, some listed effects act in a form that is not ours, and noise of an odd kind looks like an
event.  The numbers of this map, in ``calibration.json`` beside this file, say how often.  They are
fitted by maximum likelihood to simulated campaigns whose truth is known
(``paper/studies/study_calibration.py``, which also holds the check of the fit), in the mix of the
blind check: a third of the campaigns has no cause, a third a listed one, a third another.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np

LOOKS = ("none", "listed", "form", "unlisted", "own")
"""what a share of the evidence looks like: nothing; listed effects; listed effects whose form is
not exact; something unlisted; an effect of the user's own, which is taken at its word"""
CLEAREST = 3.0
"""detectability below which what looks listed is equally often something else: below it, noise
decides what it looks like"""


class Shares(NamedTuple):
    """Of what looks alike, the shares that are nothing, a listed cause, and an unlisted one."""

    none: float
    listed: float
    unlisted: float


class Appearance(NamedTuple):
    """One share of the evidence of the mean."""

    look: str
    """one of :data:`LOOKS`"""
    causes: tuple[str, ...]
    """listed effects; empty for nothing, and for something unlisted"""
    mass: float
    """posterior probability by the evidences alone; all masses sum to 1"""
    d: float
    """detectability of what it explains"""
    finding: float | None
    """log odds, by its own evidence, of the clearest finding that it leaves open; None: of none"""


@dataclass(frozen=True)
class Calibration:
    """The map."""

    listed_none: float
    """odds, at the clearest detectability and inversely to it, that what looks like listed effects
    is nothing"""
    listed_unlisted: float
    """the same that it is an unlisted cause: the clearer an effect is seen, the fewer other causes
    look the same"""
    form_unlisted: float
    """share of what looks like a listed effect in another form that is an unlisted cause"""
    unlisted_none: float
    unlisted_listed: float
    """shares of what looks unlisted by its mean"""
    none_listed: float
    none_unlisted: float
    """shares of what looks like nothing that is a cause large enough to be seen"""
    finding_offset: float
    finding_slope: float
    """log odds that a finding in single samples is an unlisted cause, and not noise of an odd kind:
    offset + slope times its log odds by evidence alone"""

    tau_widening: float = 1.0
    """factor on the spread of ln tau, and of all else, with a discrepancy in the model"""

    def shares(self, look: str, d: float) -> Shares:
        """What a look of detectability ``d`` turns out to be."""
        if look == "none":
            return _complete(self.none_listed, self.none_unlisted, "none")
        if look == "unlisted":
            return _complete(self.unlisted_none, self.unlisted_listed, "unlisted")
        if look == "form":
            return Shares(0.0, 1.0 - self.form_unlisted, self.form_unlisted)
        if look == "own":
            return Shares(0.0, 1.0, 0.0)
        fading = CLEAREST / max(d, CLEAREST)
        none, unlisted = self.listed_none * fading, self.listed_unlisted * fading
        whole = 1.0 + none + unlisted
        return Shares(none / whole, 1.0 / whole, unlisted / whole)

    def of_finding(self, log_odds: float) -> float:
        """Probability that a finding is an unlisted cause, from its log odds by evidence alone."""
        odds = self.finding_offset + self.finding_slope * log_odds
        return float(1.0 / (1.0 + np.exp(-np.clip(odds, -60.0, 60.0))))

    def classes(self, appearances: Sequence[Appearance]) -> Shares:
        """Probabilities of nothing, listed causes and an unlisted one, for one campaign."""
        total = np.zeros(3)
        for a in appearances:
            taken = 0.0 if a.finding is None else self.of_finding(a.finding)
            total += a.mass * (1.0 - taken) * np.array(self.shares(a.look, a.d))
            total[2] += a.mass * taken
        return Shares(*(total / total.sum()).tolist())


def _complete(first: float, second: float, own: str) -> Shares:
    rest = 1.0 - first - second
    return Shares(rest, first, second) if own == "none" else Shares(first, second, rest)


@cache
def calibration() -> Calibration:
    """The map of this version."""
    place = resources.files("bayes_sensor") / "diagnosis" / "calibration.json"
    return Calibration(**json.loads(place.read_text(encoding="utf-8")))
