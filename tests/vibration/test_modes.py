"""Modes against closed forms, NumPy, SciPy and differences: energies, clusters and their
derivatives, poles, spins, axes, branches."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
import scipy.linalg
from rigs import POWERTRAIN_ENERGIES, max_difference

import jaxbody as jb
from jaxbody.model.joints.frame_tables import frames_of
from jaxbody.numerics.eigenproblems import natural
from jaxbody.suspension.presets import presets

RNG = np.random.default_rng(5)


@pytest.fixture(scope="module")
def engine():
    return jb.presets.engine_on_mounts()


@pytest.fixture(scope="module")
def rig():
    """Two bodies, one on a hinge of the base, five springs, at equilibrium."""
    model = rigs.rig()
    return jb.linearize(model, jb.equilibrium(model))


def mounted(coefficients):
    """Of each mount of the powertrain the 6 x 6 matrix of three coefficients along the axes."""
    # displacement of a point: delta + theta x r
    arms = [np.hstack([np.eye(3), -np.cross(np.eye(3), r)]) for r in presets.MOUNTS]
    return [arm.T @ np.diag(k) @ arm for arm, k in zip(arms, coefficients, strict=True)]


def inertia_of(engine):
    return scipy.linalg.block_diag(139.5 * np.eye(3), np.asarray(engine["engine"].inertia))


# Energies


@pytest.mark.long
def test_kinetic_energies_of_the_published_powertrain(engine):
    result = jb.vibration.mode_energies(jb.linearize(engine, engine.reference), forward="x", up="z")
    published = POWERTRAIN_ENERGIES
    # half of the last digit printed
    assert max_difference(result.kinetic["engine"], published) < 0.51e-4
    named = ("fore-aft 99", "lateral 98", "yaw 37", "bounce 49", "pitch 66", "roll 79")
    assert result.names == tuple(f"engine {name} %" for name in named)
    assert "engine roll" in str(result) and "mount 2" in str(result)
    phi = scipy.linalg.eigh(sum(mounted(presets.MOUNT_STIFFNESS)), inertia_of(engine))[1]
    for shares, coefficients in (
        (result.strain, presets.MOUNT_STIFFNESS),
        (result.dissipation, presets.MOUNT_DAMPING),
    ):
        parts = np.array([np.diag(phi.T @ k @ phi) for k in mounted(coefficients)])
        assert max_difference(np.array(list(shares.values())), 100 * parts / parts.sum(0)) < 1e-9
    assert max(float(jnp.abs(x).max()) for x in result.other_strain.values()) < 1e-9


@pytest.mark.long
def test_shares_are_those_of_the_matrices(rig):
    """Kinetic energy with O away from the centers of mass and a hinge on a base, against the
    velocities of each body by differences; strain by the split of K."""
    model, result = rig.model, jb.vibration.mode_energies(rig)
    M, K, C = (np.asarray(x) for x in (rig.M, rig.K, rig.C))
    values, phi = scipy.linalg.eigh(K, M)
    poses = [
        eqx.filter_jit(lambda d: _places(model, rig.state.q, d))(sign * 1e-6 * phi[:, i])
        for i in range(7)
        for sign in (1, -1)
    ]
    for i in range(7):
        (p, R), (p_back, R_back) = poses[2 * i], poses[2 * i + 1]
        v, turned = (p - p_back) / 2e-6, (R - R_back) / 2e-6
        for b, name in enumerate(model.layout.bodies):
            W = turned[b] @ ((R[b] + R_back[b]) / 2).T
            w = np.array([W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1]]) / 2
            J = R[b] @ np.asarray(model[name].inertia) @ R[b].T
            expected = 100 * np.concatenate([float(model[name].mass) * v[b] ** 2, w * (J @ w)])
            # in percent; of the differences
            assert max_difference(result.kinetic[name][:, i], expected) < 1e-4
    for name, k in rig.K_elastic_by_element.items():
        assert max_difference(result.strain[name], 100 * np.diag(phi.T @ k @ phi) / values) < 1e-10
    others = {"tension": rig.K_geometric, "gravity": rig.K_gravity, "loads": rig.K_loads}
    for name, k in others.items():
        assert (
            max_difference(result.other_strain[name], 100 * np.diag(phi.T @ k @ phi) / values)
            < 1e-10
        )
    for name in model.element_names:  # of one damper, by the C that it leaves when it is taken out
        without = jb.replace(model, {f"{name}.damping": 0 * model[name].damping})
        lost = C - np.asarray(jb.linearize(without, rig.state).C)
        assert (
            max_difference(
                result.dissipation[name],
                100 * np.diag(phi.T @ lost @ phi) / np.diag(phi.T @ C @ phi),
            )
            < 1e-10
        )
    for total in (
        result.kinetic_shares.sum((0, 1)),
        result.strain_shares.sum(0) + result.other_shares.sum(0),
        result.dissipation_shares.sum(0),
    ):
        assert max_difference(total, np.full(7, 100.0)) < 1e-10


def _places(model, q, delta):
    """Centers of mass and orientations of the bodies after small displacements."""
    state = jb.State(jb.joints.retract(model, q, jnp.asarray(delta)), jnp.zeros(model.layout.nv))
    frames = frames_of(model, state)[model.layout.first_body :]
    return frames.point(model.bodies.rows.com), frames.R


@pytest.mark.long
def test_loads_have_their_share_and_undamped_elements_none():
    """A pendulum under a dead force: its stiffness is m g L + F L."""
    bob = jb.Body(mass=2.0, inertia=[1e-3] * 3, com=[0, 0, -0.5])
    model = jb.Model(
        bodies={"bob": bob},
        joints={"bob": jb.Hinge("world", axis=[0, 1, 0])},
        gravity=[0, 0, -9.81],
    )
    eq = jb.equilibrium(model, loads={"pull": jb.Force(("bob", [0, 0, -0.5]), force=[0, 0, -10.0])})
    result = jb.vibration.mode_energies(jb.linearize(model, eq))
    expected = 100 * np.array([0.0, 19.62, 10.0]) / 29.62
    assert (
        max_difference(
            [float(result.other_strain[name][0]) for name in ("tension", "gravity", "loads")],
            expected,
        )
        < 1e-9
    )
    assert result.names == ("bob along x 100 %",) and result.dissipation == {}


def test_springs_share_by_stiffness_and_dampers_by_damping():
    springs = {
        name: jb.Spring(
            ("mass", [0, 0, 0]), ("world", [0, 0, -1]), stiffness=k, free_length=1.0, damping=c
        )
        for name, k, c in (("stiff", 300.0, 1.0), ("soft", 100.0, 4.0))
    }
    mass = jb.Model(
        bodies={"mass": jb.Body(2.0, [1, 1, 1])},
        joints={"mass": jb.Guide("world", axis="z")},
        elements=springs,
    )
    energies = jb.vibration.mode_energies(jb.linearize(mass, mass.reference))
    np.testing.assert_allclose(np.ravel(list(energies.strain.values())), [75, 25], rtol=1e-12)
    np.testing.assert_allclose(np.ravel(list(energies.dissipation.values())), [20, 80], rtol=1e-12)


@pytest.mark.long
def test_directions_are_named_where_they_are_known(engine):
    lin = jb.linearize(engine, engine.reference)
    assert (
        jb.vibration.mode_energies(lin).names[0] == "engine along x 99 %"
    )  # without gravity nothing is up
    for wrong in ({"forward": "x"}, {"forward": "z", "up": "z"}, {"up": "w"}):
        with pytest.raises(jb.JaxbodyError) as error:
            jb.vibration.mode_energies(lin, **wrong)
        assert error.value.code == "BAD_DIRECTION"


@pytest.mark.long
def test_gradients_of_frequencies_ratios_and_energies(rig):
    """By stiffness, damping, mass and the place of a mount, through the equilibrium, against
    central differences."""
    model = rigs.rig(mount=rigs.MOUNT)
    eq = jb.equilibrium(model)
    x = jnp.array([120.0, 0.8, 2.0, 0.3])

    def numbers(x):
        changed = {
            "s0.stiffness": x[0],
            "s1.damping": x[1],
            "box.mass": x[2],
            "s0.a": jnp.array([0.0, 0.25, 0.1]).at[0].set(x[3]),
        }
        changed = jb.replace(model, changed)
        lin = jb.linearize(changed, jb.equilibrium(changed, start=eq.state))
        result, damped, shares = (
            jb.modes(lin),
            jb.complex_modes(lin),
            jb.vibration.mode_energies(lin),
        )
        parts = (
            result.frequency,
            result.damping_ratio,
            damped.frequency,
            damped.damping_ratio,
            damped.decay_rate,
        )
        return jnp.concatenate(
            [
                *parts,
                *(
                    y.reshape(-1) / 100
                    for y in (
                        shares.kinetic_shares,
                        shares.strain_shares,
                        shares.dissipation_shares,
                    )
                ),
            ]
        )

    numbers = jax.jit(numbers)
    forward = jax.jit(jax.jacfwd(numbers))(x)
    for i, h in enumerate((3e-3, 1e-4, 1e-4, 1e-5)):
        step = jnp.zeros(4).at[i].set(h)
        ends = [numbers(x + s * step) for s in (2, 1, -1, -2)]
        difference = (8 * (ends[1] - ends[2]) - (ends[0] - ends[3])) / (12 * h)
        assert max_difference(forward[:, i], difference) < 1e-6 * max(1.0, np.abs(difference).max())


# Modes that coincide


A, SIDE, KX, KZ, MASS = 0.4, 0.25, 3e4, 2e4, 20.0
J = MASS * SIDE**2  # equal about x and y


@pytest.fixture(scope="module")
def square():
    """A square plate on four equal mounts, each three springs at right angles, at its corners; the
    modes as a function of the upright stiffness of mount 0."""
    elements = {}
    for i, (x, y) in enumerate([(A, A), (A, -A), (-A, A), (-A, -A)]):
        for axis, (k, d) in {
            "x": (KX, [1, 0, 0]),
            "y": (KX, [0, 1, 0]),
            "z": (KZ, [0, 0, 1]),
        }.items():
            ends = ("plate", [x, y, 0]), ("world", np.array([x, y, 0]) + d)
            elements[f"{axis}{i}"] = jb.Spring(
                *ends, stiffness=k, free_length=1.0, damping=0.01 * k
            )
    return jb.Model(
        bodies={"plate": jb.Body(mass=MASS, inertia=[J, J, 1.7 * J])}, elements=elements
    )


@pytest.fixture(scope="module")
def of_square(square):
    def linearized(k):
        model = jb.replace(square, {"z0.stiffness": k})
        return jb.linearize(model, model.reference)

    return linearized


@pytest.mark.long
def test_equal_frequencies_have_two_one_sided_derivatives(of_square):
    """Roll and pitch of the plate: w^2 = 4 k a^2/J; a mount more by dk adds 2 a^2 dk/J to turning
    about one diagonal, nothing to the other."""
    frequency = jax.jit(lambda k: jb.modes(of_square(k)).frequency)
    at = frequency(KZ)
    pair = np.flatnonzero(np.abs(np.asarray(at) - np.sqrt(4 * KZ * A**2 / J) / (2 * np.pi)) < 1e-6)
    assert len(pair) == 2 and len(set(np.asarray(jb.modes(of_square(KZ)).cluster)[pair])) == 1
    slope = 2 * A**2 / J / (8 * np.pi**2 * float(at[pair[0]]))
    forward, backward = (
        np.asarray(jax.jvp(frequency, (KZ,), (sign,))[1]) * sign for sign in (1.0, -1.0)
    )
    print("one-sided", forward[pair], backward[pair], slope)
    assert (
        max_difference(forward[pair], [0.0, slope]) < 1e-9 * slope
        and max_difference(backward[pair], [slope, 0.0]) < 1e-9 * slope
    )
    # differences to each side; their errors are of the second derivative, h/(8 k) of the slope
    h = 1e-2
    assert max_difference((frequency(KZ + h) - at)[pair] / h, forward[pair]) < 1e-6 * slope
    assert max_difference((at - frequency(KZ - h))[pair] / h, backward[pair]) < 1e-6 * slope
    assert max_difference(jax.jacfwd(frequency)(KZ)[pair], [0.0, slope]) < 1e-9 * slope
    rows = jax.jit(jax.jacrev(frequency))(KZ)  # one branch: refused; the others as in forward mode
    assert np.isnan(rows[pair]).all()
    others = np.flatnonzero(
        jnp.sum(jb.modes(of_square(KZ)).cluster[:, None] == jb.modes(of_square(KZ)).cluster, 0) == 1
    )
    assert len(others) == 2 and max_difference(rows[others], forward[others]) < 1e-9 * slope
    both = jax.grad(lambda k: jnp.sum(frequency(k)[pair]))(KZ)  # the sum: right in reverse mode too
    assert abs(both / slope - 1) < 1e-9


@pytest.mark.long
def test_energies_of_equal_frequencies_are_those_of_their_space(of_square):
    """Derivatives of the shares against central differences of sums of energies over each pair,
    which differences take apart."""

    def energies(k):
        """Shares, and the energies and losses that they are shares of."""
        lin = of_square(k)
        result, modes = jb.vibration.mode_energies(lin), jb.modes(lin)
        return (result.kinetic_shares[0], result.strain_shares, result.dissipation_shares), (
            jnp.ones(6), modes.eigenvalues, modes.damping_ratio * modes.frequency
        )  # fmt: skip

    energies, modes = jax.jit(energies), jb.modes(of_square(KZ))
    same = np.asarray(modes.cluster[:, None] == modes.cluster, float)

    def of_spaces(k):
        return [
            np.asarray(share * whole) @ same / (whole @ same)
            for share, whole in zip(*energies(k), strict=True)
        ]

    h = 2.0
    forward = jax.jit(jax.jacfwd(lambda k: energies(k)[0]))(KZ)
    ends = [of_spaces(KZ + s * h) for s in (2, 1, -1, -2)]
    for at, again, result, *values in zip(
        energies(KZ)[0], of_spaces(KZ), forward, *ends, strict=True
    ):
        difference = (8 * (values[1] - values[2]) - (values[0] - values[3])) / (12 * h)
        assert (
            max_difference(at, again) < 1e-9
            and max_difference(result, difference) < 1e-6 * np.abs(difference).max() + 1e-11
        )
    assert np.abs(forward[1]).max() > 1e-4
    assert max_difference(modes.damping_ratio, 0.01 * np.pi * modes.frequency) < 1e-9  # C = 0.01 K


def random_problem(values, seed):
    """K, M, dK, dM with given eigenvalues."""
    rng, n = np.random.default_rng(seed), len(values)
    B, dK, dM = rng.normal(size=(3, n, n))
    M = B @ B.T + n * np.eye(n)
    L = np.linalg.cholesky(M) @ np.linalg.qr(rng.normal(size=(n, n)))[0]
    return L @ np.diag(values) @ L.T, M, dK + dK.T, (dM + dM.T) / 9


@pytest.mark.long
def test_derivatives_of_an_eigenproblem_with_a_double_and_a_triple_value():
    """Against SciPy's values on both sides; spaces by their projectors."""
    K, M, dK, dM = random_problem([1.0, 2.0, 2.0, 3.0, 5.0, 5.0, 5.0], 1)

    def both(t):
        return natural(K + t * dK, M + t * dM)

    def reference(t):
        return scipy.linalg.eigh(K + t * dK, M + t * dM)

    h = 1e-6
    forward, changes = jax.jit(jax.jacfwd(both))(0.0)
    # errors h times the second derivatives
    assert max_difference(forward, (reference(h)[0] - reference(0.0)[0]) / h) < 1e-5
    for group in ([0], [1, 2], [3], [4, 5, 6]):
        phi = np.asarray(both(0.0)[1])[:, group]
        change = np.asarray(changes)[:, group] @ phi.T + phi @ np.asarray(changes)[:, group].T
        ends = [v[:, group] @ v[:, group].T for v in (reference(h)[1], reference(-h)[1])]
        assert max_difference(change, (ends[0] - ends[1]) / (2 * h)) < 1e-7
        np.testing.assert_allclose(
            jax.grad(lambda t, group=group: jnp.sum(both(t)[0][jnp.array(group)]))(0.0),
            forward[jnp.array(group)].sum(),
            rtol=1e-12,
        )
    several = jax.vmap(jax.jacfwd(lambda t: both(t)[0]))(jnp.array([0.0, 0.3]))
    assert (
        max_difference(several[0], forward) < 1e-12
        and max_difference(several[1], jax.jacrev(lambda t: both(t)[0])(0.3)) < 1e-10
    )


