"""Instruments between two points (displacement, length of a wire) and with laser beams from the
world (velocity, distance)."""

from typing import Any, Unpack

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import Array, Float, concrete, vector
from jaxbody.core.errors import Problem, Problems
from jaxbody.geometry.fields import field
from jaxbody.geometry.frames import Frame, Pose
from jaxbody.geometry.points_and_orientations import direction, ends
from jaxbody.geometry.vectors import cross, dot, rotate, rotate_back
from jaxbody.model.elements.elements import length_and_direction
from jaxbody.model.layouts import WORLD
from jaxbody.model.models import Model, pose_at_reference
from jaxbody.sensors.sensors import Chain, Sensor

GRAZING = 1e-6  # smallest cosine between the beam and the normal of the surface at which they meet


class Gauge(Sensor):
    """The base class of instruments between point a of one body or support and point b of another;
    `between` names the two."""

    between: tuple[str, str] = field(static=True)
    a: Float[Array, "3"] = field("m")
    b: Float[Array, "3"] = field("m")
    axis: Float[Array, "3"] | None = field("", "direction")

    def spanned(self, a: Any, b: Any, axis: Any, chain: Chain) -> None:
        kind = type(self).__name__
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), kind, problems)
            self.axis = None if axis is None else direction(axis, f"{kind}.axis", problems)
            self.chained(problems, **chain)

    @property
    def on(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.between[0]

    @property
    def names(self):
        return self.between

    def ends_of(self, model: Model, frames: Frame) -> tuple[Frame, Frame]:
        A, B = (frames[model.layout.frame(name)] for name in self.between)
        return A, B


class Displacement(Gauge):
    """Displacement [m] of a point relative to a body or support, in the axes of the latter: R_B'
    (p_a - p_B) - b, as read by an LVDT or a ruler. A Position with `relative_to` is measured from
    the origin of the latter.

    Args:
        a: (name, point), or a name for its origin
        b: the reference, in the same form; default: the origin of the world
        axis: the sensitive direction in the axes of b, for one number; None: three numbers
        chain: `gain`, `bias` (sets the zero), `delay`, `lag`, `start`: see Sensor

    Errors: UNKNOWN_NAME, SELF_SPRING, BAD_END, BAD_DIRECTION, ZERO_AXIS, BAD_SHAPE, NON_FINITE,
    BAD_CHAIN, BAD_LAG.

    >>> jb.sensors.Displacement(("plate", [0.1, 0, 0]), "base", axis=[0, 0, 1]).shape
    ()
    """

    unit = "m"

    def __init__(self, a, b=WORLD, *, axis=None, **chain: Unpack[Chain]):
        self.spanned(a, b, axis, chain)

    @property
    def shape(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (3,) if self.axis is None else ()

    def reading(self, model, frames):
        A, B = self.ends_of(model, frames)
        d = rotate_back(B.R, A.point(self.a) - B.p) - self.b
        return d if self.axis is None else dot(jnp.asarray(self.axis), d)


class StringPotentiometer(Gauge):
    """Distance |AB| [m] between two points, as measured by a wire from one to the other; at zero
    length its derivatives are zero.

    `a` and `b` are each (name, point). `gain`, `bias`, `delay`, `lag`, `start`: see Sensor.
    Errors: UNKNOWN_NAME, SELF_SPRING, BAD_END, ZERO_LENGTH in the reference pose, BAD_SHAPE,
    NON_FINITE, BAD_LAG.

    >>> jb.sensors.StringPotentiometer(("plate", [0.1, 0, 0]), ("base", [0, 0, 1])).between
    ('plate', 'base')
    """

    shape = ()
    unit = "m"

    def __init__(self, a, b, **chain: Unpack[Chain]):
        self.spanned(a, b, None, chain)

    def reading(self, model, frames):
        A, B = self.ends_of(model, frames)
        return length_and_direction(B.point(self.b) - A.point(self.a))[0]

    def problem(self, model, where):
        if (problem := super().problem(model, where)) is not None:
            return problem
        p, other = (
            concrete(pose_at_reference(model, name).point(jnp.asarray(point)))
            for name, point in zip(self.between, (self.a, self.b), strict=True)
        )
        if p is None or other is None:
            return None
        length, size = np.linalg.norm(p - other), np.abs(p).max()
        return (
            None
            if length > 1e-12 * size
            else Problem(
                "ZERO_LENGTH",
                where,
                f"has length {length:.3g} m in the reference pose, which gives it no direction",
                length,
                "> 0",
                "Move one of its points.",
            )
        )


class LaserLine(Sensor):
    """The base class of instruments with a beam fixed in the world, from `origin` along the unit
    vector `axis` n.

    The beam meets a plane surface of the body, through `point` P with `normal` N, both in body
    axes, at the spot

        S = origin + d n,   d = (P - origin) . R N/(n . R N)
    """

    on: str = eqx.field(static=True, converter=plain)
    point: Float[Array, "3"] = field("m")
    axis: Float[Array, "3"] = field("", "direction")
    origin: Float[Array, "3"] | None = field("m")
    normal: Float[Array, "3"] | None = field("", "direction")
    shape = ()

    def __init__(
        self, on: str, point=(0, 0, 0), *, axis, origin=None, normal=None, **chain: Unpack[Chain]
    ):
        kind = type(self).__name__
        with Problems() as problems:
            self.on, self.point = on, vector(point, f"{kind}.point", problems)
            self.axis = direction(axis, f"{kind}.axis", problems)
            if (origin is None) != (normal is None):
                problems.add(
                    "NO_SURFACE",
                    kind,
                    "has only one of `origin` and `normal`",
                    hint="Give both or neither.",
                )
            self.origin = None if origin is None else vector(origin, f"{kind}.origin", problems)
            self.normal = None if normal is None else direction(normal, f"{kind}.normal", problems)
            self.chained(problems, **chain)

    def distance(self, frame: Pose) -> Float[Array, ""]:
        """Return the distance d [m] from the beam's origin to the spot."""
        N = rotate(frame.R, jnp.asarray(self.normal))
        return dot(frame.point(self.point) - jnp.asarray(self.origin), N) / dot(
            jnp.asarray(self.axis), N
        )

    def problem(self, model, where):
        if (problem := super().problem(model, where)) is not None or self.normal is None:
            return problem
        R = concrete(pose_at_reference(model, self.on).R)
        axis, normal = concrete(self.axis), concrete(self.normal)
        if (
            R is None
            or axis is None
            or normal is None
            or abs(cosine := axis @ R @ normal) > GRAZING
        ):
            return None
        return Problem(
            "GRAZING",
            where,
            "has a beam parallel to the surface in the reference pose",
            cosine,
            f"|cosine to the normal| > {GRAZING:g}",
            "Turn the beam or the normal.",
        )


class LaserVibrometer(LaserLine, init=False):
    """Velocity [m/s] of a body along a beam fixed in the world, n . v, positive along `axis` n.

    Without `origin` and `normal`, v is the velocity of `point`, which is accurate while the body
    moves little across the beam. With both, v is the velocity of the body at the spot where the
    beam meets its surface.

    Args:
        on: name of the body or support
        point: position in body axes [m]
        axis: direction of the beam, in world axes: x, y, z or a vector
        origin: a point of the beam, in world axes [m]
        normal: normal of the plane surface through `point`, in body axes: x, y, z or a vector
        chain: `gain`, `bias`, `delay`, `lag`, `start`: see Sensor

    Errors: ZERO_AXIS, NO_SURFACE, GRAZING, UNKNOWN_NAME, BAD_SHAPE, NON_FINITE, BAD_LAG.

    >>> jb.sensors.LaserVibrometer("plate", [0.1, 0, 0], axis=[0, 0, 1]).unit
    'm/s'
    """

    unit = "m/s"

    def reading(self, model, frames):
        frame, n = frames[model.layout.frame(self.on)], jnp.asarray(self.axis)
        if self.normal is None:
            return dot(n, frame.velocity(self.point))
        spot = jnp.asarray(self.origin) + self.distance(frame) * n
        return dot(n, frame.v + cross(frame.w, spot - frame.p))


class LaserDistance(LaserLine):
    """Distance d [m] from the `origin` of a beam fixed in the world, along `axis`, to a plane
    surface of a body, as read by a triangulation sensor.

    Args:
        on: name of the body or support
        point: a point of the surface in body axes [m]
        origin: position of the sensor in the world [m], where d is zero
        axis: direction of the beam in the world, or x, y or z
        normal: normal of the surface in body axes
        chain: `gain`, `bias`, `delay`, `lag`, `start`: see Sensor

    Errors: those of LaserVibrometer.

    >>> jb.sensors.LaserDistance(
    ...     "plate", [0, 0, 0.1], origin=[0, 0, 1], axis=[0, 0, -1], normal=[0, 0, 1]
    ... ).unit
    'm'
    """

    unit = "m"

    def __init__(self, on: str, point=(0, 0, 0), *, origin, axis, normal, **chain: Unpack[Chain]):
        super().__init__(on, point, axis=axis, origin=origin, normal=normal, **chain)

    def reading(self, model, frames):
        return self.distance(frames[model.layout.frame(self.on)].pose())
