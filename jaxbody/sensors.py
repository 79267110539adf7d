"""What an instrument on a body reads."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxbody import rotations
from jaxbody.arrays import checked, concrete
from jaxbody.bodies import vector
from jaxbody.channels import Channel
from jaxbody.elements import Element
from jaxbody.errors import JaxbodyError, Problem, Problems
from jaxbody.frames import Frame
from jaxbody.joints import unit_vector
from jaxbody.kinematics import Motions
from jaxbody.models import Model, State, unknown
from jaxbody.simulations import Trajectory, table_of

Reading = Float[Array, "*r"]


class Sensor(Channel):
    """The base of all sensors: a channel with the `reading` of a table of frames."""

    on: eqx.AbstractVar[str]

    def reading(self, model: Model, frames: Frame) -> Reading:
        raise TypeError  # pragma: no cover

    def disturbed(self, reading: Reading, noise: Float[Array, "*r"]) -> Reading:
        """A reading with noise on it."""
        return reading + noise

    def problem(self, model: Model, where: str) -> Problem | None:
        """What is wrong with it on this model."""
        known = model.layout.frames
        return None if self.on in known else unknown(self.on, where, known)

    def misread(self, measured: np.ndarray, where: str) -> Problem | None:
        """What is wrong with samples of the right shape."""
        return None


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
        self.axis = None if axis is None else unit_vector(axis, "Position.axis", problems)
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

    The residual has six: position, and rotation vector from the measured to the read orientation, world axes. Noise is one number for
    both, or two: meters on the position, radians on the orientation.

    >>> BodyPose("plate").shape, BodyPose("plate").noise_shape
    ((7,), (6,))
    """

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
        gone = self.missing(measured)
        q = rotations.normalize(jnp.where(gone[..., 3:4], reading[..., 3:], measured[..., 3:]))
        turn = rotations.log_quaternion(rotations.multiply(reading[..., 3:], q * jnp.array([1.0, -1, -1, -1])))
        return jnp.where(gone, 0.0, jnp.concatenate([reading[..., :3] - measured[..., :3], turn], -1))

    def missing(self, measured):
        gone = super().missing(measured)
        turn = gone[..., 3:].any(-1, keepdims=True)
        return (np if isinstance(gone, np.ndarray) else jnp).concatenate([gone[..., :3], turn, turn, turn], -1)

    def disturbed(self, reading, noise):
        turned = rotations.multiply(rotations.exp_quaternion(noise[..., 3:]), reading[..., 3:])
        return jnp.concatenate([reading[..., :3] + noise[..., :3], turned], -1)

    def spread(self, level):
        return jnp.repeat(jnp.broadcast_to(level, (2,)), 3)

    def pooled(self, x):
        return x.reshape(-1, 2, 3).sum((0, 2))

    def misread(self, measured, where):
        length = np.linalg.norm(measured[..., 3:], axis=-1)
        off = np.flatnonzero(np.abs(length - 1) > 1e-3)  # not where it is NaN
        if not len(off):
            return None
        told = f"has a quaternion of length {length[off[0]]:.6g} in row {off[0]}"
        return Problem(
            "BAD_QUATERNION", where, told, measured[off[0]], "1 within 1e-3", "Columns: x, y, z, then the quaternion w, x, y, z."
        )


class Elongation(Sensor):
    """Elongation [m] of a spring, tension positive.

    >>> Elongation("AB").unit
    'm'
    """

    on: str = eqx.field(static=True)
    shape = ()
    unit = "m"

    def __init__(self, on: str):
        self.on = on

    def reading(self, model, frames):
        element: Element = model[self.on]
        return element.deformation(*(frames[model.layout.frame(end)].pose() for end in element.between))

    def problem(self, model, where):
        names = tuple(name for table in model.elements if table.rows.size == 1 for name in table.names)
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


def noise_levels(sensors: dict[str, Sensor], noise: Any, where: str, problems: Problems, *, zero: bool) -> dict[str, Any]:
    """{sensor: standard deviation} of one number for all sensors or a dict; what is wrong goes to `problems`. `zero` says if 0 is one."""
    levels = {}
    for name, value in (noise if isinstance(noise, dict) else dict.fromkeys(sensors, noise)).items():
        there = f"{where}['{name}']"
        if name not in sensors:
            found = unknown(name, there, tuple(sensors))
            problems.add(found.code, there, found.message, value=name, hint=found.hint)
            continue
        units = sensors[name].unit.count(",") + 1
        level = checked(value, ((),) if units == 1 else ((), (units,)), there, problems, f"One number [{sensors[name].unit}].")
        known = None if level is None else concrete(level)
        if known is not None and ((known < 0).any() or not (zero or known.all())):
            hint = "" if zero else "Leave noise out to have it estimated."
            problems.add("BAD_NOISE", there, f"is {known}", value=known, limit=">= 0" if zero else "> 0", hint=hint)
        if level is not None:
            levels[name] = level
    return levels


def measure(
    trajectory: Trajectory, sensors: dict[str, Sensor], *, noise: float | dict[str, Any] = 0.0, key: PRNGKeyArray | None = None
) -> dict[str, Array]:
    """{sensor: readings (nt, ...)} of a trajectory, with white Gaussian noise of the standard deviation `noise` (one number, or one for each sensor).

    Noise on a pose is in meters on its position and in radians on its orientation; it may be two numbers. Leading axes of a batch of
    trajectories stay. Errors, all at once: WRONG_KIND, UNKNOWN_NAME, BAD_NOISE, BAD_SHAPE, NON_FINITE, NO_KEY.

    >>> import jax, jax.numpy as jnp
    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, joints={"mass": Guide("world", axis=[0, 1, 0])}, gravity=[0, -9.81, 0])
    >>> measured = measure(simulate(model, jnp.linspace(0, 1, 5)), {"place": Position("mass")}, noise=1e-3, key=jax.random.key(0))
    >>> measured["place"].shape
    (5, 3)
    """
    check_sensors(sensors, trajectory.model, "sensors")
    problems = Problems()
    levels = noise_levels(sensors, noise, "noise", problems, zero=True)
    noisy = any(concrete(level) is None or np.any(level) for level in levels.values())
    if noisy and key is None:
        problems.add("NO_KEY", "measure.key", "is missing", hint="Noise needs key=jax.random.key(...).")
    problems.raise_if_any()
    readings = trajectory.at_samples(read, sensors)
    if key is None or not noisy:
        return readings
    keys = dict(zip(sensors, jax.random.split(key, len(sensors)), strict=True))
    lead = trajectory.times.shape
    return {
        name: sensor.disturbed(readings[name], sensor.spread(levels.get(name, 0.0)) * jax.random.normal(keys[name], (*lead, *sensor.noise_shape)))
        for name, sensor in sensors.items()
    }  # fmt: skip
