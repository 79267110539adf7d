"""First and second derivatives of V, T and R in structured form, in closed form for line elements;
they equal those by jax.hessian. Those of elements at a state, for all linearizations, are of their
deformations in (Delta, Xi), and of their energies in these.

With delta_f = (displacement of its origin, rotation vector), in world axes, of every frame f
that moves, J = d delta/d(Delta, Xi), and G and H the gradient and the Hessian of V in the delta
of all frames:

    slope     J' G
    K         J' H J + G d2 delta/dx dx,
    where for x_i nearer to the root than x_j, n_i the axis about which x_i turns,
              d2 delta/dx_i dx_j = (n_i x J_j, n_i x J_j / 2) for displacement and rotation;
              the mean of both orders of i and j for rotations
              of one joint that act together; of rotations in series, the first one is nearer
              to the root
    M         J' (inertias) J, and those of the elements that have inertia
    C         J' (R'' of the elements) J

Rows: the speeds v, then six for each support. Where every body is free on the world J is
the identity.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.core.compilation.compile_options import program
from jaxbody.geometry.frames import Frame
from jaxbody.geometry.vectors import cross, product, rotate, skew
from jaxbody.lagrange import gravity_energy, potential
from jaxbody.mechanics.dynamics import all_free, element_inertia, on_coordinates
from jaxbody.model.element_states import apart
from jaxbody.model.elements.elements import Element
from jaxbody.model.elements.second_derivatives import (
    Block,
    PairBlocks,
    damping_matrix,
    dissipation_hessian,
    potential_derivatives,
    second_order,
    turning,
)
from jaxbody.model.elements.user_energies import OfFrames
from jaxbody.model.joints.frame_tables import completed, each_element, inertial_tables, wrenches
from jaxbody.model.joints.kinematics import Coordinates, frames_displaced, jacobian
from jaxbody.model.layouts import Layout
from jaxbody.model.models import Model
from jaxbody.model.states import State
from jaxbody.numerics.xla_workarounds import sums

Vector = Float[Array, "n"]
Square = Float[Array, "n n"]


class Configuration(eqx.Module):
    """A model with its bodies at q and its supports in the poses of `coordinates`. `frames`: all
    frames; `turns`: for each component of (Delta, Xi), or of Delta alone if `base` is False, the
    rotation per unit that it gives the frame whose coordinate it is; `J`: the displacement and
    rotation of every frame per unit of each component, None if all bodies are free."""

    coordinates: Coordinates
    q: Float[Array, "nq"]
    frames: Frame
    turns: Float[Array, "n 3"]
    J: Float[Array, "frames n 6"] | None
    base: bool = eqx.field(static=True)

    @property
    def model(self) -> Model:
        return self.coordinates.model


def configuration_at(
    coordinates: Coordinates,
    q: Float[Array, "nq"],
    v: Float[Array, "nv"] | None = None,
    *,
    base: bool = True,
) -> Configuration:
    """Return the configuration at q, with the bodies at rest or at the speeds v; `base`: whether it
    has columns for the displacements Xi of the supports."""
    layout = coordinates.model.layout
    v = jnp.zeros(layout.nv, q.dtype) if v is None else v
    frames, (linear, angular) = coordinates.frames_and_axes(q, v, coordinates.supports.at_rest())
    if base:
        own = np.tile(np.eye(6), (len(layout.supports), 1))
        linear, angular = (
            jnp.concatenate([linear, own[:, :3]]),
            jnp.concatenate([angular, own[:, 3:]]),
        )
    J = None if all_free(layout) else jnp.concatenate(jacobian(layout, frames, linear, angular), -1)
    return Configuration(coordinates, q, frames, angular, J, base)


def frame_twists(at: Configuration) -> Float[Array, "nf n 6"]:
    """Return the displacement of the origin and the rotation of every frame per unit of each of
    (Delta, Xi)."""
    n, layout, dtype = len(at.turns), at.model.layout, at.q.dtype
    J = jnp.swapaxes(jnp.eye(n, dtype=dtype).reshape(-1, 6, n), 1, 2) if at.J is None else at.J
    return jnp.zeros((len(layout.frames), n, 6), dtype).at[layout.moving(base=at.base)].set(J)


def slope(at: Configuration) -> Vector:
    """Return dV/d(Delta, Xi) at rest."""
    G = -jnp.concatenate(wrenches(at.model, at.frames), -1)[at.model.layout.moving(base=at.base)]
    return _pulled_back(at.J, G)


def stiffness(at: Configuration) -> Square:
    """Return K | -K~ | K_bb as one matrix."""
    return expansion(at)[2]


class DeadForces(NamedTuple):
    """Forces of constant direction on bodies: their potential energy, its gradient and its Hessian
    in the rotation of each body."""

    V: Float[Array, ""]
    G: Float[Array, "nb 6"]
    Q: Float[Array, "nb 3 3"]


@jax.jit
def expansion(
    at: Configuration, dead: DeadForces | None = None
) -> tuple[Float[Array, ""], Vector, Square]:
    """Return V, dV/d(Delta, Xi) and K | -K~ | K_bb as one matrix, with the dead forces included.
    JAX traces it once for a search and the derivative of its result."""
    model, frames, J, base = at.model, at.frames, at.J, at.base
    layout = model.layout
    arms = rotate(frames.R[layout.first_body :], model.bodies.rows.com)
    weights = -model.bodies.rows.mass[:, None] * model.gravity[None]
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
        W = jnp.asarray(_precedence(layout)[: len(n), : len(n)], K.dtype) * jnp.sum(
            n[:, None] * T[None], -1
        )
        K = K + W + W.T
    V = potential(model, frames)
    return V if dead is None else V + dead.V, _pulled_back(J, G), K


def inertias(at: Configuration) -> Float[Array, "nb 3 3"]:
    """Return the inertias of the bodies about their centers of mass, in world axes."""
    R, own = at.frames.R[at.model.layout.first_body :], at.model.bodies.rows.inertia
    return product(product(R, (own + jnp.swapaxes(own, -1, -2)) / 2), jnp.swapaxes(R, -1, -2))


def mass(at: Configuration) -> Square:
    """Return M | -M~ | M_bb as one matrix."""
    bodies, R = at.model.bodies.rows, at.frames.R[at.model.layout.first_body :]
    m, c = bodies.mass[:, None], rotate(R, bodies.com)
    inertia = Block(
        h=bodies.mass, x=m * c, y=m * c, Q=inertias(at) - m[..., None] * product(skew(c), skew(c))
    )
    M = _projected(at.J, _hessian(at.model, inertia, [], at.base))
    if not inertial_tables(at.model):
        return M
    return M + element_inertia(at.model, at.frames, frame_twists(at))[0]


def damping(at: Configuration) -> Square:
    """Return C | -C~ | C_bb as one matrix."""
    return _projected(
        at.J,
        _hessian(
            at.model, Block(), each_element(at.model, at.frames, dissipation_hessian), at.base
        ),
    )


@program
def matrices(model: Model, state: State) -> tuple[Square, Square, Square]:
    """Return M, C and K at a state, with the supports at rest in their reference poses and the
    coordinates of elements held."""
    at = configuration_at(
        Coordinates(apart(model, completed(model, state).z)), state.q, state.v, base=False
    )
    return mass(at), damping(at), stiffness(at)


# From frames to coordinates. The frames that move are in the order of the columns: bodies, then,
# with `base`, supports


def _places(layout: Layout, base: bool) -> dict[str, int]:
    """Return {name of a moving frame: its index among these}."""
    return {layout.frames[row]: i for i, row in enumerate(layout.moving(base=base))}


def _precedence(layout: Layout) -> np.ndarray:
    """Return the matrix (n, n) with 1 where column i turns the axis of column j, and 1/2 where both
    turn one joint together or are the same column."""
    movers, n = layout.movers, len(layout.movers)
    turns = np.concatenate([layout.turns, np.tile([0, 0, 0, 1, 1, 1], len(layout.supports))])
    in_series = np.array(
        [block.kind.in_series for block in layout.joints for _ in block.motions]
        + [False] * layout.nxi,
        dtype=bool,
    )
    earlier = np.triu(np.ones((n, n)), 1) + np.eye(n) / 2
    of_one_joint = np.where(in_series, earlier, 0.5 * turns[:, None] * turns)
    return np.where(movers[:, None] == movers, of_one_joint, layout.carries[np.ix_(movers, movers)])


def _pulled_back(J: Array | None, G: Array) -> Vector:
    """Return J' G."""
    return G.reshape(-1) if J is None else jnp.sum(J * G[:, None], (0, 2))


