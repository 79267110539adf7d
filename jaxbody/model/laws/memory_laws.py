"""Laws with memory: their force depends on states z, which belong to the elements that have these
laws.

massless coordinates y    V(e, y), R(e', y'):           F = dV/de + dR/de',
                          dV/dy + dR/dy' = 0, solved for y'
coordinates with mass y   V(e, y), R(e', y'), T(y'):    the same F,
                          d/dt dT/dy' + dV/dy + dR/dy' = 0,   z = (y, y')
states of first order     F(e, e', z),                  z' = f(e, e', z), zero at rest whatever z
"""

from abc import abstractmethod
from typing import ClassVar

import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float, functions_as_nodes, nan_unless
from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.model.laws.laws import Law, Number

States = Float[Array, "nz"]
ITERATIONS = 50  # of Newton's method for coordinates at rest
CONVERGED = 1e-13  # size of Newton's last step, relative to the coordinates


class Memory(Law):
    """The base class of laws with memory: `states` are descriptions of the states, `state_units`
    their units, in which "argument" and "force" are the units of the element's deformation and
    force; `has_rows` is true if the states are coordinates, with rows in M, C and K; `inertial`, if
    these have mass, and half of the states are their rates."""

    states: ClassVar[tuple[str, ...]]
    state_units: ClassVar[tuple[str, ...]]
    has_rows: ClassVar[bool]
    inertial: ClassVar[bool] = False
    has_memory = True

    @property
    def roles(self) -> tuple[str, ...]:
        """The role of each state: "massless", a coordinate without mass; "inertial", a coordinate
        with mass; "rate", the rate of one with mass; or "hysteretic"."""
        return ("massless" if self.has_rows else "hysteretic",) * len(self.states)

    def configuration(self, z: States) -> States:
        """Return the states on which the energy depends."""
        return z

    @abstractmethod
    def restoring_force(self, e: Number, e_dot: Number, z: States) -> Number:
        """Return F, which opposes the deformation e."""

    @abstractmethod
    def rate(self, e: Number, e_dot: Number, z: States) -> States:
        """Return z'."""

    @abstractmethod
    def energy(self, e: Number, z: States) -> Number:
        """Return the stored energy V of a configuration [J]."""

    @abstractmethod
    def static_force(self, e: Number, z: States) -> Number:
        """Return the force at rest in a configuration."""

    def kinetic(self, z: States) -> Number:
        """Return the kinetic energy T of the states [J]."""
        return jnp.zeros((), z.dtype)

    def force(self, x):
        raise without_states(self)

    def potential(self, x):
        raise without_states(self)


def without_states(law: Memory) -> JaxbodyError:
    """Return the error of evaluating a law without its states. Functions that do not support states
    raise it, instead of neglecting the states."""
    return JaxbodyError(
        Problem(
            "MEMORY",
            f"the law {type(law).__name__}",
            "has memory, and this function does not take elements with states yet",
            limit="laws without memory",
            hint=(
                "Replace it by a law without memory, such as jb.laws.Linear of its stiffness at "
                "the frequency of interest."
            ),
        )
    )


class InnerCoordinates(Memory):
    """The base class of laws whose states are coordinates y, relative to the element: V(e, y),
    R(e', y') and, with mass, T(y')."""

    has_rows: ClassVar[bool] = True

    @abstractmethod
    def dissipation(self, e_dot: Number, y_dot: States) -> Number:
        """Return R(e', y') [W]."""

    def static_force(self, e, z):
        return jax.grad(self.energy)(e, z)

    def viscous_force(self, e_dot: Number, y_dot: States) -> Number:
        """Return dR/de'."""
        return jax.grad(self.dissipation)(jnp.asarray(e_dot, y_dot.dtype), y_dot)

    def relaxed(self, e: Number) -> States:
        """Return y at rest, dV/dy = 0, by Newton's method. Derivatives are taken through the last
        two steps and are exact up to the third."""

        def step(law, e, y):
            return y - _solved(jax.hessian(law.energy, 1)(e, y), jax.grad(law.energy, 1)(e, y))

        law, fixed = jax.lax.stop_gradient((functions_as_nodes(self), e))

        def iterate(carry):
            y, _, n = carry
            new = step(law, fixed, y)
            return new, jnp.max(jnp.abs(new - y)) <= CONVERGED * jnp.max(jnp.abs(new)), n + 1

        start = self.configuration(jnp.zeros(len(self.states), jnp.result_type(e))) + fixed
        y, converged, _ = jax.lax.while_loop(
            lambda carry: ~carry[1] & (carry[2] < ITERATIONS), iterate, (start, jnp.array(False), 0)
        )
        for _ in range(2):
            y = step(self, e, y)
        return nan_unless(converged, y)

    def at_rest(self, e: Number) -> States:
        """Return z at rest."""
        return self.relaxed(e)

    def sensitivity(self, e: Number) -> States:
        """Return dz/de at rest."""
        return jax.jvp(self.at_rest, (e,), (jnp.ones_like(e),))[1]


