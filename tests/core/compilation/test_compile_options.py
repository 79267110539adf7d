"""jb.jit is jax.jit with options that compile quickly; a driver is one program, whose options
follow from the shapes of its arguments."""

import functools
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.compilation.compile_options import program, program_with
from jaxbody.model import models

pytestmark = pytest.mark.everywhere


def spring(k, x, power=1, name="spring"):
    """A force, an integer, a result without x, some that are no arrays: what drivers
    return, too."""
    return {
        "force": k * x**power + jnp.sin(k),
        "count": jnp.arange(power),
        "stiffness": k**2,
        "said": name,
        "power": power,
    }


def test_results_of_jit_are_those_of_the_function_whatever_they_hold():
    found, plain = (
        jb.jit(spring)(3.0, np.array([1.0, 2.0]), power=2, name="strut"),
        spring(3.0, np.array([1.0, 2.0]), 2, "strut"),
    )
    assert (found["said"], found["power"]) == ("strut", 2) and found["count"].tolist() == [0, 1]
    np.testing.assert_allclose(found["force"], plain["force"], rtol=1e-15)
    assert jb.jit(functools.partial(spring, 2.0))(1.0)["force"] == spring(2.0, 1.0)["force"]
    assert jb.jit(spring).__name__ == "spring" and jb.jit(spring).__doc__ == spring.__doc__


def test_new_floats_compile_nothing_and_other_words_do():
    traced = []
    force = jb.jit(lambda k, power: traced.append(power) or k**power)
    assert [float(force(k, 2)) for k in (1.0, 2.0, np.float64(3.0), jnp.asarray(4.0))] == [
        1,
        4,
        9,
        16,
    ]
    assert traced.count(2) <= 2  # a float of Python has a weak type
    assert float(force(2.0, 3)) == 8 and traced[-1] == 3
    one = jb.jit(lambda x: type(x).__name__)
    assert [one(1), one(True), one(1)] == ["int", "bool", "int"]  # equal, but not the same


# sin k + 8 k: with its derivatives by k
DERIVATIVES = [lambda k: 8 * k + np.sin(k), lambda k: 8 + np.cos(k), lambda k: -np.sin(k)]


def force(k):
    return jb.jit(spring)(k, jnp.asarray(2.0), 3)["force"]


@pytest.mark.parametrize(
    "inside",
    [force, lambda k: program(spring)(k, jnp.asarray(2.0), 3, "")["force"]],
    ids=["jit", "driver"],
)
def test_derivatives_and_batches_inside_and_outside_of_jit(inside):
    k = jnp.array([3.0, 5.0])
    ways = [
        (inside, 0),
        (jax.grad(inside), 1),
        (jax.jacfwd(inside), 1),
        (lambda k: jax.vjp(inside, k)[1](1.0)[0], 1),
        (jax.hessian(inside), 2),
    ]
    for way, order in ways:
        expected = DERIVATIVES[order](np.asarray(k))
        np.testing.assert_allclose(way(k[0]), expected[0], rtol=1e-14)
        for compiled in (jax.jit, jb.jit):
            np.testing.assert_allclose(compiled(way)(k[0]), expected[0], rtol=1e-14)
            np.testing.assert_allclose(compiled(jax.vmap(way))(k), expected, rtol=1e-14)
        np.testing.assert_allclose(jax.vmap(way)(k), expected, rtol=1e-14)
    scanned = jax.lax.scan(lambda carry, k: (carry + inside(k), None), 0.0, k)[0]
    np.testing.assert_allclose(scanned, DERIVATIVES[0](np.asarray(k)).sum(), rtol=1e-14)


def test_keys_of_random_numbers_are_arguments():
    drawn = jb.jit(lambda key, scale: scale * jax.random.normal(key, (2,)))
    keys = jax.random.split(jax.random.key(0), 3)
    np.testing.assert_allclose(
        jax.vmap(drawn, (0, None))(keys, 2.0),
        [2 * jax.random.normal(key, (2,)) for key in keys],
        rtol=1e-14,
    )


class Seen(Exception):
    """Instead of compiling the program that is looked at."""