def _projected(J: Array | None, H: Float[Array, "frames 6 frames 6"]) -> Square:
    """Return J' H J."""
    n = 6 * len(H)
    if J is None:
        return H.reshape(n, n)
    J = jnp.swapaxes(J, 1, 2).reshape(n, -1)
    return J.T @ H.reshape(n, n) @ J


def _collected(parts: list[tuple[Array, list[int | None]]], n: int) -> Array:
    """Return the sum of the rows for each of n indices; rows with the index None are left out."""
    rows = jnp.concatenate([part for part, _ in parts])
    targets = [index for _, indices in parts for index in indices]
    groups = [[i for i, target in enumerate(targets) if target == index] for index in range(n)]
    return sums(rows.reshape(len(rows), -1), groups).reshape(n, *rows.shape[1:])


def _gradient(
    model: Model,
    bodies: Float[Array, "nb 6"],
    elements: list[tuple[Float[Array, "_ 6"], ...]],
    base: bool,
) -> Float[Array, "frames 6"]:
    """Return the gradients of bodies and elements, summed by frame."""
    places = _places(model.layout, base)
    ends = [
        (part, [places.get(link[end]) for link in table.links])
        for table, parts in zip(model.elements, elements, strict=True)
        for end, part in enumerate(parts)
    ]
    return _collected(
        [(bodies, list(range(len(bodies)))), *ends], len(model.layout.moving(base=base))
    )


