"""Energies and dissipations of the user's own, functions of frames: beside the spring or damper
that they write out, and wrong ones."""

import re

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

MATRICES = [letter + block for letter in "MCK" for block in ("", "_tilde", "_bb")]
A, B = np.array([0.1, 0, 0]), np.array([0, 0.5, 0.2])


class Pull(eqx.Module):
    """The energy of a spring between two points."""

    stiffness: jax.Array = jb.field("N/m", "positive")
    free_length: jax.Array = jb.field("m")
    body: str = eqx.field(static=True, default="plate")

    def __call__(self, frames):
        return (
            self.stiffness
            * (
                jnp.linalg.norm(frames[self.body].point(A) - frames["base"].point(B))
                - self.free_length
            )
            ** 2
            / 2
        )


class Drag(eqx.Module):
    """The dissipation of a damper along the line between two points."""

    coefficient: jax.Array = jb.field("N s/m", "nonnegative")

    def __call__(self, frames):
        plate, base = frames["plate"], frames["base"]
        d = plate.point(A) - base.point(B)
        return (
            self.coefficient
            * (d / jnp.linalg.norm(d) @ (plate.velocity(A) - base.velocity(B))) ** 2
            / 2
        )


def plate(pulled, **more):
    """A plate on a support by four springs and what pulls it."""
    ends = [
        ([0.3, 0.1, 0], [0.3, 0.1, 0.5]),
        ([-0.3, 0.1, 0], [-0.3, 0.3, 0.6]),
        ([0, -0.3, 0], [0, -0.4, 0.7]),
        ([0, 0.3, 0.2], [0.5, -0.4, 0.7]),
    ]
    springs = {
        f"s{i}": jb.Spring(("plate", a), ("base", b), stiffness=800.0 + 90 * i, free_length=0.45)
        for i, (a, b) in enumerate(ends)
    }
    bodies, supports = (
        {"plate": jb.Body(mass=3.0, inertia=[0.3, 0.9, 1.2])},
        {"base": jb.Support(position=[0.1, 0.2, 0])},
    )
    return jb.Model(
        bodies=bodies, supports=supports, elements=springs | pulled, gravity=[0, 0, -9.81], **more
    )


@pytest.fixture(scope="module")
def models():
    """With a spring and damper of jaxbody, and with its energy and dissipation."""
    spring = jb.Spring(("plate", A), ("base", B), stiffness=600.0, free_length=0.35, damping=20.0)
    return plate({"x": spring}), plate(
        {}, energies={"x": Pull(600.0, 0.35)}, dissipations={"drag": Drag(20.0)}
    )


def assert_alike(one, other, limit):
    """Relative to the largest number of each."""
    for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(y, x, rtol=0, atol=limit * float(jnp.abs(x).max(initial=1e-300)))


def test_rest_matrices_excitation_and_motion_are_those_of_a_spring(models):
    rests = [jb.equilibrium(model) for model in models]
    assert_alike(*([eq.state.q, eq.energy, eq.reactions] for eq in rests), 1e-12)
    lins = [jb.linearize(model, rests[0].state) for model in models]
    lins.append(jb.linearize(models[1], rests[0].state, method="definition"))
    of_structured, *others = ({name: getattr(lin, name) for name in MATRICES} for lin in lins)
    for of in others:
        assert_alike(of_structured, of, 1e-12)
    assert_alike(
        *(
            jb.excitation(model, rests[0].state, {"base": [0.02, 0.01, 0, 0.1, 0, 0]})
            for model in models
        ),
        1e-12,
    )
    motion = {"base": jb.Harmonic(frequency=2.0, translation=[0.02, 0, 0.01], rotation=[0.1, 0, 0])}
    steps = {
        "stepsize_controller": diffrax.ConstantStepSize(),
        "dt0": 0.01,
        "initial": rests[0].state,
    }
    runs = [jb.simulate(model, np.linspace(0, 0.5, 6), motion=motion, **steps) for model in models]
    assert_alike(*([run.state, run.energies, run.powers, run.reactions] for run in runs), 1e-12)


