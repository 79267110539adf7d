"""Elements without a potential: forces and moments on frames, from the motion of these frames, from
readings of sensors and from states of their own.

    P = sum of F . v* + M . w*      virtual power, by which they enter the equations of motion
    z' = f(frames, readings, z, t)  states of their own
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from math import prod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import Array, Float, concrete
from jaxbody.core.errors import JaxbodyError, Problems
from jaxbody.geometry.fields import Described, Kind, field
from jaxbody.geometry.frames import Frame, Wrench
from jaxbody.geometry.vectors import cross, rotate, rotate_back
from jaxbody.model.forces.reading_filters import filter_states, filtered

PLAIN = {"kind": Kind(), "words": {}}  # of a field without unit


class ForceInputs(eqx.Module):
    """What a force element sees at one instant: its `frames`, in the order of `between`, with p, R,
    v, w, point(a) and velocity(a); its `readings` by name; its states `z`; the time `t` [s]; the
    `command` of its controller; and the rates of the states of its readings."""

    frames: tuple[Frame, ...]
    readings: dict[str, Array]
    z: Float[Array, "nz"]
    t: Float[Array, ""]
    command: Float[Array, ""] | float = 0.0
    filter_rates: tuple[Float[Array, "_"], ...] = ()
    # names of the readings of a law, as dicts in JAX are sorted by their keys
    order: tuple[str, ...] = eqx.field(static=True, default=())

    def opposed(self, force: Any, a: Any = (0, 0, 0), b: Any = (0, 0, 0)) -> tuple[Wrench, ...]:
        """Return the wrenches of `force` [N], in world axes, on point b of the second frame, and of
        its opposite on point a of the first."""
        arms = [
            rotate(frame.R, jnp.asarray(x, frame.R.dtype))
            for frame, x in zip(self.frames, (a, b), strict=True)
        ]
        return (-force, -cross(arms[0], force)), (force, cross(arms[1], force))


class ForceElement(Described, eqx.Module):
    """The base class of elements that exert forces without a potential, among the `elements` of a
    model.

    A user-defined one defines `forces` and, if it has states, `states` and `rates`. At rest its
    rates are zero, which fixes states such as integrals; states without influence at rest keep
    those of `start`.

    Args:
        between: names of the frames on which it acts, or one name
        reads: {name: sensor}, by default none. A force can read the accelerations of supports only,
            rates can read all. Gains and biases of sensors apply, a lag is one more state.
        pade: order of the Pade approximation of delays of these sensors, whose terms are states

    A self-leveling strut: a force that grows with the time integral of the travel.

    >>> class Leveler(jb.ForceElement):
    ...     gain: jax.Array = jb.field("N/m s")
    ...     states, state_units = ("integral",), ("m s",)
    ...     def forces(self, now):
    ...         return now.opposed(-self.gain * now.z[0] * jnp.array([0, 0, 1.0]))
    ...     def rates(self, now):
    ...         return now.readings["travel"][None]
    >>> model = jb.Model(
    ...     bodies={"car": jb.Body(mass=300.0)},
    ...     joints={"car": jb.Guide("world", axis=[0, 0, 1])},
    ...     elements={
    ...         "spring": jb.SpringDamper(
    ...             ("car", [0, 0, 0]), ("world", [0, 0, -1]), spring=2e4, damper=2e3, free_length=1
    ...         ),
    ...         "level": Leveler(
    ...             ("world", "car"),
    ...             gain=jnp.array(1e4),
    ...             reads={"travel": jb.Elongation("spring")},
    ...         ),
    ...     },
    ...     gravity=[0, 0, -10.0],
    ... )
    >>> eq = jb.equilibrium(model)
    >>> round(float(eq.elongations["spring"]), 12) + 0.0, round(float(eq.state.z[0]), 12)
    (0.0, -0.3)
    """

    between: tuple[str, ...] = eqx.field(
        static=True, converter=lambda on: plain((on,) if isinstance(on, str) else tuple(on))
    )
    # keyword-only, which type checkers see in a field of Equinox alone
    reads: dict[str, Any] | None = eqx.field(default=None, kw_only=True, metadata=PLAIN)
    pade: int = eqx.field(static=True, default=0, kw_only=True)
    # the present states, where a model holds them
    z: Float[Array, "nz"] | None = eqx.field(default=None, kw_only=True, metadata=PLAIN)
    states: ClassVar[tuple[str, ...]] = ()  # descriptions of the states
    state_units: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def forces(self, now: ForceInputs) -> tuple[Wrench, ...]:
        """Return force [N] and moment about its origin [N m] on each frame, in world axes."""

    def rates(self, now: ForceInputs) -> Float[Array, "nz"]:
        """Return z', the rates of the states."""
        return jnp.zeros_like(now.z)

    def more_checks(self, model: Any, seen: ForceInputs, without: ForceInputs) -> list[tuple]:
        """Return more functions to check, [(name, function, inputs, shapes of its results)], with
        all readings and without those of accelerations that forces cause."""
        return []

    @property
    def points(self) -> tuple[Float[Array, "*rows 3"], ...]:
        """The points of attachment, one in each frame."""
        return ()

    def as_drawn(self, *orientations: Float[Array, "4"]) -> ForceElement:
        """Return the element with the fields that follow from the drawing."""
        return self

    def all_states(self) -> tuple[tuple[str, str], ...]:
        """Return description and unit of each state: its own, then those of its readings."""
        return (
            *zip(self.states, (*self.state_units, *[""] * len(self.states)), strict=False),
            *(
                (f"{name} filtered {i + 1}", "")
                for name, sensor in (self.reads or {}).items()
                if (width := filter_states(sensor, self.pade))
                for i in range(width * prod(sensor.shape))
            ),
        )

    def seen(
        self, model: Any, now: Any, frames: tuple[Frame, ...], command: Any = 0.0, *, rates: bool
    ) -> ForceInputs:
        """Return what its forces, or its rates, see in the frames of a model at an instant."""
        dtype, n = model.gravity.dtype, len(self.states)
        z = jnp.zeros(n, dtype) if self.z is None else self.z
        readings, filter_rates, at = {}, [], n
        for name, sensor in (self.reads or {}).items():
            known = rates or not refers_to_caused(sensor, model)
            x = sensor.reading(model, now) if known else None
            if width := filter_states(sensor, self.pade):
                k = prod(sensor.shape)
                own, at = z[at : at + k * width].reshape(k, width), at + k * width
                y, of_filter = filtered(sensor, self.pade, None if x is None else x.ravel(), own)
                filter_rates += [jnp.stack(of_filter, 1).ravel()] if known else []
                x = None if y is None else y.reshape(sensor.shape)
            if x is not None:
                readings[name] = scaled_reading(sensor, x)
        t, of_filters = jnp.asarray(now.t), tuple(filter_rates)
        return ForceInputs(frames, readings, z[:n], t, command, of_filters)


