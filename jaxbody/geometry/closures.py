"""Closures: joints and rods that close loops, as conditions c(X_A, X_B) = 0 on the poses of two
frames, and couplings of two coordinates.

The joints of a model form a tree; a closure is an additional connection between two of its frames.
With the points a and b, each in its own frame, and the rotation R of B on A from the reference
pose, both in the axes of A:

    d = R_A' (x_b - x_a)
    R = R_A' R_B R_0',   R_0 = R_A' R_B in the reference pose

In the reference pose, as it is drawn, R is the identity and the points need not coincide:
`assemble` moves them together.
"""

import copy
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import Array, Float, scalar
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, in_domain, kind_of
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.points_and_orientations import direction, ends
from jaxbody.geometry.vectors import axial, cross, dot, product, rotate, rotate_back

__all__ = ["Ball", "Closure", "Coupling", "Equation", "Guide", "Hinge", "Inline", "Rod", "Weld"]


def __dir__():
    return __all__


class Closure(eqx.Module):
    """The base class of closures between two frames, named in `between`, at the points `a` and `b`
    in their axes.

    A closure of your own states `rows`, a description of each condition, and `gap`, the values of
    the conditions, in meters. A wheel that rolls on a rail of height 0.1 m:

    >>> class OnRail(jb.closures.Closure):
    ...     rows = ("height",)
    ...     def gap(self, A, B, rest):
    ...         return self.offset(A, B)[2:] - 0.1
    >>> OnRail(("world", "wheel"), jnp.zeros(3), jnp.zeros(3)).between
    ('world', 'wheel')
    """

    between: tuple[str, ...] = eqx.field(static=True)
    rows: eqx.AbstractClassVar[tuple[str, ...]]
    a: Float[Array, "3"] = field("m")
    b: Float[Array, "3"] = field("m")

    @property
    def points(self) -> tuple[Float[Array, "*rows 3"], ...]:
        """The points that it joins, one in each frame."""
        return self.a, self.b

    @abstractmethod
    def gap(self, A: Pose, B: Pose, rest: Pose) -> Float[Array, "rows"]:
        """Return c, zero where the loop is closed: lengths [m], or sines of angles where a
        description begins with "turn"; `rest` is the pose of B relative to A in the reference
        pose."""

    def offset(self, A: Pose, B: Pose) -> Float[Array, "3"]:
        """Return d, from a to b in the axes of A."""
        return rotate_back(A.R, (B.p - A.p) + (rotate(B.R, self.b) - rotate(A.R, self.a)))


class AlongAxis(Closure):
    """The base class of closures with an axis n, in the frame of their first end."""

    axis: Float[Array, "3"] = field("", "direction")

    def __init__(self, a, b, *, axis):
        kind = type(self).__name__
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), kind, problems)
            self.axis = direction(axis, f"{kind}.axis", problems)


class Ball(Closure):
    """A ball joint (spherical joint): points a and b coincide, d = 0.

    Args:
        a, b: (name of a body, a support or `world`, point in its frame [m])

    Errors: BAD_END, SELF_SPRING, BAD_SHAPE, NON_FINITE.

    >>> jb.closures.Ball(("upper arm", [0, 0.4, 0]), ("upright", [0, 0, 0.3])).rows
    ('x', 'y', 'z')
    """

    rows = ("x", "y", "z")

    def __init__(self, a, b):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "Ball", problems)

    def gap(self, A, B, rest):
        return self.offset(A, B)


class Hinge(AlongAxis):
    """A hinge (revolute joint): points a and b coincide, and B turns relative to A about n only,
    with d = 0 and t . R n = 0 for the two directions t across n.

    Args:
        a, b: (name of a body, a support or `world`, point in its frame [m])
        axis: n, x, y, z or a direction, in the frame of the first end

    Errors: BAD_END, SELF_SPRING, ZERO_AXIS, BAD_DIRECTION, BAD_SHAPE, NON_FINITE.

    >>> jb.closures.Hinge(("coupler", [0.12, 0, 0]), ("rocker", [0.08, 0, 0]), axis="z").rows
    ('x', 'y', 'z', 'turn 1', 'turn 2')
    """

    __init__ = AlongAxis.__init__  # for type checkers
    rows = ("x", "y", "z", "turn 1", "turn 2")

    def gap(self, A, B, rest):
        n = rotate(_turn(A, B, rest), self.axis)
        return jnp.concatenate([self.offset(A, B), _across(self.axis, n)])


