"""Every joint on the world, on a turned moving support and on a turned moving body, against
rigid-body kinematics written in NumPy."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxbody as jb
from jaxbody.model.joints.kinematics import Coordinates

RNG = np.random.default_rng(7)
AXIS, AT = np.array([0.6, -0.5, 1.1]), np.array([0.3, -0.8, 0.4])
UNIT = AXIS / np.linalg.norm(AXIS)
SECOND = np.array([0.2, 0.9, -0.3])  # not perpendicular to the other
ACROSS = SECOND / np.linalg.norm(SECOND)
STEPS = ["turn", "move", "turn", "move"]
LINES = RNG.normal(size=(2, 4, 3))
JOINTS = {
    "free": jb.Free,
    "fixed": jb.Fixed,
    "guide": lambda parent: jb.Guide(parent, axis=AXIS),
    "hinge": lambda parent: jb.Hinge(parent, axis=AXIS),
    "hinge at": lambda parent: jb.Hinge(parent, axis=AXIS, at=AT),
    "ball": jb.Ball,
    "ball at": lambda parent: jb.Ball(parent, at=AT),
    "universal": lambda parent: jb.joints.Universal(parent, first=AXIS, second=SECOND),
    "universal at": lambda parent: jb.joints.Universal(parent, first=AXIS, second=SECOND, at=AT),
    "cylindrical": lambda parent: jb.joints.Cylindrical(parent, axis=AXIS),
    "cylindrical at": lambda parent: jb.joints.Cylindrical(parent, axis=AXIS, at=AT),
    "planar": lambda parent: jb.joints.Planar(parent, first=AXIS, second=SECOND),
    "translation": jb.Translation,
    "half car": jb.joints.HeavePitch,
    "full car": jb.joints.HeavePitchRoll,
    "composite": lambda parent: jb.joints.Composite(
        parent, STEPS, directions=LINES[0], points=LINES[1]
    ),
}
NAMES = [
    f"{kind} on {parent}"
    for parent, kind in itertools.product(["world", "base", "carrier"], JOINTS)
]
# a body on a body on a body
NAMES += ["ball at on hinge at on carrier", "hinge at on full car on base"]


def turned():
    return {
        "position": RNG.normal(size=3),
        "orientation": Rotation.random(rng=RNG).as_quat(scalar_first=True),
    }


def body():
    return jb.Body(mass=1.0, inertia=[1, 1, 1], com=RNG.normal(size=3), **turned())


MODEL = jb.Model(
    bodies={"carrier": body()} | {name: body() for name in RNG.permutation(NAMES).tolist()},
    supports={"other": jb.Support(), "base": jb.Support(**turned())},
    joints={name: JOINTS[name.split(" on ")[0]](name.split(" on ", 1)[1]) for name in NAMES},
)
LAYOUT = MODEL.layout
MOTIONS = tuple(
    jb.Harmonic(
        frequency=0.3,
        translation=RNG.normal(size=3),
        rotation=2 * RNG.normal(size=3),
        rotation_phase=RNG.normal(size=3),
    )
    for _ in LAYOUT.supports
)
DELTA, V, XI, XI_DOT = (
    RNG.normal(size=LAYOUT.nv) * 2,
    RNG.normal(size=LAYOUT.nv),
    RNG.normal(size=(2, 6)),
    RNG.normal(size=(2, 6)),
)


@jax.jit
def retract(q, delta):
    return Coordinates(MODEL).retract(q, delta)


@jax.jit
def frames_and_axes(q, v, xi, xi_dot):
    coordinates = Coordinates(MODEL)
    return coordinates.frames_and_axes(q, v, coordinates.supports_at(xi, xi_dot))


@jax.jit
def rate(q, v):
    return Coordinates(MODEL).rate(q, v)


@jax.jit
def change(q, v, v_dot, xi_dot):
    """Derivative of the table of frames where v moves the coordinates, v itself passes 0 at the
    rate v_dot, and the supports move."""
    moving = (q, 0 * V, XI, 0 * XI), (rate(q, v), v_dot, xi_dot, 0 * XI)
    return jax.jvp(lambda *x: frames_and_axes(*x)[0], *moving)[1]


@pytest.fixture(scope="module")
def q():
    """Some coordinates far from the reference pose."""
    return retract(MODEL.reference.q, DELTA)


@pytest.fixture(scope="module")
def posed(q):
    """Frames in a state, and the velocities that a unit of each speed gives to its own body."""
    return jax.tree.map(np.asarray, frames_and_axes(q, V, XI, XI_DOT))


def row(name):
    return LAYOUT.frame(name)


def matrix(quaternion):
    return Rotation.from_quat(np.asarray(quaternion), scalar_first=True).as_matrix()


def spun(w, R):
    """[w] R."""
    return np.cross(w[..., None, :], np.swapaxes(R, -1, -2)).swapaxes(-1, -2)


def transform(p=(0, 0, 0), R=None):
    """4 x 4 matrix of a pose."""
    T = np.eye(4)
    T[:3, 3], T[:3, :3] = p, np.eye(3) if R is None else R
    return T


def reference(name):
    if name == "world":
        return np.eye(4)
    return transform(MODEL[name].position, matrix(MODEL[name].orientation))


def pose_by_hand(kind, q, at, rest):
    """The pose of a body on its parent."""
    if kind == "free":
        return transform(q[:3], matrix(q[3:]))
    if kind == "fixed":
        return rest
    if kind == "guide":
        return transform(q[0] * UNIT) @ rest
    if kind == "translation":
        return transform(q) @ rest
    # R = R_y R_x: each turn about an axis that the one before it has turned
    if kind.endswith("car"):
        R = Rotation.from_euler("YX"[: len(q) - 1], q[1:]).as_matrix()
        return transform(rest[:3, 3] + [0, 0, q[0]], R @ rest[:3, :3])
    if kind == "composite":
        T = np.eye(4)
        for step, n, at, x in zip(
            STEPS,
            LINES[0] / np.linalg.norm(LINES[0], axis=1, keepdims=True),
            LINES[1],
            q,
            strict=True,
        ):
            turn = (
                transform(at)
                @ transform(R=Rotation.from_rotvec(x * n).as_matrix())
                @ transform(-at)
            )
            T = T @ (turn if step == "turn" else transform(x * n))
        return T @ rest
    if kind == "planar":
        normal = np.cross(UNIT, ACROSS)
        turn = Rotation.from_rotvec(q[2] * normal / np.linalg.norm(normal)).as_matrix()
        return transform(rest[:3, 3] + q[0] * UNIT + q[1] * ACROSS, turn @ rest[:3, :3])
    if kind.startswith("universal"):
        R = (Rotation.from_rotvec(q[0] * UNIT) * Rotation.from_rotvec(q[1] * ACROSS)).as_matrix()
    elif kind.startswith("cylindrical"):
        at, R = at + q[0] * UNIT, Rotation.from_rotvec(q[1] * UNIT).as_matrix()
        return transform(at) @ transform(R=R) @ transform(q[0] * UNIT - at) @ rest
    else:
        R = matrix(q) if kind.startswith("ball") else Rotation.from_rotvec(q[0] * UNIT).as_matrix()
    return transform(at) @ transform(R=R) @ transform(-at) @ rest


@pytest.mark.parametrize("name", NAMES)
def test_a_body_stands_where_its_joint_puts_it(name, q, posed):
    """Axes and points of a joint are in the parent's frame; q = 0, or the unit quaternion, is the
    reference pose."""
    kind, parent = name.split(" on ", 1)
    frames, _ = posed
    rest = np.linalg.inv(reference(parent)) @ reference(name)
    at = AT if kind.endswith("at") else rest[:3, 3]
    mine = np.asarray(q[LAYOUT.q_slices[name]])
    relative = pose_by_hand(kind, mine, at, rest)
    exact = transform(frames.p[row(parent)], frames.R[row(parent)]) @ relative
    assert np.abs(frames.p[row(name)] - exact[:3, 3]).max() <= 1e-14 * max(1, np.abs(exact).max())
    assert np.abs(frames.R[row(name)] - exact[:3, :3]).max() <= 1e-14


def test_a_support_stands_where_its_motion_puts_it(posed):
    frames, _ = posed
    for name, xi in zip(LAYOUT.supports, XI, strict=True):
        T = reference(name)
        assert np.abs(frames.p[row(name)] - T[:3, 3] - xi[:3]).max() <= 1e-15
        assert (
            np.abs(frames.R[row(name)] - Rotation.from_rotvec(xi[3:]).as_matrix() @ T[:3, :3]).max()
            <= 1e-15
        )


def test_the_reference_pose_is_met_at_the_reference_coordinates():
    frames, _ = frames_and_axes(MODEL.reference.q, MODEL.reference.v, 0 * XI, 0 * XI)
    for name in LAYOUT.frames:
        assert (
            np.abs(transform(frames.p[row(name)], frames.R[row(name)]) - reference(name)).max()
            <= 2e-15
        )
    assert not frames.v.any() and not frames.w.any()


def test_increments_displace_a_free_body_and_turn_it_in_the_axes_of_its_parent(q):
    """The chart of a free body: displacement of its reference point, R -> exp([theta]) R; of a ball
    joint the same without the first."""
    start = MODEL.reference.q
    for name in NAMES:
        before, after = (np.asarray(x[LAYOUT.q_slices[name]]) for x in (start, q))
        delta = DELTA[LAYOUT.v_slices[name]]
        if name.startswith(("free", "ball")):
            turn = Rotation.from_rotvec(delta[-3:]).as_matrix() @ matrix(before[-4:])
            assert np.abs(matrix(after[-4:]) - turn).max() <= 2e-15
            assert np.abs(after[:-4] - before[:-4] - delta[:-3]).max(initial=0) <= 1e-15
        else:
            assert np.abs(after - before - delta).max(initial=0) <= 1e-15


@pytest.mark.long
def test_the_rate_is_the_derivative_of_the_increment(q):
    moved, moving = jax.jvp(retract, (q, 0 * V), (0 * q, V))
    assert np.abs(moved - q).max() <= 1e-15
    assert np.abs(moving - rate(q, V)).max() <= 2e-15


def test_speeds_move_bodies_as_increments_displace_them(q, posed):
    """d pose / d Delta is the velocity per unit of each speed: of the body itself `axes`, of those
    on it by the table of frames."""
    frames, (linear, angular) = posed
    own = [row(name) for name in LAYOUT.bodies for _ in range(LAYOUT.nv)[LAYOUT.v_slices[name]]]
    for i, unit in enumerate(np.eye(LAYOUT.nv)):
        d = change(q, unit, unit, 0 * XI)
        assert np.abs(d.p - d.v).max() <= 1e-14
        assert np.abs(d.R - spun(d.w, frames.R)).max() <= 1e-14
        assert np.abs(d.p[own[i]] - linear[i]).max() <= 1e-14
        assert np.abs(d.w[own[i]] - angular[i]).max() <= 1e-14


def test_velocities_of_all_frames_are_the_derivatives_of_their_poses_in_time(q, posed):
    """Supports moving and turning, all joints moving: v = dp/dt, [w] R = dR/dt."""
    frames, _ = posed
    d = change(q, V, 0 * V, XI_DOT)
    for result, exact in ((d.p, frames.v), (d.R, spun(frames.w, frames.R))):
        assert np.abs(result - exact).max() <= 1e-14 * max(1, np.abs(exact).max())


def test_velocities_of_supports_are_the_derivatives_of_their_imposed_motions():
    """Shaking by metres and turning by radians, the axis of the turn changing."""
    moving = jax.jit(
        lambda t: jax.jvp(
            lambda t: Coordinates(MODEL).supports_moving(MOTIONS, t), (t,), (jnp.ones_like(t),)
        )
    )
    frames, d = moving(jnp.array(0.4))
    assert np.abs(frames.w).max() > 1
    assert np.abs(d.p - frames.v).max() <= 1e-14
    assert np.abs(d.R - spun(frames.w, frames.R)).max() <= 1e-14


def test_a_point_of_a_moving_frame_has_the_velocity_of_a_rigid_body(posed):
    frames, _ = posed
    points = RNG.normal(size=(len(LAYOUT.frames), 3))
    arm = np.einsum("nij,nj->ni", frames.R, points)
    assert np.abs(frames.point(points) - frames.p - arm).max() <= 1e-14
    assert (
        np.abs(frames.velocity(points) - frames.v - np.cross(frames.w, arm)).max()
        <= 1e-14 * np.abs(frames.w).max()
    )


def test_a_quaternion_and_its_negative_are_the_same_pose(q, posed):
    flip = np.ones(LAYOUT.nq)
    for name in LAYOUT.bodies:
        if name.startswith(("free", "ball", "carrier")):
            flip[LAYOUT.q_slices[name]][-4:] = -1
    frames, _ = frames_and_axes(q * flip, V, XI, XI_DOT)
    for result, exact in zip(jax.tree.leaves(frames), jax.tree.leaves(posed[0]), strict=True):
        assert (result == exact).all()


def test_a_joint_may_turn_any_number_of_times(q):
    """Three turns more of every hinge or pitch and roll, or of every quaternion about any axis,
    change nothing."""
    more = np.zeros(LAYOUT.nv)
    for name in LAYOUT.bodies:
        mine = LAYOUT.v_slices[name]
        if name.startswith(
            ("hinge", "half", "full", "composite", "universal", "cylindrical", "planar")
        ):
            more[mine] = 6 * np.pi * LAYOUT.turns[mine]
        elif name.startswith(("free", "ball", "carrier")):
            more[mine][-3:] = 6 * np.pi * UNIT
    before, after = (frames_and_axes(x, V, XI, XI_DOT)[0] for x in (q, retract(q, more)))
    assert np.abs(before.R - after.R).max() <= 1e-13
    assert np.abs(before.p - after.p).max() <= 1e-13 * np.abs(before.p).max()


def test_a_direction_may_be_named():
    """x, y and z, wherever an axis is asked for."""
    for letter, n in zip("xyz", np.eye(3), strict=True):
        for thing in (
            jb.Guide("world", axis=letter),
            jb.Hinge("world", axis=letter),
            jb.Torsion("a", "b", axis=letter, spring=1.0),
            jb.inputs.Unbalance("a", axis=letter, unbalance=1.0, frequency=1.0),
        ):
            np.testing.assert_array_equal(thing.axis, n)
    with pytest.raises(jb.JaxbodyError, match=r"Hinge.axis: is 'w' \(allowed: x y z\)"):
        jb.Hinge("world", axis="w")
