"""Damped poles, rotors, axes of mounted bodies and modes along a parameter, against NumPy, closed
forms and differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rigs import max_difference
from scipy.spatial.transform import Rotation

import jaxbody as jb
from jaxbody.core.errors import Status
from jaxbody.numerics.eigenproblems import poles
from jaxbody.suspension.presets import presets


def refused(function, *args, **options):
    with pytest.raises(jb.JaxbodyError) as error:
        function(*args, **options)
    return error.value.code


# Poles


def chain(damping):
    """Three masses on guides one above another, on springs and dampers."""
    names = ("low", "middle", "top")
    below = ("world", *names)
    return jb.Model(
        bodies={
            name: jb.Body(mass=1.0 + i, inertia=[1, 1, 1], position=[0, 0, i + 1.0])
            for i, name in enumerate(names)
        },
        joints={name: jb.Guide("world", axis=[0, 0, 1]) for name in names},
        elements={
            f"s{i}": jb.Spring(
                (name, [0, 0, 0]),
                (below[i], [0, 0, 0]),
                stiffness=100.0 + 60 * i,
                free_length=1.0,
                damping=damping[i],
            )
            for i, name in enumerate(names)
        },
    )


@pytest.fixture(scope="module")
def poles_of():
    """Complex modes of the chain by its three damping coefficients."""
    model = chain([1.0, 1.0, 1.0])

    def of(c):
        changed = (
            jb.replace(model, {"s?.damping": c})
            if False
            else jb.replace(model, {f"s{i}.damping": c[i] for i in range(3)})
        )
        return jb.complex_modes(jb.linearize(changed, changed.reference))

    return of


K = np.array([[260.0, -160, 0], [-160, 380, -220], [0, -220, 220]])
M = np.diag([1.0, 2.0, 3.0])


def damping_of(c):
    return np.array([[c[0] + c[1], -c[1], 0], [-c[1], c[1] + c[2], -c[2]], [0, -c[2], c[2]]])


def companion(M, D, K):
    n = len(M)
    return np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]]
    )


@pytest.mark.parametrize(
    "c", [[1.0, 0.3, 2.0], [90.0, 5.0, 1.0], [90.0, 200.0, 300.0], [0.0, 0.0, 0.0]]
)
def test_poles_of_a_damped_chain(poles_of, c):
    """Lightly damped, partly and all overdamped, undamped: the poles, their shapes, frequencies and
    ratios by definition."""
    result = poles_of(jnp.array(c))
    expected = np.linalg.eigvals(companion(M, damping_of(c), K))
    assert (
        max_difference(np.sort_complex(np.asarray(result.poles).ravel()), np.sort_complex(expected))
        < 1e-10 * np.abs(expected).max()
    )
    one, other = np.asarray(result.poles).T
    for i in range(3):
        u = np.asarray(result.shapes)[:, i]
        residual = one[i] ** 2 * M @ u + one[i] * damping_of(c) @ u + K @ u
        assert np.abs(residual).max() < 1e-9 * np.abs(expected).max() ** 2
        assert abs(np.conj(u) @ M @ u - 1) < 1e-12
        largest = u[np.argmax(np.abs(u))]
        assert largest.real > 0 and abs(largest.imag) < 1e-12
    swings = one.imag > 0
    assert (
        np.allclose(one[swings], np.conj(other[swings]), rtol=0, atol=1e-12)
        and (np.abs(one[~swings]) <= np.abs(other[~swings])).all()
    )
    w = np.sqrt((one * other).real)
    assert (
        max_difference(2 * np.pi * result.natural_frequency, w) < 1e-10 and (np.diff(w) > 0).all()
    )
    assert max_difference(result.damping_ratio, -(one + other).real / (2 * w)) < 1e-12
    assert (
        max_difference(2 * np.pi * result.frequency, one.imag) < 1e-12
        and max_difference(result.decay_rate, -one.real) < 1e-12
    )


def test_an_overdamped_mass_keeps_its_damping_ratio():
    """c/(2 sqrt(k m)) = 1.5, and proportional damping pairs the poles of each mode: ratio
    w/2 beta."""
    beta = 0.2
    model = chain(beta * np.array([100.0, 160.0, 220.0]))
    lin = jb.linearize(model, model.reference)
    real, damped = jb.modes(lin), jb.complex_modes(lin)
    w = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real))
    assert (beta * w / 2)[0] < 1 < (beta * w / 2)[1]
    for result in (real, damped):
        assert max_difference(result.damping_ratio, beta * w / 2) < 1e-10
    assert max_difference(damped.natural_frequency, w / (2 * np.pi)) < 1e-10
    assert "overdamped" not in str(damped) and "decay rate" in str(damped)


@pytest.mark.long
def test_gradients_of_poles(poles_of):
    def numbers(c):
        result = poles_of(c)
        return jnp.concatenate(
            [
                result.frequency,
                result.natural_frequency,
                result.damping_ratio,
                result.decay_rate,
                jnp.abs(result.shapes).ravel(),
            ]
        )

    numbers = jax.jit(numbers)
    c, h = jnp.array([90.0, 5.0, 1.0]), 1e-3
    forward, reverse = jax.jit(jax.jacfwd(numbers))(c), jax.jit(jax.jacrev(numbers))(c)
    assert max_difference(forward, reverse) < 1e-12
    for i in range(3):
        step = jnp.zeros(3).at[i].set(h)
        ends = [numbers(c + s * step) for s in (2, 1, -1, -2)]
        difference = (8 * (ends[1] - ends[2]) - (ends[0] - ends[3])) / (12 * h)
        assert max_difference(forward[:, i], difference) < 1e-6 * np.abs(difference).max()


@pytest.mark.long
def test_equal_poles_have_sums_and_one_sided_derivatives():
    """A matrix with a double pair of poles and a double pole at zero that has one vector only."""
    rng = np.random.default_rng(3)
    block = np.array([[-0.1, 2.0], [-2.0, -0.1]])
    T = rng.normal(size=(7, 7))
    A0 = np.zeros((7, 7))
    A0[:2, :2] = A0[2:4, 2:4] = block
    A0[4, 5], A0[6, 6] = 1.0, -3.0
    A, dA = T @ A0 @ np.linalg.inv(T), rng.normal(size=(7, 7))

    def values(t):
        return poles(A + t * dA)[0]

    s = np.asarray(values(0.0))
    upper, alone = np.flatnonzero(s.imag > 1), np.flatnonzero(s.real < -1)
    change, back = jax.jvp(values, (0.0,), (1.0,))[1], jax.jvp(values, (0.0,), (-1.0,))[1]
    h = 1e-6
    ends = [np.linalg.eigvals(A + t * dA) for t in (h, -h)]
    ends = [end[end.imag > 1][np.argsort(end[end.imag > 1].imag)] for end in ends]
    by_imag = np.asarray(change)[upper]
    np.testing.assert_allclose(
        np.sort_complex(by_imag), np.sort_complex((ends[0] - s[upper].mean()) / h), rtol=1e-4
    )
    np.testing.assert_allclose(
        np.sort_complex(np.asarray(back)[upper]),
        np.sort_complex((ends[1] - s[upper].mean()) / h),
        rtol=1e-4,
    )
    total = jax.grad(lambda t: jnp.sum(jnp.where(s.imag > 1, values(t), 0.0)).real)(0.0)
    np.testing.assert_allclose(total, by_imag.sum().real, rtol=1e-9)
    assert np.isnan(jax.grad(lambda t: values(t)[upper[0]].real)(0.0))
    # the defective pair does not spoil it
    single = jax.grad(lambda t: values(t)[alone[0]].real)(0.0)
    np.testing.assert_allclose(single, np.asarray(change)[alone[0]].real, rtol=1e-9)
    x, y = (np.linalg.eig(B)[1][:, np.argmin(np.linalg.eig(B)[0].real)] for B in (A, A.T))
    np.testing.assert_allclose(single, ((y @ dA @ x) / (y @ x)).real, rtol=1e-6)


@pytest.mark.nan
def test_growth_and_free_motion_are_reported():
    """A negative stiffness grows; a mass that nothing holds has zero frequency and may have
    a damper."""
    for stiffness, status in ((-5.0, Status.UNSTABLE), (0.0, Status.SINGULAR_K)):
        spring = jb.Spring(
            ("mass", [0, 0, 0]),
            ("world", [0, 0, 1]),
            stiffness=1.0,
            free_length=1.0,
            damping=1.0,
            allow_negative=True,
        )
        model = jb.Model(
            bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
            joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
            elements={"s": spring},
        )
        model = jb.replace(model, {"s.stiffness": stiffness})
        lin = jb.linearize(model, model.reference)
        with pytest.warns(jb.JaxbodyWarning, match=status.name):
            result = jb.complex_modes(lin)
        assert int(result.status) == status
        poles = np.sort_complex(np.roots([1.0, 1.0, stiffness]))[::-1]
        assert max_difference(np.sort_complex(np.asarray(result.poles)[0])[::-1], poles) < 1e-12


# Spins


DISK = {"mass": 5.0, "inertia": [0.12, 0.12, 0.2]}
H, STIFF = 0.3, 4000.0


def rotor(inertia=(0.12, 0.12, 0.2), at=0.0, damping=0.0):
    """A free disk that turns about z, its points on the axis at +-H on springs along x and y (and
    one along z)."""
    elements = {}
    for end in (-1, 1):
        for i, d in enumerate(([1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, end])):
            ends = ("disk", [at, 0, end * H]), ("world", np.array(d) * 0.5 + [at, 0, end * H])
            elements[f"s{end}{i}"] = jb.Spring(
                *ends, stiffness=STIFF, free_length=0.5, damping=damping
            )
    return jb.Model(bodies={"disk": jb.Body(mass=5.0, inertia=inertia)}, elements=elements)


def spinning(model, speed):
    return jb.State(model.reference.q, jnp.zeros(6).at[5].set(speed))


@pytest.mark.nan
def test_a_rotor_whirls_forward_and_backward_as_in_closed_form():
    """I w^2 -+ P W w - k = 0 for turning across the axis, w = -+P W/(2 I) + sqrt((P W/(2
    I))^2 + k/I); the spin does not affect translation."""
    model, speed = rotor(), 80.0
    lin = jb.vibration.linearize_spin(model, spinning(model, speed))
    result = jb.complex_modes(lin)
    half, k = 0.2 * speed / (2 * 0.12), 4 * STIFF * H**2
    backward, forward = (sign * half + np.sqrt(half**2 + k / 0.12) for sign in (-1, 1))
    expected = np.sort(
        [0.0, np.sqrt(2 * STIFF / 5), *[np.sqrt(4 * STIFF / 5)] * 2, backward, forward]
    )
    print("whirl", max_difference(2 * np.pi * result.frequency, expected) / forward)
    assert max_difference(2 * np.pi * result.frequency, expected) < 1e-10 * forward
    assert lin.ok and result.ok and np.abs(np.asarray(result.decay_rate)).max() < 1e-9
    assert max_difference(lin.G, -lin.G.T) < 1e-12 and abs(lin.G[3, 4] - 0.2 * speed) < 1e-12
    sense = np.asarray(jb.vibration.whirl(lin, result))
    assert max_difference(sense[np.isin(expected, [backward, forward])], [-1.0, 1.0]) < 1e-9
    still = jb.vibration.linearize_spin(
        model, spinning(model, 0.0)
    )  # without a spin it is `linearize`
    plain = jb.linearize(model, model.reference)
    for a, b in (
        (still.M, plain.M),
        (still.C, plain.C),
        (still.K, plain.K),
        (still.G, 0 * plain.C),
    ):
        assert max_difference(a, b) < 1e-9


@pytest.mark.long
def test_a_free_spinning_disk():
    """A damper between two supports: what is left of a free disk is P W across its axis."""
    damper = jb.Spring(("base", [0, 0, 0]), ("stand", [0, 0, 0]), stiffness=STIFF, damping=9.0)
    supports = {"base": jb.Support(), "stand": jb.Support(position=[1, 0, 0])}
    with pytest.warns(jb.JaxbodyWarning, match="USELESS_SPRING"):
        model = jb.Model(
            bodies={"disk": jb.Body(**DISK)},
            supports=supports,
            elements={"damper": damper},
            gravity=[0, 0, 0],
        )
    lin = jb.vibration.linearize_spin(model, spinning(model, 30.0))
    G = np.zeros((6, 6))
    G[3, 4], G[4, 3] = 0.2 * 30.0, -0.2 * 30.0
    assert lin.ok and not lin.C.any() and not lin.K.any() and max_difference(lin.G, G) < 1e-12


@pytest.mark.nan
def test_unsteady_spins_are_reported():
    """Unequal moments, springs off the axis, a speed that is braked: time stands in
    the equations."""
    for model in (rotor(inertia=(0.1, 0.14, 0.2)), rotor(at=0.05)):
        with pytest.warns(jb.JaxbodyWarning, match="NOT_STEADY"):
            lin = jb.vibration.linearize_spin(model, spinning(model, 30.0))
        with pytest.warns(jb.JaxbodyWarning, match="NOT_STEADY"):
            result = jb.complex_modes(lin)
        assert np.isnan(np.asarray(result.frequency)).all() and "steady" in str(lin)
    assert (
        refused(jb.vibration.linearize_spin, model, jb.State(model.reference.q, jnp.zeros(5)))
        == "BAD_SHAPE"
    )


@pytest.mark.long
def test_a_rotor_on_a_hinge_of_a_carrier():
    """The same by other coordinates, and speeds where damping of the carrier leaves the frequencies
    a closed form: D = beta K of turning."""
    speed, beta = 80.0, 1e-3
    carried = rotor()
    model = jb.Model(
        bodies={
            "carrier": jb.Body(mass=2.0, inertia=[0.05, 0.05, 0.08]),
            "disk": jb.Body(mass=3.0, inertia=[0.07, 0.07, 0.09]),
        },
        joints={"disk": jb.Hinge("carrier", axis=[0, 0, 1])},
        elements={
            name: jb.Spring(
                ("carrier", spring.a),
                ("world", spring.b),
                stiffness=STIFF,
                free_length=0.5,
                damping=beta * STIFF,
            )
            for name in carried.element_names
            for spring in [carried[name]]
        }
        | {
            "stay": jb.Spring(
                ("carrier", [0.1, 0, 0]),
                ("world", [0.1, 0.5, 0]),
                stiffness=1000.0,
                free_length=0.5,
            )
        },
    )
    lin = jb.vibration.linearize_spin(
        model, jb.State(model.reference.q, jnp.zeros(7).at[6].set(speed))
    )
    result = jb.complex_modes(lin)
    k = 4 * STIFF * H**2
    for sign in (-1, 1):  # theta = x + i y:  I theta'' + (beta k - i P W) theta' + k theta = 0
        s = np.roots([0.12, beta * k - sign * 1j * 0.09 * speed, k])
        s = s[s.imag * sign > 0][0]
        s = s if sign > 0 else np.conj(s)
        nearest = np.argmin(np.abs(np.asarray(result.poles)[:, 0] - s))
        assert abs(np.asarray(result.poles)[nearest, 0] - s) < 1e-10 * abs(s)


@pytest.mark.long
def test_a_top_that_hangs_is_followed_over_its_speed():
    """J w^2 -+ P W w - m g l = 0: equal frequencies at rest part, one forward, one backward."""
    body = jb.Body(mass=1.0, inertia=[0.1, 0.1, 0.15], com=[0, 0, -1])
    model = jb.Model(bodies={"top": body}, joints={"top": jb.Ball("world")}, gravity=[0, 0, -9.81])
    speeds = np.linspace(0.0, 40.0, 5)
    result = jb.vibration.track_modes(
        lambda speed: jb.vibration.linearize_spin(
            model, jb.State(model.reference.q, jnp.array([0.0, 0.0, 1.0]) * speed)
        ),
        speeds,
    )
    half = 0.15 * speeds / (2 * 1.1)
    for sign in (-1, 1):
        w = sign * half + np.sqrt(half**2 + 9.81 / 1.1)
        assert (
            min(max_difference(2 * np.pi * column, w) for column in np.asarray(result.frequency).T)
            < 1e-9
        )


# Axes


@pytest.fixture(scope="module")
def engine():
    model = jb.presets.engine_on_mounts()
    return jb.linearize(model, model.reference)


def test_elastic_axes_satisfy_their_definition(engine):
    """A force along each, with its moment, moves the body along it and does not turn it; a couple
    along a torsional axis turns it about a parallel one."""
    result, flexibility = (
        jb.vibration.elastic_axes(engine, "engine"),
        np.linalg.inv(np.asarray(engine.K)),
    )
    for n, k, p, h in zip(
        result.directions.T, result.stiffness, result.points, result.pitch, strict=True
    ):
        moved = flexibility @ np.concatenate([k * n, np.cross(p, k * n) + h * k * n])
        assert max_difference(moved, np.concatenate([n, 0 * n])) < 1e-12
        assert abs(n @ (p - result.center)) < 1e-12  # nearest to the center
    for n, k in zip(result.torsional_directions.T, result.torsional_stiffness, strict=True):
        assert max_difference((flexibility @ np.concatenate([0 * n, k * n]))[3:], n) < 1e-12
    K, c = np.asarray(engine.K), np.asarray(result.center)
    there = K[3:, :3] - np.cross(np.eye(3), c) @ K[:3, :3]  # moments about the center
    assert max_difference(there, there.T) < 1e-9 * np.abs(K).max() and "torsional axis" in str(
        result
    )


@pytest.mark.long
def test_mounts_inclined_towards_a_point_decouple_there():
    """Two bushings, inclined by +-alpha at +-b, height 0 (focal mounts): coupling vanishes at the
    height b (kp - ks) sin cos/(kp sin^2 + ks cos^2) (Harris, ch. 3)."""
    alpha, b, kp, ks = 0.5, 0.4, 9e4, 2e4
    mounts = {}
    for side in (-1, 1):
        # its z axis leans inwards
        turn = [np.cos(side * alpha / 2), 0, -np.sin(side * alpha / 2), 0]
        mounts[f"m{side}"] = jb.Bushing(
            ("box", [side * b, 0, 0]),
            ("world", [side * b, 0, 0]),
            stiffness=[ks, ks, kp],
            orientation=turn,
            orientation_b=turn,
        )
    model = jb.Model(bodies={"box": jb.Body(mass=30.0, inertia=[1, 1, 1])}, elements=mounts)
    lin = jb.linearize(model, model.reference)
    result = jb.vibration.elastic_axes(lin, "box")
    height = (
        b
        * (kp - ks)
        * np.sin(alpha)
        * np.cos(alpha)
        / (kp * np.sin(alpha) ** 2 + ks * np.cos(alpha) ** 2)
    )
    along_x = int(np.argmax(np.abs(np.asarray(result.directions)[0])))
    assert abs(result.points[along_x, 2] - height) < 1e-12 and abs(result.pitch[along_x]) < 1e-12


def test_the_torque_roll_axis(engine):
    """J n ~ torque; a spin about it needs no other torque; decoupled where K is proportional
    to M."""
    result = jb.vibration.torque_roll_axis(engine, "engine", [2.0, 0, 0])
    n = np.linalg.solve(presets.ENGINE, [1.0, 0, 0])
    n /= np.linalg.norm(n)
    assert (
        max_difference(result.direction, n) < 1e-12
        and max_difference(result.point, np.zeros(3)) == 0
    )
    K = np.asarray(engine.K)[3:, 3:]
    assert (
        abs(result.inertia - n @ presets.ENGINE @ n) < 1e-12
        and abs(result.stiffness - n @ K @ n) < 1e-8
    )
    assert (
        abs(result.frequency - np.sqrt(n @ K @ n / (n @ presets.ENGINE @ n)) / (2 * np.pi)) < 1e-12
    )
    r, M = np.concatenate([np.zeros(3), n]), np.asarray(engine.M)
    left = np.asarray(engine.K) @ r - float(result.stiffness / result.inertia) * M @ r
    expected = np.sqrt(left @ np.linalg.solve(M, left) / (r @ M @ r)) / float(
        result.stiffness / result.inertia
    )
    assert abs(result.coupling - expected) < 1e-12 and expected > 0.1


def test_the_torque_roll_axis_of_a_turned_engine_with_its_reference_point_elsewhere():
    """R J^-1 R' torque, through the center of mass, in world axes."""
    R = Rotation.from_rotvec([0.4, -0.7, 0.2])
    com, torque = np.array([0.1, -0.2, 0.05]), np.array([200.0, 30.0, -10.0])
    body = jb.Body(
        mass=139.5,
        inertia=presets.ENGINE,
        com=com,
        position=[1, 2, 3],
        orientation=R.as_quat(scalar_first=True),
    )
    there = ("world", [1, 2, 3])
    mount = jb.Bushing(
        ("engine", [0, 0, 0]),
        there,
        stiffness=np.diag([1e5, 2e5, 3e5, 1e4, 2e4, 3e4]),
        orientation_b=R.as_matrix(),
    )
    model = jb.Model(bodies={"engine": body}, elements={"mount": mount})
    result = jb.vibration.torque_roll_axis(jb.linearize(model, model.reference), "engine", torque)
    n = R.apply(np.linalg.solve(presets.ENGINE, R.inv().apply(torque)))
    np.testing.assert_allclose(result.direction, n / np.linalg.norm(n), atol=1e-12)
    np.testing.assert_allclose(result.point - np.array([1, 2, 3]), R.apply(com), rtol=1e-11)


