"""What every result shares: a status in words, and printing as small tables."""

from typing import Any

import equinox as eqx
import numpy as np

from jaxbody import tables
from jaxbody.errors import MESSAGES, MOST_PROBLEMS, JaxbodyError, Problem, Status, is_concrete, warn


class Result(eqx.Module):
    """`.status` (one code per sample), `.ok`, `.report()`, `.raise_if_failed()`, and printing as tables."""

    status: eqx.AbstractVar[Any]

    @property
    def ok(self) -> Any:
        """True where the status is 0 (an array for batched results)."""
        return self.status == Status.OK

    def explain(self) -> str:
        """More about a failure of a single sample, in words; empty where there is nothing to add."""
        return ""

    def report(self) -> str:
        """The status in words; for a batch, how many samples ended how."""
        codes = np.asarray(self.status)
        if codes.ndim == 0:
            if not codes:
                return "ok"
            message = MESSAGES[Status(int(codes))]
            more = self.explain()
            return f"{Status(int(codes)).name}: {message}" + (f"; {more}" if more else "")
        values, counts = np.unique(codes, return_counts=True)
        return ", ".join(f"{count} {Status(int(value)).name}" for value, count in zip(values, counts, strict=True))

    def _tables(self) -> list[tables.Table]:
        """What prints."""
        raise TypeError  # pragma: no cover

    def __repr__(self) -> str:
        return tables.text(*self._tables())

    def __str__(self) -> str:
        return tables.text(*self._tables())

    def _repr_html_(self) -> str:
        return tables.html(*self._tables())

    def raise_if_failed(self) -> None:
        """Raise a JaxbodyError unless every sample is ok; a batch lists the indices that are not."""
        codes = np.asarray(self.status)
        if not codes.any():
            return
        where = type(self).__name__.lower()
        worst = Status(int(codes.flat[np.flatnonzero(codes)[0]]))
        message = self.report()
        if codes.ndim:
            message += f"; failed samples {np.argwhere(codes)[:MOST_PROBLEMS].squeeze(-1).tolist()}"
        raise JaxbodyError(Problem(worst.name, where, message, value=self.status))


def warn_if_failed(result: Result) -> None:
    """The last act of a public function: tell, where values can be looked at, that something failed."""
    if is_concrete(result.status) and (codes := np.asarray(result.status)).any():
        warn(Status(int(codes.flat[np.flatnonzero(codes)[0]])).name, f"{type(result).__name__}: {result.report()}")
