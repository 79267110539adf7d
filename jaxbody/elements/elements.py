"""Springs and bushings. An element states one geometric function, its deformation e(A, B) between two frames (or more), its potential
energy V(e) and its dissipation R(e, e_dot); forces, stiffness and the rest are derivatives.

Points and orientations of an element are in the frame of the body or support that its end is on.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbody.core.arrays import checked, concrete, scalar
from jaxbody.core.errors import Problems, warn
from jaxbody.geometry import rotations
from jaxbody.geometry.frames import Frame, Pose, Wrench
from jaxbody.geometry.orientations import IDENTITY, as_quaternion
from jaxbody.geometry.places import ends
from jaxbody.geometry.vectors import cross, dot, product, rotate, rotate_back
from jaxbody.laws import laws
from jaxbody.numerics.elementary_functions import inverse_root
from jaxbody.numerics.lane_marks import kept


class Element(eqx.Module):
    """The base of all elements between frames A and B, or more; `between` names them, `a` and `b` are the points where it is attached.

    An element of your own states `deformation`, `energy` and `dissipation`; forces and stiffness are their derivatives. Two equal charges, one
    of them hovering over the other where strength / e^2 = m g:

    >>> class Charges(Element):
    ...     strength: jax.Array  # N m2
    ...     def deformation(self, A, B):
    ...         return jnp.linalg.norm(B.point(self.b) - A.point(self.a))
    ...     def energy(self, e):
    ...         return self.strength / e
    ...     def dissipation(self, e, e_dot):
    ...         return jnp.zeros_like(e)
    >>> model = Model(bodies={"ball": Body(mass=0.2, inertia=[1, 1, 1], position=[0, 0, 0.6])}, joints={"ball": Guide("world", axis=[0, 0, 1])},
    ...               elements={"pair": Charges(("ball", "world"), jnp.zeros(3), jnp.zeros(3), jnp.array(0.5))}, gravity=[0, 0, -10])
    >>> round(float(equilibrium(model).elongations["pair"]), 9)
    0.5
    """

    between: tuple[str, ...] = eqx.field(static=True)
    size: ClassVar[int] = 1  # of the deformation
    jump: ClassVar[tuple[str, str, str] | None] = None  # code, what it is where its force jumps, and what to do about it
    a: Float[Array, "3"]
    b: Float[Array, "3"]

    @property
    def points(self) -> tuple[Float[Array, "3"], ...]:
        """Where it is attached, a point in each frame."""
        return self.a, self.b

    @abstractmethod
    def deformation(self, *poses: Pose) -> Float[Array, "*m"]:
        """The geometric function e."""

    @abstractmethod
    def energy(self, e: Float[Array, "*m"]) -> Float[Array, ""]:
        """V(e) [J]."""

    @abstractmethod
    def dissipation(self, e: Float[Array, "*m"], e_dot: Float[Array, "*m"]) -> Float[Array, ""]:
        """R(e, e_dot) [W], half the dissipated power where damping is linear."""

    def beyond(self, e: Float[Array, "*m"], e_dot: Float[Array, "*m"]) -> Bool[Array, ""]:
        """True where a law is used beyond what it is known for."""
        return jnp.array(False)

    def away_from_jump(self, *poses: Pose) -> Float[Array, "*n"]:
        """A vector that passes through zero where the force jumps, as `jump` says; its length is about 1 far from there."""
        return jnp.ones(1)

    def potential(self, *poses: Pose) -> Float[Array, ""]:
        """V of the poses."""
        return self.energy(self.deformation(*poses))

    def rates(self, *frames: Frame) -> tuple[Float[Array, "*m"], Float[Array, "*m"]]:
        """e and e_dot, the derivative of e along the motion of the frames."""
        return jax.jvp(self.deformation, tuple(f.pose() for f in frames), tuple(f.rates() for f in frames))

    def damping_force(self, e: Float[Array, "*m"], e_dot: Float[Array, "*m"]) -> Float[Array, "*m"]:
        """dR/de_dot."""
        return jax.grad(self.dissipation, argnums=1)(e, e_dot)

    def force(self, *frames: Frame) -> Float[Array, "*m"]:
        """dV/de + dR/de_dot, what the element exerts against its deformation: of a spring the tension [N]."""
        e, e_dot = self.rates(*frames)
        return jax.grad(self.energy)(e) + self.damping_force(e, e_dot)

    def lost_power(self, *frames: Frame) -> Float[Array, ""]:
        """dR/de_dot . e_dot [W]."""
        e, e_dot = self.rates(*frames)
        return jnp.sum(self.damping_force(e, e_dot) * e_dot)

    def wrenches(self, *frames: Frame) -> tuple[Wrench, ...]:
        """What the element exerts on each frame: minus the derivatives of V and R, carried from e to the frames."""
        _, pull = jax.vjp(self.deformation, *(f.pose() for f in frames))
        return tuple(_wrench(on, f.R) for on, f in zip(pull(-self.force(*frames)), frames, strict=True))


def _wrench(cotangent: Pose, R: Float[Array, "3 3"]) -> Wrench:
    """Force and moment of a cotangent of a pose: the moment is the sum over the columns of R x its cotangent."""
    return cotangent.p, cross(R.T, cotangent.R.T).sum(0)


class LineElement(Element):
    """The base of elements along the line from the point a of one body to the point b of another: e = |AB| - l0.

    A tension T(L) along it is split, T = k0 L + rest, so that the force k0 d + rest d/L has the right derivatives at d = 0 where the rest
    vanishes with L.
    """

    free_length: Float[Array, ""]
    jump = (
        "SPRING_COLLAPSED",
        "has shrunk to a point",
        "its direction jumps there: let its ends pass beside each other, hold them apart by a stop, or use a Bushing",
    )

    @abstractmethod
    def split(self, L: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
        """k0, the rest of the tension and its derivative in L."""

    @abstractmethod
    def damper_tension(self, e: Float[Array, ""], e_dot: Float[Array, ""]) -> Float[Array, ""]:
        """dR/de_dot."""

    def has_no_direction(self) -> bool:
        """True when it neither pulls nor damps at zero length, and so needs no direction there (of numbers that can be seen)."""
        return False

    def length(self, A: Pose, B: Pose) -> Float[Array, ""]:
        """|AB|, its derivatives zero at zero length."""
        return length_and_direction(B.point(self.b) - A.point(self.a))[0]

    def deformation(self, A, B):
        """The elongation s = |AB| - l0 (31)."""
        return self.length(A, B) - self.free_length

    def away_from_jump(self, A, B):
        """AB over the free length; where it neither pulls nor pushes at zero length, nothing jumps."""
        _, rest, _ = self.split(jnp.zeros_like(self.free_length))
        jumps = (self.free_length > 0) & (rest != 0)
        return jnp.where(jumps, (B.point(self.b) - A.point(self.a)) / jnp.where(jumps, self.free_length, 1.0), 1.0)

    def damping_force(self, e, e_dot):
        return self.damper_tension(e, e_dot)

    def potential(self, A, B):
        d = B.point(self.b) - A.point(self.a)
        L, _ = length_and_direction(d)
        k0, _, _ = self.split(L)
        without_norm = 0.5 * k0 * dot(d, d) + (self.energy(L - self.free_length) - 0.5 * k0 * L**2)  # exact at d = 0 where l0 = 0
        return jnp.where(self.free_length == 0, without_norm, self.energy(L - self.free_length))

    def wrenches(self, A, B):
        """Closed form: the tension along AB."""
        arm_a, arm_b = rotate(A.R, self.a), rotate(B.R, self.b)
        d = kept((B.p - A.p) + (arm_b - arm_a))
        rate = kept((B.v - A.v) + (cross(B.w, arm_b) - cross(A.w, arm_a)))
        L, u = length_and_direction(d)
        k0, rest, _ = self.split(L)
        force = kept(k0 * d + (self.damper_tension(L - self.free_length, dot(u, rate)) + rest) * u)
        return (force, cross(arm_a, force)), (-force, cross(force, arm_b))


class Spring(LineElement):
    """A line spring with viscous damping between the point a of one body and the point b of another.

        V = 1/2 k (|AB| - l0)^2,   R = 1/2 c (d|AB|/dt)^2,   tension = k (|AB| - l0) + c d|AB|/dt

    `stiffness` k [N/m], `free_length` l0 [m], `damping` c [N s/m]. With l0 = 0 the spring is exact down to zero length, where
    its damper has no direction and exerts nothing. Errors: NEGATIVE_STIFFNESS, NEGATIVE_DAMPING (warnings with `allow_negative`),
    NEGATIVE_LENGTH, SELF_SPRING, BAD_SHAPE, NON_FINITE. Source: (20)-(28) of the paper.

    >>> spring = Spring(("plate", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=100.0, free_length=0.8)
    """

    stiffness: Float[Array, ""]
    damping: Float[Array, ""]

    def __init__(self, a, b, *, stiffness, free_length=0.0, damping=0.0, allow_negative: bool = False):
        problems = Problems()
        self.between, (self.a, self.b) = ends((a, b), "Spring", problems)
        self.stiffness = scalar(stiffness, "Spring.stiffness", problems)
        self.free_length = free_length_of(free_length, "Spring", problems)
        self.damping = scalar(damping, "Spring.damping", problems)
        for name, unit in (("stiffness", "N/m"), ("damping", "N s/m")):
            value = concrete(getattr(self, name))
            if value is not None and value < 0:
                _negative("Spring", name, f"is {value:g} {unit}", float(value), allow_negative, problems)
        problems.raise_if_any()

    def energy(self, e):
        return 0.5 * self.stiffness * e**2

    def dissipation(self, e, e_dot):
        return 0.5 * self.damping * e_dot**2

    def split(self, L):
        return self.stiffness, -self.stiffness * self.free_length, jnp.zeros_like(L)

    def damper_tension(self, e, e_dot):
        return self.damping * e_dot

    def has_no_direction(self):
        return bool(self.damping == 0)


class SpringDamper(LineElement):
    """A line element whose spring and damper follow laws: a strut with its bump stop, a rope, an air spring.

        V = U_s(|AB| - l0),   R = U_d(d|AB|/dt),   tension = F_s(|AB| - l0) + F_d(d|AB|/dt)

    `spring` and `damper`: laws (jb.laws), numbers for linear ones [N/m], [N s/m], or JAX functions x -> F; either may be missing. `free_length` l0
    [m], the length at which the spring's law has x = 0. Errors: NEGATIVE, NEGATIVE_LENGTH, SELF_SPRING, BAD_SHAPE, NON_FINITE, those of the laws.

    >>> strut = SpringDamper(("car", [1.4, 0.7, 0]), ("wheel", [0, 0, 0]), free_length=0.5,
    ...                      spring=laws.Linear(2e4) + laws.Stop(gap=0.08, stiffness=1e5, engagement=0.01), damper=laws.TwoSided(bump=900.0, rebound=2100.0))
    >>> float(strut.spring.force(jnp.array(-0.1)))
    -3500.0
    """

    spring: laws.Law | None
    damper: laws.Law | None

    def __init__(self, a, b, *, spring=None, damper=None, free_length=0.0):
        problems = Problems()
        self.between, (self.a, self.b) = ends((a, b), "SpringDamper", problems)
        self.free_length = free_length_of(free_length, "SpringDamper", problems)
        self.spring = laws.as_law(spring, "SpringDamper.spring", problems)
        self.damper = laws.as_law(damper, "SpringDamper.damper", problems)
        problems.raise_if_any()

    def energy(self, e):
        return laws.potential(self.spring, e)

    def dissipation(self, e, e_dot):
        return laws.potential(self.damper, e_dot)

    def beyond(self, e, e_dot):
        return laws.beyond(self.spring, e) | laws.beyond(self.damper, e_dot)

    def split(self, L):
        e = L - self.free_length
        k0 = jnp.where(self.free_length == 0, laws.slope(self.spring, jnp.zeros_like(L)), 0.0)
        return k0, laws.force(self.spring, e) - k0 * L, laws.slope(self.spring, e) - k0

    def damper_tension(self, e, e_dot):
        return laws.force(self.damper, e_dot)

    def has_no_direction(self):
        return self.damper is None and bool(laws.force(self.spring, jnp.zeros(())) == 0)


def length_and_direction(d: Float[Array, "3"]) -> tuple[Float[Array, ""], Float[Array, "3"]]:
    """|d| and d/|d|, both zero with zero derivatives at d = 0."""
    square = dot(d, d)
    inverse = inverse_root(square)
    return square * inverse, d * inverse


class Bushing(Element):
    """A linear bushing between a frame at a on one body and a frame at b on another.

        V = 1/2 e' K e,   R = 1/2 e_dot' C e_dot,   e = log(X_A^-1 X_B) = (translation, rotation vector), axes of the frame at a

    `stiffness` K and `damping` C: 6 x 6 matrices, symmetric and positive semidefinite, or three numbers: translational along the
    bushing's axes [N/m], [N s/m], no resistance to turning. `orientation` (of the frame at a in its body) and `orientation_b`
    give the axes; the bushing is relaxed where the two frames coincide. e is the logarithm of SE(3): exchanging the ends changes only its sign.
    Errors: NOT_SYMMETRIC, NEGATIVE_STIFFNESS, NEGATIVE_DAMPING, SELF_SPRING, BAD_SHAPE, NON_FINITE, BAD_QUATERNION.

    >>> mount = Bushing(("engine", [0.4, 0, 0]), ("base", [0.4, 0, 0]), stiffness=[9e4, 2e5, 5e5], damping=[900.0, 2000.0, 200.0])
    >>> mount.stiffness.shape
    (3,)
    """

    size = 6
    jump = (
        "HALF_TURN",
        "is turned by 180 degrees",
        "a bushing is for less than half a turn, where its deformation jumps: let a joint (jb.Hinge, jb.Ball) guide what turns further, or hold it by springs",
    )
    stiffness: Float[Array, "*k"]
    damping: Float[Array, "*k"]
    orientation: Float[Array, "4"]
    orientation_b: Float[Array, "4"]

    def __init__(self, a, b, *, stiffness, damping=None, orientation=IDENTITY, orientation_b=IDENTITY, allow_negative: bool = False):
        problems = Problems()
        self.between, (self.a, self.b) = ends((a, b), "Bushing", problems)
        self.stiffness = _coefficients(stiffness, "stiffness", allow_negative, problems)
        damping = np.zeros(self.stiffness.shape) if damping is None else damping
        self.damping = _coefficients(damping, "damping", allow_negative, problems)
        self.orientation = as_quaternion(orientation, "Bushing.orientation", problems)
        self.orientation_b = as_quaternion(orientation_b, "Bushing.orientation_b", problems)
        problems.raise_if_any()

    def deformation(self, A, B):
        R_A, R = turned(self, A, B)
        p = rotate_back(R_A, (B.p - A.p) + (rotate(B.R, self.b) - rotate(A.R, self.a)))
        theta = rotations.log_below_half_turn(R)
        return jnp.concatenate([rotations.inverse_left_jacobian(theta, p), theta])

    def away_from_jump(self, A, B):
        return rotations.away_from_half_turn(turned(self, A, B)[1]) / 4

    def energy(self, e):
        return 0.5 * jnp.sum(e * _times(self.stiffness, e))

    def dissipation(self, e, e_dot):
        return 0.5 * jnp.sum(e_dot * _times(self.damping, e_dot))


def turned(element: Any, A: Pose, B: Pose) -> tuple[Float[Array, "3 3"], Float[Array, "3 3"]]:
    """The axes at the first end of an element with `orientation` and `orientation_b`, to the world, and those at the second end to them."""
    R_A, R_B = product(A.R, rotations.matrix(element.orientation)), product(B.R, rotations.matrix(element.orientation_b))
    return R_A, product(jnp.swapaxes(R_A, -1, -2), R_B)


def _times(coefficients: Float[Array, "*k"], e: Float[Array, "6"]) -> Float[Array, "6"]:
    """K e for a 6 x 6 matrix or for three translational coefficients."""
    if coefficients.shape == (3,):
        return jnp.concatenate([coefficients * e[:3], jnp.zeros_like(e[3:])])
    return jnp.sum(coefficients * e, -1)


def _coefficients(value: Any, name: str, allow_negative: bool, problems: Problems) -> Any:
    where = f"Bushing.{name}"
    array = checked(value, ((3,), (6, 6)), where, problems, "Give three translational coefficients or a 6 x 6 matrix.")
    if array is None:
        return np.zeros(3)
    known = concrete(array)
    if known is None:
        return array
    if known.ndim == 2:
        asymmetry = np.abs(known - known.T).max()
        if asymmetry > 1e-9 * np.abs(known).max():
            hint = "No potential energy belongs to such a matrix; give (K + K')/2 if that is meant."
            problems.add(
                "NOT_SYMMETRIC",
                where,
                f"is not symmetric: largest |K - K'| = {asymmetry:.3g}",
                value=known - known.T,
                limit=f"{1e-9 * np.abs(known).max():.3g}",
                hint=hint,
            )
            return array
    smallest = known if known.ndim == 1 else np.linalg.eigvalsh(known)
    if smallest.min() < -1e-12 * np.abs(smallest).max():
        told = ", ".join(f"{v:.6g}" for v in smallest)
        what = "coefficients" if known.ndim == 1 else "eigenvalues"
        _negative("Bushing", name, f"has {what} {told}", smallest, allow_negative, problems)
    return array


def _negative(kind: str, name: str, told: str, value: Any, allowed: bool, problems: Problems) -> None:
    """Negative coefficients are a problem or, where they are meant, a warning."""
    code, where = f"NEGATIVE_{name.upper()}", f"{kind}.{name}"
    if allowed:
        what = {"stiffness": "an equilibrium may be unstable", "damping": "the system may gain energy"}[name]
        warn(code, f"{where} {told}, as allowed: {what}")
    else:
        problems.add(code, where, told, value=value, limit=">= 0", hint="If it is meant, say allow_negative=True.")


def free_length_of(value: Any, kind: str, problems: Problems) -> Any:
    """The free length of an element [m]. Error: NEGATIVE_LENGTH."""
    length = scalar(value, f"{kind}.free_length", problems)
    l0 = concrete(length)
    if l0 is not None and l0 < 0:
        problems.add("NEGATIVE_LENGTH", f"{kind}.free_length", f"is {l0:g} m", value=float(l0), limit=">= 0", hint="Give 0 or more.")
    return length
