"""The matrices between inputs and outputs of small motions. With x = (Delta, Xi), motions of
supports are Xi = X u, forces enter as F u, and sensors read, to first order, y = Y0 x + Y1 x' + Y2
x'' + G u.

About rest each frame is displaced by J x and has the velocity J x' and the acceleration J x'',
where J are its twists per unit of x, so that the rows of a sensor are the derivatives of its
reading along these. Three kinds of sensor have rows in closed form: kinematic sensors by the twists
themselves, a LoadCell by V'' J and R'' J of its element, a Reaction on a support by the rows of K,
C and M of its motion. The signal chain of a sensor multiplies its response by

    gain exp(-s delay)/(1 + s lag)
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Complex, Float
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems
from jaxbody.geometry.frames import Frame, Instant
from jaxbody.geometry.points_and_orientations import DIRECTIONS
from jaxbody.geometry.vectors import cross, skew
from jaxbody.lagrange import command_forces
from jaxbody.mechanics.closed_loops import dynamics_of
from jaxbody.mechanics.hessians import (
    Configuration,
    ElementDerivatives,
    configuration_at,
    element_derivatives,
    frame_twists,
    slope,
)
from jaxbody.model.element_states import apart, settled, with_commands
from jaxbody.model.inputs.port_inputs import KINDS, BaseMotion, Command, Input, PointForce
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.layouts import Layout
from jaxbody.model.models import Model
from jaxbody.model.states import State
from jaxbody.sensors.instruments import LoadCell, Reaction
from jaxbody.sensors.kinematic_sensors import Kinematic
from jaxbody.sensors.sensors import Sensor


class Ports(eqx.Module):
    """The matrices of inputs and outputs. `orders`: for each input the order of the derivative of
    Xi that it prescribes (0 for displacements and forces); `chains`: gain, delay and lag of
    outputs; `elements`: for each output the index of the element whose force it is; `reactions`:
    the index of the component of Xi whose reaction it is; -1 for others."""

    F: Float[Array, "n nu"]
    X: Float[Array, "nxi nu"]
    Y: Float[Array, "3 ny n"]
    G: Float[Array, "ny nu"]
    chains: Chains | None
    orders: tuple[int, ...] = eqx.field(static=True)
    elements: tuple[int, ...] = eqx.field(static=True)
    reactions: tuple[int, ...] = eqx.field(static=True)


class Outputs(NamedTuple):
    """The sensors, and the names and units of all components of their readings: "seat", or
    "seat.x", "seat.y", "seat.z"."""

    names: tuple[str, ...]
    sensors: tuple[Sensor, ...]
    units: tuple[str, ...]


class Chains(eqx.Module):
    """Gain, delay [s] and lag [s] of each output."""

    gain: Float[Array, "ny"]
    delay: Float[Array, "ny"]
    lag: Float[Array, "ny"]
    lagged: tuple[int, ...] = eqx.field(static=True)  # the outputs that have a lag

    def at(self, s: Complex[Array, "nf"]) -> Complex[Array, "ny nf"]:
        """Return gain exp(-s delay)/(1 + s lag) at each s."""
        gain, delay, lag = (x.astype(s.dtype)[:, None] for x in (self.gain, self.delay, self.lag))
        return gain * jnp.exp(-s[None] * delay) / (1 + s[None] * lag)


def inputs_of(
    model: Model, given: Any, where: str, problems: Problems
) -> tuple[tuple[str, ...], tuple[Input, ...], tuple[str, ...]]:
    """Return names, inputs and units of a dict of inputs; errors are added to `problems`."""
    ports = _checked(
        model,
        given,
        Input,
        f"{where}.inputs",
        "{name: BaseMotion, PointForce or Command}",
        problems,
    )
    return tuple(ports), tuple(ports.values()), tuple(port.unit for port in ports.values())


def outputs_of(model: Model, given: Any, where: str, problems: Problems) -> Outputs:
    """Return the outputs of a dict of sensors; errors are added to `problems`."""
    sensors = _checked(
        model,
        given,
        Sensor,
        f"{where}.outputs",
        "{name: sensor}, such as jb.Position(...)",
        problems,
    )
    units = component_units(sensors, model)
    return Outputs(tuple(units), tuple(sensors.values()), tuple(units.values()))


def _checked(
    model: Model, given: Any, kinds: Any, where: str, limit: str, problems: Problems
) -> dict[str, Any]:
    """Return the dict if all its values are of these kinds and fit the model, otherwise an empty
    one."""
    if not isinstance(given, dict) or not given:
        problems.add(
            "WRONG_KIND",
            where,
            f"is {given!r:.60}",
            value=given,
            limit=limit,
            hint="Name each of them.",
        )
        return {}
    known = len(problems.collected)
    for name, port in given.items():
        path = f"{where}[{name!r}]"
        if not isinstance(port, kinds):
            problems.add("WRONG_KIND", path, f"is a {type(port).__name__}", value=port, limit=limit)
        elif (problem := type(port).problem(port, model, path)) is not None:
            # Equinox takes long to bind a method
            problems.collected.append(problem)
    return {} if len(problems.collected) > known else given


def component_units(sensors: dict[str, Any], model: Model | None = None) -> dict[str, str]:
    """Return {"seat.x": unit} of all components. Units of sensors on elements depend on the model,
    if it is given."""
    units = {}
    for name, sensor in sensors.items():
        if not isinstance(sensor, Sensor):
            units[name] = ""
            continue
        unit, parts = (
            sensor.unit if model is None else type(sensor).unit_on(sensor, model),
            sensor.components,
        )
        each = [part.strip() for part in unit.split(",")]
        units |= {
            f"{name}.{part}" if part else name: each[i * len(each) // len(parts)]
            for i, part in enumerate(parts)
        }
    return units


def chains_of(sensors: tuple[Sensor, ...]) -> Chains | None:
    """Return gain, delay and lag of all components; None if no sensor has any."""
    if all(
        getattr(sensor, stage) is None for sensor in sensors for stage in ("gain", "delay", "lag")
    ):
        return None

    def each(stage: str, none: float) -> Float[Array, "ny"]:
        given = [(getattr(sensor, stage), len(sensor.components)) for sensor in sensors]
        return jnp.concatenate(
            [jnp.broadcast_to(none if x is None else x, (count,)) for x, count in given]
        )

    with_lag = [sensor.lag is not None for sensor in sensors for _ in sensor.components]
    lagged = tuple(np.flatnonzero(with_lag).tolist())
    return Chains(each("gain", 1.0), each("delay", 0.0), each("lag", 0.0), lagged)


class _Rows(NamedTuple):
    """The rows of one sensor, and for each component the index of its element and of its reaction,
    () if it has none."""

    Y: Float[Array, "3 k n"]
    G: Float[Array, "k nu"]
    elements: tuple[int, ...] = ()
    reactions: tuple[int, ...] = ()


def rows_of(
    lin: Any,
    at: Configuration,
    twists,
    sensors: tuple[Sensor, ...],
    F: Float[Array, "n nu"],
    wrenches: Float[Array, "nu nb 6"],
    drives: dict[str, int],
):
    """Return Y and G of all outputs, and the indices of elements and reactions.

    Args:
        lin: the linearization
        at: its configuration
        twists: displacement and rotation of each frame per unit of each of (Delta, Xi)
        sensors: the outputs
        F: generalized force of each input, per unit
        wrenches: force and moment of each input on each body about its origin, in world axes, per
            unit
        drives: {drive: index of the input that is its command}"""
    model, zero = lin.model, jnp.zeros(len(F), F.dtype)

    def reads_element(sensor: Sensor) -> bool:
        """Return whether the rows of a sensor are those of the derivatives of its element."""
        of_force = isinstance(sensor, LoadCell)
        return of_force and not (lin.inner or sensor.needs_accelerations(model))

    elements = _by_name(model, at) if any(map(reads_element, sensors)) else {}
    held = None  # force on the supports
    if any(reads_matrices(sensor, model) for sensor in sensors):
        held = slope(at)[model.layout.nv :]
        held = held if lin.dependent is None else held + lin.dependent.reaction

    def in_closed_form(sensor: Sensor) -> _Rows | None:
        """Return the rows of a sensor that need no derivatives of its reading; None if there are
        none."""
        if isinstance(sensor, Kinematic):
            moved = sensor.rows(model, at.frames, twists).reshape(len(F), -1).T
            Y = jnp.zeros((3, *moved.shape), F.dtype).at[sensor.order].set(moved)
            return _Rows(Y, jnp.zeros((len(moved), F.shape[1]), F.dtype))
        if isinstance(sensor, LoadCell) and reads_element(sensor):
            i, derivatives = elements[sensor.on]
            k = sensor.component or 0
            J = (
                derivatives.J
                if lin.dependent is None
                else derivatives.J @ lin.dependent.whole(0, model.layout.nxi)
            )
            Y = jnp.stack([derivatives.stiffness[k] @ J, derivatives.damping[k] @ J, zero])[:, None]
            return _Rows(Y, jnp.zeros((1, F.shape[1]), F.dtype), (i,))
        return _reaction_rows(lin, held, sensor, F) if reads_matrices(sensor, model) else None

    known = [in_closed_form(sensor) for sensor in sensors]
    others = [sensor for sensor, row in zip(sensors, known, strict=True) if row is None]
    readings = iter(_read_rows(lin, at, twists, others, wrenches, drives) if others else ())
    rows = [next(readings) if row is None else row for row in known]
    return (
        jnp.concatenate([row.Y for row in rows], 1),
        jnp.concatenate([row.G for row in rows]),
        tuple(i for row in rows for i in row.elements or (-1,) * len(row.G)),
        tuple(i for row in rows for i in row.reactions or (-1,) * len(row.G)),
    )


def reads_matrices(sensor: Any, model: Model) -> bool:
    """Return whether the rows of a sensor are those of the matrices of a support's motion."""
    return (
        isinstance(sensor, Reaction) and sensor.on in model.layout.supports and sensor.point is None
    )


