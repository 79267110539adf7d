"""Names of modes: the bodies and the direction with most of their kinetic energy, and whether
several move in phase or in opposition.

The shares of a body's translation and rotation in the kinetic energy of the shape phi, in world
axes, are conj(v_i) (M_b v)_i/(phi* M phi), with v the velocity of its center of mass and its
angular velocity along phi.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, concrete
from jaxbody.geometry.vectors import cross, rotate
from jaxbody.mechanics.hessians import Configuration, inertias
from jaxbody.model.models import Model

AXES = "xyz"
# share, relative to the largest one, above which another body in the same direction is named too
ALIKE = 0.5
MOST_NAMED = 4  # bodies; if more move alike they are counted
IN_PHASE = 0.7  # least |cosine of the phase| between two bodies that are in phase or in opposition
TIED = 1e-6  # relative difference of shares, below which the first is taken as the largest
# squared norm of a shape normal to the others of its cluster, below which it is rounding
PARALLEL = 1e-12
NEAR = 1e-3  # relative difference of frequencies below which they are marked
MARK = " ~"
MARK_NOTE = (
    f"~ frequencies within {100 * NEAR:g} % of each other: "
    "equally small changes of the model mix these shapes and energies; consider them together"
)


class Basis(eqx.Module):
    """Velocities and momenta of the bodies per unit of each speed of a linear system: `velocities`
    of the centers of mass and angular velocities of the bodies, in world axes, and the
    corresponding `momenta`. M is the sum over the bodies of the products velocities' momenta, plus
    the part of elements with inertia."""

    velocities: Float[Array, "*b nb 6 nv"]
    momenta: Float[Array, "*b nb 6 nv"]


def basis_of(at: Configuration) -> Basis:
    """Return the basis of small motions about a configuration; coordinates of elements with inertia
    move no body."""
    layout, bodies = at.model.layout, at.model.bodies.rows
    nb, nv, k = len(layout.bodies), layout.nv, len(layout.inertial)
    twists = (
        jnp.swapaxes(jnp.eye(nv, dtype=at.q.dtype).reshape(nb, 6, nv), 1, 2)
        if at.J is None
        else at.J[:nb, :nv]
    )
    R = at.frames.R[layout.first_body :]
    linear, angular = jnp.split(twists, 2, -1)
    v_C = linear + cross(angular, rotate(R, bodies.com)[:, None])
    momenta = jnp.concatenate(
        [bodies.mass[:, None, None] * v_C, rotate(inertias(at)[:, None], angular)], -1
    )
    basis = (jnp.swapaxes(x, 1, 2) for x in (jnp.concatenate([v_C, angular], -1), momenta))
    return Basis(*(jnp.pad(x, [(0, 0), (0, 0), (0, k)]) if k else x for x in basis))


def direction_names(
    model: Model, forward: str | None = None, up: str | None = None
) -> tuple[str, ...]:
    """Return names of three translations and three rotations along and about world axes. `up`:
    upward axis, by default opposite to gravity; `forward`: forward axis, by default none."""
    up = up or upward_axis(model)
    words = {up: ("bounce", "yaw")} if up else {}
    if forward:
        words |= {
            forward: ("fore-aft", "roll"),
            next(iter(set(AXES) - {forward, up})): ("lateral", "pitch"),
        }
    named = [words.get(axis, (f"along {axis}", f"about {axis}")) for axis in AXES]
    return tuple(word for word, _ in named) + tuple(word for _, word in named)


def upward_axis(model: Model) -> str | None:
    """Return the axis opposite to gravity, None if gravity is traced or not along an axis."""
    g = concrete(model.gravity)
    if g is None or g.ndim > 1 or np.sum(np.abs(g) > 1e-9 * np.abs(g).max(initial=0.0)) != 1:
        return None
    return AXES[int(np.argmax(np.abs(g)))]


def names_of_shapes(
    model: Model, basis: Basis, M: Any, shapes: Any, cluster: Any, values: Any
) -> tuple[str, ...]:
    """Return the names of modes from their shapes (columns, real or complex).

    Args:
        model: the model
        basis: velocities and momenta of the bodies in the coordinates of the shapes
        M: mass matrix
        shapes: shapes in columns
        cluster: equal numbers for coinciding modes
        values: frequencies [Hz] or poles [1/s]"""
    V, P, shapes, cluster = map(np.asarray, (basis.velocities, basis.momenta, shapes, cluster))
    labels = model.layout.inner[: len(model.layout.inertial)]
    own = np.zeros((shapes.shape[0],) * 2)  # the mass matrix of coordinates of elements
    if labels:
        own[-len(labels) :, -len(labels) :] = np.asarray(M)[-len(labels) :, -len(labels) :]
    mass = np.einsum("bik,bil->kl", V, P) + own

    def shares(x: np.ndarray) -> np.ndarray:
        """Return shares of energy [%] of bodies and directions, then of coordinates of elements,
        summed over the columns."""
        energies = np.real((V @ x).conj() * (P @ x)).sum(-1).ravel()
        inner = np.real(x.conj() * (own @ x)).sum(-1)[len(own) - len(labels) :]
        return 100 * np.concatenate([energies, inner]) / (energies.sum() + inner.sum())

    spaces = [shapes[:, cluster == c] for c in cluster]
    each = np.stack(
        [
            shares(_orthonormal(x, mass) if x.shape[1] > 1 and np.isfinite(x).all() else x)
            for x in spaces
        ],
        -1,
    )
    of_bodies = each[: 6 * len(V)].reshape(len(V), 6, -1)
    inner = dict(zip(labels, each[6 * len(V) :], strict=True))
    return mode_names(
        model.layout.bodies, direction_names(model), of_bodies, V @ shapes, cluster, values, inner
    )


def _orthonormal(shapes: np.ndarray, M: np.ndarray) -> np.ndarray:
    """Return a basis of the space of these shapes that is orthonormal in M; shapes of coinciding
    poles are not."""
    values, vectors = np.linalg.eigh(shapes.conj().T @ M @ shapes)
    independent = values > PARALLEL * values[-1]
    return shapes @ vectors[:, independent] / np.sqrt(values[independent])


def mode_names(
    bodies: tuple[str, ...],
    directions: tuple[str, ...],
    shares: Any,
    velocities: Any,
    cluster: Any,
    values: Any,
    inner: dict[str, np.ndarray] | None = None,
) -> tuple[str, ...]:
    """Return the name of each mode, with the number of coinciding modes and a mark if another one
    is near.

    Args:
        bodies: names of the bodies
        directions: names of three translations and three rotations
        shares: shares of kinetic energy [%] (bodies, 6, modes)
        velocities: velocities along the shapes (bodies, 6, modes)
        cluster: equal numbers for coinciding modes
        values: frequencies [Hz] or poles [1/s]
        inner: {name: shares [%] (modes,)} of coordinates of elements; default: none"""
    shares, velocities, cluster = np.asarray(shares), np.asarray(velocities), np.asarray(cluster)
    marked, shared = nearly_coinciding(cluster, values), (cluster[:, None] == cluster).sum(0)
    names = []
    for i, count in enumerate(shared):
        if not np.isfinite(shares[..., i]).all():
            names.append("")
            continue
        largest, d = np.argwhere(shares[..., i] >= (1 - TIED) * shares[..., i].max())[0]
        alike = (
            [largest]
            if count > 1
            else np.flatnonzero(shares[:, d, i] >= ALIKE * shares[largest, d, i])
        )
        name = _name(bodies, directions[d], alike, largest, shares[:, d, i], velocities[:, d, i])
        most = max(inner, key=lambda label, i=i: inner[label][i]) if inner else ""
        if inner and inner[most][i] > shares[largest, d, i]:
            name = f"{most} {inner[most][i]:.0f} %"
        names.append(
            name + (f" (one of {count})" if count > 1 else "") + (MARK if marked[i] else "")
        )
    return tuple(names)


def nearly_coinciding(cluster: Any, values: Any) -> np.ndarray:
    """Return which modes nearly coincide with a mode of another cluster, by frequencies or
    poles."""
    values, cluster = np.asarray(values), np.asarray(cluster)
    size = np.maximum(np.abs(values)[:, None], np.abs(values))
    near = (np.abs(values[:, None] - values) <= NEAR * size) & (size > 0)
    return (near & (cluster[:, None] != cluster)).any(1)


def mark_note(names: tuple[str, ...]) -> str:
    """Return the footnote that explains the mark if one of the names has it, else an empty
    string."""
    return MARK_NOTE if any(name.endswith(MARK) for name in names) else ""


def _name(
    bodies: tuple[str, ...],
    direction: str,
    alike: Any,
    largest: Any,
    shares: np.ndarray,
    velocities: Any,
) -> str:
    """Return the name of a mode from the bodies that move alike in a direction, with their shares
    [%] and velocities."""
    if len(alike) == 1 or len(alike) > MOST_NAMED:
        others = f" and {len(alike) - 1} more" if len(alike) > 1 else ""
        return f"{bodies[largest]}{others} {direction} {shares[largest]:.0f} %"
    phase = [
        (velocities[b] * velocities[alike[0]].conj()).real
        / abs(velocities[b] * velocities[alike[0]])
        for b in alike
    ]
    in_phase, opposed = (
        [b for b, c in zip(alike, phase, strict=True) if sign * c > IN_PHASE] for sign in (1, -1)
    )
    rounded = [f"{shares[b]:.0f}" for b in alike]
    amounts = f"{rounded[0]} % each" if len(set(rounded)) == 1 else f"{', '.join(rounded)} %"
    one, other = (", ".join(bodies[b] for b in group) for group in (in_phase, opposed))
    if len(in_phase) == len(alike):
        return f"{one} {direction} in phase {amounts}"
    if len(in_phase) + len(opposed) == len(alike):
        return f"{one} against {other} {direction} {amounts}"
    return f"{', '.join(bodies[b] for b in alike)} {direction} out of phase {amounts}"
