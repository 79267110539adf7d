"""Forces of elements are derivatives of their energies, are in balance over all frames, and stay
finite at zero length."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

import jaxbody as jb
from jaxbody import laws
from jaxbody.geometry import rotations, vectors
from jaxbody.geometry.frames import Frame, Pose, Wrench
from jaxbody.mechanics.closed_loops import dynamics_of
from jaxbody.model.elements.second_derivatives import second_order
from jaxbody.model.joints.frame_tables import frames_of, wrenches

RNG = np.random.default_rng(42)
N = 200
AXIS = np.array([2.0, -1.0, 2.0]) / 3
ROOT = RNG.normal(size=(6, 6))
STIFFNESS, DAMPING = ROOT @ ROOT.T + np.eye(6), ROOT.T @ ROOT
HARDENING, STOP = (
    laws.Polynomial([120.0, 5.0, 30.0]),
    laws.BumpStop(gap=0.3, stiffness=900.0, engagement=0.2),
)
TABLE = laws.Tabulated(
    [-2.0, -1.0, -0.2, 0.0, 0.5, 2.0, 4.0], [-300.0, -100.0, -30.0, 0.0, 40.0, 90.0, 400.0]
)
GAS = laws.AirSpring.carrying(500.0, area=0.01, height=10.0)
ENDS = ("one", [0.3, -0.2, 0.5]), ("other", [-0.4, 0.1, 0.2])
TURNED = {
    name: Rotation.random(rng=RNG).as_quat(scalar_first=True)
    for name in ("orientation", "orientation_b")
}


def matrix(quaternion):
    return Rotation.from_quat(np.asarray(quaternion), scalar_first=True).as_matrix()


ELEMENTS = {
    "spring": jb.Spring(*ENDS, stiffness=120.0, free_length=0.7, damping=3.0),
    "spring without free length": jb.Spring(*ENDS, stiffness=120.0, damping=3.0),
    "bushing": jb.Bushing(*ENDS, stiffness=STIFFNESS, damping=DAMPING, **TURNED),
    "bushing of three numbers": jb.Bushing(
        *ENDS, stiffness=[10, 20, 30], damping=[1, 2, 3], **TURNED
    ),
    "strut with a bump stop": jb.SpringDamper(
        *ENDS, free_length=1.5, spring=HARDENING + STOP, damper=laws.TwoSided(bump=2.0, rebound=5.0)
    ),
    "strut of measured curves": jb.SpringDamper(
        *ENDS, free_length=1.5, spring=TABLE, damper=laws.Digressive(slow=5.0, fast=1.0, knee=0.7)
    ),
    "air spring with a function": jb.SpringDamper(
        *ENDS, free_length=9.0, spring=GAS, damper=jnp.sinh
    ),
    "strut without free length": jb.SpringDamper(*ENDS, spring=HARDENING),
    "torsion spring": jb.Torsion(
        *ENDS, axis=[1, 2, -1], spring=HARDENING, damper=2.0, free_angle=0.3, **TURNED
    ),
    "tyre": jb.Tyre(*ENDS, stiffness=300.0, damping=20.0, radius=2.0, engagement=0.5),
    "contact": jb.Contact(*ENDS, stiffness=300.0, damping=20.0, distance=3.0, engagement=0.5),
    "anti-roll bar": jb.AntiRollBar(*ENDS, "third", axis=[0, 1, 2], spring=HARDENING, damper=4.0),
}


PIECEWISE = ("strut with a bump stop", "strut of measured curves", "tyre", "contact")


def some_frames():
    """Random pairs of moving frames, for bushings turned by up to 2.8 rad, as derivatives lose
    digits at half a turn."""
    R_A = Rotation.random(N, rng=RNG).as_matrix()
    one, other = (matrix(q) for q in TURNED.values())
    phi = RNG.normal(size=(N, 3))
    phi *= 2.8 * RNG.uniform(size=(N, 1)) / np.linalg.norm(phi, axis=1, keepdims=True)
    R_B = R_A @ one @ Rotation.from_rotvec(phi).as_matrix() @ other.T
    R_C = Rotation.random(N, rng=RNG).as_matrix()
    return (
        Frame(*map(jnp.asarray, (p, R, v, w)))
        for R, (p, v, w) in ((R, RNG.normal(size=(3, N, 3))) for R in (R_A, R_B, R_C))
    )


A, B, C = some_frames()


class Acting(eqx.Module):
    """Deformations, energies and forces of an element between many pairs of frames."""

    V: jax.Array
    V_dot: jax.Array
    R: jax.Array
    lost: jax.Array
    e: jax.Array
    e_dot: jax.Array
    force: jax.Array
    on: tuple[Wrench, ...]
    by_definition: tuple[Wrench, ...]
    K: jax.Array
    K_by_definition: jax.Array

    @property
    def on_A(self):
        return self.on[0]

    @property
    def on_B(self):
        return self.on[1]


@eqx.filter_jit
def compute(element, *frames):
    def one(*frames):
        e, e_dot = element.rates(*frames)
        V, V_dot = jax.jvp(
            element.potential, tuple(f.pose() for f in frames), tuple(f.rates() for f in frames)
        )
        R, R_slope = jax.value_and_grad(element.dissipation, argnums=1)(e, e_dot)
        force = jax.grad(element.energy)(e) + R_slope

        class ByDefinition(type(element)):
            """Forces from the energies alone."""

            def force(self, *frames):
                return force

        plain = object.__new__(ByDefinition)
        for name in element.__dataclass_fields__:
            object.__setattr__(plain, name, getattr(element, name))
        n = len(frames)

        def displaced(x):
            return element.potential(
                *(f.pose().displaced(part) for f, part in zip(frames, jnp.split(x, n), strict=True))
            )

        _, blocks = second_order(element, *frames)
        K = jnp.block(
            [
                [blocks[i, j].whole() if i <= j else blocks[j, i].T.whole() for j in range(n)]
                for i in range(n)
            ]
        )
        return Acting(
            V,
            V_dot,
            R,
            jnp.sum(R_slope * e_dot),
            e,
            e_dot,
            element.force(*frames),
            element.wrenches(*frames),
            jb.Element.wrenches(plain, *frames),
            K,
            jax.hessian(displaced)(jnp.zeros(6 * n)),
        )

    return jax.vmap(one)(*frames)


def acting(element, *frames):
    return jax.tree.map(np.asarray, compute(element, *frames))


SLOW = ("bushing of three numbers", "strut of measured curves")


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=[pytest.mark.long] * (name in SLOW)) for name in ELEMENTS],
)
def case(request):
    return acting(ELEMENTS[request.param], *(A, B, C)[: len(ELEMENTS[request.param].between)])


def power(wrench, frame):
    return np.sum(wrench[0] * frame.v, -1) + np.sum(wrench[1] * frame.w, -1)


def largest(x):
    return np.abs(x).max()


def test_the_wrenches_are_those_of_the_definition(case):
    """Minus the derivatives of V and R, carried from the deformation to the frames."""
    for x, y in zip(jax.tree.leaves(case.on), jax.tree.leaves(case.by_definition), strict=True):
        assert largest(x - y) <= 1e-13 * max(largest(y), largest(case.force))


def test_second_derivatives_are_those_of_the_energy_in_the_chart(case):
    assert largest(case.K - case.K_by_definition) <= 1e-12 * largest(case.K_by_definition)


def test_the_wrenches_at_all_ends_balance(case):
    """Total force and total moment about one point vanish."""
    forces, moments = zip(*case.on, strict=True)
    about = [np.cross(frame.p, F) for frame, F in zip((A, B, C), forces, strict=False)]
    assert largest(sum(forces)) <= 1e-13 * max(largest(forces[0]), 1e-300)
    assert largest(sum(moments) + sum(about)) <= 2e-13 * max(largest(about[0]), largest(moments[0]))


def test_the_power_of_an_element_is_minus_the_rates_of_stored_and_dissipated_energy(case):
    done = sum(power(wrench, frame) for wrench, frame in zip(case.on, (A, B, C), strict=False))
    assert (case.lost >= 0).all() and (case.R >= 0).all()
    assert largest(done + case.V_dot + case.lost) <= 1e-13 * largest(done)


def test_a_spring_pulls_along_its_line_with_its_tension():
    """tension = k (|AB| - l0) + c d|AB|/dt, on A towards B; (20), (21) of the paper."""
    result = acting(ELEMENTS["spring"], A, B)
    r_A, r_B = np.einsum("nij,j->ni", A.R, ENDS[0][1]), np.einsum("nij,j->ni", B.R, ENDS[1][1])
    d = B.p + r_B - A.p - r_A
    d_dot = B.v + np.cross(B.w, r_B) - A.v - np.cross(A.w, r_A)
    L = np.linalg.norm(d, axis=1)
    u = d / L[:, None]
    L_dot = np.sum(u * d_dot, 1)
    tension = 120.0 * (L - 0.7) + 3.0 * L_dot
    pull = tension[:, None] * u
    pairs = [
        (result.e, L - 0.7),
        (result.e_dot, L_dot),
        (result.V, 60 * (L - 0.7) ** 2),
        (result.R, 1.5 * L_dot**2),
        (result.force, tension),
    ]
    for x, exact in [
        *pairs,
        (result.on_A[0], pull),
        (result.on_A[1], np.cross(r_A, pull)),
        (result.on_B[1], -np.cross(r_B, pull)),
    ]:
        assert largest(x - exact) <= 1e-14 * largest(exact)


@pytest.mark.parametrize(
    ("length", "sign"), [(0.75, 0), (1.0, 1), (0.5, -1)], ids=["rest", "longer", "shorter"]
)
@pytest.mark.parametrize("kind", ["spring", "bushing"])
def test_tension_is_positive(length, sign, kind):
    """An extended element pulls its ends together; a compressed one pushes them apart."""
    kinds = {
        "spring": jb.Spring(
            ("one", [0, 0, 0]), ("other", [0, 0, 0]), stiffness=100.0, free_length=0.75
        ),
        "bushing": jb.Bushing(
            ("one", [0.75, 0, 0]), ("other", [0, 0, 0]), stiffness=[100.0, 100.0, 100.0]
        ),
    }
    still, x = jnp.zeros((N, 3)), jnp.tile(jnp.array([1.0, 0, 0]), (N, 1))
    one, other = (
        Frame(length * p, jnp.tile(jnp.eye(3), (N, 1, 1)), still, still) for p in (still, x)
    )
    result = acting(kinds[kind], one, other)
    assert largest(result.on_A[0] - 25.0 * sign * x) <= 1e-14
    assert largest(result.on_B[0] + 25.0 * sign * x) <= 1e-14
    assert largest(result.force.reshape(N, -1)[:, 0] - 25.0 * sign) <= 1e-14
    assert largest(result.V - 3.125 * sign**2) <= 1e-15


def test_a_torsion_spring_feels_the_twist_about_its_axis():
    """2 atan2(v . n, w) of SciPy's quaternion of the turn, less the free angle; its moment -F n on
    B for a turn about n alone."""
    one, other = (matrix(q) for q in TURNED.values())
    n = np.array([1.0, 2, -1]) / np.sqrt(6)
    q = Rotation.from_matrix(np.swapaxes(A.R @ one, 1, 2) @ B.R @ other).as_quat()
    angle = 2 * np.arctan2(q[:, :3] @ n, q[:, 3])
    twist = (angle + np.pi) % (2 * np.pi) - np.pi
    assert largest(acting(ELEMENTS["torsion spring"], A, B).e - (twist - 0.3)) <= 1e-12
    spring = jb.Torsion("one", "other", axis=n, spring=30.0, damper=2.0)
    still, turned = (
        jnp.zeros((N, 3)),
        jnp.asarray(Rotation.from_rotvec(np.linspace(-3, 3, N)[:, None] * n).as_matrix()),
    )
    frames = (
        Frame(still, jnp.tile(jnp.eye(3), (N, 1, 1)), still, still),
        Frame(still, turned, still, jnp.tile(5.0 * n, (N, 1))),
    )
    result = acting(spring, *frames)
    moment = 30 * np.linspace(-3, 3, N) + 2 * 5.0
    assert largest(result.on_B[1] + moment[:, None] * n) <= 1e-12 * largest(moment)
    assert largest(result.on_A[1] - moment[:, None] * n) <= 1e-12 * largest(moment)


def test_an_anti_roll_bar_feels_the_difference_of_travel_along_the_bodys_axis():
    result = acting(ELEMENTS["anti-roll bar"], A, B, C)
    n = np.einsum("nij,j->ni", C.R, np.array([0, 1, 2]) / np.sqrt(5))
    P, Q = (f.p + np.einsum("nij,j->ni", f.R, end[1]) for f, end in zip((A, B), ENDS, strict=True))
    e = np.sum(n * (P - Q), 1)
    assert largest(result.e - e) <= 1e-14 * largest(e)
    force = 120 * e + 5 * e**2 + 30 * e**3 + 4 * result.e_dot
    assert largest(result.on_A[0] + force[:, None] * n) <= 1e-12 * largest(force)
    assert largest(result.on[2][0]) <= 1e-12 * largest(force)  # only a moment on the body


@pytest.mark.parametrize("name", ["tyre", "contact"])
def test_touching_is_smooth_where_it_begins_and_never_pulls(name):
    """Finite second derivatives at e = 0 and at full engagement, at rest and in motion; total
    force <= 0 (in tension) at any speed. The force of the damper, which is stated, is dR/de_dot."""
    element = ELEMENTS[name]
    e, v = (
        x.ravel()
        for x in jnp.meshgrid(
            jnp.array([-1.0, -0.5, -0.2, -1e-9, 0.0, 1e-9, 0.4]),
            jnp.array([-50.0, -1.0, 0.0, 1.0, 50.0]),
        )
    )

    @jax.jit
    @jax.vmap
    def at(e, v):
        damping = jax.grad(element.dissipation, 1)(e, v)
        second = jax.hessian(element.energy)(e), jax.hessian(element.dissipation, (0, 1))(e, v)
        return (
            jax.grad(element.energy)(e) + damping,
            second,
            element.damping_force(e, v) * v,
            element.damping_force(e, v) - damping,
        )

    total, second, lost, difference = at(e, v)
    assert largest(difference) <= 1e-14 * largest(total)
    assert (
        (total <= 1e-14 * largest(total)).all()
        and (total[e >= 0] == 0).all()
        and (total[(e < -0.1) & (v <= 0)] < 0).all()
    )
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(second)) and (lost >= 0).all()


def test_the_deformation_of_a_bushing_is_the_logarithm_of_the_relative_pose():
    """e = log(X_A^-1 X_B), turned by at most half a turn: SciPy's exponential of the 4 x 4 matrix
    of e leads from X_A to X_B."""

    def transform(p, R):
        return np.block([[R, np.reshape(p, (3, 1))], [np.zeros((1, 3)), 1]])

    places = [transform(end[1], matrix(q)) for end, q in zip(ENDS, TURNED.values(), strict=True)]
    e = acting(ELEMENTS["bushing"], A, B).e
    assert np.linalg.norm(e[:, 3:], axis=1).max() <= np.pi
    for i in range(N):
        X_A, X_B = (
            transform(frame.p[i], frame.R[i]) @ place
            for frame, place in zip((A, B), places, strict=True)
        )
        x, y, z = e[i, 3:]
        generator = np.block(
            [[np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), e[i, :3, None]], [np.zeros((1, 4))]]
        )
        assert largest(X_A @ scipy.linalg.expm(generator) - X_B) <= 1e-13


@pytest.mark.parametrize("short_of", [1.0, 0.1, 0.01])
def test_a_bushing_is_exact_next_to_half_a_turn(short_of):
    """V = k theta^2 / 2 about any axis, to round-off over what is missing to half a turn, where the
    deformation jumps."""
    twist = jb.Bushing(
        ("one", [0, 0, 0]), ("other", [0, 0, 0]), stiffness=np.diag([1.0, 1, 1, 4, 4, 4])
    )
    turns = np.resize(
        (np.pi - short_of) * np.concatenate([np.eye(3), [AXIS, -AXIS, [0.6, 0.8, 0]]]), (N, 3)
    )
    still = jnp.zeros((N, 3))
    one, other = (
        Frame(still, jnp.asarray(Rotation.from_rotvec(turn).as_matrix()), still, still)
        for turn in (0 * turns, turns)
    )
    result = acting(twist, one, other)
    assert largest(result.e[:, 3:] - turns) <= 2e-15 / short_of
    assert largest(result.V - 2 * (np.pi - short_of) ** 2) <= 2e-14 / short_of


def test_exchanging_the_ends_of_a_bushing_changes_only_the_sign_of_its_deformation():
    ends = {"orientation": TURNED["orientation_b"], "orientation_b": TURNED["orientation"]}
    points = ("one", ENDS[1][1]), ("other", ENDS[0][1])
    there, back = (
        acting(ELEMENTS["bushing"], A, B),
        acting(jb.Bushing(*points, stiffness=STIFFNESS, damping=DAMPING, **ends), B, A),
    )
    for name in ("V", "V_dot", "R"):
        assert largest(getattr(there, name) - getattr(back, name)) <= 1e-13 * largest(
            getattr(there, name)
        )
    for name in ("e", "e_dot", "force"):
        assert largest(getattr(there, name) + getattr(back, name)) <= 1e-13 * largest(
            getattr(there, name)
        )
    for x, y in zip((*there.on_A, *there.on_B), (*back.on_B, *back.on_A), strict=True):
        assert largest(x - y) <= 1e-13 * largest(x)


def test_three_numbers_of_a_bushing_are_the_diagonal_of_its_matrices():
    diagonal = jb.Bushing(
        *ENDS,
        stiffness=np.diag([10, 20, 30, 0, 0, 0]),
        damping=np.diag([1, 2, 3, 0, 0, 0]),
        **TURNED,
    )
    result, exact = acting(ELEMENTS["bushing of three numbers"], A, B), acting(diagonal, A, B)
    for x, y in zip(jax.tree.leaves(result), jax.tree.leaves(exact), strict=True):
        assert largest(x - y) <= 1e-14 * largest(y)


@pytest.mark.parametrize("name", [name for name in ELEMENTS if name not in PIECEWISE])
def test_no_work_is_done_around_a_closed_path(rng, name):
    """Both ends are carried around loops of SE(3), their velocities taken as zero in the forces:
    |work| <= 1e-10 of the largest energy. Bushings start relaxed, so that they stay short of half a
    turn, where the logarithm jumps. Laws of pieces are left out: the sum over the path converges
    fast for smooth forces only, and the balance of power above holds for all."""
    s = np.linspace(0, 2 * np.pi, N, endpoint=False)
    waves, slopes = (
        np.stack([np.cos(s), np.sin(s), np.cos(2 * s)], 1),
        np.stack([-np.sin(s), np.cos(s), -2 * np.sin(2 * s)], 1),
    )

    def path(origin, R, sizes):
        chart, rate = waves @ sizes, slopes @ sizes
        pose = Pose(jnp.tile(jnp.array(origin), (N, 1)), jnp.tile(R, (N, 1, 1))).displaced(chart)
        still, w = (
            jnp.zeros((N, 3)),
            vectors.rotate(rotations.left_jacobian(chart[:, 3:]), rate[:, 3:]),
        )
        return Frame(pose.p, pose.R, still, still), Frame(pose.p, pose.R, rate[:, :3], w)

    one, other = (matrix(q) for q in TURNED.values())
    A, A_moving = path([0.0, 0, 0], jnp.eye(3), 0.2 * rng.normal(size=(3, 6)))
    B, B_moving = path([0.5, 1.0, 2.0], one @ other.T, 0.2 * rng.normal(size=(3, 6)))
    C, C_moving = path([0.0, 0, 0], jnp.eye(3), 0.2 * rng.normal(size=(3, 6)))
    frames, moving = (
        ((A, B, C), (A_moving, B_moving, C_moving))
        if name == "anti-roll bar"
        else ((A, B), (A_moving, B_moving))
    )
    result = acting(ELEMENTS[name], *frames)
    work = (
        np.mean(sum(power(wrench, frame) for wrench, frame in zip(result.on, moving, strict=True)))
        * 2
        * np.pi
    )
    assert np.ptp(result.V) > 1
    assert abs(work) <= 1e-10 * result.V.max()


FREE_BASE = {"position": [0.2, -0.3, 0.1], "orientation": TURNED["orientation"]}
MODEL = jb.Model(
    bodies={
        "box": jb.Body(
            mass=2.0,
            inertia=[0.1, 0.2, 0.25],
            com=[0.1, -0.05, 0.2],
            position=[0.5, 0.7, 0.2],
            orientation=TURNED["orientation_b"],
        ),
        "ball": jb.Body(
            mass=1.0, inertia=[0.1, 0.1, 0.1], com=[0.0, 0.1, 0.0], position=[-0.6, 0.4, 0.9]
        ),
    },
    supports={"base": jb.Support(**FREE_BASE)},
    elements={
        "s1": jb.Spring(
            ("box", [0.2, 0.1, 0]),
            ("base", [0.5, 1, 0]),
            stiffness=100.0,
            free_length=0.5,
            damping=2.0,
        ),
        "s2": jb.Spring(
            ("box", [-0.2, 0.1, 0.3]), ("ball", [0.1, 0, 0]), stiffness=70.0, damping=1.5
        ),
        "s3": jb.Spring(
            ("base", [-1, 0.1, 0.3]),
            ("ball", [0.1, 0.2, 0]),
            stiffness=50.0,
            free_length=1.2,
            damping=0.5,
        ),
        "b1": jb.Bushing(
            ("ball", [0.1, 0.2, 0]),
            ("base", [0.3, 0, 0.1]),
            stiffness=STIFFNESS,
            damping=DAMPING,
            **TURNED,
        ),
    },
    gravity=[0.3, -0.5, -9.7],
)


def displaced(model, delta):
    """The reference state of free bodies displaced by Delta, six numbers each."""
    q = model.reference.q.reshape(-1, 7)
    delta = delta.reshape(-1, 6)
    turned = rotations.multiply(rotations.exp_quaternion(delta[:, 3:]), q[:, 3:])
    return jb.State(
        jnp.concatenate([q[:, :3] + delta[:, :3], turned], 1).ravel(), jnp.zeros(delta.size)
    )


@jax.jit
def everything(model, delta, v, xi, xi_dot):
    """V, R, their gradients in (Delta, Xi) and (v, Xi'), and the wrenches on all frames."""

    def V(delta, xi):
        return jb.potential_energy(model, displaced(model, delta), xi=xi)

    def R(v, xi_dot):
        return jb.dissipation(model, jb.State(displaced(model, delta).q, v), xi=xi, xi_dot=xi_dot)

    frames = frames_of(model, jb.State(displaced(model, delta).q, v), xi, xi_dot)
    return (
        *jax.value_and_grad(V, (0, 1))(delta, xi),
        *jax.value_and_grad(R, (0, 1))(v, xi_dot),
        wrenches(model, frames),
    )


NOWHERE, STILL = (jnp.zeros(12), jnp.zeros((1, 6))), (jnp.zeros(12), jnp.zeros((1, 6)))


def test_forces_are_minus_the_gradients_of_the_energies_of_the_model(rng):
    """On the bodies -dV/dDelta - dR/dv, gravity at the centers of mass among them, and on the
    supports -dV/dXi - dR/dXi'."""
    v, xi_dot = jnp.asarray(rng.normal(size=12)), jnp.asarray(rng.normal(size=(1, 6)))
    _, dV, _, dR, (F, M) = everything(MODEL, NOWHERE[0], v, NOWHERE[1], xi_dot)
    on_bodies, on_base = (-np.asarray(x + y).reshape(-1, 6) for x, y in zip(dV, dR, strict=True))
    result = np.concatenate([F, M], 1)  # rows world, base, bodies
    assert largest(
        result - np.concatenate([np.zeros((1, 6)), on_base, on_bodies])
    ) <= 1e-13 * largest(result)


@pytest.mark.long
def test_a_rigid_motion_of_base_and_bodies_together_changes_no_elastic_energy(rng):
    weightless = eqx.tree_at(lambda model: model.gravity, MODEL, jnp.zeros(3))
    before = everything(weightless, NOWHERE[0], STILL[0], NOWHERE[1], STILL[1])[0]
    for _ in range(5):
        shift, turn = 10 * rng.normal(size=3), rng.normal(size=3)
        R = Rotation.from_rotvec(turn).as_matrix()
        arms = [MODEL[name].position - MODEL["base"].position for name in MODEL.layout.bodies]
        delta = jnp.concatenate(
            [jnp.array([*(shift + (R - np.eye(3)) @ arm), *turn]) for arm in arms]
        )
        xi = jnp.array([[*shift, *turn]])
        assert (
            abs(everything(weightless, delta, STILL[0], xi, STILL[1])[0] - before) <= 1e-13 * before
        )
        assert everything(weightless, delta, STILL[0], 0 * xi, STILL[1])[0] > 1.1 * before


def test_a_rigid_velocity_of_base_and_bodies_together_dissipates_nothing(rng):
    v, w = rng.normal(size=(2, 3))
    arms = [MODEL[name].position - MODEL["base"].position for name in MODEL.layout.bodies]
    together = jnp.concatenate([jnp.array([*(v + np.cross(w, arm)), *w]) for arm in arms])
    dissipation = [
        everything(MODEL, NOWHERE[0], together, NOWHERE[1], xi_dot)[2]
        for xi_dot in (STILL[1], jnp.array([[*v, *w]]))
    ]
    assert dissipation[1] <= 1e-28 * dissipation[0] and dissipation[0] > 1


def test_a_damper_to_a_moving_base_feels_its_velocity():
    """A body at rest, a base that translates and rotates: tension = c times the rate of
    the length."""
    at, point, c, m = np.array([0.3, 0.1, -0.2]), np.array([0.4, -0.5, 0.6]), 3.0, 2.0
    model = jb.Model(
        bodies={"body": jb.Body(mass=m, inertia=[1, 1, 1], position=[1.0, 2.0, 0.5])},
        supports={"base": jb.Support(position=at)},
        elements={
            "damper": jb.Spring(
                ("body", [0, 0, 0]), ("base", point), stiffness=0.0, free_length=1.0, damping=c
            )
        },
    )
    velocity, spin = np.array([0.5, -0.7, 0.2]), np.array([1.0, 2.0, -0.4])
    d = at + point - [1.0, 2.0, 0.5]
    u = d / np.linalg.norm(d)
    rate = u @ (velocity + np.cross(spin, point))

    @jax.jit
    def felt(velocity, spin):
        """Dissipation, and the accelerations of the body, whose axes are those of the world."""
        sine = {
            "frequency": 1 / (2 * np.pi),
            "translation_phase": -np.pi / 2,
            "rotation_phase": -np.pi / 2,
        }
        dynamics = dynamics_of(model, (jb.Harmonic(translation=velocity, rotation=spin, **sine),))
        R = jb.dissipation(model, model.reference, xi_dot=jnp.concatenate([velocity, spin])[None])
        return R, dynamics.rate(jnp.array(0.0), dynamics.pack(model.reference))[7:]

    R, moved = felt(velocity, spin)
    assert abs(rate) > 0.5
    assert abs(R - 0.5 * c * rate**2) <= 4e-15
    assert largest(moved[:3] - c * rate * u / m) <= 4e-15
    assert largest(felt(0 * velocity, 0 * spin)[1]) <= 1e-16


# the square underflows, then its cube
LENGTHS = [0.0, 1e-300, 1e-200, 1e-160, 1e-150, 1e-120, 1e-100, 1e-50, 1e-20, 1e-8, 1e-3]
ALONG = jnp.array([0.6, 0, -0.8, 0, 0, 0])


def short(at=(0, 0, 0), stiffness=50.0, free_length=0.0):
    """One body on a spring of zero length, at the body's origin or away from it."""
    spring = jb.Spring(
        ("body", at), ("world", [0, 0, 0]), stiffness=stiffness, free_length=free_length
    )
    return jb.Model(
        bodies={
            "body": jb.Body(mass=1.0, inertia=[1, 1, 1], position=-np.asarray(at, dtype=float))
        },
        elements={"s": spring},
    )


def energy(model, x, l0):
    """Potential energy at a displacement, for a free length."""
    changed = eqx.tree_at(lambda model: model.elements[0].rows.free_length, model, l0[None])
    return jb.potential_energy(changed, displaced(changed, x))


@jax.jit
def with_derivatives(model, x):
    """Potential energy, and its first derivatives in displacement and free length: forward,
    reverse, and second ones."""
    at = x, jnp.array(0.0)
    forward, reverse = (
        kind(lambda *at: energy(model, *at), (0, 1)) for kind in (jax.jacfwd, jax.jacrev)
    )
    second, first = jax.jacfwd(lambda *at: (reverse(*at),) * 2, (0, 1), has_aux=True)(*at)
    return energy(model, *at), forward(*at), first, second


@pytest.mark.long
@pytest.mark.parametrize("length", LENGTHS)
def test_a_spring_without_free_length_is_exact_down_to_zero_length(length):
    """V = k (|d| - l0)^2 / 2 at l0 = 0: gradient k d, Hessian k I, dV/dl0 = -k |d|, d2V/dl0^2 = k;
    forward and reverse, nothing is NaN."""
    V, *gradients, ((dxx, _), (_, dll)) = with_derivatives(short(), ALONG * length)
    assert abs(V - 25 * length**2) <= 1e-15 * 25 * length**2
    for in_x, in_l0 in gradients:
        assert largest(in_x - 50 * ALONG * length) <= 1e-15 * 50 * length
        assert abs(in_l0 + 50 * length) <= 1e-13 * length + 1e-38
    assert largest(dxx - np.diag([50, 50, 50, 0, 0, 0])) <= 1e-13
    assert abs(dll - 50) <= 1e-13


@pytest.mark.long
def test_a_spring_of_zero_length_beside_the_origin_has_the_stiffness_of_its_point():
    """K = k J'J with J = [I, -[r]]; no geometric part, as nothing is loaded."""
    r = np.array([0.3, -0.4, 0.5])
    model = short(at=r)
    K = with_derivatives(model, 0 * ALONG)[3][0][0]
    J = np.hstack([np.eye(3), -np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])])
    assert largest(K - 50 * J.T @ J) <= 1e-13