def _by_name(model: Model, at: Configuration) -> dict[str, tuple[int, ElementDerivatives]]:
    """Return {element: (its index, its derivatives)}."""
    rows = [
        ElementDerivatives(*(x[i] for x in derivatives))
        for derivatives in element_derivatives(at)
        for i in range(len(derivatives.J))
    ]
    return dict(zip(model.owner_names, enumerate(rows), strict=True))


def _read_rows(
    lin: Any,
    at: Configuration,
    twists: Float[Array, "nf n 6"],
    sensors: list[Sensor],
    wrenches: Float[Array, "nu nb 6"],
    drives: dict[str, int],
) -> list[_Rows]:
    """Return the rows of sensors by the derivatives of their readings; accelerations are those of
    x'', so that no equation of motion is solved."""
    model, q, layout, frames = lin.model, lin.state.q, lin.model.layout, at.frames
    dynamics, zero = dynamics_of(lin.held, (), lin.loads), jnp.zeros(twists.shape[1], q.dtype)
    n, k, with_mass = len(lin.independent), lin.inner, len(layout.inertial)
    T = None if lin.dependent is None else lin.dependent.whole(lin.inner, layout.nxi)[: layout.nv]

    def held(x, rate, u) -> Model:
        """Return the model with displaced coordinates of elements, and with commands."""
        return with_commands(displaced(x, rate), {name: u[j] for name, j in drives.items()})

    def displaced(x, rate) -> Model:
        if not k:
            return lin.held
        y, y_dot, z, zero = x[n : n + k], rate[n : n + k], lin.state.z, jnp.zeros_like(lin.state.z)
        z = z.at[layout.inner_places[:k]].add(y).at[layout.inner_rates].add(y_dot[:with_mass])
        return (
            settled(model, z)
            if lin.slow
            else apart(model, z, zero.at[layout.inner_places[:k]].set(y_dot))
        )

    def moved(x, rate, change, u) -> Instant:
        (dp, turn), (v, w), (a, alpha) = (
            jnp.split(jnp.einsum("fni,n->fi", twists, y), 2, -1) for y in (x, rate, change)
        )
        step = Frame(frames.p, frames.R, dp, turn).rates()
        delta, v_own = (y[: layout.nv] if T is None else T @ y for y in (x, rate))
        state = State(dynamics.coordinates.retract(q, delta), v_own)
        now = Instant(
            frames.p + step.p, frames.R + step.R, v, w, jnp.zeros((), q.dtype), state, a, alpha
        )
        if any(sensor.reactions for sensor in sensors):
            extra = jnp.tensordot(u, wrenches, 1)
            now = dynamics_of(held(x, rate, u), (), lin.loads).with_reactions(
                now, (extra[:, :3], extra[:, 3:])
            )
        return now

    start = (zero, zero, zero, jnp.zeros(len(wrenches), q.dtype))
    rest = jax.lax.stop_gradient(moved(*start))

    def readings(x, rate, change, u):
        instant, present = moved(x, rate, change, u), held(x, rate, u)
        return jnp.concatenate(
            [jnp.ravel(sensor.change(present, instant, rest, dynamics.model)) for sensor in sensors]
        )

    ends = np.cumsum([len(sensor.components) for sensor in sensors])[:-1]
    *rows, direct = jax.jacfwd(readings, (0, 1, 2, 3))(*start)
    return [
        _Rows(Y, G)
        for Y, G in zip(jnp.split(jnp.stack(rows), ends, 1), jnp.split(direct, ends), strict=True)
    ]