class Options(tuple):
    """Options of one name, which tell when a program is compiled by them."""

    def __new__(cls, name):
        return super().__new__(cls, ((name, True),))

    def keys(self):
        raise Seen(self[0][0])


def test_options_are_for_programs_by_themselves():
    """Elsewhere JAX refuses them."""
    driver = program_with(Options("own"))(spring)
    with pytest.raises(Seen, match="own"):
        driver(1.0, jnp.ones(()), 3, "")
    for inside in (jax.jit, jb.jit, jax.grad, jax.vmap):
        x = jnp.ones(3) if inside is jax.vmap else 1.0
        assert np.isfinite(inside(lambda k: driver(k, jnp.ones(()), 3, "")["force"])(x)).all()


def test_the_same_call_repeated_has_the_same_bits_and_compiles_nothing():
    model = jb.presets.quarter_car()
    run = lambda: jb.simulate(model, [0.0, 0.1]).state.v  # noqa: E731
    first = np.asarray(run())
    with jb.compile_times() as times:
        assert all(np.array_equal(run(), first) for _ in range(200))
    assert times.count == 0


@pytest.mark.parametrize(
    ("times", "long"),
    [
        (np.linspace(0, 10, 1000), False),
        (np.linspace(0, 10, 1001), True),
        (np.array([0.0, 30.0]), False),
        (np.array([5.0, 35.1]), True),
    ],
)
def test_long_motions_are_optimized(monkeypatch, times, long):
    for name in ("OPTIMIZED", "QUICK"):
        monkeypatch.setattr(models, name, Options(name))
    car = jb.presets.quarter_car()
    with pytest.raises(Seen, match="OPTIMIZED" if long else "QUICK"):
        jb.simulate(car, times, initial=car.reference)


SETTINGS = """
import gc, os, threading, warnings
import jax, numpy as np, optax, scipy.optimize  # which has filters of its own
import jaxbody as jb

jax.config.update("jax_enable_x64", True)
car = jb.presets.quarter_car(damping=1500.0)
jb.equilibrium(car)  # jax itself starts with it

def settings():
    threads = {thread.name for thread in threading.enumerate()}
    of_python = gc.get_threshold(), gc.isenabled(), gc.get_freeze_count(), threads, dict(os.environ), list(warnings.filters)
    return *of_python, np.geterr(), np.get_printoptions(), dict(jax.config.values)

times, before = np.linspace(0, 1, 21), settings()
run = dict(motion={"road": jb.Harmonic(frequency=2.0, translation=[0, 0, 0.01])}, sensors={"z": jb.Position("body", axis="z")})
read = jb.measure(jb.simulate(car, times, motion=run["motion"]), run["sensors"])
guess = jb.replace(car, {"suspension.stiffness": 3e4})
for method in (optax.lbfgs(), "least_squares"):
    assert jb.fit(guess, {"run": jb.Experiment(times, measured=read, noise=1e-4, **run)}, free="suspension.stiffness", method=method).ok
print([i for i, (x, y) in enumerate(zip(before, settings())) if x != y])
"""  # noqa: E501


def test_a_fit_leaves_the_settings_of_the_process_as_they_were():
    """Python's garbage collector, threads, environment and warnings, NumPy's settings and JAX's."""
    done = subprocess.run(
        [sys.executable, "-c", SETTINGS],
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ,
    )
    assert done.stdout == "[]\n", done.stdout + done.stderr


def test_results_have_no_weak_type_for_which_others_would_be_compiled_again():
    """A number of Python becomes one in a result of JAX, and batches lose it."""
    numbers = lambda x: (jnp.where(x > 0, 3, 5), 2.0 * jnp.ones(()), x)  # noqa: E731
    assert jax.jit(numbers)(jnp.ones(()))[0].aval.weak_type
    result = program(numbers)(jnp.ones(()))
    assert [x.aval.weak_type for x in result] == [False, False, False]
    assert [x.dtype for x in result] == [
        jnp.result_type(int),
        jnp.result_type(float),
        jnp.result_type(float),
    ]
