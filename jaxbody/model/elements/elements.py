"""The base class of elements: deformation e(A, B, ...) of two or more frames, potential energy
V(e), dissipation function R(e, e_dot) and, for some elements, kinetic energy T(e, e_dot).

Forces and stiffness are derivatives of these. Points and orientations at an end are in the frame of
the body or support of that end.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import fields
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Bool, Float
from jaxbody.core.errors import JaxbodyError, Problem, Problems, warn
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import Described, Kind, field, in_domain, kind_of
from jaxbody.geometry.frames import Frame, Pose, Wrench
from jaxbody.geometry.vectors import cross, dot, length_and_direction, product, rotate

MEANT = "If this is intended, give allow_negative=True."
ALLOWED = {
    "NEGATIVE_STIFFNESS": "an equilibrium may be unstable",
    "NEGATIVE_DAMPING": "the system may gain energy",
}


class Element(Described, eqx.Module):
    """The base class of elements between two or more frames, named in `between`; `a` and `b` are
    the points where it is attached.

    A user-defined element defines `deformation`, `energy` and `dissipation`; forces and stiffness
    are their derivatives. One with inertia defines `kinetic_energy` too. `jb.field` gives the unit
    and the domain of its numbers, which `replace`, `fit` and `tune` respect. Two equal charges, one
    of which floats above the other where strength / e^2 = m g:

    >>> class Charges(jb.Element):
    ...     strength: jax.Array = jb.field("N m2", "positive")
    ...     def deformation(self, A, B):
    ...         return jnp.linalg.norm(B.point(self.b) - A.point(self.a))
    ...     def energy(self, e):
    ...         return self.strength / e
    ...     def dissipation(self, e, e_dot):
    ...         return jnp.zeros_like(e)
    >>> ball = jb.Body(mass=0.2, inertia=[1, 1, 1], position=[0, 0, 0.6])
    >>> model = jb.Model(
    ...     bodies={"ball": ball},
    ...     joints={"ball": jb.Guide("world", axis=[0, 0, 1])},
    ...     elements={
    ...         "pair": Charges(("ball", "world"), jnp.zeros(3), jnp.zeros(3), jnp.array(0.5))
    ...     },
    ...     gravity=[0, 0, -10],
    ... )
    >>> round(float(jb.equilibrium(model).elongations["pair"]), 9)
    0.5
    """

    between: tuple[str, ...] = eqx.field(static=True)
    size: ClassVar[int] = 1  # number of components of the deformation
    # where the force jumps: code of the warning, description of the place, remedy
    jump: ClassVar[tuple[str, str, str] | None] = None
    a: Float[Array, "3"] = field("m")
    b: Float[Array, "3"] = field("m")

    @property
    def points(self) -> tuple[Float[Array, "*rows 3"], ...]:
        """The points of attachment, one in each frame."""
        return self.a, self.b

    def as_drawn(self, *orientations: Float[Array, "4"]) -> Element:
        """Return the element with the fields that follow from the drawing, in which its frames have
        these orientations (unit quaternions)."""
        return self

    @abstractmethod
    def deformation(self, *poses: Pose) -> Float[Array, "*m"]:
        """Return the deformation e, a function of the poses of its frames."""

    @abstractmethod
    def energy(self, e: Float[Array, "*m"]) -> Float[Array, ""]:
        """Return V(e) [J]."""

    @abstractmethod
    def dissipation(self, e: Float[Array, "*m"], e_dot: Float[Array, "*m"]) -> Float[Array, ""]:
        """Return R(e, e_dot) [W], half the dissipated power if damping is linear."""

    def kinetic_energy(self, e: Float[Array, "*m"], e_dot: Float[Array, "*m"]) -> Float[Array, ""]:
        """Return T(e, e_dot) [J], quadratic in e_dot. Only elements with inertia define it."""
        return jnp.zeros(())

    @classmethod
    def has_inertia(cls) -> bool:
        """Return whether the class defines a kinetic energy."""
        return cls.kinetic_energy is not Element.kinetic_energy

    def beyond(self, e: Float[Array, "*m"], e_dot: Float[Array, "*m"]) -> Bool[Array, ""]:
        """Return whether a law is used outside the range for which it is known."""
        return jnp.array(False)

    def away_from_jump(self, *poses: Pose) -> Float[Array, "*n"]:
        """Return a vector that is zero where the force jumps (see `jump`) and has a length of about
        1 far from there."""
        return jnp.ones(1)

    def potential(self, *poses: Pose) -> Float[Array, ""]:
        """Return V [J] as a function of the poses."""
        return self.energy(self.deformation(*poses))

    def rates(self, *frames: Frame) -> tuple[Float[Array, "*m"], Float[Array, "*m"]]:
        """Return e and e_dot, the derivative of e along the motion of the frames."""
        return jax.jvp(
            self.deformation, tuple(f.pose() for f in frames), tuple(f.rates() for f in frames)
        )

    def damping_force(self, e: Float[Array, "*m"], e_dot: Float[Array, "*m"]) -> Float[Array, "*m"]:
        """Return dR/de_dot."""
        return jax.grad(self.dissipation, argnums=1)(e, e_dot)

    def force(self, *frames: Frame) -> Float[Array, "*m"]:
        """Return dV/de + dR/de_dot, the force that opposes the deformation: the tension of a spring
        [N]."""
        e, e_dot = self.rates(*frames)
        return self.static_force(e) + self.damping_force(e, e_dot)

    def momentum(self, e: Float[Array, "*m"], e_dot: Float[Array, "*m"]) -> Float[Array, "*m"]:
        """Return dT/de_dot."""
        return jax.grad(self.kinetic_energy, argnums=1)(e, e_dot)

    def inertial_force(
        self, frames: tuple[Frame, ...], changes: tuple[Frame, ...]
    ) -> Float[Array, "*m"]:
        """Return d/dt dT/de_dot - dT/de, which adds to `force`; `changes` are the time derivatives
        of the frames."""
        _, rate = jax.jvp(lambda *frames: self.momentum(*self.rates(*frames)), frames, changes)
        return rate - jax.grad(self.kinetic_energy)(*self.rates(*frames))

    def lost_power(self, *frames: Frame) -> Float[Array, ""]:
        """Return the dissipated power dR/de_dot . e_dot [W]."""
        e, e_dot = self.rates(*frames)
        return jnp.sum(self.damping_force(e, e_dot) * e_dot)

    def static_force(self, e: Float[Array, "*m"]) -> Float[Array, "*m"]:
        """Return dV/de, the force at rest."""
        return jax.grad(self.energy)(e)

    def tangent(self, e: Float[Array, "*m"]) -> Float[Array, "*m *m"]:
        """Return d2V/de2, the derivative of the force at rest."""
        return jax.hessian(self.energy)(e)

    def state_rates(self, e: Float[Array, "*m"], e_dot: Float[Array, "*m"]) -> Float[Array, "nz"]:
        """Return z', the rates of the states of its laws."""
        raise self._without_states()

    def rest_states(self, e: Float[Array, "*m"]) -> Float[Array, "nz"]:
        """Return the states z at rest."""
        raise self._without_states()

    def _without_states(self) -> JaxbodyError:
        return JaxbodyError(
            Problem(
                "MEMORY",
                type(self).__name__,
                "has a law with memory and does not state its rates",
                self,
                hint="Use an element of jaxbody, such as SpringDamper, or a law without memory.",
            )
        )

    def wrenches(self, *frames: Frame) -> tuple[Wrench, ...]:
        """Return the wrench on each frame: minus the derivatives of V and R with respect to its
        displacement and velocity."""
        return self._pulled_back(self.force(*frames), frames)

    def inertial_wrenches(
        self, frames: tuple[Frame, ...], changes: tuple[Frame, ...]
    ) -> tuple[Wrench, ...]:
        """Return the wrench of the element's inertia on each frame; `changes` are the time
        derivatives of the frames."""
        return self._pulled_back(self.inertial_force(frames, changes), frames)

    def _pulled_back(
        self, force: Float[Array, "*m"], frames: tuple[Frame, ...]
    ) -> tuple[Wrench, ...]:
        """Return the force and moment on each frame that have the virtual power -`force` . e_dot,
        from the transposed derivative of e. A moment is the sum of the cross products of the
        columns of R with the derivatives with respect to them."""
        _, pull_back = jax.vjp(self.deformation, *(f.pose() for f in frames))
        return tuple(
            (slope.p, cross(f.R.T, slope.R.T).sum(0))
            for slope, f in zip(pull_back(-force), frames, strict=True)
        )


