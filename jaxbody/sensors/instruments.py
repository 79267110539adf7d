"""Instruments mounted on bodies: accelerometer, gyro, inclinometer; sensors of elements, forces and
joints; and of poses and orientations, unit quaternions whose residuals are rotation vectors."""

from collections.abc import Callable
from typing import Any, ClassVar, Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import Array, Float, concrete, vector
from jaxbody.core.errors import Problem, Problems, unknown
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import field
from jaxbody.geometry.frames import Frame, Instant
from jaxbody.geometry.points_and_orientations import IDENTITY, as_quaternion, direction
from jaxbody.geometry.vectors import cross, dot, product, rotate, rotate_back, to_rank
from jaxbody.model.elements.elements import Element
from jaxbody.model.elements.torsions import Torsion
from jaxbody.model.joints.joints import Free
from jaxbody.model.models import Model
from jaxbody.sensors.sensors import Chain, Sensor


class Mounted(Sensor):
    """The base class of instruments with their own axes: three components in the axes of
    `orientation`, a quaternion or rotation matrix of the instrument in its body; or one number
    along `axis`, the sensitive direction in body axes."""

    on: str = eqx.field(static=True, converter=plain)
    point: Float[Array, "3"] = field("m")
    axis: Float[Array, "3"] | None = field("", "direction")
    orientation: Float[Array, "4"] | None = field("", "rotation")

    def __init__(self, on: str, *, axis=None, orientation=None, **chain: Unpack[Chain]):
        self.mounted(on, (0, 0, 0), axis, orientation, chain)

    def mounted(self, on: str, point: Any, axis: Any, orientation: Any, chain: Chain) -> None:
        kind = type(self).__name__
        with Problems() as problems:
            self.on, self.point = on, vector(point, f"{kind}.point", problems)
            if axis is not None and orientation is not None:
                problems.add(
                    "TWO_AXES",
                    kind,
                    "has an axis and an orientation",
                    value=axis,
                    hint="Give one of them: one number or three.",
                )
            self.axis = None if axis is None else direction(axis, f"{kind}.axis", problems)
            turned = IDENTITY if orientation is None else orientation
            self.orientation = (
                None if axis is not None else as_quaternion(turned, f"{kind}.orientation", problems)
            )
            self.chained(problems, **chain)

    @property
    def shape(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (3,) if self.axis is None else ()

    def along(self, R: Float[Array, "3 3"], x: Float[Array, "3"]) -> Float[Array, "*r"]:
        """Return the components of a world vector x in the axes of the instrument, or its component
        along the one axis."""
        x_B = rotate_back(R, x)
        if self.axis is not None:
            return dot(jnp.asarray(self.axis), x_B)
        return rotate_back(rotations.matrix(jnp.asarray(self.orientation)), x_B)


class Accelerometer(Mounted):
    """Specific force [m/s2] at a point of a body or support, in the axes of the instrument:

        f = R_S' R' (a_P - g),   a_P = a_O + alpha x r + w x (w x r),   r = R point

    At rest it reads +9.81 upwards. Accelerations are those of the equations of motion,
    loads included.

    Args:
        on: name of the body or support
        point: position in body axes [m]
        axis: the sensitive direction in body axes, or x, y or z, for one number
        orientation: R_S of the instrument in its body (quaternion or matrix), for three
            numbers; None: body axes
        chain: `gain`, `bias`, `delay`, `lag`, `start`: see Sensor

    Errors: TWO_AXES, ZERO_AXIS, BAD_QUATERNION, BAD_ROTATION, BAD_SHAPE, NON_FINITE,
    BAD_CHAIN, BAD_LAG.

    >>> box, hinge = jb.Body(mass=2.0, inertia=[1, 1, 1]), jb.Hinge("world", axis=[0, 0, 1])
    >>> model = jb.Model(bodies={"box": box}, joints={"box": hinge}, gravity=[0, 0, -9.81])
    >>> sensors = {"acc": jb.Accelerometer("box", [0.1, 0, 0])}
    >>> jb.measure(jb.simulate(model, [0.0, 0.1]), sensors)["acc"][0].tolist()
    [0.0, 0.0, 9.81]
    """

    unit = "m/s2"
    accelerations = True

    def __init__(
        self, on: str, point=(0, 0, 0), *, axis=None, orientation=None, **chain: Unpack[Chain]
    ):
        self.mounted(on, point, axis, orientation, chain)

    def reading(self, model, frames):
        row = model.layout.frame(self.on)
        return self.along(frames.R[row], frames.acceleration(row, self.point) - model.gravity)


class Gyro(Mounted, init=False):
    """Angular velocity [rad/s] of a body or support in the axes of the instrument, w_S = R_S' R' w.
    Its arguments (except `point`) and errors are those of an Accelerometer.

        >>> jb.sensors.Gyro("box", axis=[0, 0, 1]).shape, jb.sensors.Gyro("box").shape
        ((), (3,))
    """

    unit = "rad/s"

    def reading(self, model, frames):
        row = model.layout.frame(self.on)
        return self.along(frames.R[row], frames.w[row])


class Inclinometer(Mounted, init=False):
    """An inclinometer: the angles [rad] of its x and y axes above the horizontal plane, or of its
    single `axis`, positive upwards,

        theta = atan2(e . u, |e x u|),   u = -g/|g|

    It reads the direction of gravity only; for an instrument that also responds to accelerations
    use an Accelerometer. Its arguments (except `point`) and errors are those of an Accelerometer,
    with NO_GRAVITY for a model without gravity.

    >>> jb.sensors.Inclinometer("box").shape, jb.sensors.Inclinometer("box", axis=[1, 0, 0]).shape
    ((2,), ())
    """

    unit = "rad"

    @property
    def shape(self):
        return (2,) if self.axis is None else ()

    def reading(self, model, frames):
        g = model.gravity
        u = rotate_back(frames.R[model.layout.frame(self.on)], -g / jnp.sqrt(dot(g, g)))
        if self.axis is not None:
            return _elevation(jnp.asarray(self.axis), u)
        return _elevation(rotations.matrix(jnp.asarray(self.orientation)).T[:2], u)

    def problem(self, model, where):
        g = concrete(model.gravity)
        if g is not None and not g.any():
            return Problem(
                "NO_GRAVITY",
                where,
                "needs the direction of gravity",
                g,
                "not 0",
                "Give the model its gravity.",
            )
        return super().problem(model, where)


def _elevation(e: Float[Array, "*n 3"], u: Float[Array, "3"]) -> Float[Array, "*n"]:
    """Return the angle [rad] of e above the plane normal to u; its derivatives are finite where e
    is parallel to u."""
    u = jnp.broadcast_to(u, e.shape)
    across = cross(e, u)
    return jnp.arctan2(dot(e, u), jnp.sqrt(jnp.maximum(dot(across, across), 1e-24)))


class Components(Sensor):
    """The base class of sensors that read several numbers, or one `component` of them."""

    on: str = eqx.field(static=True, converter=plain)
    component: int | None = field(static=True)

    def __init__(self, on: str, *, component: int | None = None, **chain: Unpack[Chain]):
        with Problems() as problems:
            self.on, self.component = on, component
            self.chained(problems, **chain)


class OfElement(Components):
    """The base class of sensors of an element, which read one number; for a bushing, a `component`,
    0 to 2 along and 3 to 5 about the axes of its end a."""

    shape = ()
    units_of_parts: ClassVar[tuple[str, str]]  # for components along and about an axis

    @property
    def unit(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.units_of_parts[(self.component or 0) >= 3]

    @property
    def possible_units(self):
        return self.units_of_parts if self.component is None else (self.unit,)

    def unit_on(self, model):
        return self.units_of_parts[1] if isinstance(model[self.on], Torsion) else self.unit

    def read(self, model: Model, frames: Instant, of: Callable[..., Any]) -> Float[Array, ""]:
        element = model[self.on]
        rows = [model.layout.frame(end) for end in element.between]
        value = of(
            element, *(frames.frame(row) if element.has_inertia() else frames[row] for row in rows)
        )
        return value if self.component is None else value[self.component]

    def problem(self, model, where):
        if self.on not in model.element_names:
            return unknown(self.on, where, model.element_names)
        size = model[self.on].size
        return _component_problem(
            self.component, None if size == 1 else size, f"'{self.on}'", where
        )


class Elongation(OfElement):
    """Deformation of an element: elongation [m] of a spring, tension positive; the angle [rad] of a
    Torsion; as an output of responses its change from equilibrium. `gain`, `bias`, `delay`, `lag`,
    `start`: see Sensor.

    A bushing needs a `component`: 0 to 2 for the displacements [m], 3 to 5 for the rotations [rad]
    of its end b, in the axes of its end a. Errors: UNKNOWN_NAME, BAD_COMPONENT, BAD_SHAPE,
    NON_FINITE, BAD_LAG.

    >>> jb.Elongation("AB").unit, jb.Elongation("mount", component=5).unit
    ('m', 'rad')
    """

    units_of_parts = ("m", "rad")

    def reading(self, model, frames):
        return self.read(
            model, frames, lambda element, *ends: element.deformation(*(end.pose() for end in ends))
        )


class LoadCell(OfElement):
    """The force in an element [N], tension positive, including those of its damper and its inertia;
    the moment [N m] of a Torsion. `gain`, `bias`, `delay`, `lag`, `start`: see Sensor.

    A bushing needs a `component`: 0 to 2 for the forces [N], 3 to 5 for the moments [N m] that
    oppose its deformation, in the axes of its end a: positive where its end b is displaced along
    the axis.
    Errors: UNKNOWN_NAME, BAD_COMPONENT, BAD_SHAPE, NON_FINITE, BAD_LAG.

    >>> jb.sensors.LoadCell("AB").unit, jb.sensors.LoadCell("mount", component=5).unit
    ('N', 'N m')
    """

    units_of_parts = ("N", "N m")

    def reading(self, model, frames):
        return self.read(model, frames, _force)

    def needs_accelerations(self, model):
        return model[self.on].has_inertia()


def _force(element: Element, *ends: Any) -> Array:
    if not element.has_inertia():
        return element.force(*ends)
    frames = tuple(Frame(end.p, end.R, end.v, end.w) for end in ends)
    return element.force(*frames) + element.inertial_force(
        frames, tuple(end.changes() for end in ends)
    )


class WrenchSensor(Components):
    """The base class of sensors of a force [N] and a moment [N m]: six numbers, or `component` 0 to
    5 of them."""

    accelerations = reactions = True

    @property
    def shape(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (6,) if self.component is None else ()

    @property
    def unit(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return "N, N m" if self.component is None else "N" if self.component < 3 else "N m"

    @property
    def parts(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return ("force", "moment") if self.component is None else ()

    def picked(
        self, R: Float[Array, "3 3"], F: Float[Array, "3"], M: Float[Array, "3"]
    ) -> Float[Array, "*r"]:
        """Return force and moment in the axes R: all six numbers, or the selected component."""
        both = jnp.concatenate([rotate_back(R, F), rotate_back(R, M)])
        return both if self.component is None else both[self.component]

    def problem(self, model, where):
        return (
            None
            if self.component is None
            else _component_problem(self.component, 6, f"'{self.on}'", where)
        )


class ForcePlate(WrenchSensor):
    """Total force [N] on a support, or `world`, and moment [N m] about its origin, in its axes: six
    numbers, or `component` 0 to 5 of them.

    It is the sum of the forces of all bodies, springs and loads on the base, as read by a force
    plate or a shaker table. A Reaction reads it in world axes. Noise is one number, or two: for
    forces [N] and moments [N m]. `gain`, `bias`, `delay`, `lag`, `start`: see Sensor. Errors:
    UNKNOWN_NAME, BAD_COMPONENT, BAD_SHAPE, NON_FINITE, BAD_CHAIN, BAD_LAG.

    >>> jb.sensors.ForcePlate("base").shape, jb.sensors.ForcePlate("base", component=2).unit
    ((6,), 'N')
    """

    def reading(self, model, frames):
        row = model.layout.frame(self.on)
        return self.picked(frames.R[row], *(jnp.asarray(x)[row] for x in (frames.F, frames.M)))

    def problem(self, model, where):
        known = model.layout.frames[: model.layout.first_body]
        return super().problem(model, where) if self.on in known else unknown(self.on, where, known)


class Reaction(WrenchSensor):
    """Force [N] and moment [N m] that a joint exerts on the body that it carries, in the axes of
    the joint's parent; or that everything attached to a support exerts on it, in world axes. Six
    numbers, or `component` 0 to 5.

        F = sum over the body and all that it carries by joints of d(momentum)/dt - applied forces;
        M the sum of their moments about the joint

    Along the joint's degrees of freedom it is zero, or the force of a coupling
    (`jb.closures.Coupling`). Noise is one number, or two: for forces [N] and moments [N m].

    Args:
        on: name of the body that the joint carries, or of a support
        point: point about which the moment is taken, in axes of the body or support [m]; None: the
            point `at` of a hinge or ball, or else the reference point O
        component: 0 to 2 for one force, 3 to 5 for one moment; None: all six
        chain: `gain`, `bias`, `delay`, `lag`, `start`: see Sensor

    Errors: UNKNOWN_NAME, NO_JOINT for a free body, BAD_COMPONENT, BAD_SHAPE, NON_FINITE,
    BAD_CHAIN, BAD_LAG.

    >>> box, hinge = jb.Body(mass=2.0, inertia=[1, 1, 1]), jb.Hinge("world", axis=[0, 1, 0])
    >>> model = jb.Model(bodies={"box": box}, joints={"box": hinge}, gravity=[0, 0, -9.81])
    >>> sensors = {"up": jb.sensors.Reaction("box", component=2)}
    >>> jb.measure(jb.simulate(model, [0.0, 0.1]), sensors)["up"].tolist()
    [19.62, 19.62]
    """

    point: Float[Array, "3"] | None = field("m")

    def __init__(
        self, on: str, point=None, *, component: int | None = None, **chain: Unpack[Chain]
    ):
        with Problems() as problems:
            self.point = None if point is None else vector(point, "Reaction.point", problems)
            problems.gather(lambda: Components.__init__(self, on, component=component, **chain))

    def reading(self, model, frames):
        row, point = model.layout.frame(self.on), self.point
        if self.on in model.layout.supports:
            F, M = (jnp.asarray(x)[row] for x in (frames.F, frames.M))
            return self.picked(
                frames.R[0], F, M if point is None else M - cross(rotate(frames.R[row], point), F)
            )
        joint = model.joint(self.on)
        parent, at, body = model.layout.frame(joint.parent), joint.at, frames[row]
        place = (
            body.point(point)
            if point is not None
            else body.p
            if at is None
            else frames[parent].point(at)
        )
        F, M = (-jnp.asarray(x)[row] for x in (frames.F, frames.M))
        return self.picked(frames.R[parent], F, M + cross(body.p - place, F))

    def problem(self, model, where):
        layout = model.layout
        if self.on not in layout.supports + layout.bodies:
            return unknown(self.on, where, layout.supports + layout.bodies)
        if self.on in layout.bodies and layout.block(self.on).kind is Free:
            return Problem(
                "NO_JOINT",
                where,
                f"is on '{self.on}', a free body",
                self.on,
                "a body on a joint",
                "LoadCell reads elements.",
            )
        return super().problem(model, where)


class JointAngle(Components):
    """An encoder: the angle [rad] of the joint that carries a body, from its reference pose, whole
    turns included.

    A joint with several coordinates needs a `component`, the number (from 0) of one that is a
    rotation. `gain`, `bias`, `delay`, `lag`, `start`: see Sensor.
    Errors: UNKNOWN_NAME, BAD_COMPONENT (free bodies and ball joints have no angle: use
    Orientation), BAD_SHAPE, NON_FINITE, BAD_LAG.

    >>> jb.sensors.JointAngle("arm").unit
    'rad'
    """

    shape = ()
    unit = "rad"

    def reading(self, model, frames):
        return frames.state.q[model.layout.q_slices[self.on]][self.component or 0]

    def problem(self, model, where):
        layout = model.layout
        if self.on not in layout.bodies:
            return unknown(self.on, where, layout.bodies)
        block = layout.block(self.on)
        turns = [i for i, unit in enumerate(block.q_units) if unit == "rad"]
        if (self.component is None and block.nv == 1 and turns) or self.component in turns:
            return None
        return Problem(
            "BAD_COMPONENT",
            where,
            f"reads component {self.component} of the joint of '{self.on}', "
            f"a {block.kind.__name__}",
            self.component,
            f"one of {turns}" if turns else "a joint that turns",
            "Give the number of a rotation.",
        )


def _component_problem(
    component: int | None, size: int | None, what: str, where: str
) -> Problem | None:
    """Return the problem of a missing, superfluous or nonexistent component; None if there is
    none."""
    if (component is None) == (size is None) and (
        component is None or component in range(size or 0)
    ):
        return None
    return Problem(
        "BAD_COMPONENT",
        where,
        f"reads component {component} of {what}",
        component,
        "no component" if size is None else f"0 to {size - 1}",
        "Change `component`.",
    )


BACK = np.array([1.0, -1, -1, -1])  # conjugates a quaternion


class Attitude(Sensor):
    """The base class of readings that end in a unit quaternion w, x, y, z, after `places`
    other numbers.

    The residual has a rotation vector in place of the quaternion, from the measured orientation
    to the reading, in world axes. `bias` also has a rotation vector in its place, which rotates
    the reading."""

    on: str = eqx.field(static=True, converter=plain)
    places: ClassVar[int] = 0
    stages = {"bias": "0.0", "delay": "0.0"}  # noqa: RUF012

    @property
    def shape(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return (self.places + 4,)

    @property
    def noise_shape(self):
        return (self.places + 3,)

    def residual(self, reading, measured):
        n, gone = self.places, self.missing(measured)
        q = rotations.normalize(
            jnp.where(gone[..., n : n + 1], reading[..., n:], measured[..., n:])
        )
        turn = rotations.log_quaternion(
            rotations.multiply(reading[..., n:], q * to_rank(BACK, q.ndim))
        )
        return jnp.where(
            gone, 0.0, jnp.concatenate([reading[..., :n] - measured[..., :n], turn], -1)
        )

    def missing(self, measured):
        n, gone = self.places, super().missing(measured)
        turn = gone[..., n:].any(-1, keepdims=True)
        return (np if isinstance(gone, np.ndarray) else jnp).concatenate(
            [gone[..., :n], turn, turn, turn], -1
        )

    def disturbed(self, reading, noise):
        n = self.places
        turned = rotations.multiply(rotations.exp_quaternion(noise[..., n:]), reading[..., n:])
        return jnp.concatenate([reading[..., :n] + noise[..., :n], turned], -1)

    def delayed(self, times, x):
        """Return interpolated quaternions: the polynomial through samples with consistent signs,
        normalized."""
        n, q = self.places, x[..., self.places :]
        turns = jnp.where(jnp.sum(q[1:] * q[:-1], -1, keepdims=True) < 0, -1.0, 1.0)
        signs = jnp.concatenate(
            [jnp.ones_like(q[:1, :1]), jax.lax.stop_gradient(jnp.cumprod(turns, 0))]
        )
        moved = super().delayed(times, jnp.concatenate([x[..., :n], signs * q], -1))
        return jnp.concatenate([moved[..., :n], rotations.normalize(moved[..., n:])], -1)

    def misread(self, measured, where):
        length = np.linalg.norm(measured[..., self.places :], axis=-1)
        off = np.flatnonzero(np.abs(length - 1) > 1e-3)  # not where it is NaN
        if not len(off):
            return None
        return Problem(
            "BAD_QUATERNION",
            where,
            f"has a quaternion of length {length[off[0]]:.6g} in row {off[0]}",
            measured[off[0]],
            "1 within 1e-3",
            f"Columns: {'x, y, z, then ' if self.places else ''}the quaternion w, x, y, z.",
        )


class BodyPose(Attitude):
    """Pose of a body or support: position of its origin [m] and unit quaternion w, x, y, z,
    seven numbers.

    The residual has six: position, and rotation vector from the measured orientation to the
    reading, in world axes. Noise is one number for both, or two: meters for the position, radians
    for the orientation. `bias` (six numbers) and `delay` may be given.

    >>> jb.sensors.BodyPose("plate").shape, jb.sensors.BodyPose("plate").noise_shape
    ((7,), (6,))
    """

    places = 3
    unit = "m, rad"
    parts = ("position", "orientation")

    def reading(self, model, frames):
        row = model.layout.frame(self.on)
        return jnp.concatenate([frames.p[row], rotations.from_matrix(frames.R[row])])


class Orientation(Attitude):
    """Orientation of an instrument on a body or support, as read by an attitude reference: unit
    quaternion w, x, y, z, instrument to world.

    `orientation`: orientation of the instrument in its body, a quaternion or a rotation matrix. The
    residual is the rotation vector [rad] from the measured orientation to the reading, in world
    axes. `bias` (three numbers) is a rotation vector that rotates the reading; `delay` may be given
    too. Errors: BAD_QUATERNION, BAD_ROTATION, BAD_SHAPE, NON_FINITE, BAD_CHAIN.

    >>> jb.sensors.Orientation("plate").shape, jb.sensors.Orientation("plate").noise_shape
    ((4,), (3,))
    """

    orientation: Float[Array, "4"] = field("", "rotation")
    unit = "rad"

    def __init__(self, on: str, *, orientation=IDENTITY, **chain: Unpack[Chain]):
        with Problems() as problems:
            self.on, self.orientation = (
                on,
                as_quaternion(orientation, "Orientation.orientation", problems),
            )
            self.chained(problems, **chain)

    def reading(self, model, frames):
        R = product(frames.R[model.layout.frame(self.on)], rotations.matrix(self.orientation))
        return rotations.from_matrix(R)
