"""Derivatives and batches outside a jit are those inside one, in programs with the options of the function itself."""

import gc
import subprocess
import sys
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.compilation import compile_options, eager_programs
from jaxbody.compilation.compilations import listening
from jaxbody.compilation.compile_options import jit_unoptimized
from jaxbody.core import jax_internals

pytestmark = pytest.mark.everywhere

K = jnp.array([3.0, 5.0, 8.0])


@jit_unoptimized
def spring(k, x, power, count):
    """A force, an integer, a result without x, one that is no array: what drivers return, too."""
    force = k * x**power + jnp.sin(k)
    steps = jax.lax.while_loop(lambda i: i < count, lambda i: i + 1, 0)
    return {"force": force, "steps": steps, "stiffness": k**2, "said": "linear" if power == 1 else "more", "power": power}


def force(k, x=2.0):
    result = spring(k, jnp.asarray(x), 3, 4)
    assert (result["said"], result["power"]) == ("more", 3)
    return result["force"]


# sin k + 8 k: with its derivatives by k
DERIVATIVES = [lambda k: 8 * k + np.sin(k), lambda k: 8 + np.cos(k), lambda k: -np.sin(k), lambda k: -np.cos(k)]
WAYS = {
    "value": (lambda k: force(k), 0),
    "grad": (jax.grad(force), 1),
    "jacfwd": (jax.jacfwd(force), 1),
    "jacrev": (jax.jacrev(force), 1),
    "jvp": (lambda k: jax.jvp(force, (k,), (1.0,))[1], 1),
    "linearize": (lambda k: jax.linearize(force, k)[1](1.0), 1),
    "vjp": (lambda k: jax.vjp(force, k)[1](1.0)[0], 1),
    "jit of linearize": (lambda k: jax.jit(jax.linearize(force, k)[1])(1.0), 1),
    "jit of vjp": (lambda k: jax.jit(jax.vjp(force, k)[1])(1.0)[0], 1),
    "transposed": (lambda k: jax.linear_transpose(jax.linearize(force, k)[1], k)(1.0)[0], 1),
    "grad of a jit": (jax.grad(jax.jit(force)), 1),
    "grad of grad": (jax.grad(jax.grad(force)), 2),
    "hessian": (jax.hessian(force), 2),
    "jacrev of jacfwd": (jax.jacrev(jax.jacfwd(force)), 2),
    "grad of a linear function": (jax.grad(lambda k: jax.linearize(force, k)[1](1.0)), 2),
    "third": (jax.grad(jax.grad(jax.jacfwd(force))), 3),
}


@pytest.fixture(params=[False, True], ids=["members", "loop"])
def as_loop(request, monkeypatch):
    """Whether a batch of few members is a loop over them from the first call, or calls of the function for each member."""
    eager_programs.calls_of.cache_clear()
    if request.param:
        monkeypatch.setattr(eager_programs, "OFTEN", 0)
    return request.param


@pytest.mark.long
@pytest.mark.usefixtures("as_loop")
@pytest.mark.parametrize("way", WAYS)
def test_derivatives_and_their_batches_are_right(way):
    derivative, order = WAYS[way]
    expected = DERIVATIVES[order](np.asarray(K))
    np.testing.assert_allclose(derivative(K[0]), expected[0], rtol=1e-14)
    np.testing.assert_allclose(jax.jit(derivative)(K[0]), expected[0], rtol=1e-14)
    np.testing.assert_allclose(jax.vmap(derivative)(K), expected, rtol=1e-14)
    summed = jax.grad(lambda k: jax.vmap(derivative)(k).sum())(K) if order < 3 else None
    if summed is not None:
        np.testing.assert_allclose(summed, DERIVATIVES[order + 1](np.asarray(K)), rtol=1e-13)


@pytest.mark.usefixtures("as_loop")
def test_axes_of_batches_and_shared_results():
    k, x = jnp.stack([K, 2 * K]), jnp.array([1.0, 2.0])
    arrays = lambda k, x: {name: y for name, y in spring(k, x, 1, 4).items() if isinstance(y, jax.Array)}  # noqa: E731
    out = jax.vmap(lambda k, x: jax.vmap(lambda x: arrays(k, x))(x), (1, None))(k[:1], x)
    assert out["force"].shape == (3, 2, 1)
    np.testing.assert_allclose(out["force"][:, :, 0], np.outer(K, x) + np.sin(K)[:, None], rtol=1e-14)
    assert out["steps"].shape == (3, 2) and (np.asarray(out["steps"]) == 4).all() and set(out) == {"force", "steps", "stiffness"}
    np.testing.assert_allclose(out["stiffness"][:, 1, 0], np.asarray(K) ** 2, rtol=1e-14)


