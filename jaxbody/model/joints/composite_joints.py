"""Composite joints: several slides and turns, each of which moves the lines of those after it."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import Array, Float, checked
from jaxbody.core.errors import Problems
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import field
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.places import of_length_1
from jaxbody.geometry.vectors import cross, rotate
from jaxbody.model.joints.joints import Joint

STEPS = ("move", "turn")


class Composite(Joint):
    """Several motions without mass between them: q = displacements [m] and angles [rad] from the
    reference pose, v = q'. Each motion moves the lines of those after it,

        X = X_parent M_1(q_1) ... M_n(q_n) X_rest

    Args:
        parent: `world`, a support or a body
        steps: "move" or "turn" for each motion
        directions: a row for each motion: the direction along which it moves, or about which it
            turns, in the parent's frame, in the reference pose
        points: a row for each motion: a point of the line about which it turns, likewise [m];
            without effect for one that moves

    Errors: UNKNOWN_NAME, BAD_SHAPE, ZERO_AXIS, NON_FINITE. A puck on a table:

    >>> plane = Composite(
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

    @property
    def nv(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return len(self.steps)

    @property
    def motions(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return tuple(f"{step} {i + 1}" for i, step in enumerate(self.steps))

    @property
    def turns(self) -> tuple[bool, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return tuple(step == "turn" for step in self.steps)

    def _after_each(self, q: Float[Array, "n"]) -> list[Pose]:
        """1, M_1, M_1 M_2, ..."""
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
