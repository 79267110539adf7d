"""Second derivatives of the energies of elements with respect to the displacements of their frames:
closed forms, and jax.jacfwd."""

from __future__ import annotations

from functools import singledispatch
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry import rotations
from jaxbody.geometry.frames import Frame
from jaxbody.geometry.vectors import (
    cross,
    dot,
    inverse_length,
    length_and_direction,
    product,
    rotate,
    rotate_back,
    skew,
    to_rank,
)
from jaxbody.model.elements.bushings import FramePair
from jaxbody.model.elements.elements import Element, LineElement, turned

DeformationSlopes = tuple[Float[Array, "*rows 6"], ...]  # de/d(displacement of each frame)
# Matrices that place h, Q and the components of x and y, with their signs, in a 6 x 6 block
SKEW = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)  # [e_x], [e_y], [e_z]
UPPER_LEFT, LOWER_RIGHT = (
    np.kron(np.diag([1.0, 0.0]), np.eye(3)),
    np.kron(np.diag([0.0, 1.0]), np.ones((3, 3))),
)
LOWER_LEFT, UPPER_RIGHT = (
    np.kron([[0.0, 0.0], [1.0, 0.0]], SKEW),
    np.kron([[0.0, 1.0], [0.0, 0.0]], -SKEW),
)


class Block(NamedTuple):
    """A block of a Hessian with respect to the displacements of two frames (translation, rotation),
    P + [[h I, -[y]], [[x], Q]], whose parts are summed separately."""

    P: Float[Array, "*n 6 6"] | None = None
    h: Float[Array, "*n"] | None = None
    x: Float[Array, "*n 3"] | None = None
    y: Float[Array, "*n 3"] | None = None
    Q: Float[Array, "*n 3 3"] | None = None

    def __neg__(self) -> Block:
        return jax.tree.map(jnp.negative, self)

    @property
    def T(self) -> Block:
        P, Q = (None if part is None else jnp.swapaxes(part, -1, -2) for part in (self.P, self.Q))
        return Block(P, self.h, self.y, self.x, Q)

    def whole(self) -> Float[Array, "*n 6 6"] | float:
        """Return the 6 x 6 matrix as a sum of products with ones and zeros, because concatenated
        parts would be copied one number after another (numerics/xla_workarounds.py)."""
        parts = [] if self.P is None else [self.P]
        if self.h is not None:
            parts.append(self.h[..., None, None] * to_rank(UPPER_LEFT, self.h.ndim + 2))
        for vector, places in ((self.x, LOWER_LEFT), (self.y, UPPER_RIGHT)):
            parts += (
                []
                if vector is None
                else [
                    vector[..., k, None, None] * to_rank(places[k], vector.ndim + 1)
                    for k in range(3)
                ]
            )
        if self.Q is not None:
            everywhere = jnp.broadcast_to(
                self.Q[..., None, :, None, :], (*self.Q.shape[:-2], 2, 3, 2, 3)
            )
            parts.append(
                everywhere.reshape(*self.Q.shape[:-2], 6, 6) * to_rank(LOWER_RIGHT, self.Q.ndim)
            )
        return sum(parts, 0.0)


PairBlocks = dict[tuple[int, int], Block]  # for each pair (i, j) of an element's frames, i <= j


@singledispatch
def second_order(element: Element, *frames: Frame) -> tuple[DeformationSlopes, PairBlocks]:
    """Return gradient and Hessian of V with respect to the displacements of the frames."""
    G, H = potential_derivatives(element, *frames)
    return tuple(jnp.split(G, len(frames))), _blocks(H)


def potential_derivatives(
    element: Element, *frames: Frame
) -> tuple[Float[Array, "n"], Float[Array, "n n"]]:
    """Return gradient and Hessian of V; the Hessian is the symmetric part of the derivative of the
    wrenches, because rotations only add a skew part."""
    n = 6 * len(frames)

    def moved(frame, x):
        return Frame(
            frame.p + x[:3], frame.R + product(skew(x[3:]), frame.R), jnp.zeros(3), jnp.zeros(3)
        )

    def slopes(x):
        at = (
            moved(frame, part)
            for frame, part in zip(frames, jnp.split(x, len(frames)), strict=True)
        )
        G = -jnp.concatenate([part for wrench in element.wrenches(*at) for part in wrench])
        return G, G

    D, G = jax.jacfwd(slopes, has_aux=True)(jnp.zeros(n, frames[0].p.dtype))
    return G, (D + D.T) / 2


