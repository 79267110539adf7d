"""Loads: external forces and moments on bodies as functions of time. They belong to a run, like the
motions of supports.

A load F, M at a point P of a body enters the equations of motion by its virtual
power F . v*_P + M . w*.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import check_kind, check_one_of, checked_dict, plain, warn_of_degrees
from jaxbody.core.arrays import Array, Float, checked, concrete, device_array
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, take
from jaxbody.geometry.frames import Instant, Wrench
from jaxbody.geometry.points_and_orientations import direction, ends
from jaxbody.geometry.vectors import cross, dot, rotate
from jaxbody.model.forces.force_elements import ForceElement
from jaxbody.model.inputs.signals import Signal, as_signal, turned


class Load(ForceElement):
    """The base class of loads, force elements at a point of one body: a user-defined load derives
    from it and defines `at_point`.

    >>> class Thrust(jb.inputs.Load):
    ...     level: jax.Array
    ...     def at_point(self, now):
    ...         return self.level * now.R[:, 2], jnp.zeros(3)
    >>> Thrust("rocket", jnp.zeros(3), jnp.array(10.0)).on
    'rocket'
    """

    point: Float[Array, "3"] = field("m")

    @property
    def on(self) -> str:
        """The body on which it acts."""
        return self.between[0]

    @property
    def points(self):
        return (self.point,)

    @abstractmethod
    def at_point(self, now: Instant) -> Wrench:
        """Return force [N] and moment [N m] at the point, in world axes; `now` is the body's frame:
        p, R, v, w, and the time t."""

    def __init_subclass__(cls, **kwargs: Any):
        super().__init_subclass__(**kwargs)
        if "at_point" in vars(cls) and "after" not in vars(cls):
            cls.after = Load.after  # an inherited `after` would use the base class's formula

    def after(self, t0: Float[Array, ""]) -> Load:
        """Return the load at the time t0 + t, with its signals shifted by `Signal.after`."""
        return _Later(self.on, self.point, self, t0)

    def signals(self) -> tuple[Signal, ...]:
        """Return the signals (functions of time) among the fields of the load."""
        return tuple(part for part in vars(self).values() if isinstance(part, Signal))

    def dead_force(self, t: Float[Array, ""]) -> Float[Array, "3"]:
        """Return the force [N] at the point, in world axes, of a load that does not depend on the
        motion of its body; NaN for other loads."""
        return jnp.full(3, jnp.nan, t.dtype)

    def forces(self, now):
        (frame,) = now.frames
        F, M = self.at_point(frame.at_time(now.t))
        return ((F, M + cross(rotate(frame.R, self.point), F)),)


class _Later(Load):
    """A load shifted in time: at the time t it is `load` at the time t0 + t."""

    load: Load = field()
    t0: Float[Array, ""] = field("s")

    def signals(self):
        return tuple(signal.after(self.t0) for signal in self.load.signals())

    def at_point(self, now):
        return self.load.at_point(replace(now, t=now.t + self.t0))


class Force(Load):
    """A force and a moment at a point of a body, constant or varying with time, in the axes of the
    world (dead) or of the body (following).

    Args:
        on: the body, or (body, point)
        force: [N], three numbers, a Signal (jb.signals) or a function of time
        moment: [N m], likewise
        axes: "world" or "body"

    Errors: BAD_AXES, BAD_SHAPE, NON_FINITE.

    >>> pull = jb.Force(("engine", [0, 0, 0.2]), force=[100.0, 0, 0])
    >>> pull.on
    'engine'
    """

    force: Signal = field(words={"value": "N"})
    moment: Signal = field(words={"value": "N m"})
    axes: str = field(static=True, converter=plain)

    def __init__(self, on, *, force=(0, 0, 0), moment=(0, 0, 0), axes: str = "world"):
        with Problems() as problems:
            self.between, self.point = _place(on, "Force", problems)
            self.force, self.moment = (
                as_signal(x, f"Force.{name}", problems, (3,))
                for name, x in (("force", force), ("moment", moment))
            )
            check_one_of(
                axes,
                ("world", "body"),
                "BAD_AXES",
                "Force.axes",
                problems,
                "Name the axes in which it is given.",
            )
            self.axes = axes

    def dead_force(self, t):
        F, M = jnp.asarray(self.force(t)), jnp.asarray(self.moment(t))
        return jnp.where((self.axes == "world") & ~jnp.any(M != 0), F, jnp.nan)

    def at_point(self, now):
        F, M = jnp.asarray(self.force(now.t)), jnp.asarray(self.moment(now.t))
        return (F, M) if self.axes == "world" else (rotate(now.R, F), rotate(now.R, M))

    def after(self, t0):
        return eqx.tree_at(
            lambda load: (load.force, load.moment),
            self,
            (self.force.after(t0), self.moment.after(t0)),
        )


class Unbalance(Load):
    """A rotating unbalance u = m e on a shaft of the body, with the angle
    phi = 2 pi (f t + r t^2/2) + p:

        F = u (phi'^2 (n1 cos phi + n2 sin phi) + phi'' (n1 sin phi - n2 cos phi))

    n1 and n2 are perpendicular to the shaft and make a right-handed frame with `axis`: n1 is the
    projection of the body's x axis (of y where the shaft is along x). The rotor's mass is part of
    the body's. The effect of the body's motion on the unbalance is neglected, because u is small
    compared with the body's mass times its size.

    Args:
        on: the body, or (body, point of the shaft)
        axis: direction of the shaft; x, y, z or a direction, in body axes
        unbalance: u [kg m]
        frequency: f at t = 0 [Hz]
        run_up: rate r of the frequency [Hz/s]
        phase: p [rad]

    Errors: ZERO_AXIS, BAD_SHAPE, NON_FINITE.

    >>> motor = jb.inputs.Unbalance("motor", axis=[0, 1, 0], unbalance=1e-3, frequency=50.0)
    >>> motor.on
    'motor'
    """

    axis: Float[Array, "3"] = field("", "direction")
    unbalance: Float[Array, ""] = field("kg m")
    frequency: Float[Array, ""] = field("Hz")
    run_up: Float[Array, ""] = field("Hz/s")
    phase: Float[Array, ""] = field("rad")
    across: int = field(static=True)

    def __init__(self, on, *, axis, unbalance, frequency, run_up=0.0, phase=0.0):
        with Problems() as problems:
            self.between, self.point = _place(on, "Unbalance", problems)
            self.axis = direction(axis, "Unbalance.axis", problems)
            known = concrete(self.axis)
            self.across = 1 if known is not None and abs(known[0]) > 0.9 else 0
            take(
                self, problems, unbalance=unbalance, frequency=frequency, run_up=run_up, phase=phase
            )
        warn_of_degrees(self.phase, "Unbalance.phase")

    def perpendiculars(self) -> tuple[Array, Array]:
        """Return n1 and n2, in body axes."""
        axis = jnp.asarray(self.axis)
        reference = jnp.asarray(np.eye(3)[self.across], axis.dtype)
        n1 = reference - dot(reference, axis) * axis
        n1 = n1 / jnp.sqrt(dot(n1, n1))
        return n1, cross(axis, n1)

    def at_point(self, now):
        t = now.t
        phi = 2 * jnp.pi * (self.frequency * t + 0.5 * self.run_up * t**2) + self.phase
        rate, change = 2 * jnp.pi * (self.frequency + self.run_up * t), 2 * jnp.pi * self.run_up
        n1, n2 = self.perpendiculars()
        c, s = jnp.cos(phi), jnp.sin(phi)
        F = self.unbalance * (rate**2 * (c * n1 + s * n2) + change * (s * n1 - c * n2))
        return rotate(now.R, F), jnp.zeros_like(F)

    def after(self, t0):
        angle = self.phase + turned(self.frequency + 0.5 * self.run_up * t0, t0)
        return eqx.tree_at(
            lambda load: (load.frequency, load.phase),
            self,
            (self.frequency + self.run_up * t0, angle),
        )


class EngineTorque(Load):
    """The reaction torque of a running engine on its block, as a sum over orders (multiples) of the
    crank's speed,

        M = -n (T_0 + sum T_i cos(2 pi o_i f t + p_i))

    opposite to the torque on the crank.

    Args:
        on: the body
        axis: n, direction of the crankshaft; x, y, z or a direction, in body axes
        frequency: f of the crank [Hz] (3000 rpm: 50)
        orders: o_i, such as 2, 4, 6 for a four-cylinder four-stroke engine
        amplitudes: T_i [N m]
        phases: p_i [rad]; None: zero
        mean: T_0 [N m]

    Errors: ZERO_AXIS, BAD_SHAPE, NON_FINITE.

    >>> torque = jb.inputs.EngineTorque(
    ...     "engine",
    ...     axis=[1, 0, 0],
    ...     frequency=13.0,
    ...     mean=20.0,
    ...     orders=[2, 4],
    ...     amplitudes=[60.0, 15.0],
    ... )
    >>> torque.phases.tolist()
    [0.0, 0.0]
    """

    axis: Float[Array, "3"] = field("", "direction")
    frequency: Float[Array, ""] = field("Hz")
    mean: Float[Array, ""] = field("N m")
    orders: Float[Array, "n"] = field()
    amplitudes: Float[Array, "n"] = field("N m")
    phases: Float[Array, "n"] = field("rad")

    def __init__(self, on, *, axis, frequency, orders, amplitudes, phases=None, mean=0.0):
        with Problems() as problems:
            self.between, self.point = _place(on, "EngineTorque", problems)
            self.axis = direction(axis, "EngineTorque.axis", problems)
            take(self, problems, frequency=frequency, mean=mean)
            n = np.size(orders)
            rows = {
                "orders": orders,
                "amplitudes": amplitudes,
                "phases": np.zeros(n) if phases is None else phases,
            }
            for name, value in rows.items():
                row = checked(
                    value, ((n,),), f"EngineTorque.{name}", problems, "One number for each order."
                )
                setattr(self, name, np.zeros(n) if row is None else row)
        warn_of_degrees(self.phases, "EngineTorque.phases")

    def at_point(self, now):
        waves = self.amplitudes * jnp.cos(
            2 * jnp.pi * self.orders * self.frequency * now.t + self.phases
        )
        M = -(self.mean + jnp.sum(waves)) * rotate(now.R, self.axis)
        return jnp.zeros_like(M), M

    def after(self, t0):
        return eqx.tree_at(
            lambda load: load.phases, self, self.phases + turned(self.orders * self.frequency, t0)
        )


def _place(on: Any, kind: str, problems: Problems):
    """Return the name of the body, in a tuple, and the point, given as a name or as (name,
    point)."""
    names, (point,) = ends((on,), kind, problems)
    return names, point


def loads_of(
    loads: dict[str, Load] | None, bodies: tuple[str, ...], where: str = "loads"
) -> tuple[Load, ...]:
    """Return the loads of a run, each of which must be on a body of the model."""
    with Problems() as problems:
        given = loads_by_name(loads, where, problems)
        for name, load in given.items():
            if load.on not in bodies:
                problems.add(
                    "UNKNOWN_BODY",
                    f"{where}[{name!r}]",
                    f"is on '{load.on}', which is not a body",
                    value=load.on,
                    limit=" ".join(bodies),
                    hint="A load acts on a body.",
                )
    return tuple(jax.tree.map(device_array, load) for load in given.values())


def loads_by_name(loads: Any, where: str, problems: Problems) -> dict[str, Load]:
    """Return the loads in a dict; a problem is added for anything else in it."""
    given = checked_dict(loads, where, "name: jb.Force(...)", problems)
    for name, load in given.items():
        check_kind(load, Load, f"{where}[{name!r}]", "jb.Force(...) or another Load", problems)
    return {name: load for name, load in given.items() if isinstance(load, Load)}
