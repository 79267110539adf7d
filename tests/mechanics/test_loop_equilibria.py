"""Several equilibria and preloads of closed loops: a slider-crank of one freedom against roots
found by scipy, a corner against its energy over travel."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
from scipy.optimize import brentq

import jaxbody as jb
from jaxbody.lagrange import potential_energy
from jaxbody.suspension.assemblies import drives_of, position

G = 9.81
# lengths, and where the spring of the slider ends on its line [m]
CRANK, COUPLER, END = 0.2, 0.3, 0.8
WEIGHT, STIFFNESS, FREE = 4.0 * G, 300.0, 0.45


def slider_crank():
    """Drawn stretched out along x; the coupler's end slides along x and is pushed by a spring."""
    spring = jb.Spring(
        ("coupler", [COUPLER, 0, 0]), ("world", [END, 0, 0]), stiffness=STIFFNESS, free_length=FREE
    )
    return rigs.slider_crank({"spring": spring}, crank=CRANK, coupler=COUPLER)


def place(a, side):
    """The slider's x for the crank's angle, on the right or on the left; both centers of mass are
    at half the height of the pin."""
    return CRANK * np.cos(a) + side * np.sqrt(COUPLER**2 - (CRANK * np.sin(a)) ** 2)


def slope(a, side):
    return -CRANK * np.sin(a) - side * CRANK**2 * np.sin(a) * np.cos(a) / np.sqrt(
        COUPLER**2 - (CRANK * np.sin(a)) ** 2
    )


def energy(a, side):
    return WEIGHT * CRANK / 2 * np.sin(a) + STIFFNESS / 2 * (END - place(a, side) - FREE) ** 2


def moment(a, side, free=FREE):
    """dV/da."""
    return WEIGHT * CRANK / 2 * np.cos(a) - STIFFNESS * (END - place(a, side) - free) * slope(
        a, side
    )


def roots():
    """(energy, whether stable) of all equilibria, in order of energy."""
    grid = np.linspace(-np.pi, np.pi, 2000) + 0.01
    found = []
    for side in (1, -1):
        values = moment(grid, side)
        for i in np.flatnonzero(np.sign(values[:-1]) != np.sign(values[1:])):
            a: Any = brentq(moment, grid[i], grid[i + 1], args=(side,), xtol=1e-14)
            found.append((energy(a, side), moment(a + 1e-6, side) > moment(a - 1e-6, side)))
    return sorted(found)


@pytest.mark.long
def test_all_equilibria_of_a_slider_crank_are_found_on_both_of_its_branches():
    expected = roots()
    assert len(expected) == 6 and sum(stable for _, stable in expected) == 3
    result = jb.find_equilibria(slider_crank(), starts=32)
    np.testing.assert_allclose(result.energies, [e for e, _ in expected], rtol=1e-9)
    assert result.stable.tolist() == [stable for _, stable in expected]
    assert result.negative.tolist() == [int(not stable) for _, stable in expected]
    for eq in result.solutions:
        a = float(eq.state.q[0])
        side = np.sign(np.cos(a + float(eq.state.q[1])))
        assert abs(moment(a, side)) < 1e-8
        assert float(eq.energy) == pytest.approx(energy(a, side), rel=1e-10)


@pytest.mark.long
def test_the_preload_of_a_slider_crank_balances_its_weight():
    """W L/2 cos a = k (d - l) dx/da, at the nearest configuration that is closed."""
    model, pose = slider_crank(), jb.State(jnp.array([0.5, -1.0]), jnp.zeros(2))

    def of(x):
        """By the mass of the coupler and by its length."""
        changed = jb.replace(
            model,
            {
                "coupler.mass": 3.0 + x[0],
                "slider.b": jnp.array([COUPLER, 0, 0]) + jnp.array([0.1, 0, 0]) * x[1],
            },
        )
        result = jb.preload(changed, pose)
        return result.free_lengths["spring.free_length"], result

    length, result = of(jnp.zeros(2))
    a, b = np.asarray(result.state.q)
    assert CRANK * np.sin(a) + COUPLER * np.sin(a + b) == pytest.approx(0.0, abs=1e-14)
    tension = WEIGHT * CRANK / 2 * np.cos(a) / slope(a, 1)
    assert result.ok and float(length) == pytest.approx(
        END - place(a, 1) - tension / STIFFNESS, rel=1e-12
    )
    np.testing.assert_allclose(
        jb.equilibrium(result.model, start=result.state).state.q, [a, b], atol=1e-9
    )
    value = jax.jit(lambda x: of(x)[0])
    zero = jnp.zeros(2)
    forward, reverse = jax.jit(jax.jacfwd(value))(zero), jax.jit(jax.grad(value))(zero)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    assert float(forward[0]) == pytest.approx(
        -G * CRANK / 2 * np.cos(a) / slope(a, 1) / STIFFNESS, rel=1e-9
    )
    h = 1e-3
    steps = [zero.at[i].set(h) for i in range(2)]
    differences = [
        (8 * (value(s) - value(-s)) - value(2 * s) + value(-2 * s)) / (12 * h) for s in steps
    ]
    np.testing.assert_allclose(forward, differences, rtol=1e-6)


