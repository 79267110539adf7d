"""Frequency response of small motions: from motions of supports and forces to motions of points,
forces of elements and reactions.

    D(w) Delta = (K~ + i w C~ - w^2 M~ + i H~) Xi + F f,    D = K + i w C - w^2 M + i H

H is hysteretic (structural) damping, the sum over the elements of eta V''(e) de de: a loss factor
times the elastic stiffness, without gravity and tension. Frequencies are the last axis of all
arrays, so that operations run along them.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.core import tables
from jaxbody.core.arrays import (
    Array,
    Bool,
    Complex,
    Float,
    Int,
    checked,
    device_array,
    float_array,
    is_concrete,
)
from jaxbody.core.compilation.compile_options import program, program_with
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, check_known, unknown
from jaxbody.core.results import Labeled, Result, dataset, warn_if_failed
from jaxbody.geometry.vectors import rotate
from jaxbody.mechanics.hessians import configuration_at, element_derivatives
from jaxbody.model.inputs.loads import Unbalance
from jaxbody.model.inputs.port_inputs import PointForce
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.models import Model
from jaxbody.model.preconditions import check_memory
from jaxbody.numerics.eigenproblems import ZERO, natural, rows_of_one_size
from jaxbody.sensors.instruments import LoadCell
from jaxbody.sensors.sensors import Sensor
from jaxbody.vibration.dynamic_matrices import (
    DynamicMatrices,
    is_unstable,
    options_by_size,
    solved,
)
from jaxbody.vibration.linearizations import Linearization, check_system
from jaxbody.vibration.natural_modes import NO_MODES, with_modal_damping
from jaxbody.vibration.ports import Ports, check_ports, port_matrices, reads_matrices

METHODS = ("direct", "modal")


class FrequencyResponse(Labeled, Result):
    """Frequency responses: complex `values` (outputs, inputs, frequencies), the amplitude of each
    output per unit of an input exp(i 2 pi f t).

    `response["seat", "road"]` is one pair over `frequencies` [Hz]; `magnitude`, and `phase` [rad],
    unwrapped over the frequencies. From a displacement of a support to a displacement, the
    magnitude is the transmissibility. `status` UNSTABLE (values NaN), SINGULAR_K where a free
    motion has no response at 0 Hz (NaN there), or that of the equilibrium."""

    index = "frequency"
    frequencies: Float[Array, "nf"]
    values: Complex[Array, "ny nu nf"]
    status: Int[Array, ""]
    inputs: tuple[str, ...] = field(static=True)
    outputs: tuple[str, ...] = field(static=True)
    input_units: tuple[str, ...] = field(static=True)
    output_units: tuple[str, ...] = field(static=True)

    @property
    def magnitude(self) -> Float[Array, "ny nu nf"]:
        return jnp.abs(self.values)

    @property
    def phase(self) -> Float[Array, "ny nu nf"]:
        angle = jnp.angle(self.values)
        return jnp.where(jnp.isnan(angle), jnp.nan, jnp.unwrap(jnp.nan_to_num(angle), axis=-1))

    def __getitem__(self, pair: tuple[str, str]) -> Complex[Array, "nf"]:
        output, name = pair
        for given, known in ((output, self.outputs), (name, self.inputs)):
            check_known(given, "response", known)
        return self.values[..., self.outputs.index(output), self.inputs.index(name), :]

    def explain(self) -> str:
        return (
            "NaN at 0 Hz; the names in jb.modes of the linearization show the free motion"
            if Status(int(self.status)) == Status.SINGULAR_K
            else ""
        )

    def unit(self, output: str, name: str) -> str:
        """Return the unit of one output per unit of one input, "" for a ratio."""
        above = self.output_units[self.outputs.index(output)]
        below = self.input_units[self.inputs.index(name)]
        return "" if above == below else f"{above} per {below}" if below else above

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: the complex response by `output`, `input` and `frequency`, with
        units by output and input."""
        units = [[self.unit(y, u) for u in self.inputs] for y in self.outputs]
        f = np.asarray(self.frequencies)
        return dataset(
            {
                "response": (("output", "input", "frequency"), self.values, "unit"),
                "unit": (("output", "input"), np.array(units), ""),
                "status": ((), self.status, ""),
            },
            {
                "output": list(self.outputs),
                "input": list(self.inputs),
                "frequency": ("frequency", f.reshape(-1, f.shape[-1])[0], {"units": "Hz"}),
            },
            "frequency response",
        )

    @tables.summarized("Frequency response", 3, values="values")
    def _tables(self) -> list[tables.PrintedTable]:
        f, size = np.asarray(self.frequencies), np.abs(np.asarray(self.values))
        largest = np.argmax(np.nan_to_num(size, nan=-1.0), -1)
        rows = [
            (
                y,
                u,
                self.unit(y, u) or "-",
                size[i, j, 0],
                size[i, j, largest[i, j]],
                f[largest[i, j]],
            )
            for i, y in enumerate(self.outputs)
            for j, u in enumerate(self.inputs)
        ]
        return [
            tables.PrintedTable(
                f"Frequency response, {f[0]:.6g} to {f[-1]:.6g} Hz",
                ("output", "input", "unit", "at first frequency", "largest", "at [Hz]"),
                rows,
                self.failure,
            )
        ]


