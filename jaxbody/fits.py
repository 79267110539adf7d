"""A fit, as it is told: estimates, their standard errors, what could not be told, how the measurements were met."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbody import tables
from jaxbody.channels import Measurement
from jaxbody.errors import JaxbodyError, Problem, Status, is_concrete
from jaxbody.intervals import Interval, check_level, intervals_of
from jaxbody.models import Model
from jaxbody.results import Result
from jaxbody.tasks import Task
from jaxbody.uncertainties import Uncertainty

LEVEL = 0.95  # of the intervals that print


class Fit(Result):
    """A fit: `model` and `experiments` with the estimates in them, `estimates` and `standard_errors` by path (infinite where the data cannot tell), `intervals(level)`,
    `covariance` of u, `singular_values` of the Jacobian with relative columns, `unidentified` in words, `predicted` {run: {sensor: array}},
    `noise` {run: {sensor: rms residual}} (of a pose two, in meters and radians), `correlation` (lag one) of the residuals, `cost` 1/2 r'r,
    `history` of costs, `failed` trials that could not be simulated, `at_bound` in words,
    `limits` of u. `status` NOT_CONVERGED, NOT_IDENTIFIABLE, NEVER_MOVED
    or AT_BOUND where it is not good. Leading axes of a batch stay; standard errors are not there inside jit or vmap.

    >>> import inspect
    >>> inspect.signature(fit).return_annotation  # fit returns one
    'Fit'
    """

    model: Model
    experiments: dict[str, Measurement]
    u: Float[Array, "n"]
    cost: Float[Array, ""]
    status: Int[Array, ""]
    evaluations: int | Int[Array, ""]
    task: Task
    uncertainty: Uncertainty | None
    predicted: dict[str, dict[str, Array]]
    noise: dict[str, dict[str, Array]]
    history: list[float]
    failed: int
    at_bound: list[str]
    limits: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def paths(self) -> tuple[str, ...]:
        return tuple(f.path for f in self.task.free)

    @property
    def estimates(self) -> dict[str, Array]:
        """{path: value}."""
        values = lambda task, u: task.values(u)  # noqa: E731
        for _ in range(self.u.ndim - 1):
            values = eqx.filter_vmap(values)
        return dict(zip(self.paths, values(self.task, self.u), strict=True))

    def _assessed(self) -> Uncertainty:
        if self.uncertainty is None:
            raise JaxbodyError(Problem("TRACED", "fit", "has no standard errors inside jit or vmap", hint="Fit outside of it for them."))
        return self.uncertainty

    @property
    def standard_errors(self) -> dict[str, np.ndarray]:
        """{path: standard error}, infinite where the data cannot tell."""
        return self._assessed().standard_errors

    def intervals(self, level: float = 0.95) -> dict[str, Interval]:
        """{path: (lower, upper)}, confidence intervals of this level: of what is positive by its logarithm, at a bound with one side. Error: BAD_LEVEL."""
        check_level(level, "fit.intervals.level")
        slopes = [np.asarray(G) for G in jax.jacfwd(self.task.values)(self.u)]
        return intervals_of(self.task.free, np.asarray(self.u), slopes, self._assessed(), level)

    @property
    def covariance(self) -> np.ndarray:
        return self._assessed().covariance

    @property
    def singular_values(self) -> np.ndarray:
        return self._assessed().singular_values

    @property
    def unidentified(self) -> list[str]:
        """Directions that leave the readings as they are, in words."""
        return self._assessed().words

    @property
    def correlation(self) -> float:
        return self._assessed().correlation

    def explain(self) -> str:
        status = Status(int(self.status))
        if status in (Status.NOT_IDENTIFIABLE, Status.NEVER_MOVED):
            u = self._assessed()
            return f"rank {u.rank} of {len(u.singular_values)}: " + "; ".join(u.words)
        if status == Status.AT_BOUND:
            return ", ".join(self.at_bound) + "; its interval has one side, the others are estimated with it there"
        if status == Status.INTERRUPTED:
            return f"after {int(self.evaluations)} evaluations; the best so far is kept; go on with fit(..., resume=this)"
        if status == Status.NOT_CONVERGED:
            return f"after {int(self.evaluations)} evaluations; the best so far is kept; start nearer, or give more max_evaluations"
        return ""

    def to_xarray(self) -> Any:
        """An xarray.Dataset of estimates and standard errors by path."""
        from jaxbody.exports import fit_dataset

        return fit_dataset(self)

    def _tables(self) -> list[tables.Table]:
        if self.uncertainty is None or not is_concrete(self.u):
            return [tables.Table("Fit", ("", ""), [(path, value) for path, value in self.estimates.items()])]
        rows, ends = [], self.intervals(LEVEL)
        names = {f.path: f.name for f in self.task.free}
        for path, value in self.estimates.items():
            columns = (np.asarray(x).ravel() for x in (value, self.standard_errors[path], *ends[path]))
            for label, x, e, low, high in zip(_labels(names[path], np.asarray(value)), *columns, strict=True):
                known = "not determined" if not np.isfinite(high - low) else "at its bound" if not np.isfinite(e) else float(e)
                relative = f"{100 * e / abs(x):.2g} %" if np.isfinite(e) and x else ""
                rows.append((label, float(x), known, relative, f"{low:.6g} to {high:.6g}" if np.isfinite(high - low) else ""))
        fits = [
            (f"{run}.{name}", float(rms), unit.strip())
            for run, sensors in self.noise.items()
            for name, levels in sensors.items()
            for rms, unit in zip(np.ravel(levels), self.experiments[run].channels[name].unit.split(","), strict=True)
        ]
        u = self.uncertainty
        notes = [f"{u.samples} samples, {int(self.evaluations)} evaluations, {u.noise}; {self.report()}"]
        notes += u.about_noise()
        if status_words := ([] if int(self.status) in (Status.NOT_IDENTIFIABLE, Status.NEVER_MOVED) else u.words):
            notes += status_words
        return [
            tables.Table("Fit", ("parameter", "estimate", "standard error", "relative", f"{100 * LEVEL:g} % interval"), rows),
            tables.Table("", ("sensor", "rms residual", "unit"), fits, "\n".join(notes)),
        ]


def _labels(path: str, value: np.ndarray) -> list[str]:
    return [path] if value.ndim == 0 else [path + str(list(i)).replace(" ", "") for i in np.ndindex(value.shape)]