def test_shares_losses_and_the_split_have_a_place_for_them(models):
    one, other = (jb.linearize(model, jb.equilibrium(model)) for model in models)
    of_spring = one.K_elastic_by_element["x"] + one.K_geometric_by_element["x"]
    # of a free body the whole Hessian is in its displacements
    assert_alike(of_spring, other.K_elastic_by_element["x"], 1e-12)
    assert_alike(one.K_elastic + one.K_geometric, other.K_elastic + other.K_geometric, 1e-12)
    shares = [jb.vibration.mode_energies(lin) for lin in (one, other)]
    total = [sum(each.strain.values()) + sum(each.other_strain.values()) for each in shares]
    assert_alike(*total, 1e-10)
    np.testing.assert_allclose(shares[1].dissipation["drag"], 100.0, rtol=1e-10)
    run = jb.simulate(
        models[1],
        [0.0, 0.1, 0.2],
        motion={"base": jb.Harmonic(frequency=2.0, translation=[0, 0, 0.02])},
    )
    assert_alike(run.lost_powers["drag"], run.powers["damping"], 1e-12)
    assert (
        set(run.elongations) == set(run.forces) == {"s0", "s1", "s2", "s3"}
        and run.lost_powers["x"].max() == 0
    )


def test_derivatives_and_batches_by_its_numbers(models):
    def frequencies(model, k):
        model = jb.replace(model, {"x.stiffness": k})
        return jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency

    found = [
        jb.jit(jax.vmap(jax.jacfwd(lambda k, model=model: frequencies(model, k))))(
            jnp.array([500.0, 600.0])
        )
        for model in models
    ]
    assert_alike(*found, 1e-9)
    slope = jb.jit(jax.grad(lambda k: frequencies(models[1], k)[0]))(600.0)
    np.testing.assert_allclose(slope, found[0][1, 0], rtol=1e-9)


def test_one_class_many_times_and_a_bare_function(tmp_path):
    """Two bodies side by side: each on a Pull and a bare function of its own, one of the body
    alone, one of the world too."""
    bodies = {name: jb.Body(mass=2.0, inertia=[1, 1, 1]) for name in ("left", "right")}
    joints = {name: jb.Guide("world", axis=[0, 0, 1]) for name in bodies}
    pulls = {f"{name} pull": Pull(500.0 + len(name), 0.3, name) for name in bodies}
    lifted = {
        "lift": lambda frames: 1000.0 * (frames["right"].p[2] - frames["world"].p[2]) ** 2,
        "floor": lambda frames: 50 * frames["left"].p[2] ** 2,
    }
    model = jb.Model(
        bodies=bodies,
        joints=joints,
        supports={"base": jb.Support()},
        gravity=[0, 0, -9.81],
        energies=pulls | lifted,
    )
    K = jb.linearize(model, model.reference).K
    second = jax.jacfwd(
        jax.grad(lambda z, k: k * (jnp.linalg.norm(jnp.array([0, 0, z]) + A - B) - 0.3) ** 2 / 2)
    )
    np.testing.assert_allclose(
        K, np.diag([second(0.0, 504.0) + 100.0, second(0.0, 505.0) + 2000.0]), rtol=1e-12
    )
    assert (
        model.energy_names == ("left pull", "right pull", "lift", "floor")
        and not model.element_names
    )
    for row in (
        r"left pull +left, base +504 +0.3",
        r"right pull +right, base +505 +0.3",
        r"lift +right, world",
    ):
        assert re.search(row, str(model)), row
    without = jb.replace(
        model,
        {"lift": lambda frames: 0 * frames["right"].p[2], "left pull": Pull(700.0, 0.3, "left")},
    )
    np.testing.assert_allclose(
        jb.linearize(without, model.reference).K,
        np.diag([second(0.0, 700.0) + 100.0, second(0.0, 505.0)]),
        rtol=1e-12,
    )
    with pytest.raises(
        jb.JaxbodyError, match=r"energies.lift: is a function of your own Python.*OWN_CODE"
    ):
        jb.write_model(model, tmp_path / "model.toml", allow=[__name__])