@second_order.register
def _(line: LineElement, A: Frame, B: Frame) -> tuple[DeformationSlopes, PairBlocks]:
    """Return the derivatives for a line, with V'' = h I + c d d' for the vector d between the
    points, h the tension over the length."""
    a, b = rotate(A.R, line.a), rotate(B.R, line.b)
    d = (B.p - A.p) + (b - a)
    inverse = inverse_length(d)
    k0, rest, rate = _states_held(line.split, dot(d, d) * inverse)
    h = k0 + rest * inverse
    c = (rate - rest * inverse) * inverse**2
    g_a, g_b = (jnp.concatenate([d, cross(arm, d)]) for arm in (a, b))

    def block(x, y, g_x, g_y, turned: Array | float = 0.0):
        Q = dot(x, y) * np.eye(3, dtype=d.dtype) - y[:, None] * x[None]
        return Block(c * g_x[:, None] * g_y[None], h, h * x, h * y, h * Q + turned)

    return (-h * g_a, h * g_b), {
        (0, 0): block(a, a, g_a, g_a, turning(a, -h * d)),
        (0, 1): -block(a, b, g_a, g_b),
        (1, 1): block(b, b, g_b, g_b, turning(b, h * d)),
    }


@second_order.register
def _(bushing: FramePair, A: Frame, B: Frame) -> tuple[DeformationSlopes, PairBlocks]:
    """Return the derivatives for a pair of frames. V depends on the relative pose, in the axes of
    the bushing on A: position t of the end on B and orientation R = exp([theta]), which change as t
    -> t + tau, R -> exp([psi]) R. In world axes, to second order in the displacements of the
    frames, with b the arm of B and P the vector from A's origin to B's end,

        tau = d_b - d_a + phi_b x b - phi_a x P - phi_a x (d_b - d_a + phi_b x b)
              + phi_a x (phi_a x P)/2 + phi_b x (phi_b x b)/2
        psi = phi_b - phi_a - phi_a x phi_b/2
    """
    R_A, R = turned(bushing, A.pose(), B.pose())
    a, b = rotate(A.R, bushing.a), rotate(B.R, bushing.b)
    P = (B.p - A.p) + b
    theta = rotations.log_below_half_turn(R)
    g, H = _in_relative_motion(bushing, theta, rotate_back(R_A, P - a))
    turn = jnp.kron(np.eye(2, dtype=P.dtype), R_A)
    H, f, m = turn @ H @ turn.T, rotate(R_A, g[:3]), rotate(R_A, g[3:])
    I, O = np.eye(3, dtype=P.dtype), jnp.zeros((3, 3), P.dtype)
    Z_a, Z_b = _square(-I, skew(P), O, -I), _square(I, -skew(b), O, I)
    slopes = tuple(jnp.concatenate([f, m]) @ Z for Z in (Z_a, Z_b))
    return slopes, {
        (0, 0): Block(Z_a.T @ H @ Z_a + _square(O, skew(f), -skew(f), turning(P, f))),
        (0, 1): Block(
            Z_a.T @ H @ Z_b + _square(O, O, skew(f), -product(skew(f), skew(b)) + skew(m) / 2)
        ),
        (1, 1): Block(Z_b.T @ H @ Z_b + _square(O, O, O, turning(b, f))),
    }


def _in_relative_motion(
    bushing: FramePair, theta: Float[Array, "3"], t: Float[Array, "3"]
) -> tuple[Float[Array, "6"], Float[Array, "6 6"]]:
    """Return gradient and Hessian of V with respect to (tau, psi), for e = (J t, theta),
    J = 1 - [theta]/2 + c [theta]^2, c a function of x = |theta|^2.

    With eta = J psi the changes are d theta = eta, d2 theta = N(psi) eta, du = J tau + N(t) eta,
    d2u = 2 N(tau) eta + N(t) d2 theta + D2J(t)[eta, eta], where N(y) eta is the derivative of J y
    along eta; P(g) is the matrix of eta . P(g) y = g . N(y) eta, S that of f . D2J(t)[eta, eta]."""
    c, c1, c2 = _with_derivatives(rotations.cotc, dot(theta, theta))
    T = skew(theta)
    J = np.eye(3, dtype=t.dtype) - T / 2 + c * product(T, T)

    def squared(y):
        return cross(theta, cross(theta, y))

    def along(y, x):
        return y[:, None] * x[None]

    def N(y):
        return (
            skew(y) / 2
            + 2 * c1 * along(squared(y), theta)
            - c * (skew(cross(theta, y)) + product(T, skew(y)))
        )

    def P(g):
        return (
            skew(g) / 2
            + 2 * c1 * along(theta, squared(g))
            - c * (product(skew(g), T) + skew(cross(g, theta)))
        )

    u = rotate(J, t)
    e = jnp.concatenate([u, theta])
    f, K = _states_held(bushing.static_force, e), bushing.tangent(e)
    f_u, N_t = f[:3], N(t)
    p = f[3:] + rotate_back(N_t, f_u)
    w = cross(cross(theta, t), f_u) + cross(t, cross(f_u, theta))
    I = np.eye(3, dtype=t.dtype)
    S = (
        dot(f_u, squared(t)) * (4 * c2 * along(theta, theta) + 2 * c1 * I)
        + 4 * c1 * along(theta, w)
        + 2 * c * (along(f_u, t) - dot(f_u, t) * I)
    )
    E = _square(J, product(N_t, J), jnp.zeros_like(J), J)
    bend = product(J.T, P(p) + product(S, J))
    mixed = product(J.T, P(f_u))
    M = _square(jnp.zeros_like(J), mixed.T, mixed, (bend + bend.T) / 2)
    return f @ E, E.T @ K @ E + M


