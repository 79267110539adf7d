"""Runs of simple operations become kernels of XLA, results are those of NumPy, and all other operations stand between them."""

import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.compilation import few_kernels
from jaxbody.compilation.array_functions import compiled_with
from jaxbody.compilation.compile_options import BRIEF, brief_options
from jaxbody.compilation.few_kernels import LARGEST, MARKS, OPTIONS, in_few_kernels
from jaxbody.core.jax_internals import programs_inside

MARK = "xla_cpu_small_call"

pytestmark = pytest.mark.skipif(few_kernels.jaxlib_version() < (0, 10), reason="an older XLA was not tried")
X = np.random.default_rng(0).normal(size=(3, 3))


def kernels(function, *args, platform="cpu"):
    """How many kernels a program is lowered to."""
    return jax.jit(in_few_kernels(function)).trace(*args).lower(lowering_platforms=(platform,)).as_text().count(MARK)


def results(function, *args):
    return jax.tree.map(np.asarray, jax.jit(in_few_kernels(function), compiler_options=OPTIONS)(*args))


@pytest.mark.everywhere
def test_a_program_of_simple_operations_is_one_kernel_also_for_xla():
    def simple(x, steps):
        def step(i, y):
            return jax.lax.cond(i % 2 == 0, lambda: y @ x, lambda: y + jnp.tanh(x).sum(0))

        return {"y": jax.lax.fori_loop(0, steps, step, x), "norm": jax.jit(jnp.sum)(x * x)}

    compiled = jax.jit(in_few_kernels(simple), compiler_options=OPTIONS).lower(X, 3).compile()
    entry = compiled.as_text().split("ENTRY")[1]
    assert entry.count(" call(") == 1 and MARK in entry and " fusion(" not in entry, "XLA no longer heeds the attribute: see few_kernels.py"
    found = compiled(X, 3)
    y = (X @ X + np.tanh(X).sum(0)) @ X
    np.testing.assert_allclose(found["y"], y, rtol=1e-13, atol=1e-13 * np.abs(y).max())
    np.testing.assert_allclose(found["norm"], (X**2).sum(), rtol=1e-14)


def test_lapack_stands_between_two_kernels():
    def with_lapack(x):
        return jax.jit(lambda x: jnp.linalg.eigh(x, symmetrize_input=False)[0] * jnp.sin(x).sum())(x + x.T)

    assert kernels(with_lapack, X) == 2
    np.testing.assert_allclose(results(with_lapack, X), np.linalg.eigvalsh(X + X.T) * np.sin(X + X.T).sum(), atol=1e-12)


@pytest.mark.parametrize(
    ("operation", "function"),
    [
        ("sort", lambda x: jnp.sort(x)),
        ("scatter-add", lambda x: x.at[np.array([0, 2, 0])].add(1.0)),
        ("broadcast_in_dim", lambda x: jnp.full(LARGEST + 1, x[0, 0])),
        ("dot_general", lambda x: jnp.tile(x, (20, 20)) @ jnp.tile(x, (20, 20))),
        ("pure_callback", lambda x: jax.pure_callback(lambda x: x, jax.ShapeDtypeStruct((3, 3), float), x)),
        ("while", lambda x: jax.lax.while_loop(lambda s: s[0] < 2, lambda s: (s[0] + 1, jnp.sort(s[1])), (0, x))[1]),
    ],
)
def test_what_one_function_cannot_do_well_stands_alone(operation, function):
    def among_others(x):
        return jnp.cos(function(jnp.sin(x)))

    names = [equation.primitive.name for equation in jax.make_jaxpr(in_few_kernels(among_others))(X).eqns]
    assert names.count(operation) == 1 and "kernel" in names and not {"sin", "jit"} & set(names)
    np.testing.assert_allclose(results(among_others, X), np.cos(function(jnp.sin(X))), rtol=1e-12)


@pytest.mark.parametrize(
    ("operation", "function"),
    [
        ("scan", lambda x: jax.lax.scan(lambda s, row: (s + jnp.sort(jnp.sin(row)), s * row), jnp.zeros(3), x)),
        ("cond", lambda x: jax.lax.cond(x[0, 0] > 9, lambda: jnp.cos(x).sum(0), lambda: jnp.sort(jnp.sin(x)).sum(0))),
    ],
)
def test_steps_and_branches_with_other_operations_have_kernels_inside(operation, function):
    (equation,) = (e for e in jax.make_jaxpr(in_few_kernels(function))(X).eqns if e.primitive.name == operation)
    assert any(inner.primitive.name == "kernel" for program in programs_inside(equation) for inner in program.eqns)
    for ours, theirs in zip(jax.tree.leaves(results(function, X)), jax.tree.leaves(function(jnp.asarray(X))), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-15)


@pytest.mark.everywhere
def test_a_kernel_that_uses_none_of_its_arguments_does_not_end_the_process():
    """XLA does where the arguments are not among the results."""
    script = f"""
import jax, jax.numpy as jnp
from jaxbody.compilation.few_kernels import OPTIONS, in_few_kernels

def unused(x, y, n):
    kept = jax.lax.cond(n > 2, lambda: jnp.zeros(3), lambda: x * 0 + jax.lax.slice(jnp.pad(y, 3), (0,), (3,)))
    return jnp.where(jnp.array([True] * 3), kept[::-1][::-1], y)

print(jax.jit(in_few_kernels(unused), compiler_options={OPTIONS!r})(jnp.ones(3), jnp.ones(3), 2))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=Path(__file__).parents[2])
    assert done.stdout == "[0. 0. 0.]\n", done.stderr


def test_other_devices_have_no_kernels():
    assert kernels(jnp.sin, X) == 1 and kernels(jnp.sin, X, platform="cuda") == 0


@pytest.mark.everywhere
def test_short_programs_have_them_where_xla_has_no_option():
    """With jaxlib 0.10 an option does the same, so that programs are compiled as a whole."""
    few = few_kernels.jaxlib_version() in few_kernels.VERSIONS
    assert few != ("xla_cpu_use_fusion_emitters" in brief_options())
    text = compiled_with(BRIEF, lambda x: jnp.sin(x) + 1).lower(X).as_text()
    assert all((f'{name} = "{value}"' in text) == few for name, value in MARKS.items())


def test_derivatives_and_batches_of_drivers_are_the_same(monkeypatch):
    """In few kernels and in many; those of each are compared with differences elsewhere."""
    car = jb.presets.quarter_car(damping=1500.0)

    def first(k):
        model = jb.replace(car, {"suspension.stiffness": k})
        return jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]

    k = np.array([1.9e4, 2e4, 2.2e4])
    whole = jax.jit(lambda k: (jax.vmap(first)(k), jax.grad(first)(k[1])))
    several, slope = whole(k)
    few_several, few_slope = results(lambda k: (jax.vmap(first)(k), jax.grad(first)(k[1])), k)
    np.testing.assert_allclose(few_several, several, rtol=1e-12)
    np.testing.assert_allclose(few_slope, slope, rtol=1e-10)
