"""Readings: what sensors measure along a trajectory, and noise added to it."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import check_key, check_kind
from jaxbody.core.arrays import Array, PRNGKeyArray, as_numpy, concrete
from jaxbody.core.compilation.compile_options import OPTIMIZED, program_with
from jaxbody.core.errors import Problems
from jaxbody.mechanics.closed_loops import dynamics_of
from jaxbody.model.element_states import holding
from jaxbody.model.inputs.loads import Load
from jaxbody.model.joints.kinematics import Motions, frames_at_time
from jaxbody.model.models import Model, options_of_motion
from jaxbody.model.states import State
from jaxbody.motion.trajectories import Trajectory
from jaxbody.sensors.sensors import Sensor, check_sensors, noise_levels


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
