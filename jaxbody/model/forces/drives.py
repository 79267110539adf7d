"""Drives: elements along the line between two points whose force follows a command, from their
controller and a constant one of their own.

    F = u                                      an actuator that follows at once,
    F' = 2 pi f (clip(u, -F_max, F_max) - F)   one of the bandwidth f, |F'| limited
    F = -clip(-u, soft(e'), hard(e'))          a damper that is controlled between two curves

A positive force pushes the two points apart; e' is the rate of their distance.
"""

from abc import abstractmethod
from typing import Any

import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, take
from jaxbody.geometry.points_and_orientations import ends
from jaxbody.geometry.vectors import dot, length_and_direction
from jaxbody.model.forces.force_elements import ForceInputs, PointPair
from jaxbody.model.laws import law_states, laws

TURN = 2 * jnp.pi


class CommandedForce(PointPair):
    """The base class of elements whose force follows a command, at once or with a bandwidth."""

    command: Float[Array, ""] = field("N")
    bandwidth: Float[Array, ""] | None = field("Hz", "positive")

    def placed(self, a, b, problems: Problems, **numbers) -> None:
        """Set the ends, and the numbers that are given."""
        self.between, (self.a, self.b) = ends((a, b), type(self).__name__, problems)
        for name, value in numbers.items():
            setattr(self, name, None)
            if value is not None:
                take(self, problems, **{name: value})

    @property
    def states(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return () if self.bandwidth is None else ("force",)

    state_units = ("N",)

    @abstractmethod
    def wanted(self, now: ForceInputs) -> Float[Array, ""]:
        """Return the force [N] that the drive follows with its bandwidth."""

    @abstractmethod
    def exerted(self, follows: Float[Array, ""], rate: Float[Array, ""]) -> Float[Array, ""]:
        """Return the force [N] at a rate e' [m/s] of the distance."""

    def force(self, now: ForceInputs) -> tuple[Float[Array, ""], Float[Array, "3"]]:
        """Return the force [N] that pushes the two points apart, and the direction from a to b."""
        A, B = now.frames
        u = length_and_direction(B.point(self.b) - A.point(self.a))[1]
        rate = dot(u, B.velocity(self.b) - A.velocity(self.a))
        return self.exerted(self.wanted(now) if self.bandwidth is None else now.z[0], rate), u

    def forces(self, now):
        force, u = self.force(now)
        return now.opposed(force * u, self.a, self.b)

    def rates(self, now):
        if self.bandwidth is None:
            return now.z
        return TURN * self.bandwidth * (self.wanted(now) - now.z)


def drive_tables(model: Any) -> list[Any]:
    """Return the tables of the drives of a model."""
    return [table for table in model.forces if isinstance(table.rows, CommandedForce)]


class Actuator(CommandedForce):
    """An actuator along the line between two points, which exerts the commanded force:

        F = clip(u, -limit, limit)                                          without a bandwidth
        F' = clip(2 pi bandwidth (clip(u, -limit, limit) - F), -rate, rate)  with one

    F pushes the two points apart. u is the sum of `command` and of the command of the controller
    that drives it; without a controller it is an input of the linear system, `jb.Command`.

    Args:
        a, b: (name, point in its frame [m])
        command: a constant command [N], by default 0
        bandwidth: [Hz]; None: the force follows the command at once
        limit: largest force [N]; None: none
        rate: largest rate of the force [N/s], which needs a bandwidth; None: none

    Errors: BAD_END, SELF_SPRING, NOT_POSITIVE, BAD_SHAPE, NON_FINITE, BAD_CHAIN for a rate without
    a bandwidth; of the model: ZERO_LENGTH.

    >>> jb.Actuator("car", ("wheel", [0, 0, 0.1]), bandwidth=20.0, limit=2000.0).states
    ('force',)
    """

    limit: Float[Array, ""] | None = field("N", "positive")
    rate: Float[Array, ""] | None = field("N/s", "positive")

    def __init__(self, a, b, *, command=0.0, bandwidth=None, limit=None, rate=None):
        with Problems() as problems:
            self.placed(
                a, b, problems, command=command, bandwidth=bandwidth, limit=limit, rate=rate
            )
            if rate is not None and bandwidth is None:
                problems.add(
                    "BAD_CHAIN",
                    "Actuator.rate",
                    "limits the rate of a force that follows at once",
                    value=rate,
                    limit="an actuator with a bandwidth",
                    hint="Give bandwidth=.",
                )

    def wanted(self, now):
        u = self.command + now.command
        return u if self.limit is None else jnp.clip(u, -self.limit, self.limit)

    def exerted(self, follows, rate):
        return follows

    def rates(self, now):
        rates = super().rates(now)
        return rates if self.rate is None else jnp.clip(rates, -self.rate, self.rate)


class ControlledDamper(CommandedForce):
    """A semi-active damper: of the commanded force it exerts what lies between two curves,

        F = -clip(-u, soft(e'), hard(e')),

    so that it only takes energy out. u, a force that pushes the points apart, is the sum of
    `command` and of the command of its controller, with a lag if it has a bandwidth. About rest,
    where both curves are zero, small motions are those of the mean of the two.

    Args:
        a, b: (name, point in its frame [m])
        soft, hard: forces [N] over e' [m/s]: laws, dampings [N s/m] or JAX functions; the greater
            one is the limit
        command: a constant command [N], by default 0
        bandwidth: of the valve [Hz]; None: it follows the command at once

    Errors: BAD_END, SELF_SPRING, NEGATIVE, NOT_POSITIVE, BAD_SHAPE, NON_FINITE; of the model:
    ZERO_LENGTH. Source of the on-off law: D. Karnopp, M. Crosby, R. Harwood, J. Eng. Ind. 96
    (1974) 619.

    >>> damper = jb.forces.ControlledDamper("car", ("wheel", [0, 0, 0.1]), soft=300.0, hard=3000.0)
    >>> float(damper.exerted(jnp.array(-5000.0), jnp.array(0.5)))
    -1500.0
    """

    soft: laws.Law = field(words={"force": "N", "argument": "m/s"})
    hard: laws.Law = field(words={"force": "N", "argument": "m/s"})

    def __init__(self, a, b, *, soft, hard, command=0.0, bandwidth=None):
        with Problems() as problems:
            self.placed(a, b, problems, command=command, bandwidth=bandwidth)
            self.soft, self.hard = (  # pyright: ignore[reportAttributeAccessIssue]
                law_states.as_damper(law, f"ControlledDamper.{name}", problems)
                for name, law in (("soft", soft), ("hard", hard))
            )

    def wanted(self, now):
        return self.command + now.command

    def exerted(self, follows, rate):
        soft, hard = self.soft.force(rate), self.hard.force(rate)
        between = jnp.clip(-follows, jnp.minimum(soft, hard), jnp.maximum(soft, hard))
        return -jnp.where(rate == 0, (soft + hard) / 2, between)