@pytest.mark.long
@pytest.mark.parametrize("name", ["stiffness", "free_length"])
def test_a_model_with_a_spring_of_zero_length_can_be_built_while_it_is_traced(name):
    """As in a gradient or a sweep of its stiffness or free length: the length is checked only where
    it is not traced."""
    value, slope = jax.jit(
        jax.value_and_grad(
            lambda x: jb.potential_energy(model := short(**{name: x}), model.reference)
        )
    )(0.0)
    assert (value, slope) == (0.0, 0.0)


def inclined(kind, turn, body=(1, 0, 0, 0)):
    """A machine of 85 kg that moves along z on four mounts of 60 and 90 N/mm that are turned by
    this angle about y; the machine may be drawn turned, too."""
    a, b = ("machine", [0, 0, 0]), ("floor", [0, 0, 0])
    rigid = {
        "bushing": lambda **at: jb.Bushing(a, b, stiffness=[60e3, 60e3, 90e3], **at),
        "mount": lambda **at: jb.Mount(a, b, x=60e3, y=60e3, z=90e3, rx=1e3, ry=1e3, rz=1e3, **at),
    }[kind]
    along = Rotation.from_quat(body, scalar_first=True).inv() * Rotation.from_euler("y", turn)
    return jb.Model(
        bodies={"machine": jb.Body(85.0, [2.1, 3.2, 2.9], orientation=body)},
        supports={"floor": jb.Support()},
        joints={"machine": jb.Guide("floor", axis="z")},
        elements={f"m{i}": rigid(orientation=along.as_quat(scalar_first=True)) for i in range(4)},
    )