def _states_held(force, e: Array) -> Any:
    """Return force(e), so that its derivatives with respect to parameters keep the states of
    hysteretic laws constant: these states change only with e, as `law_states.Apart` defines."""
    return jax.jvp(force, (e,), (jnp.ones_like(e),))[0]


def _with_derivatives(function, x: Array) -> tuple[Array, Array, Array]:
    """Return the value of a function of one number and its first two derivatives."""

    def first(x):
        return jax.jvp(function, (x,), (jnp.ones_like(x),))

    (c, c1), (_, c2) = jax.jvp(first, (x,), (jnp.ones_like(x),))
    return c, c1, c2


def turning(arm: Float[Array, "*n 3"], force: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """Return the Hessian of force . exp([phi]) arm with respect to phi at 0: (f a' + a f')/2 -
    (f . a) I."""
    outer = force[..., :, None] * arm[..., None, :]
    return (outer + jnp.swapaxes(outer, -1, -2)) / 2 - dot(force, arm)[..., None, None] * to_rank(
        np.eye(3, dtype=arm.dtype), outer.ndim
    )


@singledispatch
def dissipation_hessian(element: Element, *frames: Frame) -> PairBlocks:
    """Return the Hessian of R with respect to the velocities of the frames, one block for each pair
    of frames."""
    return _blocks(damping_matrix(element, *frames))


def damping_matrix(element: Element, *frames: Frame) -> Float[Array, "n n"]:
    """Return the Hessian of R with respect to the velocities of the frames: J' R'' J, with J the
    derivative of e_dot with respect to these velocities."""
    e, e_dot = element.rates(*frames)
    n = 6 * len(frames)

    def rates(x):
        at = (
            Frame(f.p, f.R, part[:3], part[3:])
            for f, part in zip(frames, jnp.split(x, len(frames)), strict=True)
        )
        return element.rates(*at)[1]

    J = jax.vmap(rates, out_axes=-1)(np.eye(n, dtype=frames[0].p.dtype)).reshape(-1, n)
    second = jax.jacfwd(lambda rate: element.damping_force(e, rate))(e_dot).reshape(len(J), len(J))
    return J.T @ second @ J


@dissipation_hessian.register
def _(line: LineElement, A: Frame, B: Frame) -> PairBlocks:
    """Return the Hessian for a line, c g g', with c the slope of the damper's tension and g = (u,
    arm x u) along the unit vector u from a to b."""
    a, b = rotate(A.R, line.a), rotate(B.R, line.b)
    L, u = length_and_direction((B.p - A.p) + (b - a))
    e_dot = dot(u, (B.v - A.v) + (cross(B.w, b) - cross(A.w, a)))
    c = jax.grad(lambda e_dot: line.damper_tension(L - line.free_length, e_dot))(e_dot)
    g_a, g_b = (jnp.concatenate([u, cross(arm, u)]) for arm in (a, b))
    return {
        (0, 0): Block(c * g_a[:, None] * g_a[None]),
        (0, 1): Block(-c * g_a[:, None] * g_b[None]),
        (1, 1): Block(c * g_b[:, None] * g_b[None]),
    }


def _blocks(H: Float[Array, "m m"]) -> PairBlocks:
    n = len(H) // 6
    return {
        (i, j): Block(H[6 * i : 6 * i + 6, 6 * j : 6 * j + 6])
        for i in range(n)
        for j in range(i, n)
    }


def _square(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return [[a, b], [c, d]]."""
    return jnp.concatenate([jnp.concatenate([a, b], -1), jnp.concatenate([c, d], -1)], -2)
