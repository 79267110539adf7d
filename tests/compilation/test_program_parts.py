"""What a derivative needs of a program: no search whose end is a result, and nothing else is left out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbody.compilation.program_parts import with_known_results
from jaxbody.core.jax_internals import jaxpr_as_fun

pytestmark = pytest.mark.everywhere


@jax.custom_jvp
def implied(x, y):
    """y with the derivative of the root of y^3 = x."""
    return y


implied.defjvp(lambda primals, tangents: (implied(*primals), tangents[0] / (3 * implied(*primals) ** 2)))


def root(x, ended):
    """The cube root by Newton's method, its square, the steps, and whether it is large; with `ended` also where the search has ended."""
    start = jax.lax.stop_gradient(x), jnp.ones(()), 0
    target, y, steps = jax.lax.while_loop(lambda c: jnp.abs(c[1] ** 3 - c[0]) > 1e-12, lambda c: (c[0], newton(*c[:2]), c[2] + 1), start)
    q = implied(x, y)
    return [q, q**2, steps, steps > 3, *([target, y] if ended else [])]


def newton(x, y):
    return y - (y**3 - x) / (3 * y**2)


@pytest.mark.parametrize("ended", [False, True])
@pytest.mark.parametrize("result", [0, 1])
def test_a_search_is_left_out_where_it_has_ended_at_a_result(ended, result):
    x = jnp.asarray(8.0)
    program, y = jax.make_jaxpr(lambda x: root(x, ended))(x), root(x, ended)
    wanted = [i == result for i in range(len(y))]
    part, used = with_known_results(program, [True], wanted)
    assert "while" in str(program) and "while" not in str(part) and len(used) == 1
    value, slope = jax.value_and_grad(lambda x: jaxpr_as_fun(part)(x, *(y[i] for i in used))[0])(x)
    np.testing.assert_allclose((value, slope), [(2.0, 1 / 12), (4.0, 1 / 3)][result], rtol=1e-12)


def test_what_derivatives_pass_through_is_computed():
    x = jnp.asarray(8.0)
    program = jax.make_jaxpr(lambda x: [y := 2 * x, y**2, jax.lax.stop_gradient(y)])(x)
    part, used = with_known_results(program, [True], [False, True, False])
    assert used == [] and float(jax.grad(lambda x: jaxpr_as_fun(part)(x)[0])(x)) == 64.0


def test_a_loop_of_which_another_value_is_needed_runs():
    """The number of its steps is a result, but where it ended is not."""
    x = jnp.asarray(8.0)
    part, used = with_known_results(jax.make_jaxpr(lambda x: root(x, False)[1:3])(x), [True], [True, False])
    assert used == [] and "while" in str(part)
    np.testing.assert_allclose(jax.grad(lambda x: jaxpr_as_fun(part)(x)[0])(x), 1 / 3, rtol=1e-12)
