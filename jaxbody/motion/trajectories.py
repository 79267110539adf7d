"""Trajectories: results of a simulation, quantities along them, and what sensors measure there,
with noise added to it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from equinox import combine, field, is_array, partition

from jaxbody.core import tables
from jaxbody.core.arguments import check_key, check_kind
from jaxbody.core.arrays import (
    Array,
    Float,
    Int,
    PRNGKeyArray,
    as_numpy,
    concrete,
    is_concrete,
    part_of,
    rows_or_nan,
    time_text,
)
from jaxbody.core.compilation.compile_options import OPTIMIZED, program_with
from jaxbody.core.errors import Problems, Status
from jaxbody.core.results import AXES, QUATERNION, Labeled, Result, dataset, rows_of
from jaxbody.geometry.frames import Pose
from jaxbody.lagrange import kinetic, potential
from jaxbody.mechanics.closed_loops import ClosedLoops, Closing, dynamics_of, seen_by_forces
from jaxbody.mechanics.dynamics import accelerated
from jaxbody.mechanics.failure_causes import (
    changing_most,
    force_jump_at,
    force_jump_messages,
    force_jumps_along,
    massless_motions,
    nonfinite_ahead,
    singular_closure,
)
from jaxbody.mechanics.forces_at_rest import by_closure, labeled_elements
from jaxbody.mechanics.hessians import matrices
from jaxbody.model.element_states import holding
from jaxbody.model.inputs.loads import Load
from jaxbody.model.joints.frame_tables import (
    each_element,
    exerted,
    exerted_by_loads,
    inertial_tables,
    outside_law_range,
    power,
    turning_rows,
)
from jaxbody.model.joints.kinematics import Motions, frames_at_time
from jaxbody.model.leaf_paths import by_name, of_elements
from jaxbody.model.models import Model, options_of_motion, size_of
from jaxbody.model.states import State
from jaxbody.numerics.lanes import in_lanes
from jaxbody.numerics.precisions import in_float64
from jaxbody.sensors.sensors import Sensor, check_sensors, noise_levels

BLURRED = 1e-10  # rounding of times, relative to the whole time, above which it disturbs motions


class Trajectory(Labeled, Result):
    """A motion at `times` [s]: `state`, and by name `poses`, `elongations` [m], `forces` [N],
    `energies` [J], `powers` [W], `reactions` [N, N m].

    `status`: MAX_STEPS, DT_MIN, NONFINITE or NOT_CONVERGED if the integration ended early, with
    NaN in later samples; SINGULAR_CLOSURE if it ended where closures become dependent, NOT_CLOSED
    if no initial state fulfills them; TABLE_RANGE if a motion left the table of a law.
    `statistics`: accepted and rejected steps. `closing`: distance of the given initial state from
    the closures. Quantities by name and `summary()` are computed when they are read; printing
    computes nothing."""

    index = "time"
    times: Float[Array, "nt"]
    state: State
    status: Int[Array, ""]
    statistics: dict[str, Any]
    end: tuple[Array, State]
    model: Model
    motions: Motions
    loads: tuple[Load, ...] = ()
    jumps: list[Float[np.ndarray, "_"]] = field(
        default_factory=list
    )  # times of jumps of forces by `force_jumps_along`, if simulate has computed them
    closing: Closing | None = None  # distance of the initial state from the closures

    @property
    def poses(self) -> dict[str, Pose]:
        """{body or support: pose}, with `.p` (nt, 3) position of its origin, `.R` (nt, 3, 3)
        orientation, `.quaternion`."""
        frames, lead = self.at_samples(_frames), (slice(None),) * self.times.ndim
        return {
            name: jax.tree.map(lambda x, i=i: part_of(x, (*lead, i)), frames)
            for i, name in enumerate(self.model.layout.frames[1:], 1)
        }

    @property
    def elongations(self) -> dict[str, Array]:
        """{element: elongation (nt,), tension positive}; for a bushing its deformations (nt, 6)."""
        return self._of_elements(_of_each, "deformation")

    @property
    def forces(self) -> dict[str, Array]:
        """{element: tension (nt,), its damper and its inertia included}; for a bushing the six
        forces and moments (nt, 6) that oppose its deformation."""
        return (
            self._of_elements(_forces_with_inertia, loads=True)
            if inertial_tables(self.model)
            else self._of_elements(_of_each, "force")
        )

    @property
    def energies(self) -> dict[str, Array]:
        """{"kinetic", "potential", "total": energy [J] (nt,)}."""
        T, V = self.at_samples(_energies)
        return {"kinetic": T, "potential": V, "total": T + V}

    @property
    def lost_powers(self) -> dict[str, Array]:
        """{element: power that it dissipates, dR/de_dot . e_dot [W] (nt,)}."""
        names = [table.names for table in self.model.elements]
        return by_name(names, self.at_samples(_of_each, "lost_power"), axis=self.times.ndim)

    @property
    def powers(self) -> dict[str, Array]:
        """{"damping": power dissipated by all elements, "supports" and "loads": power that the
        imposed motions and the loads supply, "force elements": power that these supply, which have
        no potential, if there are any [W] (nt,)}."""
        forces = {"force elements": self.at_samples(_force_power, loads=True)}
        return {
            "damping": sum(self.lost_powers.values(), jnp.zeros_like(self.times)),
            "supports": self.at_samples(_support_power, loads=True),
            "loads": self.at_samples(_load_power, loads=True),
            **(forces if self.model.forces else {}),
        }

    @property
    def reactions(self) -> dict[str, tuple[Array, Array]]:
        """{support: (force, moment about its origin)}, each (nt, 3) in world axes, exerted by all
        that is attached to it."""
        supports = self.model.layout.supports
        force, moment = (
            by_name([supports], [x], axis=self.times.ndim)
            for x in self.at_samples(_reactions, loads=True)
        )
        return {name: (force[name], moment[name]) for name in supports}

    @property
    def closure_reactions(self) -> dict[str, dict[str, Array]]:
        """{closure: {condition: reaction [N, N m] (nt,)}}, positive where it resists an increase of
        the condition, as the tension of a rod does; NaN where closures share a force, so that it is
        not unique."""
        if not self.model.closures:
            return {}
        return by_closure(self.model, self.at_samples(_closure_reactions, loads=True))

    def _of_elements(self, function: Callable, *more: Any, loads: bool = False) -> dict[str, Array]:
        values = self.at_samples(function, *more, loads=loads)
        return of_elements(self.model, values, axis=self.times.ndim)

    def at_samples(self, function: Callable, *more: Any, loads: bool = False) -> Any:
        """Return function(model, motions, t, state, *more) at every sample, with `loads`
        function(model, motions, t, state, *more, loads). Leading axes of a batch are kept, and each
        function is compiled once."""
        return _evaluate(
            function,
            self.times.ndim - 1,
            self.model,
            self.motions,
            (self.loads,) if loads else (),
            self.times,
            self.state,
            more,
        )

    def _ended(self) -> str:
        """Describe when and after how many steps the integration ended."""
        if self.status == Status.TABLE_RANGE:
            return "report() names the elements"
        taken, rejected = (
            int(self.statistics[f"num_{kind}_steps"]) for kind in ("accepted", "rejected")
        )
        t, last = (time_text(t, self.times) for t in (self.end[0], self.times[-1]))
        return (
            f"at t = {t} s of {last} s, {taken} steps accepted, {rejected} rejected; "
            "samples after it are NaN"
        )

    def explain(self) -> str:
        status = Status(int(self.status))
        match status:
            case Status.TABLE_RANGE:
                return self._outside_tables()
            case Status.MAX_STEPS | Status.DT_MIN:
                jump = force_jump_at(self.model, self.motions, *self.end)
                cause = jump or self._what_steps_need(status)
            case Status.SINGULAR_CLOSURE:
                cause = singular_closure(self.model, self.motions, *self.end)
            case Status.NONFINITE:
                first = nonfinite_ahead(self.model, self.motions, self.loads, self.times, *self.end)
                cause = "first not finite: " + (first or self._accelerations())
            case _:
                return self._ended()
        return f"{self._ended()}; {cause}"

    def _what_steps_need(self, status: Status) -> str:
        """Describe what changes fastest where the steps ended, and what else to try."""
        changing = changing_most(self.model, self.motions, self.loads, self.times, *self.end)
        remedy = (
            "dt0, a first step of your own" if status == Status.DT_MIN else "a larger max_steps"
        )
        stiff = "" if self.model.closures else ", or in Python solver=diffrax.Kvaerno5() if stiff"
        usual = in_float64(self.state.q.dtype) or f"try {remedy}, a larger rtol{stiff}"
        if (rounding := float(np.spacing(abs(self.end[0])))) > BLURRED * float(
            self.times[-1] - self.times[0]
        ):
            usual = (
                f"functions of your own get times rounded to {rounding:.2g} s: count from the "
                f"first sample; or {usual}"
            )
        return "; ".join(filter(None, (changing, usual)))

    def _accelerations(self) -> str:
        """Describe which quantity is not finite although all forces and motions are: the
        accelerations, if a coordinate has no inertia, otherwise the state."""
        layout, q = self.model.layout, self.end[1].q
        massless = massless_motions(layout, matrices(self.model, State(q, np.zeros(layout.nv)))[0])
        return (
            "the accelerations: " + "; ".join(massless)
            if massless
            else f"the state of '{layout.bodies[0]}'"
        )

    def _outside_tables(self) -> str:
        """Name the elements that leave their tables, with the time when they first do."""
        beyond = np.asarray(self.at_samples(_beyond_laws))
        parts = [
            (
                f"'{name}' first at t = {time_text(self.times[np.argmax(column)], self.times)} s, "
                f"in {column.sum()} of {len(column)} samples"
            )
            for name, column in zip(self.model.element_names, beyond.T, strict=True)
            if column.any()
        ]
        return "; ".join(parts) + ": beyond its table a law continues with its end slope"

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset over time: positions and quaternions of bodies, elongations and
        forces of springs, energies."""
        layout, poses, energies = self.model.layout, self.poses, self.energies
        of_springs, of_others, springs = labeled_elements(
            self.model, ("time",), ("elongation", "deformation"), self.elongations, self.forces
        )
        variables = {
            "position": (
                ("time", "frame", "axis"),
                rows_of([pose.p for pose in poses.values()], -2),
                "m",
            ),
            "quaternion": (
                ("time", "frame", "part"),
                rows_of([pose.quaternion for pose in poses.values()], -2),
                "",
            ),
            "kinetic_energy": (("time",), energies["kinetic"], "J"),
            "potential_energy": (("time",), energies["potential"], "J"),
            **of_springs,
        }
        coordinates: dict[str, Any] = {
            "frame": list(poses),
            "axis": AXES,
            "part": QUATERNION,
            **springs,
        }
        if layout.nz:
            variables["z"] = (
                ("time", "state"),
                self.state.z,
                ", ".join(dict.fromkeys(layout.z_units)),
            )
            coordinates["state"] = list(layout.states)
        if layout.supports:
            reactions = self.reactions
            variables["reaction_force"] = (
                ("time", "support", "axis"),
                rows_of([force for force, _ in reactions.values()], -2),
                "N",
            )
            variables["reaction_moment"] = (
                ("time", "support", "axis"),
                rows_of([moment for _, moment in reactions.values()], -2),
                "N m",
            )
            coordinates["support"] = list(reactions)
        variables |= of_others
        times = np.asarray(self.times)
        if times.ndim == 1:
            coordinates["time"] = ("time", times, {"units": "s"})
        else:
            variables["times"] = (("time",), times, "s")
        result = dataset(variables, coordinates, "trajectory")
        return result.assign(status=(result["kinetic_energy"].dims[:-1], np.asarray(self.status)))

    def _summary_tables(self) -> list[tables.PrintedTable]:
        """Return the printed table of one motion, with positions of frames, elongations and
        tensions of springs, and jumps of forces."""
        known = replace(
            self, jumps=force_jumps_along(self.model, self.motions, self.times, self.state)
        )
        rows = [(name, *map(_range, np.asarray(pose.p).T)) for name, pose in self.poses.items()]
        forces = self.forces
        springs = [
            (name, _range(e), _range(forces[name]))
            for name, e in self.elongations.items()
            if e.ndim == 1
        ]
        return [
            *tables.in_numpy(known)._tables(),
            tables.PrintedTable("Positions", ("frame", "x [m]", "y [m]", "z [m]"), rows),
            tables.PrintedTable("", ("spring", "elongation [m]", "tension [N]"), springs),
        ]

    def _tables(self) -> list[tables.PrintedTable]:
        if self.times.ndim > 1 or not is_concrete(self.state.q):
            return [
                tables.PrintedTable(
                    "Trajectories",
                    ("", ""),
                    [("states", self.state.q), ("status", self.message(Trajectory._ended))],
                )
            ]
        layout = self.model.layout
        values = layout.values_by_coordinate(self.state.q)
        ends = (f.reduce(values, 0) for f in (np.fmin, np.fmax))
        rows = [*zip(layout.coordinates, *ends, layout.coordinate_units, strict=True)]
        jumps = [message for _, message in force_jump_messages(self.model, self.jumps, self.times)]
        note = "; ".join([self.message(Trajectory._ended), *jumps])
        span = " to ".join(time_text(t, self.times, 4) for t in (self.times[0], self.times[-1]))
        title = f"Trajectory, {len(self.times)} samples, {span} s"
        return [tables.PrintedTable(title, ("coordinate", "least", "largest", "unit"), rows, note)]


