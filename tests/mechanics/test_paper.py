"""The paper's formulas for small oscillations, and its plate, against derivatives of the
exact energies."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import paper
import pytest

import jaxbody as jb
from jaxbody.geometry import rotations
from jaxbody.model.joints.frame_tables import each_element, frames_of
from jaxbody.model.joints.kinematics import Coordinates

SPRINGS = ("AB", "CD", "EF")
jit_once = jb.jit  # compiling is the cost


# The plate of section 7


def plate(l, m=3.0, g=9.81, kt=120.0):
    """The plate on its three springs, k = m g/l; O is its center of mass."""
    p = paper.plate_points(l)
    k = m * g / l
    length = np.linalg.norm(p["B"] - p["A"])
    s = l * np.sqrt(2) / 2
    return jb.Model(
        bodies={"plate": jb.Body(mass=m, inertia=np.array([0.3, 0.9, 1.2]) * l**2)},
        supports={"base": jb.Support(position=p["O0"])},
        elements={
            "AB": jb.Spring(
                ("plate", p["A"]), ("base", p["B"] - p["O0"]), stiffness=k, free_length=length - s
            ),
            "CD": jb.Spring(
                ("plate", p["C"]), ("base", p["D"] - p["O0"]), stiffness=k, free_length=length - s
            ),
            "EF": jb.Spring(
                ("plate", p["E"]), ("base", p["F"] - p["O0"]), stiffness=kt, free_length=2 * l
            ),
        },
        gravity=[0, -g, 0],
    )


def assert_entries(result, expected, l, unit):
    """Equal to 1e-12, every entry in units of k: lengths in l, rotations as lengths at the
    distance l."""
    scale = np.array([1, 1, 1, 1 / l, 1 / l, 1 / l]) / np.sqrt(unit)
    result, expected = np.asarray(result), np.asarray(expected)
    scale = np.outer(scale, scale) if expected.ndim == 2 else scale
    np.testing.assert_allclose(scale * result, scale * expected, rtol=1e-12, atol=1e-12)


def only(model, name):
    """The model with the stiffness of one spring alone."""
    kept = np.array([1.0 if other == name else 0.0 for other in model.element_names])
    return eqx.tree_at(
        lambda m: m.elements[0].rows.stiffness, model, model.elements[0].rows.stiffness * kept
    )


@jit_once
def end_slopes(model, state):
    """Derivatives of the elongations in Delta and in Xi."""

    def elongations(delta, xi):
        moved = jb.State(Coordinates(model).retract(state.q, delta), state.v)
        return each_element(
            model, frames_of(model, moved, xi), lambda s, *F: s.deformation(*(f.pose() for f in F))
        )[0]

    return jax.jacfwd(elongations, argnums=(0, 1))(jnp.zeros(6), jnp.zeros(6))


@pytest.mark.parametrize("l", [0.02, 0.7, 30.0])
def test_plate_has_the_numbers_of_the_paper(l):
    m, g, kt = 3.0, 9.81, 120.0
    k, s, L = m * g / l, l * np.sqrt(2) / 2, 2 * np.sqrt(2) * l
    model = plate(l)
    eq = jb.equilibrium(model)
    lin = jb.linearize(model, eq)
    assert bool(eq.stable)

    lengths = {name: float(eq.elongations[name] + model[name].free_length) for name in SPRINGS}
    np.testing.assert_allclose(
        [eq.elongations[name] / l for name in SPRINGS], np.array([s, s, 0]) / l, rtol=0, atol=1e-12
    )  # (67)
    np.testing.assert_allclose([lengths["AB"], lengths["CD"]], L, rtol=1e-12)  # (67)
    assert float(eq.elongations["AB"]) / lengths["AB"] == pytest.approx(1 / 4, rel=1e-12)  # (67)

    U, U_tilde = paper.plate_U(l)
    of_body, of_base = end_slopes(model, eq.state)
    K2 = dict(zip(("AB", "CD"), paper.plate_K_tilde_2(k, l), strict=True))
    for i, name in enumerate(SPRINGS):
        assert_entries(-of_body[i] * l, U[name] * l, l, l**2)  # (68), (71), (74)
        assert_entries(of_base[i] * l, U_tilde[name] * l, l, l**2)  # (68), (71), (74)
        alone = jb.linearize(only(model, name), eq.state).K_tilde
        if name == "EF":  # (75), (76): no elongation
            assert_entries(alone, kt * np.outer(U[name], U_tilde[name]), l, kt)
        else:
            first = paper.K_tilde_1(k, s, L, U[name], U_tilde[name])  # (69), (72)
            assert_entries(alone - first, K2[name], l, k)  # (70), (73)

    assert_entries(lin.K_tilde, paper.plate_K_tilde(k, kt, l), l, k)  # (77)
    assert_entries(lin.K, paper.plate_K(k, kt, l), l, k)
    xi0, phi0 = 0.01 * l, 0.02
    xi = np.array([xi0, 0, 0, 0, 0, phi0])  # (78) at t = 0
    assert_entries(
        lin.K_tilde @ xi / (k * l), paper.plate_excitation(k, l, xi0, phi0) / (k * l), l, 1
    )  # (79)


def test_excitation_leaves_K_tilde_xi_with_the_square_of_xi():
    model = plate(0.7)
    eq = jb.equilibrium(model)
    K_tilde = jb.linearize(model, eq).K_tilde
    xi = np.array([0.5, -0.3, 0.4, 0.6, -0.2, 0.7])
    sizes = 10.0 ** -np.arange(2, 6)
    rest = [
        np.linalg.norm(jb.excitation(model, eq, {"base": size * xi}) - K_tilde @ (size * xi))
        for size in sizes
    ]
    slopes = np.diff(np.log(rest)) / np.diff(np.log(sizes))
    assert np.polyfit(np.log(sizes), np.log(rest), 1)[0] == pytest.approx(2, abs=0.02)
    assert slopes[-1] == pytest.approx(2, abs=0.001)


def test_exact_motion_leaves_the_harmonic_solution_in_proportion_to_the_amplitude():
    l, frequency = 0.7, 0.8
    model = plate(l)
    eq = jb.equilibrium(model)
    lin = jb.linearize(model, eq)
    w = 2 * np.pi * frequency
    direction = np.array([0.3 * l, 0, 0, 0, 0, 1.0])
    # D of (66) under (78)
    amplitude = np.linalg.solve(lin.K - w**2 * lin.M, lin.K_tilde @ direction)
    times = jnp.linspace(0, 10 / frequency, 401)
    sizes = np.array([1e-3, 5e-4, 2.5e-4])
    errors = []
    for size in sizes:
        start = jb.State(Coordinates(model).retract(eq.state.q, size * amplitude), jnp.zeros(6))
        motion = jb.Harmonic(
            frequency=frequency, translation=size * direction[:3], rotation=size * direction[3:]
        )
        states = jb.simulate(model, times, motion={"base": motion}, initial=start, rtol=1e-12).state
        turned = jax.vmap(rotations.log_quaternion)(states.q[:, 3:])
        D = np.concatenate([states.q[:, :3] - eq.state.q[:3], turned], 1)
        linear = size * amplitude * np.cos(w * times)[:, None]
        scale = np.array([1, 1, 1, l, l, l])
        errors.append(np.abs((D - linear) * scale).max() / np.abs(linear * scale).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    assert errors[0] < 0.05
    assert (np.abs(ratios - 2) < 0.02).all()  # half the amplitude, half the relative error


# A thousand geometries


N, SIX = 1000, 6


@pytest.fixture(scope="module")
def geometries():
    """Models in equilibrium on six springs, body and base turned, center of mass off O, and what
    the paper's formulas need of them."""
    rng = np.random.default_rng(0)

    def turns(n):
        q = rng.normal(size=(n, 4))
        q /= np.linalg.norm(q, axis=1, keepdims=True)
        w, e = q[:, 0, None, None], q[:, 1:]
        return q, (w * w - np.sum(e * e, -1)[:, None, None]) * np.eye(3) + 2 * paper.outer(
            e, e
        ) + 2 * w * paper.skew(e)

    (q, R), (q0, R0) = turns(N), turns(N)
    O, O0, com = (rng.normal(size=(N, 3)) for _ in range(3))
    a, b = rng.normal(size=(N, SIX, 3)), 3 * rng.normal(size=(N, SIX, 3))
    m = rng.uniform(1, 3, N)
    gravity = 9.81 * turns(N)[1][..., 0]
    J = rng.normal(size=(N, 3, 3))
    J = np.trace(J @ paper.transposed(J), axis1=1, axis2=2)[:, None, None] * np.eye(
        3
    ) - J @ paper.transposed(J)

    r_A, r_B, r_C = (paper.times(x[:, None], y) for x, y in ((R, a), (R0, b), (R, com[:, None])))
    r_C = r_C[:, 0]
    AB = O0[:, None] + r_B - O[:, None] - r_A
    L = np.linalg.norm(AB, axis=-1)
    u = AB / L[..., None]
    U = paper.U_of(u, r_A)
    g = np.linalg.norm(gravity, axis=1)
    u_C = gravity / g[:, None]
    U_C = paper.U_of(u_C, r_C)
    # (63)
    tension = np.linalg.solve(paper.transposed(U), -(m * g)[:, None, None] * U_C[..., None])[..., 0]
    s = np.sign(tension) * L * rng.uniform(0.05, 0.5, (N, SIX))
    k = tension / s

    spring = jb.Spring(("body", [0, 0, 0]), ("base", [0, 1, 0]), stiffness=1.0, free_length=1.0)
    model = jb.Model(
        bodies={"body": jb.Body(mass=1, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        elements={f"s{i}": spring for i in range(SIX)},
    )
    values = {
        "mass": m[:, None],
        "inertia": J[:, None],
        "com": com[:, None],
        "position": O[:, None],
        "orientation": q[:, None],
    }
    leaves = lambda m: (  # noqa: E731
        *(getattr(m.bodies.rows, name) for name in values),
        m.supports.rows.position, m.supports.rows.orientation,
        *(getattr(m.elements[0].rows, name) for name in ("a", "b", "stiffness", "free_length")),
        m.elements[0].rows.damping, m.gravity,
    )  # fmt: skip
    new = (*values.values(), O0[:, None], q0[:, None], a, b, k, L - s, np.zeros((N, SIX)), gravity)
    models = eqx.tree_at(leaves, model, tuple(jnp.asarray(x) for x in new))
    state = jb.State(jnp.concatenate([O, q], 1), jnp.zeros((N, 6)))
    J_O = R @ J @ paper.transposed(R) + paper.scalar(m) * (
        paper.skew(r_C) @ paper.transposed(paper.skew(r_C))
    )
    D, Xi = rng.normal(size=(2, N, 6))
    return Geometries(models, state, k, s, L, u, r_A, r_B, r_C, m, g, u_C, J_O, D, Xi)


class Geometries(NamedTuple):
    """Models with the paper's letters; D and Xi a displacement of each body and base."""

    model: jb.Model
    state: jb.State
    k: np.ndarray
    s: np.ndarray
    L: np.ndarray
    u: np.ndarray
    r_A: np.ndarray
    r_B: np.ndarray
    r_C: np.ndarray
    m: np.ndarray
    g: np.ndarray
    u_C: np.ndarray
    J_O: np.ndarray
    D: np.ndarray
    Xi: np.ndarray

    def spring(self, i):
        """The models with spring i alone, and k, s, L, u, r_A, r_B of it."""
        alone = jnp.asarray(self.k) * np.eye(SIX)[i]
        model = eqx.tree_at(
            lambda m: (stiffness(m), m.gravity), self.model, (alone, jnp.zeros((N, 3)))
        )
        return model, *(x[:, i] for x in (self.k, self.s, self.L, self.u, self.r_A, self.r_B))

    def weight(self):
        """The models without springs."""
        return eqx.tree_at(stiffness, self.model, jnp.zeros((N, SIX)))


def stiffness(model):
    return model.elements[0].rows.stiffness


def relative_difference(result, expected, scale=None):
    """Largest difference, relative to the largest number of each geometry."""
    result, expected = np.asarray(result), np.asarray(expected)
    assert result.shape == expected.shape
    axes = tuple(range(1, expected.ndim))
    scale = np.abs(expected).max(axes) if scale is None else scale
    return np.max(np.abs(result - expected).max(axes) / scale)


@jit_once
@jax.vmap
def matrices(model, state):
    lin = jb.linearize(model, state)
    return lin.M, lin.K, lin.K_tilde, lin.M_tilde


@jit_once
@jax.vmap
def split(model, state):
    lin = jb.linearize(model, state)
    return lin.K_elastic_by_element, lin.K_geometric_by_element, lin.K_gravity


@jit_once
@jax.vmap
def energies(model, state, D, Xi):
    """V, dV/dt, d2V/dt2 along (t D, t Xi) at t = 0, and V at t = 1."""

    def V(t):
        moved = jb.State(Coordinates(model).retract(state.q, t * D), state.v)
        return jb.potential_energy(model, moved, xi=t * Xi[None])

    def slope(t):
        return jax.jvp(V, (t,), (1.0,))

    (value, first), (_, second) = jax.jvp(slope, (0.0,), (1.0,))
    return value, first, second, V(1.0)


@jit_once
@jax.vmap
def forces(model, state, D, Xi):
    """The generalized force -dV/dDelta and its derivative along (D, Xi)."""

    def force(t):
        def V(delta):
            moved = jb.State(Coordinates(model).retract(state.q, delta), state.v)
            return jb.potential_energy(model, moved, xi=t * Xi[None])

        return -jax.grad(V)(t * D)

    return jax.jvp(force, (0.0,), (1.0,))


@jit_once
@jax.vmap
def points(model, state, D, Xi):
    """Displacements of the A, the B and C by (D, Xi), slopes in Delta of the A and C at rest, and
    how these change along D."""

    def moved(delta, xi):
        q = Coordinates(model).retract(state.q, delta)
        frames = frames_of(model, jb.State(q, state.v), xi)
        rows = model.elements[0].rows
        return frames[2].point(jnp.concatenate([rows.a, model.bodies.rows.com])), frames[1].point(
            rows.b
        )

    zero = jnp.zeros(6)
    before, after = moved(zero, zero), moved(D, Xi)
    slopes = jax.jvp(jax.jacfwd(lambda delta: moved(delta, zero)[0]), (zero,), (D,))
    return after[0] - before[0], after[1] - before[1], *slopes


def test_geometries_are_in_equilibrium(geometries):
    g = geometries
    pulls = [
        paper.scalar(g.k * g.s)[..., 0] * paper.U_of(g.u, g.r_A),
        (g.m * g.g)[:, None, None] * paper.U_of(g.u_C, g.r_C)[:, None],
    ]
    scale = np.abs(np.concatenate(pulls, 1)).max((1, 2))
    total, _ = forces(g.model, g.state, g.D, g.Xi)  # (63)
    assert np.max(np.abs(total).max(1) / scale) < 1e-10
    assert (g.k > 0).all() and (np.abs(g.s / g.L) > 0.04).all()


def test_mass_matrix_is_the_papers(geometries):
    g = geometries
    M, _, _, M_tilde = matrices(g.model, g.state)
    assert relative_difference(M, paper.mass_at_rest(g.m, g.r_C, g.J_O)) < 1e-10  # (42)
    assert not np.any(M_tilde)


def test_stiffness_of_each_spring_is_the_papers(geometries):
    g = geometries
    elastic, geometric, gravity = split(g.model, g.state)
    total, total_tilde = paper.K_C(g.m, g.g, g.r_C, g.u_C), 0
    assert relative_difference(gravity, total) < 1e-10  # (40)
    for i in range(SIX):
        model, k, s, L, u, r_A, r_B = g.spring(i)
        U, U_tilde = paper.U_of(u, r_A), paper.U_of(u, r_B)  # (33), (43)
        K_AB, K_tilde_AB = paper.K_AB(k, s, L, u, r_A), paper.K_tilde_AB(k, s, L, u, r_A, r_B)
        _, K, K_tilde, _ = matrices(model, g.state)
        assert relative_difference(K, K_AB) < 1e-10  # (38), (39)
        assert relative_difference(K_tilde, K_tilde_AB) < 1e-10  # (46)-(48)
        assert relative_difference(K_tilde[..., :3], K_AB[..., :3]) < 1e-10  # (58)
        assert relative_difference(elastic[f"s{i}"], paper.scalar(k) * paper.outer(U, U)) < 1e-10
        assert (
            relative_difference(geometric[f"s{i}"], K_AB - paper.scalar(k) * paper.outer(U, U))
            < 1e-10
        )
        free = eqx.tree_at(lambda m: m.elements[0].rows.free_length, model, jnp.asarray(g.L))
        assert (
            relative_difference(
                matrices(free, g.state)[2], paper.scalar(k) * paper.outer(U, U_tilde)
            )
            < 1e-10
        )  # (59)
        total, total_tilde = total + K_AB, total_tilde + K_tilde_AB
    _, K, K_tilde, _ = matrices(g.model, g.state)
    assert relative_difference(K, total) < 1e-10  # (41)
    assert relative_difference(K_tilde, total_tilde) < 1e-10  # (49)


def test_force_of_each_spring_and_of_the_weight_is_the_papers(geometries):
    g = geometries
    for i in range(SIX):
        model, k, s, L, u, r_A, r_B = g.spring(i)
        force, change = forces(model, g.state, g.D, g.Xi)
        assert relative_difference(force, (k * s)[:, None] * paper.U_of(u, r_A)) < 1e-10  # (55)
        excitation = paper.times(paper.K_tilde_AB(k, s, L, u, r_A, r_B), g.Xi)  # (57)
        assert (
            relative_difference(change, excitation - paper.times(paper.K_AB(k, s, L, u, r_A), g.D))
            < 1e-10
        )  # (55)
    force, change = forces(g.weight(), g.state, g.D, g.Xi)
    # (37), (62)
    assert relative_difference(force, (g.m * g.g)[:, None] * paper.U_of(g.u_C, g.r_C)) < 1e-10
    # (62)
    assert relative_difference(change, -paper.times(paper.K_C(g.m, g.g, g.r_C, g.u_C), g.D)) < 1e-10


def taylor(function):
    """f, f', f'' at 0 of a polynomial of degree 4, from five values."""
    f = {t: function(t) for t in (-2, -1, 0, 1, 2)}
    return (
        f[0],
        (8 * (f[1] - f[-1]) - (f[2] - f[-2])) / 12,
        (16 * (f[1] + f[-1]) - (f[2] + f[-2]) - 30 * f[0]) / 12,
    )


def test_energy_is_the_papers_and_its_series_to_second_order(geometries):
    g = geometries
    moved_A, moved_B, _, _ = (np.asarray(x) for x in points(g.model, g.state, g.D, g.Xi))
    for i in range(SIX):
        model, k, s, L, u, r_A, r_B = g.spring(i)
        *series, there = energies(model, g.state, g.D, g.Xi)
        length = paper.deformed_length(L, u, moved_A[:, i] - moved_B[:, i])  # (30), (51)
        # (50)
        assert relative_difference(there, k / 2 * (length - (L - s)) ** 2, scale=k * L**2) < 1e-10

        def V(t, k=k, s=s, L=L, u=u, r_A=r_A, r_B=r_B):
            D_AB = paper.displacement(t * g.D, r_A) - paper.displacement(t * g.Xi, r_B)  # (53)
            return paper.potential_series(k, s, L, u, D_AB)  # (52)

        expected = np.stack(taylor(V), -1)
        assert relative_difference(np.stack(series, -1), expected) < 1e-10
    *series, _ = energies(g.weight(), g.state, g.D, g.Xi)
    expected = taylor(
        lambda t: paper.gravity_potential(g.m, g.g, g.u_C, paper.displacement(t * g.D, g.r_C))
    )  # (60), (61)
    assert relative_difference(np.stack(series[1:], -1), np.stack(expected[1:], -1)) < 1e-10


def test_displacements_of_points_are_the_papers_to_second_order(geometries):
    g = geometries
    _, _, slopes, change = points(g.model, g.state, g.D, g.Xi)
    r = np.concatenate([g.r_A, g.r_C[:, None]], 1)
    at_rest = paper.displacement_slopes(np.zeros((N, 1, 6)), r)
    assert relative_difference(paper.transposed(slopes), at_rest) < 1e-10  # (56)
    assert (
        relative_difference(
            paper.transposed(change), paper.displacement_slopes(g.D[:, None], r) - at_rest
        )
        < 1e-10
    )  # (53), (56), (61)
