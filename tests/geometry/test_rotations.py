"""Rotations against independent references: the matrix series in 60 decimal digits, SciPy, and the
group axioms."""

import functools
import itertools
from decimal import Decimal, localcontext
from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

from jaxbody.geometry import rotations, vectors

RNG = np.random.default_rng(2011)
SIZES = [0.0, 1e-16, 1e-14, 1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-6, 1e-4, 1e-3, 1e-2, 1e-1]
LIMITS = [1e-15, 1e-14, 1e-13, 1e-12, 1e-10]  # of the value and its derivatives to the fourth
A, B = np.array([0.3, -0.7, 0.5]), np.array([-0.4, 0.2, 0.6])
AXIS = np.array([2.0, -1.0, 2.0]) / 3
SWEEP = np.array(SIZES)[:, None] * AXIS
LARGE = (
    np.array(
        [
            0.5,
            0.999999,
            1.000001,
            1.999999,
            2.000001,
            3.0,
            np.pi,
            2 * np.pi - 1e-3,
            2 * np.pi,
            7.0,
            12.5,
            19.0,
        ]
    )[:, None]
    * AXIS
)
DIRECTIONS = np.array(
    [s for s in itertools.product([1.0, 0.0, -1.0], repeat=3) if s > (0, 0, 0)]
    + [(1, 2, 0), (0, 1, 2), (2, 0, 1)]
)


def skew(w):
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]], dtype=w.dtype)


def skews(w):
    return np.stack([skew(row) for row in np.asarray(w)])


def series(w, s, a, first=0, order=4):
    """Coefficients of e^0 .. e^order in the sum over k of [w + e s]^k a / (k + first)!, to 50
    digits: floats are exact decimals."""
    W, S, v = (np.vectorize(Decimal)(x) for x in (w, s, a))
    W, S = skew(W), skew(S)
    with localcontext() as context:
        context.prec = 90  # the terms grow to |w|^k / k! before they fall
        term = [v] + [0 * v] * order
        total = [x / factorial(first) for x in term]
        for k in range(1, 30 + 5 * int(np.linalg.norm(w))):
            term = [W.dot(term[i]) + (S.dot(term[i - 1]) if i else 0) for i in range(order + 1)]
            total = [x + y / factorial(k + first) for x, y in zip(total, term, strict=True)]
    return total


def matrix_series(w, first=0):
    """The sum over k of [w]^k / (k + first)!: the exponential, and for first = 1 the
    left Jacobian."""
    return np.stack([series(w, 0 * w, e, first, 0)[0] for e in np.eye(3)], 1).astype(float)


@functools.cache
def exact_potential():
    """Derivatives 0 to 4 of |R a - b|^2 along each direction at each point: (5,
    points, directions)."""
    table = np.empty((5, len(SWEEP) + len(LARGE), len(DIRECTIONS)))
    for (i, w), (j, s) in itertools.product(enumerate([*SWEEP, *LARGE]), enumerate(DIRECTIONS)):
        d = series(w, s, A)
        d[0] = d[0] - np.vectorize(Decimal)(B)
        table[:, i, j] = [
            factorial(n) * sum(d[k].dot(d[n - k]) for k in range(n + 1)) for n in range(5)
        ]
    return table


def with_derivative(g):
    return lambda t: jax.jvp(g, (t,), (1.0,))


def along(f, order=4):
    """f and its first derivatives along s, as a function of (w, s); sixteen directions determine a
    symmetric tensor of the fourth order."""

    def derivatives(w, s):
        def g(t):
            return f(w + t * s)

        for _ in range(order):
            g = with_derivative(g)
        nested = g(0.0)  # ((f, f'), (f', f'')) and so on
        return [
            functools.reduce(lambda pair, i, n=n: pair[int(i < n)], range(order), nested)
            for n in range(order + 1)
        ]

    return derivatives


