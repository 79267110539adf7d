"""Bushings: the relative pose of two frames, six numbers, with stiffness and damping for three of
them or as 6 x 6 matrices."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, checked
from jaxbody.core.errors import Problems
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import field
from jaxbody.geometry.orientations import IDENTITY, as_quaternion, product
from jaxbody.geometry.places import ends
from jaxbody.geometry.vectors import rotate, rotate_back
from jaxbody.model.elements.elements import MEANT, Element, check_signs, turned


class FramePair(Element):
    """The base class of elements whose deformation is the relative pose of a frame at each end,
    six numbers.

    >>> issubclass(jb.Bushing, FramePair) and issubclass(jb.Mount, FramePair)
    True
    """

    size = 6
    jump = (
        "HALF_TURN",
        "is turned by 180 degrees",
        (
            "the deformation of a bushing jumps at half a turn: for larger rotations use a joint "
            "(jb.Hinge, jb.Ball), or springs"
        ),
    )

    def deformation(self, A, B):  # pyright: ignore[reportIncompatibleMethodOverride]  its own frames
        R_A, R = turned(self, A, B)
        p = rotate_back(R_A, (B.p - A.p) + (rotate(B.R, self.b) - rotate(A.R, self.a)))
        theta = rotations.log_below_half_turn(R)
        return jnp.concatenate([rotations.inverse_left_jacobian(theta, p), theta])

    def as_drawn(self, *orientations):
        """q_b = q_B* q_A q_a, where it is not given."""
        mount: Any = self
        if mount.orientation_b is not None:
            return mount
        q_A, q_B = orientations
        q_b = product(q_B * np.array([1.0, -1.0, -1.0, -1.0]), product(q_A, mount.orientation))
        return eqx.tree_at(lambda m: m.orientation_b, mount, q_b, is_leaf=lambda x: x is None)

    def away_from_jump(self, A, B):  # pyright: ignore[reportIncompatibleMethodOverride]  its own frames
        return rotations.away_from_half_turn(turned(self, A, B)[1]) / 4


class Bushing(FramePair):
    """A linear bushing between a frame at a on one body and a frame at b on another.

        V = 1/2 e' K e,   R = 1/2 e_dot' C e_dot,
        e = log(X_A^-1 X_B) = (translation, rotation vector), axes of the frame at a

    The bushing is relaxed where the two frames coincide. e is the logarithm of SE(3): exchanging
    the ends changes only its sign.

    Args:
        a, b: (name of a body, a support or `world`, point in its frame [m])
        stiffness: K, a symmetric positive semidefinite 6 x 6 matrix, or three numbers along the
            bushing's axes [N/m], with no rotational stiffness
        damping: C likewise [N s/m]; None: no damping
        orientation: orientation of the frame at a in its body
        orientation_b: orientation of the frame at b in its body; None: that with which the two
            frames coincide as the model is drawn
        allow_negative: warn of negative coefficients instead of refusing them

    Errors: NOT_SYMMETRIC, NEGATIVE_STIFFNESS, NEGATIVE_DAMPING, SELF_SPRING, BAD_SHAPE,
    NON_FINITE, BAD_QUATERNION.

    >>> mount = Bushing(
    ...     ("engine", [0.4, 0, 0]),
    ...     ("base", [0.4, 0, 0]),
    ...     stiffness=[9e4, 2e5, 5e5],
    ...     damping=[900.0, 2000.0, 200.0],
    ... )
    >>> mount.stiffness.shape
    (3,)
    """

    stiffness: Float[Array, "*k"] = field(
        "N/m, N; N, N m/rad",
        "definite unless allow_negative",
        code="NEGATIVE_STIFFNESS",
        hint=MEANT,
    )
    damping: Float[Array, "*k"] = field(
        "N s/m, N s; N s, N m s/rad",
        "definite unless allow_negative",
        code="NEGATIVE_DAMPING",
        hint=MEANT,
    )
    orientation: Float[Array, "4"] = field("", "rotation")
    orientation_b: Float[Array, "4"] | None = field("", "rotation")
    allow_negative: bool = eqx.field(default=False, static=True)

    def __init__(
        self,
        a,
        b,
        *,
        stiffness,
        damping=None,
        orientation=IDENTITY,
        orientation_b=None,
        allow_negative: bool = False,
    ):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "Bushing", problems)
            self.stiffness = _coefficients(stiffness, "Bushing.stiffness", problems)
            self.damping = _coefficients(
                np.zeros(self.stiffness.shape) if damping is None else damping,
                "Bushing.damping",
                problems,
            )
            check_signs(self, allow_negative, problems)
            self.orientation = as_quaternion(orientation, "Bushing.orientation", problems)
            self.orientation_b = second_orientation(
                orientation_b, "Bushing.orientation_b", problems
            )

    def energy(self, e):
        return 0.5 * jnp.sum(e * _times(self.stiffness, e))

    def dissipation(self, e, e_dot):
        return 0.5 * jnp.sum(e_dot * _times(self.damping, e_dot))


def second_orientation(value: Any, where: str, problems: Problems) -> Any:
    """The unit quaternion of an orientation; None where it follows from the drawing."""
    return None if value is None else as_quaternion(value, where, problems)


def _times(coefficients: Float[Array, "*k"], e: Float[Array, "6"]) -> Float[Array, "6"]:
    """K e for a 6 x 6 matrix or for three translational coefficients."""
    if coefficients.shape == (3,):
        return jnp.concatenate([coefficients * e[:3], jnp.zeros_like(e[3:])])
    return jnp.sum(coefficients * e[None], -1)


def _coefficients(value: Any, where: str, problems: Problems) -> Any:
    array = checked(
        value,
        ((3,), (6, 6)),
        where,
        problems,
        "Give three translational coefficients or a 6 x 6 matrix.",
    )
    return np.zeros(3) if array is None else array