def _range(values: Any) -> str:
    return f"{np.nanmin(values):.4g} .. {np.nanmax(values):.4g}"


def _frames(model, motions, t, state) -> Pose:
    return frames_at_time(model, motions, t, state).pose()


def _of_each(model, motions, t, state, quantity: str):
    """Return what a method of the elements gives for their frames, of each kind of them."""
    frames = frames_at_time(model, motions, t, state)
    return tuple(each_element(model, frames, lambda s, *F: getattr(s, quantity)(*F)))


def _forces_with_inertia(model, motions, t, state, loads):
    """Return the forces of the elements, including those of their inertia at the accelerations of
    the motion."""
    now, forces = dynamics_of(model, motions, loads).accelerated(t, state), []
    for table, force in zip(
        model.elements, _of_each(model, motions, t, state, "force"), strict=True
    ):
        inertia = (
            accelerated(model, now, table, lambda s, *F: s.inertial_force(*F))
            if table.rows.has_inertia()
            else 0.0
        )
        forces.append(force + inertia)
    return tuple(forces)


def _energies(model, motions, t, state):
    frames = frames_at_time(model, motions, t, state)
    return kinetic(model, frames), potential(model, frames)


def _beyond_laws(model, motions, t, state):
    return outside_law_range(model, frames_at_time(model, motions, t, state))