def test_a_batch_of_few_members_compiles_nothing_until_it_is_called_often():
    """Members have the numbers of the function itself; after a hundred calls a loop over them is compiled."""
    eager_programs.calls_of.cache_clear()
    k = jnp.arange(1.0, 6.0)
    force(k[0])
    with jb.compile_times() as times:
        several = jax.vmap(force)(k)
    np.testing.assert_array_equal(several, [force(each) for each in k])
    assert not [name for name in times.programs if name.startswith("spring")], times
    with jb.compile_times() as times:
        for _ in range(eager_programs.OFTEN):
            jax.vmap(force)(k)
    assert [name for name in times.programs if name.startswith("spring")] == ["spring_batch"]
    np.testing.assert_allclose(jax.vmap(force)(k), several, rtol=1e-15)


def test_keys_of_random_numbers_in_a_batch():
    """They are no numbers of NumPy."""
    drawn = jit_unoptimized(lambda key, scale: scale * jax.random.normal(key, (2,)))
    keys = jax.random.split(jax.random.key(0), 3)
    np.testing.assert_allclose(jax.vmap(drawn, (0, None))(keys, 2.0), [2 * jax.random.normal(key, (2,)) for key in keys], rtol=1e-14)


def test_a_result_that_does_not_move_has_no_derivative():
    steps = lambda k: spring(k, 2.0 * k, 1, 4)["steps"] * 1.0  # noqa: E731
    assert jax.grad(steps)(3.0) == 0.0 and jax.jvp(steps, (3.0,), (1.0,))[1] == 0.0


@jit_unoptimized
def with_root(x, y):
    return {"double": 2 * x, "root": jnp.sqrt(y)}


def test_infinite_derivatives_of_results_that_are_not_used_have_no_part():
    """Neither in one function nor in two, the second of which uses both results of the first."""

    def once(x):
        return with_root(x, x)["double"]

    def twice(x):
        first = with_root(x, x)
        return with_root(first["double"], first["root"])["double"]

    zero = jnp.zeros(())
    assert float(jax.grad(once)(zero)) == 2.0 and float(jax.grad(twice)(zero)) == 4.0
    assert float(jax.jit(jax.grad(twice))(zero)) == 4.0 and float(jax.vmap(jax.grad(twice))(jnp.zeros(3))[1]) == 4.0
    assert np.isinf(jax.grad(lambda x: with_root(x, x)["root"])(zero))


@jax.custom_jvp
def without_second(x, y):
    return x


without_second.defjvp(lambda primals, tangents: (without_second(*primals), tangents[0]))


def test_infinite_derivatives_of_arguments_that_a_rule_leaves_out_have_no_part():
    """Outside a jit as inside one."""
    first = jit_unoptimized(lambda x, y: without_second(3 * x, y))
    slope = jax.grad(lambda x: first(x, jnp.sqrt(x)))
    assert float(slope(jnp.zeros(()))) == 3.0 == float(jax.jit(slope)(jnp.zeros(())))


def test_rows_of_a_pullback_are_a_batch():
    _, back = jax.vjp(lambda k: spring(k, jnp.asarray(2.0), 3, 4)["force"] * jnp.ones(2), K[0])
    np.testing.assert_allclose(jax.vmap(back)(jnp.eye(2))[0], 2 * [8 + np.cos(3.0)], rtol=1e-14)


@pytest.mark.parametrize("lost", [False, True])
def test_programs_have_the_options_of_the_function(monkeypatch, lost):
    """Whether they have is seen from the functions that JAX compiles. Where JAX cannot say what is under way, JAX's own way remains."""
    if lost:
        monkeypatch.setattr(compile_options, "only_transformed", lambda: False)
    with jb.compile_times() as times:
        jax.grad(lambda k: spring(k, jnp.arange(5.0 + lost), 2, 4)["force"].sum())(3.0)
    ours = {name for name in times.programs if name.startswith("spring")}
    assert ours == ({"spring"} if lost else {"spring", "spring_pullback"})


