"""Short programs are compiled without optimization, long ones with it; what is compiled how is read from the call to XLA."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.compilation import compile_options, eager_programs, kept_programs
from jaxbody.compilation.array_functions import array_function
from jaxbody.designs.programs import values_and_slopes
from jaxbody.identification.residuals import residual_and_jacobian
from jaxbody.simulations.integrations import integrate


class Stop(Exception):
    """Instead of compiling the program that is looked at."""


@pytest.fixture
def optimized(monkeypatch):
    """optimized(name, calls, times=1): whether the program of a driver of this name is compiled with optimization by what `calls` it
    for the last of several times."""
    others = compile_options.call
    eager_programs.calls_of.cache_clear()

    def run(name, calls, times=1):
        levels = []

        def call(program, options, arrays):
            if program.__name__ != name:
                return others(program, options, arrays)
            levels.append(dict(options).get("xla_backend_optimization_level") != 0)
            raise Stop

        monkeypatch.setattr(compile_options, "call", call)
        monkeypatch.setattr(eager_programs, "call", call)
        monkeypatch.setattr(eager_programs, "compiled_by_jax", lambda arrays: False)  # ahead, in a thread
        for _ in range(times):
            with pytest.raises(Stop):
                calls()
        return levels[-1]

    return run


def model():
    return jb.presets.quarter_car()


@pytest.mark.parametrize(
    ("times", "long"),
    [
        (np.linspace(0, 10, 1000), False),
        (np.linspace(0, 10, 1001), True),
        (np.array([0.0, 30.0]), False),
        (np.array([5.0, 35.1]), True),
    ],
)
def test_short_motions_are_not_optimized(optimized, times, long):
    car = model()
    assert optimized(integrate.__name__, lambda: jb.simulate(car, times, initial=car.reference)) == long


@pytest.mark.parametrize(
    ("name", "transformed", "long"),
    [
        ("integrate_jvp", lambda loss: jax.jvp(loss, (2e4,), (1.0,)), False),
        ("integrate_pullback", lambda loss: jax.grad(loss)(2e4), False),
        ("integrate_batch", lambda loss: jax.vmap(loss)(2e4 * np.ones(16)), False),
        ("integrate_batch", lambda loss: jax.vmap(loss)(2e4 * np.ones(17)), True),
    ],
)
def test_derivatives_of_short_motions_are_not_optimized_and_large_batches_are(optimized, name, transformed, long):
    car = model()
    assert optimized(name, lambda: transformed(lambda k: motion(jb.replace(car, {"suspension.stiffness": k})))) == long


@pytest.mark.parametrize(("times", "often"), [(compile_options.OFTEN, False), (compile_options.OFTEN + 1, True)])
@pytest.mark.parametrize("gradient", [False, True])
def test_what_is_called_often_is_optimized(optimized, gradient, times, often):
    car = model()
    if gradient:
        slope = jax.grad(lambda k: motion(jb.replace(car, {"suspension.stiffness": k})))
        assert optimized("integrate_pullback", lambda: slope(2e4), times) == often
    else:
        assert optimized(integrate.__name__, lambda: motion(car), times) == often


def test_motions_with_closures_are_optimized(optimized):
    linkage = jb.presets.four_bar()
    assert optimized(integrate.__name__, lambda: jb.simulate(linkage, [0.0, 0.1], initial=linkage.reference))


def test_designs_with_closures_are_optimized(optimized):
    linkage = jb.presets.four_bar()
    assert optimized(
        values_and_slopes.__name__, lambda: jb.tune(linkage, lambda m: m["rocker"].mass, free=["rocker.mass"], minimize="objective")
    )


def motion(model):
    return jb.simulate(model, [0.0, 0.1], initial=model.reference).state.q[-1, 0]


def frequency(model):
    return jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]


def own_loop(model):
    return jax.lax.while_loop(lambda x: x < 1e6, lambda x: 2 * x, model["suspension"].stiffness)


def steps(model, n):
    return jax.lax.fori_loop(0, n, lambda i, x: x + jnp.sin(x), model["suspension"].stiffness)


@pytest.mark.everywhere  # JAX 0.7 could not differentiate such a motion
@pytest.mark.parametrize(
    ("function", "long"),
    [
        (frequency, False),
        (motion, True),
        (jax.jit(motion), True),
        (own_loop, True),
        (lambda model: steps(model, 10), False),
        (lambda model: steps(model, 1000), True),
    ],
)
def test_functions_of_a_user_with_loops_are_optimized(optimized, function, long):
    tuned = optimized(values_and_slopes.__name__, lambda: jb.tune(model(), function, free=["suspension.stiffness"], minimize="objective"))
    assert tuned == long


@pytest.mark.parametrize(("samples", "long"), [(200, False), (1001, True)])
def test_fits_of_short_records_are_not_optimized(optimized, samples, long):
    car = model()
    run = jb.Experiment(
        np.linspace(0, 2, samples),
        initial=car.reference,
        sensors={"body": jb.Position("body", axis="z")},
        measured={"body": np.sin(np.arange(samples))},
    )
    assert optimized(residual_and_jacobian.__name__, lambda: jb.fit(car, {"run": run}, free=["suspension.stiffness"])) == long


def test_whether_a_kept_program_has_loops_is_known_without_tracing_it(tmp_path, monkeypatch):
    monkeypatch.setattr(kept_programs, "_kept", kept_programs.KeptPrograms(tmp_path))
    program, types = array_function(jnp.linalg.norm, (np.zeros(3),))[0], (jax.typeof(np.zeros(3)),)
    assert [kept_programs.known(program, types, "loops", lambda fact=fact: fact) for fact in (True, False)] == [True, True]
    assert [kept_programs.known(program, types, "others", lambda fact=fact: fact) for fact in (False, True)] == [False, False]
