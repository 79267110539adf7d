"""Results as labeled arrays: an xarray.Dataset with names, units and coordinates.

xarray is imported here, on first use, and is an extra: `pip install 'jaxbody[xarray]'`. Leading axes of a batch become `sample`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.core.errors import import_extra

AXES, QUATERNION = list("xyz"), list("wxyz")


def dataset(variables: dict[str, tuple[tuple[str, ...], Any, str]], coordinates: dict[str, Any], kind: str) -> Any:
    """{name: (dimensions, values, unit)} as a Dataset; values with one axis more than dimensions are a batch of samples."""
    xarray = import_extra("xarray", "to_xarray")
    arrays = {}
    for name, (dimensions, values, unit) in variables.items():
        values = np.asarray(values)
        if values.ndim == len(dimensions) + 1:
            dimensions = ("sample", *dimensions)
        arrays[name] = xarray.DataArray(values, dims=dimensions, attrs={"units": unit} if unit else {})
    return xarray.Dataset(arrays, coords=coordinates, attrs={"title": kind})


def rows_of(arrays: list[Any], axis: int) -> np.ndarray:
    """Arrays side by side along a new axis, in NumPy."""
    return np.stack([np.asarray(array) for array in arrays], axis)
