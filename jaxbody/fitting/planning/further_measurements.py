"""Which further measurement would help a fit most: one more sensor in each of its runs, or the
response of each body to a force or a moment.

    M + M_i,    M the information of the fit, M_i that of the measurement with noise of 1 %
"""

import warnings
from contextlib import suppress
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import positive_number, whole_number
from jaxbody.core.arrays import Float, device_array
from jaxbody.core.errors import JaxbodyError, JaxbodyWarning, Problems, Status
from jaxbody.core.results import Result
from jaxbody.fitting.experiments.experiments import Experiment
from jaxbody.fitting.experiments.measured_responses import MeasuredResponse
from jaxbody.fitting.experiments.measurements import records_of, small_motions
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.planning.expected_fits import planned
from jaxbody.fitting.residuals import residual_and_jacobian
from jaxbody.fitting.statistics.uncertainties import (
    LESS,
    errors_of,
    information_of,
    unknown_and_largest,
)
from jaxbody.geometry.points_and_orientations import DIRECTIONS
from jaxbody.model.inputs.port_inputs import PointForce
from jaxbody.model.storage import with_attributes
from jaxbody.sensors.kinematic_sensors import Position, Rotation
from jaxbody.vibration.natural_modes import modes

RESPONSES = "responses"
ALONG = {d: f"about {d[1]}" if d[0] == "r" else f"along {d}" for d in DIRECTIONS}
LINES = 30  # frequencies of a response, from half of the lowest natural frequency on


class FurtherMeasurements(Result):
    """Result of `further_measurements`, the most helpful first.

    `measurements`: their names; `after` (N, p): standard errors of u with each of them, of the
    `parameters`; `before` (p,): without. u is the logarithm of a positive parameter, so that its
    errors are relative; infinite where nothing determines it.

    >>> import inspect
    >>> inspect.signature(jb.fitting.further_measurements).return_annotation.__name__
    'FurtherMeasurements'
    """

    measurements: tuple[str, ...] = eqx.field(static=True)
    parameters: tuple[str, ...] = eqx.field(static=True)
    share: float
    before: Float[np.ndarray, "p"]
    after: Float[np.ndarray, "N p"]
    status: np.ndarray

    def _tables(self) -> list[tables.PrintedTable]:
        def row(name: str, errors: np.ndarray) -> tuple[str, ...]:
            open_ones = ", ".join(
                p for p, e in zip(self.parameters, errors, strict=True) if np.isinf(e)
            )
            worst = int(np.argmax(np.where(np.isfinite(errors), errors, -1.0)))
            known = np.isfinite(errors[worst])
            largest = f"{errors[worst]:.3g}, {self.parameters[worst]}" if known else ""
            return name, largest, open_ones or "none"

        return [
            tables.PrintedTable(
                "Further measurements",
                ("measurement", "largest relative standard error", "not determined"),
                [
                    row("none", self.before),
                    *map(row, self.measurements, self.after),
                ],
                f"each with noise of {tables.percent(self.share)} of its rms",
            )
        ]


def further_measurements(fit: Fit, *, share: float = 0.01, most: int = 5) -> FurtherMeasurements:
    """Return which one further measurement would help most: a sensor more in a run of the fit, a
    position or a rotation of a body along an axis; or the response of a body to a force or moment
    on it, at frequencies around the natural ones.

    Args:
        fit: the result of `fit` or of `expected_fit`.
        share: noise of each measurement, relative to its rms.
        most: the number of measurements that are returned.

    First is what leaves the fewest parameters undetermined, then what leaves the smallest largest
    standard error. `choose` compares other measurements, of a number of your own.

    Errors: BAD_NUMBER, TRACED.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> test = jb.MeasuredModes(number=[0], noise={"frequency": 0.01})
    >>> fit = jb.expected_fit(car, {"test": test}, free=["body.mass", "suspension.stiffness"])
    >>> further = jb.fitting.further_measurements(fit, most=1)
    >>> bool(np.isinf(fit.standard_errors["body.mass"])), bool(np.isfinite(further.after).all())
    (True, True)
    """
    with Problems() as problems:
        positive_number(share, "further_measurements.share", problems)
        most = whole_number(most, "further_measurements.most", problems)
    known, (space, own) = fit.information, fit.task.space.of_model(_plans(fit))
    u = jnp.asarray(np.asarray(fit.u)[own])
    task = planned(space, u, fit.task.integration)
    J = np.asarray(residual_and_jacobian(task, u)[1])
    each: dict[str, np.ndarray] = {}
    for record in records_of(task.space.runs):  # a channel may have several, as the real part
        channel, run = record.channel, record.run
        y = np.asarray(task.space.runs[run].measured[channel])
        rms = np.sqrt(np.mean(np.abs(y if np.iscomplexobj(y) else y - y.mean()) ** 2))
        name = channel.replace("/", " by a ") if run == RESPONSES else f"{channel} in {run}"
        each[name] = each.get(name, 0) + information_of(J[record.rows], share * rms)
    total = known + sum(each.values())
    after = {name: errors_of(known + m, total) for name, m in each.items()}
    before = errors_of(known, total)
    helpful = [name for name, errors in after.items() if (errors < LESS * before).any()]
    order = sorted(helpful, key=lambda name: unknown_and_largest(after[name]))[:most]
    return FurtherMeasurements(
        measurements=tuple(order),
        parameters=tuple(space.names),
        share=share,
        before=before,
        after=np.reshape([after[name] for name in order], (len(order), len(before))),
        status=np.asarray(Status.OK),
    )


def _plans(fit: Fit) -> dict[str, Any]:
    """Return the runs of a fit with every sensor of a position or a rotation, and the response of
    each body to each force and moment on it, with noise of one."""
    one, model = device_array(1.0), fit.model
    places = [(body, d) for body in model.layout.bodies for d in DIRECTIONS]
    sensors = {
        f"{'rotation' if d[0] == 'r' else 'position'} of {body} {ALONG[d]}": (
            Rotation(body, axis=d[1]) if d[0] == "r" else Position(body, axis=d)
        )
        for body, d in places
    }
    changed = {"sensors": sensors, "noise": dict.fromkeys(sensors, one)}
    plans: dict[str, Any] = {
        name: with_attributes(run, changed)
        for name, run in fit.experiments.items()
        if isinstance(run, Experiment)
    }
    f = np.zeros(0)
    with warnings.catch_warnings(), suppress(JaxbodyError):  # without modes there are no responses
        warnings.simplefilter("ignore", JaxbodyWarning)
        f = np.asarray(modes(small_motions(model)).frequency)
    f = f[np.isfinite(f) & (f > 0)]
    if f.size:
        inputs = {
            f"{'moment' if d[0] == 'r' else 'force'} on {body} {ALONG[d]}": PointForce(
                body, direction=d
            )
            for body, d in places
        }
        plans[RESPONSES] = MeasuredResponse(
            np.geomspace(f.min() / 2, 2 * f.max(), LINES),
            inputs=inputs,
            outputs=sensors,
            noise=dict.fromkeys(zip(sensors, inputs, strict=True), 1.0),
        )
    return plans
