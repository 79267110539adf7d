"""Sensors of orientation: unit quaternions, whose residuals are rotation vectors."""

from typing import ClassVar, Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Problem, Problems
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import field
from jaxbody.geometry.points_and_orientations import IDENTITY, as_quaternion
from jaxbody.geometry.vectors import product, to_rank
from jaxbody.sensors.sensors import Chain, Sensor

BACK = np.array([1.0, -1, -1, -1])  # conjugates a quaternion


class Attitude(Sensor):
    """The base class of readings that end in a unit quaternion w, x, y, z, after `places`
    other numbers.

    The residual has a rotation vector in place of the quaternion, from the measured orientation
    to the reading, in world axes. `bias` also has a rotation vector in its place, which rotates
    the reading."""

    places: ClassVar[int] = 0
    stages = {"bias": "0.0", "delay": "0.0"}  # noqa: RUF012

    @property
    def shape(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return (self.places + 4,)

    @property
    def noise_shape(self):
        return (self.places + 3,)

    def residual(self, reading, measured):
        n, gone = self.places, self.missing(measured)
        q = rotations.normalize(
            jnp.where(gone[..., n : n + 1], reading[..., n:], measured[..., n:])
        )
        turn = rotations.log_quaternion(
            rotations.multiply(reading[..., n:], q * to_rank(BACK, q.ndim))
        )
        return jnp.where(
            gone, 0.0, jnp.concatenate([reading[..., :n] - measured[..., :n], turn], -1)
        )

    def missing(self, measured):
        n, gone = self.places, super().missing(measured)
        turn = gone[..., n:].any(-1, keepdims=True)
        return (np if isinstance(gone, np.ndarray) else jnp).concatenate(
            [gone[..., :n], turn, turn, turn], -1
        )

    def disturbed(self, reading, noise):
        n = self.places
        turned = rotations.multiply(rotations.exp_quaternion(noise[..., n:]), reading[..., n:])
        return jnp.concatenate([reading[..., :n] + noise[..., :n], turned], -1)

    def delayed(self, times, x):
        """Interpolated quaternions: the polynomial through samples with consistent
        signs, normalized."""
        n, q = self.places, x[..., self.places :]
        turns = jnp.where(jnp.sum(q[1:] * q[:-1], -1, keepdims=True) < 0, -1.0, 1.0)
        signs = jnp.concatenate(
            [jnp.ones_like(q[:1, :1]), jax.lax.stop_gradient(jnp.cumprod(turns, 0))]
        )
        moved = super().delayed(times, jnp.concatenate([x[..., :n], signs * q], -1))
        return jnp.concatenate([moved[..., :n], rotations.normalize(moved[..., n:])], -1)

    def misread(self, measured, where):
        length = np.linalg.norm(measured[..., self.places :], axis=-1)
        off = np.flatnonzero(np.abs(length - 1) > 1e-3)  # not where it is NaN
        if not len(off):
            return None
        message = f"has a quaternion of length {length[off[0]]:.6g} in row {off[0]}"
        columns = ("x, y, z, then " if self.places else "") + "the quaternion w, x, y, z"
        return Problem(
            "BAD_QUATERNION",
            where,
            message,
            measured[off[0]],
            "1 within 1e-3",
            f"Columns: {columns}.",
        )


class BodyPose(Attitude):
    """Pose of a body or support: position of its origin [m] and unit quaternion w, x, y, z,
    seven numbers.

    The residual has six: position, and rotation vector from the measured orientation to the
    reading, in world axes. Noise is one number for both, or two: meters for the position, radians
    for the orientation. `bias` (six numbers) and `delay` may be given.

    >>> BodyPose("plate").shape, BodyPose("plate").noise_shape
    ((7,), (6,))
    """

    on: str = eqx.field(static=True, converter=plain)
    places = 3
    unit = "m, rad"
    parts = ("position", "orientation")

    def reading(self, model, frames):
        row = model.layout.frame(self.on)
        return jnp.concatenate([frames.p[row], rotations.from_matrix(frames.R[row])])


class Orientation(Attitude):
    """Orientation of an instrument on a body or support, as read by an attitude reference: unit
    quaternion w, x, y, z, instrument to world.

    `orientation`: orientation of the instrument in its body, a quaternion or a rotation matrix. The
    residual is the rotation vector [rad] from the measured orientation to the reading, in world
    axes. `bias` (three numbers) is a rotation vector that rotates the reading; `delay` may be given
    too. Errors: BAD_QUATERNION, BAD_ROTATION, BAD_SHAPE, NON_FINITE, BAD_CHAIN.

    >>> Orientation("plate").shape, Orientation("plate").noise_shape
    ((4,), (3,))
    """

    on: str = eqx.field(static=True, converter=plain)
    orientation: Float[Array, "4"] = field("", "rotation")
    unit = "rad"

    def __init__(self, on: str, *, orientation=IDENTITY, **chain: Unpack[Chain]):
        with Problems() as problems:
            self.on, self.orientation = (
                on,
                as_quaternion(orientation, "Orientation.orientation", problems),
            )
            self.chained(problems, **chain)

    def reading(self, model, frames):
        R = product(frames.R[model.layout.frame(self.on)], rotations.matrix(self.orientation))
        return rotations.from_matrix(R)