class Guide(AlongAxis):
    """A guide (prismatic joint): B slides on A along n and does not turn, with t . d = 0 for the
    two directions t across n, and R = 1.

    Args:
        a, b: (name of a body, a support or `world`, point in its frame [m])
        axis: n, x, y, z or a direction, in the frame of the first end

    Errors: BAD_END, SELF_SPRING, ZERO_AXIS, BAD_DIRECTION, BAD_SHAPE, NON_FINITE.

    >>> len(jb.closures.Guide(("housing", [0, 0, 0]), ("rack", [0, 0, 0]), axis="y").rows)
    5
    """

    __init__ = AlongAxis.__init__  # for type checkers
    rows = ("across 1", "across 2", "turn x", "turn y", "turn z")

    def gap(self, A, B, rest):
        return jnp.concatenate([_across(self.axis, self.offset(A, B)), axial(_turn(A, B, rest))])


class Inline(AlongAxis):
    """A point on a line: the point b of B slides along the line through a of A in the direction n,
    as the top of a strut does, with t . d = 0 for the two directions t across n.

    Args:
        a, b: (name of a body, a support or `world`, point in its frame [m])
        axis: n, x, y, z or a direction, in the frame of the first end

    Errors: BAD_END, SELF_SPRING, ZERO_AXIS, BAD_DIRECTION, BAD_SHAPE, NON_FINITE.

    >>> jb.closures.Inline(("upright", [0, 0, 0]), ("world", [0, 0, 0.6]), axis="z").rows
    ('across 1', 'across 2')
    """

    __init__ = AlongAxis.__init__  # for type checkers
    rows = ("across 1", "across 2")

    def gap(self, A, B, rest):
        return _across(self.axis, self.offset(A, B))


class Weld(Closure):
    """A rigid connection: B is fixed on A with b at a and with the orientation of the reference
    pose, with d = 0 and R = 1.

    Args:
        a, b: (name of a body, a support or `world`, point in its frame [m])

    Errors: BAD_END, SELF_SPRING, BAD_SHAPE, NON_FINITE.

    >>> len(jb.closures.Weld(("left half", [0, 0, 0]), ("right half", [0, 0, 0])).rows)
    6
    """

    rows = (*Ball.rows, "turn x", "turn y", "turn z")

    def __init__(self, a, b):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "Weld", problems)

    def gap(self, A, B, rest):
        return jnp.concatenate([self.offset(A, B), axial(_turn(A, B, rest))])


class Rod(Closure):
    """A rod without mass between a and b, with a ball joint at each end: (d . d - L^2)/(2 L) = 0.

    Args:
        a, b: (name of a body, a support or `world`, point in its frame [m])
        length: L [m]; None: the distance of the points in the reference pose

    Errors: NOT_POSITIVE, BAD_END, SELF_SPRING, BAD_SHAPE, NON_FINITE; when the model is built,
    ZERO_LENGTH if that distance is zero.

    >>> jb.closures.Rod(("rack", [0, 0.2, 0]), ("upright", [0.15, 0, 0])).rows
    ('length',)
    """

    length: Float[Array, ""] | None = field("m", "positive")
    rows = ("length",)

    def __init__(self, a, b, *, length=None):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "Rod", problems)
            self.length = (
                None
                if length is None
                else in_domain(
                    scalar(length, "Rod.length", problems),
                    kind_of(self, "length"),
                    "Rod.length",
                    problems,
                )
            )

    def gap(self, A, B, rest):
        d = self.offset(A, B)
        drawn = rest.point(self.b) - self.a
        L = jnp.sqrt(dot(drawn, drawn)) if self.length is None else self.length
        return ((dot(d, d) - L**2) / (2 * L))[None]


class Equation(Closure):
    """A condition of your own: function(A, B) = 0, with the poses of two frames (p, R and `point`),
    in meters.

    Args:
        function: from two poses to a number or a row of numbers
        between: the names of the two frames

    Errors: BAD_END, SELF_SPRING; when the model is built, NON_FINITE if the condition has no finite
    derivatives in the reference pose, such as |x| at 0.

    A point at a distance of 2 m from another:

    >>> sphere = jb.closures.Equation(
    ...     lambda A, B: jnp.linalg.norm(B.p - A.point(jnp.array([1.0, 0, 0]))) - 2.0,
    ...     ("world", "ball"),
    ... )
    >>> sphere.rows
    ('equation 1',)
    """

    function: Callable[..., Any] = field(static=True)
    rows: tuple[str, ...] = field(static=True)  # pyright: ignore[reportIncompatibleVariableOverride]

    def __init__(self, function: Callable[..., Any], between: tuple[str, str]):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends(between, "Equation", problems)
        self.function = function
        pose = Pose(jnp.zeros(3), jnp.eye(3))
        values = jax.eval_shape(lambda A, B: jnp.atleast_1d(function(A, B)), pose, pose)
        self.rows = tuple(f"equation {i + 1}" for i in range(values.shape[0]))

    def gap(self, A, B, rest):
        return jnp.atleast_1d(self.function(A, B))