class PointPair(ForceElement):
    """The base class of forces of point a of one frame against point b of another; `relative` and
    `acting` are for those by the displacement x of a from b and its rate, in the axes of the second
    frame."""

    a: Float[Array, "3"] = field("m")
    b: Float[Array, "3"] = field("m")

    @property
    def points(self):
        return self.a, self.b

    def relative(self, now: ForceInputs) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        """Return x [m] and x' [m/s]."""
        A, B = now.frames
        away = A.point(self.a) - B.p
        rate = A.velocity(self.a) - B.v - cross(B.w, away)
        return rotate_back(B.R, away) - self.b, rotate_back(B.R, rate)

    def acting(self, now: ForceInputs, force: Float[Array, "3"]) -> tuple[Wrench, Wrench]:
        """Return the wrenches of a force on the first frame, in the axes of the second, and of its
        opposite on the second, both at the point a."""
        A, B = now.frames
        F = rotate(B.R, force)
        return (F, cross(rotate(A.R, self.a), F)), (-F, -cross(A.point(self.a) - B.p, F))


def scaled_reading(sensor: Any, x: Array) -> Array:
    """Return a reading after the gain and with the bias of its sensor."""
    x = x if sensor.gain is None else sensor.gain * x
    return x if sensor.bias is None else sensor.disturbed(x, sensor.bias)


def refers_to_caused(sensor: Any, model: Any) -> bool:
    """Return whether a sensor reads accelerations that forces cause, other than those of supports,
    which are imposed, and have no lag before they are read."""
    imposed = ("world", *model.layout.supports)
    return (
        sensor.lag is None
        and sensor.needs_accelerations(model)
        and (sensor.reactions or not set(sensor.names) <= set(imposed))
    )


