"""The record of a diagnosis: ``Gap``, its parts, and the content of gap.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

from bayes_sensor.diagnosis.closed_fraction import Closure
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison
from bayes_sensor.diagnosis.isolability import Separation
from bayes_sensor.diagnosis.location import ExcessMap
from bayes_sensor.diagnosis.probabilities import Probabilities
from bayes_sensor.diagnosis.signals.signal import Finding
from bayes_sensor.diagnosis.unseen_effects import HiddenEffect, HiddenEffects
from bayes_sensor.diagnosis.verdict import Verdict
from bayes_sensor.display import card, time_unit
from bayes_sensor.io.json_files import plain

if TYPE_CHECKING:
    import pandas as pd

Said = TypeVar("Said", "Shrink", HiddenEffect, "HiddenEffects")


def without_tau(said: Mapping[str, Any]) -> dict[str, Any]:
    """The record with tau None and the shorter lag in its place, under keys of its own.

    For a diagnosis that takes the shorter lag for the sensor's where its owner is not known.

    >>> without_tau({"d": 2.0, "tau_s": 0.1})
    {'d': 2.0, 'tau_s': None, 'lag_fast_s': 0.1}
    """
    of_tau = [key for key in said if key.startswith("tau_")]
    shorter = {key.replace("tau", "lag_fast", 1): said[key] for key in of_tau}
    return {**said, **dict.fromkeys(of_tau), **shorter}


def nameless(said: Said) -> Said:
    """The same of a record: fields of tau are None, ``lag_fast`` holds the shorter lag's."""
    keys = without_tau(said.to_json()).items()
    of_tau: dict[str, Any] = {f.name: None for f in fields(said) if f.name.startswith("tau_")}
    return replace(said, **of_tau, lag_fast={k: v for k, v in keys if k.startswith("lag_fast")})


@dataclass(frozen=True)
class Shrink:
    """How far the gap shrinks with the best explanation."""

    closure: Closure
    held_out_fraction_closed: float | None
    tau_before_s: float | None
    """None, as all of tau, where nobody knows which lag is the sensor's"""
    tau_after_s: float | None
    """averaged over the explanations that hold 95 % of the probability"""
    tau_after_low_s: float | None
    tau_after_high_s: float | None
    explanation: str
    rival: str | None
    """the best explanation outside the family"""
    rival_fraction_closed: float | None
    held_out_interval: tuple[float, float] | None = None
    """95 %; None where nothing was held out, and where the gap is not one of the mean"""
    of_mean: bool = True
    """whether it is the misfit of the mean that shrinks; else that of the noise, which moves no
    estimate"""
    tau_before_low_s: float | None = None
    tau_before_high_s: float | None = None
    """95 % interval of tau without any effect"""
    lag_fast: Mapping[str, Any] = field(default_factory=dict)
    """what is then said of the shorter lag in place of tau, by key of gap.json"""

    def to_json(self) -> dict[str, Any]:
        """The keys of gap.json."""
        c = self.closure
        low, high = self.held_out_interval or (None, None)
        return {
            "before_excess_rms_V": c.before_V,
            "after_excess_rms_V": c.after_V,
            "fraction_closed": c.fraction,
            "fraction_closed_lo": c.low,
            "fraction_closed_hi": c.high,
            "held_out_fraction_closed": self.held_out_fraction_closed,
            "held_out_fraction_closed_lo": low,
            "held_out_fraction_closed_hi": high,
            "tau_before_s": self.tau_before_s,
            "tau_before_lo_s": self.tau_before_low_s,
            "tau_before_hi_s": self.tau_before_high_s,
            "tau_after_s": self.tau_after_s,
            "tau_after_lo_s": self.tau_after_low_s,
            "tau_after_hi_s": self.tau_after_high_s,
            "withheld": c.withheld,
            "d_before": c.d_before,
            "d_after": c.d_after,
            "explanation": self.explanation,
            "rival": self.rival,
            "rival_fraction_closed": self.rival_fraction_closed,
            **({} if self.of_mean else {"of_mean": False}),
            **self.lag_fast,
        }


@dataclass(frozen=True)
class Round:
    """One round of the search: what was added, what is left after it."""

    added: tuple[str, ...]
    probability: float
    d_left: float
    p_left: float
    unlisted_left: float
    """probability that something unlisted is left"""


