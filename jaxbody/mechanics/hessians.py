"""First and second derivatives of V, T and R in structured form, in closed form for line elements; jax.hessian remains their definition.

With delta_f = (displacement of its origin, rotation vector), world axes, of every frame f that moves, J = d delta/d(Delta, Xi), and G and H
the gradient and the Hessian of V in the delta of all frames:

    slope     J' G
    K         J' H J + G d2 delta/dx dx,  where for x_i nearer to the root than x_j, n_i the axis about which x_i turns,
              d2 delta/dx_i dx_j = (n_i x J_j, n_i x J_j / 2) for displacement and rotation; (ij + ji)/2 for the turns of one joint
              that act together, while of turns in series the earlier one is the nearer to the root
    M         J' (inertias) J
    C         J' (R'' of the elements) J

Rows: the speeds v, then six for each support. Where every body is free on the world J is the identity.
"""

from __future__ import annotations

from functools import singledispatch
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbody.core.compile_options import jit_as_it_is
from jaxbody.elements.elements import Bushing, Element, LineElement, length_and_direction
from jaxbody.geometry import rotations
from jaxbody.geometry.frames import Frame
from jaxbody.geometry.vectors import cross, dot, product, rotate, rotate_back, skew
from jaxbody.mechanics.energies import each_element, potential, sums, wrenches
from jaxbody.mechanics.kinematics import Coordinates, take
from jaxbody.models.models import Layout, Model
from jaxbody.models.states import State
from jaxbody.numerics.elementary_functions import inverse_root

Vector = Float[Array, "n"]
Square = Float[Array, "n n"]
Slopes = tuple[Float[Array, "6"], ...]  # of each frame of an element


class Block(NamedTuple):
    """A block of a Hessian in the displacements of two frames, P + [[h I, -[y]], [[x], Q]]: sums of many are worked out part by part."""

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
        """By products with ones and zeros: parts joined in place of them are copied one number after another."""
        parts = [] if self.P is None else [self.P]
        if self.h is not None:
            parts.append(self.h[..., None, None] * UPPER_LEFT)
        for vector, places in ((self.x, LOWER_LEFT), (self.y, UPPER_RIGHT)):
            parts += [] if vector is None else [vector[..., k, None, None] * places[k] for k in range(3)]
        if self.Q is not None:
            everywhere = jnp.broadcast_to(self.Q[..., None, :, None, :], (*self.Q.shape[:-2], 2, 3, 2, 3))
            parts.append(everywhere.reshape(*self.Q.shape[:-2], 6, 6) * LOWER_RIGHT)
        return sum(parts, 0.0)


# Where in a block h is, where Q, and where the components of x and of y are, and with which sign
SKEW = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)  # [e_x], [e_y], [e_z]
UPPER_LEFT, LOWER_RIGHT = np.kron(np.diag([1.0, 0.0]), np.eye(3)), np.kron(np.diag([0.0, 1.0]), np.ones((3, 3)))
LOWER_LEFT, UPPER_RIGHT = np.kron([[0.0, 0.0], [1.0, 0.0]], SKEW), np.kron([[0.0, 1.0], [0.0, 0.0]], -SKEW)

Blocks = dict[tuple[int, int], Block]  # of each two of an element's frames, the first not after the second


class Placed(NamedTuple):
    """A model with its bodies at q, supports at rest in their reference poses: the table of frames; for each column, of (Delta, Xi) or without
    `base` of Delta alone, the turn that a unit of it gives to its own frame, and J, the motion of each frame, None for the identity."""

    model: Model
    q: Float[Array, "nq"]
    frames: Frame
    turns: Float[Array, "n 3"]
    J: Float[Array, "frames n 6"] | None
    base: bool


def placed(coordinates: Coordinates, q: Float[Array, "nq"], v: Float[Array, "nv"] | None = None, *, base: bool = True) -> Placed:
    """The bodies at q, at rest or at the speeds v."""
    model, layout = coordinates.model, coordinates.model.layout
    v = jnp.zeros(layout.nv, q.dtype) if v is None else v
    frames, (linear, angular) = coordinates.frames_and_axes(q, v, coordinates.supports.at_rest())
    if base:
        own = np.tile(np.eye(6), (len(layout.supports), 1))
        linear, angular = jnp.concatenate([linear, own[:, :3]]), jnp.concatenate([angular, own[:, 3:]])
    return Placed(model, q, frames, angular, _jacobian(layout, frames, linear, angular, base), base)