@pytest.mark.long
def test_second_derivatives_are_those_of_single_values():
    K, M, dK, dM = random_problem([1.0, 2.0, 2.0, 3.0, 5.0, 5.0, 5.0], 1)

    def both(t):
        return natural(K + t * dK, M + t * dM)

    ends = [scipy.linalg.eigh(K + t * dK, M + t * dM)[0] for t in (1e-3, 0.0, -1e-3)]
    for second in (jax.hessian(lambda t: both(t)[0]), jax.jacfwd(jax.jacfwd(lambda t: both(t)[0]))):
        result = np.asarray(second(0.0))
        assert (
            max_difference(result[[0, 3]], ((ends[0] - 2 * ends[1] + ends[2]) / 1e-6)[[0, 3]])
            < 1e-4
        )
        assert np.isnan(result[[1, 2, 4, 5, 6]]).all()


@pytest.mark.long
def test_single_shapes_of_a_cluster_have_no_derivative_and_invariants_of_it_have(of_square):
    from jaxbody.numerics.eigenproblems import clusters, refused_in_clusters

    K, M, dK, dM = random_problem([1.0, 2.0, 2.0, 3.0], 2)

    def shapes(t):
        values, phi = natural(K + t * dK, M + t * dM)
        return refused_in_clusters(phi, clusters(values))

    for one in (jax.jacfwd, jax.jacrev):
        change = np.asarray(one(shapes)(0.0))
        assert np.isnan(change[:, 1:3]).all() and np.isfinite(change[:, [0, 3]]).all()
    invariant = jax.grad(lambda t: jnp.sum(shapes(t)[0, 1:3] ** 2))(0.0)  # of the projector
    ends = [
        np.sum(scipy.linalg.eigh(K + t * dK, M + t * dM)[1][0, 1:3] ** 2) for t in (1e-6, -1e-6)
    ]
    np.testing.assert_allclose(invariant, (ends[0] - ends[1]) / 2e-6, rtol=1e-6)


