"""The one place that knows how ArviZ 0.23 (Python 3.11) and ArviZ 1.x differ.

Groups go in as xarray Datasets; out comes an ``InferenceData`` or, in ArviZ 1.x, a ``DataTree``
with the same groups and names.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray

ENGINE = "h5netcdf"


def _arviz() -> Any:
    return import_module("arviz")  # slow to import: only where it is used


def _modern() -> bool:
    return int(_arviz().__version__.split(".")[0]) >= 1


def assemble(groups: Mapping[str, Any], attributes: Mapping[str, Any]) -> Any:
    """InferenceData (or DataTree) of xarray Datasets by group name, with attributes at its root."""
    if _modern():
        import xarray

        tree = xarray.DataTree.from_dict({f"/{name}": data for name, data in groups.items()})
        tree.attrs.update(attributes)
        return tree
    return _arviz().InferenceData(attrs=dict(attributes), **groups)


def save(data: Any, path: Path) -> None:
    """Write as netCDF-4."""
    data.to_netcdf(str(path), engine=ENGINE)


def load(path: Path) -> Any:
    """Read what :func:`save` wrote, into memory; the file is closed again."""
    if _modern():
        import xarray

        with xarray.open_datatree(str(path), engine=ENGINE) as tree:
            return tree.load()
    data = _arviz().from_netcdf(str(path), engine=ENGINE)
    for group in data.groups():
        data[group].load()
    data.close()
    return data


def diagnostics(chains: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rank R-hat, bulk and tail ESS (n_parameters,) of chains (n_chain, n_draw, n_parameters).

    Vehtari et al., Bayesian Analysis 16, 667 (2021), as implemented by ArviZ.  A parameter that
    does not vary has R-hat nan and ESS nan.
    """
    import xarray

    arviz = _arviz()
    data = xarray.Dataset({"theta": (("chain", "draw", "parameter"), chains)})
    with np.errstate(divide="ignore", invalid="ignore"):
        r_hat = arviz.rhat(data)["theta"].values
        bulk = arviz.ess(data, method="bulk")["theta"].values
        tail = arviz.ess(data, method="tail")["theta"].values
    return r_hat, bulk, tail


def pareto_k(log_weights: FloatArray) -> float:
    """Shape of the generalised Pareto law fitted to the largest of the weights (n,).

    Below .5 the weights have a finite variance and the proposal may be trusted (Vehtari et al.,
    Pareto smoothed importance sampling, JMLR 25, 2024).
    """
    log_weights = np.asarray(log_weights)[np.isfinite(log_weights)]
    if len(log_weights) < 100:
        return float("inf")
    if np.ptp(log_weights) < 1e-12:
        return float("-inf")
    if _modern():
        # its psislw takes the negative of what ArviZ 0.23's takes; this one asks for the draws
        array_stats = import_module("arviz_stats.base").array_stats
        weights = np.exp(log_weights - log_weights.max())
        return float(array_stats.pareto_khat(weights[None], r_eff=1.0, tail="right"))
    return float(_arviz().psislw(log_weights)[1])