def _reactions(model, motions, t, state, loads):
    return dynamics_of(model, motions, loads).reactions(t, state.q, state.v)


def _closure_reactions(model, motions, t, state, loads):
    multipliers, unique = ClosedLoops(model, motions, loads).multipliers(t, state)
    return rows_or_nan(
        unique,
        multipliers * jnp.where(turning_rows(model), jax.lax.stop_gradient(size_of(model)), 1.0),
    )


def _load_power(model, motions, t, state, loads):
    now = frames_at_time(model, motions, t, state)
    return power(model, exerted_by_loads(model, now, loads), now)


def _force_power(model, motions, t, state, loads):
    now = seen_by_forces(model, motions, loads, t, state)
    return power(model, exerted(model, now), now)


def _support_power(model, motions, t, state, loads):
    dynamics = dynamics_of(model, motions, loads)
    force, moment = dynamics.reactions(t, state.q, state.v)
    supports = dynamics.coordinates.supports_moving(motions, t)
    return -jnp.sum(force * supports.v) - jnp.sum(moment * supports.w)


@program_with(
    lambda function, batch_axes, model, motions, loads, times, *_: options_of_motion(model, times)
)
def _evaluate(function: Callable, batch_axes: int, model, motions, loads, times, state, more):
    numbers, rest = partition((model, motions, loads), is_array)
    others, fixed = partition(more, is_array)

    def one(numbers, t, state, others):
        model, motions, loads = combine(numbers, rest)
        return function(holding(model, state.z), motions, t, state, *combine(others, fixed), *loads)

    over_batch = jax.vmap(in_lanes(one), in_axes=(None, 0, 0, None))
    for _ in range(batch_axes):
        over_batch = jax.vmap(over_batch, in_axes=(0, 0, 0, None))
    return over_batch(numbers, times, state, others)