def over_all(function, points):
    """A function of (w, s) at every point and direction."""
    w, s = np.repeat(points, len(DIRECTIONS), 0), np.tile(DIRECTIONS, (len(points), 1))
    values = jax.jit(jax.vmap(function))(w, s)
    return [np.asarray(x).reshape(len(points), len(DIRECTIONS), *x.shape[1:]) for x in values]


@pytest.mark.parametrize(
    "mode",
    [
        "forward over exp_quaternion",
        pytest.param("reverse over forward over exp", marks=pytest.mark.long),
    ],
)
def test_derivatives_to_the_fourth_are_exact_from_zero_to_three_turns(mode):
    """A potential |R a - b|^2 at rotations of 0 and 1e-16 to 0.1, on either side of the switches of
    branch, and up to 19 rad."""

    def rotation(w):
        return (
            rotations.matrix(rotations.exp_quaternion(w))
            if "quaternion" in mode
            else rotations.exp(w)
        )

    def potential(w):
        d = rotation(w) @ A - B
        return d @ d

    def reverse(w, s):
        """The last derivative of each order by jax.grad."""
        return potential(w), *(jax.jacrev(lambda w: jnp.stack(along(potential, 3)(w, s)))(w) @ s)

    exact, size = exact_potential(), np.abs(DIRECTIONS).sum(1)
    for n, value in enumerate(
        over_all(
            reverse if mode.startswith("reverse") else along(potential),
            np.concatenate([SWEEP, LARGE]),
        )
    ):
        error = np.abs(value - exact[n]) / size**n / max(1, np.abs(exact[n] / size**n).max())
        assert error.max() <= LIMITS[n], n


@pytest.mark.long
def test_log_undoes_exp_with_all_derivatives_to_the_fourth():
    """log(exp(w)) = w: its first derivative is the identity, the next three vanish; also next to
    half a turn."""
    points = np.concatenate([SWEEP, LARGE[:6], (np.pi - 1e-7) * AXIS[None]])
    value, *derivatives = over_all(along(lambda w: rotations.log(rotations.exp(w))), points)
    exact = [DIRECTIONS + 0 * points[:, None], 0, 0, 0]
    assert np.abs(value - points[:, None]).max() <= 1e-15
    for n, (value, right) in enumerate(zip(derivatives, exact, strict=True), 1):
        assert np.abs(value - right).max() <= LIMITS[n], n


def sample(n, largest):
    """Rotation vectors in every direction, of every size up to the largest, zero and the coordinate
    axes among them."""
    v = RNG.normal(size=(n, 3))
    v[:6] = [*np.eye(3), *-np.eye(3)]
    size = largest * RNG.uniform(size=n) ** 2
    size[-1] = 0
    return v / np.linalg.norm(v, axis=1, keepdims=True) * size[:, None]


PHI, PSI, CHI = sample(60, 19.0), sample(60, 3.1), sample(60, 3.1)
HALF_TURNS = np.concatenate([np.eye(3), sample(58, 1.0)[:57]])
HALF_TURNS = np.pi * HALF_TURNS / np.linalg.norm(HALF_TURNS, axis=1, keepdims=True)


def test_exp_is_the_matrix_exponential():
    R = np.asarray(rotations.exp(PHI))
    assert np.abs(R - [matrix_series(w) for w in PHI]).max() <= 2e-15
    assert np.abs(R - Rotation.from_rotvec(PHI).as_matrix()).max() <= 2e-15
    assert np.abs(rotations.exp(PSI) - scipy.linalg.expm(skews(PSI))).max() <= 1e-14


def test_a_turn_about_an_axis_is_the_exponential():
    axes, angles = (
        PSI[:-1] / np.linalg.norm(PSI[:-1], axis=1, keepdims=True),
        np.linspace(-19, 19, 59),
    )
    exact = Rotation.from_rotvec(angles[:, None] * axes).as_matrix()
    assert np.abs(rotations.about(axes, angles) - exact).max() <= 1e-14