def test_axes_of_bodies_without_them_are_refused(engine):
    model = jb.presets.half_car()
    lin = jb.linearize(model, model.reference)
    assert (
        refused(jb.vibration.elastic_axes, lin, "body") == "NOT_FREE"
        and refused(jb.vibration.elastic_axes, engine, "motor") == "UNKNOWN_NAME"
    )
    assert refused(jb.vibration.torque_roll_axis, engine, "engine", [0, 0, 0]) == "ZERO_AXIS"
    assert refused(jb.vibration.torque_roll_axis, engine, "engine", [1, 0]) == "BAD_SHAPE"


# Modes compared and followed


def test_mac_by_its_definition():
    rng = np.random.default_rng(0)
    X, Y = rng.normal(size=(2, 4, 3)) + 1j * rng.normal(size=(2, 4, 3))
    W = np.cov(rng.normal(size=(4, 9)))
    result = jb.vibration.mac(X, Y, mass=W)
    for i in range(3):
        for j in range(3):
            x, y = X[:, i], Y[:, j]
            expected = abs(np.vdot(x, W @ y)) ** 2 / (
                np.vdot(x, W @ x).real * np.vdot(y, W @ y).real
            )
            assert abs(result[i, j] - expected) < 1e-12
    assert (
        refused(jb.vibration.mac, X, Y[:3]) == "BAD_SHAPE"
        and refused(jb.vibration.mac, X, Y, mass=W[:2]) == "BAD_SHAPE"
    )


