"""Robust losses, which penalize residuals of many standard deviations less than least squares does.

    soft_l1   rho(r) = c^2 (sqrt(1 + (r/c)^2) - 1)   c = 1.345   like |r| for large r (pseudo-Huber)
    cauchy    rho(r) = c^2/2 log(1 + (r/c)^2)           c = 2.385    outliers have little influence

r in units of the noise; with these c, estimates from Gaussian data have 95 % of the efficiency of
least squares. Fits use root(r) = sign(r) sqrt(2 rho(r)), whose sum of squares is twice the loss, so
that least-squares methods minimize the loss.

Sources: P. Huber, E. Ronchetti, Robust Statistics, 2nd ed. (2009), sections 6.4 (covariance) and
7.7 (scale);
R. Holland, R. Welsch, Comm. Stat. A 6 (1977) 813 (c).
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, as_numpy
from jaxbody.core.errors import JaxbodyError, Problem

LOSSES = {"soft_l1": 1.345, "cauchy": 2.385}


def check_loss(loss: str | None, where: str) -> None:
    """Check that a loss is known. Error: UNKNOWN_LOSS."""
    if loss is not None and loss not in LOSSES:
        raise JaxbodyError(
            Problem("UNKNOWN_LOSS", where, f"is {loss!r:.60}", loss, "None, " + ", ".join(LOSSES))
        )


def root(r: Float[Array, "*m"], loss: str | None) -> Float[Array, "*m"]:
    """Return residuals with the loss applied, sign(r) sqrt(2 rho(r)); r itself without a loss."""
    if loss is None:
        return r
    z = (r / LOSSES[loss]) ** 2
    if loss == "soft_l1":
        return r * jnp.sqrt(2 / (1 + jnp.sqrt(1 + z)))
    small = z < 1e-4
    wide = jnp.where(small, 1.0, z)
    return r * jnp.sqrt(jnp.where(small, 1 - z / 2 + z**2 / 3 - z**3 / 4, jnp.log1p(wide) / wide))


def linearized(r, J, present: np.ndarray, loss: str | None) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals r* and Jacobian J* of the least-squares problem that has the same optimum
    and covariance as the loss.

        r* = rho'(r)/mean rho''(r),   J* = dr/du

    `J` is the Jacobian of root(r); the mean is over samples that are `present`.
    """
    if loss is None:
        return np.asarray(r), np.asarray(J)
    r = jnp.asarray(r)
    each = lambda f: jax.vmap(f)(r)  # noqa: E731
    rho = lambda x: 0.5 * root(x, loss) ** 2  # noqa: E731
    slope, curvature = each(jax.grad(rho)), each(jax.grad(jax.grad(rho)))
    return np.asarray(slope / jnp.mean(curvature[present])), np.asarray(J) / np.asarray(
        each(jax.grad(lambda x: root(x, loss)))
    )[:, None]


def robust_level(mean_of_clipped_squares, start: Array) -> Array:
    """Return the noise level s by Huber's Proposal 2: the mean of min((r/s)^2, c^2), a given
    function of s and c, equals E min(z^2, c^2) for a standard normal z. `start`: initial guess of
    s."""
    c = 1.345  # standard deviations at which residuals are clipped
    tail, density = 0.5 * math.erfc(c / math.sqrt(2)), math.exp(-c * c / 2) / math.sqrt(2 * math.pi)
    expected = (1 - 2 * tail) - 2 * c * density + 2 * c * c * tail
    s = start
    for _ in range(60):
        s = as_numpy(s * (mean_of_clipped_squares(s, c) / expected) ** 0.5)
    return s