def frequency_response(
    lin: Linearization,
    frequencies: Any,
    inputs: dict[str, Any],
    outputs: dict[str, Any],
    *,
    loss_factor: Any = None,
    modal_damping: Any = None,
    method: str = "direct",
) -> FrequencyResponse:
    """Compute the response at `frequencies` [Hz] from named inputs to named outputs, {name: port},
    of small motions about an equilibrium.

        D(w) Delta = (K~ + i w C~ - w^2 M~) Xi + F f,   D(w) = K + i w C - w^2 M

    At 0 Hz the response is static. With both methods it is differentiable with respect to the
    model, points of ports, damping and frequencies, also where modes coincide.

    Args:
        lin: `linearize(model, equilibrium(model))`.
        frequencies: frequencies [Hz], 0 or more, in one row.
        inputs: {name: BaseMotion, PointForce or Unbalance}; of an Unbalance, the response to it as
            it turns with each of the frequencies, whatever its own frequency is.
        outputs: {name: sensor}, such as Position, Acceleration, Elongation, LoadCell or Reaction;
            a sensor of several numbers has the outputs "seat.x", "seat.y", "seat.z". Gain, delay
            and lag multiply a response by gain exp(-i w delay)/(1 + i w lag).
        loss_factor: hysteretic damping, i eta times the stiffness V''(e) of elements, one number
            for all or {element: eta}; by default none. It is an option here and not a property of a
            model because it exists for harmonic motion only.
        modal_damping: damping ratios added to those of the dampers, one for all natural modes or
            one for each, in ascending order; by default none. They damp the motion relative to the
            quasi-static one; ratios of coinciding modes are averaged.
        method: "direct" (default), by elimination at each frequency, or "modal", the sum over all
            complex modes; both agree to rounding.

    Errors: BAD_FREQUENCY below 0 Hz, and at 0 Hz for an input that is a velocity or an
    acceleration, UNKNOWN_NAME, WRONG_KIND, BAD_COMPONENT, BAD_METHOD, BAD_SHAPE, NON_FINITE,
    TOO_LARGE, NEGATIVE loss factors or damping ratios, BAD_OPTION for either with sensors of
    forces; warns UNSTABLE, SINGULAR_K at 0 Hz, DEFECTIVE (modes), NONFINITE (an undamped
    resonance), and for modal damping NOT_SYMMETRIC, SINGULAR_M.

    >>> spring = jb.Spring(
    ...     ("mass", [0, 0, 0]), ("base", [0, 1, 0]), stiffness=50.0, free_length=1.0
    ... )
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     supports={"base": jb.Support()},
    ...     elements={"s": spring},
    ... )
    >>> lin = jb.linearize(model, jb.equilibrium(model))
    >>> response = jb.frequency_response(
    ...     lin,
    ...     [2.0],
    ...     {"base": jb.BaseMotion("base", "y")},
    ...     {"mass": jb.Position("mass", axis="y")},
    ... )
    >>> round(float(response["mass", "base"][0].real * (1 - (2.0 * 2 * jnp.pi) ** 2 / 25)), 12)
    1.0
    """
    check_system(lin, "frequency_response")
    f = check_frequencies(frequencies, "frequency_response.frequencies", static=True)
    turning = (
        {}
        if not isinstance(inputs, dict)
        else {name: load for name, load in inputs.items() if isinstance(load, Unbalance)}
    )
    (u, ins, u_units), (y, sensors, y_units) = check_ports(
        lin, _forces_of(lin, turning, inputs), outputs, "frequency_response"
    )
    if method not in METHODS:
        raise JaxbodyError(
            Problem(
                "BAD_METHOD",
                "frequency_response.method",
                f"is {method!r}",
                method,
                " ".join(METHODS),
            )
        )
    check_memory("frequency_response", lin.model, f.size if method == "direct" else 0)
    static = is_concrete(f) and not np.asarray(f).all()
    if static:
        _check_bounded_at_rest(u, ins)
    lin, eta = damped(lin, sensors, loss_factor, modal_damping, "frequency_response")
    values, status = response_values(lin, f, port_matrices(lin, ins, sensors), eta, method, static)
    if turning:
        values = _turned(f, values, u, list(inputs), turning)
        u_units = tuple("" if name in turning else u_units[u.index(name)] for name in inputs)
        u = tuple(inputs)
    return warn_if_failed(FrequencyResponse(f, values, status, u, y, u_units, y_units))


