"""Ports: inputs and outputs of small motions: motions of supports and forces; motions of points, elements, reactions.

About an equilibrium, with x = (Delta, Xi), outputs are y = Y0 x + Y1 x' + Y2 x'' + G f and forces enter as F f. The rows of a point are its
Jacobian, those of an element the derivatives of its force or deformation, those of a reaction the rows of K, C and M of its support.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import Array, Float, float_array, vector
from jaxbody.core.compile_options import jit_unoptimized
from jaxbody.core.errors import Problem, Problems, unknown
from jaxbody.elements.torsions import Torsion
from jaxbody.geometry.fields import field
from jaxbody.geometry.frames import Frame
from jaxbody.geometry.places import unit_vector
from jaxbody.geometry.vectors import cross, skew
from jaxbody.mechanics.element_derivatives import ElementDerivatives, element_derivatives
from jaxbody.mechanics.hessians import configuration_at, frame_twists, slope
from jaxbody.mechanics.kinematics import Coordinates
from jaxbody.mechanics.linear_readings import reading_rows
from jaxbody.models.models import Model

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")  # along and about world axes
KINDS = ("displacement", "velocity", "acceleration")
UNITS = (("m", "m/s", "m/s2"), ("rad", "rad/s", "rad/s2"))


class BaseMotion(eqx.Module):
    """An input: the motion of a support along or about a world axis through its origin, `direction` x, y, z, rx, ry or rz.

    `kind` of the input: displacement [m, rad], velocity or acceleration. Errors: BAD_DIRECTION, BAD_KIND.

    >>> BaseMotion("base", "z", kind="acceleration").unit
    'm/s2'
    """

    on: str = eqx.field(static=True, converter=plain)
    direction: str = eqx.field(static=True, converter=plain)
    kind: str = eqx.field(static=True, converter=plain)

    def __init__(self, on: str, direction: str, *, kind: str = "displacement"):
        with Problems() as problems:
            _check_one_of(direction, DIRECTIONS, "BAD_DIRECTION", "BaseMotion.direction", problems)
            _check_one_of(kind, KINDS, "BAD_KIND", "BaseMotion.kind", problems)
        self.on, self.direction, self.kind = on, direction, kind

    @property
    def unit(self) -> str:
        return UNITS[len(self.direction) - 1][KINDS.index(self.kind)]

    def problem(self, model: Model, where: str) -> Problem | None:
        known = model.layout.supports
        return None if self.on in known else unknown(self.on, where, known)


class PointForce(eqx.Module):
    """An input: a force [N] at a point of a body along x, y, z or a vector, in world axes; or a moment [N m] about them: rx, ry, rz.

    `point` is in the axes of the body. Errors: BAD_DIRECTION, ZERO_AXIS, BAD_SHAPE, NON_FINITE.

    >>> PointForce("engine", [0, 0, 0.2], "z").unit, PointForce("engine", direction="rx").unit
    ('N', 'N m')
    """

    on: str = eqx.field(static=True, converter=plain)
    point: Float[Array, "3"] = field("m")
    axis: Float[Array, "3"] = field("", "direction")
    turns: bool = field(static=True)

    def __init__(self, on: str, point=(0, 0, 0), direction: Any = "z"):
        with Problems() as problems:
            self.on, self.point = on, vector(point, "PointForce.point", problems)
            self.axis, self.turns = _direction(direction, "PointForce.direction", problems)

    @property
    def unit(self) -> str:
        return "N m" if self.turns else "N"

    def problem(self, model: Model, where: str) -> Problem | None:
        known = model.layout.bodies
        return None if self.on in known else unknown(self.on, where, known)


class PointMotion(eqx.Module):
    """An output: the motion of a point of a body or support along x, y, z or a vector, in world axes, or its rotation about rx, ry, rz.

    Args:
        on: name of the body or support
        point: position in its axes [m]
        direction: x, y, z, a vector in world axes, rx, ry or rz
        kind: displacement [m, rad], velocity or acceleration
        relative_to: a body or support, for the motion relative to its point that coincides with this one at equilibrium; None: absolute

    Errors: BAD_DIRECTION, BAD_KIND, ZERO_AXIS, BAD_SHAPE, NON_FINITE.

    >>> PointMotion("cabin", [0.1, 0, 0], "z", kind="acceleration").unit
    'm/s2'
    """

    on: str = eqx.field(static=True, converter=plain)
    point: Float[Array, "3"] = field("m")
    axis: Float[Array, "3"] = field("", "direction")
    turns: bool = field(static=True)
    kind: str = field(static=True, converter=plain)
    relative_to: str | None = field(static=True, converter=plain)

    def __init__(self, on: str, point=(0, 0, 0), direction: Any = "z", *, kind: str = "displacement", relative_to: str | None = None):
        with Problems() as problems:
            self.on, self.point = on, vector(point, "PointMotion.point", problems)
            self.axis, self.turns = _direction(direction, "PointMotion.direction", problems)
            _check_one_of(kind, KINDS, "BAD_KIND", "PointMotion.kind", problems)
        self.kind, self.relative_to = kind, relative_to

    @property
    def unit(self) -> str:
        return UNITS[self.turns][KINDS.index(self.kind)]

    def problem(self, model: Model, where: str) -> Problem | None:
        known = model.layout.frames
        wrong = [name for name in (self.on, self.relative_to) if name is not None and name not in known]
        return unknown(wrong[0], where, known) if wrong else None


class ElementForce(eqx.Module):
    """An output: the force of an element, spring and damper, minus its value at equilibrium: for a spring the tension [N], for a bushing
    its `component`, one of three forces (0 to 2) [N] and moments (3 to 5) [N m] in its own axes, opposing the deformation.

    >>> ElementForce("mount", component=2).component
    2
    """

    on: str = eqx.field(static=True, converter=plain)
    component: int | None = eqx.field(static=True, default=None)

    def unit_on(self, model: Model) -> str:
        return "N m" if _turning(self, model) else "N"

    def problem(self, model: Model, where: str) -> Problem | None:
        return _element_problem(self, model, where)


class ElementDeformation(eqx.Module):
    """An output: the deformation of an element minus its value at equilibrium: for a spring its elongation [m], for a bushing the
    `component` (0 to 5) of its displacement [m] and rotation [rad].

    >>> ElementDeformation("AB").on
    'AB'
    """

    on: str = eqx.field(static=True, converter=plain)
    component: int | None = eqx.field(static=True, default=None)

    def unit_on(self, model: Model) -> str:
        return "rad" if _turning(self, model) else "m"

    def problem(self, model: Model, where: str) -> Problem | None:
        return _element_problem(self, model, where)


class SupportReaction(eqx.Module):
    """An output: the force [N] on a support along x, y, z, or the moment [N m] about its origin, rx, ry, rz, in world axes, exerted by all
    that is attached to it, minus its value at equilibrium.

    >>> SupportReaction("base", "z").unit
    'N'
    """

    on: str = eqx.field(static=True, converter=plain)
    direction: str = eqx.field(static=True, converter=plain)

    def __init__(self, on: str, direction: str):
        with Problems() as problems:
            _check_one_of(direction, DIRECTIONS, "BAD_DIRECTION", "SupportReaction.direction", problems)
        self.on, self.direction = on, direction

    @property
    def unit(self) -> str:
        return "N m" if len(self.direction) == 2 else "N"

    def problem(self, model: Model, where: str) -> Problem | None:
        known = model.layout.supports
        return None if self.on in known else unknown(self.on, where, known)


Input = BaseMotion | PointForce
OUTPUTS = (PointMotion, ElementForce, ElementDeformation, SupportReaction)


class PortMatrices(eqx.Module):
    """The matrices of ports: forces enter (Delta, Xi) as F f, motions are Xi = X u; outputs are Y0 x + Y1 x' + Y2 x'' + G f.
    `orders`: the order of the derivative of Xi for each input (0 for forces); `elements`: for each output the index of the element if it is
    a force; `reactions`: the index of the component of Xi if it is a reaction; -1 for others."""

    F: Float[Array, "n nu"]
    X: Float[Array, "nxi nu"]
    Y: Float[Array, "3 ny n"]
    G: Float[Array, "ny nu"]
    orders: tuple[int, ...] = eqx.field(static=True)
    elements: tuple[int, ...] = eqx.field(static=True)
    reactions: tuple[int, ...] = eqx.field(static=True)


@jit_unoptimized
def port_matrices(lin: Any, inputs: tuple[Input, ...], outputs: tuple[Any, ...]) -> PortMatrices:
    """The matrices of these ports on a linearization."""
    model, layout, q = lin.model, lin.model.layout, lin.state.q
    n, dtype = layout.nv + layout.nxi, q.dtype
    zero = jnp.zeros(n, dtype)
    at = configuration_at(Coordinates(model), q)
    frames, twists = at.frames, frame_twists(at)
    points = iter(
        [_point_row(port, frames, twists, layout.frame) for port in (*inputs, *outputs) if isinstance(port, PointForce | PointMotion)]
    )
    of_elements = {}
    if any(isinstance(port, ElementForce | ElementDeformation) for port in outputs):
        for table, derivatives in zip(model.elements, element_derivatives(at), strict=True):
            of_elements |= {name: ElementDerivatives(*(x[i] for x in derivatives)) for i, name in enumerate(table.names)}
    turned = any(isinstance(port, SupportReaction) and len(port.direction) == 2 for port in outputs)
    reaction_at_rest = slope(at)[layout.nv :] if turned else zero
    sensors = [port for port in outputs if hasattr(port, "reading")]
    readings = iter(zip(*reading_rows(lin, sensors, _input_wrenches(inputs, frames, layout)), strict=True) if sensors else ())
    forces = [next(points) if isinstance(port, PointForce) else zero for port in inputs]
    moved = [_unit(layout, port, dtype) if isinstance(port, BaseMotion) else jnp.zeros(layout.nxi, dtype) for port in inputs]
    F, X = (jnp.reshape(jnp.asarray(cols, dtype), (len(inputs), size)).T for cols, size in ((forces, n), (moved, layout.nxi)))
    whole, rows, direct = full_matrices(lin), [], []
    for port in outputs:
        G = jnp.zeros(len(inputs), dtype)
        if isinstance(port, PointMotion):
            place = jnp.asarray(np.eye(3)[KINDS.index(port.kind)], dtype)
            row = place[:, None] * next(points)[None]
        elif isinstance(port, SupportReaction):
            unit = jnp.concatenate([jnp.zeros(layout.nv, dtype), _unit(layout, port, dtype)])
            K, C, M = (unit @ matrix for matrix in whole)
            row, G = -jnp.stack([K + _turned_moment(layout, reaction_at_rest, port), C, M]), unit @ F
        elif isinstance(port, ElementForce):
            J, *second = of_elements[port.on]
            row = jnp.stack([H[port.component or 0] @ J for H in second] + [zero])
        elif isinstance(port, ElementDeformation):
            row = jnp.stack([of_elements[port.on].J[port.component or 0], zero, zero])
        else:
            row, G = next(readings)
        rows.append(row)
        direct.append(G)
    names = model.element_names
    return PortMatrices(
        F, X, jnp.stack(rows, 1), jnp.stack(direct),
        tuple(KINDS.index(port.kind) if isinstance(port, BaseMotion) else 0 for port in inputs),
        tuple(names.index(port.on) if isinstance(port, ElementForce) else -1 for port in outputs),
        tuple(_place(layout, port) if isinstance(port, SupportReaction) else -1 for port in outputs),
    )  # fmt: skip


def full_matrices(lin: Any) -> tuple[Float[Array, "n n"], Float[Array, "n n"], Float[Array, "n n"]]:
    """K, C and M of (Delta, Xi)."""
    blocks = ((lin.K, lin.K_tilde, lin.K_bb), (lin.C, lin.C_tilde, lin.C_bb), (lin.M, lin.M_tilde, lin.M_bb))
    return tuple(jnp.block([[A, -A_tilde], [-A_tilde.T, A_bb]]) for A, A_tilde, A_bb in blocks)  # pyright: ignore[reportReturnType]  of three


def ports_of(
    model: Model, given: Any, what: str, where: str, problems: Problems
) -> tuple[tuple[str, ...], tuple[Any, ...], tuple[str, ...]]:
    """Names, ports and units of a dict of ports; errors go to `problems`."""
    limit = "{name: BaseMotion or PointForce}" if what == "inputs" else "{name: PointMotion, ElementForce, ...}"
    if not isinstance(given, dict) or not given:
        problems.add("WRONG_KIND", f"{where}.{what}", f"is {given!r:.60}", value=given, limit=limit, hint="Name each port.")
        return (), (), ()
    for name, port in given.items():
        path = f"{where}.{what}[{name!r}]"
        scalar_sensor = hasattr(port, "reading") and getattr(port, "shape", None) == () and port.plain
        if not (isinstance(port, Input) if what == "inputs" else isinstance(port, OUTPUTS) or scalar_sensor):
            hint = "A sensor must read one number, with no chain."
            problems.add("WRONG_KIND", path, f"is a {type(port).__name__}", value=port, limit=limit, hint=hint)
        elif (problem := port.problem(model, path)) is not None:
            problems.collected.append(problem)
    if problems.collected:
        return (), (), ()
    ports = tuple(given.values())
    return tuple(given), ports, tuple(port.unit_on(model) if hasattr(port, "unit_on") else port.unit for port in ports)


def _check_one_of(value: Any, known: tuple[str, ...], code: str, where: str, problems: Problems) -> None:
    if value not in known:
        problems.add(code, where, f"is {value!r}", value=value, limit=" ".join(known), hint="Give one of these.")


def _direction(direction: Any, where: str, problems: Problems) -> tuple[Any, bool]:
    """A unit vector, and whether the direction is a rotation about it."""
    if not isinstance(direction, str):
        return unit_vector(float_array(direction, where), where, problems), False
    _check_one_of(direction, DIRECTIONS, "BAD_DIRECTION", where, problems)
    return np.eye(3)["xyz".find(direction[-1:])], len(direction) == 2


def _point_row(port: PointForce | PointMotion, frames: Frame, twists, row_of) -> Float[Array, "n"]:
    """The displacement or rotation of a port's point per unit of each of (Delta, Xi)."""
    place, axis = frames[row_of(port.on)].point(port.point), jnp.asarray(port.axis)

    def moved(name: str):
        row = row_of(name)
        if port.turns:
            return twists[row, :, 3:] @ axis
        return twists[row, :, :3] @ axis + twists[row, :, 3:] @ cross(place - frames.p[row], axis)

    other = getattr(port, "relative_to", None)
    return moved(port.on) if other is None else moved(port.on) - moved(other)


