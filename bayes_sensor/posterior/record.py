"""The posterior as a record: draws, diagnostics, summaries, posterior.json."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.laplace import Coordinates
from bayes_sensor.likelihood import Prior, Problem, default_priors
from bayes_sensor.model import Layout
from bayes_sensor.notebook import card
from bayes_sensor.posterior.convergence import ESS_LIMIT, MESH_ERROR_LIMIT, R_HAT_LIMIT
from bayes_sensor.posterior.settings import Settings
from bayes_sensor.posterior.summaries import highest_density, reaches_end, weighted_quantiles
from bayes_sensor.results import plain

if TYPE_CHECKING:
    import pandas as pd

NEAR_EQUAL, MAY_BE_EQUAL = 0.8, 0.025
"""tau over tau_v that counts as equal, and the probability of it that is worth a warning"""
QUANTILES = (0.5, 2.5, 16.0, 50.0, 84.0, 97.5, 99.5)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Draws of theta and what is needed to trust them."""

    problem: Problem
    chains: FloatArray
    """(n_chain, n_draw, n_theta); for emcee a chain is an ensemble, its walkers end to end"""
    log_likelihood: FloatArray
    """(n_chain, n_draw, n_experiment)"""
    sampler: str
    """which sampler made the draws"""
    reasons: tuple[str, ...]
    """sentences: which sampler was used and why it can be trusted"""
    mesh_error: float
    """largest difference of log L between mesh and full pass over a few draws"""
    r_hat: FloatArray
    ess_bulk: FloatArray
    ess_tail: FloatArray
    settings: Settings = field(default_factory=Settings)
    seed: int = 1
    seconds: float = 0.0
    k_hat: float | None = None
    acceptance: float | None = None
    caveats: tuple[str, ...] = ()
    """sentences of the fit that decide whether the headline stands"""
    remarks: tuple[str, ...] = ()
    """further sentences of the fit that concern the posterior too"""
    doubts: tuple[str, ...] = ()
    """sentences on what the noise law fails in, so that intervals are not to be trusted"""

    @property
    def layout(self) -> Layout:
        """Order of the flat vector."""
        return self.problem.layout

    @property
    def names(self) -> list[str]:
        """Flat names, in the order of the last axis of ``chains``."""
        return self.layout.names

    @cached_property
    def draws(self) -> FloatArray:
        """(n, n_theta), all chains together."""
        return self.chains.reshape(-1, self.chains.shape[-1])

    @cached_property
    def free(self) -> np.ndarray:
        """Positions of the parameters that vary."""
        return Coordinates(self.problem).free

    def of(self, name: str) -> FloatArray:
        """(n,) draws of one parameter."""
        return self.draws[:, self.layout.index(name)]

    def mean(self, name: str) -> float:
        """Posterior mean."""
        return float(self.of(name).mean())

    def sd(self, name: str) -> float:
        """Posterior standard deviation."""
        return float(self.of(name).std(ddof=1))

    def quantiles(self, name: str, probabilities: Any) -> FloatArray:
        """Posterior quantiles at ``probabilities`` between 0 and 1."""
        found: FloatArray = np.quantile(self.of(name), probabilities)
        return found

    @property
    def converged(self) -> bool:
        """R-hat below 1.01 and bulk and tail ESS of at least 400 for every parameter."""
        r_hat, bulk, tail = (a[self.free] for a in (self.r_hat, self.ess_bulk, self.ess_tail))
        return bool(
            np.all(r_hat < R_HAT_LIMIT) and np.all(bulk >= ESS_LIMIT) and np.all(tail >= ESS_LIMIT)
        )

    @property
    def status(self) -> str:
        """Whether it converged, and what its noise law fails in."""
        return "; ".join([self.convergence, *self.doubts])

    @property
    def convergence(self) -> str:
        """One sentence: converged, or what falls short."""
        free = self.free
        worst = free[int(np.nanargmax(self.r_hat[free]))]
        least = free[int(np.nanargmin(np.minimum(self.ess_bulk, self.ess_tail)[free]))]
        ess = min(self.ess_bulk[least], self.ess_tail[least])
        numbers = (
            f"largest R-hat {self.r_hat[worst]:.4f} ({self.names[worst]}), "
            f"smallest effective sample size {ess:.0f} ({self.names[least]})"
        )
        return ("converged: " if self.converged else "NOT converged: ") + numbers

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences a reader must see."""
        found = [*self.caveats, *([] if self.converged else [self.convergence]), *self.remarks]
        found += self.doubts
        if self.problem.campaign.same_flow:
            found.append(
                "all flows are equal: these data cannot tell tau_v from V/Q, only the priors say "
                "which is which, and where they do not, the intervals hold both; tau is taken for "
                "the smallest lag"
            )
        tau, tau_v = self.of("tau_s"), self.of("tau_v_s")
        if not self.problem.campaign.same_flow and np.mean(tau > NEAR_EQUAL * tau_v) > MAY_BE_EQUAL:
            low, high = np.quantile(tau, 0.025), np.quantile(tau_v, 0.975)
            found.append(
                f"tau and tau_v may be equal and can then not be told apart: only the rule "
                f"tau <= tau_v separates their intervals; both lie between {1e3 * low:.4g} and "
                f"{1e3 * high:.4g} ms (95 %)"
            )
        if self.mesh_error > MESH_ERROR_LIMIT:
            found.append(f"the mesh is off by {self.mesh_error:.1e} in log L, more than 1e-3")
        return tuple(found)

    def summary(self) -> pd.DataFrame:
        """Mean, sd, percentiles and diagnostics of every varying parameter, one row each."""
        import pandas as pd

        rows = {name: self._row(i) for i, name in enumerate(self.names) if i in set(self.free)}
        return pd.DataFrame.from_dict(rows, orient="index")

    def _row(self, i: int) -> dict[str, float]:
        draws = self.draws[:, i]
        row = {"mean": float(draws.mean()), "sd": float(draws.std(ddof=1))}
        for percent, value in zip(QUANTILES, np.percentile(draws, QUANTILES), strict=True):
            row[f"q{percent:g}"] = float(value)
        row["ess_bulk"] = float(self.ess_bulk[i])
        row["ess_tail"] = float(self.ess_tail[i])
        row["r_hat"] = float(self.r_hat[i])
        return row

    def __repr__(self) -> str:
        """Size and status."""
        return f"Posterior({len(self.draws)} draws by {self.sampler}; {self.convergence})"

    def _repr_html_(self) -> str:
        """What a notebook shows of it."""
        rows = []
        for i in self.free:
            low, middle, high = np.quantile(self.draws[:, i], [0.025, 0.5, 0.975]).tolist()
            ess = float(min(self.ess_bulk[i], self.ess_tail[i]))
            rows.append([self.names[i], middle, low, high, round(ess), float(self.r_hat[i])])
        columns = ["parameter", "median", "95 % low", "95 % high", "effective draws", "R-hat"]
        warnings = [text for text in self.warnings if text != self.convergence]
        return card(f"posterior: {self.convergence}", warnings, columns, rows)

    def to_json(self) -> dict[str, Any]:
        """The contents of ``posterior.json``; parameters that the noise law pins are null."""
        parameters: dict[str, Any] = {}
        for i, name in enumerate(self.names):
            parameters[name] = self._row(i) if i in set(self.free) else None
        return {
            "parameters": parameters,
            "n_draws": len(self.draws),
            "converged": self.converged,
            "status": self.status,
            "convergence": self.convergence,
            "doubts": list(self.doubts),
            "sampler": self.sampler,
            "reasons": list(self.reasons),
            "caveats": list(self.caveats),
            "warnings": list(self.warnings),
            "k_hat": plain(self.k_hat),
            "acceptance": self.acceptance,
            "log_likelihood_error": self.mesh_error,
            "seed": self.seed,
            "seconds": self.seconds,
            "priors": {n: str(self.problem.priors[n]) for n in self.names if n in self._varying},
            "phi_interval_s": self.problem.campaign.reference_interval,
            "signal_unit": self.problem.campaign.signal_unit,
            **self._tau_under_priors(),
        }

    def _tau_under_priors(self) -> dict[str, Any]:
        """The rows of :meth:`tau_under_priors` that hold numbers, and the laws of those that do
        not, with the reason."""
        rows = self.tau_under_priors().to_dict(orient="records")
        without = [row for row in rows if row["status"] != "ok"]
        return {
            "tau_under_priors": [row for row in rows if row["status"] == "ok"],
            "tau_under_priors_left_out": [
                {key: row[key] for key in ("prior", "law", "status")} for row in without
            ],
        }

    @cached_property
    def _varying(self) -> set[str]:
        return {self.names[i] for i in self.free}

    def tau_under_priors(self) -> pd.DataFrame:
        """Intervals and upper limits of tau (s) under other priors, by reweighting the draws.

        Rows: flat, half-normal, log-uniform with a floor (a hundredth of the half-normal's scale).
        The half-normal is the posterior's own or, where it has another law, the default one.
        Columns: equal-tailed 95 % interval, highest-density 95 % interval, one-sided 95 and 99 %
        upper limits, the effective number of draws that the reweighting leaves, and ``status``.

        Reweighting cannot leave the support of the law that was sampled.  Where that one is bounded
        and the draws under another law reach its bound, this law would allow values that were never
        drawn: its row then has nan for numbers, no effective draws, and says so in ``status``,
        which is ``ok`` elsewhere.  ``posterior.json`` lists such laws apart.
        """
        import pandas as pd

        current = self.problem.priors["tau_s"]
        usual = current
        if current.kind != "half_normal":
            bare = replace(self.problem.campaign, side_information={})
            usual = default_priors(bare, self.layout)["tau_s"]
        scale = usual.a
        tau = self.of("tau_s")
        top = max(float(tau.max()), scale)
        laws = {
            "flat": Prior("flat"),
            "half_normal": Prior("half_normal", scale),
            "log_uniform_floored": Prior("log_uniform", scale / 100.0, 10.0 * top),
        }
        rows = []
        for label, law in laws.items():
            # below the floor the log-uniform law is flat, so that it stays proper at zero
            value = law.log_density(np.maximum(tau, law.a) if law.kind == "log_uniform" else tau)
            log_w = value - current.log_density(tau)
            w = np.exp(log_w - log_w.max())
            w /= w.sum()
            lo, hi, up95, up99 = weighted_quantiles(tau, w, [0.025, 0.975, 0.95, 0.99])
            hdi_lo, hdi_hi = highest_density(tau, w, 0.95)
            n_effective, status = float(1.0 / np.sum(w**2)), "ok"
            if reaches_end(tau, w, *current.support):
                lo = hi = hdi_lo = hdi_hi = up95 = up99 = nan
                n_effective = 0.0
                status = (
                    f"the draws were made under {current} and reach its bound: what {law} allows "
                    "beyond it was never drawn; sample under that law"
                )
            rows.append(
                {
                    "prior": label,
                    "law": str(law),
                    "lo95_s": lo,
                    "hi95_s": hi,
                    "hdi_lo95_s": hdi_lo,
                    "hdi_hi95_s": hdi_hi,
                    "upper95_s": up95,
                    "upper99_s": up99,
                    "n_effective": n_effective,
                    "status": status,
                }
            )
        return pd.DataFrame(rows)

    @cached_property
    def inference_data(self) -> Any:
        """ArviZ InferenceData (a DataTree in ArviZ 1.x): posterior, log_likelihood,
        posterior_predictive (a summary on a coarse grid), observed_data."""
        from bayes_sensor.posterior.saving import to_inference_data

        return to_inference_data(self)

    def save(self, path: str | Path) -> None:
        """Write ``posterior.nc``, under a temporary name first."""
        from bayes_sensor.posterior.saving import save

        save(self, path)
