"""Damping ratios given by mode, and the static response at 0 Hz, against sums over modes and matrix
functions by NumPy and SciPy."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
import scipy.linalg
from rigs import max_difference
from scipy.spatial.transform import Rotation

import jaxbody as jb

F = np.array([0.3, 1.1, 2.7, 9.0])
POINT = [0.1, 0.2, -0.1]
RATIOS = 0.02 + 0.01 * np.arange(7)
FORCES = {a: jb.PointForce("box", POINT, a) for a in "xyz"}
MOTIONS = {f"base {d}": jb.BaseMotion("base", d) for d in ("x", "y", "z", "ry")}
OUTPUTS = {a: jb.Position("box", POINT, axis=a) for a in "xyz"}


@pytest.fixture(scope="module")
def rig():
    """A free box and an arm on a hinge of the base, five springs, at equilibrium, without dampers;
    and how its point moves with each coordinate, by SciPy."""
    model = rigs.rig()
    model = jb.replace(model, {f"{name}.damping": 0.0 for name in model.element_names})
    lin = jb.linearize(model, jb.equilibrium(model))
    w, *xyz = np.asarray(lin.state.q)[model.layout.q_slices["box"]][3:]
    r = Rotation.from_quat([*xyz, w]).apply(POINT)
    Y = np.zeros((3, model.layout.nv))
    Y[:, model.layout.v_slices["box"]] = np.hstack([np.eye(3), -np.cross(np.eye(3), r)])
    return lin, Y


def relative_sum(lin, Y, ratios, f):
    """Y x of forces Y' f and motions of the base: with S = K^-1 K~ of relative motion x - S Xi
    the sum of phi phi' (Y' f + w^2 (M S - M~) Xi) over w_i^2 - w^2 + 2 i zeta_i w_i w, by
    SciPy's modes."""
    M, K, M_tilde, K_tilde = (np.asarray(x) for x in (lin.M, lin.K, lin.M_tilde, lin.K_tilde))
    squares, phi = scipy.linalg.eigh(K, M)
    S = np.linalg.solve(K, K_tilde)
    columns, result = [0, 1, 2, 4], []
    for w in 2 * np.pi * np.asarray(f):
        gain = phi / (squares - w**2 + 2j * ratios * np.sqrt(squares) * w) @ phi.T
        result.append(
            np.concatenate(
                [Y @ gain @ Y.T, Y @ (S + w**2 * gain @ (M @ S - M_tilde))[:, columns]], 1
            )
        )
    return np.stack(result, -1)


@pytest.mark.parametrize("method", ["direct", "modal"])
def test_responses_with_modal_damping_are_sums_over_the_modes(rig, method):
    """Of forces and of motions of the base, whose inertia couples to the arm's; 0 Hz with
    the rest."""
    lin, Y = rig
    f = np.append(0.0, F)
    result = jb.frequency_response(
        lin, f, FORCES | MOTIONS, OUTPUTS, modal_damping=RATIOS, method=method
    )
    expected = relative_sum(lin, Y, RATIOS, f)
    assert result.ok and max_difference(result.values, expected) < 1e-9 * np.abs(expected).max()


@pytest.mark.long
def test_random_responses_with_modal_damping_are_sums_over_the_modes(rig):
    lin, Y = rig
    f = np.linspace(0.5, 3.0, 301)
    white = {
        "z": jb.vibration.PowerLaw(3.0, unit="N2/Hz"),
        "base x": jb.vibration.PowerLaw(0.2, unit="m2/Hz"),
    }
    inputs = {name: (FORCES | MOTIONS)[name] for name in white}
    ride = jb.random_response(lin, f, inputs, OUTPUTS, white, modal_damping=RATIOS)
    H = np.abs(relative_sum(lin, Y, RATIOS, f)[:, [2, 3]]) ** 2
    np.testing.assert_allclose(ride.psd, 3.0 * H[:, 0] + 0.2 * H[:, 1], rtol=1e-8)


def on_a_spring(damping):
    spring = jb.Spring(
        ("mass", [0, 0, 0]), ("base", [0, 0, -1]), stiffness=50.0, free_length=1.0, damping=damping
    )
    model = jb.Model(
        bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        supports={"base": jb.Support()},
        elements={"s": spring},
    )
    return jb.linearize(model, model.reference)


def test_a_ratio_acts_as_a_damper_on_body_and_support():
    """zeta = c/(2 m w): the same motion and the same reaction of forces and of the base in motion;
    what a damper has is added to."""
    inputs = {"pull": jb.PointForce("mass"), "base": jb.BaseMotion("base", "z")}
    outputs = {
        "mass": jb.Position("mass", axis="z"),
        "reaction": jb.sensors.Reaction("base", component=2),
    }
    damped = jb.frequency_response(on_a_spring(3.0), F, inputs, outputs)
    for c in (0.0, 1.0):
        result = jb.frequency_response(
            on_a_spring(c), F, inputs, outputs, modal_damping=(3.0 - c) / (2 * 2.0 * 5.0)
        )
        np.testing.assert_allclose(result.values, damped.values, rtol=1e-12, atol=1e-14)


