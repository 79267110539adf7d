"""Result of a fit: estimates, standard errors, confidence intervals, unidentified parameters,
residuals. Intervals follow from Student's t for the transformed parameter u, mapped to values of
the parameter so that these stay physically possible.

    value(u - t s) to value(u + t s),    s the standard error of u, t the quantile for the degrees
                                         of freedom of s

At a bound the interval has one side and follows from the likelihood. It ends at the distance d of u
from the bound over which the cost increases as much as over t standard errors at an optimum:

    2 g d + h d^2 = t^2 h s^2

with slope g and curvature h of the cost at the bound when the other parameters are adjusted.
"""

from typing import Any

import jax
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, Int, indices, is_concrete
from jaxbody.core.errors import JaxbodyError, Problem, Status
from jaxbody.core.results import Labeled, Result, dataset
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.fitting.parameters.spaces import Space, arrays_of
from jaxbody.fitting.parameters.transforms import Direction, Elementwise, Rotated
from jaxbody.fitting.residuals import Task
from jaxbody.fitting.statistics.uncertainties import ZERO, Uncertainty, check_level, quantile
from jaxbody.model.models import Model
from jaxbody.suspension.suspensions import Suspension

Interval = tuple[np.ndarray, np.ndarray]
FEW = 13  # degrees of freedom below which Student's t widens 95 % intervals by more than a tenth


def interval_of_u(u: np.ndarray, uncertainty: Uncertainty, level: float) -> Interval:
    """Return (lower, upper) of each u, infinite where the data do not determine it."""
    error, freedom = uncertainty.spread(np.eye(len(u)))
    half_width = quantile(level, freedom) * error
    low, high = u - half_width, u + half_width
    for i, (slope, curvature, error, freedom) in uncertainty.at_bounds.items():
        t = float(quantile(level, freedom, sides=1))
        distance = (
            t**2
            * error**2
            * curvature
            / (abs(slope) + np.sqrt(slope**2 + (t * error * curvature) ** 2))
        )
        low[i], high[i] = (u[i], u[i] + distance) if slope > 0 else (u[i] - distance, u[i])
    return low, high


def intervals_of(
    space: Space, u: np.ndarray, values: dict[str, Any], uncertainty: Uncertainty, level: float
) -> dict[str, Interval]:
    """Return {path: (lower, upper)}, arrays of the shape of the leaf. Intervals of the elements of
    a matrix or a direction are computed from their own standard errors."""
    low, high = interval_of_u(u, uncertainty, level)
    intervals = {}
    for (parameter, own), G in zip(space.parts, uncertainty.slopes, strict=True):
        if isinstance(parameter.form, Elementwise):
            with np.errstate(over="ignore"):
                intervals[parameter.path] = tuple(
                    np.asarray(parameter.form.value(end[own])) for end in (low, high)
                )
        else:
            error, freedom = uncertainty.spread(G.reshape(-1, len(u)))
            value, half_width = (
                np.asarray(values[parameter.path]),
                (quantile(level, freedom) * error).reshape(G.shape[:-1]),
            )
            intervals[parameter.path] = (value - half_width, value + half_width)
    return intervals


def widening(freedom: Any, level: float) -> str:
    """Return a note by how much few degrees of freedom widen the intervals, "" if there are
    many."""
    least = np.min(freedom, initial=np.inf)
    if not least < FEW:
        return ""
    times, degrees = (
        quantile(level, least) / quantile(level, np.inf),
        "degree" if f"{least:.3g}" == "1" else "degrees",
    )
    return (
        f"intervals use Student's t with {least:.3g} {degrees} of freedom, which makes them "
        f"{times:.2g} times wider, because the noise is estimated from few independent samples"
    )


LEVEL = 0.95  # confidence level of the printed intervals
FLAT = 1e-9  # derivative of a number, relative to the largest in its leaf, that counts as zero