@pytest.fixture(scope="module")
def crossing():
    """Three masses on perpendicular guides: independent frequencies."""
    axes = np.eye(3)
    model = jb.Model(
        bodies={f"m{i}": jb.Body(mass=1.0, inertia=[1, 1, 1]) for i in range(3)},
        joints={f"m{i}": jb.Guide("world", axis=axes[i]) for i in range(3)},
        elements={
            f"s{i}": jb.Spring(
                (f"m{i}", [0, 0, 0]), ("world", axes[i]), stiffness=100.0 * (i + 1), free_length=1.0
            )
            for i in range(3)
        },
    )

    def linearized(k):
        changed = jb.replace(model, {"s0.stiffness": k})
        return jb.linearize(changed, changed.reference)

    return linearized


@pytest.mark.long
@pytest.mark.parametrize(
    "values", [np.linspace(100, 400, 7), np.linspace(200, 400, 5), np.linspace(110, 390, 7)]
)
def test_modes_are_followed_through_crossings(crossing, values):
    """Also where a value lies on a crossing, also where the first one does."""
    result = jb.vibration.track_modes(crossing, values)
    assert result.ok.all() and result.frequency.shape == (len(values), 3)
    columns = 4 * np.pi**2 * np.asarray(result.frequency).T ** 2
    for expected in (values, 200.0 + 0 * values, 300.0 + 0 * values):
        assert min(max_difference(column, expected) for column in columns) < 1e-9 * 400
    assert np.asarray(result.mac).min() > 1 - 1e-9 and "least MAC" in str(result)


