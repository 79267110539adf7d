"""Laws of dampers whose force flattens: digressive, friction."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp

from jaxbody.geometry.fields import field, take
from jaxbody.model.laws.laws import Law, Number


class Digressive(Law):
    """F = c1 x + (c0 - c1) x/sqrt(1 + (x/x0)^2): slope c0 at rest, c1 at large x, the knee at x0.

    Args:
        slow: c0 [N s/m]
        fast: c1 [N s/m]
        knee: x0, the velocity about which the slope changes [m/s]

    Errors: NEGATIVE, NOT_POSITIVE for the knee.

    >>> float(Digressive(slow=3000.0, fast=0.0, knee=0.3).force(jnp.array(0.4)))
    720.0
    """

    words: ClassVar[dict[str, str]] = {"force": "N", "argument": "m/s"}
    slow: Number = field("force/argument", "nonnegative")
    fast: Number = field("force/argument", "nonnegative")
    knee: Number = field("argument", "positive")

    def __init__(self, *, slow, fast, knee):
        take(self, slow=slow, fast=fast, knee=knee)

    def force(self, x):
        return self.fast * x + (self.slow - self.fast) * x / jnp.sqrt(1 + (x / self.knee) ** 2)

    def potential(self, x):
        return 0.5 * self.fast * x**2 + (self.slow - self.fast) * x**2 / (
            1 + jnp.sqrt(1 + (x / self.knee) ** 2)
        )


class Friction(Law):
    """Dry friction, regularized: F = F0 x/sqrt(x^2 + v0^2), 71 % of F0 at the velocity v0,
    99.5 % at 10 v0. It creeps instead of sticking.

    `level` F0 [N], `velocity` v0 [m/s]. Errors: NEGATIVE, NOT_POSITIVE for the velocity.

    >>> round(float(Friction(level=50.0, velocity=1e-3).force(jnp.array(0.1))), 2)
    50.0
    """

    words: ClassVar[dict[str, str]] = {"force": "N", "argument": "m/s"}
    level: Number = field("force", "nonnegative")
    velocity: Number = field(
        "argument", "positive", hint="Give the velocity at which it slides with 71 % of the force."
    )

    def __init__(self, *, level, velocity):
        take(self, level=level, velocity=velocity)

    def force(self, x):
        return self.level * x / jnp.sqrt(x**2 + self.velocity**2)

    def potential(self, x):
        return self.level * x**2 / (jnp.sqrt(x**2 + self.velocity**2) + self.velocity)
