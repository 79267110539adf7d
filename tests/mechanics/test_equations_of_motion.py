"""The equations of motion by three independent methods, and the reactions on supports."""

import jax
import jax.numpy as jnp
import numpy as np
import paper
import pytest

import jaxbody as jb
from jaxbody.geometry import rotations
from jaxbody.mechanics.closed_loops import acceleration, dynamics_of
from jaxbody.mechanics.dynamics import FreeBodies, JointedBodies
from jaxbody.model.joints.kinematics import Coordinates

SAMPLES = 100
jit_once = jb.jit  # compiling is the cost


# Euler-Lagrange by automatic differentiation, in coordinates x: rotation vectors where the library
# has quaternions


def chart(model, x):
    """q of x: a rotation vector for a ball, (position, rotation vector) for a free joint, the same
    numbers for all others."""
    parts, i = [], 0
    for block in model.layout.blocks:
        part, i = x[i : i + block.nv], i + block.nv
        if block.nq > block.nv:
            part = jnp.concatenate([part[:-3], exp_quaternion(part[-3:])])
        parts.append(part)
    return jnp.concatenate(parts)


def exp_quaternion(phi):
    """Of a rotation vector that is not zero."""
    t = jnp.sqrt(jnp.sum(phi * phi))
    return jnp.append(jnp.cos(t / 2), jnp.sin(t / 2) / t * phi)


def speeds(model, q, q_dot):
    """v of q and q': the angular velocity is the vector part of 2 q' q*."""
    parts, i = [], 0
    for block in model.layout.blocks:
        part, rate, i = q[i : i + block.nq], q_dot[i : i + block.nq], i + block.nq
        if block.nq > block.nv:
            conjugate = part[-4:] * jnp.array([1, -1, -1, -1])
            rate = jnp.concatenate([rate[:-4], 2 * rotations.multiply(rate[-4:], conjugate)[1:]])
        parts.append(rate)
    return jnp.concatenate(parts)


def state_of(model, x, x_dot):
    q, q_dot = jax.jvp(lambda x: chart(model, x), (x,), (x_dot,))
    return jb.State(q, speeds(model, q, q_dot))


def euler_lagrange(model, motions, t, x, x_dot):
    """v' and the force and moment on each support, from

    d/dt dL/dy' - dL/dy + dR/dy' = 0 for y = x, = what moves the supports for y = Xi(t)."""
    n = len(x)

    def imposed(t):
        return jax.jvp(
            lambda t: jnp.concatenate([motion(t) for motion in motions]), (t,), (jnp.ones_like(t),)
        )

    def value(function, y, y_dot):
        return function(
            model,
            state_of(model, y[:n], y_dot[:n]),
            xi=y[n:].reshape(-1, 6),
            xi_dot=y_dot[n:].reshape(-1, 6),
        )

    (xi, xi_dot), (_, xi_ddot) = jax.jvp(imposed, (t,), (jnp.ones_like(t),))
    y, y_dot = jnp.concatenate([x, xi]), jnp.concatenate([x_dot, xi_dot])
    lost = jax.grad(value, argnums=2)(jb.dissipation, y, y_dot)

    def left(x_ddot):
        slopes = jax.grad(lambda y, y_dot: value(jb.lagrangian, y, y_dot), argnums=(0, 1))
        (slope, _), (_, momentum_dot) = jax.jvp(
            slopes, (y, y_dot), (y_dot, jnp.concatenate([x_ddot, xi_ddot]))
        )
        return momentum_dot - slope + lost

    columns = jax.vmap(left)(jnp.concatenate([jnp.zeros((1, n)), jnp.eye(n)]))  # affine in x''
    bias, mass = columns[0], (columns[1:] - columns[0]).T
    x_ddot = -jnp.linalg.solve(mass[:n], bias[:n])
    v_dot = jax.jvp(lambda x, x_dot: state_of(model, x, x_dot).v, (x, x_dot), (x_dot, x_ddot))[1]
    moving = (bias[n:] + mass[n:] @ x_ddot).reshape(-1, 2, 3)
    turns = jax.vmap(angular_velocity_per_rate)(xi.reshape(-1, 6)[:, 3:])
    moments = jax.vmap(lambda J, g: jnp.linalg.solve(J.T, g))(turns, moving[:, 1])
    return v_dot, (-moving[:, 0], -moments)


