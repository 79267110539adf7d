"""The motion of a point or of a body, without an instrument: position, velocity, acceleration;
rotation, angular velocity and acceleration.

p, v, a are position, velocity and acceleration of the point; R, w, alpha are orientation, angular
velocity and angular acceleration of its body; those of the reference body B have an index B. The
readings relative to B are, in the axes of B, with r = p - p_B and u = v - v_B - w_B x r:

    position               R_B' r
    velocity               R_B' u
    acceleration           R_B' (a - a_B - alpha_B x r - w_B x (w_B x r) - 2 w_B x u)
    rotation               log(Q Q_0'), Q = R_B' R, Q_0 its value in the reference pose
    angular velocity       R_B' (w - w_B)
    angular acceleration   R_B' (alpha - alpha_B - w_B x w)

Velocities and accelerations are time derivatives of positions and velocities. Relative to the world
the axes are those of the world.
"""

from abc import abstractmethod
from typing import Any, ClassVar, Unpack

import equinox as eqx
import jax.numpy as jnp

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import Array, Float, vector
from jaxbody.core.errors import Problems
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import field
from jaxbody.geometry.frames import Frame, Instant
from jaxbody.geometry.points_and_orientations import direction
from jaxbody.geometry.vectors import cross, dot, product, rotate_back
from jaxbody.model.layouts import WORLD
from jaxbody.model.models import Model, pose_at_reference
from jaxbody.sensors.sensors import Chain, Sensor


