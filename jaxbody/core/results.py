"""The base classes of results: a status with its message, and tables that are printed."""

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import as_numpy, is_concrete, part_of, rows_or_nan
from jaxbody.core.datasets import Labeled, dataset, frame_of_table
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