def test_files_hold_energies_of_allowed_modules(models, tmp_path):
    path = tmp_path / "plate.toml"
    with pytest.raises(
        jb.JaxbodyError,
        match=(
            rf"(?s)energies.x: is a Pull from {__name__}.*dissipations.drag: "
            rf".*allow=\['{__name__}'\]"
        ),
    ):
        jb.write_model(models[1], path)
    jb.write_model(models[1], path, allow=[__name__])
    again = jb.read_model(path, allow=[__name__])
    assert jax.tree.structure(again) == jax.tree.structure(models[1])
    assert all(map(np.array_equal, jax.tree.leaves(again), jax.tree.leaves(models[1])))
    with pytest.raises(jb.JaxbodyError, match=r"energies\.x\.type: names the module .*NOT_ALLOWED"):
        jb.read_model(path)
    path.write_text(path.read_text().replace("stiffness = 600.0", 'stiffness = "0.7 N/mm"'))
    assert float(jb.read_model(path, allow=[__name__])["x"].stiffness) == pytest.approx(
        700.0, rel=1e-15
    )
    path.write_text(path.read_text().replace('"0.7 N/mm"', "-1.0"))
    with pytest.raises(jb.JaxbodyError, match="NOT_POSITIVE"):
        jb.read_model(path, allow=[__name__])


WRONG = {
    "vector": (
        lambda frames: frames["plate"].p,
        r"energies\['vector'\]: returns shape \(3,\).*BAD_SHAPE",
    ),
    "name": (
        lambda frames: frames["plat"].p[2],
        r"frame 'plat' is unknown .*Did you mean 'plate'.*UNKNOWN_BODY",
    ),
    "root": (
        lambda frames: jnp.linalg.norm(frames["plate"].p),
        r"slopes that are not finite in the reference pose.*NON_FINITE",
    ),
    "numpy": (
        lambda frames: np.sin(frames["plate"].p[0]),
        r"cannot be traced by JAX.*NOT_TRACEABLE",
    ),
    "constant": (lambda frames: 3.0, r"reads no frame"),
    "speed": (
        lambda frames: frames["plate"].v[0] ** 2,
        r"AttributeError: 'Pose' object has no attribute 'v'",
    ),
    "class": (Pull, r"is the class Pull .*Write Pull\(\.\.\.\)"),
    "text": (Pull("hard", 0.3), r"energies\['text'\]\.stiffness: is 'hard'.*NOT_A_NUMBER"),
    "sign": (Pull(-1.0, 0.3), r"energies\['sign'\]\.stiffness: is -1 N/m .*NOT_POSITIVE"),
    "s0": (Pull(1.0, 0.3), r"is also the name of one of the elements.*DUPLICATE_NAME"),
}


def test_all_that_is_wrong_is_said_at_once():
    with pytest.raises(jb.JaxbodyError) as raised:
        plate({}, energies={name: function for name, (function, _) in WRONG.items()})
    message = str(raised.value)
    assert len(raised.value.problems) == len(WRONG)
    for _, said in WRONG.values():
        with pytest.raises(AssertionError, match=said):
            raise AssertionError(message)
    with pytest.raises(jb.JaxbodyError, match=r"energies: is a Pull \(allowed: a dict"):
        plate({}, energies=Pull(1.0, 0.3))


def test_sensors_of_forces_do_not_read_them(models):
    with pytest.raises(jb.JaxbodyError, match=r"'x' is unknown.*s0"):
        jb.measure(jb.simulate(models[1], [0.0, 0.1]), {"cell": jb.sensors.LoadCell("x")})


def test_pictures_and_files_of_results_leave_them_out(models, tmp_path):
    run = jb.simulate(models[1], [0.0, 0.1])
    jb.write_results(run, tmp_path / "run.zip", allow=[__name__])
    assert_alike(jb.read_results(tmp_path / "run.zip", allow=[__name__]).state, run.state, 1e-15)
    drawn = {
        part.path[1]
        for part in jb.view(run, forces=True).animation.parts
        if part.path[0] == "elements"
    }
    assert (
        drawn
        == {"s0", "s1", "s2", "s3"}
        == {line.get_label() for line in jb.plots.plot_forces(run).lines}
    )
    jb.plots.draw_model(models[1])
