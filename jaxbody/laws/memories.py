"""Laws with memory: their force depends on states z of their own, which the elements own that have these laws.

massless coordinates y    V(e, y), R(e', y'):   F = dV/de + dR/de',   dV/dy + dR/dy' = 0, solved for y'
states of first order     F(e, e', z),          z' = f(e, e', z), zero at rest whatever z
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float, functions_as_nodes
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.geometry.fields import field
from jaxbody.laws.laws import Law, Number, as_law, force, parts, potential

States = Float[Array, "nz"]
ITERATIONS = 50  # of Newton's method for massless coordinates at rest
CONVERGED = 1e-13  # its last step, relative to the coordinates


class Memory(Law):
    """The base class of both kinds: `states` describes each state, `state_units` are their units, "argument" and "force" being those of
    the element's deformation and force; `massless`, whether they are massless coordinates."""

    states: ClassVar[tuple[str, ...]]
    state_units: ClassVar[tuple[str, ...]]
    massless: ClassVar[bool]
    has_memory = True

    @abstractmethod
    def restoring_force(self, e: Number, e_dot: Number, z: States) -> Number:
        """F, which opposes the deformation e."""

    @abstractmethod
    def rate(self, e: Number, e_dot: Number, z: States) -> States:
        """z'."""

    @abstractmethod
    def energy(self, e: Number, z: States) -> Number:
        """The stored energy V [J]."""

    @abstractmethod
    def static_force(self, e: Number, z: States) -> Number:
        """The force at rest."""

    def force(self, x):
        raise without_states(self)

    def potential(self, x):
        raise without_states(self)


def without_states(law: Memory) -> JaxbodyError:
    """The error of an evaluation of a law without its states. Whatever does not yet know states ends here instead of leaving them out."""
    message = "has memory, and this function does not take elements with states yet"
    hint = "Replace it by a law without memory, such as jb.laws.Linear of its stiffness at the frequency of interest."
    return JaxbodyError(Problem("MEMORY", f"the law {type(law).__name__}", message, limit="laws without memory", hint=hint))


class Viscoelastic(Memory):
    """The base class of laws with massless coordinates y: springs and dampers in series, branch by branch.

        F = dV/de + dR/de',    dV/dy + dR/dy' = 0, so that    y' = -R_yy^-1 (dV/dy + R_ye e')

    A law of your own states `states`, `energy` V(e, y) and `dissipation` R(e', y'), quadratic in (e', y') and definite in y'. In a
    linearization each y has a row, with M = 0. A spring k with a branch of a cubic spring and a dashpot:

    >>> class Branch(Viscoelastic):
    ...     cubic: jax.Array = jb.field("N/m3", "positive")
    ...     damping: jax.Array = jb.field("N s/m", "positive")
    ...     states = ("dashpot",)
    ...     def energy(self, e, y):
    ...         return self.cubic * (e - y[0]) ** 4 / 4
    ...     def dissipation(self, e_dot, y_dot):
    ...         return self.damping * y_dot[0] ** 2 / 2
    >>> branch = Branch(jnp.array(8.0), jnp.array(2.0))
    >>> e, rest, y = jnp.array(0.5), jnp.array(0.0), jnp.zeros(1)
    >>> float(branch.restoring_force(e, rest, y)), float(branch.rate(e, rest, y)[0])
    (1.0, 0.5)
    """

    states: ClassVar[tuple[str, ...]] = ("branch",)
    state_units: ClassVar[tuple[str, ...]] = ("argument",)
    massless: ClassVar[bool] = True

    @abstractmethod
    def dissipation(self, e_dot: Number, y_dot: States) -> Number:
        """R(e', y') [W]."""

    def static_force(self, e, z):
        return jax.grad(self.energy)(e, z)

    def viscous_force(self, e_dot: Number, y_dot: States) -> Number:
        """dR/de'."""
        return jax.grad(self.dissipation)(jnp.asarray(e_dot, y_dot.dtype), y_dot)

    def restoring_force(self, e, e_dot, z):
        return self.static_force(e, z) + self.viscous_force(e_dot, self.rate(e, e_dot, z))

    def rate(self, e, e_dot, z):
        zero = jnp.zeros_like(z)
        slope = jax.grad(self.energy, 1)(e, z) + jax.grad(self.dissipation, 1)(jnp.asarray(e_dot, z.dtype), zero)
        return -_solved(jax.hessian(self.dissipation, 1)(jnp.zeros((), z.dtype), zero), slope)

    def relaxed(self, e: Number) -> States:
        """y at rest, dV/dy = 0, by Newton's method; the last two steps carry its derivatives, which are exact to the third."""

        def step(law, e, y):
            return y - _solved(jax.hessian(law.energy, 1)(e, y), jax.grad(law.energy, 1)(e, y))

        law, fixed = jax.lax.stop_gradient((functions_as_nodes(self), e))

        def iterate(carry):
            y, _, n = carry
            new = step(law, fixed, y)
            return new, jnp.max(jnp.abs(new - y)) <= CONVERGED * jnp.max(jnp.abs(new)), n + 1

        start = jnp.zeros(len(self.states), jnp.result_type(e)) + fixed
        y, *_ = jax.lax.while_loop(lambda carry: ~carry[1] & (carry[2] < ITERATIONS), iterate, (start, jnp.array(False), 0))
        for _ in range(2):
            y = step(self, e, y)
        return y

    def sensitivity(self, e: Number) -> States:
        """dy/de at rest."""
        return jax.jvp(self.relaxed, (e,), (jnp.ones_like(e),))[1]