def equal_ways(k):
    """A bob with equal stiffness along x and y and a further k along an oblique line: its modes
    coincide at k = 0."""
    spring = jb.Spring(("bob", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=1.0, free_length=0.0)
    model = jb.Model(
        bodies={"bob": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        joints={"bob": jb.Translation("world")},
        elements={"s": spring},
    )
    d = jnp.array([0.6, 0.8, 0.0])
    return dataclasses.replace(
        jb.linearize(model, model.reference),
        K=jnp.diag(jnp.array([80.0, 80.0, 300.0])) + k * d[:, None] * d,
    )


@pytest.mark.long
def test_derivatives_where_modes_coincide_are_those_of_the_matrix_function():
    """With one ratio for all C = 2 zeta M^(1/2) (M^(-1/2) K M^(-1/2))^(1/2) M^(1/2), smooth where
    modes meet: forward and reverse against differences of SciPy's."""
    zeta, f = 0.1, np.array([0.7, 1.3])
    inputs, outputs = (
        {"x": jb.PointForce("bob", direction="x")},
        {"y": jb.Position("bob", axis="y")},
    )

    def response(k):
        H = jb.frequency_response(equal_ways(k), f, inputs, outputs, modal_damping=zeta)["y", "x"]
        return jnp.concatenate([H.real, H.imag])

    def exact(k):
        d, w = np.array([0.6, 0.8, 0.0]), 2 * np.pi * f[:, None, None]
        K = np.diag([80.0, 80.0, 300.0]) + k * np.outer(d, d)
        H = np.linalg.inv(
            K - 2.0 * w**2 * np.eye(3) + 2j * zeta * w * np.real(scipy.linalg.sqrtm(2.0 * K))
        )[:, 1, 0]
        return np.concatenate([H.real, H.imag])

    for k in (0.0, 3.0):
        np.testing.assert_allclose(response(k), exact(k), atol=1e-15)
        h = 0.05
        slope = (8 * (exact(k + h) - exact(k - h)) - exact(k + 2 * h) + exact(k - 2 * h)) / (12 * h)
        np.testing.assert_allclose(jax.jacfwd(response)(k), slope, rtol=1e-8, atol=1e-13)
        np.testing.assert_allclose(jax.jacrev(response)(k), slope, rtol=1e-8, atol=1e-13)


@pytest.mark.parametrize(
    ("ratios", "code"),
    [
        (-0.1, "NEGATIVE"),
        ([0.1, 0.2], "BAD_SHAPE"),
        (np.nan, "NON_FINITE"),
        ([0.1] * 6 + [-0.2], "NEGATIVE"),
    ],
)
def test_invalid_ratios_are_refused(rig, ratios, code):
    for call in (
        lambda: jb.frequency_response(rig[0], F, FORCES, OUTPUTS, modal_damping=ratios),
        lambda: jb.random_response(
            rig[0],
            F,
            {"z": FORCES["z"]},
            OUTPUTS,
            {"z": jb.vibration.PowerLaw(1.0, unit="N2/Hz")},
            modal_damping=ratios,
        ),
    ):
        with pytest.raises(jb.JaxbodyError) as refused:
            call()
        assert refused.value.code == code and refused.value.where.endswith("modal_damping")


@pytest.mark.nan
def test_modal_damping_without_real_modes_is_reported(rig):
    lin = rig[0]
    skew = dataclasses.replace(lin, K=lin.K.at[0, 1].add(5.0))
    with pytest.warns(jb.JaxbodyWarning, match="NOT_SYMMETRIC"):
        result = jb.frequency_response(skew, F, FORCES, OUTPUTS, modal_damping=0.1)
    assert np.isnan(result.values).all()


def test_modal_damping_with_sensors_of_forces_is_refused(rig):
    """They read forces of the model, which these are not."""
    sensors = {"arm": jb.sensors.Reaction("arm", component=0)}
    with pytest.raises(
        jb.JaxbodyError, match="modal_damping: is not read by a Reaction on 'arm'"
    ) as refused:
        jb.frequency_response(rig[0], F, FORCES, sensors, modal_damping=0.1)
    assert refused.value.code == "BAD_OPTION"


# 0 Hz


@pytest.mark.long
@pytest.mark.parametrize("method", ["direct", "modal"])
def test_at_0_hz_the_response_is_the_static_one(rig, method):
    """K^-1 by NumPy, as the limit is; the base moves all with it."""
    lin, Y = rig
    result = jb.frequency_response(lin, [0.0, 1e-6], FORCES | MOTIONS, OUTPUTS, method=method)
    compliance = Y @ np.linalg.solve(np.asarray(lin.K), Y.T)
    assert (
        result.ok
        and max_difference(result.values[:, :3, 0], compliance) < 1e-11
        and max_difference(result.values[:, 3:6, 0], np.eye(3)) < 1e-9
    )
    # of the inertia at 1e-6 Hz
    assert max_difference(result.values[..., 0], result.values[..., 1]) < 1e-9
    hard = jb.frequency_response(
        on_a_spring(3.0),
        [0.0],
        {"pull": jb.PointForce("mass")},
        {"mass": jb.Position("mass", axis="z")},
        loss_factor=0.2,
    )
    np.testing.assert_allclose(hard.values[0, 0, 0], 1 / (50.0 * (1 + 0.2j)), rtol=1e-13)


@pytest.mark.long
def test_free_motions_have_no_static_response_and_are_reported():
    """Two masses on a spring between them, one dragged by a damper: NaN at 0 Hz, (K + i w C - w^2
    M)^-1 elsewhere."""
    model = jb.Model(
        bodies={name: jb.Body(mass=2.0, inertia=[1, 1, 1]) for name in ("one", "two")},
        joints={name: jb.Guide("world", axis=[0, 0, 1]) for name in ("one", "two")},
        elements={
            "s": jb.Spring(("one", [0, 0, 0]), ("two", [0, 0, 1]), stiffness=50.0, free_length=1.0)
        },
    )
    lin = dataclasses.replace(
        jb.linearize(model, model.reference), C=jnp.diag(jnp.array([3.0, 0.0]))
    )
    w = 2 * np.pi
    expected = np.linalg.inv(
        50.0 * np.array([[1, -1], [-1, 1]]) + 1j * w * np.diag([3.0, 0.0]) - 2.0 * w**2 * np.eye(2)
    )[1, 0]
    for method in ("direct", "modal"):
        with pytest.warns(
            jb.JaxbodyWarning,
            match=r"singular: a motion is not resisted; NaN at 0 Hz.*\[SINGULAR_K\]",
        ):
            result = jb.frequency_response(
                lin,
                [0.0, 1.0],
                {"pull": jb.PointForce("one")},
                {"two": jb.Position("two", axis="z")},
                method=method,
            )
        assert np.isnan(result.values[0, 0, 0]) and not result.ok
        np.testing.assert_allclose(result.values[0, 0, 1], expected, rtol=1e-11)


def test_at_0_hz_velocities_and_accelerations_are_refused_as_inputs():
    lin, outputs = on_a_spring(0.0), {"mass": jb.Acceleration("mass", axis="z")}
    for kind in ("velocity", "acceleration"):
        with pytest.raises(
            jb.JaxbodyError, match=f'given as {kind}.*Take kind="displacement"'
        ) as refused:
            jb.frequency_response(
                lin, [1.0, 0.0], {"base": jb.BaseMotion("base", "z", kind=kind)}, outputs
            )
        assert refused.value.code == "BAD_FREQUENCY"
    assert (
        jb.frequency_response(lin, [0.0], {"base": jb.BaseMotion("base", "z")}, outputs).values[
            0, 0, 0
        ]
        == 0
    )


@pytest.mark.long
def test_pictures_tables_and_objectives_of_a_response_with_0_hz():
    """A logarithmic scale starts above it; a NaN at it does not change the other phases and the
    largest magnitude."""
    from matplotlib.figure import Figure

    f = np.array([0.0, 0.5, 1.0, 2.0])
    inputs, outputs = {"base": jb.BaseMotion("base", "z")}, {"mass": jb.Position("mass", axis="z")}
    result = jb.frequency_response(on_a_spring(3.0), f, inputs, outputs)
    ax = jb.plots.plot_frequency_response(result, ax=Figure().subplots())
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), f[1:])
    assert (
        jb.plots.plot_transmissibility(result, ax=Figure().subplots()).lines[0].get_xdata()[0]
        == 0.5
    )
    lost = dataclasses.replace(
        result, values=result.values.at[..., 0].set(jnp.nan), status=jnp.array(3)
    )
    np.testing.assert_allclose(
        lost.phase[0, 0, 1:], np.angle(np.asarray(result.values))[0, 0, 1:], rtol=1e-12
    )
    assert "nan" in str(lost) and f"{float(result.magnitude.max()):.6g}" in str(lost)
    with pytest.raises(jb.JaxbodyError, match="BAD_FREQUENCY"):
        jb.objectives.transmitted(result, "mass", "base")
