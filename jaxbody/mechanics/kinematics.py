"""From coordinates to frames: where every frame of a model is and how it moves, as one table with rows world, supports, bodies."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry import rotations
from jaxbody.geometry.frames import Frame, Pose, stack
from jaxbody.geometry.vectors import cross, rotate
from jaxbody.inputs.signals import Signal
from jaxbody.models.models import Model, at_rest_in, body_poses, rest_poses, support_poses
from jaxbody.models.states import State
from jaxbody.models.storage import KindTable
from jaxbody.numerics.xla_workarounds import take

Motions = tuple[Signal, ...]  # of six numbers, one per support, in their order


class Chart(eqx.Module):
    """The coordinates q of the joints of a model, their increments Delta and the speeds v."""

    model: Model

    def _each(self, function, *tables: tuple[Array, str]):
        """Apply function(joint, row, ...) to each body; `tables` are vectors ("q" or "v") split by body."""
        layout = self.model.layout
        for table in self.model.joints:
            kind = type(table.rows)
            parts = []
            for vector, which in tables:
                slices = layout.q_slices if which == "q" else layout.v_slices
                width = kind.nq if which == "q" else kind.nv
                rows = np.array([np.arange(slices[name].start, slices[name].stop) for name in table.names], dtype=int)
                parts.append(take(vector, rows.ravel()).reshape(len(table), width))
            yield table, jax.vmap(function)(table.rows, *parts)

    def _assemble(self, pieces: list[tuple[KindTable, Array]]) -> Array:
        """The rows of each body as one vector, sorted by body."""
        if len(pieces) == 1 and pieces[0][0].names == self.model.layout.bodies:
            return pieces[0][1].reshape(-1)
        rows = {name: part[i] for table, part in pieces for i, name in enumerate(table.names)}
        return jnp.concatenate([rows[name] for name in self.model.layout.bodies])

    def retract(self, q: Float[Array, "nq"], delta: Float[Array, "nv"]) -> Float[Array, "nq"]:
        """q (+) Delta, joint by joint."""
        return self._assemble(list(self._each(lambda joint, q, d: joint.retract(q, d), (q, "q"), (delta, "v"))))

    def rate(self, q: Float[Array, "nq"], v: Float[Array, "nv"]) -> Float[Array, "nq"]:
        """dq/dt for the speeds v."""
        return self._assemble(list(self._each(lambda joint, q, v: joint.rate(q, v), (q, "q"), (v, "v"))))


class Coordinates(Chart):
    """A chart with the reference poses of supports and bodies, and `rest`, the reference poses of bodies relative to their parents."""

    supports: Pose
    bodies: Pose
    rest: Pose

    def __init__(self, model: Model):
        self.model = model
        self.supports, self.bodies = support_poses(model), body_poses(model)
        self.rest = rest_poses(model, self.supports, self.bodies)

    @property
    def reference(self) -> State:
        """The state of rest in the reference pose."""
        return at_rest_in(self.model, self.rest)

    def supports_at(self, xi: Float[Array, "ns 6"], xi_dot: Float[Array, "ns 6"]) -> Frame:
        """Frames of the supports displaced by Xi from their reference poses, with the rate Xi'."""
        pose = self.supports.displaced(xi)
        return Frame(pose.p, pose.R, xi_dot[:, :3], rotate(rotations.left_jacobian(xi[:, 3:]), xi_dot[:, 3:]))

    def supports_moving(self, motions: Motions, t: Float[Array, ""]) -> Frame:
        """Frames of the supports at time t."""
        if not motions:
            return self.supports.at_rest()
        xi, xi_dot = jax.jvp(lambda t: jnp.stack([motion(t) for motion in motions]), (t,), (jnp.ones_like(t),))
        return self.supports_at(xi, xi_dot)

    def at_rest(self, q: Float[Array, "nq"], v: Float[Array, "nv"] | None = None) -> Frame:
        """The table of frames with supports at rest in their reference poses, and bodies at rest or with speeds v."""
        return self.frames(q, jnp.zeros(self.model.layout.nv, q.dtype) if v is None else v, self.supports.at_rest())

    def frames(self, q: Float[Array, "nq"], v: Float[Array, "nv"], supports: Frame) -> Frame:
        """The table of frames: world, supports, bodies."""
        return self.frames_and_axes(q, v, supports)[0]

    def frames_and_axes(self, q: Float[Array, "nq"], v: Float[Array, "nv"], supports: Frame):
        """The table of frames, and for each speed the velocity (nv, 3) and angular velocity (nv, 3) of its own body per unit
        of it, in world axes."""
        layout, dtype = self.model.layout, q.dtype
        zero = jnp.zeros((1, 3), dtype)
        known = stack([Frame(zero, np.eye(3, dtype=dtype)[None], zero, zero), supports])
        order = list(layout.frames[: layout.first_body])
        linear, angular = [], []
        for table, (q_rows, v_rows) in self._each(lambda joint, q, v: (q, v), (q, "q"), (v, "v")):
            parent = Frame(*(take(x, np.array([order.index(name) for name in table.links])) for x in (known.p, known.R, known.v, known.w)))
            bodies = np.array([layout.bodies.index(name) for name in table.names])
            rest = Pose(take(self.rest.p, bodies), take(self.rest.R, bodies))
            frame, axes = jax.vmap(_joint_frame)(table.rows, q_rows, v_rows, parent, rest)
            known = stack([known, frame])
            order += table.names
            linear.append((table, axes[0]))
            angular.append((table, axes[1]))
        rows = np.array([order.index(name) for name in layout.frames])
        frames = Frame(*(take(x, rows) for x in (known.p, known.R, known.v, known.w)))
        return frames, (self._assemble(linear).reshape(-1, 3), self._assemble(angular).reshape(-1, 3))


def _joint_frame(joint, q, v, parent: Frame, rest: Pose):
    """One body's frame from its parent's: w = w_P + sum v_i n_i, v_O = v_P + w_P x (O - O_P) + sum v_i l_i."""
    pose = joint.pose(q, parent.pose(), rest)
    linear, angular = joint.axes(q, parent.pose(), pose)
    w = parent.w + jnp.sum(v[:, None] * angular, 0)
    velocity = parent.v + cross(parent.w, pose.p - parent.p) + jnp.sum(v[:, None] * linear, 0)
    return Frame(pose.p, pose.R, velocity, w), (linear, angular)


def frames_at_time(model: Model, motions: Motions, t, state: State) -> Frame:
    """The table of frames at a time."""
    coordinates = Coordinates(model)
    return coordinates.frames(state.q, state.v, coordinates.supports_moving(motions, t))


@eqx.filter_jit
def retract(model: Model, q: Float[Array, "nq"], delta: Float[Array, "nv"]) -> Float[Array, "nq"]:
    """q (+) Delta: the coordinates after small displacements Delta, one for each speed; of a free body its displacement [m] and
    rotation vector [rad], in world axes.

    >>> import jax.numpy as jnp
    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])})
    >>> retract(model, model.reference.q, jnp.array([0.1, 0, 0, 0, 0, 0])).tolist()
    [0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    """
    return Chart(model).retract(q, delta)
