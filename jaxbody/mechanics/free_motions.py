"""The motions that closures leave free at a configuration, and the forces of closures, with
J = dc/dDelta and r = dV/dDelta - Q:

    P = 1 - J^+ J          on the null space of J
    lambda = -(J^+)' r     the multipliers, with which r + J' lambda = 0 at rest
    H = K + d2(lambda c)   second derivatives along the closures: those of V on them are P H P

in scaled increments, in meters. J^+ is the least squares inverse, which allows redundant
conditions; the multipliers of conditions that share a force have the least norm.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float
from jaxbody.mechanics.constraints import CLOSED, RANK, closed, how_open, values_and_slopes
from jaxbody.model.joints.frame_tables import gaps_at, gaps_displaced
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.models import Model, scale_of, scaled, size_of

# a multiplier is unique if its diagonal element of 1 - J J^+ is below this
UNIQUE = 1e-6


class FreeMotions(NamedTuple):
    """The Jacobian J of the closures and its pseudoinverse J^+ at a configuration."""

    J: Float[Array, "n nv"]
    inverse: Float[Array, "nv n"]

    @property
    def projector(self) -> Float[Array, "nv nv"]:
        """P, the projector on the null space of J."""
        return jnp.eye(len(self.inverse), dtype=self.J.dtype) - self.inverse @ self.J

    @property
    def unique(self) -> Bool[Array, "n"]:
        """True for the conditions whose multiplier is unique."""
        return 1 - jnp.sum(self.inverse.T * self.J, 1) < UNIQUE

    def multipliers(self, r: Float[Array, "nv"]) -> Float[Array, "n"]:
        """Return the multipliers lambda = -(J^+)' r, with r = dV/dDelta - Q, scaled
        as J is."""
        return -self.inverse.T @ r

    def stiffness(self, H: Float[Array, "nv nv"]) -> Float[Array, "nv nv"]:
        """Return P H P plus the largest entry of H in the directions that closures prevent, so that
        these directions count as stiff."""
        P = self.projector
        K, unit = P.T @ H @ P, jnp.max(jnp.abs(H), initial=0.0)
        return K + jnp.where(unit > 0, unit, 1.0) * (jnp.eye(len(P), dtype=P.dtype) - P)


def scale_at(model: Model) -> Float[Array, "nv"]:
    """Return the change of each coordinate per scaled increment, without derivatives."""
    return jax.lax.stop_gradient(scale_of(model, size_of(model)))


def scaled_slopes(
    coordinates: Coordinates, q: Float[Array, "nq"], scale: Float[Array, "nv"]
) -> Float[Array, "n nv"]:
    """Return J = dc/dDelta with respect to scaled increments."""
    return values_and_slopes(coordinates, lambda q: gaps_at(coordinates, q), q)[1] * scale[None]


def free_motions(
    coordinates: Coordinates, q: Float[Array, "nq"], scale: Float[Array, "nv"]
) -> FreeMotions:
    """Return the free motions at q."""
    J = scaled_slopes(coordinates, q, scale)
    return FreeMotions(J, jnp.linalg.pinv(J, rtol=RANK))


def curvature(
    coordinates: Coordinates, q: Float[Array, "nq"], multipliers: Float[Array, "n"]
) -> Float[Array, "nv nv"]:
    """Return d2(lambda c)/dDelta2."""
    return jax.hessian(
        lambda delta: multipliers @ gaps_at(coordinates, coordinates.retract(q, delta))
    )(jnp.zeros(coordinates.model.layout.nv, q.dtype))


def on_closures(
    coordinates: Coordinates,
    q: Float[Array, "nq"],
    r: Float[Array, "nv"],
    K: Float[Array, "nv nv"],
    scale: Float[Array, "nv"],
) -> tuple[Float[Array, "nv"], Float[Array, "nv nv"]]:
    """Return the scaled residual r and stiffness K along the closures, unchanged for a model
    without closures."""
    if not coordinates.model.closures:
        return r, K
    free = free_motions(coordinates, q, scale)
    H = K + scaled(curvature(coordinates, q, free.multipliers(r)), scale)
    return free.projector @ r, free.stiffness(H)


def moved(
    coordinates: Coordinates, q: Float[Array, "nq"], delta: Float[Array, "nv"]
) -> Float[Array, "nq"]:
    """Return q (+) Delta, moved to the nearest configuration that fulfills the closures."""
    q = coordinates.retract(q, delta)
    return closed(coordinates, q) if coordinates.model.closures else q


def is_closed(coordinates: Coordinates, q: Float[Array, "nq"]) -> Bool[Array, ""]:
    """Return whether all closures are fulfilled; True for a model without closures."""
    return how_open(coordinates, q) <= CLOSED if coordinates.model.closures else jnp.array(True)


def multipliers_at(
    coordinates: Coordinates, q: Float[Array, "nq"], r: Float[Array, "nv"]
) -> Float[Array, "n"]:
    """Return lambda at q for the residual r."""
    scale = scale_at(coordinates.model)
    return free_motions(coordinates, q, scale).multipliers(r * scale)


def implied_change(
    coordinates: Coordinates,
    q: Float[Array, "nq"],
    r: Float[Array, "nv"],
    K: Float[Array, "nv nv"],
    change: tuple[Float[Array, "nv"], Float[Array, "n"]],
) -> Float[Array, "nv"]:
    """Return Delta of an equilibrium on closures for a change of what it depends on, where `change`
    holds the changes of r + J' lambda at fixed q and lambda, and of c:

    J Delta = -dc,   P (H Delta + dr) = 0"""
    scale = scale_at(coordinates.model)
    free = free_motions(coordinates, q, scale)
    H = scaled(K + curvature(coordinates, q, free.multipliers(r * scale)), scale)
    across = -free.inverse @ change[1]
    along = -jnp.linalg.solve(free.stiffness(H), free.projector @ (change[0] * scale + H @ across))
    return scale * (across + along)


def slopes_by_supports(coordinates: Coordinates, q: Float[Array, "nq"]) -> Float[Array, "n nxi"]:
    """Return dc/dXi, the derivatives of the conditions with respect to displacements of the
    supports."""
    layout = coordinates.model.layout
    zero = jnp.zeros((len(layout.supports), 6), q.dtype)
    J = jax.jacfwd(lambda xi: gaps_displaced(coordinates, q, xi))(zero)
    return J.reshape(len(J), layout.nxi)


def speeds_on_closures(
    coordinates: Coordinates, q: Float[Array, "nq"], own: Float[Array, "nf"]
) -> Float[Array, "nv"]:
    """Return the speeds of all coordinates with J v = 0 from the independent ones, `own`, as a
    function of q with derivatives of any order:

    J_d v_d = -J_i v_i,   solved by (J_d' J_d)^-1 J_d', as redundant conditions are consistent"""
    model = coordinates.model
    scale, independent = scale_at(model), np.array(model.independent, int)
    others = np.setdiff1d(np.arange(len(scale)), independent)
    J = scaled_slopes(coordinates, q, scale)
    J_d, J_i = J[:, others], J[:, independent]
    v_d = -jnp.linalg.solve(J_d.T @ J_d, J_d.T @ (J_i @ (own / scale[independent])))
    return (
        jnp.zeros(len(scale), q.dtype).at[independent].set(own).at[others].set(scale[others] * v_d)
    )


def constraint_force(
    coordinates: Coordinates, q: Float[Array, "nq"], multipliers: Float[Array, "n"]
) -> Float[Array, "nv"]:
    """Return J' lambda, the generalized forces of the closures' multipliers."""
    return jax.grad(
        lambda delta: multipliers @ gaps_at(coordinates, coordinates.retract(q, delta))
    )(jnp.zeros(coordinates.model.layout.nv, q.dtype))


class DependentMotions(eqx.Module):
    """The motion of dependent coordinates: `N`, the changes of all coordinates per unit of the
    independent ones; `S`, those per unit of the supports' Xi; the multipliers lambda; `reaction`,
    lambda dc/dXi; and `smallest`, the smallest singular value of J_d relative to the largest; it is
    zero where the independent coordinates do not determine the others."""

    N: Float[Array, "nv nf"]
    S: Float[Array, "nv nxi"]
    multipliers: Float[Array, "n"]
    reaction: Float[Array, "nxi"]
    smallest: Float[Array, ""]

    def of(self, H: Float[Array, "n n"], inner: int = 0) -> Float[Array, "m m"]:
        """Return the matrix T' H T of the independent coordinates, for a matrix H of (Delta, y, Xi)
        or of Delta alone, with `inner` coordinates y of elements."""
        nv = len(self.N)
        if len(H) == nv:
            return self.N.T @ H @ self.N
        T = self.whole(inner, len(H) - nv - inner)
        return T.T @ H @ T

    def whole(self, inner: int, nxi: int) -> Float[Array, "n m"]:
        """Return T, with (Delta, y, Xi) = T (independent Delta, y, Xi); its blocks are N, 1 and
        S."""
        (nv, nf), dtype = self.N.shape, self.N.dtype
        own = jnp.eye(inner + nxi, dtype=dtype)
        top = [self.N, jnp.zeros((nv, inner), dtype), self.S[:, :nxi]]
        return jnp.block([top, [jnp.zeros((len(own), nf), dtype), own]])


def dependent_motions(
    coordinates: Coordinates,
    q: Float[Array, "nq"],
    r: Float[Array, "nv"],
    independent: tuple[int, ...],
) -> DependentMotions:
    """Return how the dependent coordinates follow the independent ones and the supports at q, where
    r = dV/dDelta - Q."""
    scale, nv = scale_at(coordinates.model), coordinates.model.layout.nv
    own = np.array(independent, int)
    others = np.setdiff1d(np.arange(nv), own)
    free = free_motions(coordinates, q, scale)
    J_d, J_i = free.J[:, others], free.J[:, own]
    inverse = jnp.linalg.pinv(J_d, rtol=RANK)
    J_Xi = slopes_by_supports(coordinates, q)
    N = (
        jnp.zeros((nv, len(own)), q.dtype)
        .at[own]
        .set(np.eye(len(own)))
        .at[others]
        .set(-inverse @ J_i)
    )
    S = jnp.zeros((nv, J_Xi.shape[1]), q.dtype).at[others].set(-inverse @ J_Xi)
    multipliers = -inverse.T @ (r * scale)[others]
    values = jnp.linalg.svdvals(jax.lax.stop_gradient(J_d))
    # more conditions are independent here than in the reference pose
    open_ = jnp.max(jnp.abs(jax.lax.stop_gradient(free.J @ N)), initial=0.0)
    smallest = jnp.where(open_ > 1e-6 * values[0], 0.0, values[-1] / jnp.maximum(values[0], 1e-300))
    return DependentMotions(
        scale[:, None] * N / scale[own][None],
        scale[:, None] * S,
        multipliers,
        multipliers @ J_Xi,
        smallest,
    )


def closure_stiffness(
    coordinates: Coordinates, q: Float[Array, "nq"], multipliers: Float[Array, "n"]
) -> Float[Array, "m m"]:
    """Return the Hessian of lambda c in (Delta, Xi)."""
    layout = coordinates.model.layout

    def work(x):
        moved = coordinates.retract(q, x[: layout.nv])
        return multipliers @ gaps_displaced(coordinates, moved, x[layout.nv :].reshape(-1, 6))

    return jax.hessian(work)(jnp.zeros(layout.nv + layout.nxi, q.dtype))
