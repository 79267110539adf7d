"""What an instrument on a body reads, and how far a reading is from a measured one."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxbody import rotations
from jaxbody.bodies import vector
from jaxbody.elements import Element
from jaxbody.errors import JaxbodyError, Problem, Problems
from jaxbody.frames import Frame
from jaxbody.joints import _unit
from jaxbody.kinematics import Motions
from jaxbody.models import Model, State, unknown
from jaxbody.simulations import Trajectory, table_of

Reading = Float[Array, "*r"]


class Sensor(eqx.Module):
    """The base of all sensors: `reading` of a table of frames, and `residual`, reading less measured."""

    on: eqx.AbstractVar[str]
    shape: ClassVar[tuple[int, ...]]
    unit: ClassVar[str]

    def reading(self, model: Model, frames: Frame) -> Reading:
        raise TypeError  # pragma: no cover

    def residual(self, reading: Reading, measured: Reading) -> Float[Array, "*r"]:
        return reading - measured

    def disturbed(self, reading: Reading, noise: Float[Array, "*r"]) -> Reading:
        """A reading with noise on it."""
        return reading + noise

    @property
    def noise_shape(self) -> tuple[int, ...]:
        """Of a residual."""
        return self.shape

    def problem(self, model: Model, where: str) -> Problem | None:
        """What is wrong with it on this model."""
        known = model.layout.frames
        return None if self.on in known else unknown(self.on, where, known)


class Position(Sensor):
    """World position [m] of a point of a body or support; with `axis` (a direction in world axes) one number, the component along it.

    >>> Position("plate", [0.1, 0, 0]).shape, Position("plate", axis=[1, 0, 0]).shape
    ((3,), ())
    """

    on: str = eqx.field(static=True)
    point: Float[Array, "3"]
    axis: Float[Array, "3"] | None
    unit = "m"

    def __init__(self, on: str, point=(0, 0, 0), *, axis=None):
        problems = Problems()
        self.on, self.point = on, vector(point, "Position.point", problems)
        self.axis = None if axis is None else _unit(axis, "Position.axis", problems)
        problems.raise_if_any()

    @property
    def shape(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (3,) if self.axis is None else ()

    def reading(self, model, frames):
        row = model.layout.frame(self.on)
        p = frames.p[row] + rotations.rotate(frames.R[row], self.point)
        return p if self.axis is None else rotations.dot(self.axis, p)


class BodyPose(Sensor):
    """Pose of a body or support: position of its origin [m] and unit quaternion w, x, y, z, seven numbers.
    The residual has six: position, and rotation vector from the measured to the read orientation, world axes."""

    on: str = eqx.field(static=True)
    shape = (7,)
    unit = "m, rad"

    def __init__(self, on: str):
        self.on = on

    @property
    def noise_shape(self):
        return (6,)

    def reading(self, model, frames):
        row = model.layout.frame(self.on)
        return jnp.concatenate([frames.p[row], rotations.from_matrix(frames.R[row])])

    def residual(self, reading, measured):
        conjugate = measured[..., 3:] * jnp.array([1.0, -1, -1, -1])
        turn = rotations.log_quaternion(rotations.multiply(reading[..., 3:], conjugate))
        return jnp.concatenate([reading[..., :3] - measured[..., :3], turn], -1)

    def disturbed(self, reading, noise):
        turned = rotations.multiply(rotations.exp_quaternion(noise[..., 3:]), reading[..., 3:])
        return jnp.concatenate([reading[..., :3] + noise[..., :3], turned], -1)


class Elongation(Sensor):
    """Elongation [m] of a spring, tension positive."""

    on: str = eqx.field(static=True)
    shape = ()
    unit = "m"

    def __init__(self, on: str):
        self.on = on

    def reading(self, model, frames):
        element: Element = model[self.on]
        A, B = (frames[model.layout.frame(end)] for end in element.between)
        return element.deformation(A.pose(), B.pose())

    def problem(self, model, where):
        names = tuple(name for table in model.elements if hasattr(table.rows, "free_length") for name in table.names)
        return None if self.on in names else unknown(self.on, where, names)


def read(model: Model, motions: Motions, t, state: State, sensors: dict[str, Sensor]) -> dict[str, Array]:
    """What all sensors read at one time."""
    frames = table_of(model, motions, t, state)
    return {name: sensor.reading(model, frames) for name, sensor in sensors.items()}


def check_sensors(sensors: dict[str, Sensor], model: Model, where: str) -> None:
    """Every sensor is one, and on something that the model has."""
    problems = [
        Problem("WRONG_KIND", f"{where}['{name}']", f"is a {type(sensor).__name__}", sensor, "a sensor")
        if not isinstance(sensor, Sensor)
        else sensor.problem(model, f"{where}['{name}']")
        for name, sensor in sensors.items()
    ]
    found = [problem for problem in problems if problem is not None]
    if found:
        raise JaxbodyError(*found)


def measure(
    trajectory: Trajectory, sensors: dict[str, Sensor], *, noise: float | dict[str, Any] = 0.0, key: PRNGKeyArray | None = None
) -> dict[str, Array]:
    """{sensor: readings (nt, ...)} of a trajectory, with white Gaussian noise of the standard deviation `noise` (one number, or one for each sensor).

    Noise on a pose is in meters on its position and in radians on its orientation. Errors: NO_KEY, BAD_NOISE, UNKNOWN_NAME.

    >>> import jax, jax.numpy as jnp
    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, joints={"mass": Guide("world", axis=[0, 1, 0])}, gravity=[0, -9.81, 0])
    >>> measured = measure(simulate(model, jnp.linspace(0, 1, 5)), {"place": Position("mass")}, noise=1e-3, key=jax.random.key(0))
    >>> measured["place"].shape
    (5, 3)
    """
    check_sensors(sensors, trajectory.model, "sensors")
    levels = {name: noise.get(name, 0.0) if isinstance(noise, dict) else noise for name in sensors}
    for name, level in levels.items():
        if not np.isfinite(level) or level < 0:
            raise JaxbodyError(Problem("BAD_NOISE", f"noise['{name}']", f"is {level}", level, ">= 0, finite"))
    readings = trajectory.at_samples(read, sensors)
    if not any(levels.values()):
        return readings
    if key is None:
        raise JaxbodyError(Problem("NO_KEY", "measure.key", "is missing", hint="Noise needs key=jax.random.key(...)."))
    keys = dict(zip(sensors, jax.random.split(key, len(sensors)), strict=True))
    lead = trajectory.times.shape
    return {
        name: sensor.disturbed(readings[name], levels[name] * jax.random.normal(keys[name], (*lead, *sensor.noise_shape)))
        for name, sensor in sensors.items()
    }
