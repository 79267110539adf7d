"""Laws with memory in given states z, which elements evaluate like any other law: in a motion,
in small motions about a state of rest, or at rest; and sums over the laws of an element."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, functions_as_nodes
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field
from jaxbody.model.laws.laws import Law, Number, as_law, force, parts, potential
from jaxbody.model.laws.memory_laws import Hysteretic, Memory, States, per_speed, without_states


class InState(Law):
    """The base class of laws with memory in a given state z."""

    law: Any = field()  # a Memory
    z: Any = field()  # States, or one number for them in a tree of axes or ranks

    def potential(self, x):
        return self.law.energy(x, self.law.configuration(self.z))

    def force(self, x):
        return self.law.static_force(x, self.law.configuration(self.z))

    def beyond(self, x):
        return self.law.beyond(x)

    def kinetic(self) -> Number:
        """Return the kinetic energy T [J] of the states."""
        return self.law.kinetic(self.z)

    @abstractmethod
    def viscous(self, x: Number, x_dot: Number) -> Number:
        """Return the part of the force that depends on the rate."""

    @abstractmethod
    def dissipation(self, x: Number, x_dot: Number) -> Number:
        """Return R [W]; 0 for a hysteretic law, whose force has no such potential."""


class Held(InState):
    """A law with memory whose state changes by its own rate, as in a motion."""

    def viscous(self, x, x_dot):
        return self.law.restoring_force(x, x_dot, self.z) - self.force(x)

    def dissipation(self, x, x_dot):
        if not self.law.has_rows:
            return jnp.zeros_like(x)
        return self.law.dissipation(
            x_dot, self.law.rates(self.z) if self.law.inertial else self.rate(x, x_dot)
        )

    def rate(self, x: Number, x_dot: Number) -> States:
        """Return z'."""
        return self.law.rate(x, x_dot, self.z)

    def lost_power(self, x: Number, x_dot: Number) -> Number:
        """Return the dissipated power F e' - d(V + T)/dt [W]."""

        def stored(x, z):
            V = self.law.energy(x, self.law.configuration(z))
            return V + self.law.kinetic(z) if self.law.inertial else V

        change = jax.jvp(stored, (x, self.z), (x_dot, self.rate(x, x_dot)))[1]
        return self.law.restoring_force(x, x_dot, self.z) * x_dot - change


class Apart(InState):
    """A law with memory in small motions about a state of rest: its coordinates are unknowns of the
    system; those without mass have the rates z_dot. Hysteretic states change linearly with the
    deformation, by their tangents."""

    z_dot: Any = field(default=None)  # of coordinates without mass

    @property
    def rates(self) -> States:
        """The rates y' of its coordinates."""
        return self.law.rates(self.z) if self.law.inertial else self.z_dot

    def potential(self, x):
        return (
            super().potential(x)
            if self.law.has_rows
            else _tangent_potential(functions_as_nodes(self.law), x, self.z)
        )

    def force(self, x):
        return (
            super().force(x)
            if self.law.has_rows
            else _tangent_force(functions_as_nodes(self.law), x, self.z)
        )

    def viscous(self, x, x_dot):
        return (
            self.law.viscous_force(x_dot, self.rates)
            if self.law.has_rows
            else _rate_part(self.law, x, x_dot, self.z)
        )

    def dissipation(self, x, x_dot):
        if self.law.has_rows:
            return self.law.dissipation(x_dot, self.rates)
        return _rate_potential(functions_as_nodes(self.law), x, x_dot, self.z)

    def inner(self, x: Number, x_dot: Number) -> tuple[Array, ...]:
        """Return V_ye, V_yy, R_ye, R_yy and T_yy."""
        V_y, R_y = jax.grad(self.law.energy, 1), jax.grad(self.law.dissipation, 1)
        y, y_dot = self.law.configuration(self.z), self.rates
        x_dot = jnp.asarray(x_dot, y.dtype)
        massless = jnp.zeros((len(y), len(y)), y.dtype)
        return (
            jax.jacfwd(V_y, 0)(x, y),
            jax.jacfwd(V_y, 1)(x, y),
            jax.jacfwd(R_y, 0)(x_dot, y_dot),
            jax.jacfwd(R_y, 1)(x_dot, y_dot),
            jax.hessian(self.law.kinetic_energy)(y_dot) if self.law.inertial else massless,
        )