def slope(at: Placed) -> Vector:
    """dV/d(Delta, Xi) at rest."""
    G = -jnp.concatenate(wrenches(at.model, at.frames), -1)[_rows(at.model.layout, at.base)]
    return _pulled(at.J, G)


def stiffness(at: Placed) -> Square:
    """K | -K~ | K_bb as one matrix."""
    return expansion(at)[2]


class DeadForces(NamedTuple):
    """What forces of constant direction on bodies add: potential energy, its gradient and its Hessian in the rotation of each body."""

    V: Float[Array, ""]
    G: Float[Array, "nb 6"]
    Q: Float[Array, "nb 3 3"]


def expansion(at: Placed, dead: DeadForces | None = None) -> tuple[Float[Array, ""], Vector, Square]:
    """V, dV/d(Delta, Xi) and K | -K~ | K_bb as one matrix."""
    model, frames, J, base = at.model, at.frames, at.J, at.base
    layout = model.layout
    arms = rotate(frames.R[layout.first_body :], model.bodies.rows.com)
    weights = -model.bodies.rows.mass[:, None] * model.gravity
    G_bodies, Q = jnp.concatenate([weights, cross(arms, weights)], -1), turning(arms, weights)
    if dead is not None:
        G_bodies, Q = G_bodies + dead.G, Q + dead.Q
    elements = each_element(model, frames, second_order)
    G = _gradient(model, G_bodies, [slopes for slopes, _ in elements], base)
    H = _hessian(model, Block(Q=Q), [blocks for _, blocks in elements], base)
    K = _projected(J, H)
    if J is not None:
        n = at.turns
        T = jnp.sum(cross(J[..., :3], G[:, None, :3]) + cross(J[..., 3:], G[:, None, 3:]) / 2, 0)
        W = jnp.asarray(_precedence(layout)[: len(n), : len(n)], K.dtype) * jnp.sum(n[:, None] * T, -1)
        K = K + W + W.T
    V = potential(model, frames)
    return V if dead is None else V + dead.V, _pulled(J, G), K


def mass(at: Placed) -> Square:
    """M | -M~ | M_bb as one matrix."""
    bodies, R = at.model.bodies.rows, at.frames.R[at.model.layout.first_body :]
    m, c = bodies.mass[:, None], rotate(R, bodies.com)
    turned = product(product(R, (bodies.inertia + jnp.swapaxes(bodies.inertia, -1, -2)) / 2), jnp.swapaxes(R, -1, -2))
    inertia = Block(h=bodies.mass, x=m * c, y=m * c, Q=turned - m[..., None] * product(skew(c), skew(c)))
    return _projected(at.J, _hessian(at.model, inertia, [], at.base))


def damping(at: Placed) -> Square:
    """C | -C~ | C_bb as one matrix."""
    return _projected(at.J, _hessian(at.model, Block(), each_element(at.model, at.frames, dissipation_hessian), at.base))


@jit_as_it_is
def matrices(model: Model, state: State) -> tuple[Square, Square, Square]:
    """M, C and K at a state, supports at rest in their reference poses."""
    at = placed(Coordinates(model), state.q, state.v, base=False)
    return mass(at), damping(at), stiffness(at)


# Elements: second derivatives in the displacements of their two frames


@singledispatch
def second_order(element: Element, *frames: Frame) -> tuple[Slopes, Blocks]:
    """Gradient and Hessian of V, this as the symmetric part of the derivative of the wrenches: what increments of rotations add is skew."""
    n = 6 * len(frames)

    def moved(frame, x):
        return Frame(frame.p + x[:3], frame.R + product(skew(x[3:]), frame.R), jnp.zeros(3), jnp.zeros(3))

    def slopes(x):
        at = (moved(frame, part) for frame, part in zip(frames, jnp.split(x, len(frames)), strict=True))
        G = -jnp.concatenate([part for wrench in element.wrenches(*at) for part in wrench])
        return G, G

    D, G = jax.jacfwd(slopes, has_aux=True)(jnp.zeros(n, frames[0].p.dtype))
    return tuple(jnp.split(G, len(frames))), _blocks((D + D.T) / 2)