@pytest.mark.parametrize("body", [(1, 0, 0, 0), (0.8, 0.0, 0.6, 0.0), (0.5, -0.5, 0.5, 0.5)])
@pytest.mark.parametrize("kind", ["bushing", "mount"])
def test_the_second_frame_of_a_mount_coincides_with_the_first_as_drawn(kind, body):
    """k_z = k_x sin^2 a + k_z cos^2 a of an inclined mount, which is relaxed as drawn; with the
    second frame left in the axes of its support it would be twisted by a and act at a/2."""
    model = inclined(kind, 0.7, body)
    lin = jb.linearize(model, model.reference)
    np.testing.assert_allclose(
        lin.K, 4 * (60e3 * np.sin(0.7) ** 2 + 90e3 * np.cos(0.7) ** 2), rtol=1e-12
    )
    np.testing.assert_allclose(jb.equilibrium(model).elongations["m0"], np.zeros(6), atol=1e-12)


def test_the_second_frame_follows_traced_numbers():
    """dk/da = (k_x - k_z) sin 2a, of the orientation from which a model is built."""

    def stiffness(turn):
        at = jnp.stack([jnp.cos(turn / 2), jnp.zeros(()), jnp.sin(turn / 2), jnp.zeros(())])
        mount = jb.Bushing(
            ("m", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=[60.0, 60.0, 90.0], orientation=at
        )
        model = jb.Model(
            bodies={"m": jb.Body(1.0, [1, 1, 1])},
            joints={"m": jb.Guide("world", axis="z")},
            elements={"mount": mount},
        )
        return jb.linearize(model, model.reference).K[0, 0]

    np.testing.assert_allclose(jax.grad(stiffness)(0.3), (60 - 90) * np.sin(0.6), rtol=1e-10)