def _hessian(
    model: Model, bodies: Block, elements: list[PairBlocks], base: bool
) -> Float[Array, "frames 6 frames 6"]:
    """Return the Hessians of bodies and elements, summed by pairs of frames."""
    places, n = _places(model.layout, base), len(model.layout.moving(base=base))

    def cells(table, one: int, other: int):
        pairs = [(places.get(link[one]), places.get(link[other])) for link in table.links]
        return [None if i is None or j is None else i * n + j for i, j in pairs]

    parts: list[tuple[Block, list[int | None]]] = [
        (bodies, [i * n + i for i in range(len(model.layout.bodies))])
    ]
    for table, blocks in zip(model.elements, elements, strict=False):
        for (one, other), block in blocks.items():
            parts.append((block, cells(table, one, other)))
            if one != other:
                parts.append((block.T, cells(table, other, one)))
    blocks, indices = zip(*parts, strict=True)

    def summed(parts):
        present = [
            (part, index) for part, index in zip(parts, indices, strict=True) if part is not None
        ]
        return _collected(present, n * n) if present else None

    H = Block(*map(summed, zip(*blocks, strict=True))).whole()
    return (
        jnp.broadcast_to(jnp.asarray(H, model.gravity.dtype), (n * n, 6, 6))
        .reshape(n, n, 6, 6)
        .swapaxes(1, 2)
    )


class ElementDerivatives(NamedTuple):
    """Derivatives of the k deformations e of each of ne elements: J = de/d(Delta, Xi), V''(e) and
    R''(e, e_dot). For energies written by the user, e are the displacements and rotations of their
    frames."""

    J: Float[Array, "ne k n"]
    stiffness: Float[Array, "ne k k"]
    damping: Float[Array, "ne k k"]

    def elastic(self) -> Float[Array, "ne n n"]:
        """Return J' V'' J of each element."""
        return jnp.swapaxes(self.J, 1, 2) @ self.stiffness @ self.J


def element_derivatives(at: Configuration) -> list[ElementDerivatives]:
    """Return the derivatives for each table of elements, at the speeds of the configuration."""

    def of(element, *frames: Frame):
        if isinstance(element, OfFrames):
            n = 6 * len(frames)
            slopes = jnp.split(jnp.eye(n, dtype=frames[0].p.dtype), len(frames), 1)
            return (
                slopes,
                potential_derivatives(element, *frames)[1],
                damping_matrix(element, *frames),
            )
        e, e_dot = element.rates(*frames)
        k = e.size
        return (
            deformation_slopes(element, *frames),
            element.tangent(e).reshape(k, k),
            jax.jacfwd(lambda rate: element.damping_force(e, rate))(e_dot).reshape(k, k),
        )

    twists = frame_twists(at)
    return [
        ElementDerivatives(on_coordinates(at.model, table, slopes, twists), *second)
        for table, (slopes, *second) in zip(
            at.model.elements, each_element(at.model, at.frames, of), strict=True
        )
    ]


def deformation_slopes(element: Element, *frames: Frame) -> list[Float[Array, "k 6"]]:
    """Return de/d(displacement and rotation) of each frame of an element."""

    def deformation(moves):
        return element.deformation(
            *(f.pose().displaced(move) for f, move in zip(frames, moves, strict=True))
        ).reshape(-1)

    return jax.jacfwd(deformation)([jnp.zeros(6, frames[0].p.dtype)] * len(frames))


@program
def gravity_stiffness(model: Model, state: State) -> Float[Array, "nv nv"]:
    """Return the Hessian of the potential energy of the weights."""
    return jax.hessian(lambda d: gravity_energy(model, frames_displaced(model, state, d)))(
        jnp.zeros(model.layout.nv, state.q.dtype)
    )


@program
def split_stiffness(model: Model, state: State):
    """Return elastic and geometric stiffness of every element, table by table: V'' de de, and the
    rest of the Hessian, V' d2e."""
    zero = jnp.zeros(n := model.layout.nv, state.q.dtype)

    def potentials(d):
        return each_element(
            model,
            frames_displaced(model, state, d),
            lambda s, *F: s.potential(*(f.pose() for f in F)),
        )

    if not model.elements:
        return [], []
    elastic = [
        x.elastic()[:, :n, :n]
        for x in element_derivatives(configuration_at(Coordinates(model), state.q))
    ]
    return elastic, [k - e for k, e in zip(jax.hessian(potentials)(zero), elastic, strict=True)]
