"""The one place that knows how ArviZ 0.23 (Python 3.11) and ArviZ 1.x differ.

Groups go in as xarray Datasets; out comes an ``InferenceData`` or, in ArviZ 1.x, a ``DataTree``
with the same groups and names.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.io.disk import write_bytes
from bayes_sensor.io.untrusted import LARGEST_FILE, UNREADABLE, check_size, read_bytes, refused

EXPECTED = "the draws of a posterior"
DEEPEST = 4
"""levels of groups in a file of ours, and two more"""
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
    """Write Datasets by group name as netCDF-4, complete or not at all; either ArviZ reads it.

    By xarray alone, because ArviZ takes two seconds to start.  HDF5 makes it in memory: what cannot
    write to a full disk ends this process, now or when it is cleared away.
    """
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    made = io.BytesIO()
    with h5netcdf.File(made, "w") as file:
        file.attrs.update(attributes)
        for name, group in groups.items():
            # by a store of its own: on a Dask worker xarray would ask the cluster for a file's lock
            group.dump_to_store(H5NetCDFStore(file.create_group(name)))
    write_bytes(path, made.getvalue())


def load_group(path: Path, name: str) -> Any:
    """One group of what :func:`save` wrote, as a Dataset in memory.

    Raises CampaignError for a file that is damaged, leads to others or unpacks to too much.
    """
    import h5py
    import xarray

    content = read_bytes(path, LARGEST_FILE, EXPECTED)
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            check_size(_size(file), len(content))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # one message on a damaged file is enough
            with xarray.open_dataset(io.BytesIO(content), group=name, engine=ENGINE) as group:
                return group.load()
    except UNREADABLE as error:
        raise refused(path, EXPECTED, f"they cannot be read ({error})") from None


def _size(group: Any, depth: int = 0) -> int:
    """Bytes of all datasets; ValueError for what leads out of the file, or round in it."""
    import h5py

    size = 0
    for name in group:
        item = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
        if isinstance(item, h5py.Dataset) and not (item.external or item.is_virtual):
            size += int(np.prod(item.shape or (1,), dtype=object)) * item.dtype.itemsize
        elif isinstance(item, h5py.Group) and depth < DEEPEST:
            size += _size(item, depth + 1)
        else:
            raise ValueError(f"'{str(name)[:60]}' is neither numbers nor a group of such")
    return size


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