class Hysteretic(Memory):
    """The base class of laws with states of first order whose rate is zero at rest whatever the state: hysteresis, dry friction with
    presliding.

        F(e, e', z),    z' = f(e, e', z),    f(e, 0, z) = 0

    A law of your own states `states`, `state_units`, `rate` and `restoring_force`; `energy`, the part of the work of F that is stored, is
    zero unless it is given. At rest every z stays, so an equilibrium keeps the z of its start, zero without one. A linearization has its
    tangent at rest in K, dF/de + dF/dz df/de', and no row for z: to first order it is a spring, and its losses, which grow with the square
    of the amplitude or less, are in simulations only.

    >>> class Elastoplastic(Hysteretic):
    ...     stiffness: jax.Array = jb.field("force/argument", "positive")
    ...     limit: jax.Array = jb.field("force", "positive")
    ...     states, state_units = ("spring",), ("force",)
    ...     def rate(self, e, e_dot, z):
    ...         slips = (jnp.abs(z) >= self.limit) & (z * e_dot > 0)
    ...         return jnp.where(slips, 0.0, self.stiffness * e_dot)
    ...     def restoring_force(self, e, e_dot, z):
    ...         return z[0]
    >>> law = Elastoplastic(jnp.array(100.0), jnp.array(5.0))
    >>> float(law.rate(0.0, 0.2, jnp.zeros(1))[0]), float(law.rate(0.0, 0.2, jnp.array([5.0]))[0])
    (20.0, 0.0)
    """

    states: ClassVar[tuple[str, ...]] = ("hysteresis",)
    state_units: ClassVar[tuple[str, ...]] = ("force",)
    massless: ClassVar[bool] = False

    def energy(self, e, z):
        return jnp.zeros_like(e)

    def static_force(self, e, z):
        return self.restoring_force(e, jnp.zeros_like(e), z)

    def sensitivity(self, e: Number) -> States:
        """df/de' at rest, with z = 0."""
        return _per_speed(self, e, jnp.zeros(len(self.states), jnp.result_type(e)))


def _per_speed(law: Hysteretic, e: Number, z: States) -> States:
    zero = jnp.zeros_like(e)
    return jax.jvp(lambda e_dot: law.rate(e, e_dot, z), (zero,), (jnp.ones_like(e),))[1]


def _solved(A: Float[Array, "n n"], b: Float[Array, "n"]) -> Float[Array, "n"]:
    return b / A[0] if len(b) == 1 else jnp.linalg.solve(A, b)


# Laws with known states, which elements evaluate as any other


class InState(Law):
    """The base class of laws with memory in a known state z."""

    law: Any = field()  # a Memory
    z: Any = field()  # States, or in a tree of axes their axis

    def potential(self, x):
        return self.law.energy(x, self.z)

    def force(self, x):
        return self.law.static_force(x, self.z)

    def beyond(self, x):
        return self.law.beyond(x)

    @abstractmethod
    def viscous(self, x: Number, x_dot: Number) -> Number:
        """The part of the force that depends on the rate."""

    @abstractmethod
    def dissipation(self, x: Number, x_dot: Number) -> Number:
        """R; 0 for a hysteretic law, whose force has no such potential."""


