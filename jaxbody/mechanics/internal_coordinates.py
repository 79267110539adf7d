"""Rows of the coordinates y of elements in the matrices of small motions: the derivatives of V, R
and T in (Delta, y, Xi).

    K_yy = V_yy,   K_yx = V_ye de/dx,   C_yy = R_yy,   C_yx = R_ye de/dx,   M_yy = T_yy,   M_yx = 0,
    x = (Delta, Xi)

Coordinates with mass come first, then those without, whose T_yy is 0. In slow motions y follows x
by K_yy y + K_yx x = 0, so that (x, y) = T x, and a matrix H becomes T' H T.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.mechanics.dynamics import on_coordinates
from jaxbody.mechanics.hessians import (
    Configuration,
    Square,
    damping,
    deformation_slopes,
    expansion,
    frame_twists,
    mass,
)
from jaxbody.model.joints.frame_tables import of_table
from jaxbody.model.laws.law_states import Apart, memories


class InnerRows(NamedTuple):
    """The blocks of K and C between y and (Delta, Xi), and those of y."""

    K_yx: Float[Array, "ny n"]
    K_yy: Float[Array, "ny ny"]
    C_yx: Float[Array, "ny n"]
    C_yy: Float[Array, "ny ny"]
    M_yy: Float[Array, "ny ny"]


def inner_rows(at: Configuration) -> InnerRows:
    """Return the blocks at a configuration of a model in which coordinates of elements (all, or
    those with mass) are coordinates of the system, see `apart` and `settled`."""
    twists, parts, layout = frame_twists(at), [], at.model.layout

    def of(element, *frames):
        return deformation_slopes(element, *frames), element.inner(*element.rates(*frames))

    for table in at.model.elements:
        if any(law.law.has_rows for law in memories(table.rows, Apart)):
            slopes, (V_ye, V_yy, R_ye, R_yy, T_yy) = of_table(at.model, at.frames, table, of)
            J = on_coordinates(at.model, table, slopes, twists)
            n, ny = V_ye.shape[:2]
            K_yx, C_yx = (jnp.reshape(H.reshape(n, ny, -1) @ J, (n * ny, -1)) for H in (V_ye, R_ye))
            parts.append(InnerRows(K_yx, _diagonal(V_yy), C_yx, _diagonal(R_yy), _diagonal(T_yy)))
    K_yx, C_yx = (
        jnp.concatenate([getattr(part, name) for part in parts]) for name in ("K_yx", "C_yx")
    )
    from jax.scipy.linalg import block_diag  # few models have inner coordinates

    K_yy, C_yy, M_yy = (
        block_diag(*(getattr(part, name) for part in parts)) for name in ("K_yy", "C_yy", "M_yy")
    )
    if 0 < len(layout.inertial) < len(K_yy):
        places = layout.inner_places[: len(K_yy)]
        order = np.searchsorted(np.sort(places), places)
        K_yx, C_yx, K_yy, C_yy, M_yy = (
            K_yx[order],
            C_yx[order],
            *(H[order][:, order] for H in (K_yy, C_yy, M_yy)),
        )
    return InnerRows(K_yx, K_yy, C_yx, C_yy, M_yy)


def _diagonal(blocks: Float[Array, "n k k"]) -> Array:
    """Return the matrix with these blocks on its diagonal."""
    n, k, _ = blocks.shape
    return jnp.swapaxes(
        jnp.eye(n, dtype=blocks.dtype)[:, :, None, None] * blocks[:, None], 1, 2
    ).reshape(n * k, n * k)


def inserted(
    H: Square, H_yx: Float[Array, "ny n"], H_yy: Float[Array, "ny ny"], nv: int
) -> Float[Array, "m m"]:
    """Return the matrix of (Delta, y, Xi) from that of (Delta, Xi) and the blocks of y."""
    return jnp.block(
        [
            [H[:nv, :nv], H_yx[:, :nv].T, H[:nv, nv:]],
            [H_yx[:, :nv], H_yy, H_yx[:, nv:]],
            [H[nv:, :nv], H_yx[:, nv:].T, H[nv:, nv:]],
        ]
    )


def following(K: Square, nv: int, ny: int) -> Float[Array, "n m"]:
    """Return T, with (Delta, y, Xi) = T (Delta, Xi) in slow motions; of K', the combinations of
    rows in which y has no effect to first order."""
    own, x = slice(nv, nv + ny), jnp.concatenate([jnp.arange(nv), jnp.arange(nv + ny, len(K))])
    one = jnp.eye(len(x), dtype=K.dtype)
    return jnp.concatenate([one[:nv], -jnp.linalg.solve(K[own, own], K[own][:, x]), one[nv:]])


def slow_matrices(
    M: Square, K: Square, nv: int
) -> tuple[Float[Array, "nv nv"], Float[Array, "nv nv"]]:
    """Return M and K of Delta alone in slow motions."""
    left, right = following(K.T, nv, len(K) - nv), following(K, nv, len(K) - nv)
    return left.T @ M @ right, left.T @ K @ right


def whole_matrices(at: Configuration) -> tuple[tuple[Float[Array, "m m"], ...], Float[Array, "n"]]:
    """Return M, C and K of (Delta, y, Xi), and dV/d(Delta, Xi), where the coordinates y of
    elements are coordinates of the system in the model of the configuration."""
    nv, nf = at.model.layout.nv, len(at.model.layout.first_order)
    ny = len(at.model.layout.inner) - nf
    _, slope, stiffness = expansion(at)
    whole = mass(at), damping(at), stiffness
    if ny:
        inner, zero = inner_rows(at), jnp.zeros((ny, len(stiffness)), at.q.dtype)
        rows = (zero, inner.M_yy), (inner.C_yx, inner.C_yy), (inner.K_yx, inner.K_yy)
        whole = tuple(inserted(H, *row, nv) for H, row in zip(whole, rows, strict=True))
    if nf:  # rows of force elements, which `lagrange.force_matrices` fills
        own = jnp.zeros((nf, len(whole[0])), at.q.dtype), jnp.zeros((nf, nf), at.q.dtype)
        whole = tuple(inserted(H, *own, nv + ny) for H in whole)
    return whole, slope