def _forces_of(lin: Linearization, turning: dict[str, Unbalance], inputs: Any) -> Any:
    """Return the inputs with two forces in place of each unbalance: along n1, by its name, and
    along n2."""
    with Problems() as problems:
        for name, load in turning.items():
            known = lin.model.layout.bodies
            if load.on not in known:
                where = f"frequency_response.inputs[{name!r}]"
                problems.collected.append(unknown(load.on, where, known))
    if not turning:
        return inputs
    forces = {}
    for name, load in turning.items():
        for key, n in zip((name, (name, 2)), _perpendiculars(lin, load), strict=True):
            forces[key] = PointForce(load.on, load.point, n)
    return inputs | forces


@program
def _perpendiculars(lin: Linearization, load: Unbalance):
    """Return n1 and n2 of an unbalance at the equilibrium, in world axes."""
    at = configuration_at(Coordinates(lin.held), lin.state.q, base=False)
    R = at.frames.R[lin.model.layout.frame(load.on)]
    return tuple(rotate(R, n) for n in load.perpendiculars())


def _turned(f: Array, values: Array, u: Any, names: list[str], turning: dict[str, Unbalance]):
    """Return the values (ny, nu, nf) by input, for an unbalance those of its force
    u w^2 (n1 - i n2) exp(i p)."""

    def of(name: str) -> Array:
        one = values[:, u.index(name)]
        if name not in turning:
            return one
        load, two = turning[name], values[:, u.index((name, 2))]
        size = load.unbalance * (2 * jnp.pi * f) ** 2
        return size * jnp.exp(1j * load.phase) * (one - 1j * two)

    return jnp.stack([of(name) for name in names], 1)


def damped(
    lin: Linearization,
    sensors: tuple[Sensor, ...],
    loss_factor: Any,
    modal_damping: Any,
    where: str,
) -> tuple[Linearization, Float[Array, "ne"] | None]:
    """Return the system with modal damping, and the loss factors of its elements. Errors: MEMORY if
    either is given for a system with rows of elements with memory, which have their own damping,
    and those of the checks of both."""
    eta = check_loss_factors(loss_factor, lin.model, f"{where}.loss_factor")
    with Problems() as problems:
        for name, given in {"loss_factor": loss_factor, "modal_damping": modal_damping}.items():
            check_without_force_sensors(given, f"{where}.{name}", sensors, lin.model)
            if lin.inner and given is not None:
                problems.add(
                    "MEMORY",
                    f"{where}.{name}",
                    "is given beside elements with memory",
                    value=given,
                    limit="None",
                    hint="Give the linear system's `condensed`, or leave the option out.",
                )
    return with_modal_damping(lin, modal_damping, f"{where}.modal_damping"), eta


