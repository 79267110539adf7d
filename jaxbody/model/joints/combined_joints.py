"""Joints of two or three slides and turns with a name of their own: universal joints, cylindrical
joints, planes."""

from abc import abstractmethod
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, is_concrete, vector
from jaxbody.core.errors import Problems
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import field
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.places import direction
from jaxbody.geometry.vectors import cross, dot, product, rotate
from jaxbody.model.joints.elementary_joints import arms, turned_about
from jaxbody.model.joints.joints import Joint

PARALLEL = 1e-6  # sine of the angle between two directions that count as one


class Combined(Joint):
    """The base class of these joints: q = displacements [m] and angles [rad] from the reference
    pose, v = q'."""

    in_series = True

    @property
    @abstractmethod
    def directions(self) -> Float[Array, "nv 3"]:
        """The direction of each motion in the parent's frame, in the reference pose."""

    def crossed(self, first: Any, second: Any, problems: Problems) -> tuple[Any, Any]:
        """Two unit vectors that are not parallel. Error: BAD_DIRECTION."""
        kind = type(self).__name__
        first, second = (
            direction(first, f"{kind}.first", problems),
            direction(second, f"{kind}.second", problems),
        )
        if is_concrete((first, second)) and np.linalg.norm(np.cross(first, second)) <= PARALLEL:
            hint = "Give two directions that cross, such as x and y."
            problems.add(
                "BAD_DIRECTION",
                f"{kind}.second",
                "is parallel to the first",
                value=second,
                limit="across the first",
                hint=hint,
            )
        return first, second


class Universal(Combined):
    """A universal joint: two crossed hinges through one point. q = the angles [rad] about `first`,
    which stays with the parent, and about `second`, which the first turn carries along,

        R = R_first(q_1) R_second(q_2) R_rest

    Args:
        parent: `world`, a support or a body
        first, second: the two axes in the reference pose, x, y, z or a direction, parent's frame;
            they need not be perpendicular
        at: the point in which they cross, parent's frame [m]; None: the body's reference point O

    Errors: BAD_DIRECTION, also for axes that are parallel, ZERO_AXIS, BAD_SHAPE, NON_FINITE.

    >>> Universal("gearbox", first="y", second="z").motions
    ('turn about its first axis', 'turn about its second axis')
    """

    first: Float[Array, "3"] = field("", "direction")
    second: Float[Array, "3"] = field("", "direction")
    at: Float[Array, "3"] | None = field("m")
    nq, nv = 2, 2
    motions = ("turn about its first axis", "turn about its second axis")
    turns = (True, True)

    def __init__(self, parent: str, *, first, second, at=None):
        with Problems() as problems:
            self.parent = parent
            self.first, self.second = self.crossed(first, second, problems)
            self.at = None if at is None else vector(at, "Universal.at", problems)  # pyright: ignore[reportIncompatibleVariableOverride]

    @property
    def directions(self):
        return jnp.stack([self.first, self.second])

    def pose(self, q, parent, rest):
        return parent @ turned_about(
            self.at,
            product(rotations.about(self.first, q[0]), rotations.about(self.second, q[1])),
            rest,
        )

    def axes(self, q, parent, body):
        n = jnp.stack(
            [
                rotate(parent.R, self.first),
                rotate(parent.R, rotate(rotations.about(self.first, q[0]), self.second)),
            ]
        )
        return arms(n, self.at, parent, body), n


class Cylindrical(Combined):
    """Sliding along a line and turning about it, independently, as a shaft in a plain bearing:
    q = the displacement [m] and the angle [rad] from the reference pose.

    Args:
        parent: `world`, a support or a body
        axis: the direction of the line, x, y, z or a direction, parent's frame
        at: a point of the line, parent's frame [m]; None: the body's reference point O

    Errors: BAD_DIRECTION, ZERO_AXIS, BAD_SHAPE, NON_FINITE.

    >>> Cylindrical("housing", axis="x").motions
    ('move along its axis', 'turn about its axis')
    """

    axis: Float[Array, "3"] = field("", "direction")
    at: Float[Array, "3"] | None = field("m")
    nq, nv = 2, 2
    motions = ("move along its axis", "turn about its axis")
    turns = (False, True)

    def __init__(self, parent: str, *, axis, at=None):
        with Problems() as problems:
            self.parent = parent
            self.axis = direction(axis, "Cylindrical.axis", problems)
            self.at = None if at is None else vector(at, "Cylindrical.at", problems)  # pyright: ignore[reportIncompatibleVariableOverride]

    @property
    def directions(self):
        return jnp.stack([self.axis, self.axis])

    def pose(self, q, parent, rest):
        turned = turned_about(self.at, rotations.about(self.axis, q[1]), rest)
        return parent @ Pose(turned.p + q[0] * self.axis, turned.R)

    def axes(self, q, parent, body):
        n = rotate(parent.R, self.axis)
        return jnp.stack([n, arms(n[None], self.at, parent, body)[0]]), jnp.stack(
            [jnp.zeros_like(n), n]
        )


class Planar(Combined):
    """Moving in a plane, as on a table: q = the displacements [m] of the body's reference point O
    along `first` and `second` from the reference pose, and the angle [rad] about the normal first x
    second through O.

    Args:
        parent: `world`, a support or a body
        first, second: two directions of the plane, x, y, z or a direction, parent's frame; they
            need not be perpendicular

    Errors: BAD_DIRECTION, also for directions that are parallel, ZERO_AXIS, BAD_SHAPE, NON_FINITE.

    >>> Planar("world", first="x", second="z").motions
    ('move along its first direction', 'move along its second direction', 'turn about its normal')
    """

    first: Float[Array, "3"] = field("", "direction")
    second: Float[Array, "3"] = field("", "direction")
    nq, nv = 3, 3
    motions = (
        "move along its first direction",
        "move along its second direction",
        "turn about its normal",
    )
    turns = (False, False, True)

    def __init__(self, parent: str, *, first, second):
        with Problems() as problems:
            self.parent = parent
            self.first, self.second = self.crossed(first, second, problems)

    @property
    def directions(self):
        normal = cross(self.first, self.second)
        return jnp.stack([self.first, self.second, normal / jnp.sqrt(dot(normal, normal))])

    def pose(self, q, parent, rest):
        first, second, normal = self.directions
        return parent @ Pose(
            rest.p + q[0] * first + q[1] * second, product(rotations.about(normal, q[2]), rest.R)
        )

    def axes(self, q, parent, body):
        n, turns = rotate(parent.R[None], self.directions), np.array(self.turns)[:, None]
        return jnp.where(turns, 0.0, n), jnp.where(turns, n, 0.0)