class Held(InState):
    """A law with memory whose state moves by its own rate: as in a motion."""

    def viscous(self, x, x_dot):
        return self.law.restoring_force(x, x_dot, self.z) - self.law.static_force(x, self.z)

    def dissipation(self, x, x_dot):
        return self.law.dissipation(x_dot, self.rate(x, x_dot)) if self.law.massless else jnp.zeros_like(x)

    def rate(self, x: Number, x_dot: Number) -> States:
        """z'."""
        return self.law.rate(x, x_dot, self.z)

    def lost_power(self, x: Number, x_dot: Number) -> Number:
        """F e' - dV/dt [W]."""
        stored = jax.jvp(self.law.energy, (x, self.z), (x_dot, self.rate(x, x_dot)))[1]
        return self.law.restoring_force(x, x_dot, self.z) * x_dot - stored


class Apart(InState):
    """A law with memory about a state of rest, for small motions: massless coordinates are coordinates of the system, with the rate z_dot;
    hysteretic states follow the deformation by their tangent."""

    z_dot: Any = field()

    def potential(self, x):
        return super().potential(x) if self.law.massless else _tangent_potential(functions_as_nodes(self.law), x, self.z)

    def force(self, x):
        return super().force(x) if self.law.massless else _tangent_force(functions_as_nodes(self.law), x, self.z)

    def viscous(self, x, x_dot):
        if self.law.massless:
            return self.law.viscous_force(x_dot, self.z_dot)
        return self.law.restoring_force(x, x_dot, self.z) - self.law.static_force(x, self.z)

    def dissipation(self, x, x_dot):
        return self.law.dissipation(x_dot, self.z_dot) if self.law.massless else jnp.zeros_like(x)

    def inner(self, x: Number, x_dot: Number) -> tuple[Array, ...]:
        """V_ye, V_yy, R_ye and R_yy."""
        V_y, R_y = jax.grad(self.law.energy, 1), jax.grad(self.law.dissipation, 1)
        x_dot = jnp.asarray(x_dot, self.z.dtype)
        return (
            jax.jacfwd(V_y, 0)(x, self.z),
            jax.jacfwd(V_y, 1)(x, self.z),
            jax.jacfwd(R_y, 0)(x_dot, self.z_dot),
            jax.jacfwd(R_y, 1)(x_dot, self.z_dot),
        )


class Relaxed(Law):
    """A law with memory at rest: massless coordinates are where the deformation has pulled them; hysteretic states stay at z."""

    law: Any = field()  # a Memory
    z: Any = field()  # States, or in a tree of axes their axis

    def state(self, x: Number) -> States:
        """z at rest."""
        return self.law.relaxed(x) if self.law.massless else self.z

    def potential(self, x):
        return self.law.energy(x, self.law.relaxed(x)) if self.law.massless else super().potential(x)

    def force(self, x):
        return self.law.static_force(x, self.state(x))

    def beyond(self, x):
        return self.law.beyond(x)

    def viscous(self, x: Number, x_dot: Number) -> Number:
        """The part of the force that depends on a slow rate: the derivative of R(e', dy/de e')."""
        if not self.law.massless:
            return self.law.restoring_force(x, x_dot, self.z) - self.force(x)
        follows = self.law.sensitivity(x)
        return jax.grad(lambda rate: self.law.dissipation(rate, follows * rate))(jnp.asarray(x_dot, follows.dtype))


@jax.custom_jvp
def _tangent_potential(law: Hysteretic, x: Number, z: States) -> Number:
    """The stored energy, whose derivative in x is the tangent force."""
    return law.energy(x, z)


@_tangent_potential.defjvp
def _tangent_potential_jvp(primals, tangents):
    (law, x, z), (law_dot, x_dot, z_dot) = primals, tangents
    V, V_dot = jax.jvp(lambda law, z: law.energy(x, z), (law, z), (law_dot, z_dot))
    return V, V_dot + _tangent_force(law, x, z) * x_dot


@jax.custom_jvp
def _tangent_force(law: Hysteretic, x: Number, z: States) -> Number:
    """F(x, 0, z), where a change of x changes z too, by df/de'."""
    return law.static_force(x, z)