class Relaxed(Law):
    """A law with memory at rest: its coordinates are in equilibrium at the given deformation
    (relaxed); its hysteretic states are z."""

    law: Any = field()  # a Memory
    z: Any = field()  # States, or one number for them in a tree of axes or ranks

    def state(self, x: Number) -> States:
        """Return z at rest."""
        return self.law.at_rest(x) if self.law.has_rows else self.z

    def potential(self, x):
        return (
            self.law.energy(x, self.law.relaxed(x)) if self.law.has_rows else super().potential(x)
        )

    def force(self, x):
        return self.law.static_force(x, self.law.relaxed(x) if self.law.has_rows else self.z)

    def beyond(self, x):
        return self.law.beyond(x)

    def viscous(self, x: Number, x_dot: Number) -> Number:
        """Return the part of the force that depends on the rate in slow motions, where y follows e:
        the derivative of R(e', dy/de e') with respect to e'."""
        if not self.law.has_rows:
            return self.law.restoring_force(x, x_dot, self.z) - self.force(x)
        follows = self.law.configuration(self.law.sensitivity(x))
        return jax.grad(lambda rate: self.law.dissipation(rate, follows * rate))(
            jnp.asarray(x_dot, follows.dtype)
        )


@jax.custom_jvp
def _tangent_potential(law: Hysteretic, x: Number, z: States) -> Number:
    """Return the stored energy; its derivative with respect to x is the tangent force."""
    return law.energy(x, z)


@_tangent_potential.defjvp
def _tangent_potential_jvp(primals, tangents):
    (law, x, z), (law_dot, x_dot, z_dot) = primals, tangents
    V, V_dot = jax.jvp(lambda law, z: law.energy(x, z), (law, z), (law_dot, z_dot))
    return V, V_dot + _tangent_force(law, x, z) * x_dot


@jax.custom_jvp
def _tangent_force(law: Hysteretic, x: Number, z: States) -> Number:
    """Return F(x, 0, z); its derivative with respect to x includes the change of z with x,
    df/de'."""
    return law.static_force(x, z)


@_tangent_force.defjvp
def _tangent_force_jvp(primals, tangents):
    (law, x, z), (law_dot, x_dot, z_dot) = primals, tangents
    follows = per_speed(law, x, z) * x_dot
    return jax.jvp(
        lambda law, x, z: law.static_force(x, z), primals, (law_dot, x_dot, z_dot + follows)
    )


@jax.custom_jvp
def _rate_potential(law: Hysteretic, x: Number, x_dot: Number, z: States) -> Number:
    """Return zero; its derivative with respect to the rate is the part of the force that depends on
    the rate."""
    return jnp.zeros_like(x)


@_rate_potential.defjvp
def _rate_potential_jvp(primals, tangents):
    rate_force = _rate_part(*primals)
    return jnp.zeros_like(rate_force), rate_force * tangents[2]


def _rate_part(law: Hysteretic, x: Number, x_dot: Number, z: States) -> Number:
    return law.restoring_force(x, x_dot, z) - law.static_force(x, z)


# Elements with a law `spring` that may have memory and a law `damper` that may not


def memories(tree: Any, kind: Any = Memory) -> list[Any]:
    """Return the laws of this kind in a law, an element or a table, in the order of their
    states."""
    return [part for part in jax.tree.leaves(tree, is_leaf=with_states) if isinstance(part, kind)]


