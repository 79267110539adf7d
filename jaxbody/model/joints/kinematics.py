"""From coordinates to frames: where every frame of a model is and how it moves, as one table with
rows world, supports, bodies."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, numbers, shaped
from jaxbody.core.arrays import stack as stack_rows
from jaxbody.core.errors import Problems, unknown
from jaxbody.geometry import rotations
from jaxbody.geometry.frames import Frame, Instant, Pose, stack
from jaxbody.geometry.vectors import cross, rotate
from jaxbody.model.element_states import rest_states
from jaxbody.model.inputs.signals import Signal
from jaxbody.model.layouts import Layout
from jaxbody.model.states import State
from jaxbody.model.storage import KindTable

Motions = tuple[Signal, ...]  # of six numbers, one per support, in their order


def places(names: Sequence[str], order: Sequence[str]) -> np.ndarray:
    """Return the rows of names in a table of this order."""
    return np.array([order.index(name) for name in names], dtype=int)


def rest_poses(model: Any, supports: Pose, bodies: Pose) -> Pose:
    """Return the pose of each body on its parent in the reference pose, in the order of the bodies,
    from its pose in the world."""
    poses = drawn_poses(supports, bodies)
    return poses[places(model.layout.parents, model.layout.frames)].inverse() @ bodies


def coordinates_at_rest(model: Any, rest: Pose) -> Float[Array, "nq"]:
    """Return the coordinates with which the bodies have the poses `rest` relative to their
    parents."""
    layout, each = model.layout, jax.vmap(lambda joint, pose: joint.rest(pose))
    return layout.joined(
        [
            (table.names, each(table.rows, rest[places(table.names, layout.bodies)]))
            for table in model.joints
        ]
    )


def body_poses(model: Any) -> Pose:
    """Return the poses of the bodies in the reference pose."""
    return poses_of(model.bodies)


def poses_of(table: KindTable) -> Pose:
    """Return the poses of bodies or supports as they are drawn."""
    return Pose(table.rows.position, rotations.matrix(table.rows.orientation))


def drawn_poses(supports: Pose, bodies: Pose) -> Pose:
    """Return the poses of all frames, in the order world, supports, bodies."""
    return with_world(supports.at_rest(), bodies.at_rest()).pose()


class Chart(eqx.Module):
    """The coordinates q of the joints of a model, their increments Delta and the speeds v."""

    model: Any

    def _each(self, function, *vectors: tuple[Array, dict[str, slice]]):
        """Yield (table, function(joint, row, ...)) for each table of joints; `vectors` are q or v
        with their slices."""
        for table in self.model.joints:
            yield (
                table,
                jax.vmap(function)(
                    table.rows,
                    *(self.model.layout.rows_of(table.names, *vector) for vector in vectors),
                ),
            )

    def _joined(self, function, *vectors: tuple[Array, dict[str, slice]]) -> Array:
        return self.model.layout.joined(
            [(table.names, row) for table, row in self._each(function, *vectors)]
        )

    def retract(self, q: Float[Array, "nq"], delta: Float[Array, "nv"]) -> Float[Array, "nq"]:
        """Return q (+) Delta, joint by joint."""
        layout = self.model.layout
        return self._joined(
            lambda joint, q, d: joint.retract(q, d), (q, layout.q_slices), (delta, layout.v_slices)
        )

    def rate(self, q: Float[Array, "nq"], v: Float[Array, "nv"]) -> Float[Array, "nq"]:
        """Return dq/dt for the speeds v."""
        layout = self.model.layout
        return self._joined(
            lambda joint, q, v: joint.rate(q, v), (q, layout.q_slices), (v, layout.v_slices)
        )

    def rate_transposed(self, q: Float[Array, "nq"], p: Float[Array, "nq"]) -> Float[Array, "nv"]:
        """Return B' p, where dq/dt = B v."""
        zero = jnp.zeros(self.model.layout.nv, q.dtype)
        return jax.linear_transpose(lambda v: self.rate(q, v), zero)(p)[0]


class Coordinates(Chart):
    """A chart with the reference poses of supports and bodies, and `rest`, the reference poses of
    bodies relative to their parents."""

    supports: Pose
    bodies: Pose
    rest: Pose

    def __init__(self, model: Any):
        self.model = model
        self.supports, self.bodies = poses_of(model.supports), body_poses(model)
        self.rest = rest_poses(model, self.supports, self.bodies)

    @property
    def reference(self) -> State:
        """The state of rest in the reference pose as it is drawn; elements with memory are
        relaxed."""
        layout, q = self.model.layout, coordinates_at_rest(self.model, self.rest)
        z = rest_states(self.model, self.in_world) if layout.nz else None
        return State(q, jnp.zeros(layout.nv, q.dtype), z)

    @property
    def in_world(self) -> Pose:
        """The poses of all frames as they are drawn, in the order world, supports, bodies."""
        return drawn_poses(self.supports, self.bodies)

    def supports_at(self, xi: Float[Array, "ns 6"], xi_dot: Float[Array, "ns 6"]) -> Frame:
        """Return the frames of the supports, displaced by Xi [m, rad] from their reference poses
        and moving with the rate Xi'."""
        pose = self.supports.displaced(xi)
        return Frame(
            pose.p, pose.R, xi_dot[:, :3], rotate(rotations.left_jacobian(xi[:, 3:]), xi_dot[:, 3:])
        )

    def supports_moving(self, motions: Motions, t: Float[Array, ""]) -> Frame:
        """Return the frames of the supports at time t [s]."""
        if not motions:
            return self.supports.at_rest()
        return self.supports_at(*imposed(motions, t))

    def at_rest(self, q: Float[Array, "nq"], v: Float[Array, "nv"] | None = None) -> Frame:
        """Return the table of frames with supports at rest in their reference poses, and bodies
        with speeds v, by default at rest."""
        return self.frames(
            q, jnp.zeros(self.model.layout.nv, q.dtype) if v is None else v, self.supports.at_rest()
        )

    def frames(self, q: Float[Array, "nq"], v: Float[Array, "nv"], supports: Frame) -> Frame:
        """Return the table of frames: world, supports, bodies."""
        return self.frames_and_axes(q, v, supports)[0]

    @jax.jit
    def frames_and_axes(self, q: Float[Array, "nq"], v: Float[Array, "nv"], supports: Frame):
        """Return the table of frames, and for each speed the velocity (nv, 3) and angular velocity
        (nv, 3) per unit of it, in world axes, of the body that it moves first."""
        layout, known = self.model.layout, with_world(supports)
        order, linear, angular = list(layout.frames[: layout.first_body]), [], []
        for table, (q_rows, v_rows) in self._each(
            lambda joint, q, v: (q, v), (q, layout.q_slices), (v, layout.v_slices)
        ):
            parent = known[places(table.links, order)]
            rest = self.rest[places(table.names, layout.bodies)]
            frame, axes = jax.vmap(_joint_frame)(table.rows, q_rows, v_rows, parent, rest)
            known = stack([known, frame])
            order += table.names
            linear.append((table.names, axes[0]))
            angular.append((table.names, axes[1]))
        return known[places(layout.frames, order)], (
            layout.joined(linear),
            layout.joined(angular),
        )