def angular_velocity_per_rate(phi):
    """J with w = J phi' for a rotation vector: what turns a generalized force into a moment."""
    conjugate = exp_quaternion(phi) * jnp.array([1, -1, -1, -1])
    rates = jax.jacfwd(exp_quaternion)(phi)
    return jax.vmap(lambda rate: 2 * rotations.multiply(rate, conjugate)[1:], 1, 1)(rates)


def random_coordinates(model, rng, size):
    """x within 2.5 rad of the reference turn, and x'."""
    n = model.layout.nv
    x = rng.normal(size=(size, n))
    turns = np.flatnonzero(model.layout.turns)
    x[:, turns] *= 0.8
    return jnp.array(np.clip(x, -1.4, 1.4)), jnp.array(rng.normal(size=(size, n)))


def relative_difference(one, other):
    """Largest difference, each sample relative to its largest number."""
    one, other = np.asarray(one), np.asarray(other)
    axes = tuple(range(1, one.ndim))
    return np.max(np.abs(one - other).max(axes) / np.abs(other).max(axes))


def shaking(rng, scale=0.3):
    """A motion of all six components, frequencies and phases apart."""
    return jb.Harmonic(
        frequency=rng.uniform(0.2, 1.0, 6),
        translation=scale * rng.normal(size=3),
        rotation=scale * rng.normal(size=3),
        translation_phase=rng.uniform(0, 6, 3),
        rotation_phase=rng.uniform(0, 6, 3),
    )


def random_inertia(rng):
    A = rng.normal(size=(3, 3))
    # second moments of a mass distribution, so that no moment exceeds the sum of the others
    J = A @ A.T
    return np.trace(J) * np.eye(3) - J


def random_body(rng, **where):
    return jb.Body(
        mass=rng.uniform(1, 3), inertia=random_inertia(rng), com=0.3 * rng.normal(size=3), **where
    )


def random_quaternion(rng):
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def floating_model(rng, names, springs, damping):
    """Free bodies on springs of finite free length; ends far enough apart never to meet."""
    bodies = {name: random_body(rng) for name in names}
    elements = {}
    for i, (one, other) in enumerate(springs):
        a, b = 0.4 * rng.normal(size=3), (5.0 if other == "base" else 0.4) * rng.normal(size=3)
        elements[f"s{i}"] = jb.Spring(
            (one, a),
            (other, b),
            stiffness=rng.uniform(10, 40),
            free_length=rng.uniform(0.5, 1.5),
            damping=damping * rng.uniform(0.5, 2),
        )
    supports = {"base": jb.Support(position=[0.3, -0.2, 0.5], orientation=random_quaternion(rng))}
    return jb.Model(bodies=bodies, supports=supports, elements=elements, gravity=[0.7, -9.81, 0.4])


STEPS = ["turn", "move", "turn", "move"]
MODELS = {
    "one body on three springs": (["plate"], [("plate", "base")] * 3),
    "two bodies": (
        ["plate", "rotor"],
        [("plate", "base")] * 3
        + [("rotor", "plate"), ("plate", "rotor"), ("rotor", "base"), ("rotor", "world")],
    ),
}


@jit_once
def by_library(model, motions, times, states):
    """v' by the path that is integrated and by that of trees, and the reactions."""
    dynamics = dynamics_of(model, motions)

    def one(t, state):
        y = dynamics.pack(state)
        along = jax.jvp(dynamics.unpack, (y,), (dynamics.rate(t, y),))[1].v
        tree = (
            JointedBodies(model, motions).acceleration(t, state.q, state.v)
            if isinstance(dynamics, FreeBodies)
            else along
        )
        return along, tree, dynamics.reactions(t, state.q, state.v)

    return jax.vmap(one)(times, states)


@jit_once
def by_lagrange(model, motions, times, x, x_dot):
    return jax.vmap(lambda t, x, x_dot: euler_lagrange(model, motions, t, x, x_dot))(
        times, x, x_dot
    )