def read(
    model: Model,
    motions: Motions,
    t,
    state: State,
    sensors: dict[str, Sensor],
    loads: tuple[Load, ...] = (),
) -> dict[str, Array]:
    """Return the readings of all sensors at one time, before their signal chains; accelerations are
    computed once, if any sensor needs them."""
    model = holding(model, state.z)
    if any(sensor.needs_accelerations(model) for sensor in sensors.values()):
        instant = dynamics_of(model, motions, loads).instant(
            t, state, reactions=any(sensor.reactions for sensor in sensors.values())
        )
    else:
        instant = frames_at_time(model, motions, t, state)
    return {name: sensor.reading(model, instant) for name, sensor in sensors.items()}


def readings(trajectory: Trajectory, sensors: dict[str, Sensor]) -> dict[str, Array]:
    """Return the readings of each sensor along a trajectory, after its signal chain."""
    return _transduced(sensors, trajectory.times, trajectory.at_samples(read, sensors, loads=True))


@program_with(OPTIMIZED)
def _transduced(
    sensors: dict[str, Sensor], times: Array, measured: dict[str, Array]
) -> dict[str, Array]:
    def over_batch(times, measured):
        return {name: sensor.transduced(times, measured[name]) for name, sensor in sensors.items()}

    for _ in range(times.ndim - 1):
        over_batch = jax.vmap(over_batch)
    return over_batch(times, measured)