def imposed(
    motions: Motions, t: Float[Array, ""]
) -> tuple[Float[Array, "ns 6"], Float[Array, "ns 6"]]:
    """Return Xi and Xi' of the supports at time t [s]."""
    return jax.jvp(
        lambda t: jnp.stack([motion(t) for motion in motions]), (t,), (jnp.ones_like(t),)
    )


def displacements(model: Any, given: Any, where: str, problems: Problems) -> Float[Array, "ns 6"]:
    """Return Xi of the supports [m, rad], or its rate, given as {support: six numbers}, 0 for
    omitted supports, or as a row for each support. Errors: UNKNOWN_NAME, BAD_SHAPE, NON_FINITE."""
    names = model.layout.supports
    if not isinstance(given, dict):
        return shaped(given, (len(names), 6), where, problems)
    problems.collected += [unknown(name, where, names) for name in given if name not in names]
    return stack_rows(
        [
            shaped(given.get(name, np.zeros(6)), (6,), f"{where}[{name!r}]", problems)
            for name in names
        ]
    )


def with_world(*frames: Frame) -> Frame:
    """Return the table of the frame of the world and the given frames: supports, bodies."""
    zero = jnp.zeros((1, 3), frames[0].p.dtype)
    return stack([Frame(zero, np.eye(3, dtype=zero.dtype)[None], zero, zero), *frames])


def jacobian(
    layout: Layout, frames: Frame, linear: Float[Array, "n 3"], angular: Float[Array, "n 3"]
):
    """Return (frames, n, 3) velocities of the origins of the moving frames, and their angular
    velocities, per unit of each speed, from the velocities of the frame that each speed moves
    first: of the bodies alone or, with six rows more for each support, of bodies and supports."""
    rows, movers = layout.moving(base=len(linear) > layout.nv), layout.movers[: len(linear)]
    mask = jnp.asarray(layout.carries[np.ix_(movers, rows)].T, frames.p.dtype)[..., None]
    arms = frames.p[rows][:, None] - frames.p[movers][None]
    return mask * (linear[None] + cross(angular[None], arms)), mask * angular[None]


def _joint_frame(joint, q, v, parent: Frame, rest: Pose):
    """Return one body's frame from its parent's, and the joint's axes: w = w_P + sum v_i n_i, v_O =
    v_P + w_P x (O - O_P) + sum v_i l_i."""
    pose = joint.pose(q, parent.pose(), rest)
    linear, angular = joint.axes(q, parent.pose(), pose)
    w = parent.w + jnp.sum(v[:, None] * angular, 0)
    velocity = parent.v + cross(parent.w, pose.p - parent.p) + jnp.sum(v[:, None] * linear, 0)
    return Frame(pose.p, pose.R, velocity, w), (linear, angular)


def frames_at_time(model: Any, motions: Motions, t, state: State) -> Instant:
    """Return the table of frames at a time [s] and state."""
    coordinates = Coordinates(model)
    return coordinates.frames(state.q, state.v, coordinates.supports_moving(motions, t)).at_time(
        t, state
    )


def frames_displaced(
    model: Any, state: State, delta: Float[Array, "nv"], xi: Float[Array, "*ns 6"] | None = None
) -> Frame:
    """Return the table of frames at q (+) Delta, at rest, with the supports displaced by Xi."""
    coordinates = Coordinates(model)
    zero = jnp.zeros((len(model.layout.supports), 6), delta.dtype)
    supports = coordinates.supports_at(zero if xi is None else xi.reshape(-1, 6), zero)
    return coordinates.frames(coordinates.retract(state.q, delta), jnp.zeros_like(delta), supports)


def retract(model: Any, q, delta) -> Float[Array, "nq"]:
    """Return q (+) Delta, the coordinates after small displacements Delta, one for each speed;
    those of a free body are its displacement [m] and rotation vector [rad], in world axes.

    >>> model = jb.Model(bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])})
    >>> jb.joints.retract(model, model.reference.q, [0.1, 0, 0, 0, 0, 0]).tolist()
    [0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    """
    return _retract(model, numbers(q, "retract.q"), numbers(delta, "retract.delta"))


@eqx.filter_jit
def _retract(model: Any, q: Float[Array, "nq"], delta: Float[Array, "nv"]) -> Float[Array, "nq"]:
    return Chart(model).retract(q, delta)
