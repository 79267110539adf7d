"""Combinations of the peaks of modes, whose times are unknown: SRSS, CQC, and the sum of
absolute values.

    SRSS       R^2 = sum_j R_j^2,   modes of one frequency are one mode, R_j their sum
    CQC        R^2 = sum_ij rho_ij R_i R_j,   r = w_i/w_j,
               rho_ij = 8 sqrt(z_i z_j) (r z_i + z_j) r^1.5
                        /((1 - r^2)^2 + 4 z_i z_j r (1 + r^2) + 4 (z_i^2 + z_j^2) r^2)
    absolute   R = sum_j |R_j|, an upper bound

rho_ij is the correlation of the displacements of two oscillators under one white noise. Source:
A. Der Kiureghian, Earthquake Eng. Struct. Dyn. 9 (1981) 419; E. L. Wilson, A. Der Kiureghian,
E. P. Bayo, same volume, 187.
"""

from __future__ import annotations

import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float, Int
from jaxbody.numerics.eigenproblems import together

COMBINATIONS = ("SRSS", "CQC", "absolute")


def correlations(
    frequency: Float[Array, "n"], damping: Float[Array, "n"], cluster: Int[Array, "n"]
) -> Float[Array, "n n"]:
    """rho_ij, 1 within a cluster of coinciding frequencies, and 0 between modes without damping."""
    same = together(cluster)
    zi, zj, r = damping[:, None], damping[None], frequency[:, None] / frequency[None]
    product = zi * zj
    root = jnp.sqrt(jnp.where(product > 0, product, 1.0)) * (product > 0).astype(product.dtype)
    below = (1 - r**2) ** 2 + 4 * product * r * (1 + r**2) + 4 * (zi**2 + zj**2) * r**2
    return jnp.where(same, 1.0, 8 * root * (r * zi + zj) * r**1.5 / jnp.where(same, 1.0, below))


def combined(
    modal: Float[Array, "*b n"], rest: Float[Array, "*b"], rho: Float[Array, "n n"], combine: str
):
    """The combined peak of signed peaks of modes and of the rest, which is not correlated with
    them, and the shares of all, (..., n + 1).

    `rho`: correlations, of SRSS those within clusters alone."""
    if combine == "absolute":
        same = (rho == 1).astype(modal.dtype)
        each = jnp.abs(modal @ (same / jnp.sum(same, 0)[None]))
        parts = jnp.concatenate([each, jnp.abs(rest)[..., None]], -1)
        total = jnp.sum(parts, -1)
    else:
        parts = jnp.concatenate([modal * (modal @ rho), rest[..., None] ** 2], -1)
        total = root(jnp.sum(parts, -1))
    return total, parts


def root(square: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """The square root, with the derivative zero at zero."""
    positive = square > 0
    return jnp.where(
        jnp.isnan(square),
        square,
        jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0),
    )
