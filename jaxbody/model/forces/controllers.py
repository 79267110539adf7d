"""Controllers: laws between the readings of sensors and the commands of drives, continuous or
sampled.

    u = law(readings, z, t),   z' = rates(readings, z, t)                continuous
    u_k = law(readings, z_k),  z_(k+1) = next(readings, z_k)  at k T     sampled, u held between

The commands of a sampled controller are held, and those computed at k T act at k T + delay. At rest
its states are those that the next sample leaves as they are.
"""

from abc import abstractmethod
from dataclasses import replace
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxbody.core.arguments import checked_dict, plain
from jaxbody.core.arrays import Array, Float, is_concrete
from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.geometry.fields import Described, field, take
from jaxbody.model.forces.drives import CommandedForce, drive_tables
from jaxbody.model.forces.force_elements import ForceElement, ForceInputs

NEAR = 1e-7  # distance from an instant of sampling, in sampling times, that counts as none


class ControlLaw(Described, eqx.Module):
    """The base class of control laws. A user-defined one defines `command` and, if it has states,
    `states` and `rates`; as an equinox.Module it may contain arrays or a network, whose numbers
    have paths, "ride.law.gain".

    >>> class Damped(jb.control.ControlLaw):
    ...     gain: jax.Array = jb.field("N s/m")
    ...     def command(self, now):
    ...         return -self.gain * now.readings["speed"]
    >>> Damped(jnp.array(10.0)).states
    ()
    """

    states: ClassVar[tuple[str, ...]] = ()  # descriptions of the states
    state_units: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def command(self, now: ForceInputs) -> Float[Array, "*nu"]:
        """Return the command of each drive, or one number for one drive, from now.readings,
        now.z and now.t."""

    def rates(self, now: ForceInputs) -> Float[Array, "nz"]:
        """Return z', the rates of the states."""
        return jnp.zeros_like(now.z)

    def next(self, now: ForceInputs, every: Float[Array, ""]) -> Float[Array, "nz"]:
        """Return the states at the next sample, by default z + every z'."""
        return now.z + every * self.rates(now)