@pytest.mark.long
def test_a_coordinate_that_may_move_takes_the_others_along():
    """The crank goes to the angle of equilibrium for the spring that is there."""
    pose = jb.State(jnp.array([0.9, -1.5]), jnp.zeros(2))
    result = jb.preload(slider_crank(), pose, free=[], moving="crank*")
    a: Any = brentq(moment, 0.6, 1.4, args=(1,), xtol=1e-14)
    assert result.ok
    assert float(result.state.q[0]) == pytest.approx(a, abs=1e-10)
    assert CRANK * np.sin(a) + COUPLER * np.sin(a + float(result.state.q[1])) == pytest.approx(
        0.0, abs=1e-10
    )


@pytest.mark.long
def test_a_pose_that_cannot_be_closed_is_reported():
    far = jb.replace(slider_crank(), {"slider.a": jnp.array([0, 0.9, 0])})
    with pytest.warns(jb.JaxbodyWarning, match=r"NOT_CLOSED"):
        assert not jb.preload(far).ok
    with pytest.warns(jb.JaxbodyWarning, match=r"NOT_CONVERGED"):
        assert not len(jb.find_equilibria(far, starts=4))


@pytest.mark.long
def test_the_spring_of_a_corner_carries_its_weight_over_its_travel():
    """dV/dz = 0 over the travel of the wheel."""
    corner = jb.suspension.double_wishbone()
    drawn, names = corner.model, corner.model.layout.bodies
    model = jb.Model(
        bodies={name: drawn[name] for name in names},
        joints={name: drawn.joint(name) for name in names} | {"rack": jb.Fixed("world")},
        closures={name: drawn[name] for name in drawn.closure_names},
        elements={"spring": drawn["spring"]},
        gravity=[0, 0, -G],
    )
    drives = drives_of(
        model, {"travel": jb.Position(corner.wheel.on, corner.wheel.center, axis="z")}, "test"
    )

    def energy_at(model, travel):
        q = position(model, drives, travel[None], model.reference.q)
        return potential_energy(model, jb.State(q, jnp.zeros(model.layout.nv)))

    slope = jax.jit(jax.grad(energy_at, 1))
    center = jnp.asarray(corner.wheel.center)[2]
    result = jb.preload(model)
    assert result.ok and abs(float(slope(model, center))) > 1e3
    assert abs(float(slope(result.model, center))) < 1e-9 * float(jnp.abs(slope(model, center)))


@pytest.mark.long
def test_a_preload_of_a_loop_that_is_drawn_open_follows_a_length():
    """The pose is the assembled one, by a movement that leaves a freedom."""
    place = np.array([0.25, 0.05, 0.1])
    model = jb.Model(
        bodies={
            "input": jb.Body(1.0, [1, 1, 1]),
            "output": jb.Body(1.0, [1, 1, 1], position=place),
        },
        joints={
            "input": jb.Hinge("world", axis="z"),
            "output": jb.Hinge("world", axis="y", at=place),
        },
        elements={
            "s": jb.Spring(
                ("input", [0.1, 0, 0]), ("world", [0, 0.4, 0.1]), stiffness=50.0, free_length=0.2
            )
        },
        closures={
            "rod": jb.closures.Rod(("input", [0.1, 0, 0]), ("output", [0.2, 0, 0]), length=0.35)
        },
    )
    value, h = lambda length: jb.preload(jb.replace(model, {"rod.length": length})).values[0], 1e-5
    difference = (value(0.35 + h) - value(0.35 - h)) / (2 * h)
    for of in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(jax.jit(of(value))(0.35), difference, rtol=1e-7)