@second_order.register
def _(line: LineElement, A: Frame, B: Frame) -> tuple[Slopes, Blocks]:
    """With V'' = h I + c d d' for the vector d between the points, h the tension over the length."""
    a, b = rotate(A.R, line.a), rotate(B.R, line.b)
    d = (B.p - A.p) + (b - a)
    square = dot(d, d)
    inverse = inverse_root(square)
    k0, rest, rate = line.split(square * inverse)
    h = k0 + rest * inverse
    c = (rate - rest * inverse) * inverse**2
    g_a, g_b = (jnp.concatenate([d, cross(arm, d)]) for arm in (a, b))

    def block(x, y, g_x, g_y, turned=0.0):
        Q = dot(x, y) * np.eye(3, dtype=d.dtype) - y[:, None] * x
        return Block(c * g_x[:, None] * g_y, h, h * x, h * y, h * Q + turned)

    return (-h * g_a, h * g_b), {
        (0, 0): block(a, a, g_a, g_a, turning(a, -h * d)),
        (0, 1): -block(a, b, g_a, g_b),
        (1, 1): block(b, b, g_b, g_b, turning(b, h * d)),
    }


@second_order.register
def _(bushing: Bushing, A: Frame, B: Frame) -> tuple[Slopes, Blocks]:
    """By what V depends on: in the axes of the bushing on A, where its end on B is, t, and how it is turned, R = exp([theta]), that is
    t -> t + tau, R -> exp([psi]) R. In world axes, to second order in the displacements of the frames, b the arm of B, P from A's origin to B's end,

        tau = d_b - d_a + phi_b x b - phi_a x P - phi_a x (d_b - d_a + phi_b x b) + phi_a x (phi_a x P)/2 + phi_b x (phi_b x b)/2
        psi = phi_b - phi_a - phi_a x phi_b/2
    """
    R_A, R_B = product(A.R, rotations.matrix(bushing.orientation)), product(B.R, rotations.matrix(bushing.orientation_b))
    a, b = rotate(A.R, bushing.a), rotate(B.R, bushing.b)
    P = (B.p - A.p) + b
    theta = rotations.log_below_half_turn(product(R_A.T, R_B))
    g, H = _in_relative_motion(bushing, theta, rotate_back(R_A, P - a))
    turn = jnp.kron(np.eye(2, dtype=P.dtype), R_A)
    H, f, m = turn @ H @ turn.T, rotate(R_A, g[:3]), rotate(R_A, g[3:])
    I, O = np.eye(3, dtype=P.dtype), jnp.zeros((3, 3), P.dtype)
    Z_a, Z_b = _square(-I, skew(P), O, -I), _square(I, -skew(b), O, I)
    slopes = tuple(jnp.concatenate([f, m]) @ Z for Z in (Z_a, Z_b))
    return slopes, {
        (0, 0): Block(Z_a.T @ H @ Z_a + _square(O, skew(f), -skew(f), turning(P, f))),
        (0, 1): Block(Z_a.T @ H @ Z_b + _square(O, O, skew(f), -product(skew(f), skew(b)) + skew(m) / 2)),
        (1, 1): Block(Z_b.T @ H @ Z_b + _square(O, O, O, turning(b, f))),
    }


def _in_relative_motion(bushing: Bushing, theta: Float[Array, "3"], t: Float[Array, "3"]) -> tuple[Float[Array, "6"], Float[Array, "6 6"]]:
    """Gradient and Hessian of V in (tau, psi), for e = (J t, theta), J = 1 - [theta]/2 + c [theta]^2, c a function of x = |theta|^2.

    With eta = J psi the changes are d theta = eta, d2 theta = N(psi) eta, du = J tau + N(t) eta, d2u = 2 N(tau) eta + N(t) d2 theta + D2J(t)[eta, eta],
    where N(y) eta is the derivative of J y along eta; P(g) is the matrix of eta . P(g) y = g . N(y) eta, S that of f . D2J(t)[eta, eta]."""
    c, c1, c2 = _with_derivatives(rotations.cotc, dot(theta, theta))
    T = skew(theta)
    J = np.eye(3, dtype=t.dtype) - T / 2 + c * product(T, T)

    def squared(y):
        return cross(theta, cross(theta, y))

    def along(y, x):
        return y[:, None] * x

    def N(y):
        return skew(y) / 2 + 2 * c1 * along(squared(y), theta) - c * (skew(cross(theta, y)) + product(T, skew(y)))

    def P(g):
        return skew(g) / 2 + 2 * c1 * along(theta, squared(g)) - c * (product(skew(g), T) + skew(cross(g, theta)))

    u = rotate(J, t)
    e = jnp.concatenate([u, theta])
    f, K = jax.grad(bushing.energy)(e), jax.hessian(bushing.energy)(e)
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