class Viscoelastic(InnerCoordinates):
    """The base class of laws with massless coordinates y: springs and dampers in series, branch
    by branch.

        F = dV/de + dR/de',    dV/dy + dR/dy' = 0, so that    y' = -R_yy^-1 (dV/dy + R_ye e')

    A user-defined law defines `states`, `energy` V(e, y) and `dissipation` R(e', y'), quadratic in
    (e', y') and definite in y'. In a linearization each y has a row, with M = 0. A spring k with a
    branch of a cubic spring and a dashpot:

    >>> class Branch(jb.laws.Viscoelastic):
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

    def restoring_force(self, e, e_dot, z):
        return self.static_force(e, z) + self.viscous_force(e_dot, self.rate(e, e_dot, z))

    def rate(self, e, e_dot, z):
        zero = jnp.zeros_like(z)
        slope = jax.grad(self.energy, 1)(e, z) + jax.grad(self.dissipation, 1)(
            jnp.asarray(e_dot, z.dtype), zero
        )
        return -_solved(jax.hessian(self.dissipation, 1)(jnp.zeros((), z.dtype), zero), slope)


class Inertial(InnerCoordinates):
    """The base class of laws with coordinates y that have mass, such as the fluid column of a
    hydraulic mount.

        F = dV/de + dR/de',    T_yy y'' + dV/dy + dR/dy' = 0,    z = (y, y')

    A user-defined law defines `states` and `state_units`, first of the coordinates and then of
    their rates, `energy` V(e, y), `dissipation` R(e', y') and `kinetic_energy` T(y'), quadratic
    and definite. In a linearization each y has a row in M, C and K. A mass on a spring whose
    other end moves with the deformation:

    >>> class Absorber(jb.laws.Inertial):
    ...     stiffness: jax.Array = jb.field("force/argument", "positive")
    ...     mass: jax.Array = jb.field("force s2/argument", "positive")
    ...     states, state_units = ("mass", "rate of mass"), ("argument", "argument/s")
    ...     def energy(self, e, y):
    ...         return self.stiffness * (e - y[0]) ** 2 / 2
    ...     def dissipation(self, e_dot, y_dot):
    ...         return jnp.zeros(())
    ...     def kinetic_energy(self, y_dot):
    ...         return self.mass * y_dot[0] ** 2 / 2
    >>> law = Absorber(jnp.array(8.0), jnp.array(2.0))
    >>> law.rate(jnp.array(0.5), 0.0, jnp.array([0.0, 0.1])).tolist()
    [0.1, 2.0]
    """

    inertial: ClassVar[bool] = True

    @abstractmethod
    def kinetic_energy(self, y_dot: States) -> Number:
        """Return T(y') [J]."""

    @property
    def roles(self):
        n = len(self.states) // 2
        return ("inertial",) * n + ("rate",) * n

    def configuration(self, z):
        return z[: len(self.states) // 2]

    def rates(self, z: States) -> Float[Array, "ny"]:
        """Return y'."""
        return z[len(self.states) // 2 :]

    def at_rest(self, e):
        y = self.relaxed(e)
        return jnp.concatenate([y, jnp.zeros_like(y)])

    def kinetic(self, z):
        return self.kinetic_energy(self.rates(z))

    def restoring_force(self, e, e_dot, z):
        return self.static_force(e, self.configuration(z)) + self.viscous_force(
            e_dot, self.rates(z)
        )

    def rate(self, e, e_dot, z):
        y, y_dot = self.configuration(z), self.rates(z)
        force = jax.grad(self.energy, 1)(e, y) + jax.grad(self.dissipation, 1)(
            jnp.asarray(e_dot, z.dtype), y_dot
        )
        return jnp.concatenate(
            [y_dot, -_solved(jax.hessian(self.kinetic_energy)(jnp.zeros_like(y)), force)]
        )


class Hysteretic(Memory):
    """The base class of laws with states of first order whose rate is zero at rest whatever the
    state: hysteresis, dry friction with presliding.

        F(e, e', z),    z' = f(e, e', z),    f(e, 0, z) = 0

    A user-defined law defines `states`, `state_units`, `rate` and `restoring_force`; `energy`, the
    part of the work of F that is stored, is zero by default. At rest z is constant, so an
    equilibrium has the z of its initial guess, by default zero. A linearization has its tangent at
    rest in K, dF/de + dF/dz df/de', and no row for z: to first order it is a spring. Its losses,
    due to forces of second or higher order in the amplitude, appear only in simulations.

    >>> class Elastoplastic(jb.laws.Hysteretic):
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
    has_rows: ClassVar[bool] = False

    def energy(self, e, z):
        return jnp.zeros_like(e)

    def static_force(self, e, z):
        return self.restoring_force(e, jnp.zeros_like(e), z)

    def sensitivity(self, e: Number) -> States:
        """Return df/de' at rest, with z = 0."""
        return per_speed(self, e, jnp.zeros(len(self.states), jnp.result_type(e)))


def per_speed(law: Hysteretic, e: Number, z: States) -> States:
    """Return df/de' at rest."""
    zero = jnp.zeros_like(e)
    return jax.jvp(lambda e_dot: law.rate(e, e_dot, z), (zero,), (jnp.ones_like(e),))[1]


def _solved(A: Float[Array, "n n"], b: Float[Array, "n"]) -> Float[Array, "n"]:
    return b / A[0] if len(b) == 1 else jnp.linalg.solve(A, b)