@pytest.mark.parametrize("lost", [False, True])
def test_a_function_is_traced_once_for_itself_and_its_gradient(lost, monkeypatch):
    """Where JAX has moved what says which devices are meant, it is traced again, and right."""
    if lost:
        monkeypatch.delattr("jax._src.mesh")
        monkeypatch.setitem(sys.modules, "jax._src.mesh", None)
    traced = []

    @jit_unoptimized
    def cube(x):
        traced.append(x)
        return x**3

    assert float(cube(jnp.asarray(2.0))) == 8.0 and float(jax.grad(cube)(jnp.asarray(2.0))) == 12.0
    assert len(traced) <= 1 + lost


@pytest.mark.long
def test_what_is_under_way_is_told():
    seen = []

    def look(x):
        seen.append((jax_internals.outermost(), jax_internals.only_transformed()))
        return x

    look(1.0)
    jax.grad(look)(1.0)
    jax.vmap(jax.grad(look))(K)
    jax.jacfwd(look)(1.0)
    jax.jit(look)(1.0)
    jax.jit(jax.grad(look))(1.0)
    jax.grad(jax.jit(look))(2.0)
    assert seen == [
        (True, True),
        (False, True),
        (False, True),
        (False, True),
        *2 * [(False, False)],
    ]


@pytest.mark.long
def test_a_frequency_has_the_slope_of_its_closed_form():
    """omega = sqrt(k/m): d f/d k = f/2k; of a batch, too."""

    def frequency(k):
        spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 2.0, 0]), stiffness=k, free_length=2.0)
        joints = {"mass": jb.Guide("world", axis=[0, 1, 0])}
        bodies = {"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])}
        model = jb.Model(bodies=bodies, joints=joints, elements={"spring": spring}, gravity=[0, -9.81, 0])
        return jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]

    f = np.sqrt(np.asarray(K) / 2.0) / (2 * np.pi)
    np.testing.assert_allclose(jax.vmap(frequency)(K), f, rtol=1e-12)
    np.testing.assert_allclose(jax.vmap(jax.grad(frequency))(K), f / (2 * np.asarray(K)), rtol=1e-10)
    np.testing.assert_allclose(jax.grad(jax.grad(frequency))(K[1]), -f[1] / (4 * K[1] ** 2), rtol=1e-9)


@pytest.fixture
def pullbacks(monkeypatch):
    """Pullbacks in the order in which JAX calls them, each with those that were expected after it; nothing is compiled ahead."""
    seen = []

    def ahead(pullback, options, arrays):
        types = tuple(map(jax.typeof, arrays))
        seen.append(((pullback, options, types), list(eager_programs._following(pullback, types, arrays))))

    monkeypatch.setattr(eager_programs, "_compile_ahead", ahead)
    return seen


guessed = pytest.mark.skipif(jax.__version_info__ < (0, 8, 2), reason="a cotangent has a weak type there: a program more is compiled")


@guessed
@pytest.mark.nan  # where NaNs are looked for, nothing is compiled ahead
def test_the_pullbacks_that_follow_are_known_at_the_first(pullbacks):
    """Those of three springs in a row, with an argument that two of them share, and of a model's first frequency."""
    jax.grad(twice, (0, 1))(jnp.asarray(1.1), jnp.asarray(0.7))
    called, following = zip(*pullbacks, strict=True)
    assert len(called) == 3 and following[0] == list(called[1:])
    pullbacks.clear()
    model = jb.presets.quarter_car()
    jax.grad(lambda model: jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0])(model)
    called, following = zip(*pullbacks, strict=True)
    assert [pullback.__name__ for pullback, *_ in called] == ["_modes_pullback", "_linearize_pullback", "equilibrium_of_pullback"]
    assert following[0] == list(called[1:2])  # before the equilibrium comes what makes a failed one NaN


def test_a_gradient_leaves_no_arrays():
    eager_programs._called.clear()
    f = lambda k: spring(k, 2.0 * k, 3, 4)["force"]  # noqa: E731
    jax.grad(f)(jnp.asarray(1.7))
    jax.grad(f)(jnp.asarray(1.8))
    gc.collect()
    assert all(reference() is None for called in eager_programs._called for reference in called.references)