class Controller(ForceElement):
    """A controller, among the `controllers` of a model: a law between sensors and drives.

    Args:
        reads: {name: sensor}, what the law reads; a lag of a sensor is a state. If a drive follows
            its command at once, the law can read no accelerations that the drive causes.
        drives: name of an Actuator or ControlledDamper, or several
        law: a law of `jb.control`, or a ControlLaw of your own
        every: for a sampled law the time between samples [s], counted from the start of a motion
        delay: time of computation, after which the commands of a sample act [s], `every` at most
        pade: order of the Pade approximation of delays of sensors

    Errors: WRONG_KIND, NOT_POSITIVE, BAD_CHAIN for a delay without or above `every`; of the model:
    those of sensors, UNKNOWN_NAME and DUPLICATE_NAME for drives, BAD_SHAPE, ALGEBRAIC_LOOP.

    A mass on a spring is damped by a skyhook actuator:

    >>> model = jb.Model(
    ...     bodies={"car": jb.Body(mass=300.0)},
    ...     joints={"car": jb.Guide("world", axis=[0, 0, 1])},
    ...     elements={
    ...         "spring": jb.Spring(("car", [0, 0, 0]), ("world", [0, 0, -1]), stiffness=3e4),
    ...         "actuator": jb.Actuator(("car", [0, 0, 0]), ("world", [0, 0, -1])),
    ...     },
    ...     controllers={
    ...         "ride": jb.Controller(
    ...             {"speed": jb.Velocity("car", axis="z")}, "actuator", jb.control.skyhook(1200.0)
    ...         )
    ...     },
    ... )
    >>> poles = jb.complex_modes(jb.linearize(model, model.reference))
    >>> round(float(poles.damping_ratio[0]), 9)
    0.2
    """

    drives: tuple[str, ...] = eqx.field(static=True, kw_only=True)
    law: ControlLaw = field(kw_only=True)
    every: Any = field("s", "positive", kw_only=True)  # None for a continuous law
    delay: Float[Array, ""] | None = field("s", "positive", kw_only=True)
    order: tuple[str, ...] = eqx.field(static=True, kw_only=True)  # of the readings
    held: bool = eqx.field(static=True, kw_only=True)  # between samples, states do not change

    def __init__(self, reads, drives, law, *, every=None, delay=None, pade=0):
        self.between, self.law, self.pade = (), law, pade
        self.drives = tuple(map(plain, (drives,) if isinstance(drives, str) else drives))
        self.z, self.every, self.delay, self.held = None, None, None, False
        with Problems() as problems:
            self.reads = checked_dict(reads, "Controller.reads", "name: jb.Velocity(...)", problems)
            self.order = tuple(self.reads)
            if not isinstance(law, ControlLaw):
                problems.add(
                    "WRONG_KIND",
                    "Controller.law",
                    f"is a {type(law).__name__}",
                    value=law,
                    limit="a ControlLaw, such as jb.control.skyhook(1000.0)",
                )
            given = {"every": every, "delay": delay}
            take(self, problems, **{k: x for k, x in given.items() if x is not None})
            times = self.delay, self.every
            if delay is not None and (
                every is None or (is_concrete(times) and times[0] > times[1])
            ):
                problems.add(
                    "BAD_CHAIN",
                    "Controller.delay",
                    "is that of the computation of a sampled law",
                    value=delay,
                    limit="a delay up to every=",
                    hint="Give the delay of a continuous law to its sensors, with pade=.",
                )

    @property
    def states(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        if self.every is None:
            return self.law.states
        kinds = ("next command", "command") if self.delay is not None else ("command",)
        return (*self.law.states, *(f"{kind} of {x}" for kind in kinds for x in self.drives))

    @property
    def state_units(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.law.state_units

    def of_law(self, now: ForceInputs) -> ForceInputs:
        """Return what the law sees."""
        return replace(now, order=self.order, z=now.z[: len(self.law.states)])

    @property
    def count(self) -> int:
        return len(self.drives)

    def forces(self, now):
        return ()

    def command(self, now: ForceInputs) -> Float[Array, "*nu"]:
        """Return the present commands, in the order of the drives."""
        return self.law.command(self.of_law(now)) if self.every is None else now.z[-self.count :]

    def rates(self, now):
        if self.every is None:
            return self.law.rates(self.of_law(now))
        if self.held:
            return jnp.zeros_like(now.z)
        return (self.sampled(now, jnp.array(True), jnp.array(True)) - now.z) / self.every

    def sampled(self, now: ForceInputs, reads: Array, acts: Array) -> Float[Array, "nz"]:
        """Return the states after an instant at which the law reads its sensors, or at which the
        commands of its last sample act."""
        seen, n, nu = self.of_law(now), len(self.law.states), self.count
        new = jnp.append(self.law.next(seen, self.every), self.law.command(seen))
        z = jnp.where(reads, new, now.z[: n + nu])
        if self.delay is None:
            return z
        return jnp.append(z, jnp.where(acts, now.z[n : n + nu], now.z[n + nu :]))

    def _phases(self, t: Float[Array, ""]) -> tuple[Array, Array]:
        """Return the time t after the law read its sensors, and after commands acted, in sampling
        times from the first one."""
        return t / self.every, (t if self.delay is None else t - self.delay) / self.every

    def instants(self, t: Float[Array, ""]) -> tuple[Array, Array]:
        """Return whether the law reads its sensors at the time t, and whether commands act."""
        reads, acts = (jnp.abs(x - jnp.round(x)) < NEAR for x in self._phases(t))
        return reads, acts

    def next_instant(self, t: Float[Array, ""]) -> Float[Array, ""]:
        """Return the next time after t at which either happens."""
        left = [jnp.floor(x + NEAR) + 1 - x for x in self._phases(t)]
        return t + self.every * jnp.minimum(*left)

    def more_checks(self, model, seen, without):
        at_once = self.every is None and followed_at_once(model) & set(self.drives)

        def commands(now):
            return jnp.atleast_1d(self.law.command(self.of_law(now)))

        inputs = without if at_once else seen
        return [("law.command", commands, inputs, [(self.count,)])]


def is_sampled(table: Any) -> bool:
    """Return whether a table of force elements is one of sampled controllers."""
    return isinstance(table.rows, Controller) and table.rows.every is not None


def sampled_names(model: Any) -> tuple[str, ...]:
    """Return the names of the sampled controllers of a model."""
    return tuple(name for table in model.forces if is_sampled(table) for name in table.names)


def next_sample(model: Any, t: Float[Array, ""]) -> Float[Array, ""]:
    """Return the next instant after time t at which a law reads its sensors or commands act."""
    return jnp.min(jnp.stack([model[name].next_instant(t) for name in sampled_names(model)]))


def check_continuous(where: str, model: Any) -> None:
    """Refuse a model with sampled controllers, in functions of continuous systems. Error:
    SAMPLED."""
    if sampled := sampled_names(model):
        raise JaxbodyError(
            Problem(
                "SAMPLED",
                f"{where}.model",
                f"has sampled controllers: {', '.join(sampled)}",
                sampled,
                "continuous laws",
                "Leave every= out; approximate sampling and computation by a delay of every/2 + "
                "delay of its sensors, with pade=2. simulate takes them as they are.",
            )
        )


def followed_at_once(model: Any) -> set[str]:
    """Return the drives whose forces follow their commands at once."""
    tables = [table for table in drive_tables(model) if table.rows.bandwidth is None]
    return {name for table in tables for name in table.names}


def check_drives(problems: Problems, controllers: dict[str, Any], forces: dict[str, Any]) -> None:
    """Check that each controller drives drives of the model that no other one drives. Errors:
    UNKNOWN_NAME, DUPLICATE_NAME."""
    drives = tuple(name for name, force in forces.items() if isinstance(force, CommandedForce))
    driven: dict[str, str] = {}
    for name, controller in controllers.items():
        where = f"controllers[{name!r}].drives"
        for drive in controller.drives:
            if drive not in drives:
                problems.collected.append(unknown(drive, where, drives))
            elif drive in driven:
                problems.add(
                    "DUPLICATE_NAME",
                    where,
                    f"names '{drive}', which '{driven[drive]}' drives",
                    value=drive,
                    limit="one controller for each drive",
                )
            driven[drive] = name