@jit_once
def states_of(model, x, x_dot):
    return jax.vmap(lambda x, x_dot: state_of(model, x, x_dot))(x, x_dot)


@pytest.mark.parametrize(
    "name", [pytest.param("one body on three springs", marks=pytest.mark.long), "two bodies"]
)
def test_free_bodies_move_as_by_euler_lagrange_and_the_paper(name):
    rng = np.random.default_rng(1)
    names, springs = MODELS[name]
    model = floating_model(rng, names, springs, damping=0.0)
    motions = (shaking(rng),)
    times = jnp.array(rng.uniform(0, 3, SAMPLES))

    # the same motion in the paper's angles: q, q' drawn there, x and the library's state made
    # from them
    q = {
        name: np.concatenate(
            [rng.normal(size=(SAMPLES, 3)), rng.uniform(-1.2, 1.2, (SAMPLES, 3))], 1
        )
        for name in names
    }
    q_dot = {name: rng.normal(size=(SAMPLES, 6)) for name in names}
    R = {name: paper.rotation(q[name][:, 3:]) for name in names}
    v = np.concatenate([paper.world_velocity(q[name], q_dot[name]) for name in names], 1)
    phi = {name: np.asarray(rotations.log(jnp.array(R[name]))) for name in names}
    x = jnp.concatenate([jnp.concatenate([q[name][:, :3], phi[name]], 1) for name in names], 1)
    J = [jax.vmap(angular_velocity_per_rate)(jnp.array(phi[name])) for name in names]
    x_dot = [
        jnp.concatenate(
            [
                v[:, 6 * i : 6 * i + 3],
                np.linalg.solve(J[i], v[:, 6 * i + 3 : 6 * i + 6, None])[..., 0],
            ],
            1,
        )
        for i in range(len(names))
    ]
    state = states_of(model, x, jnp.concatenate(x_dot, 1))
    np.testing.assert_allclose(state.v, v, atol=1e-12)

    base = support_of_paper(model, motions[0], times)
    bodies = {}
    for body in names:
        m, r_C, J_C = (
            np.asarray(getattr(model[body], field)) for field in ("mass", "com", "inertia")
        )
        bodies[body] = {"m": m, "r_C": r_C, "J_O": J_C - m * paper.skew(r_C) @ paper.skew(r_C)}
    ends = [model[f"s{i}"] for i in range(len(springs))]
    by_paper = [
        ((one, np.asarray(s.a)), (other, np.asarray(s.b)), float(s.stiffness), float(s.free_length))
        for (one, other), s in zip(springs, ends, strict=True)
    ]
    frames = {"base": base, "world": (np.zeros(3), np.eye(3))}
    q_ddot = paper.accelerations(bodies, by_paper, np.asarray(model.gravity), q, q_dot, frames)
    expected = np.concatenate(
        [paper.world_acceleration(q[n], q_dot[n], q_ddot[n]) for n in names], 1
    )

    floating, tree, reactions = by_library(model, motions, times, state)
    lagrange, lagrange_reactions = by_lagrange(model, motions, times, x, jnp.concatenate(x_dot, 1))
    assert isinstance(dynamics_of(model, motions), FreeBodies)
    assert relative_difference(floating, expected) < 1e-10
    assert relative_difference(tree, expected) < 1e-10
    assert relative_difference(lagrange, expected) < 1e-10
    for one, other in zip(reactions, lagrange_reactions, strict=True):
        assert relative_difference(one, other) < 1e-10


def support_of_paper(model, motion, times):
    """O2(t), R2(t) of the base: reference pose, then Xi(t); the turn about phi by
    Rodrigues' formula."""
    support = model["base"]
    w, e = float(support.orientation[0]), np.asarray(support.orientation[1:])
    R0 = (w * w - e @ e) * np.eye(3) + 2 * np.outer(e, e) + 2 * w * paper.skew(e)
    xi = np.asarray(jax.vmap(motion)(times))
    angle = np.linalg.norm(xi[:, 3:], axis=1)
    n = paper.skew(xi[:, 3:] / angle[:, None])
    R = np.eye(3) + np.sin(angle)[:, None, None] * n + (1 - np.cos(angle))[:, None, None] * n @ n
    return np.asarray(support.position) + xi[:, :3], R @ R0