def with_states(x: Any) -> bool:
    """Return whether x is a law with memory, with or without given states."""
    return isinstance(x, Memory | InState | Relaxed)


def _parts(spring: Law | None) -> list[Any]:
    """Return the laws in given states that are part of a spring's law."""
    laws = [] if spring is None else [part for part in parts(spring) if with_states(part)]
    for part in laws:
        if isinstance(part, Memory):
            raise without_states(part)
    return laws


def rate_force(spring: Law | None, damper: Law | None, x: Number, x_dot: Number) -> Number:
    """Return the force that depends on the rate: that of the damper, plus the viscous part of a
    spring with memory."""
    return sum((part.viscous(x, x_dot) for part in _parts(spring)), force(damper, x_dot))


def dissipation(spring: Law | None, damper: Law | None, x: Number, x_dot: Number) -> Number:
    """Return R of a damper, plus that of a spring with memory in a given state."""
    return sum((part.dissipation(x, x_dot) for part in _parts(spring)), potential(damper, x_dot))


def lost_power(spring: Law | None, damper: Law | None, x: Number, x_dot: Number) -> Number:
    """Return the power that a damper, and a spring with memory in a given state, dissipate."""
    return sum((part.lost_power(x, x_dot) for part in _parts(spring)), force(damper, x_dot) * x_dot)


def tangent(spring: Law | None, energy: Callable[[Number], Number], x: Number) -> Number:
    """Return dF/de at rest: the second derivative of the energy or, for a spring with memory in a
    given state, the derivative of its force."""
    if not _parts(spring):
        return jax.hessian(energy)(x)
    return jax.jvp(lambda x: force(spring, x), (x,), (jnp.ones_like(x),))[1]


def state_rates(spring: Law | None, x: Number, x_dot: Number) -> list[States]:
    """Return z' of the laws of a spring with memory in a given state."""
    return [part.rate(x, x_dot) for part in _parts(spring)]


def rest_states(spring: Law | None, x: Number) -> list[States]:
    """Return z at rest of the laws of a relaxed spring with memory."""
    return [part.state(x) for part in _parts(spring)]


def sensitivities(spring: Law | None, x: Number) -> list[States]:
    """Return dz/de of the laws of a relaxed spring with memory."""
    return [part.law.sensitivity(x) for part in _parts(spring)]


def has_rows(spring: Law | None) -> bool:
    """Return whether a spring has coordinates that are coordinates of the system (see Apart)."""
    return any(isinstance(part, Apart) and part.law.has_rows for part in _parts(spring))


def inner(spring: Law | None, x: Number, x_dot: Number) -> tuple[Array, ...]:
    """Return V_ye, V_yy, R_ye, R_yy and T_yy of all coordinates of a spring with memory (see
    Apart)."""
    each = [
        part.inner(x, x_dot)
        for part in _parts(spring)
        if isinstance(part, Apart) and part.law.has_rows
    ]
    V_ye, R_ye = (jnp.concatenate([one[i] for one in each]) for i in (0, 2))
    from jax.scipy.linalg import block_diag  # for the few models with inner coordinates

    V_yy, R_yy, T_yy = (block_diag(*(one[i] for one in each)) for i in (1, 3, 4))
    return V_ye, V_yy, R_ye, R_yy, T_yy


def as_damper(value: Any, where: str, problems: Problems) -> Law | None:
    """Return a law of the rate, which cannot have memory. Errors: those of laws, MEMORY."""
    law = as_law(value, where, problems)
    check_without_memory(
        law, where, problems, "Memory is of the deformation: add the law to spring=."
    )
    return law


def check_without_memory(law: Law | None, where: str, problems: Problems, hint: str) -> None:
    """Refuse laws with memory. Error: MEMORY."""
    for part in memories(law):
        problems.add(
            "MEMORY",
            where,
            f"has memory ({type(part).__name__})",
            value=part,
            limit="laws without memory",
            hint=hint,
        )