class Coupling(Closure):
    """A coupling of two joint coordinates, such as those of a rack and its pinion or of two gears:
    x - f(y) = 0.

    Coordinates count from the reference pose, turns of any number included. They are named as in
    `suspension_curves`: "rack.q" for the one of a joint, "nut.q.0", "nut.q.1" for those of a joint
    with several (not the numbers of a quaternion). The forces act along the coordinates, between a
    body and the body or support that carries it, as the force of a drive in the joint does. They
    are part of the reaction of the joint.

    Args:
        of: x, such as "rack.q"
        by: y, such as "pinion.q"
        ratio: f(y) = ratio y [unit of x by that of y]: for a rack the radius of its pinion, for two
            outer gears minus the ratio of their teeth, for a screw its pitch/(2 pi)
        function: f instead, a JAX function, or a law whose force is then x, such as the measured
            curve `jb.laws.Tabulated(y, x)`

    Errors: WRONG_KIND unless one of ratio and function is given, UNKNOWN_NAME where the model has
    no such coordinate, BAD_SHAPE, NON_FINITE.

    >>> jb.closures.Coupling("rack.q", "pinion.q", ratio=0.008).between
    ('rack', 'pinion')
    """

    of: str = field(static=True)
    by: str = field(static=True)
    ratio: Float[Array, ""] | None = field("force/argument")  # as in laws: of x by y
    function: Any = field()
    rows: tuple[str, ...] = field(static=True)  # pyright: ignore[reportIncompatibleVariableOverride]

    def __init__(self, of: str, by: str, *, ratio=None, function: Any = None):
        with Problems() as problems:
            self.of, self.by, self.rows = plain(of), plain(by), ("move",)
            self.between = tuple(str(path).partition(".q")[0] for path in (self.of, self.by))
            self.a, self.b = np.zeros(3), np.zeros(3)
            self.ratio = None if ratio is None else scalar(ratio, "Coupling.ratio", problems)
            self.function = function
            if (ratio is None) == (function is None):
                problems.add(
                    "WRONG_KIND",
                    "Coupling",
                    "needs a ratio or a function",
                    limit="one of them",
                    hint="Give ratio=... for f(y) = ratio y, or function=... for another f.",
                )

    def counted_in(self, unit: str) -> "Coupling":
        """Return the coupling with x in this unit."""
        changed = copy.copy(self)
        object.__setattr__(changed, "rows", ("turn",) if unit == "rad" else ("move",))
        return changed

    def gap(self, A, B, rest):
        x, y = A.p[0], B.p[0]
        function = getattr(self.function, "force", self.function)
        return (x - (function(y) if self.ratio is None else self.ratio * y))[None]


def as_slide(x: Float[Array, "n"]) -> Pose:
    """Return coordinates x as the poses that couplings read, with p = (x, 0, 0)."""
    zero = jnp.zeros_like(x)
    return Pose(
        jnp.stack([x, zero, zero], -1),
        jnp.broadcast_to(jnp.asarray(np.eye(3, dtype=x.dtype)), (*x.shape, 3, 3)),
    )


def _turn(A: Pose, B: Pose, rest: Pose) -> Float[Array, "3 3"]:
    """Return the rotation of B relative to A since the reference pose, in the axes of A."""
    return product(product(A.R.T, B.R), rest.R.T)


def _across(n: Float[Array, "3"], d: Float[Array, "3"]) -> Float[Array, "2"]:
    """Return the components of d along two directions across n: t_1, across the axis that is
    farthest from n, and n x t_1."""
    farthest = jnp.asarray(np.eye(3, dtype=n.dtype))[jnp.argmin(jnp.abs(n))]
    t = cross(n, farthest)
    t = t / jnp.sqrt(dot(t, t))
    return jnp.stack([dot(t, d), dot(cross(n, t), d)])
