"""Force laws F(x) of one variable: x is the elongation of a spring [m] and U its energy, or x is
the rate of a damper [m/s] and U its dissipation potential.

    F(x) = dU/dx,   U(0) = 0

A law defines F or U; the other is its derivative, or its integral by Gauss-Legendre
quadrature. Tension is positive: in compression x < 0 and F < 0. All coefficients are arrays and can
be free in a fit. Laws can be added. Torsion elements use the same laws in rad and N m. Laws with
memory: `memory_laws`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float, checked, functions_as_nodes
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.geometry.fields import Described, field, take

Number = Float[Array, ""]
POINTS = 20  # of the Gauss-Legendre quadrature of a force


class Law(Described, eqx.Module):
    """The base class of laws. A user-defined law derives from it and defines `force` or
    `potential`.

    >>> class Cubic(jb.laws.Law):
    ...     coefficient: jax.Array
    ...     def force(self, x):
    ...         return self.coefficient * x**3
    >>> round(float(Cubic(jnp.array(8.0)).potential(jnp.array(0.5))), 12)
    0.125
    """

    has_memory: ClassVar[bool] = False

    def __check_init__(self):
        kind = type(self)
        if kind.force is Law.force and kind.potential is Law.potential:
            raise JaxbodyError(
                Problem(
                    "NO_FORCE",
                    kind.__name__,
                    "states neither force nor potential",
                    limit="one of them",
                    hint="Give one of them: def force(self, x): ...",
                )
            )

    def potential(self, x: Number) -> Number:
        """Return U(x), the integral of the force from 0."""
        return _integral(functions_as_nodes(self), x)

    def force(self, x: Number) -> Number:
        """Return F(x) = dU/dx."""
        return jax.grad(self.potential)(x)

    def slope(self, x: Number) -> Number:
        """Return dF/dx, the tangent stiffness or damping."""
        return jax.jvp(self.force, (x,), (jnp.ones_like(x),))[1]

    def beyond(self, x: Number) -> Bool[Array, ""]:
        """Return whether x is outside the range for which the law is known."""
        return jnp.zeros(jnp.shape(x), bool)

    def __add__(self, other: Any) -> Sum:
        return Sum(self, other)


def as_law(value: Any, where: str, problems: Problems) -> Law | None:
    """Return the Law for a law, for the coefficient of a linear law, or for a Python function x ->
    F; None for None."""
    if value is None or isinstance(value, Law):
        return value
    if callable(value):
        return Function(value)
    number = checked(value, ((),), where, problems, "Give a law, a number or a function x -> F.")
    if number is None:
        return None
    return problems.gather(lambda: Linear(number), lambda problem: replace(problem, where=where))


class Linear(Law):
    """A linear law: F = k x,  U = k x^2/2. `coefficient` k, stiffness [N/m] or damping [N s/m].
    Error: NEGATIVE.

    >>> float(jb.laws.Linear(200.0).force(jnp.array(0.1)))
    20.0
    """

    coefficient: Number = field(
        "force/argument", "nonnegative", hint="If this is intended, use Polynomial([...])."
    )

    def __init__(self, coefficient):
        take(self, coefficient=coefficient)

    def force(self, x):
        return self.coefficient * x

    def potential(self, x):
        return 0.5 * self.coefficient * x**2


class Function(Law):
    """A law given by any JAX function x -> F. A new function object makes programs compile again;
    a user-defined Law with array fields avoids that. The energy is integrated by a quadrature with
    twenty nodes, exact to rounding where F is smooth.

    >>> round(float(jb.laws.Function(lambda x: jnp.sinh(x)).potential(jnp.array(1.0))), 12)
    0.543080634815
    """

    function: Callable[..., Any] = eqx.field(static=True)

    def force(self, x):
        return self.function(x)


class Sum(Law):
    """The sum of several laws, such as a spring and its bump stop.

    >>> float(
    ...     (
    ...         jb.laws.Linear(100.0) + jb.laws.BumpStop(gap=0.1, stiffness=1000.0, engagement=0.01)
    ...     ).force(jnp.array(-0.2))
    ... )
    -115.0
    """

    terms: tuple[Law, ...] = field()

    def __init__(self, *terms):
        with Problems() as problems:
            laws = [law_of(term, f"Sum.terms[{i}]", problems) for i, term in enumerate(terms)]
        self.terms = tuple(
            part for law in laws for part in (law.terms if isinstance(law, Sum) else (law,))
        )

    def force(self, x):
        return sum((law.force(x) for law in self.terms[1:]), self.terms[0].force(x))

    def potential(self, x):
        return sum((law.potential(x) for law in self.terms[1:]), self.terms[0].potential(x))

    def beyond(self, x):
        return jnp.any(jnp.stack([law.beyond(x) for law in self.terms]), 0)

    def _described(self, words):
        return " + ".join(term._described(words) for term in self.terms)


@jax.custom_jvp
def _integral(law: Law, x: Number) -> Number:
    """Return U(x) = x/2 sum w_i F(x (1 + t_i)/2), whose derivative in x is F(x) itself and not that
    of the quadrature."""
    return _quadrature(law, x)


@_integral.defjvp
def _integral_jvp(primals, tangents):
    (law, x), (law_dot, x_dot) = primals, tangents
    U, U_dot = jax.jvp(lambda law: _quadrature(law, x), (law,), (law_dot,))
    return U, U_dot + law.force(x) * x_dot


def _quadrature(law: Law, x: Number) -> Number:
    nodes, weights = np.polynomial.legendre.leggauss(POINTS)
    points = x * (1 + jnp.asarray(nodes, x.dtype)) / 2
    return x / 2 * jnp.sum(jnp.asarray(weights, x.dtype) * jax.vmap(law.force)(points))


def potential(law: Law | None, x: Number) -> Number:
    """Return U(x), or 0 if there is no law."""
    return jnp.zeros_like(x) if law is None else law.potential(x)


def force(law: Law | None, x: Number) -> Number:
    """Return F(x), or 0 if there is no law."""
    return jnp.zeros_like(x) if law is None else law.force(x)


def slope(law: Law | None, x: Number) -> Number:
    """Return dF/dx, or 0 if there is no law."""
    return jnp.zeros_like(x) if law is None else law.slope(x)


def beyond(law: Law | None, x: Number) -> Bool[Array, ""]:
    """Return whether x is outside the range for which the law is known."""
    return jnp.zeros(jnp.shape(x), bool) if law is None else law.beyond(x)


def parts(law: Law) -> list[Any]:
    """Return the elementary laws of which a law consists, with sums and two-sided laws split into
    their parts."""
    return jax.tree.leaves(
        law, is_leaf=lambda part: isinstance(part, Law) and not isinstance(part, Sum | TwoSided)
    )


# Checks


def law_of(value: Any, where: str, problems: Problems) -> Law:
    """Return the Law for a law, a number or a function; anything else, including None, is an error.
    Error: WRONG_KIND."""
    law = as_law(value, where, problems)
    if law is None and not problems.collected:
        problems.add(
            "WRONG_KIND", where, "is None", limit="a law or a number", hint="Give 0 for no force."
        )
    return Linear(0.0) if law is None else law


def row_of_numbers(value: Any, where: str, problems: Problems) -> Any:
    """Return a one-dimensional array of finite numbers."""
    n = max(np.size(value), 1) if not hasattr(value, "aval") else value.shape[0]
    array = checked(value, ((n,),), where, problems, "Give a row of at least 1 numbers.")
    return np.zeros(0) if array is None else array


class TwoSided(Law):
    """Two laws: F = bump(x) for x < 0, rebound(x) for x > 0; the slope at 0 is the mean of both.

    `bump` (spring or damper in compression) and `rebound` (in extension): laws or numbers. Two
    numbers make a bilinear damper.

    >>> damper = jb.laws.TwoSided(bump=800.0, rebound=2400.0)
    >>> (
    ...     float(damper.force(jnp.array(-0.5))),
    ...     float(damper.force(jnp.array(0.5))),
    ...     float(damper.slope(jnp.array(0.0))),
    ... )
    (-400.0, 1200.0, 1600.0)
    """

    bump: Law = field()
    rebound: Law = field()

    def __init__(self, *, bump, rebound):
        with Problems() as problems:
            self.bump, self.rebound = (
                law_of(law, f"TwoSided.{name}", problems)
                for name, law in (("bump", bump), ("rebound", rebound))
            )
            for part in (
                part for law in (self.bump, self.rebound) for part in parts(law) if part.has_memory
            ):
                problems.add(
                    "MEMORY",
                    "TwoSided",
                    f"has memory ({type(part).__name__})",
                    value=part,
                    limit="laws without memory",
                    hint="Add it to the two-sided law: TwoSided(...) + Maxwell(...).",
                )

    def potential(self, x):
        return self._each(x, lambda law, x: law.potential(x))

    def force(self, x):
        return self._each(x, lambda law, x: law.force(x))

    def beyond(self, x):
        return jnp.where(x < 0, self.bump.beyond(x), self.rebound.beyond(x))

    def _each(self, x, value):
        below, above = (
            value(self.bump, jnp.where(x <= 0, x, 0.0)),
            value(self.rebound, jnp.where(x >= 0, x, 0.0)),
        )
        side = jnp.sign(x)  # 0 at 0, so that derivatives there are the means of both sides
        return (1 - side) / 2 * below + (1 + side) / 2 * above
