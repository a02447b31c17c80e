"""The posterior as a record: draws, diagnostics, summaries, posterior.json."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.display import card
from bayes_sensor.io.json_files import plain
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.default_priors import MOST_RISES, default_priors
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior.convergence import ESS_LIMIT, MESH_ERROR_LIMIT, R_HAT_LIMIT
from bayes_sensor.posterior.quantiles import highest_density, reaches_end, weighted_quantiles
from bayes_sensor.posterior.settings import Settings
from bayes_sensor.rig.lags import LAG_NAMES, Naming, lags_of, named
from bayes_sensor.rig.layout import SHARED, Layout
from bayes_sensor.rig.response_times import response_times

if TYPE_CHECKING:
    import pandas as pd

NEAR_EQUAL, MAY_BE_EQUAL = 0.8, 0.025
"""ratio of two lags that counts as equal, and the probability from which a warning is given"""
NEVER = 1e-6
"""probability below which an assignment is not mentioned"""
MOST_TIMES = 2000
"""number of draws for the summary of response times"""
QUANTILES = (0.5, 2.5, 16.0, 50.0, 84.0, 97.5, 99.5)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Draws of theta with their diagnostics."""

    problem: Problem
    chains: FloatArray
    """(n_chain, n_draw, n_theta); for emcee a chain is an ensemble, its walkers end to end"""
    log_likelihood: FloatArray
    """(n_chain, n_draw, n_experiment)"""
    sampler: str
    """which sampler made the draws"""
    reasons: tuple[str, ...]
    """sentences: which sampler was used and its checks"""
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
    hidden_by_sampling: float | None = None
    """s, the sampling interval if the whole response is shorter than it"""
    caveats: tuple[str, ...] = ()
    """caveats of the fit"""
    remarks: tuple[str, ...] = ()
    """further sentences of the fit that also apply to the posterior"""
    doubts: tuple[str, ...] = ()
    """sentences on failed checks of the noise law; intervals are then not reliable"""

    @property
    def layout(self) -> Layout:
        """Order of the flat vector."""
        return self.problem.layout

    @cached_property
    def names(self) -> list[str]:
        """Flat names, in the order of the last axis of ``chains``.

        That axis has the lags by size (:mod:`bayes_sensor.rig.lags`).  A lag that cannot be
        assigned is named by its size.
        """
        return [*self.naming.names, *self.layout.names[len(SHARED) :]]

    @cached_property
    def draws(self) -> FloatArray:
        """(n, n_theta), all chains together, lags by size."""
        return self.chains.reshape(-1, self.chains.shape[-1])

    @cached_property
    def free(self) -> np.ndarray:
        """Positions of the parameters that vary."""
        return Coordinates(self.problem).free

    @cached_property
    def shares(self) -> FloatArray:
        """(n, n_assignments) probability of every assignment of names to lags, draw by draw."""
        return self.problem.shares(self.draws)

    @cached_property
    def naming(self) -> Naming:
        """The assignment of the lags that may be stated."""
        return self.problem.naming(self.shares.mean(axis=0))

    @cached_property
    def lags(self) -> FloatArray:
        """(n, n_lags) s, draws of the lags that do not depend on flow, shortest first."""
        return lags_of(self.draws, self.problem.flow)

    @cached_property
    def named(self) -> FloatArray:
        """(n, 3) draws of tau (s), tau_v (s) and V (mL).

        If several assignments are possible, each draw has one, drawn with its probability; tau is
        then either of the lags.  If one assignment is stated, a draw with another one is replaced
        by the last draw that has it.
        """
        choices = self.problem.assignments
        if len(choices) == 1:
            return named(self.draws, self.problem.flow, choices)
        stated = self.naming.place("sensor")
        allowed = np.array([stated in (None, choice.sensor) for choice in choices])
        rng = np.random.default_rng([self.seed, len(choices)])
        u = rng.random(len(self.draws))
        chosen = (np.cumsum(self.shares, axis=1) < u[:, None]).sum(axis=1).clip(0, len(choices) - 1)
        good = allowed[chosen]
        place = np.maximum.accumulate(np.where(good, np.arange(len(good)), -1))
        place = np.where(place < 0, int(np.argmax(good)), place)
        return named(self.draws[place], self.problem.flow, choices, chosen[place])

    def of(self, name: str) -> FloatArray:
        """(n,) draws of one parameter; tau, tau_v and V as in :attr:`named`."""
        if name in SHARED:
            return self.named[:, SHARED.index(name)]
        lag_names = LAG_NAMES[self.naming.n_lags]
        if name in lag_names:
            return self.lags[:, lag_names.index(name)]
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
        """Whether it converged, and which checks of the noise law failed."""
        return "; ".join([self.convergence, *self.doubts])

    @property
    def convergence(self) -> str:
        """One sentence: converged, or what is missing."""
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
        """Warnings, in sentences."""
        found = [*self.caveats, *([] if self.converged else [self.convergence]), *self.remarks]
        found += self.doubts
        found += self._of_names()
        if self.mesh_error > MESH_ERROR_LIMIT:
            found.append(f"the mesh is off by {self.mesh_error:.1e} in log L, more than 1e-3")
        return tuple(found)

    def _of_names(self) -> list[str]:
        """Sentences on the assignment of the lags."""
        found = []
        naming = self.naming
        if naming.flow is not None and None in (naming.place("valve"), naming.place("manifold")):
            found.append(
                "all flows are equal: these data cannot tell tau_v from V/Q; where nothing else "
                "tells which is which, their intervals hold both"
            )
        fast, slow = self.lags[:, 0], self.lags[:, -1]
        told = naming.flow is None and self.hidden_by_sampling is None
        if told and np.mean(fast > NEAR_EQUAL * slow) > MAY_BE_EQUAL:
            low, high = np.quantile(fast, 0.025), np.quantile(slow, 0.975)
            found.append(
                f"tau and tau_v may be equal and can then not be told apart: both lie between "
                f"{1e3 * low:.4g} and {1e3 * high:.4g} ms (95 %)"
            )
        return found

    @cached_property
    def rows(self) -> dict[str, dict[str, float]]:
        """Mean, sd, percentiles and diagnostics of every varying parameter, by flat name.

        If the order of lags is undecided, the lags are listed in addition to tau and tau_v.
        """
        found = {}
        # where names are not settled the diagnostics are those of the worst of the lags
        of_lags = [0, 1] if self.problem.flow is None else [0, 1, 2]
        one = len(self.problem.assignments) == 1
        labels = {name: i for i, name in enumerate(self.names)}
        for name in SHARED:
            settled = one or (self.problem.flow is None and name == "V_mL")
            found[name] = self._row(self.of(name), [labels[name]] if settled else of_lags)
        if self.naming.order == "undecided":
            for name in LAG_NAMES[self.naming.n_lags]:
                found[name] = self._row(self.of(name), of_lags)
        for i in self.free:
            if i >= len(SHARED):
                found[self.names[i]] = self._row(self.draws[:, i], [i])
        return found

    def summary(self) -> pd.DataFrame:
        """Mean, sd, percentiles and diagnostics of every varying parameter, one row each."""
        import pandas as pd

        return pd.DataFrame.from_dict(self.rows, orient="index")

    def _row(self, draws: FloatArray, places: list[int]) -> dict[str, float]:
        row = {"mean": float(draws.mean()), "sd": float(draws.std(ddof=1))}
        for percent, value in zip(QUANTILES, np.percentile(draws, QUANTILES), strict=True):
            row[f"q{percent:g}"] = float(value)
        row["ess_bulk"] = float(self.ess_bulk[places].min())
        row["ess_tail"] = float(self.ess_tail[places].min())
        row["r_hat"] = float(self.r_hat[places].max())
        return row

    @cached_property
    def assignments(self) -> list[dict[str, Any]]:
        """For each lag that may be the sensor's: its place, the probability, tau and tau_v."""
        found = []
        choices = self.problem.assignments
        for place in sorted({choice.sensor for choice in choices}):
            members = [j for j, choice in enumerate(choices) if choice.sensor == place]
            weights = self.shares[:, members]
            probability = float(weights.sum() / len(self.draws))
            # of the draws, each with the weight of this sensor; of all where that is nil
            if probability <= NEVER:
                weights = np.full(weights.shape, 1.0 / weights.size)
            valve = np.concatenate([self.lags[:, choices[j].valve] for j in members])
            w = weights.sum(axis=1)
            found.append(
                {
                    "sensor_is": choices[members[0]].sensor_is,
                    "lag": place,
                    "probability": probability,
                    "tau_s": _quantiles(self.lags[:, place], w / w.sum()),
                    "tau_v_s": _quantiles(valve, weights.T.ravel() / weights.sum()),
                }
            )
        return found

    @cached_property
    def chain(self) -> dict[str, dict[str, dict[str, float]]]:
        """By experiment, s after the switch until the whole chain has covered 63 and 90 %, and its
        rise from 10 to 90 %.

        They do not depend on the assignment of the lags.
        """
        some = self.draws[:: max(1, len(self.draws) // MOST_TIMES)]
        found: dict[str, dict[str, dict[str, float]]] = {}
        by_flow: dict[float, dict[str, dict[str, float]]] = {}
        for e in self.problem.campaign:
            if e.total_flow not in by_flow:
                times = response_times([some[:, 1], some[:, 2] / e.total_flow, some[:, 0]])
                by_flow[e.total_flow] = {
                    f"{key}_s": {
                        f"q{percent:g}": float(value)
                        for percent, value in zip(
                            QUANTILES, np.percentile(values, QUANTILES), strict=True
                        )
                    }
                    for key, values in (
                        ("t63", times.t63),
                        ("t90", times.t90),
                        ("rise", times.rise),
                    )
                }
            found[e.name] = by_flow[e.total_flow]
        return found

    def __repr__(self) -> str:
        """Size and status."""
        return f"Posterior({len(self.draws)} draws by {self.sampler}; {self.convergence})"

    def _repr_html_(self) -> str:
        """HTML for a notebook."""
        rows = [
            [
                name, row["q50"], row["q2.5"], row["q97.5"],
                round(min(row["ess_bulk"], row["ess_tail"])), row["r_hat"],
            ]
            for name, row in self.rows.items()
        ]  # fmt: skip
        columns = ["parameter", "median", "95 % low", "95 % high", "effective draws", "R-hat"]
        warnings = [text for text in self.warnings if text != self.convergence]
        return card(f"posterior: {self.convergence}", warnings, columns, rows)

    def to_json(self) -> dict[str, Any]:
        """The contents of ``posterior.json``; parameters that the noise law fixes are null."""
        parameters: dict[str, Any] = dict(self.rows)
        parameters |= {name: None for name in self.names if name not in parameters}
        return {
            "parameters": parameters,
            "order": self.naming.order,
            "assignments": self.assignments,
            "lags_s": [_quantiles(lag) for lag in self.lags.T],
            "chain": self.chain,
            "hidden_by_sampling_s": self.hidden_by_sampling,
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
            "priors": self.laws,
            "phi_interval_s": self.problem.campaign.reference_interval,
            "signal_unit": self.problem.campaign.signal_unit,
            **self._tau_under_priors(),
        }

    def _tau_under_priors(self) -> dict[str, Any]:
        """The rows of :meth:`tau_under_priors` with numbers, and the laws of the others, with the
        reason."""
        rows = self.tau_under_priors().to_dict(orient="records")
        without = [row for row in rows if row["status"] != "ok"]
        return {
            "tau_under_priors": [row for row in rows if row["status"] == "ok"],
            "tau_under_priors_left_out": [
                {key: row[key] for key in ("prior", "law", "status")} for row in without
            ],
        }

    @cached_property
    def laws(self) -> dict[str, str]:
        """The prior of every varying parameter in words, by flat name; lags that are not assigned
        by size have theirs beside the side information by name."""
        priors, own = self.problem.priors, self.layout.names
        found = {self.names[i]: str(priors[own[i]]) for i in self.free}
        if len(self.problem.assignments) > 1:
            found = {name: law for name, law in found.items() if name not in self.names[:3]}
            by_size = zip(LAG_NAMES[self.naming.n_lags], self.problem.lag_priors, strict=True)
            found |= {name: str(law) for name, law in by_size}
            if self.problem.flow is None:
                found["V_mL"] = str(priors["V_mL"])
            found |= {name: str(law) for name, law in self.problem.named_laws.items()}
        return found

    def tau_under_priors(self) -> pd.DataFrame:
        """Intervals and upper limits of tau (s) under other priors, by reweighting the draws.

        Rows: flat, half-normal, log-uniform with a floor (a hundredth of the half-normal's scale);
        one set for each lag that may be the sensor's, if that is undecided (``sensor_is``). The
        half-normal is the posterior's own or, where it has another law, the default one. Columns:
        equal-tailed 95 % interval, highest-density 95 % interval, one-sided 95 and 99 % upper
        limits, the effective number of draws that the reweighting leaves, and ``status``.

        Reweighting cannot leave the support of the law that was sampled.  If that support is
        bounded and the draws under another law reach its bound, this law would allow values that
        were never drawn.  Its row then has nan for numbers, no effective draws, and the reason in
        ``status``, which is ``ok`` elsewhere.  ``posterior.json`` lists such laws apart.
        """
        import pandas as pd

        rows = []
        for assignment in self.assignments:
            stated = self.naming.place("sensor") in (None, assignment["lag"])
            if stated and assignment["probability"] > NEVER:
                rows += self._tau_at(assignment["lag"], assignment["sensor_is"])
        return pd.DataFrame(rows)

    def _tau_at(self, place: int, sensor_is: str) -> list[dict[str, Any]]:
        """Rows of :meth:`tau_under_priors` if the sensor is the lag at this place."""
        current = self.problem.lag_priors[place]
        usual = current
        if current.kind != "half_normal":
            usual = default_priors(self.problem.campaign, self.layout)["tau_s"]
        # where lags have no names their law is uniform up to ten rises
        scale = usual.a if usual.kind == "half_normal" else usual.b / MOST_RISES
        tau = self.lags[:, place]
        chosen = [j for j, a in enumerate(self.problem.assignments) if a.sensor == place]
        share = self.shares[:, chosen].sum(axis=1)
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
            w = np.exp(log_w - log_w.max()) * share
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
                    "sensor_is": sensor_is,
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
        return rows

    @cached_property
    def inference_data(self) -> Any:
        """ArviZ InferenceData (a DataTree in ArviZ 1.x): posterior, log_likelihood,
        posterior_predictive (a summary on a coarse grid), observed_data."""
        from bayes_sensor.posterior.save_draws import to_inference_data

        return to_inference_data(self)

    def save(self, path: str | Path) -> None:
        """Write ``posterior.nc``, under a temporary name first."""
        from bayes_sensor.posterior.save_draws import save

        save(self, path)


def _quantiles(draws: FloatArray, weights: FloatArray | None = None) -> dict[str, float]:
    """``q2.5``, ``q50``, ``q95`` and ``q97.5`` of draws (n,), weighted by ``weights`` (n,)."""
    percents = (2.5, 50.0, 95.0, 97.5)
    if weights is None:
        values = [float(v) for v in np.percentile(draws, percents)]
    else:
        values = weighted_quantiles(draws, weights, [0.01 * percent for percent in percents])
    return {f"q{percent:g}": value for percent, value in zip(percents, values, strict=True)}