def _reaction_rows(lin: Any, held: Any, sensor: Any, F: Float[Array, "n nu"]) -> _Rows:
    """Return minus the rows of K, C and M of a support's motion, and the forces on it; `held`:
    forces and moments on all supports in the configuration. To the rows of a moment m, phi x m/2 is
    added: the moment equals dV/dphi only at the rotation vector phi = 0; in general m = J(phi)^-T
    dV/dphi."""
    nv, first = lin.M.shape[-1], 6 * lin.model.layout.supports.index(sensor.on)
    places = (
        tuple(range(first, first + 6)) if sensor.component is None else (first + sensor.component,)
    )
    own = nv + np.array(places)
    turned = (
        jnp.zeros((6, len(F)), F.dtype)
        .at[3:, nv + first + 3 : nv + first + 6]
        .set(-skew(held[first + 3 : first + 6]) / 2)
    )
    K, C, M = (A[own] for A in lin.whole)
    return _Rows(-jnp.stack([K + turned[np.array(places) - first], C, M]), F[own], reactions=places)


@program
def port_matrices(lin: Any, inputs: tuple[Input, ...], sensors: tuple[Sensor, ...]) -> Ports:
    """Return the matrices between these inputs and outputs on a linearization."""
    layout = lin.model.layout
    at = configuration_at(Coordinates(lin.held), lin.state.q)
    twists = frame_twists(at)
    if lin.inner:  # coordinates of elements move no frame
        twists = jnp.insert(twists, np.full(lin.inner, layout.nv), 0.0, axis=1)
    if lin.dependent is not None:
        twists = jnp.einsum("fni,nm->fmi", twists, lin.dependent.whole(lin.inner, layout.nxi))
    F, X, wrenches = _input_matrices(inputs, at.frames, twists, layout)
    drives = {port.on: j for j, port in enumerate(inputs) if isinstance(port, Command)}
    if drives:
        columns = command_forces(lin.model, lin.state, lin.loads, tuple(drives))
        if lin.dependent is not None:
            columns = lin.dependent.whole(lin.inner, layout.nxi).T @ columns
        F = jnp.asarray(F).at[:, np.array([*drives.values()])].set(columns)
    rows, direct, elements, reactions = rows_of(lin, at, twists, sensors, F, wrenches, drives)
    orders = tuple(KINDS.index(port.kind) if isinstance(port, BaseMotion) else 0 for port in inputs)
    return Ports(F, X, rows, direct, chains_of(sensors), orders, elements, reactions)