@pytest.mark.parametrize("ratio", [1e8, 1.1e10, 1e11])
def test_a_soft_spring_beside_one_that_stands_for_a_link_is_no_free_motion(ratio):
    """Both masses of 1 kg: w^2 = (s - sqrt(s^2 - 4 k0 k1))/2, s = k0 + 2 k1, here 2 k0
    k1/(s + sqrt(...)); the static sag of the second under 1 m/s2 is 1/k1 + 2/k0."""
    k0, k1 = 100 * ratio, 100.0
    model = jb.Model(
        bodies={
            name: jb.Body(1.0, position=[x, 0, 0]) for name, x in (("link", 1.0), ("mass", 2.0))
        },
        joints={name: jb.Guide("world", axis="x") for name in ("link", "mass")},
        elements={
            "stiff": jb.Spring(
                ("link", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=k0, free_length=1.0
            ),
            "soft": jb.Spring(
                ("mass", [0, 0, 0]), ("link", [0, 0, 0]), stiffness=k1, free_length=1.0
            ),
        },
        gravity=[1.0, 0, 0],
    )
    eq = jb.equilibrium(model)
    s = k0 + 2 * k1
    expected = np.sqrt(2 * k0 * k1 / (s + np.sqrt(s**2 - 4 * k0 * k1))) / (2 * np.pi)
    np.testing.assert_allclose(jb.modes(jb.linearize(model, eq)).frequency[0], expected, rtol=1e-4)
    np.testing.assert_allclose(eq.state.q[1], 1 / k1 + 2 / k0, rtol=1e-5)
