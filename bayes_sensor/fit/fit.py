"""The record of a fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from bayes_sensor.campaign import FloatArray
from bayes_sensor.display import card
from bayes_sensor.fit.inseparable import Inseparable
from bayes_sensor.fit.lag_count import LagCount
from bayes_sensor.fit.side_information import SideComparison
from bayes_sensor.io.json_files import plain
from bayes_sensor.rig.lags import Naming

Progress = Callable[[float, str], None]
"""called with the fraction done and a word"""


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares fit of a campaign."""

    names: list[str]
    """flat parameter names; a lag that cannot be assigned is named by its size"""
    theta_hat: FloatArray
    """(n_theta,) in the order of ``names``: lags by size (:mod:`bayes_sensor.rig.lags`); noise
    parameters estimated from the residuals"""
    parameters: dict[str, Any]
    """the same as the nested mapping of ``fit.json``, under the likeliest names of the lags"""
    rms: float
    """V, of the residuals of all used samples"""
    rms_per_experiment: dict[str, float]
    """V"""
    n_samples: int
    """used samples of all experiments"""
    cost: float
    """V^2, the sum of squares"""
    at_bound: list[str]
    """flat names of estimates at a search bound"""
    bounds: dict[str, tuple[float, float]]
    """search bounds by flat name: low and high in s, mL and the signal's unit"""
    converged: bool
    """whether the refinement ended by itself, and a step is seen"""
    status: str
    """one sentence"""
    warnings: list[str]
    swarms: dict[str, Any]
    """``agree`` and, per swarm, its cost before and after refinement and its shared parameters"""
    euler: dict[str, Any] | None
    """the same fit by forward Euler: parameters, rms_V, cost and differences (Euler - exact)"""
    de: dict[str, Any] | None
    """the differential-evolution cross-check, or None when it was not asked for"""
    n_evaluations: int
    """evaluations of the whole campaign's misfit"""
    seconds: float
    """s, how long the fit took"""
    naming: Naming
    """names that may be stated for the lags"""
    signal_unit: str = "V"
    """unit of what is said to be in V here"""
    phi_interval: float = 0.0
    """s, the sampling interval that phi refers to"""
    seed: int = 1
    """of the swarms"""
    cannot_tell: str = ""
    """why these data allow no interval, as a sentence; empty where they do"""
    twin: str = ""
    """a sentence if another valve and manifold fit equally well; else empty"""
    step_seen: bool = True
    """whether the step of any experiment exceeds the noise"""
    unseen: tuple[str, ...] = ()
    """lags, or V, at the lower end of the search: too small to be seen in these data"""
    side_information: tuple[SideComparison, ...] = ()
    """each piece of side information with the estimate from the data alone"""
    hidden_by_sampling: float | None = None
    """s, the sampling interval if the whole response is shorter than it"""
    caveats: tuple[str, ...] = ()
    """caveats of the first line: posterior, bounds and report repeat them first"""
    noise: float | None = None
    """V, RMS of the noise without test gas, from the quiet stretches; None where none is quiet"""
    misfit: float | None = None
    """RMS over that of the noise of the quiet stretches; None where it cannot be computed"""
    misfit_per_experiment: dict[str, float | None] = field(default_factory=dict)
    """the same by experiment"""
    inseparable: tuple[Inseparable, ...] = ()
    """parameters that this campaign cannot tell apart, and what would"""
    n_lags: LagCount | None = None
    """how many lags the data support; None where they were not counted
    (:func:`bayes_sensor.fit.count_lags`)"""

    @property
    def order(self) -> str:
        """Assignment of the lags: ``given``, ``decided`` (by side information) or ``undecided``."""
        return self.naming.order

    @property
    def lags(self) -> FloatArray:
        """(n_lags,) s, the lags that do not depend on flow, shortest first."""
        return self.naming.commuting.lags(self.theta_hat)

    @property
    def n_shared(self) -> int:
        """How many of the first parameters all experiments share."""
        return len(self.naming.commuting.shared)

    def __repr__(self) -> str:
        """The shared time constants and the status."""
        shared = ", ".join(
            f"{name} too small to be seen" if name in self.unseen else f"{name} {value:.4g}"
            for name, value in zip(self.names[: self.n_shared], self.theta_hat)
        )
        return f"Fit({shared}; RMS {self.rms:.4g} {self.signal_unit}; {self.status})"

    def _repr_html_(self) -> str:
        """HTML for a notebook, without spreads; bounds and posterior have those."""
        limit = set(self.at_bound)
        rows = [
            [
                name,
                None if name in self.unseen else value,
                "too small to be seen" if name in self.unseen
                else "at a search bound" if name in limit else "",
            ]
            for name, value in zip(self.names, self.theta_hat.tolist(), strict=True)
        ]  # fmt: skip
        title = f"least squares: RMS {self.rms:.4g} {self.signal_unit}, {self.n_samples} samples"
        sentences = [*self.caveats, self.status, *self.warnings]
        return card(title, sentences, ["parameter", "value", ""], rows)

    def estimates(self) -> dict[str, float | None]:
        """The shared values under the names that may be stated; None where one is too small to be
        seen."""
        names = self.names[: self.n_shared]
        labels = self.naming.labels
        return {
            label: None if name in self.unseen else float(factor * value)
            for name, (label, factor), value in zip(names, labels, self.theta_hat)
        }

    def to_json(self) -> dict[str, Any]:
        """The content of ``fit.json``."""
        return {
            "order": self.order,
            "noise_V": self.noise,
            "misfit": self.misfit,
            "misfit_per_experiment": dict(self.misfit_per_experiment),
            "rms_V": self.rms,
            "n_samples": self.n_samples,
            "parameters": self.parameters,
            "estimates": self.estimates(),
            "lags_s": self.lags.tolist(),
            "unseen": list(self.unseen),
            "hidden_by_sampling_s": self.hidden_by_sampling,
            "side_information": [each.to_json() for each in self.side_information],
            "cannot_tell_apart": [each.to_json() for each in self.inseparable],
            "n_lags": None if self.n_lags is None else self.n_lags.to_json(),
            "at_bound": list(self.at_bound),
            "converged": self.converged,
            "caveats": list(self.caveats),
            "warnings": [*self.caveats, *self.warnings],
            "status": self.status,
            "rms_per_experiment_V": dict(self.rms_per_experiment),
            "cost_V2": self.cost,
            "phi_interval_s": self.phi_interval,
            "signal_unit": self.signal_unit,
            "bounds": plain(self.bounds),
            "swarms": self.swarms,
            "euler": self.euler,
            "differential_evolution": self.de,
            "n_evaluations": self.n_evaluations,
            "seed": self.seed,
        }
