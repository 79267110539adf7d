"""The base classes of results: a status with its message, tables that are printed, and labeled
arrays: an xarray.Dataset with names, units and coordinates, and a table of pandas.

Both libraries are imported here, at their first use, and are an extra: `pip install
'jaxbody[xarray]'`. The leading axis of a batch becomes `sample`."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import as_numpy, is_concrete, part_of, rows_or_nan
from jaxbody.core.errors import (
    MESSAGES,
    MOST_PROBLEMS,
    JaxbodyError,
    Problem,
    Status,
    check_known,
    import_extra,
    warn,
)
from jaxbody.core.jax_internals import Tracer

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


AnyResult = TypeVar("AnyResult", bound="Result")


class Result(tables.Printed, eqx.Module):
    """The base class of results: `.status` (one code per sample), `.ok`, `.report()`,
    `.raise_if_failed()`, and printing as tables."""

    status: eqx.AbstractVar[Any]

    @property
    def ok(self) -> Any:
        """True where the status is 0 (an array for batched results)."""
        return as_numpy(self.status) == Status.OK

    def explain(self) -> str:
        """Return details of the failure of a single sample; "" if there are none. Trajectories and
        equilibria compute them here."""
        return ""

    def report(self) -> str:
        """Return the status with its message and details; for a batch, the number of samples of
        each status; "traced" inside jit or vmap."""
        return self.message(type(self).explain)

    @property
    def failure(self) -> str:
        """The report of a result that failed, for a note below its table; "" if it is ok
        or traced."""
        return self.report() if is_concrete(self.status) and np.any(self.status) else ""

    def message(self, details: Callable[[Any], str]) -> str:
        """Return the text of `report`, with the details from `details` in place of `explain`."""
        if not is_concrete(self.status):
            return "traced"
        codes = np.asarray(self.status)
        if codes.ndim == 0:
            if not codes:
                return "ok"
            message = MESSAGES[Status(int(codes))]
            plain = without_derivatives(self)
            more = details(plain) if is_concrete(plain) else ""
            return f"{Status(int(codes)).name}: {message}" + (f"; {more}" if more else "")
        values, counts = np.unique(codes, return_counts=True)
        return ", ".join(
            f"{count} {Status(int(value)).name}"
            for value, count in zip(values, counts, strict=True)
        )

    def to_pandas(self) -> Any:
        """Return the first of the printed tables as a pandas.DataFrame; `attrs["units"]` {column:
        unit}. Error: MISSING_EXTRA."""
        table = tables.in_numpy(self)._tables()[0]
        return frame_of_table(table.columns, table.rows)

    def to_xarray(self) -> Any:
        """Return the same table as an xarray.Dataset over its rows, with units in the attributes of
        its variables. Error: MISSING_EXTRA."""
        import_extra("xarray", "to_xarray")
        frame = self.to_pandas()
        data = frame.to_xarray()
        for name, unit in frame.attrs["units"].items():
            data[name].attrs |= {"units": unit} if unit else {}
        return data

    def raise_if_failed(self) -> None:
        """Raise a JaxbodyError unless every sample is ok; for a batch it lists the indices that are
        not. Error inside jit or vmap: TRACED."""
        where = type(self).__name__.lower()
        if not is_concrete(self.status):
            raise JaxbodyError(
                Problem(
                    "TRACED",
                    where,
                    "has no status yet inside jit or vmap",
                    hint="Call raise_if_failed() on what the compiled or batched function returns.",
                )
            )
        codes = np.asarray(self.status)
        if not codes.any():
            return
        first = Status(int(codes.flat[np.flatnonzero(codes)[0]]))
        message = self.report()
        if codes.ndim:
            message += f"; failed samples {np.argwhere(codes)[:MOST_PROBLEMS].squeeze(-1).tolist()}"
        raise JaxbodyError(Problem(first.name, where, message, value=self.status))


class OfOutputs(Labeled, Result):
    """The base class of results with values for each of the `outputs`, in its unit.
    `response["seat"]` is the part for the output "seat" of the attribute whose name is `main`."""

    main: ClassVar[str]
    word: ClassVar[str] = "response"  # what messages about an unknown output call the result
    outputs: tuple[str, ...] = eqx.field(static=True, kw_only=True)
    units: tuple[str, ...] = eqx.field(static=True, kw_only=True)

    def __getitem__(self, output: str) -> Any:
        check_known(output, self.word, self.outputs)
        return part_of(getattr(self, self.main), (..., self.outputs.index(output)))

    def labeled(self, kind: str, variables: dict[str, Any], coordinates: Any = ()) -> Any:
        """Return a dataset of these variables, with the units of outputs and the status."""
        own = {"unit": (("output",), np.array(self.units), ""), "status": ((), self.status, "")}
        return dataset(variables | own, {"output": list(self.outputs), **dict(coordinates)}, kind)


def without_derivatives(tree: Any) -> Any:
    """Return the tree with values in place of the tracers of jax.grad, jax.jvp and jax.vjp; tracers
    of jit and vmap remain."""
    return jax.tree.map(lambda x: jax.lax.stop_gradient(x) if isinstance(x, Tracer) else x, tree)


def finished(
    result: AnyResult, found: Callable[[Any], Any], parts: Callable[[AnyResult], Any]
) -> AnyResult:
    """Return the result, after a warning if it failed.

    If it is traced there is no warning; the numbers in `parts(result)` are then NaN, with NaN as
    their derivatives, where `found(status)` is False."""
    warn_if_failed(result)
    if is_concrete(result):
        return result
    numbers = jax.tree.leaves(parts(result))
    checked = _nan_unless_found(found, result.status, numbers)
    of_number = dict(zip(map(id, numbers), checked, strict=True))
    return jax.tree.map(lambda x: of_number.get(id(x), x), result)


@partial(jax.jit, static_argnums=0)
def _nan_unless_found(found: Callable[[Any], Any], status: Any, numbers: list[Any]) -> list[Any]:
    valid = found(status)
    return [
        rows_or_nan(valid.reshape(valid.shape + (1,) * (x.ndim - valid.ndim)), x) for x in numbers
    ]


def warn_if_failed(result: AnyResult) -> AnyResult:
    """Return the result, after a warning if it failed and its status is not traced."""
    if is_concrete(result.status) and (codes := np.asarray(result.status)).any():
        warn(
            Status(int(codes.flat[np.flatnonzero(codes)[0]])).name,
            f"{type(result).__name__}: {result.report()}",
        )
    return result