def _with_derivatives(function, x: Array) -> tuple[Array, Array, Array]:
    """A function of one number and its first two derivatives."""

    def first(x):
        return jax.jvp(function, (x,), (jnp.ones_like(x),))

    (c, c1), (_, c2) = jax.jvp(first, (x,), (jnp.ones_like(x),))
    return c, c1, c2


def turning(arm: Float[Array, "*n 3"], force: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """The Hessian of force . exp([phi]) arm: (f a' + a f')/2 - (f . a) I."""
    outer = force[..., :, None] * arm[..., None, :]
    return (outer + jnp.swapaxes(outer, -1, -2)) / 2 - dot(force, arm)[..., None, None] * np.eye(3, dtype=arm.dtype)


@singledispatch
def dissipation_hessian(element: Element, *frames: Frame) -> Blocks:
    """Of R, in the velocities of the frames: J' R'' J, J the rates of the deformation per unit of each."""
    e, e_dot = element.rates(*frames)
    n = 6 * len(frames)

    def rates(x):
        at = (Frame(f.p, f.R, part[:3], part[3:]) for f, part in zip(frames, jnp.split(x, len(frames)), strict=True))
        return element.rates(*at)[1]

    J = jax.vmap(rates, out_axes=-1)(np.eye(n, dtype=frames[0].p.dtype)).reshape(-1, n)
    second = jax.jacfwd(lambda rate: element.damping_force(e, rate))(e_dot).reshape(len(J), len(J))
    return _blocks(J.T @ second @ J)


@dissipation_hessian.register
def _(line: LineElement, A: Frame, B: Frame) -> Blocks:
    """c g g', c the slope of the damper's tension, g = (u, arm x u) along the unit vector u from a to b."""
    a, b = rotate(A.R, line.a), rotate(B.R, line.b)
    L, u = length_and_direction((B.p - A.p) + (b - a))
    e_dot = dot(u, (B.v - A.v) + (cross(B.w, b) - cross(A.w, a)))
    c = jax.grad(lambda e_dot: line.damper_tension(L - line.free_length, e_dot))(e_dot)
    g_a, g_b = (jnp.concatenate([u, cross(arm, u)]) for arm in (a, b))
    return {(0, 0): Block(c * g_a[:, None] * g_a), (0, 1): Block(-c * g_a[:, None] * g_b), (1, 1): Block(c * g_b[:, None] * g_b)}


def _blocks(H: Float[Array, "m m"]) -> Blocks:
    n = len(H) // 6
    return {(i, j): Block(H[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]) for i in range(n) for j in range(i, n)}


def _square(a: Array, b: Array, c: Array, d: Array) -> Array:
    """[[a, b], [c, d]]."""
    a, b, c, d = jnp.broadcast_arrays(a, b, c, d)
    return jnp.concatenate([jnp.concatenate([a, b], -1), jnp.concatenate([c, d], -1)], -2)


# From frames to coordinates. The frames that move are in the order of the columns: bodies, then, with `base`, supports


def _rows(layout: Layout, base: bool) -> np.ndarray:
    """The rows of these in the table of frames."""
    return np.concatenate([np.arange(layout.first_body, len(layout.frames)), np.arange(1, layout.first_body if base else 1)])


def _places(layout: Layout, base: bool) -> dict[str, int | None]:
    """Name of a frame -> its place among these."""
    rows = list(_rows(layout, base))
    return {name: rows.index(row) if row in rows else None for row, name in enumerate(layout.frames)}


def _owners(layout: Layout) -> np.ndarray:
    """For each column the place of the frame that it moves first, in the order of the columns."""
    widths = [kind.nv for kind in layout.kinds] + [6] * len(layout.supports)
    return np.repeat(np.arange(len(widths)), widths)


def _carried(layout: Layout) -> np.ndarray:
    """(frames, n): 1 where a column moves a frame."""
    supports = np.arange(len(layout.supports))
    on_bodies = np.repeat(layout.roots[:, None] - 1 == supports, 6, axis=1)
    on_supports = np.repeat(supports[:, None] == supports, 6, axis=1)
    return np.block([[layout.carries, on_bodies], [np.zeros((len(supports), layout.nv)), on_supports]])


def _precedence(layout: Layout) -> np.ndarray:
    """(n, n): 1 where column i turns the axis of column j, 1/2 where both turn one joint together, or are one."""
    owners = _owners(layout)
    of_one_joint = owners[:, None] == owners
    turns = np.concatenate([layout.turns, np.tile([0, 0, 0, 1, 1, 1], len(layout.supports))])
    in_series = np.array([kind.in_series for kind in layout.kinds] + [False] * len(layout.supports), dtype=bool)[owners]
    earlier = np.triu(np.ones((len(owners), len(owners))), 1) + np.eye(len(owners)) / 2
    return np.where(of_one_joint, turns[:, None] * turns * np.where(in_series, earlier, 0.5), _carried(layout)[owners].T)


def _jacobian(layout: Layout, frames: Frame, linear, angular, base: bool) -> Float[Array, "frames n 6"] | None:
    """The motion of each frame per unit of each column; None for the identity."""
    if layout.floating:
        return None
    rows, n = _rows(layout, base), len(linear)
    p = frames.p[rows]
    mask = jnp.asarray(_carried(layout)[: len(rows), :n], p.dtype)[..., None]
    return mask * jnp.concatenate(jnp.broadcast_arrays(linear + cross(angular[None], p[:, None] - p[_owners(layout)[:n]]), angular), -1)


def _pulled(J: Array | None, G: Array) -> Vector:
    """J' G."""
    return G.reshape(-1) if J is None else jnp.sum(J * G[:, None], (0, 2))


def _projected(J: Array | None, H: Float[Array, "frames 6 frames 6"]) -> Square:
    """J' H J."""
    n = 6 * len(H)
    if J is None:
        return H.reshape(n, n)
    J = jnp.swapaxes(J, 1, 2).reshape(n, -1)
    return J.T @ H.reshape(n, n) @ J


def _collected(parts: list[tuple[Array, list[int | None]]], n: int) -> Array:
    """The sums of all rows that belong to each of n places; rows without a place are left out."""
    kept = [(part, [i for i, place in enumerate(places) if place is not None]) for part, places in parts]
    found = [place for _, places in parts for place in places if place is not None]
    if not found:
        return jnp.zeros((n, *parts[0][0].shape[1:]), parts[0][0].dtype)
    rows = jnp.concatenate([take(part, np.array(rows)) for part, rows in kept if rows])
    groups = [[i for i, place in enumerate(found) if place == wanted] for wanted in range(n)]
    return sums(rows.reshape(len(rows), -1), groups).reshape(n, *rows.shape[1:])


def _gradient(model: Model, bodies: Float[Array, "nb 6"], elements: list[Slopes], base: bool) -> Float[Array, "frames 6"]:
    """The sum over bodies and elements of what each has of each frame."""
    places = _places(model.layout, base)
    ends = [
        (part, [places[link[end]] for link in table.links])
        for table, parts in zip(model.elements, elements, strict=True)
        for end, part in enumerate(parts)
    ]
    return _collected([(bodies, list(range(len(bodies)))), *ends], len(_rows(model.layout, base)))


def _hessian(model: Model, bodies: Block, elements: list[Blocks], base: bool) -> Float[Array, "frames 6 frames 6"]:
    """The sum over bodies and elements of what each has of each two frames."""
    places, n = _places(model.layout, base), len(_rows(model.layout, base))

    def cells(table, one: int, other: int):
        pairs = [(places[link[one]], places[link[other]]) for link in table.links]
        return [None if i is None or j is None else i * n + j for i, j in pairs]

    found = [(bodies, [i * n + i for i in range(len(model.layout.bodies))])]
    for table, blocks in zip(model.elements, elements, strict=False):
        for (one, other), block in blocks.items():
            found.append((block, cells(table, one, other)))
            if one != other:
                found.append((block.T, cells(table, other, one)))
    each, their_cells = zip(*found, strict=True)

    def summed(parts):
        known = [(part, to) for part, to in zip(parts, their_cells, strict=True) if part is not None]
        return _collected(known, n * n) if known else None

    H = Block(*map(summed, zip(*each, strict=True))).whole()
    return jnp.broadcast_to(jnp.asarray(H, model.gravity.dtype), (n * n, 6, 6)).reshape(n, n, 6, 6).swapaxes(1, 2)
