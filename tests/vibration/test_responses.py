"""Frequency response and state space: low-frequency limits, steady state, published vehicles and
absorbers, symmetry, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
import scipy.linalg
from rigs import max_difference

import jaxbody as jb

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")
BASE = {d: jb.BaseMotion("base", d) for d in DIRECTIONS}
POINT = np.array([0.1, -0.2, 0.3])
LOW = 1e-6  # Hz: inertia and damping change the static response of these rigs by less than 1e-9
jit_once = jb.jit  # compiling is the cost


def at_rest(model):
    eq = jb.equilibrium(model)
    return eq, jb.linearize(model, eq)


def uniform(n):
    return jb.Body(mass=1.0, inertia=np.full(3, n))


@pytest.fixture(scope="module")
def rig():
    """An arm on the base and a box on springs and a bushing, nothing symmetric."""
    model = rigs.rig(mount=rigs.MOUNT)
    return model, *at_rest(model)


OUTPUTS = {
    "point": jb.Position("box", POINT, axis=[1, 1, 0]),
    "turn": jb.sensors.Rotation("arm", axis="x"),
    "relative": jb.Position("arm", [0.1, 0, 0.2], axis="y", relative_to="box"),
    "elongation": jb.Elongation("s2"),
    "deformation": jb.Elongation("mount", component=4),
    "tension": jb.sensors.LoadCell("s3"),
    "bushing": jb.sensors.LoadCell("mount", component=1),
    "force": jb.sensors.Reaction("base", component=0),
    "moment": jb.sensors.Reaction("base", component=4),
}


def test_slow_translation_of_the_base_carries_everything_along():
    """Base translation at zero frequency is the identity, gravity or not."""
    _, lin = at_rest(rigs.plate(damping=2.0))
    outputs = {d: rigs.motion("plate", POINT, d) for d in DIRECTIONS}
    result = jb.frequency_response(lin, [LOW], BASE, outputs).values[:, :3, 0]
    assert max_difference(result, np.eye(6)[:, :3]) < 1e-9


def test_slow_rotation_of_the_base_carries_everything_along_without_gravity_only():
    """A point at r follows phi x r; under gravity the plate hangs as it did, so it does not."""
    outputs = {d: rigs.motion("plate", POINT, d) for d in DIRECTIONS}
    for gravity in (0.0, 9.81):
        eq, lin = at_rest(rigs.plate(damping=2.0, gravity=[0, 0, -gravity]))
        q = np.asarray(eq.state.q)
        r = q[:3] + rigs.turned(q[3:]) @ POINT  # the base is at the origin
        rigid = np.concatenate([np.cross(np.eye(3), r).T, np.eye(3)])
        error = max_difference(
            jb.frequency_response(lin, [LOW], BASE, outputs).values[:, 3:, 0], rigid
        )
        assert error < 1e-9 if gravity == 0 else error > 0.1


@pytest.mark.long
def test_bodies_attached_to_the_world_do_not_follow_the_base():
    """Two springs in line, of 30 N/m to the base and 10 N/m to the world: three quarters of the
    motion arrive."""
    springs = {
        name: jb.Spring(("mass", [0, 0, 0]), (on, to), stiffness=k, free_length=1.0)
        for name, on, to, k in (("b", "base", [0, 1, 0], 30.0), ("w", "world", [0, -1, 0], 10.0))
    }
    model = jb.Model(
        bodies={"mass": uniform(1.0)},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
        elements=springs,
    )
    _, lin = at_rest(model)
    result = jb.frequency_response(
        lin, [LOW], {d: BASE[d] for d in ("y", "rz")}, {"mass": jb.Position("mass", axis="y")}
    )
    assert max_difference(result.values[0, :, 0], [0.75, 0.0]) < 1e-12


@pytest.mark.long
def test_steady_motion_is_that_of_simulate(rig):
    """Base and force together, small, at five frequencies, once transients have died: readings of
    the nonlinear model to 1e-5."""
    stiff = {**rigs.PARAMETERS, "damping": 12 * rigs.PARAMETERS["damping"]}
    mount = {**rigs.MOUNT, "damping": 3 * np.diag([1.0, 1.2, 1.5, 0.4, 0.5, 0.6])}
    model = rigs.rig(stiff, mount=mount)
    eq, lin = at_rest(model)
    size, frequencies = 1e-6, np.array([0.4, 0.9, 1.5, 2.2, 3.5])
    inputs = {"x": BASE["x"], "ry": BASE["ry"], "pull": jb.PointForce("arm", [0.2, 0.1, 0.1], "y")}
    amplitudes = np.array([1.0, 2.0, 30.0])
    result = np.asarray(jb.frequency_response(lin, frequencies, inputs, OUTPUTS).values)
    slowest = np.abs(
        scipy.linalg.eigvals(np.asarray(lin.state_space(inputs, {"t": OUTPUTS["turn"]}).A)).real
    ).min()
    settled = np.log(1e8) / slowest
    steps = 64

    @jax.jit
    def steady(f):
        motion = {
            "base": jb.Harmonic(
                frequency=f,
                translation=size * np.array([1.0, 0, 0]),
                rotation=size * np.array([0, 2.0, 0]),
            )
        }
        pull = jb.Force(
            ("arm", [0.2, 0.1, 0.1]),
            force=jb.signals.Sine(amplitude=size * np.array([0, 30.0, 0]), frequency=f),
        )
        begin = jnp.ceil(settled * f) / f  # whole periods
        times = jnp.concatenate([jnp.zeros(1), begin + jnp.arange(steps) / (steps * f)])
        run = jb.simulate(
            model,
            times,
            motion=motion,
            loads={"pull": pull},
            initial=eq.state,
            rtol=1e-12,
            max_steps=200_000,
        )
        box, arm = run.poses["box"], run.poses["arm"]
        corner = box.p + box.R @ POINT
        at_arm, on_box = (
            arm.p + arm.R @ jnp.array([0.1, 0, 0.2]),
            eq_box.T @ (eq_arm @ jnp.array([0.1, 0, 0.2]) + p_arm - p_box),
        )
        relative = (at_arm - box.p - box.R @ on_box) @ eq_box  # in the axes of the box
        force, moment = run.reactions["base"]
        return jnp.stack(
            [
                corner @ jnp.array([1.0, 1, 0]) / 2**0.5,
                (arm.R @ eq_arm.T)[:, 2, 1],
                relative[:, 1],
                run.elongations["s2"],
                run.elongations["mount"][:, 4],
                run.forces["s3"],
                run.forces["mount"][:, 1],
                force[:, 0],
                moment[:, 1],
            ]
        )[:, 1:], run.status

    q = np.asarray(eq.state.q)
    p_box, eq_box = q[:3], rigs.turned(q[3:7])
    poses = jb.simulate(model, np.array([0.0, 1e-6]), initial=eq.state).poses["arm"]
    p_arm, eq_arm = poses.p[0], poses.R[0]
    for i, f in enumerate(frequencies):
        readings, status = steady(jnp.array(f))
        assert int(status) == 0
        measured = 2 * np.fft.fft(readings)[:, 1] / steps
        expected = size * result[:, :, i] @ amplitudes
        assert np.abs(measured / expected - 1).max() < 1e-5, f


@pytest.mark.long
def test_modal_sum_and_state_space_agree(rig):
    """To 1e-10 of the largest response; for each kind of base motion that has a state space."""
    _, _, lin = rig
    f = np.array([0.3, 1.1, 2.0, 7.0])
    kinds = {
        "displacement": ("point", "turn", "relative", "elongation", "deformation"),
        "acceleration": tuple(OUTPUTS),
    }
    for kind, names in kinds.items():
        inputs = {d: jb.BaseMotion("base", d, kind=kind) for d in ("x", "rx")} | {
            "pull": jb.PointForce("arm", POINT, "y")
        }
        outputs = {name: OUTPUTS[name] for name in names}
        if kind == "acceleration":
            outputs["felt"] = jb.Acceleration("box", POINT, axis="z")
        result = jb.frequency_response(lin, f, inputs, outputs)
        modal = jb.frequency_response(lin, f, inputs, outputs, method="modal")
        s = lin.state_space(inputs, outputs)
        assert (
            s.inputs == tuple(inputs) and s.outputs == tuple(outputs) and len(s.states) == len(s.A)
        )
        A, B, C, D = (np.asarray(x) for x in (s.A, s.B, s.C, s.D))
        direct = np.stack(
            [C @ np.linalg.solve(2j * np.pi * x * np.eye(len(A)) - A, B) + D for x in f], -1
        )
        size = np.abs(result.values).max(2, keepdims=True)
        assert (np.abs(modal.values - result.values) / size).max() < 1e-10
        assert (np.abs(direct - result.values) / size).max() < 1e-10


@pytest.mark.long
def test_an_output_of_derivatives_of_the_input_has_no_state_space(rig):
    _, _, lin = rig
    felt = {"felt": jb.Acceleration("box", POINT, axis="z")}
    with pytest.warns(jb.JaxbodyWarning, match=r"'felt' of 'x'.*acceleration of the support"):
        s = lin.state_space({"x": BASE["x"]}, felt)
    assert jb.Status(int(s.status)).name == "IMPROPER" and np.isnan(s.D).all()


def test_receptance_is_symmetric(rig):
    """From each of six forces to each of the motions that they work on, with hysteretic damping
    too: to 1e-12 of the largest."""
    _, _, lin = rig
    places = [
        ("box", POINT, "x"),
        ("box", (0, 0, 0), "ry"),
        ("arm", (0.2, 0.1, 0), "z"),
        ("arm", (0, 0, 0), "rx"),
        ("box", -POINT, [1, 2, 3]),
    ]
    inputs = {str(i): jb.PointForce(*place) for i, place in enumerate(places)}
    outputs = {str(i): rigs.motion(*place) for i, place in enumerate(places)}
    H = np.asarray(
        jb.frequency_response(lin, np.linspace(0.2, 5, 40), inputs, outputs, loss_factor=0.1).values
    )
    assert (np.abs(H - H.swapaxes(0, 1)).max((0, 1)) / np.abs(H).max((0, 1))).max() < 1e-12
    assert np.all(H.imag[0, 0] < 0)  # power is lost


@pytest.mark.long
def test_a_loss_factor_makes_the_stiffness_complex():
    """One mass on k = 50 N/m with eta: base to mass (1 + i eta)/(1 + i eta - r^2), the spring's
    force -k (1 + i eta) of its elongation."""
    model = jb.Model(
        bodies={"mass": uniform(1.0)},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
        elements={
            "s": jb.Spring(
                ("mass", [0, 0, 0]), ("base", [0, 1, 0]), stiffness=50.0, free_length=1.0
            )
        },
    )
    _, lin = at_rest(model)
    r = np.array([0.3, 1.0, 1.7])
    f, eta = r * np.sqrt(50.0) / (2 * np.pi), 0.2
    outputs = {
        "mass": jb.Position("mass", axis="y"),
        "force": jb.sensors.LoadCell("s"),
        "reaction": jb.sensors.Reaction("base", component=1),
    }
    T = (1 + 1j * eta) / (1 + 1j * eta - r**2)
    for given, method in ((eta, "direct"), ({"s": eta}, "modal")):
        result = jb.frequency_response(
            lin, f, {"y": BASE["y"]}, outputs, loss_factor=given, method=method
        )
        assert max_difference(result["mass", "y"], T) < 1e-12
        assert max_difference(result["force", "y"], 50 * (1 + 1j * eta) * (1 - T)) < 1e-10
        assert max_difference(result["reaction", "y"], 50 * r**2 * T) < 1e-10


def test_a_car_on_a_wavy_road():
    """Rao: m = 1200 kg, k = 400 kN/m, damping ratio 0.5, 20 km/h, waves of 6 m:
    r = 0.318652, X/Y = 1.100963."""
    m, k = 1200.0, 4e5
    model = jb.Model(
        bodies={"car": jb.Body(mass=m, inertia=[1, 1, 1], position=[0, 0, 0.5])},
        supports={"base": jb.Support()},
        joints={"car": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "s": jb.Spring(
                ("car", [0, 0, 0]),
                ("base", [0, 0, 0]),
                stiffness=k,
                free_length=0.5,
                damping=np.sqrt(k * m),
            )
        },
    )
    f = 20 / 3.6 / 6
    assert abs(2 * np.pi * f / np.sqrt(k / m) - 0.318652) < 1e-6
    result = jb.frequency_response(
        at_rest(model)[1], [f], {"z": BASE["z"]}, {"car": jb.Position("car", axis="z")}
    )
    assert abs(float(result.magnitude[0, 0, 0]) - 1.100963) < 1e-6


def test_fixed_points_of_an_absorber():
    """Den Hartog: at the best tuning 1/(1 + mu) all curves of X k/F over damping meet at
    sqrt(1 + 2/mu), at two frequencies."""
    mu, k = 0.05, 1000.0
    a = np.sqrt(mu / (2 + mu))
    r2 = (1 - a) / (1 + mu), (1 + a) / (1 + mu)
    model = jb.Model(
        bodies={
            "main": jb.Body(mass=1.0, inertia=[1, 1, 1]),
            "absorber": jb.Body(mass=mu, inertia=[1, 1, 1], position=[0, 0, 1.0]),
        },
        joints={name: jb.Guide("world", axis=[0, 0, 1]) for name in ("main", "absorber")},
        elements={
            "spring": jb.Spring(
                ("main", [0, 0, 0]), ("world", [0, 0, -1]), stiffness=k, free_length=1.0
            ),
            "own": jb.Spring(
                ("absorber", [0, 0, 0]),
                ("main", [0, 0, 0]),
                stiffness=mu * k / (1 + mu) ** 2,
                free_length=1.0,
                damping=1.0,
            ),
        },
    )
    f = np.sqrt(np.array(r2) * k) / (2 * np.pi)

    @jax.vmap
    def heights(c):
        lin = jb.linearize(jb.replace(model, {"own.damping": c}), model.reference)
        result = jb.frequency_response(
            lin, f, {"F": jb.PointForce("main")}, {"X": jb.Position("main", axis="z")}
        )
        return result.magnitude[0, 0] * k

    best = 2 * mu * np.sqrt(k) * np.sqrt(3 * mu / (8 * (1 + mu) ** 3))
    assert (
        max_difference(heights(jnp.array([0.01, best, 3.0])), np.full((3, 2), np.sqrt(1 + 2 / mu)))
        < 1e-9
    )


PLATE = rigs.plate(damping=2.0)
FOUR = np.array([0.6, 1.9, 2.7, 4.0])
UP = {"base": jb.BaseMotion("base", "z")}
CORNER = {
    "corner": jb.Acceleration("plate", [0.4, 0.3, 0.05], axis="z"),
    "s1": jb.sensors.LoadCell("s1"),
}


def measures(model):
    """Magnitudes of responses by both methods, with hysteresis too; rms over a band; comfort: of
    one model, through its equilibrium."""
    lin = jb.linearize(model, jb.equilibrium(model))
    direct = jb.frequency_response(lin, FOUR, UP, CORNER, loss_factor={"s1": 0.1}).magnitude.ravel()
    modal = jb.frequency_response(lin, FOUR, UP, CORNER, method="modal").magnitude.ravel()
    ride = jb.random_response(
        lin,
        jb.vibration.Band(0.2, 20.0, points=201),
        UP,
        CORNER,
        {"base": jb.vibration.PowerLaw(1e-4, unit="(m/s)2/Hz")},
    )
    return jnp.concatenate(
        [direct, modal, ride.rms, jb.vibration.weighted_response(ride, {"corner": "Wk"}).rms]
    )


@pytest.mark.long
def test_responses_have_the_derivatives_of_differences():
    """By every kind of number of the model in one backward pass: along a random direction of each,
    against central differences of the fourth order."""
    gradient = jax.tree.leaves(jit_once(jax.jacrev(measures))(PLATE))
    leaves, structure = jax.tree.flatten(PLATE)
    rng = np.random.default_rng(5)
    sizes = [max(float(jnp.abs(leaf).max(initial=0.0)), 0.1) for leaf in leaves]
    free = [
        i
        for i, (slope, size) in enumerate(zip(gradient, sizes, strict=True))
        if np.abs(slope).max(initial=0.0) * size > 1e-9
    ]
    assert len(free) >= 9  # mass, center, inertia, gravity, points, lengths, stiffness, damping
    # the truncation of differences, near resonance, falls below 1e-7; rounding is below it too
    h, points, slopes = 2e-5, [], []
    for i in free:
        tangent = rng.normal(size=leaves[i].shape) * sizes[i]
        slopes.append(np.tensordot(np.asarray(gradient[i]), tangent, tangent.ndim))
        for step in (-2, -1, 1, 2):
            points.append(
                [leaf + step * h * tangent if k == i else leaf for k, leaf in enumerate(leaves)]
            )
    batch = jax.tree.unflatten(structure, [jnp.stack(rows) for rows in zip(*points, strict=True)])
    values = np.asarray(jit_once(jax.vmap(measures))(batch)).reshape(len(free), 4, -1)
    differences = (8 * (values[:, 2] - values[:, 1]) - (values[:, 3] - values[:, 0])) / (12 * h)
    error = np.abs(np.array(slopes) - differences) / np.abs(differences).max(1, keepdims=True)
    print("derivatives of responses", error.max(1))
    assert error.max() < 1e-6
    one = measures(jax.tree.unflatten(structure, points[3]))
    np.testing.assert_allclose(values[0, 3], one, rtol=1e-9)  # a batch is its samples


@pytest.mark.long
def test_responses_have_derivatives_where_modes_coincide():
    """A square table on four equal isolators, one of them changed: the response is smooth where two
    frequencies meet."""
    table = jb.presets.isolated_table(
        gyration=(0.4, 0.4, 0.5),
        stiffness=(3e4, 3e4, 8e4),
        at=(0.4, 0.4, 0.25),
        damping=(60.0, 60.0, 100.0),
    )
    inputs, outputs = (
        {"x": jb.BaseMotion("floor", "x"), "z": jb.BaseMotion("floor", "z")},
        {"edge": jb.Position("table", [0.5, 0.2, 0], axis=[1, 2, 1])},
    )
    f = np.array([3.0, 5.0, 8.0])

    def magnitudes(k):
        lin = jb.linearize(jb.replace(table, {"isolator 1.stiffness": k}), table.reference)
        result = [
            jb.frequency_response(lin, f, inputs, outputs, method=method)
            for method in ("direct", "modal")
        ]
        return jnp.concatenate([response.magnitude.ravel() for response in result])

    k, h = jnp.array([3e4, 3e4, 8e4]), 30.0
    assert (
        float(jnp.abs(jnp.diff(jb.modes(jb.linearize(table, table.reference)).eigenvalues)).min())
        < 1e-6
    )
    unit = jnp.array([1.0, 0, 0])
    slope, value = jit_once(jax.jacrev(magnitudes))(k)[:, 0], jit_once(magnitudes)
    d = [np.asarray(value(k + step * h * unit)) for step in (-2, -1, 1, 2)]
    difference = (8 * (d[2] - d[1]) - (d[3] - d[0])) / (12 * h)
    assert max_difference(slope, difference) < 1e-6 * np.abs(difference).max()


@pytest.mark.long
def test_second_derivatives():
    """Forward over reverse against differences of the gradient: the response is nonlinear in
    its parameters."""
    model = jb.presets.quarter_car(damping=1800.0)

    def height(c):
        lin = jb.linearize(jb.replace(model, {"suspension.damping": c}), model.reference)
        return jb.frequency_response(
            lin,
            [1.4],
            {"road": jb.BaseMotion("road", "z")},
            {"body": jb.Position("body", axis="z")},
        ).magnitude[0, 0, 0]

    slope = jax.jit(jax.grad(height))
    second = float(jax.jit(jax.hessian(height))(1800.0))
    h = 1.0
    difference = float(slope(1800.0 + h) - slope(1800.0 - h)) / (2 * h)
    assert abs(second / difference - 1) < 1e-6


@pytest.mark.nan
def test_an_unstable_equilibrium_has_no_response():
    """A pendulum upside down, and one whose damping is negative."""
    bob = jb.Body(mass=1.0, inertia=[0.01, 0.01, 0.01], com=[0, 0, 0.5])
    up = jb.Model(
        bodies={"bob": bob},
        supports={"base": jb.Support()},
        joints={"bob": jb.Hinge("base", axis=[0, 1, 0])},
        gravity=[0, 0, -9.81],
    )
    lin = jb.linearize(up, up.reference)
    with pytest.warns(jb.JaxbodyWarning, match="UNSTABLE"):
        result = jb.frequency_response(
            lin, [1.0], {"x": BASE["x"]}, {"bob": jb.Position("bob", axis="z")}
        )
    assert np.isnan(result.values).all() and not result.ok
    with pytest.warns(jb.JaxbodyWarning, match="UNSTABLE"):
        ride = jb.random_response(
            lin,
            jb.vibration.Band(1, 2, points=17),
            {"x": BASE["x"]},
            {"bob": jb.Position("bob", axis="z")},
            {"x": jb.vibration.PowerLaw(1.0, unit="m2/Hz")},
        )
    assert np.isnan(ride.rms).all()
    with pytest.raises(jb.JaxbodyError, match="UNSTABLE"):
        ride.raise_if_failed()


@pytest.mark.long
def test_modes_that_coincide_and_are_damped_critically_are_flagged():
    """One mass, damping ratio 1: one eigenvector for two poles, which a sum over modes lacks;
    elimination does not."""
    spring = jb.Spring(
        ("mass", [0, 0, 0]),
        ("base", [0, 1, 0]),
        stiffness=50.0,
        free_length=1.0,
        damping=2 * np.sqrt(50.0),
    )
    model = jb.Model(
        bodies={"mass": uniform(1.0)},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
        elements={"s": spring},
    )
    _, lin = at_rest(model)
    f, outputs = np.array([0.5, 2.0]), {"mass": jb.Position("mass", axis="y")}
    s, w = 2j * np.pi * f, np.sqrt(50.0)
    exact = (2 * w * s + w**2) / (s + w) ** 2
    assert (
        max_difference(jb.frequency_response(lin, f, {"y": BASE["y"]}, outputs).values[0, 0], exact)
        < 1e-13
    )
    try:
        modal = jb.frequency_response(lin, f, {"y": BASE["y"]}, outputs, method="modal").values[
            0, 0
        ]
        assert max_difference(modal, exact) < 1e-7
    except jb.JaxbodyWarning as caught:
        assert caught.code == "DEFECTIVE"