def measure(
    trajectory: Trajectory,
    sensors: dict[str, Sensor],
    *,
    noise: float | dict[str, Any] = 0.0,
    key: PRNGKeyArray | None = None,
) -> dict[str, Array]:
    """Return {sensor: readings (nt, ...)} of a trajectory, with white Gaussian noise.

    Args:
        sensors: {name: sensor}.
        noise: standard deviation in the unit of the sensor, one for all or {sensor: one};
            default 0. For a pose, one number (in meters for the position and in radians for the
            orientation) or two.
        key: random key of the noise, such as jax.random.key(0); by default none, for readings
            without noise.

    A delayed instrument reads NaN where the delayed time is outside the trajectory. Leading axes of
    a batch of trajectories are kept. Errors, all at once: WRONG_KIND, UNKNOWN_NAME, BAD_NOISE,
    BAD_SHAPE, NON_FINITE, NO_KEY.

    >>> import jax, jax.numpy as jnp
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     gravity=[0, -9.81, 0],
    ... )
    >>> measured = jb.measure(
    ...     jb.simulate(model, jnp.linspace(0, 1, 5)),
    ...     {"place": jb.Position("mass")},
    ...     noise=1e-3,
    ...     key=jax.random.key(0),
    ... )
    >>> measured["place"].shape
    (5, 3)
    """
    with Problems() as problems:
        check_kind(
            trajectory,
            Trajectory,
            "measure.trajectory",
            "a Trajectory, the result of jb.simulate(...)",
            problems,
        )
    check_sensors(sensors, trajectory.model, "sensors")
    levels = noise_levels(sensors, noise, "noise", problems, zero=True)
    noisy = any(concrete(level) is None or np.any(level) for level in levels.values())
    check_key(key, "measure.key", problems, "Noise needs" if noisy else "")
    problems.raise_if_any()
    levels = {name: as_numpy(levels.get(name, 0.0)) for name in sensors}
    return _measured(trajectory, sensors, levels if noisy else {}, key if noisy else None)


@program_with(lambda trajectory, *_: options_of_motion(trajectory.model, trajectory.times))
def _measured(
    trajectory: Trajectory,
    sensors: dict[str, Sensor],
    levels: dict[str, Array],
    key: PRNGKeyArray | None,
) -> dict[str, Array]:
    """Return the readings with noise of these levels, NaN for samples that are unknown."""
    values = {
        name: _nan_outside(sensors[name], trajectory.times, x)
        for name, x in readings(trajectory, sensors).items()
    }
    if key is None:
        return values
    keys = jax.random.split(key, len(sensors))
    for k, (name, sensor) in zip(keys, sensors.items(), strict=True):
        noise = jax.random.normal(k, (*trajectory.times.shape, *sensor.noise_shape))
        values[name] = sensor.disturbed(values[name], sensor.spread(levels[name]) * noise)
    return values


def _nan_outside(sensor: Sensor, times: Array, x: Array) -> Array:
    """Return x with NaN for delayed samples that lie outside the trajectory."""
    if sensor.delay is None:
        return x
    inside = jnp.vectorize(sensor.weight, signature="(n)->(n)")(times) > 0
    return jnp.where(inside.reshape(*times.shape, *[1] * (x.ndim - times.ndim)), x, jnp.nan)
