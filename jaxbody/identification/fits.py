"""Result of a fit: estimates, standard errors, unidentified parameters, residuals."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbody.core import tables
from jaxbody.core.datasets import dataset
from jaxbody.core.errors import JaxbodyError, Problem, Status, is_concrete
from jaxbody.core.results import Result
from jaxbody.experiments.measurements import Measurement
from jaxbody.identification.fit_parameters import parts_of
from jaxbody.identification.intervals import FEW, Interval, freedoms_of, intervals_of, widening
from jaxbody.identification.residuals import Task
from jaxbody.models.models import Model
from jaxbody.parameters.field_units import units_of
from jaxbody.parameters.transforms import Direction, Rotation
from jaxbody.statistics.quantiles import check_level
from jaxbody.statistics.uncertainties import Uncertainty

LEVEL = 0.95  # of the intervals that print
STILL = 1e-9  # slope of a number, relative to the largest of its leaf, that is none


class Fit(Result):
    """A fit: `model` and `experiments` with the estimates in them, `estimates` and `standard_errors` by path (infinite where the data cannot tell), `intervals(level)` with `degrees_of_freedom` by path,
    `covariance` of u, `singular_values` of the Jacobian with relative columns, `unidentified` in words, `predicted` {run: {sensor: array}},
    `noise` {run: {sensor: rms residual}} (of a pose two, in meters and radians), `correlation` (lag one) of the residuals, `cost` 1/2 r'r,
    `history` of costs, `rounds`, where in it the noise was estimated anew, `failed` trials that could not be simulated, `at_bound` in words,
    `limits` of u, `remarks` on what would help it. `status` NOT_CONVERGED, NOT_IDENTIFIABLE, NEVER_MOVED
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
    rounds: tuple[int, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def paths(self) -> tuple[str, ...]:
        return tuple(f.path for f in self.task.free)

    @property
    def estimates(self) -> dict[str, Array]:
        """{path: value}."""
        arrays = {run: jax.tree.leaves(tree) for run, tree in {"": self.model, **self.experiments}.items()}
        return {f.path: leaf.read(arrays[run]) for f in self.task.free for run, leaf in f.places[:1]}

    def _assessed(self) -> Uncertainty:
        if self.uncertainty is None:
            raise JaxbodyError(Problem("TRACED", "fit", "has no standard errors inside jit or vmap", hint="Fit outside of it for them."))
        return self.uncertainty

    @property
    def standard_errors(self) -> dict[str, np.ndarray]:
        """{path: standard error}, infinite where the data cannot tell."""
        found = self._assessed().standard_errors
        return {path: np.where(lost, np.inf, found[path]) for path, lost in self._lost().items()}

    def _lost(self) -> dict[str, np.ndarray]:
        """Which numbers of a direction or an orientation move only to second order, in what the data cannot tell: a tilted axis z has
        a first derivative of zero along z."""
        u = self._assessed()
        error, _ = u.spread(np.eye(self.u.size))
        found = {}
        for f, slopes, mine in zip(self.task.free, u.slopes, parts_of(self.task.free), strict=True):
            found[f.path] = np.zeros(f.form.start.shape, bool)
            if isinstance(f.form, Direction | Rotation) and not np.isfinite(error[mine]).all():
                size = np.linalg.norm(slopes[..., mine], axis=-1)
                found[f.path] = size <= STILL * size.max()
        return found

    def intervals(self, level: float = 0.95) -> dict[str, Interval]:
        """{path: (lower, upper)}, confidence intervals of this level: of what is positive by its logarithm, at a bound with one side. Error: BAD_LEVEL."""
        check_level(level, "fit.intervals.level")
        found = intervals_of(self.task.free, np.asarray(self.u), self.estimates, self._assessed(), level)
        lost = self._lost()
        return {path: (np.where(lost[path], -np.inf, low), np.where(lost[path], np.inf, high)) for path, (low, high) in found.items()}

    @property
    def degrees_of_freedom(self) -> dict[str, np.ndarray]:
        """{path: degrees of freedom} of Student's t in its interval: few where samples are few, or noise is correlated for long."""
        return freedoms_of(self.task.free, self._assessed())

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
        return "; ".join([*filter(None, [self._how_it_ended()]), *self.remarks])

    def _how_it_ended(self) -> str:
        status = Status(int(self.status))
        if status in (Status.NOT_IDENTIFIABLE, Status.NEVER_MOVED):
            u = self._assessed()
            return f"rank {u.rank} of {len(u.singular_values)}: " + "; ".join(u.words)
        if status == Status.AT_BOUND:
            given = any(label.endswith(("(lower)", "(upper)")) for label in self.at_bound)
            return ", ".join(self.at_bound) + ("; its interval has one side, the others are estimated with it there" if given else "")
        after = f"after {tables.counted(int(self.evaluations), 'evaluation')}; the best so far is kept"
        if status == Status.INTERRUPTED:
            return f"{after}; go on with fit(..., resume=this)"
        return after if status == Status.NOT_CONVERGED else ""

    def to_xarray(self) -> Any:
        """An xarray.Dataset of estimates and standard errors by path."""
        names, estimates, errors, intervals = [], [], [], self.intervals(0.95)
        ends = [np.concatenate([np.ravel(interval[side]) for interval in intervals.values()]) for side in (0, 1)]
        for path, value in self.estimates.items():
            value = np.asarray(value)
            names += [path] if value.ndim == 0 else [path + str(list(i)).replace(" ", "") for i in np.ndindex(value.shape)]
            estimates += value.ravel().tolist()
            errors += np.asarray(self.standard_errors[path]).ravel().tolist()
        variables: dict[str, tuple[tuple[str, ...], Any, str]] = {
            "estimate": (("parameter",), estimates, ""),
            "standard_error": (("parameter",), errors, ""),
            "lower": (("parameter",), ends[0], ""),
            "upper": (("parameter",), ends[1], ""),
            "singular_value": (("direction",), self.singular_values, ""),
            "status": ((), self.status, ""),
        }
        coordinates: dict[str, Any] = {"parameter": names}
        for run, sensors in self.predicted.items():
            experiment = self.experiments[run]
            for name, values in sensors.items():
                over, where, unit = experiment.axis(name)
                row = f"{run}_{over}"
                coordinates[row] = (row, np.asarray(where), {"units": unit})
                dimensions, unit = (row, *(f"{run}_{name}_component",) * (np.ndim(values) - 1)), experiment.channels[name].unit
                variables[f"{run}_{name}_predicted"] = (dimensions, values, unit)
                variables[f"{run}_{name}_measured"] = (dimensions, experiment.measured[name], unit)
        return dataset(variables, coordinates, "fit")

    def _tables(self) -> list[tables.PrintedTable]:
        if self.uncertainty is None or not is_concrete(self.u):
            return [tables.PrintedTable("Fit", ("", ""), [(path, value) for path, value in self.estimates.items()])]
        rows, few = [], []
        ends, errors, freedoms = self.intervals(LEVEL), self.standard_errors, self.degrees_of_freedom
        for f, (path, value) in zip(self.task.free, self.estimates.items(), strict=True):
            value = np.asarray(value)
            units = units_of(f.places[0][1], f.places[0][0], self.model, value)
            columns = (np.asarray(x).ravel() for x in (value, errors[path], freedoms[path], *ends[path]))
            for label, unit, x, e, freedom, low, high in zip(_labels(f.name, value), units, *columns, strict=True):
                bounded = bool(np.isfinite(high - low))
                few.append(float(freedom) if bounded else np.inf)
                ended = f"{label} (zero)" in self.at_bound or (not np.isfinite(e) and bounded)
                known = "at its bound" if ended else float(e) if bounded else "not determined"
                relative = tables.percent(e / abs(x)) if x else ""
                rows.append((label, float(x), unit, known, relative, f"{low:.6g} to {high:.6g}" if bounded else ""))
        fits = [row for run, sensors in self.noise.items() for name, levels in sensors.items() for row in self._met(run, name, levels)]
        u = self.uncertainty
        counts = tables.counted(u.samples, "sample"), tables.counted(int(self.evaluations), "evaluation")
        notes = [f"{', '.join(counts)}, {u.noise}; {self.report()}"]
        notes += u.about_noise() + (list(self.remarks) if self.ok else [])
        heads = ("parameter", "estimate", "unit", "standard error", "relative", f"{100 * LEVEL:g} % interval")
        if told := widening(few, LEVEL):
            notes.append(told)
            heads = (*heads, "degrees of freedom")
            rows = [(*row, f"{freedom:.3g}" if freedom < FEW else "") for row, freedom in zip(rows, few, strict=True)]
        if status_words := ([] if int(self.status) in (Status.NOT_IDENTIFIABLE, Status.NEVER_MOVED) else u.words):
            notes += status_words
        return [
            tables.PrintedTable("Fit", heads, rows),
            tables.PrintedTable("", ("sensor", "rms residual", "unit"), fits, "\n".join(notes)),
        ]

    def _met(self, run: str, name: str, levels: Array) -> list[tuple[str, float, str]]:
        """How a sensor was met, in each of its units."""
        channel = self.experiments[run].channels[name]
        parts = [f" {part}" for part in channel.parts] or [""] * channel.units
        return [
            (f"{run}.{name}{part}", float(rms), unit.strip())
            for rms, unit, part in zip(np.ravel(levels), channel.unit.split(","), parts, strict=True)
        ]


def _labels(path: str, value: np.ndarray) -> list[str]:
    return [path] if value.ndim == 0 else [path + str(list(i)).replace(" ", "") for i in np.ndindex(value.shape)]
