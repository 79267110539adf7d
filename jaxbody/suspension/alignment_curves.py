"""Curves of suspensions: camber, toe, the steering axis, motion ratios, wheel rates and roll center
over travel and steering."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, Int, checked, is_concrete, rows_or_nan
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems, Status, check_known, unknown
from jaxbody.core.results import Labeled, Result, dataset, warn_if_failed, without_derivatives
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.vectors import axial, cross, dot, product, rotate
from jaxbody.mechanics.constraints import RANK, closure_gaps, values_and_slopes
from jaxbody.model.elements.elements import LineElement
from jaxbody.model.inputs.loads import Load, loads_of
from jaxbody.model.joints.frame_tables import each_element
from jaxbody.model.joints.kinematics import Chart, Coordinates
from jaxbody.model.leaf_paths import springs_of
from jaxbody.model.models import Model, scale_of, size_of
from jaxbody.model.preconditions import check_potential, check_precision
from jaxbody.suspension.assemblies import (
    Drive,
    RestingSystem,
    conditions,
    drives_of,
    position,
    positions,
    readings,
    resting_position,
    resting_positions,
    with_value,
)
from jaxbody.suspension.wheels import Wheel

# order of printed curves, by the words with which their names begin
ORDER = (
    "camber",
    "toe",
    "caster",
    "kingpin",
    "trail",
    "scrub",
    "wheel",
    "contact",
    "roll",
    "side",
    "motion",
    "length",
    "wheel force",
    "wheel rate",
)
# unit and factor with which numbers are printed
PRINTED = {"rad": ("deg", 180 / np.pi), "m": ("mm", 1e3), "N/m": ("N/mm", 1e-3)}
# units of the curves that are neither lengths [m] nor motion ratios
UNITS = {
    "camber": "rad",
    "toe": "rad",
    "caster": "rad",
    "kingpin": "rad",
    "side view angle of the contact": "rad",
    "side view angle of the center": "rad",
    "wheel force": "N",
    "wheel rate": "N/m",
}
MOST_COLUMNS = 6  # most curves in a printed table
# largest movement of the wheel while all driven readings are held, relative to the model's size
FREE = 1e-6


class SuspensionCurves(Labeled, Result):
    """Curves of a suspension, in SI units (rad, m, N/m): `curves["camber"]` (n,) over the driven
    readings (prescribed values) `over` {name: (n,)}, and `slopes["travel"]["camber"]`, their
    derivatives with respect to a driven reading. See `suspension_curves`.

    `status` (n,): NOT_CLOSED where the suspension cannot reach the readings, with NaN in all
    curves. `q` (n, nq): the configurations."""

    index = "row"
    over: dict[str, Float[Array, "n"]]
    curves: dict[str, Float[Array, "n"]]
    slopes: dict[str, dict[str, Float[Array, "n"]]]
    q: Float[Array, "n nq"]
    status: Int[Array, "n"]
    model: Model
    drives: tuple[Drive, ...]
    wheel: Wheel

    def __getitem__(self, name: str) -> Float[Array, "n"]:
        check_known(name, "curves[...]", self.curves)
        return self.curves[name]

    def report(self) -> str:
        """Return the number of rows of each status, and the driven readings of the last row that
        the suspension can reach."""
        text = super().report()
        if not is_concrete(self.status) or np.asarray(self.ok).all():
            return text
        last = int(np.argmax(~np.asarray(self.ok))) - 1
        if last < 0:
            return f"{text}; the first row is beyond reach"
        over = without_derivatives(self.over)
        values = ", ".join(
            f"{drive.name} = {float(over[drive.name][last]):.6g} {drive.unit}"
            for drive in self.drives
        )
        return f"{text}; the last values within reach: {values}"

    def unit(self, name: str) -> str:
        """Return the unit of a curve or of a driven reading."""
        return {drive.name: drive.unit for drive in self.drives}.get(name, curve_unit(name))

    def _tables(self) -> list[tables.PrintedTable]:
        driven, shown = [drive.name for drive in self.drives], []
        names = sorted(
            self.curves,
            key=lambda name: max(i for i, start in enumerate(ORDER) if name.startswith(start)),
        )
        for begin in range(0, len(names), MOST_COLUMNS):
            part = [*driven, *names[begin : begin + MOST_COLUMNS]]
            heads, columns = zip(*map(self._column, part), strict=True)
            shown.append(
                tables.PrintedTable(
                    "Suspension" if not shown else "", heads, list(zip(*columns, strict=True))
                )
            )
        if self.failure:
            shown[-1].note = self.failure
        return shown

    def _column(self, name: str) -> tuple[str, list[float]]:
        unit, factor = PRINTED.get(self.unit(name), (self.unit(name), 1.0))
        numbers = factor * np.asarray((self.over | self.curves)[name])
        return f"{name} [{unit}]".replace(" []", ""), tables.without_dust(numbers, 1.0).tolist()

    def to_xarray(self):
        variables = {
            name: (("row",), values, self.unit(name))
            for name, values in (self.over | self.curves).items()
        }
        for drive, slopes in self.slopes.items():
            unit = self.unit(drive)
            variables |= {
                f"{name} by {drive}": (("row",), values, f"{self.unit(name) or '1'}/{unit}")
                for name, values in slopes.items()
            }
        return dataset(variables, {"row": np.arange(len(self.status))}, "suspension curves")


def curve_unit(name: str) -> str:
    """Return the unit of a curve."""
    return UNITS.get(name, "" if name.startswith("motion ratio") else "m")


def suspension_curves(
    model: Model,
    *,
    drive: Mapping[str, Any],
    over: Mapping[str, Any],
    wheel: Wheel,
    equilibrium: bool = False,
    loads: dict[str, Load] | None = None,
) -> SuspensionCurves:
    """Compute curves of a wheel over its travel and steering, in the configurations in which driven
    readings have given values.

        c(q) = 0,   r_i(q) - r_i(q_0) = x_i

    Angles and positions of the wheel and of its steering axis are those of ISO 8855
    (suspension/wheels.py). With l(x) the elongation of a spring, V the energy of all elements, and
    v = dC/dx the velocity of the point of the upright at the contact C per unit of the travel x:

        motion ratio   dl/dx; the length of an element between two points
        wheel force    dV/dx, upward at the wheel
        wheel rate     d2V/dx2
        roll center height above the ground    C_y v_y/v_z
        side view angle of the contact         atan2(-v_x, v_z), with locked brakes
        side view angle of the center          the same with the velocity of the wheel center

    Args:
        model: a model with closures, x forward, y to the left, z up; its supports are at rest
        drive: {name: sensor of one number, such as Position("upright", point, axis="z"), or
            "rack.q", or a wheel for the rise of its center}, the travel first, the one that steers
            second. Where the wheel has no kingpin, its steering axis is the screw axis of the
            motion by this drive, with the others held
        over: {name: values}, changes from the assembled reference [m or rad]; a single number keeps
            a reading constant
        wheel: the wheel
        equilibrium: whether the coordinates that closures and readings leave free are in
            equilibrium, as in a model with bushings (`jb.suspension.compliant`)
        loads: {name: load} of this equilibrium, such as a side force at the wheel; by default none

    The curves can be part of an objective of `tune` or of your own loss function: they have exact
    derivatives with respect to all numbers of the model, up to the fourth order, including those
    with respect to the travel in ratios, rates and slopes.

    Errors: UNDRIVEN where the wheel can move while all readings are held, unless in equilibrium, or
    a drive moves nothing; UNKNOWN_NAME, UNKNOWN_BODY for a load, BAD_OPTION for loads without
    `equilibrium`, or `equilibrium` of a model without elements, BAD_SHAPE, NON_FINITE; warns
    NOT_CLOSED where a value is beyond reach, UNSTABLE where the energy has no minimum.

    Source: ISO 8855 for signs; the screw axis of a twist (w, v) passes through w x v/|w|^2.

    A wheel on two parallel arms of 0.4 m moves on a circle, without camber:

    >>> part = jb.Body(mass=1.0, inertia=[1, 1, 1])
    >>> arms = {
    ...     name: jb.Hinge("world", axis="x", at=[0, 0.3, z])
    ...     for name, z in (("lower", 0.2), ("upper", 0.5))
    ... }
    >>> closures = {
    ...     "upper joint": jb.closures.Ball(("upper", [0, 0.7, 0.5]), ("upright", [0, 0.7, 0.5]))
    ... }
    >>> model = jb.Model(
    ...     bodies=dict.fromkeys(["lower", "upper", "upright"], part),
    ...     closures=closures,
    ...     joints={**arms, "upright": jb.Hinge("lower", axis="x", at=[0, 0.7, 0.2])},
    ... )
    >>> wheel = jb.suspension.Wheel(
    ...     "upright",
    ...     center=[0, 0.75, 0.3],
    ...     axis="y",
    ...     radius=0.3,
    ...     kingpin=[[0, 0.7, 0.2], [0, 0.7, 0.5]],
    ... )
    >>> curves = jb.suspension.suspension_curves(
    ...     model,
    ...     drive={"travel": jb.Position("upright", [0, 0.75, 0.3], axis="z")},
    ...     over={"travel": [0.0, 0.24]},
    ...     wheel=wheel,
    ... )
    >>> jnp.round(curves["wheel y"], 9).tolist(), jnp.round(jnp.abs(curves["camber"]), 9).tolist()
    ([0.75, 0.67], [0.0, 0.0])
    """
    arguments = arguments_of(model, drive, over, wheel, "suspension_curves", resting=equilibrium)
    with Problems() as problems:
        acting = loads_of(loads, model.layout.bodies, "suspension_curves.loads")
        if acting and not equilibrium:
            problems.add(
                "BAD_OPTION",
                "suspension_curves.loads",
                "act on what is held by its readings",
                limit="an equilibrium",
                hint="Say equilibrium=True, or leave the loads out.",
            )
        if equilibrium and not model.elements:
            problems.add(
                "BAD_OPTION",
                "suspension_curves.equilibrium",
                "has no elements to rest on",
                limit="a model with springs or bushings",
                hint="Leave the option out, or give the model elements "
                "(`jb.suspension.compliant`).",
            )
    return warn_if_failed(_curves(*arguments, acting if equilibrium else None))


def curve_names(
    model: Model, drive: Mapping[str, Any], over: Mapping[str, Any], wheel: Wheel, where: str
) -> tuple[str, ...]:
    """Return the names of the curves of a model, without computing the curves. Errors: those of
    `suspension_curves`."""
    arguments = arguments_of(model, drive, over, wheel, where)
    return tuple(jax.eval_shape(lambda: _curves(*arguments).curves))


def arguments_of(
    model: Model,
    drive: Mapping[str, Any],
    over: Mapping[str, Any],
    wheel: Wheel,
    where: str,
    resting: bool = False,
):
    """Return the arguments of `suspension_curves` after checks: model, drives, targets, wheel.
    `resting`: whether the free coordinates are in equilibrium."""
    check_precision(where, model)
    check_potential(where, model)
    drives = drives_of(model, dict(drive), f"{where}.drive")
    check_known(wheel.on, f"{where}.wheel.on", model.layout.frames)
    targets = _targets(drives, over, where)
    if is_concrete(model):
        _check_determined(model, drives, wheel, where, resting)
    return model, drives, targets, wheel


def _targets(drives: tuple[Drive, ...], over: Mapping[str, Any], where: str) -> Any:
    """Return the values (n, nd) of the driven readings. Errors: UNKNOWN_NAME, BAD_SHAPE,
    NON_FINITE."""
    names, values = tuple(drive.name for drive in drives), {}
    with Problems() as problems:
        problems.collected += [
            unknown(name, f"{where}.over", names) for name in over if name not in names
        ]
        lengths = {n for x in over.values() if (n := np.shape(x)) != ()}
        shape = next(iter(lengths), (1,))
        for name in names:
            if name not in over:
                problems.add(
                    "BAD_SHAPE",
                    f"{where}.over",
                    f"has no values of '{name}'",
                    value=name,
                    limit=str(shape),
                    hint="Give a number to hold it.",
                )
            else:
                values[name] = checked(
                    over[name],
                    ((), shape),
                    f"{where}.over['{name}']",
                    problems,
                    "One number, or as many as the others have.",
                )
    xp: Any = np if all(is_concrete(x) for x in values.values()) else jnp
    return jnp.asarray(
        xp.stack([xp.broadcast_to(xp.asarray(values[name]), shape) for name in names], -1)
    )


def _check_determined(
    model: Model, drives: tuple[Drive, ...], wheel: Wheel, where: str, resting: bool
) -> None:
    """Check that each drive moves something and, unless `resting`, that the wheel cannot move while
    all readings are held. Error: UNDRIVEN."""
    slopes, closures, moved = map(np.asarray, _slopes_at_reference(model, drives, wheel))
    if np.isnan(slopes).any():  # there is no assembled reference: all rows are NOT_CLOSED
        return
    names, count = [drive.name for drive in drives], len(slopes) - len(drives)
    with Problems() as problems:
        free = (
            scipy.linalg.null_space(closures, rcond=RANK)
            if len(closures)
            else np.eye(slopes.shape[1])
        )
        for name, row in zip(names, slopes[count:], strict=True):
            if np.abs(row @ free).max(initial=0.0) <= 1e-9:
                problems.add(
                    "UNDRIVEN",
                    f"{where}.drive['{name}']",
                    "does not move while the closures are fulfilled",
                    value=name,
                    hint="Drive a reading that the closures leave free.",
                )
        held = scipy.linalg.null_space(slopes, rcond=RANK)
        loose = np.abs(moved @ held).max(initial=0.0)
        if not problems.collected and loose > FREE and not resting:
            worst = model.layout.coordinates[int(np.argmax(np.abs(held).max(1)))]
            problems.add(
                "UNDRIVEN",
                f"{where}.drive",
                f"leaves the wheel free to move: {held.shape[1]} freedoms remain",
                value=names,
                limit="all freedoms of the wheel",
                hint=(
                    f"Drive one more reading for each freedom, such as one of '{worst}'; or "
                    "equilibrium=True leaves the rest in equilibrium."
                ),
            )


@program
def _slopes_at_reference(model: Model, drives: tuple[Drive, ...], wheel: Wheel):
    """Return the Jacobians of all conditions, of the closures alone, and of the wheel's center and
    axis in the assembled reference pose, with respect to increments in meters."""
    q = model.reference.q
    chart, scale, size = Chart(model), scale_of(model, size_of(model))[None], size_of(model)
    row = model.layout.frame(wheel.on)

    def of_wheel(q: Array) -> Array:
        pose = Coordinates(model).at_rest(q)[row].pose()
        return jnp.concatenate([pose.point(wheel.center), size * rotate(pose.R, wheel.axis)])

    target = readings(model, drives, q)
    parts = (
        lambda q: conditions(model, (drives, target), q),
        lambda q: closure_gaps(model, None, q),
        of_wheel,
    )
    return tuple(values_and_slopes(chart, part, q)[1] * scale for part in parts)


@program
def _curves(
    model: Model,
    drives: tuple[Drive, ...],
    targets: Float[Array, "n nd"],
    wheel: Wheel,
    loads: tuple[Load, ...] | None = None,
) -> SuspensionCurves:
    """Compute the curves; `loads` are those of an equilibrium, None if there is none."""
    names, start = [drive.name for drive in drives], model.reference.q
    targets = targets.astype(start.dtype)
    zero, row = readings(model, drives, start), model.layout.frame(wheel.on)
    side = wheel.side(Coordinates(model).at_rest(start)[row].pose())
    fixed, driven, goals, begin = jax.lax.stop_gradient(
        (model, drives, targets + zero[None], start)
    )
    if loads is None:
        known, status = positions(fixed, driven, goals, begin)
        find = lambda x, known: position(model, drives, x, known)  # noqa: E731
    else:
        known, status, k = resting_positions(
            fixed, tuple(map(jax.lax.stop_gradient, loads)), driven, goals, begin
        )
        find = lambda x, known: resting_position(RestingSystem(model, loads, drives, k), x, known)  # noqa: E731

    def at(x: Float[Array, "nd"], known: Any):
        def placed(x: Array):
            q = find(x + zero, known)
            return _placed(model, q, row), q

        def read(x: Array):
            slopes, (values, q) = jax.jacfwd(with_value(placed), has_aux=True)(x)
            return _read(wheel, side, values, slopes[0], model), q

        (slopes, _), (values, q) = jax.jacfwd(with_value(read), has_aux=True)(x)
        return values, slopes, q

    values, slopes, q = jax.vmap(at)(targets, known)
    if model.elements:
        values["wheel rate"] = slopes["wheel force"][:, 0]
    ok = status == Status.OK
    values: dict[str, Any] = {name: rows_or_nan(ok, x) for name, x in values.items()}
    by_drive: dict[str, Any] = {
        drive: {name: rows_or_nan(ok, x[:, i]) for name, x in slopes.items()}
        for i, drive in enumerate(names)
    }
    return SuspensionCurves(
        over=dict(zip(names, targets.T, strict=True)),
        curves=values,
        slopes=by_drive,
        q=rows_or_nan(ok[:, None], q),
        status=status,
        model=model,
        drives=drives,
        wheel=wheel,
    )


def _placed(model: Model, q: Float[Array, "nq"], row: int):
    """Return the pose of the wheel's body, the deformations of the elements that have one number,
    and the energy V of all elements in a configuration."""
    frames = Coordinates(model).at_rest(q)
    e = each_element(model, frames, lambda s, *F: jnp.atleast_1d(s.deformation(*F)))
    V = sum(
        (jnp.sum(v) for v in each_element(model, frames, lambda s, *F: s.potential(*F))),
        jnp.zeros((), q.dtype),
    )
    return (
        frames[row].pose(),
        jnp.concatenate([jnp.zeros(0, q.dtype), *(x[:, 0] for x in e if x.shape[1] == 1)]),
        V,
    )


def _read(wheel: Wheel, side: Array, placed: Any, slopes: Any, model: Model) -> dict[str, Array]:
    """Return all curves at one set of driven readings, from what `_placed` returns and its
    derivatives with respect to the readings."""
    (pose, e, _), (turning, e_slopes, V_slopes), single = placed, slopes, springs_of(model)
    center, C = pose.point(wheel.center), wheel.contact(pose)
    curves = wheel.alignment(pose, side)
    if wheel.kingpin is not None:
        lower, upper = pose.point(wheel.kingpin[0]), pose.point(wheel.kingpin[1])
        curves |= wheel.steering(pose, side, lower, upper - lower)
    elif V_slopes.size > 1:  # the second reading steers
        w, v = _twist(pose, turning, 1)
        curves |= wheel.steering(pose, side, pose.p + cross(w, v) / dot(w, w), w)
    w, v = _twist(pose, turning, 0)
    at_contact, at_center = v + cross(w, C - pose.p), v + cross(w, center - pose.p)
    curves |= {
        "roll center height": C[1] * at_contact[1] / at_contact[2],
        "side view angle of the contact": jnp.arctan2(-at_contact[0], at_contact[2]),
        "side view angle of the center": jnp.arctan2(-at_center[0], at_center[2]),
        **{f"motion ratio of {name}": e_slopes[i, 0] for i, name in enumerate(single)},
    }
    for table in model.elements:
        if isinstance(table.rows, LineElement):
            curves |= {
                f"length of {name}": e[single.index(name)] + table.rows.free_length[i]
                for i, name in enumerate(table.names)
            }
    return curves | ({"wheel force": V_slopes[0]} if single else {})


def _twist(pose: Pose, slopes: Pose, i: int):
    """Return angular velocity and velocity of the origin per unit rate of driven reading i."""
    return axial(product(slopes.R[..., i], pose.R.T)), slopes.p[..., i]