def check_ports(lin: Any, inputs: Any, outputs: Any, where: str) -> tuple[tuple[Any, ...], Outputs]:
    """Check inputs and outputs; return (names, inputs, units) and the outputs. All errors are
    raised at once."""
    with Problems() as problems:
        given, sensed = (
            inputs_of(lin.model, inputs, where, problems),
            outputs_of(lin.model, outputs, where, problems),
        )
        if lin.slow and len(lin.model.layout.first_order):
            for name, port in zip(*given[:2], strict=True):
                if isinstance(port, Command):
                    problems.add(
                        "MEMORY",
                        f"{where}.inputs[{name!r}]",
                        "acts on states of drives, which have no rows",
                        value=port,
                        hint="Give the linear system itself, not its `condensed`.",
                    )
            for sensor in sensed.sensors:
                if sensor.reactions and not reads_matrices(sensor, lin.model):
                    problems.add(
                        "MEMORY",
                        f"{where}.outputs",
                        f"reads reactions on '{sensor.on}' while states of force elements have no "
                        "rows",
                        value=sensor,
                        hint="Give the linear system itself, not its `condensed`.",
                    )
    return given, sensed


def _input_matrices(
    inputs: tuple[Input, ...], frames: Frame, twists: Float[Array, "nf n 6"], layout: Layout
) -> tuple[Float[Array, "n nu"], Float[Array, "nxi nu"], Float[Array, "nu nb 6"]]:
    """Return F and X, and force and moment on each body about its origin, per unit of input."""
    dtype, nu = twists.dtype, len(inputs)
    F, X = jnp.zeros((twists.shape[1], nu), dtype), jnp.zeros((layout.nxi, nu), dtype)
    wrenches = jnp.zeros((nu, len(layout.bodies), 6), dtype)
    for j, port in enumerate(inputs):
        if isinstance(port, BaseMotion):
            place = 6 * layout.supports.index(port.on) + DIRECTIONS.index(port.direction)
            X = X.at[place, j].set(1.0)
        elif isinstance(port, PointForce):
            row, axis = layout.frame(port.on), jnp.asarray(port.axis)
            if port.turns:
                force, moment, work = jnp.zeros(3), axis, twists[row, :, 3:] @ axis
            else:
                force, moment = axis, cross(frames[row].point(port.point) - frames.p[row], axis)
                work = twists[row, :, :3] @ force + twists[row, :, 3:] @ moment
            F = F.at[:, j].set(work)
            wrench = jnp.concatenate([force, moment])
            wrenches = wrenches.at[j, row - layout.first_body].set(wrench)
    return F, X, wrenches