def check_force(problems: Problems, where: str, force: ForceElement, model: Any) -> None:
    """Check the sensors of a force element on a model, and the shapes of what its functions return;
    nothing is computed. Errors: WRONG_KIND, DUPLICATE_NAME, those of sensors, BAD_CHAIN,
    ALGEBRAIC_LOOP, FUNCTION_FAILED, BAD_SHAPE."""
    sensors, known = {}, len(problems.collected)
    for name, sensor in (force.reads or {}).items():
        at = f"{where}.reads[{name!r}]"
        if not hasattr(sensor, "reading"):
            problems.add(
                "WRONG_KIND",
                at,
                f"is a {type(sensor).__name__}",
                value=sensor,
                limit="a sensor, such as jb.Position(...)",
            )
            continue
        problem = sensor.problem(model, at)
        problems.collected += [] if problem is None else [problem]
        if problem is None and sensor.follows_commands(model):
            problems.add(
                "ALGEBRAIC_LOOP",
                at,
                f"follows the commands that depend on it: {at} -> command -> {sensor.on}",
                value=sensor.on,
                limit="readings that no command changes at once",
                hint="Read the DriveForce of an actuator with a bandwidth.",
            )
        delay = 0.0 if sensor.delay is None else concrete(sensor.delay)
        late = sensor.delay is not None and (not force.pade or (delay is not None and delay <= 0))
        if sensor.reactions or late:
            problems.add(
                "BAD_CHAIN",
                at,
                "reads reactions" if sensor.reactions else "has a delay",
                value=sensor,
                limit="gain, bias, lag, and a delay > 0 with pade=",
                hint="Read a LoadCell in place of a Reaction; give pade=2, the order of the Pade "
                "approximation, for a delay.",
            )
        twin = next((other for other, x in sensors.items() if eqx.tree_equal(x, sensor)), None)
        if twin is not None:
            problems.add(
                "DUPLICATE_NAME",
                at,
                f"is the same reading as '{twin}'",
                value=name,
                hint="Leave one of them out.",
            )
        sensors[name] = sensor
    if len(problems.collected) > known:
        return
    caused = {name for name, sensor in sensors.items() if refers_to_caused(sensor, model)}
    dtype, n = model.gravity.dtype, len(force.between)
    still, zero = np.zeros(3, dtype), np.zeros((), dtype)
    frames = (Frame(still, np.eye(3, dtype=dtype), still, still),) * n
    readings: Any = {name: np.zeros(x.shape, dtype) for name, x in sensors.items()}
    z = np.zeros(len(force.states), dtype)
    seen = ForceInputs(frames, readings, z, zero, zero)
    without = replace(seen, readings={k: x for k, x in readings.items() if k not in caused})
    for name, function, inputs, shapes in (
        ("forces", force.forces, without, [(3,)] * (2 * n)),
        *force.more_checks(model, seen, without),
        ("rates", force.rates, seen, [(len(force.states),)]),
    ):
        if len(problems.collected) == known:
            _check_result(problems, f"{where}.{name}", function, inputs, shapes, caused)


def _check_result(
    problems: Problems,
    where: str,
    function: Any,
    inputs: ForceInputs,
    shapes: list[tuple[int, ...]],
    caused: set[str],
) -> None:
    """Check that JAX can trace a function, and that it returns arrays of these shapes. `caused`:
    readings that only `rates` may have."""
    try:
        out = [x.shape for x in jax.tree.leaves(jax.eval_shape(function, inputs))]
    except JaxbodyError as error:
        problems.collected += [replace(problem, where=where) for problem in error.problems]
        return
    except Exception as error:  # a function of the user may raise anything
        text = f"raises {type(error).__name__}: {(str(error).splitlines() or [''])[0]:.200}"
        if isinstance(error, KeyError) and error.args[0] in caused:
            reading = f"reads[{error.args[0]!r}]"
            problems.add(
                "ALGEBRAIC_LOOP",
                where,
                f"reads accelerations that it causes: {where} -> acceleration -> {reading}",
                value=error.args[0],
                limit="positions, velocities, states, accelerations of supports",
                hint="Read it in `rates`, or give its sensor a lag or its drive a bandwidth.",
            )
        else:
            problems.add("FUNCTION_FAILED", where, text, limit="functions of jax.numpy")
        return
    if out != shapes:
        problems.add(
            "BAD_SHAPE",
            where,
            f"returns arrays of shape {', '.join(map(str, out)) or 'none'}",
            value=out,
            limit=", ".join(map(str, shapes)),
            hint="`forces` returns force and moment for each frame of `between`, three numbers "
            "each; `rates` one number for each state, `command` one for each drive.",
        )
