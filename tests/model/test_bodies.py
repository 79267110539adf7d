"""Bodies as users give them: orientations by Euler angles, inertia of parts and points, bodies free
to turn without inertia."""

from itertools import pairwise, product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxbody as jb

SEQUENCES = [
    "".join(s)
    for n in (1, 2, 3)
    for s in product("xyz", repeat=n)
    if all(a != b for a, b in pairwise(s))
]
ANGLES = np.array([0.7, -1.9, 2.8])


def turned(q):
    return Rotation.from_quat(np.asarray(q), scalar_first=True).as_matrix()


@pytest.mark.parametrize("sequence", [*SEQUENCES, *map(str.upper, SEQUENCES)])
def test_euler_angles_are_those_of_scipy(sequence):
    angles = ANGLES[: len(sequence)]
    exact = Rotation.from_euler(sequence, angles).as_matrix()
    np.testing.assert_allclose(
        turned(jb.Body(mass=1.0, orientation=jb.EulerAngles(sequence, angles)).orientation),
        exact,
        atol=1e-15,
    )


def test_euler_angles_may_stand_wherever_an_orientation_may():
    euler, exact = jb.EulerAngles("ZYX", ANGLES), Rotation.from_euler("ZYX", ANGLES).as_matrix()
    ends = ("a", [0, 0, 0]), ("b", [0, 0, 0])
    for thing in (
        jb.Body(mass=1.0, orientation=euler).orientation,
        jb.Support(orientation=euler).orientation,
        jb.Bushing(*ends, stiffness=[1, 2, 3], orientation=euler).orientation,
        jb.Bushing(*ends, stiffness=[1, 2, 3], orientation_b=euler).orientation_b,
        jb.Torsion("a", "b", axis=[0, 0, 1], spring=1.0, orientation=euler).orientation,
        jb.Accelerometer("a", orientation=euler).orientation,
        jb.sensors.Gyro("a", orientation=euler).orientation,
        jb.sensors.Orientation("a", orientation=euler).orientation,
        jb.replace(
            jb.Model(bodies={"a": jb.Body(mass=1.0, inertia=[1, 1, 1])}), {"a.orientation": euler}
        )["a"].orientation,
    ):
        np.testing.assert_allclose(turned(thing), exact, atol=1e-15)


def test_euler_angles_may_be_differentiated():
    """dR/d(yaw) of a turn about z is [z] R."""

    def R(yaw):
        q = jb.Support(orientation=jb.EulerAngles("ZYX", jnp.stack([yaw, 0.3, -0.2]))).orientation
        return jb.Model(
            bodies={"a": jb.Body(mass=1.0, inertia=[1, 1, 1], orientation=q)}
        ).reference.q[3:]

    q, rate = jax.jit(lambda yaw: jax.jvp(R, (yaw,), (1.0,)))(0.5)
    np.testing.assert_allclose(
        turned(q), Rotation.from_euler("ZYX", [0.5, 0.3, -0.2]).as_matrix(), atol=1e-15
    )
    w, x, y, z = q
    np.testing.assert_allclose(rate, 0.5 * np.array([-z, -y, x, w]), atol=1e-15)  # (0, z) q / 2


# Parts


def cloud(masses, points):
    """Mass, center and inertia about it of point masses, by their definition."""
    com = masses @ points / masses.sum()
    return (
        masses.sum(),
        com,
        sum(
            m * (d @ d * np.eye(3) - np.outer(d, d))
            for m, d in zip(masses, points - com, strict=True)
        ),
    )


def test_a_body_of_parts_is_the_cloud_of_all_their_points(rng):
    """Parts that are clouds of points themselves, each in its own axes, and single points."""
    parts, masses, points = [], [], []
    for _ in range(4):
        m, x = rng.uniform(0.1, 2, 6), rng.normal(size=(6, 3))
        total, com, inertia = cloud(m, x)
        place, turn = rng.normal(size=3), Rotation.random(rng=rng)
        parts.append(
            jb.Body(
                mass=total, inertia=inertia, com=com, position=place, orientation=turn.as_matrix()
            )
        )
        masses, points = [*masses, *m], [*points, *(place + turn.apply(x))]
    for _ in range(3):
        m, x = rng.uniform(0.1, 2), rng.normal(size=3)
        parts.append(jb.Body(mass=m, position=x))
        masses, points = [*masses, m], [*points, x]
    whole = jb.Body.of_parts(parts, position=[1, 2, 3], orientation=jb.EulerAngles("Z", [0.4]))
    total, com, inertia = cloud(np.array(masses), np.array(points))
    assert abs(whole.mass - total) <= 1e-14 * total
    np.testing.assert_allclose(whole.com, com, atol=1e-14)
    np.testing.assert_allclose(whole.inertia, inertia, atol=1e-13 * np.trace(inertia))
    assert whole.position.tolist() == [1, 2, 3]
    np.testing.assert_allclose(
        turned(whole.orientation), Rotation.from_euler("z", 0.4).as_matrix(), atol=1e-15
    )