def test_dampers_act_on_free_bodies_as_by_euler_lagrange():
    rng = np.random.default_rng(2)
    model, motions = floating_model(rng, *MODELS["two bodies"], damping=3.0), (shaking(rng),)
    assert_moves_as_by_euler_lagrange(model, motions, rng)


def tree_model(rng, joints, *, bushing):
    """Bodies anywhere on these joints, two supports, springs and perhaps a bushing, all with
    damping, across the tree."""

    def somewhere():
        return dict(position=rng.normal(size=3), orientation=random_quaternion(rng))

    def spring(one, other):
        return jb.Spring(
            (one, 0.3 * rng.normal(size=3)),
            (other, 4 * rng.normal(size=3)),
            stiffness=rng.uniform(5, 20),
            free_length=rng.uniform(0.5, 1.5),
            damping=rng.uniform(0.5, 2),
        )

    def square(scale):
        A = rng.normal(size=(6, 6))
        return scale * (A @ A.T)

    order = sorted(joints)  # of no help to the tree
    elements = {
        f"s{i}": spring(name, ["base", "stand", "world", order[0]][i % 4])
        for i, name in enumerate(order[1:])
    }
    if bushing:
        elements["mount"] = jb.Bushing(
            (order[-1], 0.3 * rng.normal(size=3)),
            ("base", rng.normal(size=3)),
            stiffness=square(3.0),
            damping=square(0.3),
            orientation=random_quaternion(rng),
            orientation_b=random_quaternion(rng),
        )
    return jb.Model(
        bodies={name: random_body(rng, **somewhere()) for name in order},
        supports={"base": jb.Support(**somewhere()), "stand": jb.Support(**somewhere())},
        joints=joints,
        elements=elements,
        gravity=[0.7, -9.81, 0.4],
    )


def assert_moves_as_by_euler_lagrange(model, motions, rng):
    x, x_dot = random_coordinates(model, rng, SAMPLES)
    times = jnp.array(rng.uniform(0, 3, SAMPLES))
    floating_or_tree, tree, reactions = by_library(
        model, motions, times, states_of(model, x, x_dot)
    )
    expected, expected_reactions = by_lagrange(model, motions, times, x, x_dot)
    for one, other in zip(
        (floating_or_tree, tree, *reactions), (expected, expected, *expected_reactions), strict=True
    ):
        assert relative_difference(one, other) < 1e-10


def test_a_chain_of_hinge_ball_and_guide_moves_and_reacts_as_by_euler_lagrange():
    rng = np.random.default_rng(3)
    joints = {
        "arm": jb.Hinge("base", axis=rng.normal(size=3), at=rng.normal(size=3)),
        "knee": jb.Ball("arm", at=rng.normal(size=3)),
        "slider": jb.Guide("knee", axis=rng.normal(size=3)),
    }
    assert_moves_as_by_euler_lagrange(
        tree_model(rng, joints, bushing=False), (shaking(rng), shaking(rng)), rng
    )


@pytest.mark.long
def test_every_joint_on_a_support_and_on_a_body_moves_and_reacts_as_by_euler_lagrange():
    rng = np.random.default_rng(4)
    on_supports = {
        "arm": jb.Hinge("base", axis=rng.normal(size=3), at=rng.normal(size=3)),
        "bob": jb.Ball("base", at=rng.normal(size=3)),
        "slider": jb.Guide("stand", axis=rng.normal(size=3)),
        "raft": jb.Free("stand"),
        "car": jb.joints.HeavePitchRoll("base"),
    }
    on_bodies = {
        "flap": jb.Hinge("raft", axis=rng.normal(size=3), at=rng.normal(size=3)),
        "knee": jb.Ball("arm", at=rng.normal(size=3)),
        "piston": jb.Guide("bob", axis=rng.normal(size=3)),
        "dinghy": jb.Free("slider"),
        "wheel": jb.Hinge("car", axis=rng.normal(size=3), at=rng.normal(size=3)),
        "tool": jb.joints.Composite(
            "knee", STEPS, directions=rng.normal(size=(4, 3)), points=rng.normal(size=(4, 3))
        ),
    }
    tree = tree_model(rng, on_supports | on_bodies, bushing=True)
    motions = (shaking(rng), shaking(rng))
    assert isinstance(dynamics_of(tree, motions), JointedBodies)
    assert_moves_as_by_euler_lagrange(tree, motions, rng)


