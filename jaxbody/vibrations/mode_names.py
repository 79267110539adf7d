"""What modes are called: bodies and the direction with most of the kinetic energy, and whether several move in phase or against each other.

A body's shares in the energy of the shape phi are those of its center of mass and its turn, world axes: conj(v_i) (M_b v)_i/(phi* M phi), v its velocities along phi.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Array, Float

from jaxbody.core.arrays import concrete
from jaxbody.core.compile_options import jit_unoptimized
from jaxbody.mechanics.hessians import configuration_at
from jaxbody.mechanics.kinematics import Coordinates
from jaxbody.models.models import Model

AXES = "xyz"
ALIKE = 0.5  # of the largest share, above which another body that moves in the same direction is named too
MOST_NAMED = 4  # bodies; where more are alike they are counted
IN_PHASE = 0.7  # cosine of the phase between two bodies, above which they are in phase, and below minus which against each other
TIED = 1e-6  # relative difference of shares, below which the first in order has most
PARALLEL = 1e-12  # square of a shape's length across the others of its cluster, below which it is rounding
NEAR = 1e-3  # relative distance of frequencies that is marked
MARK = " ~"
MARK_NOTE = (
    f"~ frequencies within {100 * NEAR:g} % of each other: changes of the model as small mix these shapes and energies; take them together"
)


def direction_names(model: Model, forward: str | None = None, up: str | None = None) -> tuple[str, ...]:
    """What three translations and three rotations along and about world axes are called, where up is known, given or from gravity, and forward."""
    up = up or upward_axis(model)
    words = {up: ("bounce", "yaw")} if up else {}
    if forward:
        words |= {forward: ("fore-aft", "roll"), next(iter(set(AXES) - {forward, up})): ("lateral", "pitch")}
    named = [words.get(axis, (f"along {axis}", f"about {axis}")) for axis in AXES]
    return tuple(word for word, _ in named) + tuple(word for _, word in named)


def upward_axis(model: Model) -> str | None:
    """The axis upwards, where gravity is known and along one."""
    g = concrete(model.gravity)
    if g is None or g.ndim > 1 or np.sum(np.abs(g) > 1e-9 * np.abs(g).max(initial=0.0)) != 1:
        return None
    return AXES[int(np.argmax(np.abs(g)))]


def names_of_shapes(model: Model, q: Float[Array, "nq"], shapes: Any, cluster: Any, values: Any) -> tuple[str, ...]:
    """The names of shapes (columns, real or complex) about the configuration q; `values`: their frequencies or poles."""
    R, J = (None if x is None else np.asarray(x) for x in _placed(model, q))
    assert R is not None
    bodies, shapes, cluster = model.bodies.rows, np.asarray(shapes), np.asarray(cluster)
    nb, nv = len(model.layout.bodies), model.layout.nv
    J = np.eye(nv).reshape(nb, 6, nv) if J is None else J[:nb].swapaxes(1, 2)
    arms = np.einsum("bij,bj->bi", R, bodies.com)
    V = np.concatenate([J[:, :3] + np.cross(J[:, 3:], arms[:, :, None], axis=1), J[:, 3:]], 1)
    inertia = np.asarray(bodies.inertia)
    inertia = R @ ((inertia + inertia.swapaxes(1, 2)) / 2) @ R.swapaxes(1, 2)
    P = np.concatenate([np.asarray(bodies.mass)[:, None, None] * V[:, :3], inertia @ V[:, 3:]], 1)

    def shares(x: np.ndarray) -> np.ndarray:
        """[%] of the columns together."""
        energies = ((V @ x).conj() * (P @ x)).real.sum(-1)
        return 100 * energies / energies.sum()

    spaces = [shapes[:, cluster == c] for c in cluster]
    each = [shares(_basis(x, np.einsum("bik,bil->kl", V, P)) if x.shape[1] > 1 and np.isfinite(x).all() else x) for x in spaces]
    return mode_names(model.layout.bodies, direction_names(model), np.stack(each, -1), V @ shapes, cluster, values)


def _basis(shapes: np.ndarray, M: np.ndarray) -> np.ndarray:
    """The same space, x* M x = 1 and orthogonal in M; poles that coincide have shapes that are not."""
    values, vectors = np.linalg.eigh(shapes.conj().T @ M @ shapes)
    kept = values > PARALLEL * values[-1]
    return shapes @ vectors[:, kept] / np.sqrt(values[kept])


@jit_unoptimized
def _placed(model: Model, q: Float[Array, "nq"]):
    """The orientations of the bodies and J of `hessians`."""
    at = configuration_at(Coordinates(model), q, base=False)
    return at.frames.R[model.layout.first_body :], at.J


def mode_names(
    bodies: tuple[str, ...], directions: tuple[str, ...], shares: Any, velocities: Any, cluster: Any, values: Any
) -> tuple[str, ...]:
    """The name of each mode from shares [%] and velocities (bodies, 6, modes); with how many it coincides, and a mark where another is near."""
    shares, velocities, cluster = np.asarray(shares), np.asarray(velocities), np.asarray(cluster)
    marked, shared = nearly_coinciding(cluster, values), (cluster[:, None] == cluster).sum(0)
    names = []
    for i, count in enumerate(shared):
        if not np.isfinite(shares[..., i]).all():
            names.append("")
            continue
        top, d = np.argwhere(shares[..., i] >= (1 - TIED) * shares[..., i].max())[0]
        alike = [top] if count > 1 else np.flatnonzero(shares[:, d, i] >= ALIKE * shares[top, d, i])
        name = _name(bodies, directions[d], alike, top, shares[:, d, i], velocities[:, d, i])
        names.append(name + (f" (one of {count})" if count > 1 else "") + (MARK if marked[i] else ""))
    return tuple(names)


def nearly_coinciding(cluster: Any, values: Any) -> np.ndarray:
    """Which modes nearly coincide with another, by frequencies or poles."""
    values, cluster = np.asarray(values), np.asarray(cluster)
    size = np.maximum(np.abs(values)[:, None], np.abs(values))
    close = np.abs(values[:, None] - values) <= NEAR * size
    return (close & (size > 0) & (cluster[:, None] != cluster)).any(1)


def mark_note(names: tuple[str, ...]) -> str:
    """The word for a note on what the mark means, where one of the names has it."""
    return MARK_NOTE if any(name.endswith(MARK) for name in names) else ""


def _name(bodies: tuple[str, ...], direction: str, alike: Any, top: int, shares: np.ndarray, velocities: Any) -> str:
    if len(alike) == 1 or len(alike) > MOST_NAMED:
        others = f" and {len(alike) - 1} more" if len(alike) > 1 else ""
        return f"{bodies[top]}{others} {direction} {shares[top]:.0f} %"
    phase = [(velocities[b] * velocities[alike[0]].conj()).real / abs(velocities[b] * velocities[alike[0]]) for b in alike]
    together, against = ([b for b, c in zip(alike, phase, strict=True) if sign * c > IN_PHASE] for sign in (1, -1))
    rounded = [f"{shares[b]:.0f}" for b in alike]
    amounts = f"{rounded[0]} % each" if len(set(rounded)) == 1 else f"{', '.join(rounded)} %"
    one, other = (", ".join(bodies[b] for b in group) for group in (together, against))
    if len(together) == len(alike):
        return f"{one} {direction} in phase {amounts}"
    if len(together) + len(against) == len(alike):
        return f"{one} against {other} {direction} {amounts}"
    return f"{', '.join(bodies[b] for b in alike)} {direction} out of phase {amounts}"