def test_parts_may_be_differentiated():
    """A bar and a point at its end: dI/dm = (M/(M + m))^2 (l/2)^2 for a bar of mass M about its
    center of mass, m the point."""

    @jax.jit
    @jax.value_and_grad
    def inertia(m):
        bar = jb.Body(
            mass=2.0, inertia=[0, 2 / 12, 2 / 12], orientation=jb.EulerAngles("z", [m * 0])
        )
        return jb.Body.of_parts([bar, jb.Body(mass=m, position=[0.5, 0, 0])]).inertia[2, 2]

    value, slope = inertia(0.5)
    np.testing.assert_allclose(
        [value, slope], [2 / 12 + 2 * 0.5 / 2.5 * 0.25, (2 / 2.5) ** 2 * 0.25], rtol=1e-14
    )


# Without inertia


def mounted(body, joint=None):
    ends = {
        f"m{i}": jb.Bushing(
            ("body", [i, 0, 0]), ("world", [i, 0, 0]), stiffness=[900.0, 800.0, 700.0]
        )
        for i in (-1, 1)
    }
    ends["m0"] = jb.Bushing(
        ("body", [0, 0.5, 0]), ("world", [0, 0.5, 0]), stiffness=[900.0, 800.0, 700.0]
    )
    return jb.Model(
        bodies={"body": body}, joints={} if joint is None else {"body": joint}, elements=ends
    )


@pytest.mark.long
def test_a_point_mass_on_a_joint_that_does_not_turn_it_is_accepted():
    lin = jb.linearize(
        model := mounted(jb.Body(mass=2.0), jb.Translation("world")), model.reference
    )
    np.testing.assert_allclose(
        jb.modes(lin).frequency, np.sqrt(np.array([2100, 2400, 2700]) / 2) / (2 * np.pi), rtol=1e-12
    )


def test_what_may_turn_without_inertia_is_reported_when_a_model_is_built():
    with pytest.warns(
        jb.JaxbodyWarning,
        match=(
            r"'body' is free to turn and has no inertia about \[0.0, 0.0, 1.0\] of "
            r"its axes.*ZERO_MOMENT"
        ),
    ):
        mounted(jb.Body(mass=1.0, inertia=[1, 1, 0]))
    with pytest.warns(jb.JaxbodyWarning, match=r"has no inertia about any axis.*ZERO_MOMENT"):
        mounted(jb.Body(mass=1.0))


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*ZERO_MOMENT")
def test_a_singular_mass_matrix_is_reported_as_such():
    """K is regular; the rod has no inertia about its own axis z. Once six zero frequencies and
    SINGULAR_K were reported."""
    model = mounted(jb.Body(mass=1.0, inertia=[1, 1, 0], orientation=jb.EulerAngles("x", [0.0])))
    eq = jb.equilibrium(model)
    assert eq.ok  # statics is right
    lin = jb.linearize(model, eq)
    for analyse in (jb.modes, jb.complex_modes):
        with pytest.warns(
            jb.JaxbodyWarning, match=r"'body' has no inertia to turn about z.*SINGULAR_M"
        ):
            result = analyse(lin)
        assert int(result.status) == jb.Status.SINGULAR_M and np.isnan(result.frequency).all()
    with pytest.warns(jb.JaxbodyWarning, match="SINGULAR_M"):
        assert np.isnan(np.array(list(jb.vibration.mode_energies(lin).kinetic.values()))).all()


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*ZERO_MOMENT")
def test_a_simulation_without_inertia_states_the_reason():
    model = mounted(jb.Body(mass=1.0, inertia=[1, 1, 0]))
    with pytest.warns(jb.JaxbodyWarning, match=r"'body' has no inertia to turn about z.*NONFINITE"):
        jb.simulate(model, [0.0, 0.1])


@pytest.mark.long
def test_a_rod_along_no_axis_has_no_inertia_about_it():
    """Round-off leaves a moment of 1e-17, whose frequency of 1e8 Hz would reduce all others
    to zero."""
    R = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()
    with pytest.warns(jb.JaxbodyWarning, match="ZERO_MOMENT"):
        model = mounted(jb.Body(mass=1.0, inertia=R @ np.diag([1, 1, 0]) @ R.T))
    with pytest.warns(jb.JaxbodyWarning, match="no inertia to move together.*SINGULAR_M"):
        assert np.isnan(jb.modes(jb.linearize(model, model.reference)).frequency).all()


@pytest.mark.long
@pytest.mark.parametrize("letter", ["M", "K"])
def test_a_matrix_with_nan_has_no_frequency(letter):
    import equinox as eqx

    lin = jb.linearize(model := mounted(jb.Body(mass=1.0, inertia=[1, 2, 2.5])), model.reference)
    broken = eqx.tree_at(
        lambda lin: getattr(lin, letter), lin, getattr(lin, letter).at[1, 1].set(jnp.nan)
    )
    for analyse in (jb.modes, jb.complex_modes):
        with pytest.warns(jb.JaxbodyWarning, match="NONFINITE"):
            result = analyse(broken)
        assert int(result.status) == jb.Status.NONFINITE and np.isnan(result.frequency).all()
