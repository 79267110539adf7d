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
from jaxbody.compilation.array_functions import compiled_with, known_to_xla
from jaxbody.compilation.compile_options import BRIEF
from jaxbody.compilation.few_kernels import LARGEST, MARKS, OPTIONS, in_few_kernels
from jaxbody.compilation.program_parts import programs_inside
from jaxbody.numerics.xla_workarounds import any_of_batch, kept, sum_p

MARK = "xla_cpu_small_call"

pytestmark = [
    pytest.mark.skipif(few_kernels.jaxlib_version() < (0, 10), reason="an older XLA was not tried"),
    pytest.mark.skipif(few_kernels.debugging(), reason="who looks for NaN has no kernels"),
]
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
        ("custom_linear_solve", lambda x: jnp.linalg.solve(x + 9 * np.eye(3), x)),
    ],
)
def test_what_one_function_cannot_do_well_stands_alone(operation, function):
    def among_others(x):
        return jnp.cos(function(jnp.sin(x)))

    names = [equation.primitive.name for equation in jax.make_jaxpr(in_few_kernels(among_others))(X).eqns]
    assert names.count(operation) == 1 and "kernel" in names and not {"sin", "jit"} & set(names)
    np.testing.assert_allclose(results(among_others, X), np.cos(function(jnp.sin(X))), rtol=1e-12)


def of_one_number(x):
    i, z, lax = (100 * x).astype(int), jax.lax.complex(x, 1 - x), jax.lax
    one = (
        jnp.abs(x), jnp.arccos(x), jnp.arccosh(1 + x), jnp.arcsin(x), jnp.arcsinh(x), jnp.arctan(x), jnp.arctan2(x, z.imag), jnp.arctanh(x),
        jnp.cbrt(x), jnp.ceil(9 * x), lax.clamp(0.2, x, 0.6), jnp.conj(z), lax.cos(x), jnp.cosh(x), x / z.imag, x == 0.5, lax.erf(x),
        lax.erf_inv(x), lax.erfc(x), jnp.exp(z), jnp.exp2(x), jnp.expm1(x), jnp.floor(9 * x), x >= 0.5, x > 0.5, x**3, jnp.isfinite(1 / x),
        x <= 0.5, jnp.log(x), jnp.log1p(x), lax.logistic(x), x < 0.5, jnp.maximum(x, 0.5), jnp.minimum(x, 0.5), x != 0.5, -x,
        jnp.nextafter(x, 2.0), ~i, (i > 3) & (i < 60), i | 3, i ^ 5, x**z.imag, z.real * z, i % 7, jnp.round(9 * x), lax.rsqrt(x),
        jnp.where(x > 0.5, x, i), i << 2, i >> 2, lax.shift_right_logical(i, i // 30), jnp.sign(x - 0.5), jnp.sin(z), jnp.sinh(x),
        jnp.sqrt(x), jnp.square(x), lax.stop_gradient(x), x - i, jnp.tan(x), jnp.tanh(z), lax.add(x, x), lax.copy_p.bind(x),
    )  # fmt: skip
    return [jnp.asarray(y) for y in one]


def of_many_numbers(x):
    i, lax = jnp.argmin(x), jax.lax
    return [
        jnp.argmax(x), i, jnp.broadcast_to(x, (2, *x.shape)), jnp.concatenate([x, x]), lax.cummax(x), lax.cummin(x), lax.cumprod(x),
        lax.cumsum(x), jnp.outer(x, x) @ x, lax.dynamic_slice(x, (i,), (3,)), lax.dynamic_update_slice(x, x[:2], (i,)),
        jnp.expand_dims(x, 1), x[np.array([3, 0, 3])], jnp.arange(5.0) + lax.iota(int, 5), jnp.pad(x, 2), jnp.all(x > 0), jnp.any(x > 0.9),
        jnp.max(x), jnp.min(x), jnp.prod(x), jnp.sum(x), lax.reduce(x, 0.0, lambda a, b: a + 2 * b - b, (0,)), jnp.outer(x, x).reshape(-1),
        x[::-1], x[1:5:2], *jnp.split(x, 2), jnp.outer(x, x)[:1].squeeze(0), jnp.stack([x, 2 * x]), jnp.outer(x, 2 * x).T,
        sum(jnp.unstack(jnp.outer(x, x))), any_of_batch(x > 0.5), kept(x), sum_p.bind(x, axes=(0,)),
        jax.grad(lambda x: jnp.sum(jnp.sin(x) * x))(x),
    ]  # fmt: skip


@pytest.mark.everywhere
@pytest.mark.parametrize("function", [of_one_number, of_many_numbers])
def test_every_operation_that_a_kernel_may_hold_has_the_results_of_jax(function):
    """Operation by operation; elementary functions of XLA's two ways differ by a few round-offs."""
    x = np.linspace(0.05, 0.95, 16)
    assert kernels(function, x) == 1
    for i, (ours, theirs) in enumerate(zip(results(function, x), function(jnp.asarray(x)), strict=True)):
        np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-15, err_msg=str(i))


def test_they_are_all_tried():
    tried = {
        e.primitive.name
        for function in (of_one_number, of_many_numbers)
        for e in equations(jax.make_jaxpr(function)(np.linspace(0.05, 0.95, 16)).jaxpr)
    }
    assert few_kernels.SIMPLE - {*few_kernels.CALLS, *few_kernels.BODIES, "cond", "custom_linear_solve"} <= tried


def equations(jaxpr):
    return [e for own in jaxpr.eqns for e in (own, *(e for program in programs_inside(own) for e in equations(program)))]


@pytest.mark.parametrize(
    ("operation", "function"),
    [
        ("scan", lambda x: jax.lax.scan(lambda s, row: (s + jnp.sort(jnp.sin(row)), s * row), jnp.zeros(3), x)),
        ("while", lambda x: jax.lax.while_loop(lambda s: s[0] < 2, lambda s: (s[0] + 1, jnp.sort(jnp.sin(s[1]))), (0, x))[1]),
        ("cond", lambda x: jax.lax.cond(x[0, 0] > 9, lambda: jnp.cos(x).sum(0), lambda: jnp.sort(jnp.sin(x)).sum(0))),
    ],
)
def test_loops_and_branches_with_other_operations_have_kernels_inside(operation, function):
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


def test_what_nothing_needs_is_left_out():
    def unneeded(x):
        jnp.zeros(3) + 1
        return jnp.sort(x)

    np.testing.assert_array_equal(results(unneeded, X), np.sort(X))
    assert kernels(unneeded, X) == 0


def test_who_debugs_sees_numbers():
    seen = []

    def watched(x):
        seen.append(x)
        return jnp.log(x)

    program = jax.jit(in_few_kernels(jax.jit(watched)))
    with jax.disable_jit():
        program(X)
    assert np.asarray(seen[-1]).shape == X.shape  # a traced array has none
    with jax.debug_nans(True), pytest.raises(FloatingPointError, match="nan"):
        program(-np.ones(3))


def test_other_devices_have_no_kernels():
    assert kernels(jnp.sin, X) == 1 and kernels(jnp.sin, X, platform="cuda") == 0


@pytest.mark.everywhere
def test_short_programs_have_them_where_xla_has_no_option():
    """With jaxlib 0.10 an option does the same, so that programs are compiled as a whole."""
    few = few_kernels.jaxlib_version() in few_kernels.VERSIONS
    assert few != ("xla_cpu_use_fusion_emitters" in known_to_xla(BRIEF))
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