def check_frequencies(given: Any, where: str, *, static: bool = False) -> Float[Array, "nf"]:
    """Check that frequencies are in one row and positive (with `static`, 0 is allowed too), and
    return them as a JAX array."""
    return device_array(checked_frequencies(given, where, static=static))


def checked_frequencies(given: Any, where: str, *, static: bool = False) -> Float[Array, "nf"]:
    """Check frequencies as `check_frequencies` does, but return them without a transfer to the
    device."""
    with Problems() as problems:
        array = float_array(given, where)
        shape = (max(array.size, 1),)
        array = checked(array, (shape,), where, problems, "Give frequencies [Hz] in one row.")
        if (
            array is not None
            and is_concrete(array)
            and (wrong := array < 0 if static else array <= 0).any()
        ):
            i = int(np.flatnonzero(wrong)[0])
            problems.add(
                "BAD_FREQUENCY",
                where,
                f"is {array[i]:g} Hz at index {i}",
                value=float(array[i]),
                limit=">= 0" if static else "> 0",
                hint="Give their magnitudes." if array[i] < 0 else "Leave 0 out.",
            )
    return array  # pyright: ignore[reportReturnType]  which is not None here


def _check_bounded_at_rest(names: tuple[str, ...], inputs: tuple[Any, ...]) -> None:
    """Refuse inputs given as velocity or acceleration at 0 Hz, because their displacement
    is unbounded."""
    with Problems() as problems:
        for name, port in zip(names, inputs, strict=True):
            if (kind := getattr(port, "kind", "displacement")) != "displacement":
                problems.add(
                    "BAD_FREQUENCY",
                    f"frequency_response.inputs[{name!r}]",
                    f"is given as {kind}, and a frequency is 0 Hz",
                    value=kind,
                    limit="displacement at 0 Hz",
                    hint='Take kind="displacement", or leave 0 Hz out.',
                )


def check_without_force_sensors(
    given: Any, where: str, sensors: tuple[Sensor, ...], model: Model
) -> None:
    """Refuse sensors of forces together with `loss_factor` or `modal_damping`, because these
    sensors read only forces of the model; sensors whose rows follow from matrices are allowed.
    Error: BAD_OPTION."""
    with Problems() as problems:
        for sensor in sensors if given is not None else ():
            if sensor.unit[0] == "N" and not (
                isinstance(sensor, LoadCell) or reads_matrices(sensor, model)
            ):
                problems.add(
                    "BAD_OPTION",
                    where,
                    f"is not read by a {type(sensor).__name__} on '{sensor.on}'",
                    value=given,
                    limit="sensors of motion",
                    hint="Use LoadCell or the Reaction of a support, or give the model dampers.",
                )


def check_loss_factors(given: Any, model: Model, where: str) -> Float[Array, "ne"] | None:
    """Return one loss factor for each element, from one for all or {element: factor}. Errors:
    UNKNOWN_NAME, BAD_SHAPE, NEGATIVE."""
    if given is None:
        return None
    names = model.owner_names
    factors = given if isinstance(given, dict) else dict.fromkeys(names, given)
    with Problems() as problems:
        problems.collected += [unknown(name, where, names) for name in factors if name not in names]
        each = [checked(factors.get(name, 0.0), ((),), where, problems) for name in names]
        for name, value in zip(names, each, strict=True):
            if value is not None and is_concrete(value) and value < 0:
                problems.add(
                    "NEGATIVE",
                    where,
                    f"of '{name}' is {value:g}",
                    value=float(value),
                    limit=">= 0",
                    hint="It would add energy.",
                )
    return jnp.stack([device_array(value) for value in each]) if each else jnp.zeros(0)


