"""Joints as rows of elementary ones, slides, hinges and balls, from which other programs build
theirs; and their coordinates."""

import dataclasses

import numpy as np
import rigs

import jaxbody as jb

CONJUGATE = np.array([1.0, -1, -1, -1])


@dataclasses.dataclass
class Step:
    """One elementary joint: "move" or "turn" along or about an axis, or "ball"; axis and point in
    the reference pose, in the axes of the parent. Value and speed: a number, or the unit quaternion
    of the turn and the angular velocity, in the axes of the parent."""

    kind: str
    at: np.ndarray
    axis: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))

    @property
    def nv(self):
        return 3 if self.kind == "ball" else 1


@dataclasses.dataclass
class Carried:
    """A body, or a support that moves freely, on its parent; `place` is its reference
    pose there."""

    name: str
    parent: str
    place: tuple[np.ndarray, np.ndarray]
    steps: list[Step]


def multiplied(p, q):
    """The product of two quaternions."""
    (w, x), (v, y) = (p[0], p[1:]), (q[0], q[1:])
    return np.concatenate([[w * v - x @ y], w * y + v * x + np.cross(x, y)])


def reference(model, name):
    if name == "world":
        return np.zeros(3), np.array([1.0, 0, 0, 0])
    return np.asarray(model[name].position), np.asarray(model[name].orientation)


def on_parent(model, name, parent):
    """Position and quaternion of a frame on another in the reference pose."""
    (p, q), (p_0, q_0) = reference(model, name), reference(model, parent)
    return rigs.turned(q_0).T @ (p - p_0), multiplied(q_0 * CONJUGATE, q)


def frames(model):
    """Supports and bodies, each followed by all that it carries, as Pinocchio needs them."""
    E, layout = np.eye(3), model.layout
    parents = dict.fromkeys(layout.supports, "world") | dict(
        zip(layout.bodies, layout.parents, strict=True)
    )

    def carried_by(parent):
        for name in (name for name, its in parents.items() if its == parent):
            yield name
            yield from carried_by(name)

    found = []
    for name in carried_by("world"):
        joint = jb.Free() if name in layout.supports else model.joint(name)
        p, q = on_parent(model, name, joint.parent)
        at = p if joint.at is None else np.asarray(joint.at)
        ball = Step("ball", at)
        slides = [Step("move", p, e) for e in E]
        if isinstance(joint, jb.Free):
            steps = [*slides, ball]
        elif isinstance(joint, jb.Fixed):
            steps = []
        elif isinstance(joint, jb.Ball):
            steps = [ball]
        elif isinstance(joint, jb.Guide | jb.Hinge):
            steps = [
                Step("move" if isinstance(joint, jb.Guide) else "turn", at, np.asarray(joint.axis))
            ]
        elif isinstance(joint, jb.joints.Composite):
            rows = zip(
                joint.steps, np.asarray(joint.points), np.asarray(joint.directions), strict=True
            )
            steps = [Step(kind, point, axis) for kind, point, axis in rows]
        else:  # translations, then rotations about O, along axes of the parent
            steps = [
                Step("turn" if turn else "move", p, E[i])
                for i, turn in zip(joint.steps, joint.turns, strict=True)
            ]
        found.append(Carried(name, joint.parent, (p, q), steps))
    return found


def coordinates(model, carried, state, supports):
    """(values, speeds) of the steps of a frame, in a state and with the supports at
    `supports[name]` = (displacement, turn, velocity, angular velocity), in world axes."""
    if carried.name in model.layout.supports:
        u, turn, v, w = supports[carried.name]
        return [*u, turn], [*v, w]
    q, v = (
        np.asarray(x)[slices[carried.name]]
        for x, slices in ((state.q, model.layout.q_slices), (state.v, model.layout.v_slices))
    )
    joint = model.joint(carried.name)
    if isinstance(joint, jb.Free):
        p, rest = carried.place
        return [*(q[:3] - p), multiplied(q[3:], rest * CONJUGATE)], [*v[:3], v[3:]]
    if isinstance(joint, jb.Ball):
        return [q], [v]
    return list(q), list(v)


def imposed(motion, t):
    """(displacement, turn, velocity, angular velocity) and (acceleration, angular acceleration) of
    a support with a `Harmonic` motion, by its formula: R' by a complex step, w' by six values of w
    at 0.002 s, which leaves 1e-12 at 1 Hz."""
    amplitude = np.concatenate([motion.translation, motion.rotation])
    phase = np.concatenate([motion.translation_phase, motion.rotation_phase])
    rate = 2 * np.pi * np.asarray(motion.frequency)

    def xi(t):
        return amplitude * np.cos(rate * t + phase)

    def w(t):
        R = rigs.rodrigues(xi(t + 1e-30j)[3:])
        W = (R.imag / 1e-30) @ R.real.T
        return np.array([W[2, 1], W[0, 2], W[1, 0]])

    h, phi = 2e-3, xi(t)[3:]
    alpha = sum(
        c * w(t + i * h)
        for i, c in zip((-3, -2, -1, 1, 2, 3), (-1, 9, -45, 45, -9, 1), strict=True)
    ) / (60 * h)
    angle = np.linalg.norm(phi)
    turn = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * phi / angle])
    x_dot, x_ddot = (
        (-amplitude * rate * np.sin(rate * t + phase))[:3],
        (-amplitude * rate**2 * np.cos(rate * t + phase))[:3],
    )
    return (xi(t)[:3], turn, x_dot, w(t)), (x_ddot, alpha)


AT_REST = (
    (np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3)),
    (np.zeros(3), np.zeros(3)),
)