class Fit(Labeled, Result):
    """Result of a fit: estimates, their uncertainty, residuals.

    `model` and `experiments` are those given, with the estimates in them; so is `suspension` if one
    was fitted. Dictionaries by path, in SI units: `estimates`, `standard_errors` (infinite where
    the data do not determine a parameter), `intervals(level)` and their `degrees_of_freedom`.
    `unidentified` lists combinations of parameters that the data do not determine, `at_bound` the
    parameters at a bound. `u` are the transformed parameters, zero at the initial guess;
    `covariance`, `correlations`, `information` and `limits` (bounds) refer to u, `singular_values`
    to the Jacobian with scaled columns. `predicted`: {run: {sensor: array}}; `noise`:
    {run: {sensor: rms residual}}, for a pose two numbers, in meters and radians; `correlation`:
    lag-one correlation of the residuals; `cost`: 1/2 r'r; `history`: cost of every evaluation;
    `rounds`: evaluations after which the noise was estimated again; `failed`: number of trials that
    could not be simulated; `remarks`: suggested remedies.

    `status`: OK, FAR_OFF, NOT_CONVERGED, NOT_IDENTIFIABLE, NEVER_MOVED, AT_BOUND, NOISY_INPUT or
    INTERRUPTED. A batch keeps its leading axes; a fit inside jit or vmap has no standard errors.

    >>> import inspect
    >>> inspect.signature(jb.fit).return_annotation.__name__  # the result of fit
    'Fit'
    """

    index = "parameter"
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
    rounds: tuple[int, ...] = ()
    remarks: tuple[str, ...] = ()
    suspension: Suspension | None = None

    @property
    def paths(self) -> tuple[str, ...]:
        return tuple(parameter.path for parameter in self.task.space.parameters)

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        return self.task.space.bounds

    @property
    def estimates(self) -> dict[str, Array]:
        """Estimated values {path: value}, in SI units."""
        arrays = {"": arrays_of(self.model, self.suspension)} | {
            run: jax.tree.leaves(tree) for run, tree in self.experiments.items()
        }
        return {
            leaf.path: leaf.read(arrays[run])
            for parameter in self.task.space.parameters
            for run, leaf in parameter.places[:1]
        }

    def _assessed(self) -> Uncertainty:
        if self.uncertainty is None:
            raise JaxbodyError(
                Problem(
                    "TRACED",
                    "fit",
                    "has no standard errors inside jit or vmap",
                    hint="Fit outside of jit and vmap to get them.",
                )
            )
        return self.uncertainty

    @property
    def standard_errors(self) -> dict[str, np.ndarray]:
        """Standard errors {path: array}, infinite where the data do not determine a parameter."""
        errors = self._assessed().standard_errors
        return {
            path: np.where(unknown, np.inf, errors[path])
            for path, unknown in self._unknown_to_second_order().items()
        }

    def _unknown_to_second_order(self) -> dict[str, np.ndarray]:
        """Return {path: True for numbers without a standard error to first order}: numbers of an
        undetermined direction or orientation whose first derivatives are zero, such as the z
        component of an axis along z."""
        u = self._assessed()
        error, _ = u.spread(np.eye(self.u.size))
        unknown = {}
        for (parameter, own), slopes in zip(self.task.space.parts, u.slopes, strict=True):
            unknown[parameter.path] = np.zeros(parameter.form.start.shape, bool)
            if (
                isinstance(parameter.form, Direction | Rotated)
                and not np.isfinite(error[own]).all()
            ):
                size = np.linalg.norm(slopes[..., own], axis=-1)
                unknown[parameter.path] = size <= FLAT * size.max()
        return unknown

    def intervals(self, level: float = 0.95) -> dict[str, Interval]:
        """Return confidence intervals {path: (lower, upper)}, from logarithms for positive
        parameters, one-sided at a bound. Error: BAD_LEVEL."""
        check_level(level, "fit.intervals.level")
        intervals = intervals_of(
            self.task.space, np.asarray(self.u), self.estimates, self._assessed(), level
        )
        unknown = self._unknown_to_second_order()
        return {
            path: (np.where(unknown[path], -np.inf, low), np.where(unknown[path], np.inf, high))
            for path, (low, high) in intervals.items()
        }

    @property
    def degrees_of_freedom(self) -> dict[str, np.ndarray]:
        """Degrees of freedom {path: array} of Student's t in the intervals: few for few samples or
        for noise that is correlated over many samples."""
        uncertainty, freedoms = self._assessed(), {}
        for (parameter, own), G in zip(self.task.space.parts, uncertainty.slopes, strict=True):
            _, freedom = uncertainty.spread(G.reshape(-1, G.shape[-1]))
            if isinstance(parameter.form, Elementwise):
                freedom = np.array(
                    [
                        uncertainty.at_bounds[i][3] if i in uncertainty.at_bounds else x
                        for i, x in enumerate(freedom, own.start)
                    ]
                )
            freedoms[parameter.path] = freedom.reshape(G.shape[:-1])
        return freedoms

    @property
    def covariance(self) -> np.ndarray:
        return self._assessed().covariance

    @property
    def correlations(self) -> np.ndarray:
        """Correlations (n, n) of the estimates; zero with what is not determined."""
        size = np.sqrt(np.diag(self.covariance))
        size = np.where(size > 0, size, 1.0)
        return self.covariance / np.outer(size, size)

    @property
    def information(self) -> np.ndarray:
        """The inverse of the covariance of the u of the model, zero along what is not determined or
        at a bound; parameters of single runs n are eliminated: M_mm - M_mn M_nn^-1 M_nm."""
        M = np.linalg.pinv(self.covariance, ZERO, hermitian=True)
        _, m = self.task.space.of_model({})
        rest = np.linalg.pinv(M[np.ix_(~m, ~m)], ZERO, hermitian=True)
        return M[np.ix_(m, m)] - M[np.ix_(m, ~m)] @ rest @ M[np.ix_(~m, m)]

    @property
    def singular_values(self) -> np.ndarray:
        return self._assessed().singular_values

    @property
    def unidentified(self) -> list[str]:
        """Combinations of parameters whose change does not change the readings: "AB.stiffness up
        with CD.stiffness down"."""
        return self._assessed().words

    @property
    def correlation(self) -> float:
        return self._assessed().correlation

    def explain(self) -> str:
        return "; ".join([*filter(None, [self._status_details()]), *self.remarks])

    def _status_details(self) -> str:
        status = Status(int(self.status))
        if status in (Status.NOT_IDENTIFIABLE, Status.NEVER_MOVED):
            u = self._assessed()
            return f"rank {u.rank} of {len(u.singular_values)}: " + "; ".join(u.words)
        if status == Status.FAR_OFF and self.at_bound:
            return f"it ends with {', '.join(self.at_bound)}"
        if status == Status.AT_BOUND:
            details = ", ".join(self.at_bound)
            if any(label.endswith(("(lower)", "(upper)")) for label in self.at_bound):
                details += (
                    "; its interval is one-sided, the other parameters are "
                    "estimated with it fixed there"
                )
            return details
        after = (
            f"after {tables.counted(int(self.evaluations), 'evaluation')}; the best so far is kept"
        )
        if status == Status.INTERRUPTED:
            return f"{after}; continue with fit(..., resume=this)"
        return after if status == Status.NOT_CONVERGED else ""

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset of estimates and standard errors by path, with predictions and
        measured values."""
        estimates, intervals = self.estimates, self.intervals(LEVEL).values()
        columns = {
            "estimate": estimates.values(),
            "standard_error": self.standard_errors.values(),
            "lower": [low for low, _ in intervals],
            "upper": [high for _, high in intervals],
        }
        variables: dict[str, tuple[tuple[str, ...], Any, str]] = {
            name: (("parameter",), np.concatenate([*map(np.ravel, arrays)]), "")
            for name, arrays in columns.items()
        }
        variables |= {
            "singular_value": (("direction",), self.singular_values, ""),
            "status": ((), self.status, ""),
        }
        coordinates: dict[str, Any] = {
            "parameter": [
                path + index
                for path, value in estimates.items()
                for index in indices(np.shape(value))
            ]
        }
        for run, sensors in self.predicted.items():
            experiment = self.experiments[run]
            for name, values in sensors.items():
                over, where, unit = experiment.axis(name)
                row = f"{run}_{over}"
                coordinates[row] = (row, np.asarray(where), {"units": unit})
                dimensions = (row, *(f"{run}_{name}_component",) * (np.ndim(values) - 1))
                unit = experiment.channels[name].unit
                variables[f"{run}_{name}_predicted"] = (dimensions, values, unit)
                variables[f"{run}_{name}_measured"] = (dimensions, experiment.measured[name], unit)
        return dataset(variables, coordinates, "fit")

    def _tables(self) -> list[tables.PrintedTable]:
        if self.uncertainty is None or not is_concrete(self.u):
            return [
                tables.PrintedTable(
                    "Fit", ("", ""), [(path, value) for path, value in self.estimates.items()]
                )
            ]
        rows, printed_freedoms = [], []
        ends, errors, freedoms = (
            self.intervals(LEVEL),
            self.standard_errors,
            self.degrees_of_freedom,
        )
        for parameter, (path, value) in zip(
            self.task.space.parameters, self.estimates.items(), strict=True
        ):
            value, units = np.asarray(value), self.task.space.units(parameter)
            columns = (
                np.asarray(x).ravel() for x in (value, errors[path], freedoms[path], *ends[path])
            )
            for index, unit, x, e, freedom, low, high in zip(
                indices(value.shape), units, *columns, strict=True
            ):
                label = parameter.name() + index
                bounded = bool(np.isfinite(high - low))
                printed_freedoms.append(float(freedom) if bounded else np.inf)
                ended = f"{label} (zero)" in self.at_bound or (not np.isfinite(e) and bounded)
                error = "at its bound" if ended else float(e) if bounded else "not determined"
                relative = tables.percent(e / abs(x)) if x else ""
                rows.append(
                    (
                        label,
                        float(x),
                        unit,
                        error,
                        relative,
                        f"{low:.6g} to {high:.6g}" if bounded else "",
                    )
                )
        residuals = [
            row
            for run, sensors in self.noise.items()
            for name, levels in sensors.items()
            for row in self._rms_rows(run, name, levels)
        ]
        u = self.uncertainty
        notes = [
            f"{tables.counted(u.samples, 'sample')}, "
            f"{tables.counted(int(self.evaluations), 'evaluation')}, {u.noise}; {self.report()}",
            *u.about_noise(),
            *(self.remarks if self.ok else ()),
        ]
        heads = (
            "parameter",
            "estimate",
            "unit",
            "standard error",
            "relative",
            f"{100 * LEVEL:g} % interval",
        )
        if note := widening(printed_freedoms, LEVEL):
            notes.append(note)
            heads = (*heads, "degrees of freedom")
            rows = [
                (*row, f"{freedom:.3g}" if freedom < FEW else "")
                for row, freedom in zip(rows, printed_freedoms, strict=True)
            ]
        if int(self.status) not in (Status.NOT_IDENTIFIABLE, Status.NEVER_MOVED):
            notes += u.words
        return [
            tables.PrintedTable("Fit", heads, rows, digits=6),  # errors may be small
            tables.PrintedTable(
                "", ("sensor", "rms residual", "unit"), residuals, "\n".join(notes)
            ),
        ]

    def _rms_rows(self, run: str, name: str, levels: Array) -> list[tuple[str, float, str]]:
        """Return table rows with the rms residuals of a sensor, one for each of its units."""
        channel = self.experiments[run].channels[name]
        parts = [f" {part}" for part in channel.parts] or [""] * channel.units
        return [
            (f"{run}.{name}{part}", float(rms), unit.strip())
            for rms, unit, part in zip(
                np.ravel(levels), channel.unit.split(","), parts, strict=True
            )
        ]