def _input_wrenches(inputs: tuple[Input, ...], frames: Frame, layout) -> Float[Array, "nu nb 6"]:
    """Force and moment on each body about its origin, per unit of each input."""
    wrenches = jnp.zeros((len(inputs), len(layout.bodies), 6), frames.p.dtype)
    for i, port in enumerate(inputs):
        if isinstance(port, PointForce):
            row, axis = layout.frame(port.on), jnp.asarray(port.axis)
            F = jnp.zeros(3) if port.turns else axis
            M = axis if port.turns else cross(frames[row].point(port.point) - frames.p[row], axis)
            wrenches = wrenches.at[i, row - layout.first_body].set(jnp.concatenate([F, M]))
    return wrenches


def _place(layout, port: Any) -> int:
    return 6 * layout.supports.index(port.on) + DIRECTIONS.index(port.direction)


def _unit(layout, port: Any, dtype) -> Float[Array, "nxi"]:
    return jnp.zeros(layout.nxi, dtype).at[_place(layout, port)].set(1.0)


def _turned_moment(layout, held: Float[Array, "nxi"], port: SupportReaction) -> Float[Array, "n"]:
    """phi x m/2: the moment m at equilibrium equals dV/dphi at the rotation vector phi = 0 only; in general m = J(phi)^-T dV/dphi."""
    first = 6 * layout.supports.index(port.on) + 3
    row = jnp.zeros(layout.nv + layout.nxi, held.dtype)
    if len(port.direction) == 1:
        return row
    turned = -skew(held[first : first + 3])[DIRECTIONS.index(port.direction) - 3] / 2
    return row.at[layout.nv + first : layout.nv + first + 3].set(turned)


def _turning(port: Any, model: Model) -> bool:
    return isinstance(model[port.on], Torsion) or (port.component or 0) >= 3


def _element_problem(port: Any, model: Model, where: str) -> Problem | None:
    if port.on not in model.element_names:
        return unknown(port.on, where, model.element_names)
    size = model[port.on].size
    if (size == 1) == (port.component is None) and (port.component is None or 0 <= port.component < size):
        return None
    limit = "no component" if size == 1 else f"0 to {size - 1}"
    return Problem("BAD_COMPONENT", where, f"is component {port.component} of '{port.on}'", port.component, limit, "Say which one.")


def check_ports(lin: Any, inputs: Any, outputs: Any, where: str):
    """(names, ports, units) of inputs and outputs; raises all errors at once."""
    with Problems() as problems:
        ports = [ports_of(lin.model, given, what, where, problems) for given, what in ((inputs, "inputs"), (outputs, "outputs"))]
    return ports
