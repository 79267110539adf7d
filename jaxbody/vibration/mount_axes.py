"""Axes of a mounted body: the axis about which it turns under a torque, and the axes along which
a force moves it without rotation."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.core import tables
from jaxbody.core.arguments import plain
from jaxbody.core.arrays import Array, Float, Int, is_concrete, shaped
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, check_known
from jaxbody.core.results import AXES, Labeled, Result, dataset, warn_if_failed
from jaxbody.geometry.frames import Frame
from jaxbody.geometry.vectors import axial, cross, dot, rotate, rotate_back, skew
from jaxbody.model.joints.joints import Free
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.numerics.eigenproblems import natural
from jaxbody.numerics.elementary_functions import root
from jaxbody.vibration.linearizations import Linearization, check_system


class ElasticAxes(Labeled, Result):
    """Elastic axes of a body on its mounts, in world axes, the softest first.

    `directions` (columns), `stiffness` [N/m] along each, `points` (rows): the point of each axis
    nearest to `center`, `pitch` [m]: moment per force that accompanies the force, 0 for an elastic
    axis in the strict sense. `center`: center of stiffness; all axes pass through it, and pitches
    vanish, where the mounts decouple translation from rotation. `torsional_directions` (columns)
    and `torsional_stiffness` [N m/rad]: axes along which a pure couple turns the body about a
    parallel axis."""

    index = "elastic_axis"
    center: Float[Array, "3"]
    directions: Float[Array, "3 3"]
    stiffness: Float[Array, "3"]
    points: Float[Array, "3 3"]
    pitch: Float[Array, "3"]
    torsional_directions: Float[Array, "3 3"]
    torsional_stiffness: Float[Array, "3"]
    status: Int[Array, ""]
    body: str = field(static=True, converter=plain)

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: direction, stiffness, point and pitch of each axis."""
        return dataset(
            {
                "center": (("axis",), self.center, "m"),
                "direction": (("axis", "elastic_axis"), self.directions, ""),
                "stiffness": (("elastic_axis",), self.stiffness, "N/m"),
                "point": (("elastic_axis", "axis"), self.points, "m"),
                "pitch": (("elastic_axis",), self.pitch, "m"),
                "torsional_direction": (("axis", "elastic_axis"), self.torsional_directions, ""),
                "torsional_stiffness": (("elastic_axis",), self.torsional_stiffness, "N m/rad"),
                "status": ((), self.status, ""),
            },
            {"axis": AXES, "elastic_axis": [1, 2, 3]},
            f"elastic axes of {self.body}",
        )

    @tables.summarized("Elastic axes", 1, stiffness="stiffness [N/m]")
    def _tables(self) -> list[tables.PrintedTable]:
        axes = zip(
            "123",
            map(tables.without_dust, self.directions.T),
            self.stiffness,
            map(tables.without_dust, self.points),
            self.pitch,
            strict=True,
        )
        torsional_axes = zip(
            "123",
            map(tables.without_dust, self.torsional_directions.T),
            self.torsional_stiffness,
            strict=True,
        )
        note = f"center of stiffness {tables.number(self.center)} m; {self.report()}"
        return [
            tables.PrintedTable(
                f"Elastic axes of {self.body}",
                ("axis", "direction", "stiffness [N/m]", "through [m]", "pitch [m]"),
                [*axes],
            ),
            tables.PrintedTable(
                "",
                ("torsional axis", "direction", "stiffness [N m/rad]"),
                [*torsional_axes],
                note,
            ),
        ]


class TorqueRollAxis(Result):
    """The axis through `point`, the center of mass, along `direction` (unit), about which a free
    body turns under a torque, in world axes.

    `inertia` [kg m2] and `stiffness` [N m/rad] of rotation about it, `frequency` [Hz] from both,
    and `coupling`, 0 if this rotation is a mode, the only one that the torque excites."""

    point: Float[Array, "3"]
    direction: Float[Array, "3"]
    inertia: Float[Array, ""]
    stiffness: Float[Array, ""]
    frequency: Float[Array, ""]
    coupling: Float[Array, ""]
    status: Int[Array, ""]
    body: str = field(static=True, converter=plain)

    def _tables(self) -> list[tables.PrintedTable]:
        rows = [
            ("direction", tables.without_dust(self.direction), ""),
            ("through", tables.without_dust(self.point), "m"),
            ("inertia", self.inertia, "kg m2"),
            ("stiffness", self.stiffness, "N m/rad"),
            ("frequency", self.frequency, "Hz"),
            ("coupling", self.coupling, "-"),
        ]
        return [
            tables.PrintedTable(
                f"Torque roll axis of {self.body}",
                ("quantity", "value", "unit"),
                rows,
                self.failure,
            )
        ]


