"""Matrices and motions by the definition, `lagrange.py`, beside the structured forms, over random
models of every kind, with derivatives in a random direction of all their numbers."""

import warnings

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from random_mechanics import Structure

import jaxbody as jb

MATRICES = [letter + block for letter in "MCK" for block in ("", "_tilde", "_bb")]
SEEDS = 40  # so that either test has 200 models
# ropes; closures; bushings; laws that relax
LONG = [pytest.param(shape, marks=pytest.mark.long) for shape in (5, 6, 8, 11)]
SHAPES = [1, *LONG]  # the first: two joints, a law with memory, torsion springs


@pytest.fixture(autouse=True)
def without_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)  # random numbers are implausible ones
        yield


def cases(shape, seeds):
    """A model, a direction of its numbers, and a state, for each seed."""
    structure = Structure(4 * shape + shape % 4)
    for seed in range(seeds):
        model, rng = structure.model(seed), structure.rng(seed, "direction")
        state = structure.state(seed, model)
        state = jb.State(
            state.q, state.v, state.z + 0.1 * structure.size(seed) * rng.normal(size=state.z.shape)
        )
        yield (
            structure,
            seed,
            model,
            jax.tree_util.tree_map_with_path(
                lambda path, x, rng=rng: changed(rng, str(path[-1]), x), model
            ),
            state,
        )


def changed(rng, name, x):
    """A change of a number by some tenths; directions are turned, and matrices of inertia,
    stiffness and damping stay symmetric."""
    if name in (".axis", ".directions"):
        return jnp.cross(0.1 * rng.normal(size=x.shape), x)
    factor = 0.1 * rng.normal(size=x.shape)
    return x * (
        factor + np.swapaxes(factor, -1, -2)
        if x.ndim > 1 and x.shape[-1] == x.shape[-2]
        else factor
    )


def loads(structure, seed):
    """On the last body: a force and a moment that turn with it, and one that does not."""
    rng, size = structure.rng(seed, "load"), structure.size(seed)
    place = structure.bodies[-1], size * rng.normal(size=3)
    turning = {"force": 10 * size * rng.normal(size=3), "moment": 10 * size**2 * rng.normal(size=3)}
    return {
        "follower": jb.Force(place, axes="body", **turning),
        "dead": jb.Force(place, force=10 * size * rng.normal(size=3)),
    }


def both(of):
    """of(model, ...) and its derivative in a direction, for the structured form and
    the definition."""
    return jb.jit(
        lambda how, model, direction, *more: jax.jvp(
            lambda model: of(how, model, *more), (model,), (direction,)
        )
    )


def assert_alike(found, limit):
    """Values or derivatives of both, each relative to the largest number of its kind."""
    one, other = found
    for name, x in one.items():
        scale = max(
            float(jnp.abs(y).max(initial=0.0)) for key, y in one.items() if key[0] == name[0]
        )
        assert np.isfinite(np.asarray(x)).all(), name
        np.testing.assert_allclose(other[name], x, rtol=0, atol=limit * scale, err_msg=name)


@pytest.mark.parametrize("shape", SHAPES)
def test_matrices_are_the_hessians_of_the_definition(shape):
    matrices = both(
        lambda how, model, state: {
            name: getattr(jb.linearize(model, state, method=how), name) for name in MATRICES
        }
    )
    for _, _, model, direction, state in cases(shape, SEEDS):
        values, slopes = zip(
            *(matrices(how, model, direction, state) for how in ("structured", "definition")),
            strict=True,
        )
        assert_alike(values, 1e-12)
        assert_alike(slopes, 1e-9)


@jb.jit
def fastest(model, state):
    """No less than the rate of any motion, vibrating or creeping [1/s]."""
    lin = jb.linearize(model, state).instantaneous
    by_K, by_C = (jnp.max(jnp.sum(jnp.abs(jnp.linalg.solve(lin.M, H)), 1)) for H in (lin.K, lin.C))
    return jnp.maximum(jnp.sqrt(by_K), by_C)