class Varying(jb.Element):
    """An inertance that depends on the length: b |AB|^2."""

    b_of_length: jax.Array

    def deformation(self, A, B):
        return jnp.linalg.norm(B.point(self.b) - A.point(self.a))

    def energy(self, e):
        return jnp.zeros_like(e)

    def dissipation(self, e, e_dot):
        return jnp.zeros_like(e)

    def kinetic_energy(self, e, e_dot):
        return 0.5 * self.b_of_length * e**2 * e_dot**2


def with_inerters(model, *links):
    """The model with an inerter, and an element of one's own with a kinetic energy, between each
    two of these."""
    rng, added = np.random.default_rng(6), {}
    for one, other in links:
        a, b = 0.4 * rng.normal(size=3), 4 * rng.normal(size=3)
        added[f"{one} {other}"] = jb.Inerter((one, a), (other, b), inertance=rng.uniform(1, 4))
        added[f"own {one} {other}"] = Varying(
            (one, other), jnp.array(a), jnp.array(b), jnp.array(rng.uniform(0.05, 0.2))
        )
    layout = model.layout
    return jb.Model(
        bodies={name: model[name] for name in layout.bodies},
        supports={name: model[name] for name in layout.supports},
        joints={name: model.joint(name) for table in model.joints for name in table.names},
        elements={name: model[name] for name in model.element_names} | added,
        gravity=model.gravity,
    )


@pytest.mark.long
@pytest.mark.parametrize("free", [True, False])
def test_elements_with_inertia_act_as_by_euler_lagrange(free):
    rng = np.random.default_rng(7)
    if free:
        model, links = (
            floating_model(rng, *MODELS["two bodies"], damping=3.0),
            [("plate", "base"), ("rotor", "plate")],
        )
    else:
        joints = {
            "arm": jb.Hinge("base", axis=rng.normal(size=3), at=rng.normal(size=3)),
            "knee": jb.Ball("arm", at=rng.normal(size=3)),
            "slider": jb.Guide("knee", axis=rng.normal(size=3)),
        }
        model, links = (
            tree_model(rng, joints, bushing=False),
            [("slider", "stand"), ("knee", "base"), ("arm", "slider")],
        )
    model, motions = (
        with_inerters(model, *links),
        tuple(shaking(rng) for _ in model.layout.supports),
    )
    assert isinstance(dynamics_of(model, motions), JointedBodies)
    assert_moves_as_by_euler_lagrange(model, motions, rng)


@pytest.mark.parametrize("inerters", [pytest.param(False, marks=pytest.mark.long), True])
def test_matrices_are_the_hessians_that_define_them(inerters):
    rng = np.random.default_rng(5)
    joints = {
        "raft": jb.Free("base"),
        "arm": jb.Hinge("raft", axis=rng.normal(size=3)),
        "knee": jb.Ball("arm"),
        "lump": jb.Fixed("knee"),
        "slider": jb.Guide("stand", axis=rng.normal(size=3)),
        "car": jb.joints.HeavePitchRoll("arm"),
        "wheel": jb.Hinge("car", axis=rng.normal(size=3), at=rng.normal(size=3)),
        "half": jb.joints.HeavePitch("wheel"),
        "block": jb.Translation("half"),
        "tool": jb.joints.Composite(
            "lump", STEPS, directions=rng.normal(size=(4, 3)), points=rng.normal(size=(4, 3))
        ),
    }
    tree = tree_model(rng, joints, bushing=False)
    if inerters:
        tree = with_inerters(
            tree, ("raft", "base"), ("tool", "stand"), ("wheel", "tool"), ("car", "world")
        )
    x, x_dot = random_coordinates(tree, rng, 10)
    states = states_of(tree, x, x_dot)
    n, nxi = tree.layout.nv, tree.layout.nxi

    @jit_once
    @jax.vmap
    def definition(state):
        def kinetic(s):
            return jb.kinetic_energy(tree, jb.State(state.q, s[:n]), xi_dot=s[n:].reshape(2, 6))

        def rayleigh(s):
            return jb.dissipation(tree, jb.State(state.q, s[:n]), xi_dot=s[n:].reshape(2, 6))

        def potential(d):
            return jb.potential_energy(
                tree,
                jb.State(Coordinates(tree).retract(state.q, d[:n]), state.v),
                xi=d[n:].reshape(2, 6),
            )

        speeds, still = jnp.concatenate([state.v, jnp.zeros(nxi)]), jnp.zeros(n + nxi)
        return (
            jax.hessian(kinetic)(speeds),
            jax.hessian(rayleigh)(speeds),
            jax.hessian(potential)(still),
        )

    lin = jit_once(jax.vmap(lambda state: jb.linearize(tree, state)))(states)
    for letter, whole in zip("MCK", definition(states), strict=True):
        for block, expected in (
            ("", whole[:, :n, :n]),
            ("_tilde", -whole[:, :n, n:]),
            ("_bb", whole[:, n:, n:]),
        ):
            assert relative_difference(getattr(lin, letter + block), expected) < 1e-12, (
                letter + block
            )