def test_left_jacobian_is_its_series_and_turns_a_rate_into_an_angular_velocity():
    J = np.asarray(rotations.left_jacobian(PHI))
    assert np.abs(J - [matrix_series(w, 1) for w in PHI]).max() <= 2e-15
    R, R_dot = jax.jvp(rotations.exp, (jnp.asarray(PHI),), (jnp.asarray(PSI),))
    assert np.abs(R_dot - skews(vectors.rotate(J, PSI)) @ R).max() <= 2e-14


def test_inverse_left_jacobian_is_the_inverse_and_the_derivative_of_log():
    points = np.concatenate([PSI, HALF_TURNS * (1 - 1e-9), SWEEP])
    inverse = np.stack(
        [
            rotations.inverse_left_jacobian(points, np.broadcast_to(e, points.shape))
            for e in np.eye(3)
        ],
        -1,
    )
    assert np.abs(inverse - np.linalg.inv([matrix_series(w, 1) for w in points])).max() <= 2e-15
    change = jax.jacrev(lambda e, R: rotations.log(vectors.product(rotations.exp(e), R)))
    singular = np.concatenate(
        [np.zeros((1, 3)), 1e-160 * AXIS[None], 1e-300 * AXIS[None], HALF_TURNS]
    )  # squares underflow, sign open
    result = jax.jit(jax.vmap(change, (None, 0)))(
        jnp.zeros(3), rotations.exp(np.concatenate([points, singular]))
    )
    assert np.abs(result[: len(points)] - inverse).max() <= 1e-14
    assert np.isfinite(result).all()


def test_quaternions_and_matrices_agree_with_scipy(rng):
    q, R = (
        Rotation.from_rotvec(PHI).as_quat(scalar_first=True),
        Rotation.from_rotvec(PHI).as_matrix(),
    )
    scale = rng.uniform(0.5, 2, size=(len(q), 1))
    result = np.asarray(rotations.exp_quaternion(PHI))
    assert np.abs(result * np.sign(np.sum(result * q, 1, keepdims=True)) - q).max() <= 1e-14
    assert np.abs(rotations.matrix(q * scale) - R).max() <= 1e-15
    assert np.abs(rotations.normalize(q * scale) - q).max() <= 4e-16
    assert (
        np.abs(
            rotations.log_quaternion(q) - Rotation.from_quat(q, scalar_first=True).as_rotvec()
        ).max()
        <= 4e-15
    )
    assert np.abs(rotations.log_quaternion(-q) - rotations.log_quaternion(q)).max() == 0


def test_from_matrix_finds_the_quaternion_whichever_component_is_largest():
    """Turns near half a turn have w near zero and any of x, y, z largest."""
    turns = np.concatenate([PHI, HALF_TURNS, HALF_TURNS * (1 - 1e-8), HALF_TURNS * 0.7])
    R = Rotation.from_rotvec(turns).as_matrix()
    q = np.asarray(jax.jit(rotations.from_matrix)(R))
    assert {int(np.abs(row).argmax()) for row in q} == {0, 1, 2, 3}
    assert (
        np.abs(np.abs(np.sum(q * Rotation.from_matrix(R).as_quat(scalar_first=True), 1)) - 1).max()
        <= 1e-15
    )
    assert np.abs(rotations.matrix(q) - R).max() <= 1e-15
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() <= 1e-15


@pytest.mark.parametrize("short_of", [1e-1, 1e-4, 1e-8, 1e-12, 1e-15, 0.0])
def test_log_keeps_its_digits_up_to_half_a_turn(short_of):
    phi = HALF_TURNS * (1 - short_of / np.pi)
    for log in (
        rotations.log(rotations.exp(phi)),
        rotations.log_quaternion(rotations.exp_quaternion(phi)),
    ):
        log = np.asarray(log)
        if short_of <= 1e-15:  # both of phi and -phi are right there
            log = log * np.sign(np.sum(log * phi, 1, keepdims=True))
        assert np.abs(log - phi).max() <= 4e-15


