"""Elementary joints: sliding along a line, turning about a line, turning about a point."""

import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float, vector
from jaxbody.core.errors import Problems
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import field
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.places import direction
from jaxbody.geometry.vectors import cross, product, rotate
from jaxbody.model.joints.joints import Joint
from jaxbody.model.layouts import TURNS


class Guide(Joint):
    """Sliding along a straight line: q is the displacement [m] from the reference pose along `axis`
    (x, y, z or a direction, parent's frame).

    >>> Guide("base", axis="z").axis.tolist()
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
    """Turning about a line: q is the angle [rad] from the reference pose about `axis` (x, y, z or a
    direction) through the point `at`, both in the parent's frame; without `at`, through the body's
    reference point O.

    >>> model = Model(
    ...     bodies={"arm": Body(mass=1.0, inertia=[1, 1, 1], com=[1, 0, 0])},
    ...     joints={"arm": Hinge("world", axis=[0, 0, 1])},
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
    """Turning about the point `at` (parent's frame; without it, the body's reference point O).
    q = unit quaternion of the turn from the reference pose, v = angular velocity, in the
    parent's axes.

    >>> Model(
    ...     bodies={"top": Body(mass=1.0, inertia=[1, 1, 1])}, joints={"top": Ball("world")}
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
    """The reference pose turned by R about the point `at`."""
    if at is None:
        return Pose(rest.p, product(R, rest.R))
    return Pose(at + rotate(R, rest.p - at), product(R, rest.R))


def arms(n: Float[Array, "nv 3"], at, parent: Pose, body: Pose) -> Float[Array, "nv 3"]:
    """Velocity of the body's origin for unit turns about the directions n through `at`."""
    if at is None:
        return jnp.zeros_like(n)
    return cross(n, (body.p - parent.point(at))[None])