@pytest.mark.long
def test_following_is_differentiable(crossing):
    k = jnp.array([100.0, 250.0, 350.0])
    rows = jax.jacrev(lambda k: jb.vibration.track_modes(crossing, k).frequency)(k)
    slope = 1 / (4 * np.pi * np.sqrt(k))
    assert max_difference(rows[:, 0, :], np.diag(slope)) < 1e-12 and np.abs(rows[:, 1:]).max() == 0


@pytest.mark.long
def test_lost_branches_are_reported():
    def turned(angle):
        """The frame of two springs turns under a mass while they stay different: a quarter turn
        changes one mode into the other."""
        ends = [
            jnp.stack([jnp.cos(angle + a), jnp.sin(angle + a), 0 * angle]) for a in (0.0, np.pi / 2)
        ]
        model = jb.Model(
            bodies={"m": jb.Body(mass=1.0, inertia=[1, 1, 1])},
            joints={"m": jb.Translation("world")},
            elements={
                f"s{i}": jb.Spring(
                    ("m", [0, 0, 0]), ("world", end), stiffness=100.0 * (i + 1), free_length=1.0
                )
                for i, end in enumerate(ends)
            }
            | {
                "z": jb.Spring(
                    ("m", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=500.0, free_length=1.0
                )
            },
        )
        return jb.linearize(model, model.reference)

    with pytest.warns(jb.JaxbodyWarning, match="LOST_BRANCH"):
        result = jb.vibration.track_modes(turned, [0.0, 0.4, 1.3])
    assert np.asarray(result.status).tolist() == [0, 0, int(Status.LOST_BRANCH)]
    assert (
        refused(jb.vibration.track_modes, turned, [[0.0]]) == "BAD_SHAPE"
        and refused(jb.vibration.track_modes, turned, [0.0, np.nan]) == "NON_FINITE"
    )


@pytest.mark.long
def test_results_as_labelled_arrays_and_wrong_kinds(engine, crossing):
    pytest.importorskip("xarray")
    damped, energies, axes = (
        jb.complex_modes(engine),
        jb.vibration.mode_energies(engine),
        jb.vibration.elastic_axes(engine, "engine"),
    )
    followed = jb.vibration.track_modes(crossing, np.linspace(100, 400, 7))
    assert complex(damped.to_xarray()["pole"].sel(mode=2)[0]) == complex(damped.poles[1, 0])
    share = energies.to_xarray()["kinetic"].sel(body="engine", direction="about x", mode=6)
    assert float(share) == float(energies.kinetic["engine"][3, 5]) and share.attrs["units"] == "%"
    assert float(axes.to_xarray()["stiffness"].sel(elastic_axis=3)) == float(axes.stiffness[2])
    assert float(followed.to_xarray()["frequency"].sel(mode=1, value=100.0)) == float(
        followed.frequency[0, 0]
    )
    model = rotor()
    spun = jb.vibration.linearize_spin(model, spinning(model, 80.0))
    assert float(
        spun.to_xarray()["G"].sel(coordinate="disk turn about x", coordinate_2="disk turn about y")
    ) == float(spun.G[3, 4])
    # they would not see G
    for function in (
        jb.modes,
        jb.vibration.mode_energies,
        lambda lin: jb.vibration.elastic_axes(lin, "disk"),
    ):
        assert refused(function, spun) == "WRONG_KIND"
    assert refused(jb.complex_modes, model) == "WRONG_KIND"


@pytest.mark.long
def test_derivatives_of_poles_by_a_place_are_finite():
    """An arm on a spring at r from its hinge: w^2 = k r^2/J, dw/dr = w/r; the size of the model, by
    which poles are made alike, has no part in it."""
    model = jb.Model(
        bodies={"arm": jb.Body(mass=1.0, inertia=[1.0, 2.0, 1.0])},
        joints={"arm": jb.Hinge("world", axis=[0, 1, 0])},
        elements={
            "s": jb.Spring(
                ("arm", [0.5, 0, 0]), ("world", [0.5, 0, -1.0]), stiffness=80.0, free_length=1.0
            )
        },
    )

    def frequency(r):
        ends = {
            "s.a": jnp.array([1.0, 0, 0]) * r,
            "s.b": jnp.array([1.0, 0, 0]) * r + jnp.array([0, 0, -1.0]),
        }
        return jb.complex_modes(jb.linearize(jb.replace(model, ends), model.reference)).frequency[0]

    w = 0.5 * np.sqrt(80.0 / 2.0) / (2 * np.pi)
    np.testing.assert_allclose(frequency(0.5), w, rtol=1e-9)
    np.testing.assert_allclose(jax.jacfwd(frequency)(0.5), w / 0.5, rtol=1e-9)
