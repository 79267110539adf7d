"""Joints: how a body can move relative to its parent, which is `world`, a support or another body.

A joint defines four functions: how its coordinates q change by an increment (`retract`), their
rate for given speeds v (`rate`), the pose of the body for a pose of the parent (`pose`) and the
velocity of the body per unit of each speed (`axes`). All else follows from these. `rest` gives the
coordinates of the body's reference pose on its parent. Axes and points are in the parent's frame.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import Array, Float, vector
from jaxbody.core.errors import Problems
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import Described, field
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.points_and_orientations import direction
from jaxbody.geometry.vectors import cross, product, rotate
from jaxbody.model.layouts import MOVES, TURNS, CoordinateBlock

Axes = tuple[Float[Array, "nv 3"], Float[Array, "nv 3"]]


class Joint(Described, eqx.Module):
    """The base class of joints: nq coordinates, nv speeds; `motions` describes each speed, `turns`
    says which are rotations [rad/s]; `in_series`, whether an earlier rotation turns the axes of
    later ones (else the rotations of a joint act together).

    A user-defined joint defines these, `pose` and `axes`, and, unless increments of q are added,
    also `rest`, `retract` and `rate`. A nut on a screw, which falls with the acceleration
    g / (1 + I / (m lead^2)):

    >>> from jaxbody.geometry.frames import Pose
    >>> class Screw(jb.joints.Joint):
    ...     lead: jax.Array  # m/rad
    ...     nq, nv, motions, turns = 1, 1, ("turn of the screw",), (True,)
    ...     def pose(self, q, parent, rest):
    ...         c, s = jnp.cos(q[0]), jnp.sin(q[0])
    ...         R = jnp.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    ...         return parent @ Pose(rest.p + jnp.array([0, 0, self.lead * q[0]]), R @ rest.R)
    ...     def axes(self, q, parent, body):
    ...         n = parent.R[:, 2]
    ...         return self.lead * n[None], n[None]
    >>> nut = jb.Body(mass=0.3, inertia=[2e-5, 2e-5, 2e-5])
    >>> model = jb.Model(
    ...     bodies={"nut": nut}, joints={"nut": Screw("world", jnp.array(0.01))}, gravity=[0, 0, -9]
    ... )
    >>> round(float(jb.simulate(model, [0.0, 1.0]).poses["nut"].p[-1, 2]), 9)  # 9 / (1 + 2/3) / 2
    -2.7
    """

    parent: str = eqx.field(static=True, converter=plain)
    nq: eqx.AbstractClassVar[int]
    nv: eqx.AbstractClassVar[int]
    motions: eqx.AbstractClassVar[tuple[str, ...]]
    turns: eqx.AbstractClassVar[tuple[bool, ...]]
    in_series: ClassVar[bool] = False
    # the point of the joint on its parent; None: the body's O in the reference pose
    at: ClassVar[Any] = None

    def block(self, body: str) -> CoordinateBlock:
        """Return the coordinates of the joint of a body; if q has one number more than v, the last
        four are a quaternion."""
        units, quaternion = tuple("rad" if turn else "m" for turn in self.turns), self.nq > self.nv
        q_units = (*units[:-3], *[""] * 4) if quaternion else units
        return CoordinateBlock(
            body,
            type(self),
            self.motions,
            q_units,
            tuple(f"{unit}/s" for unit in units),
            quaternion,
        )

    def rest(self, rest: Pose) -> Float[Array, "nq"]:
        """Return the coordinates q at which the body has the pose `rest` relative to its parent."""
        return jnp.zeros(self.nq, rest.p.dtype)

    def retract(self, q: Float[Array, "nq"], delta: Float[Array, "nv"]) -> Float[Array, "nq"]:
        """Return q (+) delta: the coordinates q after the increments delta, one for each speed."""
        return q + delta

    def rate(self, q: Float[Array, "nq"], v: Float[Array, "nv"]) -> Float[Array, "nq"]:
        """Return dq/dt, the derivative of retract(q, t v) at t = 0."""
        return v

    @abstractmethod
    def pose(self, q: Float[Array, "nq"], parent: Pose, rest: Pose) -> Pose:
        """Return the pose of the body in the world, from the pose of its parent and the body's
        reference pose `rest` on it."""

    @abstractmethod
    def axes(self, q: Float[Array, "nq"], parent: Pose, body: Pose) -> Axes:
        """Return the velocity of the body's origin, and its angular velocity, per unit of each
        speed, relative to the parent, in world axes."""


class Free(Joint):
    """The joint of a free body, with six degrees of freedom: q = (position of O [m], unit
    quaternion), v = (velocity of O [m/s], angular velocity [rad/s]), in the parent's axes.

    >>> jb.Free().parent
    'world'
    """

    nq, nv = 7, 6
    motions = MOVES + TURNS
    turns = (False,) * 3 + (True,) * 3

    def __init__(self, parent: str = "world"):
        self.parent = parent

    def rest(self, rest: Pose):
        return jnp.concatenate([rest.p, rest.quaternion])

    def retract(self, q, delta):
        return jnp.concatenate(
            [q[:3] + delta[:3], rotations.multiply(rotations.exp_quaternion(delta[3:]), q[3:])]
        )

    def rate(self, q, v):
        return jnp.concatenate([v[:3], rotations.quaternion_rate(q[3:], v[3:])])

    def pose(self, q, parent, rest):
        return parent @ Pose(q[:3], rotations.matrix(q[3:]))

    def axes(self, q, parent, body):
        zero = jnp.zeros((3, 3), parent.R.dtype)
        return jnp.concatenate([parent.R.T, zero]), jnp.concatenate([zero, parent.R.T])


class Fixed(Joint):
    """A rigid connection: the body keeps its reference pose relative to the parent.

    >>> jb.Fixed("base").nq
    0
    """

    nq, nv = 0, 0
    motions, turns = (), ()

    def __init__(self, parent: str):
        self.parent = parent

    def pose(self, q, parent, rest):
        return parent @ rest

    def axes(self, q, parent, body):
        return jnp.zeros((0, 3), parent.R.dtype), jnp.zeros((0, 3), parent.R.dtype)


class Guide(Joint):
    """A prismatic joint, along which the body slides without rotation: q is the displacement [m]
    from the reference pose along `axis` (x, y, z or a direction, parent's frame).

    >>> jb.Guide("base", axis="z").axis.tolist()
    [0.0, 0.0, 1.0]
    """

    axis: Float[Array, "3"] = field("", "direction")
    nq, nv = 1, 1
    motions = ("move along its guide",)
    turns = (False,)

    def __init__(self, parent: str, *, axis):
        with Problems() as problems:
            self.parent = parent
            self.axis = direction(axis, "Guide.axis", problems)

    def pose(self, q, parent, rest):
        return parent @ Pose(rest.p + q[0] * self.axis, rest.R)

    def axes(self, q, parent, body):
        n = rotate(parent.R, self.axis)[None]
        return n, jnp.zeros_like(n)


class Hinge(Joint):
    """A hinge (revolute joint): q is the angle [rad] from the reference pose about `axis` (x, y, z
    or a direction) through the point `at`, both in the parent's frame; without `at`, through the
    body's reference point O.

    >>> model = jb.Model(
    ...     bodies={"arm": jb.Body(mass=1.0, inertia=[1, 1, 1], com=[1, 0, 0])},
    ...     joints={"arm": jb.Hinge("world", axis=[0, 0, 1])},
    ... )
    >>> model.reference.q.tolist()
    [0.0]
    """

    axis: Float[Array, "3"] = field("", "direction")
    at: Float[Array, "3"] | None = field("m")
    nq, nv = 1, 1
    motions = ("turn about its hinge",)
    turns = (True,)

    def __init__(self, parent: str, *, axis, at=None):
        with Problems() as problems:
            self.parent = parent
            self.axis = direction(axis, "Hinge.axis", problems)
            self.at = None if at is None else vector(at, "Hinge.at", problems)  # pyright: ignore[reportIncompatibleVariableOverride]

    def pose(self, q, parent, rest):
        return parent @ turned_about(self.at, rotations.about(self.axis, q[0]), rest)

    def axes(self, q, parent, body):
        n = rotate(parent.R, self.axis)[None]
        return arms(n, self.at, parent, body), n


class Ball(Joint):
    """A ball joint at the point `at` (parent's frame; without it, the body's reference point O).
    q = unit quaternion of the rotation from the reference pose, v = angular velocity, in the
    parent's axes.

    >>> jb.Model(
    ...     bodies={"top": jb.Body(mass=1.0, inertia=[1, 1, 1])}, joints={"top": jb.Ball("world")}
    ... ).reference.q.tolist()
    [1.0, 0.0, 0.0, 0.0]
    """

    at: Float[Array, "3"] | None = field("m")
    nq, nv = 4, 3
    motions = TURNS
    turns = (True,) * 3

    def __init__(self, parent: str, *, at=None):
        with Problems() as problems:
            self.parent = parent
            self.at = None if at is None else vector(at, "Ball.at", problems)  # pyright: ignore[reportIncompatibleVariableOverride]

    def rest(self, rest: Pose):
        return jnp.array([1.0, 0, 0, 0], rest.p.dtype)

    def retract(self, q, delta):
        return rotations.multiply(rotations.exp_quaternion(delta), q)

    def rate(self, q, v):
        return rotations.quaternion_rate(q, v)

    def pose(self, q, parent, rest):
        return parent @ turned_about(self.at, rotations.matrix(q), rest)

    def axes(self, q, parent, body):
        return arms(parent.R.T, self.at, parent, body), parent.R.T


def turned_about(at, R, rest: Pose) -> Pose:
    """Return the reference pose turned by R about the point `at`; None: about its origin."""
    if at is None:
        return Pose(rest.p, product(R, rest.R))
    return Pose(at + rotate(R, rest.p - at), product(R, rest.R))


def arms(n: Float[Array, "nv 3"], at, parent: Pose, body: Pose) -> Float[Array, "nv 3"]:
    """Return the velocity of the body's origin per unit of angular velocity about each of the axes
    with directions n through the point `at` of the parent; None: through the body's origin."""
    if at is None:
        return jnp.zeros_like(n)
    return cross(n, (body.p - parent.point(at))[None])
