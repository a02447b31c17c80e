"""The posterior as ArviZ InferenceData, and chains read back from it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.io.untrusted import refused
from bayes_sensor.likelihood.noise import scale_squared
from bayes_sensor.posterior import inference_data as idata
from bayes_sensor.posterior.draws import Draws
from bayes_sensor.rig.lags import LAG_NAMES
from bayes_sensor.rig.named_values import unit_of
from bayes_sensor.rig.switching import is_switch_time

LARGEST = 1e100
"""of a draw: its square is a number, too"""


def variable_of(flat: str) -> str:
    """Name of a parameter's variable: its flat name, for those of rig, records and noise without
    the unit.

    >>> [variable_of(name) for name in ("tau_v_s", "V_mL", "phi", "t0_s", "drift_V_per_s")]
    ['tau_v', 'V', 'phi', 't0', 'drift_V_per_s']
    """
    own = re.fullmatch(r"(tau|lag|V|y0|beta|sigma[01])(_\w+)?_(s|mL|V)|(tau|lag)_s", flat)
    return flat.rsplit("_", 1)[0] if own or is_switch_time(flat) else flat


def to_inference_data(posterior: Draws) -> Any:
    """ArviZ InferenceData (a DataTree in ArviZ 1.x) of a posterior."""
    return idata.assemble(*_contents(posterior))


def save_posterior(posterior: Draws, path: str | Path) -> None:
    """Write ``posterior.nc``, complete or not at all."""
    idata.save(*_contents(posterior), Path(path))


def _contents(posterior: Draws) -> tuple[dict[str, Any], dict[str, Any]]:
    """Groups as Datasets by name, and the attributes of the whole."""
    import xarray

    from bayes_sensor import __version__

    problem, layout, chains = posterior.problem, posterior.layout, posterior.chains
    campaign = problem.campaign
    names = campaign.names_of_experiments
    records = list(dict.fromkeys(layout.records))
    n_chain, n_draw, _ = chains.shape
    coordinates: dict[str, Any] = {
        "chain": np.arange(n_chain), "draw": np.arange(n_draw), "experiment": names,
    }  # fmt: skip
    variables: dict[str, Any] = {}

    def add(variable: str, flat: str, draws: FloatArray, dimension: str = "") -> None:
        dims = ("chain", "draw", dimension) if dimension else ("chain", "draw")
        unit = unit_of(flat, campaign.signal_unit)
        variables[variable] = (dims, draws, {"units": unit, "parameter": flat})

    lag_names = LAG_NAMES.get(posterior.naming.n_lags, ())
    alone = [name for name in (*layout.shared_names, *layout.tied) if "[" not in name]
    if posterior.naming.order == "undecided":
        alone += lag_names
    for flat in alone:
        add(variable_of(flat), flat, posterior.of(flat).reshape(n_chain, n_draw))
    rest = [name for name in layout.names if name not in alone]
    kinds = dict.fromkeys(name.split("[")[0] for name in rest)
    for flat in kinds:
        if flat in layout.names:
            add(variable_of(flat), flat, chains[:, :, layout.index(flat)])
            continue
        # by experiment, by record where several sensors share one, or by sensor
        for dimension, labels in (
            ("experiment", names), ("record", records), ("sensor", list(layout.sensor_names)),
        ):  # fmt: skip
            known = [f"{flat}[{label}]" in layout.names for label in labels]
            if any(known):
                columns = [
                    posterior.of(f"{flat}[{label}]").reshape(n_chain, n_draw)
                    if there or f"{flat}[{label}]" in layout.sources
                    else np.full((n_chain, n_draw), np.nan)
                    for label, there in zip(labels, known, strict=True)
                ]
                add(variable_of(flat), flat, np.stack(columns, axis=-1), dimension)
                coordinates.setdefault(dimension, labels)
                break
    group = xarray.Dataset(variables, coords=coordinates)
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
    """Flat names and chains (n_chain, n_draw, n_theta) of a saved ``posterior.nc``.

    Raises CampaignError where it holds something else.
    """
    data = idata.load_group(Path(path), "posterior")
    names: list[str] = []
    columns = []
    for kind in map(str, data.data_vars):
        variable, flat = data[kind], str(data[kind].attrs.get("parameter", ""))
        good = variable.dims[:2] == ("chain", "draw") and variable.ndim < 4 and variable.size
        if not (good and flat and variable.dtype.kind == "f"):
            told = f"{kind[:60]} is no parameter with its chains"
            raise refused(path, idata.EXPECTED, told)
        own = [str(dim) for dim in variable.dims if dim not in ("chain", "draw")]
        if not own:
            names.append(flat)
            columns.append(variable.values)
            continue
        for name in variable[own[0]].values:
            values = variable.sel({own[0]: name}).values
            if np.isfinite(values).all():
                names.append(f"{flat}[{name}]")
                columns.append(values)
    chains = np.stack(columns, axis=-1) if columns else np.empty((0, 0, 0))
    if not (chains.size and (np.abs(chains) < LARGEST).all() and len({*names}) == len(names)):
        raise refused(path, idata.EXPECTED, "they are not finite, or a name stands twice")
    return names, chains