def elastic_axes(lin: Linearization, body: str) -> ElasticAxes:
    """Compute the elastic axes and the center of stiffness of a free body, with all others held
    fixed, from its 6 x 6 stiffness [[A, B], [B', D]] about its origin. With closures the other
    independent coordinates are held, and the body's own must be independent.

        A n = k n,
        m = B' n:   force k n with moment m moves the body along n and does not turn it;
        it acts on the line through O + n x m/k, with pitch n . m/k
        center O + p, where B' - [p] A is symmetric:   (tr(A) I - A) p = axial vector of B' - B,
        (P32 - P23, P13 - P31, P21 - P12)
        D - B' A^-1 B = the torsional stiffness, about any point

    Preload and gravity are included as in K. Errors: UNKNOWN_NAME for the body, NOT_FREE; NaN
    with SINGULAR_K if the mounts do not resist every translation. Source: J. Loncaric, IEEE
    Journal of Robotics and Automation 3 (1987) 567; T. Patterson, H. Lipkin, Journal of
    Mechanical Design 115 (1993) 576.

    >>> corners = [[1, 1, -0.2], [1, -1, -0.2], [-1, 1, -0.2], [-1, -1, -0.2]]
    >>> legs = {
    ...     f"leg{i}": jb.Bushing(("box", at), ("world", at), stiffness=[1e4, 2e4, 3e4])
    ...     for i, at in enumerate(corners)
    ... }
    >>> model = jb.Model(bodies={"box": jb.Body(mass=50.0, inertia=[4, 5, 6])}, elements=legs)
    >>> axes = jb.vibration.elastic_axes(jb.linearize(model, model.reference), "box")
    >>> axes.stiffness.tolist(), [round(float(x), 9) for x in axes.center]
    ([40000.0, 80000.0, 120000.0], [0.0, 0.0, -0.2])
    """
    check_system(lin, "elastic_axes")
    return warn_if_failed(_elastic_axes(lin, _free(lin, body, "elastic_axes")))


def torque_roll_axis(lin: Linearization, body: str, torque: Any) -> TorqueRollAxis:
    """Compute the axis about which a free body, without mounts or on very soft ones, turns under a
    torque (3,) of fixed direction in world axes, such as that of the crankshaft.

        J n ~ torque,   through the center of mass,   J: moment of inertia about it
        r = (displacement of O, n) of this rotation:   frequency = sqrt(r' K r/(r' M r))/(2 pi),
        coupling = |K r - w^2 M r|/(w^2 |M r|) in the norm of M^-1

    If r is a mode, with coupling 0, the mounts are decoupled about this axis. Errors: UNKNOWN_NAME
    for the body, NOT_FREE, BAD_SHAPE, NON_FINITE, ZERO_AXIS for the torque. Source: T. Jeong,
    R. Singh, Journal of Sound and Vibration 234 (2000) 85.

    >>> model = jb.presets.engine_on_mounts()
    >>> axis = jb.vibration.torque_roll_axis(
    ...     jb.linearize(model, model.reference), "engine", [1, 0, 0]
    ... )
    >>> [round(float(x), 4) for x in axis.direction]
    [0.9445, 0.3279, -0.0191]
    """
    check_system(lin, "torque_roll_axis")
    with Problems() as problems:
        along = shaped(torque, (3,), "torque_roll_axis.torque", problems)
    if is_concrete(along) and not np.any(along):
        raise JaxbodyError(
            Problem(
                "ZERO_AXIS",
                "torque_roll_axis.torque",
                "is zero",
                along,
                "> 0",
                "Give the direction of the torque.",
            )
        )
    return warn_if_failed(
        _torque_roll_axis(lin, jnp.asarray(along), _free(lin, body, "torque_roll_axis"))
    )


