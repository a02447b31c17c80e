"""The posterior as ArviZ InferenceData, and chains read back from it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.io.disk import replacing
from bayes_sensor.likelihood.noise import scale_squared
from bayes_sensor.posterior import inference_data as idata
from bayes_sensor.posterior.draws import Draws
from bayes_sensor.rig.lags import LAG_NAMES
from bayes_sensor.rig.layout import SHARED, unit_of

VARIABLES = {
    "tau": "tau_s", "tau_v": "tau_v_s", "V": "V_mL", "phi": "phi", "sigma0": "sigma0_V",
    "sigma1": "sigma1_V", "y0": "y0_V", "beta": "beta_V", "t0": "t0_s", "tf": "tf_s",
}  # fmt: skip


def to_inference_data(posterior: Draws) -> Any:
    """ArviZ InferenceData (a DataTree in ArviZ 1.x) of a posterior."""
    return idata.assemble(*_contents(posterior))


def save_posterior(posterior: Draws, path: str | Path) -> None:
    """Write ``posterior.nc``, complete or not at all."""
    with replacing(path) as new:
        idata.save(*_contents(posterior), new)


def _contents(posterior: Draws) -> tuple[dict[str, Any], dict[str, Any]]:
    """Groups as Datasets by name, and the attributes of the whole."""
    import xarray

    from bayes_sensor import __version__

    problem, layout, chains = posterior.problem, posterior.layout, posterior.chains
    campaign = problem.campaign
    names = campaign.names_of_experiments
    n_chain, n_draw, _ = chains.shape
    coordinates: dict[str, Any] = {
        "chain": np.arange(n_chain), "draw": np.arange(n_draw), "experiment": names,
    }  # fmt: skip
    variables: dict[str, Any] = {}
    own = dict.fromkeys(name.split("[")[0] for name in layout.extra)
    flat_names = VARIABLES | {kind: kind for kind in own}
    if posterior.naming.order == "undecided":
        flat_names |= {name.removesuffix("_s"): name for name in LAG_NAMES[posterior.naming.n_lags]}
    for variable, flat in flat_names.items():
        if flat in SHARED or flat in LAG_NAMES[posterior.naming.n_lags]:
            draws = posterior.of(flat).reshape(n_chain, n_draw)
            variables[variable] = (("chain", "draw"), draws)
            continue
        if flat in layout.names:
            variables[variable] = (("chain", "draw"), chains[:, :, layout.index(flat)])
            continue
        columns = [
            chains[:, :, layout.index(f"{flat}[{name}]")]
            if f"{flat}[{name}]" in layout.names
            else np.full((n_chain, n_draw), np.nan)
            for name in names
        ]
        if any(f"{flat}[{name}]" in layout.names for name in names):
            variables[variable] = (("chain", "draw", "experiment"), np.stack(columns, axis=-1))
    group = xarray.Dataset(variables, coords=coordinates)
    for variable in variables:
        group[variable].attrs["units"] = unit_of(flat_names[variable], campaign.signal_unit)
    predictive, observed = _predictive(posterior)
    attributes = {
        "created_by": f"bayes_sensor {__version__}",
        "sampler": posterior.sampler,
        "seed": posterior.seed,
        "converged": int(posterior.converged),
        "status": posterior.status,
        "reasons": " | ".join(posterior.reasons),
        "phi_interval_s": campaign.reference_interval,
        "log_likelihood_error": posterior.mesh_error,
        "priors": json.dumps(dict(sorted(posterior.laws.items()))),
        "order_of_lags": posterior.naming.order,
        "data_sha256": json.dumps({e.name: e.sha256 for e in campaign}),
    }
    likelihood = xarray.Dataset(
        {"log_likelihood": (("chain", "draw", "experiment"), posterior.log_likelihood)},
        coords=coordinates,
    )
    groups = {
        "posterior": group,
        "log_likelihood": likelihood,
        "posterior_predictive": predictive,
        "observed_data": observed,
    }
    return groups, attributes


def _predictive(posterior: Draws, n_times: int = 240, n_draws: int = 120) -> tuple[Any, Any]:
    """Summary of the replicated mean and of the data on a coarse grid of every experiment."""
    import xarray

    problem, layout = posterior.problem, posterior.layout
    campaign = problem.campaign
    some = posterior.draws[:: max(1, len(posterior.draws) // n_draws)][:n_draws]
    shape = (len(campaign), n_times)
    t, low, middle, high, spread, seen = (np.full(shape, np.nan) for _ in range(6))
    for k, e in enumerate(campaign):
        edges = np.linspace(0, len(e.t), n_times + 1).astype(int)
        used = e.used
        for b in range(n_times):
            part = slice(edges[b], max(edges[b + 1], edges[b] + 1))
            t[k, b] = e.t[part].mean()
            if used[part].any():
                seen[k, b] = e.values[part][used[part]].mean()
        means = np.array([problem.model.mean(t[k], row, layout, e) for row in some])
        low[k], middle[k], high[k] = np.quantile(means, [0.025, 0.5, 0.975], axis=0)
        row = some.mean(axis=0)
        x = problem.model.response(t[k], row, layout, e)
        _, sigma0, sigma1 = row[layout.noise[k]]
        law = problem.noise.weight(campaign, e), problem.noise.fading
        spread[k] = np.sqrt(scale_squared(x, sigma0, sigma1, *law))
    dims = ("experiment", "bin")
    coordinates = {"experiment": campaign.names_of_experiments, "bin": np.arange(n_times)}
    predictive = xarray.Dataset(
        {
            "t": (dims, t),
            "mean_q2.5": (dims, low),
            "mean_q50": (dims, middle),
            "mean_q97.5": (dims, high),
            "sample_sd": (dims, spread),
        },
        coords=coordinates,
    )
    return predictive, xarray.Dataset({"t": (dims, t), "y": (dims, seen)}, coords=coordinates)


def load_chains(path: str | Path) -> tuple[list[str], FloatArray]:
    """Flat names and chains (n_chain, n_draw, n_theta) of a saved ``posterior.nc``."""
    data = idata.load_group(Path(path), "posterior")
    names, columns = [], []
    by_size = {lag.removesuffix("_s"): lag for several in LAG_NAMES.values() for lag in several}
    own = [str(kind) for kind in data.data_vars if kind not in VARIABLES | by_size]
    for kind, flat in (VARIABLES | by_size | {kind: kind for kind in own}).items():
        if kind not in data:
            continue
        variable = data[kind]
        if "experiment" not in variable.dims:
            names.append(flat)
            columns.append(variable.values)
            continue
        for name in variable["experiment"].values:
            values = variable.sel(experiment=name).values
            if np.isfinite(values).all():
                names.append(f"{flat}[{name}]")
                columns.append(values)
    return names, np.stack(columns, axis=-1)
