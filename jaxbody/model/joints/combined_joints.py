"""Joints with several translations and rotations: composite joints, motions in series along and
about the axes of the parent, and universal, cylindrical and planar joints."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import Array, Float, checked, is_concrete, vector
from jaxbody.core.errors import Problems
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import field
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.points_and_orientations import direction, of_length_1
from jaxbody.geometry.vectors import cross, dot, product, rotate
from jaxbody.model.joints.joints import Joint, arms, turned_about
from jaxbody.model.layouts import MOVES, TURNS

STEPS = ("move", "turn")


class Composite(Joint):
    """A joint of several motions in series, without mass between them: q = displacements [m] and
    angles [rad] from the reference pose, v = q'. Each motion also moves the axes of those after it,

        X = X_parent M_1(q_1) ... M_n(q_n) X_rest

    Args:
        parent: `world`, a support or a body
        steps: "move" or "turn" for each motion
        directions: a row for each motion: the direction along which it moves, or about which it
            turns, in the parent's frame, in the reference pose
        points: a row for each motion: a point of the line about which it turns, in the parent's
            frame, in the reference pose [m]; without effect for a "move"

    Errors: UNKNOWN_NAME, BAD_SHAPE, ZERO_AXIS, NON_FINITE. A puck on a table:

    >>> plane = jb.joints.Composite(
    ...     "table",
    ...     ["move", "move", "turn"],
    ...     directions=[[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    ...     points=[[0, 0, 0.1]] * 3,
    ... )
    >>> plane.motions
    ('move 1', 'move 2', 'turn 3')
    """

    steps: tuple[str, ...] = eqx.field(static=True)
    directions: Float[Array, "n 3"] = field("", "direction")
    points: Float[Array, "n 3"] = field("m")
    in_series = True

    def __init__(self, parent: str, steps: Sequence[str], *, directions, points):
        with Problems() as problems:
            self.parent = parent
            self.steps = tuple(map(plain, steps))
            if not self.steps:
                problems.add(
                    "BAD_SHAPE",
                    "Composite.steps",
                    "is empty",
                    limit="one or more",
                    hint="Use Fixed for no motion.",
                )
            for step in self.steps:
                if step not in STEPS:
                    hint = "A slide moves, a hinge turns."
                    problems.add(
                        "UNKNOWN_NAME",
                        "Composite.steps",
                        f"has {step!r:.60}",
                        value=step,
                        limit="move, turn",
                        hint=hint,
                    )
            rows = (len(self.steps), 3)
            hint = "Give a row of three numbers for each step."
            self.points = checked(points, (rows,), "Composite.points", problems, hint)
            lines = checked(directions, (rows,), "Composite.directions", problems, hint)
            if lines is not None:
                self.directions = of_length_1(lines, "Composite.directions", problems)

    @property
    def nq(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return len(self.steps)

    nv = nq  # pyright: ignore[reportAssignmentType]

    @property
    def motions(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return tuple(f"{step} {i + 1}" for i, step in enumerate(self.steps))

    @property
    def turns(self) -> tuple[bool, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return tuple(step == "turn" for step in self.steps)

    def _after_each(self, q: Float[Array, "n"]) -> list[Pose]:
        """Return the products 1, M_1, M_1 M_2, ... of the motions, as poses in the parent's
        frame."""
        poses = [Pose(jnp.zeros(3, q.dtype), jnp.eye(3, dtype=q.dtype))]
        for n, at, turn, x in zip(self.directions, self.points, self.turns, q, strict=True):
            if turn:
                R = rotations.about(n, x)
                poses.append(poses[-1] @ Pose(at - rotate(R, at), R))
            else:
                poses.append(Pose(poses[-1].point(x * n), poses[-1].R))
        return poses

    def pose(self, q, parent, rest):
        return parent @ self._after_each(q)[-1] @ rest

    def axes(self, q, parent, body):
        moves, turns = [], []
        for n, at, turn, moved in zip(
            self.directions, self.points, self.turns, self._after_each(q), strict=False
        ):
            n = rotate(parent.R, rotate(moved.R, n))
            moves.append(cross(n, body.p - parent.point(moved.point(at))) if turn else n)
            turns.append(n if turn else jnp.zeros_like(n))
        return jnp.stack(moves), jnp.stack(turns)


class Series(Joint):
    """Several motions in series, without mass between them: translations along the parent's axes,
    then rotations about the body's reference point O,

        O = O_rest + sum q_i e_i,    R = R_1(q_j) R_2(q_k) ... R_rest,

    each about an axis that the earlier rotations have turned. q: displacements [m] and angles [rad]
    from the reference pose, v = q'. A subclass defines `steps`: the axis of each motion, 0, 1, 2
    for x, y, z.
    """

    steps: eqx.AbstractClassVar[tuple[int, ...]]
    in_series = True

    def pose(self, q, parent, rest):
        e = np.eye(3, dtype=parent.R.dtype)
        p, R = rest.p, e
        for axis, turn, x in zip(self.steps, self.turns, q, strict=True):
            if turn:
                R = product(R, rotations.about(e[axis], x))
            else:
                p = p + x * e[axis]
        return parent @ Pose(p, product(R, rest.R))

    def axes(self, q, parent, body):
        R, e, directions = parent.R, np.eye(3, dtype=parent.R.dtype), []
        for axis, turn, x in zip(self.steps, self.turns, q, strict=True):
            directions.append(R[:, axis])
            if turn:
                R = product(R, rotations.about(e[axis], x))
        turns = jnp.array(self.turns)[:, None]
        n = jnp.stack(directions)
        return jnp.where(turns, 0.0, n), jnp.where(turns, n, 0.0)


class Translation(Series):
    """A joint that allows translation only: q is the displacement [m] of the body along the
    parent's x, y and z from the reference pose.

    >>> jb.Translation("base").motions
    ('move along x', 'move along y', 'move along z')
    """

    nq, nv = 3, 3
    steps, motions, turns = (0, 1, 2), MOVES, (False,) * 3


class HeavePitch(Series):
    """The joint of a half-car model: q = (heave [m] along the parent's z, pitch [rad] about its y)
    from the reference pose, with the rotation about the body's reference point O. With x forward
    and z up, a positive pitch lowers the front.

    >>> jb.joints.HeavePitch("world").motions
    ('move along z', 'turn about y')
    """

    nq, nv = 2, 2
    steps, motions, turns = (2, 1), (MOVES[2], TURNS[1]), (False, True)


class HeavePitchRoll(Series):
    """The joint of a full-car model: q = (heave [m] along the parent's z, pitch [rad] about its y,
    roll [rad] about the x axis turned by the pitch) from the reference pose, with the rotations
    about the body's reference point O. With x forward, y to the left and z up (ISO 8855), a
    positive pitch lowers the front and a positive roll the right.

    >>> jb.joints.HeavePitchRoll("world").motions
    ('move along z', 'turn about y', 'turn about x')
    """

    nq, nv = 3, 3
    steps, motions, turns = (2, 1, 0), (MOVES[2], TURNS[1], TURNS[0]), (False, True, True)


PARALLEL = 1e-6  # sine of the angle between two directions that count as one


class Combined(Joint):
    """The base class of Universal, Cylindrical and Planar: q = displacements [m] and angles [rad]
    from the reference pose, v = q'."""

    in_series = True

    @property
    @abstractmethod
    def directions(self) -> Float[Array, "nv 3"]:
        """The direction of each motion in the parent's frame, in the reference pose."""

    def crossed(self, first: Any, second: Any, problems: Problems) -> tuple[Any, Any]:
        """Return two unit vectors that are not parallel. Error: BAD_DIRECTION."""
        kind = type(self).__name__
        first, second = (
            direction(first, f"{kind}.first", problems),
            direction(second, f"{kind}.second", problems),
        )
        if is_concrete((first, second)) and np.linalg.norm(np.cross(first, second)) <= PARALLEL:
            problems.add(
                "BAD_DIRECTION",
                f"{kind}.second",
                "is parallel to the first",
                value=second,
                limit="across the first",
                hint="Give two directions that cross, such as x and y.",
            )
        return first, second


class Universal(Combined):
    """A universal joint: two crossed hinges through one point. q = the angles [rad] about `first`,
    which is fixed in the parent, and about `second`, which rotates with the first,

        R = R_first(q_1) R_second(q_2) R_rest

    Args:
        parent: `world`, a support or a body
        first, second: the two axes in the reference pose, x, y, z or a direction, parent's frame;
            they need not be perpendicular
        at: the point in which they cross, parent's frame [m]; None: the body's reference point O

    Errors: BAD_DIRECTION, also for axes that are parallel, ZERO_AXIS, BAD_SHAPE, NON_FINITE.

    >>> jb.joints.Universal("gearbox", first="y", second="z").motions
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
    """A cylindrical joint, in which the body slides along a line and rotates about it, like a
    shaft in a plain bearing: q = the displacement [m] and the angle [rad] from the reference
    pose.

    Args:
        parent: `world`, a support or a body
        axis: the direction of the line, x, y, z or a direction, parent's frame
        at: a point of the line, parent's frame [m]; None: the body's reference point O

    Errors: BAD_DIRECTION, ZERO_AXIS, BAD_SHAPE, NON_FINITE.

    >>> jb.joints.Cylindrical("housing", axis="x").motions
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
    """A planar joint, in which the body moves as on a table: q = the displacements [m] of its
    reference point O along `first` and `second` from the reference pose, and the angle [rad] about
    the normal first x second through O.

    Args:
        parent: `world`, a support or a body
        first, second: two directions of the plane, x, y, z or a direction, parent's frame; they
            need not be perpendicular

    Errors: BAD_DIRECTION, also for directions that are parallel, ZERO_AXIS, BAD_SHAPE, NON_FINITE.

    >>> jb.joints.Planar("world", first="x", second="z").motions
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
