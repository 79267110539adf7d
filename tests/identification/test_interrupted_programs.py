"""Programs that ask Python for numbers: optimizers of optax against their own run in JAX, loops and branches, numbers of programs."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import jaxbody as jb
from jaxbody.identification.interrupted_programs import Parts, asked, interrupted

pytestmark = pytest.mark.everywhere
START = np.array([-1.2, 1.0])


def cost(y):
    """Rosenbrock's function."""
    return 50 * (y[1] - y[0] ** 2) ** 2 + 0.5 * (1 - y[0]) ** 2


def answer(y):
    f, x = 10 * (y[1] - y[0] ** 2), y[0]
    return 0.5 * f**2 + 0.5 * (1 - x) ** 2, np.array([-20 * x * f - (1 - x), 10 * f])


@pytest.mark.long
@pytest.mark.parametrize(
    "optimizer, most",
    [
        (optax.lbfgs(), 15),
        (optax.adam(0.1), 2),
        (optax.chain(optax.sgd(1.0), optax.scale_by_backtracking_linesearch(max_backtracking_steps=20)), 15),
    ],
    ids=["zoom", "adam", "backtracking"],
)
def test_an_optimizer_that_asks_python_goes_the_way_that_it_goes_in_jax(optimizer, most):
    optimizer = optax.with_extra_args_support(optimizer)

    def step(y, state, value, gradient, function):
        change, state = optimizer.update(gradient, state, y, value=value, grad=gradient, value_fn=function)
        return optax.apply_updates(y, change), state

    def steps(begin, update, evaluate):
        y, state = begin
        way = []
        for _ in range(12):
            y, state = update(y, state, *evaluate(y))
            way.append(np.asarray(y))
        return np.array(way)

    in_jax = steps((jnp.asarray(START), optimizer.init(jnp.asarray(START))), jax.jit(lambda *x: step(*x, cost)), jax.value_and_grad(cost))
    with jb.compile_times() as spent:
        begin = START, jax.jit(optimizer.init)(START)
        divided = interrupted(lambda *x: step(*x, asked), *begin, *answer(START), parts=Parts())
        way = steps(begin, lambda *x: divided(answer, *x), lambda y: answer(np.asarray(y)))
    np.testing.assert_allclose(way, in_jax, rtol=1e-8)  # rounding, amplified by the steps
    assert np.abs(np.diff(way, axis=0)).max() > 0.01 and spent.count <= most


def test_loops_and_branches_ask_and_what_they_carry_arrives():
    """Newton's iteration for the zero of the derivative of cosh(y - 0.7), in a loop with a branch, and its value there."""
    questions = []

    def cosh(y):
        questions.append(y)
        return np.cosh(y[0] - 0.7), np.sinh(y - 0.7)

    def newton(y, limit):
        def body(carry):
            y, n = carry
            value, slope = jax.value_and_grad(asked)(y)
            return jax.lax.cond(n < limit, lambda y: y - slope / value, lambda y: y + 0 * asked(y), y), n + 1

        y, n = jax.lax.while_loop(lambda carry: carry[1] < limit + 1, body, (y, 0))
        return {"y": y, "n": n, "value": jax.jit(asked)(y)}

    result = interrupted(newton, np.zeros(1), 6, parts=Parts())(cosh, np.zeros(1), 6)
    np.testing.assert_allclose(result["y"], [0.7], rtol=1e-14)
    assert result["n"] == 7 and result["value"] == 1.0
    assert len(questions) == 7 + 1 + 1  # one a step, one in the other branch, one at the end


def test_what_cannot_ask_says_so():
    scanned = lambda y: jax.lax.scan(lambda y, _: (y + asked(y), None), y, None, 3)[0]  # noqa: E731
    with pytest.raises(NotImplementedError, match="scan cannot ask"):
        interrupted(scanned, START, parts=Parts())
    with pytest.raises(NotImplementedError, match="outside of `interrupted`"):
        asked(jnp.asarray(START))
