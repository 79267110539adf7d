"""Wheels: alignment, contact point and steering axis by ISO 8855, x forward, y to the left, z up.

With a the outward unit vector along the axis of the wheel, s = 1 on the left and -1 on the right
(so that right wheels are mirrored), and u from a lower to an upper point of the steering axis:

    camber  -atan2(a_z, s a_y)      positive if the top leans outward
    toe      atan2(a_x, s a_y)      positive if the front points inward
    caster   atan2(-u_x, u_z)       positive if the top leans backward
    kingpin  atan2(-s u_y, u_z)     positive if the top leans inward
    contact  C = center - r (z - (z . a) a)/|z - (z . a) a|

With K where the steering axis meets the ground plane through C, h the heading of the wheel and l
its outward direction, both level:

    trail    (K - C) . h            positive if the contact is behind
    scrub radius  (C - K) . l       positive if the contact is outside
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import Array, Float, checked, scalar, vector
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, in_domain, kind_of
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.points_and_orientations import direction
from jaxbody.geometry.vectors import cross, dot, rotate


class Wheel(eqx.Module):
    """A wheel on a body, for `suspension_curves`.

    Args:
        on: name of the body that carries it, the upright
        center: the center of the wheel in the frame of this body [m]
        axis: the outward direction of its axis in this frame: y on the left, [0, -1, 0] on the
            right
        radius: loaded radius, from the center to the contact [m]
        kingpin: the lower and the upper point of the steering axis in this frame [m]; None: the
            screw axis of steering, which the drive that steers moves

    Errors: NOT_POSITIVE, ZERO_AXIS, BAD_DIRECTION, BAD_SHAPE, NON_FINITE.

    >>> jb.suspension.Wheel("upright", center=[0, 0.75, 0.3], axis=[0, 1, 0], radius=0.3).on
    'upright'
    """

    on: str = eqx.field(static=True, converter=plain)
    center: Float[Array, "3"] = field("m")
    axis: Float[Array, "3"] = field("", "direction")
    radius: Float[Array, ""] = field("m", "positive")
    kingpin: Float[Array, "2 3"] | None = field("m")

    def __init__(self, on: str, *, center: Any, axis: Any, radius: Any, kingpin: Any = None):
        with Problems() as problems:
            self.on = on
            self.center = vector(center, "Wheel.center", problems)
            self.axis = direction(axis, "Wheel.axis", problems)
            self.radius = in_domain(
                scalar(radius, "Wheel.radius", problems),
                kind_of(self, "radius"),
                "Wheel.radius",
                problems,
            )
            self.kingpin = (
                None if kingpin is None else checked(kingpin, ((2, 3),), "Wheel.kingpin", problems)
            )

    def side(self, reference: Pose) -> Float[Array, ""]:
        """Return s: 1 for a wheel on the left, -1 on the right, in the reference pose."""
        return jnp.where(rotate(reference.R, self.axis)[1] < 0, -1.0, 1.0)

    def contact(self, pose: Pose) -> Float[Array, "3"]:
        """Return C, the lowest point of the wheel."""
        a = rotate(pose.R, self.axis)
        down = a * a[2] - np.array([0.0, 0, 1])
        return pose.point(self.center) + self.radius * down / jnp.sqrt(dot(down, down))

    def alignment(self, pose: Pose, s: Float[Array, ""]) -> dict[str, Array]:
        """Return the angles [rad] and positions [m] of the wheel that do not depend on the steering
        axis."""
        a, center, C = rotate(pose.R, self.axis), pose.point(self.center), self.contact(pose)
        return (
            {"camber": -jnp.arctan2(a[2], s * a[1]), "toe": jnp.arctan2(a[0], s * a[1])}
            | {f"wheel {x}": center[i] for i, x in enumerate("xyz")}
            | {f"contact {x}": C[i] for i, x in enumerate("xyz")}
        )

    def steering(
        self, pose: Pose, s: Float[Array, ""], point: Float[Array, "3"], u: Float[Array, "3"]
    ) -> dict[str, Array]:
        """Return angles [rad] and lengths [m] of the steering axis through a point along u, in the
        world."""
        u = u * jnp.where(u[2] < 0, -1.0, 1.0) / jnp.sqrt(dot(u, u))
        a, C = rotate(pose.R, self.axis), self.contact(pose)
        K = point + u * (C[2] - point[2]) / u[2]
        outward = a * np.array([1.0, 1, 0])
        outward = outward / jnp.sqrt(dot(outward, outward))
        heading = s * cross(outward, jnp.array([0.0, 0, 1]))
        return {
            "caster": jnp.arctan2(-u[0], u[2]),
            "kingpin": jnp.arctan2(-s * u[1], u[2]),
            "trail": dot(K - C, heading),
            "scrub radius": dot(C - K, outward),
        }