@program_with(options_by_size)
def response_values(
    lin: Linearization,
    f: Float[Array, "nf"],
    ports: Ports,
    eta: Float[Array, "ne"] | None,
    method: str = "direct",
    static: bool = False,
):
    """Return (values (ny, nu, nf), status). `static`: whether 0 Hz is among the frequencies."""
    nv, X = lin.M.shape[-1], ports.X
    s = jax.lax.complex(jnp.zeros_like(f), 2 * jnp.pi * f)
    whole = DynamicMatrices(
        *lin.whole,
        None if eta is None else hysteretic_damping(lin, eta),
        lin.massless,
        not lin.model.forces,
    )
    scale = (
        s[None] ** -jnp.array(ports.orders, s.dtype)[:, None]
        if any(ports.orders)
        else jnp.ones((len(ports.orders), 1), s.dtype)
    )
    own = jax.tree.map(lambda A: A[:nv, :nv], whole)
    right = (
        ports.F[:nv, :, None].astype(s.dtype)
        - jax.tree.map(lambda A: A[:nv, nv:] @ X, whole).at(s) * scale[None]
    )
    Delta, complete = solved(own, s, jnp.broadcast_to(right, (nv, X.shape[1], f.shape[0])), method)
    Y = ports.Y
    rows = DynamicMatrices(
        Y[0],
        Y[1],
        Y[2],
        None if eta is None else _elastic_rows(Y, whole.H, ports, lin, eta),
        lin.massless,
    )
    on_bodies, on_supports = (
        jax.tree.map(lambda A: A[:, :nv], rows),
        jax.tree.map(lambda A: A[:, nv:] @ X, rows),
    )
    values = (
        on_bodies.times(s, Delta)
        + on_supports.at(s) * scale[None]
        + ports.G[:, :, None].astype(s.dtype)
    )
    values = values if ports.chains is None else values * ports.chains.at(s)[:, None]
    free = jnp.array(False)
    if static:
        free = _is_free(jax.lax.stop_gradient(lin))
        values = jnp.where(free & (f == 0), jnp.nan, values)
    status = lin.kept_status(
        jnp.select(
            [is_unstable(own), ~complete, free, ~jnp.isfinite(values).all()],
            [
                Status.UNSTABLE.value,
                Status.DEFECTIVE.value,
                Status.SINGULAR_K.value,
                Status.NONFINITE.value,
            ],
            Status.OK.value,
        ),
        NO_MODES,
    )
    failed = (status != Status.OK) & (status != Status.NONFINITE) & (status != Status.SINGULAR_K)
    return values * jnp.where(failed, jnp.nan, 1.0), status


def _is_free(lin: Linearization) -> Bool[Array, ""]:
    """Return whether a motion is not resisted at 0 Hz."""
    if lin.model.forces:
        values = jnp.linalg.svdvals(rows_of_one_size(lin.K))
    else:
        slow = lin.condensed
        values = jnp.abs(natural(slow.K, slow.M)[0])
    return jnp.min(values, initial=jnp.inf) <= ZERO * jnp.max(values, initial=0.0)


def hysteretic_damping(lin: Linearization, eta: Float[Array, "ne"]) -> Float[Array, "n n"]:
    """Return H of (Delta, Xi): the sum over the elements of eta V''(e) de de."""
    at = configuration_at(Coordinates(lin.held), lin.state.q)
    H = [x.elastic() for x in element_derivatives(at)]
    whole = jnp.tensordot(eta, jnp.concatenate(H), 1) if H else jnp.zeros((len(at.turns),) * 2)
    return whole if lin.dependent is None else lin.dependent.of(whole)


def _elastic_rows(Y, H, ports: Ports, lin: Linearization, eta) -> Float[Array, "ny n"]:
    """Return the rows that i H adds to outputs: eta times the elastic part of an element's force,
    -H for a reaction."""
    rows = [jnp.zeros(Y.shape[-1], Y.dtype)] * Y.shape[1]
    for i, (element, support) in enumerate(zip(ports.elements, ports.reactions, strict=True)):
        if element >= 0:
            rows[i] = eta[element] * Y[0, i]
        if support >= 0:
            rows[i] = -H[lin.M.shape[-1] + support]
    return jnp.stack(rows)
