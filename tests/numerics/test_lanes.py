"""Rewriting for lanes against jax.vmap: every kind of operation, loops, batches of
batches, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.jax_internals import jaxpr_as_fun, only_what_is_needed
from jaxbody.numerics import lanes
from jaxbody.numerics.lanes import LANES, in_lanes, vmap_last
from jaxbody.numerics.xla_workarounds import any_of_batch

pytestmark = pytest.mark.everywhere


def batches(test):
    """Both ways, which are both quick here."""
    return pytest.mark.usefixtures("batches")(
        pytest.mark.parametrize("batches", ["in lanes", "by vmap"], indirect=True)(test)
    )


def vectors(x, a):
    """Shapes, sums, slices, gathers, products."""
    M = jnp.stack([x, x[::-1], jnp.cross(x, a)])
    rows = M[jnp.array([2, 0, 0])]
    padded = jnp.pad(M @ a, (1, 2)).reshape(2, 3).T
    return (
        jnp.where(x[0] > 0, rows.sum(1), jnp.clip(x, -0.5, 0.5)),
        padded,
        M.argmax(0),
        jnp.cumsum(x),
        jnp.max(rows, (0, 1)),
    )


def loops(x, a):
    """A while loop that ends when each has ended, one that does not know of lanes, a scan, a
    branch, a linear system."""
    grown, n = jax.lax.while_loop(
        lambda c: jnp.sum(c[0]) < 10.0, lambda c: (c[0] + jnp.abs(x) + 0.1, c[1] + 1), (x, 0)
    )
    fixed = jax.lax.fori_loop(0, 3, lambda i, y: y.at[i].set(y[i] * x[i] + i), a)
    end, ys = jax.lax.scan(lambda c, r: (c * 0.9 + r, jnp.sin(c)), x, jnp.outer(a, x))
    branch = jax.lax.cond(x[0] > 0, jnp.sin, jnp.cos, x)
    return grown, n, fixed, end, ys, branch, jnp.linalg.solve(jnp.eye(3) * 4 + jnp.outer(x, a), x)


def until_all_have(x, a):
    """A loop of which members that have ended keep what they had."""

    def more(c):
        return any_of_batch(c[0][0] < 4.0)

    def body(c):
        return jnp.where(c[0][0] < 4.0, c[0] + 1.0, c[0]), c[1] + 1

    return jax.lax.while_loop(more, body, (x, 0))[0]


def sums_of_sums(x, a):
    y = jnp.sin(x)
    table = y[:, None] * a / (1 + a * a)
    return jnp.sum(jnp.sum(table * table[::-1], 0) - table, 0), jnp.sum(table), y


def while_carrying_lanes_alone(x, a):
    """A loop whose lanes end apart."""
    return jax.lax.while_loop(lambda c: c[0] < 4.0, lambda c: c + 1.0, x)


def tables(x, a):
    """Operations that JAX replaces by others before it compiles: from version 0.12 on,
    searchsorted, alone and in a loop."""
    between = jnp.interp(x, jnp.sort(a), jnp.array([1.0, -2.0, 0.5]))
    return jax.lax.fori_loop(
        0, 2, lambda i, y: y + jnp.searchsorted(jnp.cumsum(jnp.abs(x)), y), between
    )


@pytest.mark.long
@batches
@pytest.mark.parametrize(
    "function",
    [vectors, loops, until_all_have, sums_of_sums, while_carrying_lanes_alone, tables],
)
def test_lanes_are_vmap(function):
    x = jax.random.normal(jax.random.key(0), (LANES + 5, 3))
    a = jnp.array([0.3, -1.0, 2.0])
    for batch in (x, x[:4]):  # several chunks, less than one
        ours, theirs = (
            jax.jit(jax.vmap(f, in_axes=(0, None)))(batch, a)
            for f in (in_lanes(function), function)
        )
        jax.tree.map(
            lambda p, q: np.testing.assert_allclose(p, q, rtol=1e-13, atol=1e-13), ours, theirs
        )
    alone = jax.jit(in_lanes(function))(x[0], a)
    jax.tree.map(
        lambda p, q: np.testing.assert_allclose(p, q, rtol=1e-14, atol=1e-14),
        alone,
        jax.jit(function)(x[0], a),
    )


@pytest.mark.parametrize("method", ["scan_unrolled", "scan"])
def test_traced_records_are_searched_in_lanes(method):
    """In JAX 0.12 a search is an operation of its own, which constants of a trace go through."""

    def found(times, t):
        return vmap_last(lambda t: jnp.searchsorted(times, t, method=method))(t)

    times, t = np.array([0.0, 0.1, 0.5, 0.6, 2.0]), np.array([-1.0, 0.05, 0.55, 0.6, 3.0])
    np.testing.assert_array_equal(jax.jit(found)(times, t), np.searchsorted(times, t))


@pytest.mark.long
@batches
def test_derivatives_forward_and_batches_of_batches():
    x = jax.random.normal(jax.random.key(1), (2, 3, 3))
    a = jnp.array([0.3, -1.0, 2.0])

    def energy(function):
        return lambda x: sum(
            jnp.sum(y**2)
            for y in jax.tree.leaves(function(x, a))
            if jnp.issubdtype(y.dtype, jnp.inexact)
        )

    for function in (vectors, loops, sums_of_sums, tables):
        ours, theirs = (
            jax.jit(jax.vmap(jax.vmap(jax.jacfwd(energy(f)))))(x)
            for f in (in_lanes(function), function)
        )
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)


@batches
def test_results_that_do_not_depend_on_the_lane_are_given_to_all():
    ours = jax.vmap(in_lanes(lambda x, a: (x + 1, a * 2)), in_axes=(0, None))(
        jnp.arange(3.0), jnp.ones(2)
    )
    assert ours[0].shape == (3,) and ours[1].shape == (3, 2)
    last = vmap_last(lambda t: (jnp.sin(t), jnp.ones(2)))(jnp.arange(4.0))
    assert last[0].shape == (4,) and last[1].shape == (2, 4)


@batches
def test_derivatives_in_reverse_of_sums():
    x = jax.random.normal(jax.random.key(2), (4, 3))
    a = jnp.array([0.3, -1.0, 2.0])

    def energy(function):
        over = jax.vmap(function, in_axes=(0, None))
        return lambda x: sum(jnp.sum(y**2) for y in over(x, a))

    ours, theirs = (jax.jit(jax.grad(energy(f)))(x) for f in (in_lanes(sums_of_sums), sums_of_sums))
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)


def test_a_loop_of_all_lanes_keeps_them_last():
    x = jnp.zeros((5, 3))
    text = str(
        jax.make_jaxpr(jax.vmap(in_lanes(while_carrying_lanes_alone), in_axes=(0, None)))(x, x[0])
    )
    assert "while" in text and "f64[3,5]" in text.split("while", 1)[1]


def test_jitted_functions_are_kept_and_what_is_not_needed_is_left_out():
    @jax.jit
    def product(x, a):
        return jnp.cross(x, a) * 2.0

    def chain(x, a):
        unused = jnp.exp(jnp.exp(x))
        return product(product(product(x, a), a), a), unused

    batch = jax.vmap(in_lanes(lambda x, a: chain(x, a)[0]))
    traced = jax.make_jaxpr(batch)(np.ones((5, 3)), np.ones((5, 3))).jaxpr
    names = [eqn.primitive.name for eqn in traced.eqns]
    assert (
        sum(name in ("jit", "pjit") for name in names) == 3
        and "mul" not in names
        and "exp" not in names
    )
    x, a = np.random.default_rng(0).normal(size=(2, 5, 3))
    expected = 8 * np.cross(np.cross(np.cross(x, a), a), a)
    np.testing.assert_allclose(batch(x, a), expected, rtol=1e-14, atol=1e-14)


@pytest.mark.long
@batches
def test_a_yes_or_no_takes_no_part_in_derivatives():
    def of_positive(x):
        return jnp.where(in_lanes(lambda x: jnp.sum(x) > 0)(x), jnp.sum(x**2), 0.0)

    x = jnp.array([[1.0, 2.0, 3.0], [-1.0, -2.0, -3.0]])
    for function in (of_positive, jax.jit(of_positive)):
        np.testing.assert_allclose(
            jax.vmap(jax.grad(function))(x), [2 * x[0], 0 * x[0]], rtol=1e-15
        )
        np.testing.assert_allclose(jax.grad(function)(x[0]), 2 * x[0], rtol=1e-15)


@pytest.mark.long
@pytest.mark.parametrize("why", ["a rule fails", "a GPU"])
def test_what_lanes_cannot_take_is_done_by_vmap_and_shown(why, monkeypatch):
    x, a = jax.random.normal(jax.random.key(3), (4, 3)), jnp.array([0.3, -1.0, 2.0])
    if why == "a rule fails":
        monkeypatch.delattr(lanes.Lanes, "_scan")
    else:
        monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    with jb.compile_times() as times:
        ours = jax.vmap(in_lanes(loops), in_axes=(0, None))(x, a)
        last = vmap_last(jnp.sin)(a)
    theirs = jax.vmap(loops, in_axes=(0, None))(x, a)
    jax.tree.map(
        lambda p, q: np.testing.assert_allclose(p, q, rtol=1e-13, atol=1e-13), ours, theirs
    )
    np.testing.assert_allclose(last, np.sin(a), rtol=1e-15)
    (reason,) = times.left_to_vmap.values()
    assert (
        "test_lanes.loops" in repr(times)
        and {"a rule fails": "_scan", "a GPU": "gpu"}[why] in reason
    )


def test_an_operation_without_a_rule_is_shown():
    with jb.compile_times() as times:
        jax.vmap(in_lanes(jnp.fft.fft))(jnp.ones((2, 4)))
    (reason,) = times.left_to_vmap.values()
    assert "no rule for fft" in reason


@pytest.mark.long
def test_batches_of_drivers_stay_in_lanes():
    """Nothing of them is left to jax.vmap by a rule that fails: a new version of JAX shows here."""

    def all_of(k):
        spring = jb.Spring(
            ("mass", [0, 0, 0]), ("world", [0, 2.0, 0]), stiffness=k, free_length=2.0
        )
        model = jb.Model(
            bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
            elements={"spring": spring},
            gravity=[0, -9.81, 0],
        )
        equilibrium = jb.equilibrium(model)
        return jb.modes(jb.linearize(model, equilibrium)).frequency, jb.simulate(
            model, jnp.linspace(0, 0.1, 3)
        ).state.q

    with jb.compile_times() as times:
        jax.jit(jax.vmap(lambda k: (all_of(k), jax.jacfwd(all_of)(k)))).trace(
            jnp.array([40.0, 50.0])
        )
    assert times.left_to_vmap == {}, times


@jax.custom_jvp
def powers(x, n):
    """x^2 and n + 1, with the derivative of n x^3: numbers, whole and not, by a rule that shows."""
    return x**2, n + 1


@powers.defjvp
def _(primals, tangents):
    x, n = primals
    y, more = powers(x, n)
    return (y, more), (n * 3 * x**2 * tangents[0], np.zeros(jnp.shape(more), jax.dtypes.float0))


@jax.custom_jvp
def held(x):
    """A constant, with the derivative of the identity: what a lane does not know of moves
    with it."""
    return jnp.ones_like(x) * 2.0


@held.defjvp
def _(primals, tangents):
    return held(*primals), tangents[0]


@jax.custom_vjp
def turned_back(x):
    """x^2, pulled back as if it were x^3."""
    return x**2


turned_back.defvjp(lambda x: (x**2, x), lambda x, c: (3 * x**2 * c,))


@pytest.mark.long
@batches
@pytest.mark.parametrize("reversible", [False, True])
def test_a_rule_of_ones_own_is_kept_when_a_batch_is_differentiated(reversible):
    """Forward, reverse, second order, in a loop, and next to an operation that JAX replaces:
    against the rule by hand."""
    x, n = jnp.array([0.5, -1.0, 2.0]), jnp.array([1, 2, 3])
    in_lane = lambda f: in_lanes(f, reversible=reversible)  # noqa: E731

    def value(x, n):
        return powers(x, n)[0] * jnp.asarray(powers(x, n)[1], x.dtype)

    over = lambda x: jax.vmap(in_lane(value))(x, n)  # noqa: E731
    slope = n * 3 * x**2 * (n + 1)
    for change in (lambda f: f, jax.jit):
        y, dy = change(lambda x: jax.jvp(over, (x,), (jnp.ones(3),)))(x)
        np.testing.assert_allclose(y, x**2 * (n + 1), rtol=1e-15)
        np.testing.assert_allclose(dy, slope, rtol=1e-15)
        np.testing.assert_allclose(
            change(jax.grad(lambda x: jnp.sum(over(x))))(x), slope, rtol=1e-15
        )
        np.testing.assert_allclose(
            change(jax.jacfwd(jax.jacrev(lambda x: jnp.sum(over(x)))))(x),
            np.diag(n * 6 * x * (n + 1)),
            rtol=1e-14,
        )
    in_loop = jax.vmap(
        in_lane(lambda x: jax.lax.fori_loop(0, 2, lambda i, y: powers(y, i + 1)[0], x))
    )
    np.testing.assert_allclose(
        jax.jvp(in_loop, (x,), (jnp.ones(3),))[1], 2 * 3 * x**4 * 3 * x**2, rtol=1e-15
    )
    np.testing.assert_allclose(jax.jvp(jax.vmap(in_lane(held)), (x,), (x,))[1], x, rtol=1e-15)
    with_tables = jax.vmap(
        in_lane(lambda x: powers(jnp.interp(x, jnp.arange(-3.0, 3.0), jnp.arange(-3.0, 3.0)), 1)[0])
    )
    np.testing.assert_allclose(jax.jvp(with_tables, (x,), (jnp.ones(3),))[1], 3 * x**2, rtol=1e-15)
    np.testing.assert_allclose(
        jax.grad(lambda x: jnp.sum(jax.vmap(in_lane(turned_back))(x)))(x), 3 * x**2, rtol=1e-15
    )


@jax.custom_jvp
def stiff(k):
    """k, which a rule says changes by five."""
    return k


@stiff.defjvp
def _(primals, tangents):
    return stiff(*primals), 5 * tangents[0]


class Ruled(jb.laws.Law):
    """A linear spring, of which a rule says that its force changes seven times as much with k as it
    does, and its stiffness five times."""

    k: jax.Array

    def force(self, x):
        @jax.custom_jvp
        def of(k, x):
            return k * x

        @of.defjvp
        def _(primals, tangents):
            (k, x), (dk, dx) = primals, tangents
            return of(k, x), stiff(k) * dx + 7 * dk * x

        return of(self.k, x)


@pytest.mark.long
@pytest.mark.usefixtures("batches")
def test_a_rule_of_a_law_of_ones_own_is_kept_in_batches_of_drivers():
    """The derivative of a batch is the batch of derivatives, of the equilibrium, of matrices and of
    a simulation."""

    def drivers(k):
        spring = jb.SpringDamper(
            ("mass", [0, 0, 0]), ("world", [0, 2.0, 0]), spring=Ruled(k), free_length=2.0
        )
        bodies, joints = (
            {"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
            {"mass": jb.Guide("world", axis=[0, 1, 0])},
        )
        model = jb.Model(
            bodies=bodies, joints=joints, elements={"spring": spring}, gravity=[0, -9.81, 0]
        )
        result = jb.equilibrium(model)
        return (
            result.state.q[0],
            jb.linearize(model, result).K[0, 0],
            jb.simulate(model, jnp.linspace(0, 0.1, 3)).state.q[-1, 0],
        )

    k = jnp.array([40.0, 50.0])
    _, after = jax.jit(lambda k: jax.jvp(jax.vmap(drivers), (k,), (jnp.ones(2),)))(k)
    inside = jax.jit(jax.vmap(jax.jacfwd(drivers)))(k)
    np.testing.assert_allclose(after, inside, rtol=1e-9)
    sag = 2.0 * 9.81 / k
    # dF = k dx + 7 x dk = 0, sag dk/k being the spring's own
    np.testing.assert_allclose(after[0], 7 * sag / k, rtol=1e-6)
    np.testing.assert_allclose(after[1], 5.0, rtol=1e-6)


def test_what_is_not_needed_of_a_function_in_lanes_is_removed():
    """Its results as before, and the arguments of what is left."""
    both = in_lanes(lambda x, y: [jnp.sin(x), jnp.exp(y)], name="both")
    program = jax.make_jaxpr(lambda x, y: both(x, 1.5 * y)[0])(0.5, 2.0)
    part = only_what_is_needed(program)
    assert "exp" in str(program) and not {"exp", "mul"} & set(str(part).split()), part
    np.testing.assert_allclose(
        jax.vmap(jaxpr_as_fun(part), (0, None))(jnp.arange(3.0), 2.0)[0],
        np.sin(np.arange(3.0)),
        rtol=1e-7,
    )
