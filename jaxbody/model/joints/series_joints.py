"""Motions in series along and about the axes of the parent and the body's reference point: points
that move, cars that heave and pitch."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.geometry import rotations
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.vectors import product
from jaxbody.model.joints.joints import Joint
from jaxbody.model.layouts import MOVES, TURNS


class Series(Joint):
    """Several motions in series, without mass between them: translations along the parent's axes,
    then rotations about the body's reference point O,

        O = O_rest + sum q_i e_i,    R = R_1(q_j) R_2(q_k) ... R_rest,

    each about an axis that the earlier rotations have turned. q: displacements [m] and angles [rad]
    from the reference pose, v = q'. A subclass states `steps`: the axis of each motion, 0, 1, 2 for
    x, y, z.
    """

    steps: eqx.AbstractClassVar[tuple[int, ...]]
    in_series = True

    def __init__(self, parent: str):
        self.parent = parent

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
    """Moving without turning: q is the displacement [m] of the body along the parent's x, y and z
    from the reference pose.

    >>> Translation("base").motions
    ('move along x', 'move along y', 'move along z')
    """

    nq, nv = 3, 3
    steps, motions, turns = (0, 1, 2), MOVES, (False,) * 3


class HeavePitch(Series):
    """A half car: q = (heave [m] along the parent's z, pitch [rad] about its y) from the reference
    pose, with the rotation about the body's reference point O. With x forward and z up, a positive
    pitch lowers the front.

    >>> HeavePitch("world").motions
    ('move along z', 'turn about y')
    """

    nq, nv = 2, 2
    steps, motions, turns = (2, 1), (MOVES[2], TURNS[1]), (False, True)


class HeavePitchRoll(Series):
    """A full car: q = (heave [m] along the parent's z, pitch [rad] about its y, roll [rad] about
    the x axis turned by the pitch) from the reference pose, with the rotations about the body's
    reference point O. With x forward, y to the left and z up (ISO 8855), a positive pitch lowers
    the front and a positive roll the right.

    >>> HeavePitchRoll("world").motions
    ('move along z', 'turn about y', 'turn about x')
    """

    nq, nv = 3, 3
    steps, motions, turns = (2, 1, 0), (MOVES[2], TURNS[1], TURNS[0]), (False, True, True)
