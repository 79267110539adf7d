"""Results as labeled arrays, an xarray.Dataset with names, units and coordinates, and as a table of
pandas.

Both libraries are imported here, at their first use, and are an extra: `pip install
'jaxbody[xarray]'`. The leading axis of a batch becomes `sample`."""

from abc import ABC, abstractmethod
from itertools import product
from typing import Any, ClassVar

import numpy as np

from jaxbody.core.errors import check_known, import_extra

AXES, QUATERNION = list("xyz"), list("wxyz")


class Labeled(ABC):
    """The base class of objects with labeled arrays. Class attribute: `index`, the dimension of
    their table."""

    index: ClassVar[str]

    @abstractmethod
    def to_xarray(self) -> Any:
        """Return an xarray.Dataset with units in the attributes of its variables."""

    def to_pandas(self, over: str | None = None) -> Any:
        """Return a pandas.DataFrame of the variables of `to_xarray` over one dimension, a row for
        each of its values.

        Args:
            over: the dimension; None: the main one, such as time or mode. Labels of other
                dimensions stand in the names of the columns, "position[car, z]". For a batch,
                `sample` is the first level of the index.

        The result has `attrs["units"]`, {column: unit}, "" for a column without a unit. Errors:
        UNKNOWN_NAME, with the dimensions; MISSING_EXTRA."""
        import_extra("pandas", "to_pandas")
        return _frame_of(self.to_xarray(), over or self.index, f"{type(self).__name__}.to_pandas")


def frame_of_table(columns: tuple[str, ...], rows: list[tuple[Any, ...]]) -> Any:
    """Return a printed table as a DataFrame; a heading "mass [kg]" is a column and its unit."""
    pandas = import_extra("pandas", "to_pandas")
    units: dict[str, str] = {}
    for i, head in enumerate(columns, start=1):
        name, _, unit = head.removesuffix("]").partition(" [")
        units[name if name and name not in units else f"column {i}"] = unit
    cells = [
        [value if isinstance(value, str) else np.asarray(value)[()] for value in row]
        for row in rows
    ]
    frame = pandas.DataFrame(cells, columns=list(units))
    frame.attrs["units"] = units
    return frame


def _frame_of(data: Any, over: str, where: str) -> Any:
    """Return the variables of a Dataset over one dimension as a DataFrame, as `to_pandas` describes
    it."""
    pandas = import_extra("pandas", where)
    check_known(over, where, data.dims)
    index = [dim for dim in ("sample", over) if dim in data.dims]
    labels = {
        dim: data[dim].values if dim in data.coords else np.arange(size)
        for dim, size in data.sizes.items()
    }
    columns, units = {}, {}
    for name, array in data.data_vars.items():
        others = [dim for dim in array.dims if dim not in index]
        if over not in array.dims:
            continue
        values = array.transpose(*others, *(dim for dim in index if dim in array.dims)).values
        for place in product(*(range(data.sizes[dim]) for dim in others)):
            words = [str(labels[dim][i]) for dim, i in zip(others, place, strict=True)]
            column = f"{name}[{', '.join(words)}]" if words else str(name)
            columns[column] = (
                values[place].ravel()
                if index[0] in array.dims
                else np.tile(values[place], data.sizes["sample"])
            )
            units[column] = _unit(data, array, dict(zip(others, place, strict=True)))
    names = [labels[dim] for dim in index]
    made = (
        pandas.MultiIndex.from_product(names, names=index)
        if len(index) > 1
        else pandas.Index(names[0], name=over)
    )
    frame = pandas.DataFrame(columns, index=made)
    frame.attrs["units"] = {
        over: data[over].attrs.get("units", "") if over in data.coords else "",
        **units,
    }
    return frame


def _unit(data: Any, array: Any, place: dict[str, int]) -> str:
    """Return the unit of a column. The word `unit` in the units of an array stands for the value of
    the variable `unit` at this place."""
    stated = array.attrs.get("units", "")
    if "unit" not in stated or "unit" not in data:
        return stated
    own = data["unit"].isel({dim: i for dim, i in place.items() if dim in data["unit"].dims}).values
    if own.ndim:  # the unit differs from row to row
        return stated
    return str(own) if stated == "unit" else stated.replace("unit", f"({own})")


def dataset(
    variables: dict[str, tuple[tuple[str, ...], Any, str]], coordinates: dict[str, Any], kind: str
) -> Any:
    """Return {name: (dimensions, values, unit)} as a Dataset; values with one axis more than
    dimensions are a batch of samples."""
    xarray = import_extra("xarray", "to_xarray")
    arrays = {}
    for name, (dimensions, values, unit) in variables.items():
        values = np.asarray(values)
        if values.ndim == len(dimensions) + 1:
            dimensions = ("sample", *dimensions)
        arrays[name] = xarray.DataArray(
            values, dims=dimensions, attrs={"units": unit} if unit else {}
        )
    return xarray.Dataset(arrays, coords=coordinates, attrs={"title": kind})


def rows_of(arrays: list[Any], axis: int) -> np.ndarray:
    """Return arrays stacked along a new axis, in NumPy."""
    return np.stack([np.asarray(array) for array in arrays], axis)
