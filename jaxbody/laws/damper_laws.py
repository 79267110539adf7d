"""Laws of dampers whose force flattens: digressive, friction."""

from __future__ import annotations

import jax.numpy as jnp

from jaxbody.core.arrays import scalar
from jaxbody.core.errors import Problems
from jaxbody.laws.laws import Law, Number, not_negative, positive


class Digressive(Law):
    """F = c1 x + (c0 - c1) x/sqrt(1 + (x/x0)^2): slope c0 at rest, c1 at large x, the knee at x0.

    `slow` c0 and `fast` c1 [N s/m], `knee` x0 [m/s]. Errors: NEGATIVE, NOT_POSITIVE of the knee.

    >>> float(Digressive(slow=3000.0, fast=0.0, knee=0.3).force(jnp.array(0.4)))
    720.0
    """

    slow: Number
    fast: Number
    knee: Number

    def __init__(self, *, slow, fast, knee):
        problems = Problems()
        self.slow, self.fast, self.knee = (
            scalar(v, f"Digressive.{name}", problems) for name, v in (("slow", slow), ("fast", fast), ("knee", knee))
        )
        not_negative(self.slow, "Digressive.slow", "N s/m", problems)
        not_negative(self.fast, "Digressive.fast", "N s/m", problems)
        positive(self.knee, "Digressive.knee", "m/s", problems)
        problems.raise_if_any()

    def force(self, x):
        return self.fast * x + (self.slow - self.fast) * x / jnp.sqrt(1 + (x / self.knee) ** 2)

    def potential(self, x):
        return 0.5 * self.fast * x**2 + (self.slow - self.fast) * x**2 / (1 + jnp.sqrt(1 + (x / self.knee) ** 2))


class Friction(Law):
    """Dry friction, regularized: F = F0 x/sqrt(x^2 + v0^2), 71 % of F0 at the velocity v0, 99.5 % at 10 v0. It creeps where it should stick.

    `level` F0 [N], `velocity` v0 [m/s]. Errors: NEGATIVE, NOT_POSITIVE of the velocity.

    >>> round(float(Friction(level=50.0, velocity=1e-3).force(jnp.array(0.1))), 2)
    50.0
    """

    level: Number
    velocity: Number

    def __init__(self, *, level, velocity):
        problems = Problems()
        self.level = scalar(level, "Friction.level", problems)
        self.velocity = scalar(velocity, "Friction.velocity", problems)
        not_negative(self.level, "Friction.level", "N", problems)
        positive(self.velocity, "Friction.velocity", "m/s", problems, "Say how fast it slides before the full force is there.")
        problems.raise_if_any()

    def force(self, x):
        return self.level * x / jnp.sqrt(x**2 + self.velocity**2)

    def potential(self, x):
        return self.level * x**2 / (jnp.sqrt(x**2 + self.velocity**2) + self.velocity)