def test_the_laws_of_a_group():
    """Identity, inverse, associativity, and acting on vectors, for quaternions and for matrices."""
    p, q, r = (rotations.exp_quaternion(x) for x in (PHI, PSI, CHI))
    one, conjugate = jnp.array([[1.0, 0, 0, 0]]), jnp.array([[1.0, -1, -1, -1]])
    assert np.abs(rotations.multiply(p, one) - p).max() == 0
    assert np.abs(rotations.multiply(one, p) - p).max() == 0
    assert np.abs(rotations.multiply(p, p * conjugate) - one).max() <= 1e-15
    assert (
        np.abs(
            rotations.multiply(rotations.multiply(p, q), r)
            - rotations.multiply(p, rotations.multiply(q, r))
        ).max()
        <= 1e-15
    )
    P, Q = rotations.matrix(p), rotations.matrix(q)
    assert np.abs(rotations.matrix(rotations.multiply(p, q)) - vectors.product(P, Q)).max() <= 2e-15
    assert np.abs(vectors.product(P, Q) - np.einsum("nij,njk->nik", P, Q)).max() <= 1e-15
    assert np.abs(vectors.rotate(P, CHI) - np.einsum("nij,nj->ni", P, CHI)).max() <= 2e-15
    assert np.abs(vectors.rotate_back(P, vectors.rotate(P, CHI)) - CHI).max() <= 4e-15
    assert np.abs(P @ np.swapaxes(P, 1, 2) - np.eye(3)).max() <= 1e-15
    assert np.abs(rotations.exp(PHI) - P).max() <= 2e-15
    assert np.abs(np.linalg.det(P) - 1).max() <= 2e-15
    assert (
        np.abs(vectors.skew(PHI) @ PSI[..., None] - vectors.cross(PHI, PSI)[..., None]).max()
        <= 1e-14
    )
    assert np.abs(vectors.cross(PHI, PSI) - np.cross(PHI, PSI)).max() <= 1e-14


@pytest.mark.parametrize("axes", ["world", "body"])
def test_quaternion_rates_are_the_derivatives_of_a_turning_frame(axes):
    q = rotations.exp_quaternion(PHI)

    def turned(t):
        step = rotations.exp_quaternion(t * PSI)
        return rotations.multiply(step, q) if axes == "world" else rotations.multiply(q, step)

    rate = rotations.quaternion_rate if axes == "world" else rotations.quaternion_rate_body
    assert np.abs(jax.jvp(turned, (0.0,), (1.0,))[1] - rate(q, jnp.asarray(PSI))).max() <= 1e-15


@pytest.mark.parametrize("name", ["exp_quaternion", "left_jacobian", "inverse_left_jacobian"])
def test_no_second_derivative_is_nan(rng, name):
    """At zero, at rotations whose square underflows, and at half a turn about each axis."""

    f = getattr(rotations, name)
    f = (
        (lambda w: rotations.inverse_left_jacobian(w, AXIS))
        if name == "inverse_left_jacobian"
        else f
    )
    points = np.concatenate(
        [np.zeros((1, 3)), SWEEP[1:4], 1e-160 * AXIS[None], 1e-300 * AXIS[None], HALF_TURNS[:3]]
    )
    weights = rng.normal(size=f(points[0]).shape)
    second = jax.jit(jax.vmap(jax.hessian(lambda w: jnp.sum(weights * f(w)))))(points)
    assert np.isfinite(second).all()


def test_an_inverse_length_is_zero_with_zero_derivatives_at_length_zero():
    length = np.sqrt(2**2 + 3**2 + 6**2)
    d = jnp.array([[2.0, 3.0, 6.0], [0.0, 0.0, 0.0], [1e-41, 0.0, 0.0]])
    np.testing.assert_allclose(vectors.inverse_length(d), [1 / length, 0.0, 0.0], rtol=1e-15)
    slopes = jax.vmap(jax.grad(vectors.inverse_length))(d)  # -d/|d|^3
    np.testing.assert_allclose(slopes, [-d[0] / length**3, *np.zeros((2, 3))], rtol=1e-15)
    fifth = vectors.inverse_length
    for _ in range(5):
        fifth = jax.jacfwd(fifth)
    assert np.isfinite(jax.vmap(fifth)(d)).all()
