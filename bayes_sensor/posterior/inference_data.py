"""The one place that knows how ArviZ 0.23 (Python 3.11) and ArviZ 1.x differ.

Groups go in as xarray Datasets; out comes an ``InferenceData`` or, in ArviZ 1.x, a ``DataTree``
with the same groups and names.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

ENGINE = "h5netcdf"


def import_quietly(name: str) -> Any:
    """A module that imports ArviZ, without what that says once a day about its own future."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        return import_module(name)


def _arviz() -> Any:
    return import_quietly("arviz")  # slow to import: only where it is used


def has_data_tree() -> bool:
    """Whether the installed ArviZ is 1.0 or newer, whose groups are in a DataTree."""
    return int(_arviz().__version__.split(".")[0]) >= 1


def assemble(groups: Mapping[str, Any], attributes: Mapping[str, Any]) -> Any:
    """InferenceData (or DataTree) of xarray Datasets by group name, with attributes at its root."""
    if has_data_tree():
        import xarray

        tree = xarray.DataTree.from_dict({f"/{name}": data for name, data in groups.items()})
        tree.attrs.update(attributes)
        return tree
    return _arviz().InferenceData(attrs=dict(attributes), **groups)


def save(groups: Mapping[str, Any], attributes: Mapping[str, Any], path: Path) -> None:
    """Write Datasets by group name as netCDF-4: the file that ArviZ of either version writes.

    By xarray alone, because ArviZ takes two seconds to start.
    """
    import xarray

    root: Any = xarray.Dataset(attrs=dict(attributes))
    root.to_netcdf(str(path), mode="w", engine=ENGINE)
    for name, group in groups.items():
        group.to_netcdf(str(path), mode="a", group=name, engine=ENGINE)


def load_group(path: Path, name: str) -> Any:
    """One group of what :func:`save` wrote, as a Dataset in memory."""
    import xarray

    with xarray.open_dataset(str(path), group=name, engine=ENGINE) as group:
        return group.load()


def load(path: Path) -> Any:
    """Read what :func:`save` wrote, into memory; the file is closed again."""
    if has_data_tree():
        import xarray

        with xarray.open_datatree(str(path), engine=ENGINE) as tree:
            return tree.load()
    data = _arviz().from_netcdf(str(path), engine=ENGINE)
    for group in data.groups():
        data[group].load()
    data.close()
    return data