class Kinematic(Sensor):
    """The base class of kinematic sensors, with three components in the axes of `relative_to`
    or one.

    Class attribute: `order`, 0 for a displacement, 1 for a velocity, 2 for an acceleration."""

    order: ClassVar[int] = 0
    on: str = eqx.field(static=True, converter=plain)
    axis: Float[Array, "3"] | None = field("", "direction")
    relative_to: str = field(static=True, converter=plain)

    def __init__(self, on: str, *, axis=None, relative_to: str = WORLD, **chain: Unpack[Chain]):
        self.placed(on, axis, relative_to, chain)

    def placed(self, on: Any, axis: Any, relative_to: Any, chain: Chain, point: Any = None) -> None:
        kind = type(self).__name__
        with Problems() as problems:
            for name, given in (("on", on), ("relative_to", relative_to)):
                if not isinstance(given, str):
                    problems.add(
                        "WRONG_KIND",
                        f"{kind}.{name}",
                        f"is {given!r:.60}",
                        value=given,
                        limit="a name",
                        hint=f'Write {kind}("plate", ..., relative_to="base").',
                    )
            self.on, self.relative_to = on, relative_to
            if isinstance(self, KinematicOfPoint):
                self.point = vector(point, f"{kind}.point", problems)
            self.axis = None if axis is None else direction(axis, f"{kind}.axis", problems)
            self.chained(problems, **chain)

    @property
    def shape(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (3,) if self.axis is None else ()

    @property
    def names(self):
        return (self.on, self.relative_to)

    def along(self, x: Float[Array, "3"]) -> Float[Array, "*r"]:
        """Return all components of x, or the one along the axis."""
        return x if self.axis is None else dot(jnp.asarray(self.axis), x)

    def rows(
        self, model: Model, frames: Frame, twists: Float[Array, "nf n 6"]
    ) -> Float[Array, "n *r"]:
        """Return the change of the displacement, or of the rotation, per unit of each of n
        coordinates that move the frames by their `twists`."""
        row, other = (model.layout.frame(name) for name in self.names)
        moved = self.moved(frames, row, twists[row], row)
        carried = self.moved(frames, row, twists[other], other)
        moved = rotate_back(frames.R[other][None], moved - carried)
        return moved if self.axis is None else moved @ jnp.asarray(self.axis)

    def moved(
        self, frames: Frame, row: int, twist: Float[Array, "n 6"], carried_by: int
    ) -> Float[Array, "n 3"]:
        """Return the rotation of frame `row` in world axes, or the displacement of the point, for a
        twist of frame `carried_by`."""
        return twist[:, 3:]


class KinematicVector(Kinematic, init=False):
    """The base class of kinematic sensors whose reading is a vector: `relative` returns it in world
    axes, for frame `row` relative to frame `other`."""

    @abstractmethod
    def relative(self, frames: Instant, row: int, other: int) -> Float[Array, "3"]: ...

    def reading(self, model, frames):
        row, other = (model.layout.frame(name) for name in self.names)
        return self.along(rotate_back(frames.R[other], self.relative(frames, row, other)))


class KinematicOfPoint(KinematicVector):
    """The base class of kinematic sensors of a point."""

    point: Float[Array, "3"] = field("m")

    def __init__(
        self,
        on: str,
        point=(0, 0, 0),
        *,
        axis=None,
        relative_to: str = WORLD,
        **chain: Unpack[Chain],
    ):
        self.placed(on, axis, relative_to, chain, point)

    def moved(self, frames, row, twist, carried_by):
        arm = frames[row].point(self.point) - frames.p[carried_by]
        return twist[:, :3] + cross(twist[:, 3:], arm[None])


class Position(KinematicOfPoint, init=False):
    """Position [m] of a point of a body or support, in world axes; as an output of responses,
    its displacement from equilibrium.

    Args:
        on: name of the body or support
        point: position in its axes [m]
        axis: for one component, x, y, z or a direction; None: three components
        relative_to: a body or support B, for the position from its origin, as seen by an observer
            on B, in the axes of B
        chain: `gain`, `bias`, `delay`, `lag`, `start`: see Sensor

    Errors: BAD_DIRECTION, ZERO_AXIS, UNKNOWN_NAME, BAD_SHAPE, NON_FINITE, BAD_CHAIN, BAD_LAG.

    >>> jb.Position("plate", [0.1, 0, 0]).shape, jb.Position("plate", axis="x").shape
    ((3,), ())
    """

    unit = "m"

    def relative(self, frames, row, other):
        return frames[row].point(self.point) - frames.p[other]


class Velocity(KinematicOfPoint, init=False):
    """Velocity [m/s] of a point of a body or support. Relative to the world it is the ideal record
    of a geophone.

    Its arguments and errors are those of Position.

    >>> jb.Velocity("plate", [0.1, 0, 0], relative_to="base").unit
    'm/s'
    """

    unit = "m/s"
    order = 1

    def relative(self, frames, row, other):
        r = frames[row].point(self.point) - frames.p[other]
        return frames[row].velocity(self.point) - frames.v[other] - cross(frames.w[other], r)


class Acceleration(KinematicOfPoint, init=False):
    """Acceleration [m/s2] of a point of a body or support, d2p/dt2, without gravity, as used to
    assess ride comfort. An Accelerometer reads the specific force in its own axes, which contains
    gravity.

    Its arguments and errors are those of Position. A falling stone:

    >>> guide = jb.Guide("world", axis=[0, 0, 1])
    >>> model = jb.Model(
    ...     bodies={"stone": jb.Body(mass=1, inertia=[1, 1, 1])},
    ...     joints={"stone": guide},
    ...     gravity=[0, 0, -10],
    ... )
    >>> sensors = {"a": jb.Acceleration("stone", axis="z")}
    >>> jb.measure(jb.simulate(model, [0.0, 0.5]), sensors)["a"].tolist()
    [-10.0, -10.0]
    """

    unit = "m/s2"
    order = 2
    accelerations = True

    def relative(self, frames, row, other):
        assert frames.a is not None and frames.alpha is not None
        r, w = frames[row].point(self.point) - frames.p[other], frames.w[other]
        u = frames[row].velocity(self.point) - frames.v[other] - cross(w, r)
        return (
            frames.acceleration(row, self.point)
            - frames.a[other]
            - cross(frames.alpha[other], r)
            - cross(w, cross(w, r) + 2 * u)
        )


class Rotation(Kinematic, init=False):
    """Rotation vector [rad] of a body or support from its reference pose, below half a turn; as an
    output of responses, the rotation from equilibrium.

    Args:
        on: name of the body or support
        axis: for one component, x, y, z or a direction; None: three components
        relative_to: a body or support B, for the rotation as seen by an observer on B, in the axes
            of B
        chain: `gain`, `bias`, `delay`, `lag`, `start`: see Sensor

    Errors: BAD_DIRECTION, ZERO_AXIS, UNKNOWN_NAME, BAD_SHAPE, NON_FINITE, BAD_CHAIN, BAD_LAG.

    >>> jb.sensors.Rotation("plate", axis="z").unit
    'rad'
    """

    unit = "rad"

    def reading(self, model, frames):
        R_0, B_0 = (pose_at_reference(model, name).R for name in self.names)
        return self._turned(self._seen(model, frames), product(B_0.T, R_0))

    def change(self, model, frames, rest, at_rest):
        return self._turned(self._seen(model, frames), self._seen(model, rest))

    def _seen(self, model: Model, frames: Instant) -> Float[Array, "3 3"]:
        """Return Q = R_B' R."""
        R, B = (frames.R[model.layout.frame(name)] for name in self.names)
        return product(B.T, R)

    def _turned(self, Q: Float[Array, "3 3"], Q_0: Float[Array, "3 3"]) -> Float[Array, "*r"]:
        return self.along(rotations.log(product(Q, Q_0.T)))


class AngularVelocity(KinematicVector, init=False):
    """Angular velocity [rad/s] of a body or support. Its arguments and errors are those of
    Rotation; a Gyro reads it in its own axes.

    >>> jb.sensors.AngularVelocity("plate").shape
    (3,)
    """

    unit = "rad/s"
    order = 1

    def relative(self, frames, row, other):
        return frames.w[row] - frames.w[other]


class AngularAcceleration(KinematicVector, init=False):
    """Angular acceleration [rad/s2] of a body or support. Its arguments and errors are those
    of Rotation.

    >>> jb.sensors.AngularAcceleration("plate", axis="y").unit
    'rad/s2'
    """

    unit = "rad/s2"
    order = 2
    accelerations = True

    def relative(self, frames, row, other):
        assert frames.alpha is not None
        return frames.alpha[row] - frames.alpha[other] - cross(frames.w[other], frames.w[row])