@dataclass(frozen=True, eq=False)
class Gap:
    """The result of :func:`diagnose_gap`."""

    verdict: Verdict
    budget: dict[str, Any]
    map: ExcessMap
    shrink: Shrink
    hidden: HiddenEffects
    rounds: tuple[Round, ...]
    separations: tuple[Separation, ...]
    findings: tuple[Finding, ...]
    comparison: Comparison | None
    """all that were compared; None in a record that was read back from a file"""
    probabilities: Probabilities
    rows: tuple[dict[str, Any], ...]
    strength_units: Mapping[str, str]
    """name of a strength -> its unit; "1": it has none"""
    tau_with_discrepancy_s: Mapping[str, float] | None = None
    """percentiles of tau with a smooth discrepancy in the model"""
    lag_fast_with_discrepancy_s: Mapping[str, float] | None = None
    """the same of the shorter lag, where nobody knows which lag is the sensor's"""
    signal_unit: str = "V"
    notes: tuple[str, ...] = ()
    """what could not be told, in sentences"""
    experiments: tuple[str, ...] = ()
    """names of the experiments that were looked at"""

    @cached_property
    def where(self) -> pd.DataFrame:
        """Experiment x phase: excess, share and p-value."""
        import pandas as pd

        return pd.DataFrame([vars(c) for c in self.map.cells])

    @cached_property
    def which(self) -> pd.DataFrame:
        """Every explanation with its probability, most probable first."""
        import pandas as pd

        return pd.DataFrame(list(self.rows))

    def __repr__(self) -> str:
        """Verdict, size of the gap, and tau without and with the explanation."""
        v, s = self.verdict, self.shrink
        which = (" and " if v.kind == "effect" else " or ").join(v.effects)
        key = "lag_fast" if s.lag_fast else "tau"
        taus = [s.to_json()[f"{key}_{when}_s"] for when in ("before", "after")]
        per_s, unit = time_unit(max(taus))
        before, after = (per_s * tau for tau in taus)
        return (
            f"Gap({v.kind} {which}".rstrip()
            + f", probability {v.probability:.2f}; d {self.budget['excess_d']:.1f}; "
            f"{self.hidden.lag} {before:.4g} {unit} without, {after:.4g} {unit} with the best "
            "explanation)"
        )

    def _repr_html_(self) -> str:
        """What a notebook shows of it: the verdict and the explanations it was chosen from."""
        keys = ("effect", "family", "probability", "d", "fraction_closed", "tau_s")
        rows = [[row.get(key) for key in keys] for row in self.rows[:8]]
        sentences = [self.verdict.sentence, *self.notes]
        title = f"gap: {self.verdict.kind}, probability {self.verdict.probability:.2f}"
        return card(title, sentences, [key.replace("_", " ") for key in keys], rows)

    def _finding(self, found: Finding) -> dict[str, Any]:
        where = found.strength.get(f"{found.name}_experiment")
        return {
            "name": found.name,
            "log_bayes_factor": found.log_bayes_factor,
            "probability": found.probability,
            "strength": {k: v for k, v in found.strength.items() if not k.endswith("_experiment")},
            "experiment": None if where is None else self.experiments[int(where)],
            "d": found.d,
        }

    def _note(self, found: Finding) -> dict[str, Any]:
        names = list(self.experiments)
        return {
            "signal": found.name,
            "place": found.place(names),
            "log_bayes_factor": found.log_bayes_factor,
            "probability": found.probability,
            "sentence": found.sentence(names, self.signal_unit),
        }

    def to_json(self) -> dict[str, Any]:
        """The content of gap.json; further keys: `where_scales`, `unlisted`, `rounds`, ..."""
        v = self.verdict
        record = {
            "budget": self.budget,
            "where": [_without(vars(c), "scale", "scale_s") for c in self.map.cells],
            "where_shared_by": self.map.shared_by,
            "where_scales": [_without(vars(c), "measured_excess_rms_V") for c in self.map.scales],
            "where_left_out_d": self.map.left_out,
            "which": list(self.rows),
            "strength_units": dict(self.strength_units),
            "verdict": {
                "kind": v.kind,
                "effects": list(v.effects),
                "family": v.family,
                "probability": v.probability,
                "sentence": v.sentence,
                "sets_in": list(v.sets_in),
            },
            "findings": [self._note(f) for f in self.findings],
            "families": self.probabilities.families,
            "shrink": self.shrink.to_json(),
            "tau_with_discrepancy_s": self.tau_with_discrepancy_s,
            "hidden": self.hidden.to_json(),
            "rounds": [{**vars(r), "added": list(r.added)} for r in self.rounds],
            "separate": [vars(s) for s in self.separations],
            "full_rate": [self._finding(f) for f in self.findings],
            "residuals": [
                {
                    "experiment": name,
                    "since_switch_s": since.tolist(),
                    "whitened": whitened.tolist(),
                    "residual_V": volts.tolist(),
                    "phase": phase.tolist(),
                }
                for name, since, whitened, volts, phase in self.map.residuals
            ],
            "signal_unit": self.signal_unit,
            "notes": list(self.notes),
        }
        if self.lag_fast_with_discrepancy_s is not None:
            record["lag_fast_with_discrepancy_s"] = self.lag_fast_with_discrepancy_s
        as_json: dict[str, Any] = plain(record, "gap")
        return as_json


def _without(mapping: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {k: v for k, v in mapping.items() if k not in names}


def without_lag_names(gap: Gap) -> Gap:
    """The record for a campaign in which it is not known which lag is the sensor's."""
    hidden = replace(gap.hidden, effects=tuple(nameless(each) for each in gap.hidden.effects))
    return replace(
        gap,
        rows=tuple(without_tau(row) for row in gap.rows),
        budget=without_tau(gap.budget),
        shrink=nameless(gap.shrink),
        hidden=nameless(hidden),
        tau_with_discrepancy_s=None,
        lag_fast_with_discrepancy_s=gap.tau_with_discrepancy_s,
    )
