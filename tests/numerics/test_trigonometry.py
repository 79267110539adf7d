"""Sine and cosine against the C library's in extended precision, for difficult arguments;
derivatives of any order."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbody.numerics.elementary_functions import sincos

compiled = jax.jit(sincos)
RNG = np.random.default_rng(0)
WHOLE = np.arange(-600_000, 600_000) * (np.pi / 2)  # up to 1e6
ARGUMENTS = {
    "near zero": RNG.uniform(-10, 10, 200_000),
    "to a million": RNG.uniform(-1e6, 1e6, 200_000),
    "tiny to large": 10.0 ** RNG.uniform(-300, 6, 200_000),
    "multiples of a quarter turn": WHOLE,
    "just above them": np.nextafter(WHOLE, np.inf),
    "eighths of a turn": WHOLE[::7] + np.pi / 4,
}


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 60, reason="long double is double here")
@pytest.mark.parametrize("where", ARGUMENTS)
def test_within_one_unit_in_the_last_place(where):
    x = ARGUMENTS[where]
    for ours, exact in zip(
        compiled(x), (np.sin(np.longdouble(x)), np.cos(np.longdouble(x))), strict=True
    ):
        units = np.abs(np.asarray(ours) - exact) / np.spacing(np.abs(exact).astype(float))
        assert units.max() < 1.1  # of the exact value rounded itself 0.5


def test_beyond_a_million_no_worse_than_the_rounding_of_the_argument():
    x = 10.0 ** RNG.uniform(6, 15, 100_000)
    s, c = (np.asarray(y) for y in compiled(x))
    np.testing.assert_array_less(
        np.maximum(abs(s - np.sin(x)), abs(c - np.cos(x))), np.spacing(x) + 1e-15
    )
    np.testing.assert_array_less(
        np.abs(np.array(compiled(jnp.array([1e17, 1e100, 1e300])))), 1 + 1e-15
    )


def test_what_is_not_finite_is_nan():
    assert np.isnan(np.array(compiled(jnp.array([np.inf, -np.inf, np.nan])))).all()
    s, c = compiled(jnp.array([0.0, -0.0]))
    assert s.tolist() == [0, 0] and c.tolist() == [1, 1]


def test_derivatives_forward_and_reverse_to_the_third():
    x = jnp.linspace(-9.0, 9.0, 41)
    s, c = np.sin(x), np.cos(x)
    first = jax.vmap(jax.grad(lambda x: sincos(x)[0]))
    second = jax.vmap(jax.jacfwd(jax.grad(lambda x: sincos(x)[1])))
    third = jax.vmap(jax.grad(jax.jacfwd(jax.jacfwd(lambda x: sincos(x)[0]))))
    for ours, exact in ((first(x), c), (second(x), -c), (third(x), -c)):
        np.testing.assert_allclose(ours, exact, rtol=0, atol=3e-16)
    assert np.allclose(jax.vmap(jax.grad(lambda x: sincos(x)[1]))(x), -s, rtol=0, atol=3e-16)


def test_single_precision_stays_single():
    s, c = compiled(jnp.float32(0.5))
    assert (s.dtype, c.dtype) == (jnp.float32, jnp.float32)
    np.testing.assert_allclose([s, c], [np.sin(0.5), np.cos(0.5)], rtol=2e-7)