def _free(lin: Linearization, body: str, where: str) -> str:
    """Check that a body is free and independent of closures, and return its name. Errors:
    UNKNOWN_NAME, NOT_FREE."""
    layout = lin.model.layout
    check_known(body, where, layout.bodies)
    if layout.block(body).kind is not Free:
        raise JaxbodyError(
            Problem(
                "NOT_FREE",
                where,
                f"'{body}' is on a joint",
                body,
                "a body without a joint",
                "These axes exist for bodies with six degrees of freedom.",
            )
        )
    own = layout.v_slices[body]
    if not set(range(own.start, own.stop)) <= set(lin.independent):
        raise JaxbodyError(
            Problem(
                "NOT_FREE",
                where,
                f"'{body}' follows other bodies by closures",
                body,
                "a body whose six coordinates are independent",
                "Make bushings of them by jb.suspension.compliant.",
            )
        )
    return body


def _rows(lin: Linearization, body: str) -> slice:
    """Return the body's rows of K and M."""
    own = lin.model.layout.v_slices[body]
    return slice(lin.independent.index(own.start), lin.independent.index(own.start) + 6)


@program
def _elastic_axes(lin: Linearization, body: str) -> ElasticAxes:
    rows, K = _rows(lin, body), lin.quasistatic[1]
    K = (K[rows, rows] + K[rows, rows].T) / 2
    A, P, D = K[:3, :3], K[3:, :3], K[3:, 3:]  # a translation n needs the moment P n
    p = jnp.linalg.solve(jnp.trace(A) * jnp.eye(3, dtype=A.dtype) - A, 2 * axial(P))
    stiffness, n = natural(A, jnp.eye(3, dtype=A.dtype))
    about_p = (P - skew(p) @ A) @ n
    points = cross(n.T, about_p.T) / stiffness[:, None]
    pitch = jnp.sum(n * about_p, 0) / stiffness
    torsional_K = D - P @ jnp.linalg.solve(A, P.T)
    torsional, torsional_axes = natural(torsional_K, jnp.eye(3, dtype=A.dtype))
    origin = _frame(lin, body).p
    resists = jnp.min(stiffness) > 1e-10 * jnp.max(jnp.abs(stiffness))
    status = jnp.where(resists, Status.OK.value, Status.SINGULAR_K.value)
    center, points, pitch, torsional = (
        jnp.where(resists, x, jnp.nan)
        for x in (origin + p, (origin + p)[None] + points, pitch, torsional)
    )
    return ElasticAxes(center, n, stiffness, points, pitch, torsional_axes, torsional, status, body)


@program
def _torque_roll_axis(lin: Linearization, torque: Float[Array, "3"], body: str) -> TorqueRollAxis:
    rows, row = _rows(lin, body), lin.model.bodies.rows
    i = lin.model.layout.bodies.index(body)
    M, K = (H[rows, rows] for H in lin.quasistatic)
    K = (K + K.T) / 2
    frame = _frame(lin, body)
    inertia = (row.inertia[i] + row.inertia[i].T) / 2
    n = rotate(frame.R, jnp.linalg.solve(inertia, rotate_back(frame.R, torque)))
    n = n / jnp.linalg.norm(n)
    arm = rotate(frame.R, row.com[i])
    r = jnp.concatenate([-cross(n, arm), n])
    m, k = dot(r, M @ r), dot(r, K @ r)
    force = K @ r - k / m * (M @ r)
    square = dot(force, jnp.linalg.solve(M, force)) / m
    coupling = root(square) / jnp.abs(k / m)
    frequency = jnp.where(k > 0, jnp.sqrt(jnp.where(k > 0, k / m, 1.0)), jnp.nan) / (2 * jnp.pi)
    status = jnp.where(k > 0, Status.OK.value, Status.UNSTABLE.value)
    return TorqueRollAxis(frame.p + arm, n, m, k, frequency, coupling, status, body)


def _frame(lin: Linearization, body: str) -> Frame:
    frames = Coordinates(lin.model).at_rest(lin.state.q, lin.state.v)
    return frames[lin.model.layout.frame(body)]