class LineElement(Element):
    """The base class of elements along the line from the point a of one body to the point b of
    another: e = |AB| - l0.

    The tension is split, T(L) = k0 L + rest, with d the vector from a to b and L = |d|. The force
    k0 d + rest d/L then has the right derivatives at d = 0 if the rest is zero there.
    """

    free_length: Float[Array, ""] = field(
        "m", "nonnegative", code="NEGATIVE_LENGTH", hint="Give 0 or more."
    )
    jump = (
        "SPRING_COLLAPSED",
        "has shrunk to a point",
        (
            "its direction jumps there: offset its ends so that they pass each other, keep them "
            "apart by a stop, or use a Bushing"
        ),
    )

    @abstractmethod
    def split(
        self, L: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
        """Return k0, the rest of the tension, and its derivative with respect to L."""

    @abstractmethod
    def damper_tension(self, e: Float[Array, ""], e_dot: Float[Array, ""]) -> Float[Array, ""]:
        """Return dR/de_dot."""

    def has_no_direction(self) -> bool:
        """Return whether the force at zero length is zero, so that no direction is needed there
        (for numbers that are not traced)."""
        return False

    def deformation(self, A, B):  # pyright: ignore[reportIncompatibleMethodOverride]  its own frames
        """Return the elongation s = |AB| - l0, (31) of the paper; its derivatives are zero at
        |AB| = 0."""
        return length_and_direction(B.point(self.b) - A.point(self.a))[0] - self.free_length

    def away_from_jump(self, A, B):  # pyright: ignore[reportIncompatibleMethodOverride]  its own frames
        """Return the vector AB over the free length; or 1 if the force at zero length is zero, as
        there is no jump then."""
        _, rest, _ = self.split(jnp.zeros_like(self.free_length))
        jumps = (self.free_length > 0) & (rest != 0)
        return jnp.where(
            jumps,
            (B.point(self.b) - A.point(self.a)) / jnp.where(jumps, self.free_length, 1.0),
            1.0,
        )

    def damping_force(self, e, e_dot):
        return self.damper_tension(e, e_dot)

    def potential(self, A, B):  # pyright: ignore[reportIncompatibleMethodOverride]  its own frames
        d = B.point(self.b) - A.point(self.a)
        L, _ = length_and_direction(d)
        k0, _, _ = self.split(L)
        # exact at d = 0 where l0 = 0
        without_norm = 0.5 * k0 * dot(d, d) + (self.energy(L - self.free_length) - 0.5 * k0 * L**2)
        return jnp.where(self.free_length == 0, without_norm, self.energy(L - self.free_length))

    def wrenches(self, A, B):  # pyright: ignore[reportIncompatibleMethodOverride]  its own frames
        """Return the wrenches in closed form: the tension along AB."""
        arm_a, arm_b = rotate(A.R, self.a), rotate(B.R, self.b)
        d = (B.p - A.p) + (arm_b - arm_a)
        rate = (B.v - A.v) + (cross(B.w, arm_b) - cross(A.w, arm_a))
        L, u = length_and_direction(d)
        k0, rest, _ = self.split(L)
        force = k0 * d + (self.damper_tension(L - self.free_length, dot(u, rate)) + rest) * u
        return (force, cross(arm_a, force)), (-force, cross(force, arm_b))


def turned(element: Any, A: Pose, B: Pose) -> tuple[Float[Array, "3 3"], Float[Array, "3 3"]]:
    """Return two rotations of an element with `orientation` and `orientation_b`: from the axes of
    its first end to the world, and from those of its second end to the first. Before the element is
    part of a model, an `orientation_b` that is not given equals `orientation`."""
    second = element.orientation if element.orientation_b is None else element.orientation_b
    R_A, R_B = (
        product(A.R, rotations.matrix(element.orientation)),
        product(B.R, rotations.matrix(second)),
    )
    return R_A, product(jnp.swapaxes(R_A, -1, -2), R_B)


def check_signs(element: Any, allow_negative: bool, problems: Problems) -> None:
    """Check the signs of stiffness and damping: negative values are a problem or, where allowed, a
    warning."""
    names = [
        each.name
        for each in fields(element)
        if each.metadata.get("kind", Kind()).domain.endswith("unless allow_negative")
    ]
    violations = Problems()
    for name in names:
        number, where = getattr(element, name), f"{type(element).__name__}.{name}"
        element.allow_negative = False
        in_domain(number, kind_of(element, name), where, violations)
        element.allow_negative = bool(allow_negative)
        setattr(element, name, in_domain(number, kind_of(element, name), where, Problems()))
    for problem in violations.collected:
        if allow_negative and problem.code in ALLOWED:
            warn(
                problem.code,
                f"{problem.where} {problem.message}, which is allowed: {ALLOWED[problem.code]}",
            )
        else:
            problems.collected.append(problem)