# Two links in a plane: Spong, Hutchinson and Vidyasagar, Robot Modeling and Control, Wiley 2006,
# section 7.4, planar elbow manipulator


M1, M2, L1, LC1, LC2, I1, I2, G = 1.3, 0.7, 0.9, 0.4, 0.5, 0.11, 0.05, 9.81


def elbow():
    def link(mass, length, moment, **where):
        return jb.Body(mass=mass, inertia=[0.01, moment, moment], com=[length, 0, 0], **where)

    return jb.Model(
        bodies={"upper": link(M1, LC1, I1), "lower": link(M2, LC2, I2, position=[L1, 0, 0])},
        joints={
            "upper": jb.Hinge("world", axis=[0, 0, 1]),
            "lower": jb.Hinge("upper", axis=[0, 0, 2], at=[L1, 0, 0]),
        },
        gravity=[0, -G, 0],
    )


def textbook(q, v):
    """D, C (Christoffel's) and g of the book: C q' with h = -m2 l1 lc2 sin q2."""
    (q1, q2), (v1, v2) = q, v
    d12 = M2 * (LC2**2 + L1 * LC2 * np.cos(q2)) + I2
    d22 = M2 * LC2**2 + I2
    d11 = M1 * LC1**2 + M2 * (L1**2 + LC2**2 + 2 * L1 * LC2 * np.cos(q2)) + I1 + I2
    h = -M2 * L1 * LC2 * np.sin(q2)
    g2 = M2 * LC2 * G * np.cos(q1 + q2)
    return (
        np.array([[d11, d12], [d12, d22]]),
        np.array([[h * v2, h * v2 + h * v1], [-h * v1, 0]]),
        np.array([(M1 * LC1 + M2 * L1) * G * np.cos(q1) + g2, g2]),
    )


@pytest.mark.long
def test_double_pendulum_of_hinges_has_the_matrices_of_the_textbook():
    model, rng = elbow(), np.random.default_rng(6)
    q, v = rng.uniform(-3, 3, (2, SAMPLES, 2))

    @jit_once
    @jax.vmap
    def result(q, v):
        def mass(q):
            return jb.linearize(model, jb.State(q, v)).M

        slopes = jax.jacfwd(mass)(q)  # dM_ij/dq_k
        christoffel = (slopes + jnp.swapaxes(slopes, 1, 2) - jnp.transpose(slopes, (2, 1, 0))) / 2
        gravity = jax.grad(lambda q: jb.potential_energy(model, jb.State(q, v)))(q)
        return mass(q), christoffel @ v, gravity, acceleration(model, jb.State(q, v))

    M, C, g, v_dot = result(jnp.array(q), jnp.array(v))
    for i in range(SAMPLES):
        expected = textbook(q[i], v[i])
        for one, other in zip((M[i], C[i], g[i]), expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())
        force = expected[1] @ v[i] + expected[2]
        np.testing.assert_allclose(
            expected[0] @ v_dot[i] + force, 0, atol=1e-12 * np.abs(force).max()
        )
