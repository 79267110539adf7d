"""Torsion springs at hinges and ball joints, and the anti-roll bar of an axle."""

import jax.numpy as jnp

from jaxbody.core.arguments import warn_of_degrees
from jaxbody.core.arrays import Array, Float, scalar
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field
from jaxbody.geometry.points_and_orientations import IDENTITY, as_quaternion, direction, ends
from jaxbody.geometry.vectors import dot, rotate
from jaxbody.model.elements.elements import turned
from jaxbody.model.elements.springs import LawForces
from jaxbody.model.laws import law_states, laws


class Torsion(LawForces):
    """A torsion spring and damper between two bodies, for example at a hinge: the rotation of B
    relative to A about an axis n of A,

        e = 2 atan2(n . w, 1 + tr R) - e0,   R = R_A' R_B,   w = (R32 - R23, R13 - R31, R21 - R12),
        |e + e0| < pi

    which for a general rotation is the part about n (the twist). At half a turn e jumps by 2 pi,
    and `simulate` warns HALF_TURN. At a ball joint use a Bushing for all three axes.

    Args:
        a, b: names, or (name, point) with the point where plots show the element
        axis: n; x, y, z or a direction, in the axes of A
        spring: a law [rad -> N m], with or without memory, a stiffness [N m/rad] or a
            function; None: no spring
        damper: a law without memory [rad/s -> N m], a damping [N m s/rad] or a function
        free_angle: e0 [rad], the rotation at which the spring is relaxed; 0: where the axes of
            the two frames coincide
        orientation: orientation of the first frame's axes in A
        orientation_b: orientation of the second frame's axes in B

    Errors: NEGATIVE, ZERO_AXIS, SELF_SPRING, BAD_SHAPE, NON_FINITE, BAD_QUATERNION, MEMORY, those
    of the laws.
    Warns UNIT for a free angle of more than a turn.

    >>> spring = jb.Torsion("arm", "base", axis=[0, 0, 1], spring=30.0, damper=0.5)
    >>> spring.between
    ('arm', 'base')
    """

    jump = (
        "HALF_TURN",
        "is turned by 180 degrees",
        (
            "the angle of a torsion spring jumps at half a turn: turn `orientation` to the middle "
            "of its motion, or put two in series"
        ),
    )
    spring: laws.Law | None = field(words={"force": "N m", "argument": "rad"})
    damper: laws.Law | None = field(words={"force": "N m", "argument": "rad/s"})
    axis: Float[Array, "3"] = field("", "direction")
    free_angle: Float[Array, ""] = field("rad")
    orientation: Float[Array, "4"] = field("", "rotation")
    orientation_b: Float[Array, "4"] = field("", "rotation")

    def __init__(
        self,
        a,
        b,
        *,
        axis,
        spring=None,
        damper=None,
        free_angle=0.0,
        orientation=IDENTITY,
        orientation_b=IDENTITY,
    ):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "Torsion", problems)
            self.axis = direction(axis, "Torsion.axis", problems)
            self.spring = laws.as_law(spring, "Torsion.spring", problems)
            self.damper = law_states.as_damper(damper, "Torsion.damper", problems)
            self.free_angle = scalar(free_angle, "Torsion.free_angle", problems)
            self.orientation = as_quaternion(orientation, "Torsion.orientation", problems)
            self.orientation_b = as_quaternion(orientation_b, "Torsion.orientation_b", problems)
        warn_of_degrees(self.free_angle, "Torsion.free_angle")

    def deformation(self, A, B):  # pyright: ignore[reportIncompatibleMethodOverride]  its own frames
        sine, cosine = self._half(A, B)
        return 2 * jnp.arctan2(sine, cosine) - self.free_angle

    def away_from_jump(self, A, B):  # pyright: ignore[reportIncompatibleMethodOverride]  its own frames
        return jnp.stack(self._half(A, B)) / 4

    def _half(self, A, B):
        """Return sine and cosine of half the twist, times a number that is zero at half a turn."""
        _, R = turned(self, A, B)
        w = jnp.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        return dot(self.axis, w), 1 + jnp.trace(R)


class AntiRollBar(LawForces):
    """An anti-roll bar: it resists a difference in travel of two wheels relative to the body that
    carries the bar,

        e = n . (P_left - P_right),   n = R_body `axis`

    Args:
        left, right: (name of the wheel, point of its drop link)
        body: name of the body that carries the bar, or (name, point)
        axis: the upward direction; x, y, z or a direction, in body axes
        spring: a law, with or without memory, or the stiffness at the wheels [N/m]: torsional
            stiffness of the bar over the square of its lever arm
        damper: a law without memory, as a function of the rate, or a damping [N s/m]

    Errors: NEGATIVE, ZERO_AXIS, SELF_SPRING, BAD_SHAPE, NON_FINITE, MEMORY, those of the laws.

    >>> bar = jb.AntiRollBar(
    ...     ("left wheel", [0, -0.1, 0]), ("right wheel", [0, 0.1, 0]), "car", spring=1.2e4
    ... )
    >>> bar.between
    ('left wheel', 'right wheel', 'car')
    """

    spring: laws.Law | None = field(words={"force": "N", "argument": "m"})
    damper: laws.Law | None = field(words={"force": "N", "argument": "m/s"})
    c: Float[Array, "3"] = field("m")
    axis: Float[Array, "3"] = field("", "direction")

    def __init__(self, left, right, body, *, axis=(0, 0, 1), spring=None, damper=None):
        with Problems() as problems:
            self.between, (self.a, self.b, self.c) = ends(
                (left, right, body), "AntiRollBar", problems
            )
            self.axis = direction(axis, "AntiRollBar.axis", problems)
            self.spring = laws.as_law(spring, "AntiRollBar.spring", problems)
            self.damper = law_states.as_damper(damper, "AntiRollBar.damper", problems)

    @property
    def points(self):
        return self.a, self.b, self.c

    def deformation(self, left, right, body):  # pyright: ignore[reportIncompatibleMethodOverride]  its own frames
        return dot(rotate(body.R, self.axis), left.point(self.a) - right.point(self.b))