@pytest.mark.parametrize("shape", SHAPES)
def test_motions_are_those_of_the_lagrangian(shape):
    """Two radians of a fast motion on a shaking base, under loads, in the same forty steps: one
    that an error chooses differs by rounding, and a derivative after a kink of hysteresis depends
    on it."""
    steps = {"stepsize_controller": diffrax.ConstantStepSize(), "adjoint": diffrax.ForwardMode()}

    def motion_of(how, model, state, times, motion, acting):
        step = (times[1] - times[0]) / 20
        done = jb.simulate(
            model,
            times,
            motion=motion,
            loads=acting,
            initial=state,
            equations=how,
            dt0=step,
            **steps,
        )
        return {"q": done.state.q, "v": done.state.v, "z": done.state.z}

    motions = both(motion_of)
    for structure, seed, model, direction, state in cases(shape, SEEDS):
        rng, size, w = (
            structure.rng(seed, "base"),
            structure.size(seed),
            float(fastest(model, state)),
        )
        shaking = jb.Harmonic(
            frequency=w / 20,
            translation=0.05 * size * rng.normal(size=3),
            rotation=0.05 * rng.normal(size=3),
        )
        more = state, jnp.linspace(0, 2 / w, 3), {"base": shaking}, loads(structure, seed)
        values, slopes = zip(
            *(motions(how, model, direction, *more) for how in ("structured", "lagrange")),
            strict=True,
        )
        assert_alike(values, 1e-9)
        assert_alike(slopes, 1e-9)


class Rubbing(jb.laws.Hysteretic):
    """Friction with a state whose force depends on the rate too."""

    level: jax.Array

    def rate(self, e, e_dot, z):
        return 50.0 * e_dot - jnp.abs(e_dot) * z * 20.0

    def restoring_force(self, e, e_dot, z):
        return self.level * z[0] + 3.0 * e_dot * (1 + e**2)


def test_forces_without_a_potential_beside_others_in_one_element():
    """A spring, a branch that relaxes and two kinds of hysteresis act along one line: each enters
    Lagrange's equations once."""
    laws = jb.laws.Linear(400.0) + jb.laws.Maxwell(stiffness=300.0, relaxation_time=0.2)
    laws = (
        laws
        + jb.laws.BoucWen(alpha=90.0, beta=2.0, gamma=0.8, delta=-0.3)
        + Rubbing(jnp.array(7.0))
    )
    model = jb.Model(
        bodies={"ball": jb.Body(2.0, [1, 1, 1])},
        joints={"ball": jb.Translation("base")},
        supports={"base": jb.Support()},
        elements={
            "s": jb.SpringDamper(
                ("ball", [0, 0, 0]),
                ("world", [0, 0.3, 1]),
                spring=laws,
                damper=5.0,
                free_length=0.8,
            )
        },
    )
    state = jb.State([0.1, -0.2, 0.3], [1.0, 2.0, -0.5], [0.1, 3.0, -0.4])
    motion = {"base": jb.Harmonic(frequency=2.0, translation=[0.02, 0, 0.01])}
    one, other = (
        jb.simulate(model, [0.0, 0.05, 0.1], motion=motion, initial=state, equations=how)
        for how in ("structured", "lagrange")
    )
    np.testing.assert_allclose(other.state.v, one.state.v, rtol=0, atol=1e-8)
    lins = [jb.linearize(model, state, method=how) for how in ("structured", "definition")]
    assert_alike([{name: getattr(lin, name) for name in MATRICES} for lin in lins], 1e-12)
    np.testing.assert_allclose(other.state.z, one.state.z, rtol=0, atol=1e-7)
    with pytest.raises(jb.JaxbodyError, match=r"structured or lagrange.*BAD_METHOD"):
        jb.simulate(model, [0.0, 1.0], equations="hamilton")
    with pytest.raises(jb.JaxbodyError, match=r"structured or definition.*BAD_METHOD"):
        jb.linearize(model, state, method="hamilton")