@_tangent_force.defjvp
def _tangent_force_jvp(primals, tangents):
    (law, x, z), (law_dot, x_dot, z_dot) = primals, tangents
    follows = _per_speed(law, x, z) * x_dot
    changed = jax.jvp(lambda law, x, z: law.static_force(x, z), primals, (law_dot, x_dot, z_dot + follows))
    return changed


# Elements with a law `spring` that may have memory and a law `damper` that may not


def memories(tree: Any, kind: Any = Memory) -> list[Any]:
    """The laws of this kind in a law, an element or a table, in the order of their states."""
    return [part for part in jax.tree.leaves(tree, is_leaf=with_states) if isinstance(part, kind)]


def with_states(x: Any) -> bool:
    """Whether it is a law with memory, with or without known states."""
    return isinstance(x, Memory | InState | Relaxed)


def _parts(spring: Law | None) -> list[Any]:
    """The laws with known states that are part of a spring's law."""
    found = [] if spring is None else [part for part in parts(spring) if with_states(part)]
    for part in found:
        if isinstance(part, Memory):
            raise without_states(part)
    return found


def rate_force(spring: Law | None, damper: Law | None, x: Number, x_dot: Number) -> Number:
    """The force that depends on the rate: that of the damper, and of a spring with memory its part."""
    return sum((part.viscous(x, x_dot) for part in _parts(spring)), force(damper, x_dot))


def dissipation(spring: Law | None, damper: Law | None, x: Number, x_dot: Number) -> Number:
    """R of a damper, and of a spring with memory in a known state."""
    return sum((part.dissipation(x, x_dot) for part in _parts(spring)), potential(damper, x_dot))


def lost_power(spring: Law | None, damper: Law | None, x: Number, x_dot: Number) -> Number:
    """The power that a damper, and a spring with memory in a known state, dissipate."""
    return sum((part.lost_power(x, x_dot) for part in _parts(spring)), force(damper, x_dot) * x_dot)


def tangent(spring: Law | None, energy: Callable[[Number], Number], x: Number) -> Number:
    """dF/de at rest: the second derivative of the energy, or of a spring with memory in a known state that of its force."""
    if not _parts(spring):
        return jax.hessian(energy)(x)
    return jax.jvp(lambda x: force(spring, x), (x,), (jnp.ones_like(x),))[1]


def state_rates(spring: Law | None, x: Number, x_dot: Number) -> list[States]:
    """z' of the laws of a spring with memory in a known state."""
    return [part.rate(x, x_dot) for part in _parts(spring)]


def rest_states(spring: Law | None, x: Number) -> list[States]:
    """z at rest of the laws of a relaxed spring with memory."""
    return [part.state(x) for part in _parts(spring)]


def sensitivities(spring: Law | None, x: Number) -> list[States]:
    """dz/de of the laws of a relaxed spring with memory."""
    return [part.law.sensitivity(x) for part in _parts(spring)]


def has_massless(spring: Law | None) -> bool:
    """Whether a spring has massless coordinates."""
    return any(part.law.massless for part in _parts(spring))


def inner(spring: Law | None, x: Number, x_dot: Number) -> tuple[Array, ...]:
    """V_ye, V_yy, R_ye and R_yy of all massless coordinates of a spring with memory, apart."""
    each = [part.inner(x, x_dot) for part in _parts(spring) if part.law.massless]
    rows, squares = ([jnp.concatenate([one[i] for one in each]) for i in (0, 2)], [[one[i] for one in each] for i in (1, 3)])
    return rows[0], jax.scipy.linalg.block_diag(*squares[0]), rows[1], jax.scipy.linalg.block_diag(*squares[1])


def as_damper(value: Any, where: str, problems: Problems) -> Law | None:
    """A law of the rate, which cannot have memory. Errors: those of laws, MEMORY."""
    law = as_law(value, where, problems)
    hint = "Memory is of the deformation: add the law to spring=."
    check_without_memory(law, where, problems, hint)
    return law


def check_without_memory(law: Law | None, where: str, problems: Problems, hint: str) -> None:
    """Refuse laws with memory. Error: MEMORY."""
    for part in memories(law):
        problems.add("MEMORY", where, f"has memory ({type(part).__name__})", value=part, limit="laws without memory", hint=hint)
