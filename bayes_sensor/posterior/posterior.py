"""The posterior as a record: draws, diagnostics, summaries, posterior.json."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.display import card
from bayes_sensor.io.json_files import plain
from bayes_sensor.posterior.convergence import MESH_ERROR_LIMIT
from bayes_sensor.rig.lags import LAG_NAMES
from bayes_sensor.rig.named_values import unit_of
from bayes_sensor.rig.response_times import response_times

if TYPE_CHECKING:
    import pandas as pd

from bayes_sensor.posterior.agreement import Agreement
from bayes_sensor.posterior.draws import Draws, percentiles
from bayes_sensor.posterior.prior_sensitivity import decided_by_prior, tau_under_priors
from bayes_sensor.posterior.save_draws import save_posterior, to_inference_data

NEAR_EQUAL, MAY_BE_EQUAL = 0.8, 0.025
"""ratio of two lags that counts as equal, and the probability from which a warning is given"""
MOST_TIMES = 2000
"""number of draws for the summary of response times"""
QUANTILES = (0.5, 2.5, 16.0, 50.0, 84.0, 97.5, 99.5)


@dataclass(frozen=True, eq=False)
class Posterior(Draws):
    """Draws of theta with their diagnostics, and what they say."""

    agreement: Agreement | None = None
    """with the draws that the sampler began from, if it was given any"""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, in sentences."""
        found = [*self.caveats, *([] if self.converged else [self.convergence]), *self.remarks]
        found += self.doubts
        if self.agreement is not None and not self.agreement.agrees:
            found.append(self.agreement.sentence(self.sampler))
        found += self._of_names()
        found += [
            f"the data give no upper limit of {name}: its interval ends where its prior does, at "
            f"{end:.3g} {unit_of(name.partition('[')[0], '')}"
            for name, end in self.no_upper_limit.items()
        ]
        found += [
            f"the prior that was given of {name}, {law}, ends its interval: the data would allow "
            "more"
            for name, law in self.cut_by_prior.items()
        ]
        found += [
            f"default priors decide the interval of {name}: without them it lies outside with "
            f"{100.0 * outside:.0f} %; give a prior of your own, or record longer steps"
            for name, outside in self.decided_by_prior.items()
        ]
        if self.mesh_error > MESH_ERROR_LIMIT:
            found.append(f"the mesh is off by {self.mesh_error:.1e} in log L, more than 1e-3")
        return tuple(found)

    def _of_names(self) -> list[str]:
        """Sentences on the assignment of the lags."""
        found = []
        naming = self.naming
        unknown = [
            f"{name.rsplit('_', 1)[0]}{'/Q' if name.startswith('V_') else ''}"
            for name in naming.commuting.names
            if name != "tau_s" and naming.place(name) is None
        ]
        if naming.flow is not None and unknown:
            found.append(
                f"all flows are equal: these data cannot tell {' from '.join(unknown)}; where "
                "nothing else tells which is which, their intervals hold both"
            )
        if naming.n_lags < 2:
            return found
        fast, slow = self.lags[:, 0], self.lags[:, -1]
        told = naming.flow is None and self.hidden_by_sampling is None
        if told and np.mean(fast > NEAR_EQUAL * slow) > MAY_BE_EQUAL:
            low, high = np.quantile(fast, 0.025), np.quantile(slow, 0.975)
            found.append(
                f"{' and '.join(name.rsplit('_', 1)[0] for name in naming.commuting.names)} may be "
                "equal and can then not be told apart: both lie between "
                f"{1e3 * low:.4g} and {1e3 * high:.4g} ms (95 %)"
            )
        return found

    @cached_property
    def rows(self) -> dict[str, dict[str, float]]:
        """Mean, sd, percentiles and diagnostics of every varying parameter, by flat name.

        If the order of lags is undecided, the lags are listed in addition to tau and tau_v.  A
        tied parameter has the diagnostics of the one that gives it.
        """
        found = {}
        # where names are not settled the diagnostics are those of the worst of the lags
        commuting = self.problem.commuting
        of_lags = sorted(commuting.places)
        one = len(self.problem.assignments) == 1
        labels = {name: i for i, name in enumerate(self.names)}
        tied = self.layout.tied
        for name in (*self.layout.shared_names, *tied):
            source = tied[name][0] if name in tied else name
            settled = one or source not in commuting.names
            found[name] = self._row(self.of(name), [labels[source]] if settled else of_lags)
        if self.naming.order == "undecided":
            for name in LAG_NAMES[self.naming.n_lags]:
                found[name] = self._row(self.of(name), of_lags)
        for i in self.free:
            if i >= self.layout.n_shared:
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
    def chain(self) -> dict[str, dict[str, dict[str, float]]]:
        """By experiment, s after the switch until the whole chain has covered 63 and 90 %, and its
        rise from 10 to 90 %.

        They do not depend on the assignment of the lags.
        """
        some = self.draws[:: max(1, len(self.draws) // MOST_TIMES)]
        found: dict[str, dict[str, dict[str, float]]] = {}
        known: dict[tuple[str, float], dict[str, dict[str, float]]] = {}
        layout = self.layout
        for k, e in enumerate(self.problem.campaign):
            flow = e.total_flow if layout.rig.needs_flow else 0.0
            which = (e.sensor, flow)
            if which not in known:
                times = response_times(layout.rigs[k].taus(some[:, layout.shared[k]].T, flow))
                known[which] = {
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
            found[e.name] = known[which]
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
            "lags_s": [percentiles(lag) for lag in self.lags.T],
            "chain": self.chain,
            "hidden_by_sampling_s": self.hidden_by_sampling,
            "no_upper_limit": self.no_upper_limit,
            "decided_by_prior": self.decided_by_prior,
            "n_draws": len(self.draws),
            "converged": self.converged,
            "status": self.status,
            "convergence": self.convergence,
            "doubts": list(self.doubts),
            "sampler": self.sampler,
            "reasons": list(self.reasons),
            "began_from": None if self.agreement is None else self.agreement.to_json(),
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
    def decided_by_prior(self) -> dict[str, float]:
        """The probability without default priors that a shared parameter lies outside its 95 %
        interval, by flat name, where that is more likely than not."""
        return decided_by_prior(self)

    def tau_under_priors(self) -> pd.DataFrame:
        """Intervals and upper limits of tau (s) under other priors, by reweighting the draws.

        See :func:`bayes_sensor.posterior.prior_sensitivity.tau_under_priors`.
        """
        return tau_under_priors(self)

    @cached_property
    def inference_data(self) -> Any:
        """ArviZ InferenceData (a DataTree in ArviZ 1.x): posterior, log_likelihood,
        posterior_predictive (a summary on a coarse grid), observed_data."""
        return to_inference_data(self)

    def save(self, path: str | Path) -> None:
        """Write ``posterior.nc``, under a temporary name first."""
        save_posterior(self, path)
