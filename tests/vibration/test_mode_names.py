"""Modes are named by their energies, in the same way in every result; modes of a pair of bodies
have different names."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import jaxbody as jb
from jaxbody.vibration.mode_names import MARK_NOTE, mode_names
from jaxbody.vibration.spins import SpinLinearization


@pytest.fixture(scope="module")
def car():
    car = jb.presets.full_car()
    return jb.linearize(car, car.reference)


@pytest.mark.long
def test_a_bouncing_body_is_not_named_by_the_arm_that_turns_with_it():
    """A body on an arm that carries the wheel: by shares of T from SciPy's shapes, of the body 300
    q0'^2/2, of the arm about its end what remains. In metres against radians the arm's angle,
    bounce over 0.4 m, is the larger component of both modes."""
    model = jb.Model(
        bodies={
            "body": jb.Body(mass=300.0, inertia=[1, 1, 1], position=[0, 0, 0.5]),
            "arm": jb.Body(
                mass=20.0, inertia=[0.1, 0.4, 0.4], com=[0.4, 0, 0], position=[0, 0, 0.3]
            ),
        },
        supports={"road": jb.Support()},
        joints={
            "body": jb.Guide("world", axis=[0, 0, 1]),
            "arm": jb.Hinge("body", axis=[0, 1, 0], at=[0, 0, -0.2]),
        },
        elements={
            "coil": jb.Spring(
                ("arm", [0.3, 0, 0]),
                ("body", [0.3, 0, 0.2]),
                stiffness=3e4,
                free_length=0.4,
                damping=300.0,
            ),
            "tyre": jb.Spring(
                ("arm", [0.4, 0, 0]), ("road", [0.4, 0, 0]), stiffness=2e5, free_length=0.3
            ),
        },
    )
    lin = jb.linearize(model, model.reference)
    _, phi = scipy.linalg.eigh(lin.K, lin.M)
    body = 100 * 300.0 * phi[0] ** 2  # phi' M phi = 1
    assert (np.argmax(np.abs(phi), axis=0) == 1).all() and body[0] > 90 > 10 > body[1]
    modes = jb.modes(lin)
    assert modes.names[0] == f"body along z {body[0]:.0f} %" and modes.names[1].startswith(
        "arm along z "
    )
    assert "turn about its hinge" not in str(modes) and modes.names[0] in str(modes)


@pytest.mark.long
def test_hop_and_tramp_have_names_of_their_own_everywhere(car):
    """The modes of an axle's two wheels, which move together in one and against each other in the
    other, by the signs of their shapes."""
    modes, damped = jb.modes(car), jb.complex_modes(car)
    rows = [
        [car.coordinates.index(f"{name} move along its guide") for name in axle]
        for axle in (("fl", "fr"), ("rl", "rr"))
    ]
    for computed in (modes, damped):
        named = set()
        for i in range(3, 7):
            shape = np.asarray(computed.shapes)[:, i]
            left, right = shape[max(rows, key=lambda axle: np.abs(shape[axle]).sum())]
            front = np.abs(shape[rows[0]]).sum() > np.abs(shape[rows[1]]).sum()
            one, other = ("fl", "fr") if front else ("rl", "rr")
            named.add(
                f"{one}, {other} bounce in phase"
                if (left * np.conj(right)).real > 0
                else f"{one} against {other} bounce"
            )
            assert computed.names[i].rpartition(" %")[0].rpartition(" ")[0] in named
        assert len(named) == 4 and "each" in computed.names[3]
        assert all(name in str(computed) for name in computed.names)
    energies = jb.vibration.mode_energies(car)
    assert energies.names == modes.names and all(name in str(energies) for name in modes.names)
    assert jb.vibration.mode_energies(car, forward="x").names[1] == "car pitch 85 %"


@pytest.mark.long
def test_branches_are_named_by_their_modes_at_the_first_value(car):
    half = jb.presets.half_car()
    computed = jb.vibration.track_modes(
        lambda k: jb.linearize(jb.replace(half, {"front spring.stiffness": k}), half.reference),
        [1.8e4, 2.6e4],
    )
    at_first = jb.replace(half, {"front spring.stiffness": 1.8e4})
    assert computed.names == jb.modes(jb.linearize(at_first, half.reference)).names
    assert f"at the first value 1: {computed.names[0]}; 2: {computed.names[1]}" in str(computed)


def on_springs(*stiffness, coupling=None):
    """Unit masses along x, each on its own spring, the first two coupled by another one."""
    names = [f"m{i}" for i in range(len(stiffness))]
    here = dict(free_length=0.0)
    springs = {
        f"s{i}": jb.Spring((f"m{i}", [0, 0, 0]), ("world", [i, 0, 0]), stiffness=k, **here)
        for i, k in enumerate(stiffness)
    }
    if coupling:
        springs["between"] = jb.Spring(
            ("m0", [0, 0, 0]), ("m1", [-1, 0, 0]), stiffness=coupling, **here
        )
    model = jb.Model(
        bodies={
            name: jb.Body(mass=1.0, inertia=[1, 1, 1], position=[i, 0, 0])
            for i, name in enumerate(names)
        },
        joints={name: jb.Guide("world", axis=[1, 0, 0]) for name in names},
        elements=springs,
    )
    return jb.linearize(model, model.reference)


@pytest.mark.long
def test_nearly_equal_frequencies_carry_a_mark():
    """1.6e-6 apart: 1e-5 of one stiffness moves shares by 40 points, which the mark says. Those
    that coincide have none: their energies are summed."""
    lin = on_springs(100.0, 100.0, 400.0, coupling=1.6e-4)
    modes, energies = jb.modes(lin), jb.vibration.mode_energies(lin)
    f = np.asarray(modes.frequency)
    np.testing.assert_allclose(f[1] / f[0] - 1, 1.6e-6, rtol=0.02)
    moved = jb.vibration.mode_energies(
        on_springs(100.0, 100.0 * (1 + 1e-5), 400.0, coupling=1.6e-4)
    )
    assert abs(float(moved.kinetic["m0"][0, 0] - energies.kinetic["m0"][0, 0])) > 40
    for computed in (modes, energies, jb.complex_modes(lin)):
        assert [name.endswith(" ~") for name in computed.names] == [True, True, False]
        assert MARK_NOTE in str(computed)
    assert (
        modes.names[0] == "m0, m1 along x in phase 50 % each ~"
        and modes.names[1] == "m0 against m1 along x 50 % each ~"
    )
    equal = jb.modes(on_springs(100.0, 100.0, 400.0))
    assert equal.names == ("m0 along x 50 % (one of 2)",) * 2 + (
        "m2 along x 100 %",
    ) and "~" not in str(equal)


def test_phases_and_many_bodies_in_words():
    """By hand: a quarter of a period apart is neither; of more than four bodies that are alike the
    first is named."""

    def name(velocities):
        v = np.zeros((len(velocities), 6, 1), complex)
        v[:, 0, 0] = velocities
        shares = 100 * np.abs(v) ** 2 / np.sum(np.abs(v) ** 2)
        directions = tuple(f"{how} {axis}" for how in ("along", "about") for axis in "xyz")
        return mode_names(
            tuple("abcdefg"[: len(velocities)]), directions, shares, v, np.zeros(1, int), np.ones(1)
        )[0]

    assert name([1, 1j]) == "a, b along x out of phase 50 % each"
    assert name([1, -0.8]) == "a against b along x 61, 39 %"
    assert name([1, -1, 1, -1]) == "a, c against b, d along x 25 % each"
    assert name([1, 0.1]) == "a along x 99 %"
    assert name([1, 1, 1, 1, 1]) == "a and 4 more along x 20 %"
    assert name([np.nan, 1]) == ""


@pytest.mark.long
def test_a_damping_ratio_that_is_rounding_prints_as_zero(car):
    modes = jb.modes(car)
    dusty = eqx.tree_at(lambda m: m.damping_ratio, modes, modes.damping_ratio.at[0].set(1.9e-33))
    row = repr(dusty).splitlines()[2].split()
    assert row[2] == "0" and "e-33" not in str(dusty)


def test_printing_modes_compiles_nothing(car):
    modes, damped = jb.modes(car), jb.complex_modes(car)
    again = jb.modes(jb.linearize(jb.replace(car.model, {"car.mass": 900.0}), car.state))
    with jb.compile_times() as times:
        str(modes), str(damped), repr(modes), str(again), again.report()
    assert times.count == 0


@pytest.mark.long
def test_what_is_no_linearization_is_refused_with_what_to_give(car):
    """Modes, a model or an equilibrium in its place; a rotor's linear system has complex
    modes only."""
    modes = jb.modes(car)
    for given, what in ((modes, "a Modes"), (car.model, "a Model"), ([car], "a list")):
        with pytest.raises(
            jb.JaxbodyError,
            match=(
                rf"mode_energies.lin: is {what} .*Give linearize\(model, "
                r"equilibrium\(model\)\).*WRONG_KIND"
            ),
        ):
            jb.vibration.mode_energies(given)
    with pytest.raises(
        jb.JaxbodyError, match=r"modes.lin: is a SpinLinearization .*Use complex_modes"
    ):
        jb.modes(
            SpinLinearization(
                car.M,
                car.C,
                car.K,
                car.status,
                car.state,
                car.model,
                car.basis,
                car.C,
                car.K,
                car.K[0],
            )
        )


@pytest.mark.long
def test_batches_of_modes_print_a_summary(car):
    computed = eqx.filter_vmap(
        lambda k: jb.modes(jb.linearize(jb.replace(car.model, {"car.mass": k}), car.state))
    )(jnp.array([800.0, 900.0]))
    assert "array 2 x 7" in str(computed)
