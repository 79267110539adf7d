"""Bushings and mounts: the relative pose of two frames, six numbers, with stiffness and damping for
three of them, as 6 x 6 matrices, or with a law for each."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, checked, module_of
from jaxbody.core.errors import Problems
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import field, in_domain, kind_of
from jaxbody.geometry.points_and_orientations import (
    DIRECTIONS,
    IDENTITY,
    as_quaternion,
    ends,
    product,
)
from jaxbody.geometry.vectors import rotate, rotate_back
from jaxbody.model.elements.elements import MEANT, Element, check_signs, turned
from jaxbody.model.elements.springs import LawForces
from jaxbody.model.laws import law_states, laws


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
        """Return the element with the orientation q_b = q_B* q_A q_a of its second frame, with
        which the two frames coincide as drawn, unless it is given."""
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
        e = log(X_A^-1 X_B) = (translation, rotation vector), in the axes of the frame at a

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

    >>> mount = jb.Bushing(
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
            self.orientation_b = _second(orientation_b, "Bushing.orientation_b", problems)

    def energy(self, e):
        return 0.5 * jnp.sum(e * _times(self.stiffness, e))

    def dissipation(self, e, e_dot):
        return 0.5 * jnp.sum(e_dot * _times(self.damping, e_dot))


def _second(value: Any, where: str, problems: Problems) -> Any:
    """Return the unit quaternion of the second frame's orientation, or None if none is given and it
    follows from the reference poses."""
    return None if value is None else as_quaternion(value, where, problems)


def _times(coefficients: Float[Array, "*k"], e: Float[Array, "6"]) -> Float[Array, "6"]:
    """Return K e for a 6 x 6 matrix or for three translational coefficients."""
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


FORCES, MOMENTS = {"force": "N", "argument": "m"}, {"force": "N m", "argument": "rad"}


class Mount(FramePair, LawForces):  # pyright: ignore[reportIncompatibleMethodOverride]
    """A mount between a frame at a on one body and a frame at b on another, with a law for each of
    its six deformations,

        V = sum U_i(e_i),   R = 1/2 sum c_i e_i'^2 + what laws with memory add,
        e as for a Bushing, in the axes of the frame at a

    It is relaxed where the two frames coincide, unless a law has a force at zero.

    Args:
        a, b: (name of a body, a support or `world`, point in its frame [m])
        x, y, z: laws along the axes [m -> N], with or without memory, stiffnesses [N/m] or
            functions; None: no force
        rx, ry, rz: laws about the axes [rad -> N m], stiffnesses [N m/rad] or functions; None:
            no moment
        damping: c, six coefficients along and about the axes [N s/m, N m s/rad], or three along
            them; None: no damper
        orientation: orientation of the frame at a in its body
        orientation_b: orientation of the frame at b in its body; None: that with which the two
            frames coincide as the model is drawn

    Errors: NEGATIVE, SELF_SPRING, BAD_SHAPE, NON_FINITE, BAD_QUATERNION, those of the laws.

    >>> rubber = jb.laws.Linear(4e5) + jb.laws.Maxwell(stiffness=2e5, relaxation_time=2e-3)
    >>> mount = jb.Mount(
    ...     ("engine", [0.4, 0, 0]),
    ...     ("base", [0.4, 0, 0]),
    ...     x=1e5,
    ...     y=1e5,
    ...     z=rubber + jb.laws.BumpStop(gap=0.01, stiffness=5e6),
    ... )
    >>> mount.between
    ('engine', 'base')
    """

    x: laws.Law | None = field(words=FORCES)
    y: laws.Law | None = field(words=FORCES)
    z: laws.Law | None = field(words=FORCES)
    rx: laws.Law | None = field(words=MOMENTS)
    ry: laws.Law | None = field(words=MOMENTS)
    rz: laws.Law | None = field(words=MOMENTS)
    damping: Float[Array, "6"] = field("N s/m, N m s/rad", "nonnegative")
    orientation: Float[Array, "4"] = field("", "rotation")
    orientation_b: Float[Array, "4"] | None = field("", "rotation")

    def __init__(
        self,
        a,
        b,
        *,
        x=None,
        y=None,
        z=None,
        rx=None,
        ry=None,
        rz=None,
        damping=None,
        orientation=IDENTITY,
        orientation_b=None,
    ):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "Mount", problems)
            for name, law in zip(DIRECTIONS, (x, y, z, rx, ry, rz), strict=True):
                setattr(self, name, laws.as_law(law, f"Mount.{name}", problems))
            self.damping = in_domain(
                _damping(damping, problems), kind_of(self, "damping"), "Mount.damping", problems
            )
            self.orientation = as_quaternion(orientation, "Mount.orientation", problems)
            self.orientation_b = _second(orientation_b, "Mount.orientation_b", problems)

    def _each(self, function, *e) -> list[Any]:
        """Return function(law, ...) for each of the six laws and its deformation."""
        return [
            function(getattr(self, name), *(x[i] for x in e)) for i, name in enumerate(DIRECTIONS)
        ]

    def energy(self, e):
        return sum(self._each(laws.potential, e), jnp.zeros((), e.dtype))

    def static_force(self, e):
        return jnp.stack(self._each(laws.force, e))

    def tangent(self, e):
        return jnp.diag(jnp.stack(self._each(laws.slope, e)))

    def beyond(self, e, e_dot):
        return jnp.stack(self._each(laws.beyond, e)).any()

    def dissipation(self, e, e_dot):
        each = self._each(
            lambda law, x, x_dot: law_states.dissipation(law, None, x, x_dot), e, e_dot
        )
        return sum(each, 0.5 * jnp.sum(self.damping * e_dot**2))

    def damping_force(self, e, e_dot):
        return (
            jnp.stack(
                self._each(
                    lambda law, x, x_dot: law_states.rate_force(law, None, x, x_dot), e, e_dot
                )
            )
            + self.damping * e_dot
        )

    def lost_power(self, *frames):
        e, e_dot = self.rates(*frames)
        return sum(
            self._each(lambda law, x, x_dot: law_states.lost_power(law, None, x, x_dot), e, e_dot),
            jnp.sum(self.damping * e_dot**2),
        )

    def inner(self, e, e_dot):
        with_rows = [
            i for i, name in enumerate(DIRECTIONS) if law_states.has_rows(getattr(self, name))
        ]
        each = [law_states.inner(getattr(self, DIRECTIONS[i]), e[i], e_dot[i]) for i in with_rows]
        unit = np.eye(6, dtype=e.dtype)

        def rows(k):
            return jnp.concatenate(
                [one[k][:, None] * unit[i][None] for i, one in zip(with_rows, each, strict=True)]
            )

        from jax.scipy.linalg import block_diag  # for the few models with inner coordinates

        V_yy, R_yy, T_yy = (block_diag(*(one[k] for one in each)) for k in (1, 3, 4))
        return rows(0), V_yy, rows(2), R_yy, T_yy


def _damping(value: Any, problems: Problems) -> Any:
    """Return the damping coefficients along and about the three axes."""
    array = checked(
        np.zeros(6) if value is None else value,
        ((3,), (6,)),
        "Mount.damping",
        problems,
        "Give three coefficients along the axes, or six.",
    )
    if array is None:
        return np.zeros(6)
    return module_of(array).concatenate([array, np.zeros(6 - len(array))])