@pytest.mark.nan  # where NaNs are looked for, nothing is compiled ahead
def test_what_is_expected_wrongly_does_no_harm(pullbacks):
    """Another use of a result, by an operation of JAX, is not foreseen; the next pullback is seen to have its cotangent, too."""

    def mixed(k):
        first = spring(k, jnp.asarray(1.5), 3, 4)
        return spring(first["force"], jnp.asarray(0.5), 2, 4)["force"] + jnp.sin(first["stiffness"])

    slope = jax.grad(mixed)(jnp.asarray(1.3))
    (_, following), (second, _) = pullbacks
    assert [pullback.of.given for pullback, *_ in following] != [second[0].of.given]
    k, f = 1.3, 1.3 * 1.5**3 + np.sin(1.3)
    np.testing.assert_allclose(slope, (1.5**3 + np.cos(k)) * (0.25 + np.cos(f)) + 2 * k * np.cos(k**2), rtol=1e-13)


@guessed
@pytest.mark.nan  # where NaNs are looked for, nothing is compiled ahead
def test_each_pullback_is_compiled_once_and_ahead():
    """What a thread has compiled is what the call then uses: JAX reports one compilation for each, and no more for the second gradient."""
    k, x = jnp.asarray([1.2, 1.3, 1.4]), jnp.asarray([0.7, 0.8, 0.9])
    slope = jax.grad(lambda k, x: twice(k, x).sum(), (0, 1))
    threads = []

    def heard(event, seconds, fun_name="", **_):
        if "backend_compile" in event and "spring_pullback" in fun_name:
            threads.append(threading.current_thread())

    with listening(heard):
        first = slope(k, x)
        assert len(threads) == 3 and threading.main_thread() not in threads
        np.testing.assert_array_equal(slope(k, x), first)
        assert len(threads) == 3
    each = [jax.grad(twice, (0, 1))(*pair) for pair in zip(k, x, strict=True)]
    np.testing.assert_allclose(np.transpose(first), each, rtol=1e-13)


def twice(k, x):
    """k g^2 + sin k with g = a x^3 + sin a and a = k^2, which does not depend on x."""
    a = spring(k, x, 3, 4)["stiffness"]
    return spring(k, spring(a, x, 3, 4)["force"], 2, 4)["force"]


def alike(k, x):
    """f h + sin f with h = f^3 + sin f of f = twice, which is given twice to one call, after another one has depended on it."""
    f = twice(k, x)
    return spring(f, spring(f, f, 2, 4)["force"], 1, 4)["force"]


@pytest.mark.parametrize("by_jax", [False, True], ids=["in its program", "by JAX"])
def test_an_operation_adds_to_the_cotangents_that_others_have_given(by_jax, monkeypatch):
    """Outside a jit JAX adds them by a program for each shape, and so do versions without such rules."""
    try:
        from jax._src.interpreters.ad import fancy_transposes
    except ImportError:
        fancy_transposes = {eager_programs._tangents_p: None}
        by_jax = True
    if by_jax:
        monkeypatch.delitem(fancy_transposes, eager_programs._tangents_p)
    k, x = 1.1 + by_jax, 0.7
    with jb.compile_times() as times:
        slopes = jax.grad(twice, (0, 1))(jnp.asarray(k, float), jnp.asarray(x, float))
    assert by_jax or not {"add", "add_any"} & set(times.programs), times
    a = k**2
    g, g_a, g_x = a * x**3 + np.sin(a), x**3 + np.cos(a), 3 * a * x**2
    exact = np.array([g**2 + np.cos(k) + 4 * k**2 * g * g_a, 2 * k * g * g_x])
    np.testing.assert_allclose(slopes, exact, rtol=1e-13)
    f = k * g**2 + np.sin(k)
    force, force_f = f**3 + np.sin(f), 3 * f**2 + np.cos(f)  # and f times it, plus sin f
    exact = exact * (force + f * force_f + np.cos(f))
    np.testing.assert_allclose(jax.grad(alike, (0, 1))(jnp.asarray(k, float), jnp.asarray(x, float)), exact, rtol=1e-13)


SHARDED = """
import os
os.environ["XLA_FLAGS"] = "--xla_force_host_platform_device_count=2"
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxbody.compilation.compile_options import jit_unoptimized

@jit_unoptimized
def force(k):
    return k * jnp.sin(k)

mesh = jax.make_mesh((2,), ("devices",))
k = jax.device_put(jnp.arange(1.0, 5.0), NamedSharding(mesh, PartitionSpec("devices")))
result = jax.vmap(force)(k)
np.testing.assert_allclose(result, np.arange(1, 5) * np.sin(np.arange(1, 5)), rtol=1e-6)
assert result.sharding.device_set == k.sharding.device_set and not result.is_fully_replicated
"""


def test_a_batch_over_several_devices_is_no_loop():
    done = subprocess.run([sys.executable, "-c", SHARDED], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
