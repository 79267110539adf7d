"""Load paths: equilibrium under loads that are raised step by step from nothing, Newton's method at each step.

    dV/dDelta = lambda Q,   K = d2V/dDelta2 - lambda dQ/dDelta,   lambda from 0 to 1

Q is the generalized force of the loads in the chart. A step is taken where Newton's method converges and K stays positive, so the path stays
on the stable branch that the unloaded equilibrium is on; else it is quartered.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxbody.derivatives import expansion, slope
from jaxbody.frames import Frame, Pose
from jaxbody.kinematics import Coordinates, supports_at
from jaxbody.loads import Load
from jaxbody.models import Model
from jaxbody.rotations import product, skew

FIRST, LEAST, MOST = 0.25, 1e-5, 60  # steps of lambda: the first, the smallest, how many
ITERATIONS = 10  # of Newton's method, within a step
CONVERGED = 1e-10  # its last move, relative to the size of the model
SHIFT = 1e-11  # keeps a free motion from making the system singular
SINGULAR = 1e-10


class Raised(eqx.Module):
    """What is raised with lambda: loads, each times its weight (as at time 0), and a change of gravity."""

    loads: tuple[Load, ...]
    weights: Float[Array, "n"]
    gravity: Float[Array, "3"]


class Path(eqx.Module):
    """The steps taken: lambda and the smallest eigenvalue of the nondimensional K over its largest without loads; NaN where a step failed."""

    factor: Float[Array, "n"]
    smallest: Float[Array, "n"]


def with_gravity(model: Model, change: Float[Array, "3"]) -> Model:
    """The model with g + change."""
    return eqx.tree_at(lambda m: m.gravity, model, model.gravity + change)


def generalized(model: Model, q, loads: tuple[Load, ...], weights: Float[Array, "n"], delta: Float[Array, "nv"]) -> Float[Array, "nv"]:
    """Q at q (+) Delta, in the rates of Delta: the virtual power sum of F . v* + M . w*, supports at their reference poses."""
    layout = model.layout
    if not loads:
        return jnp.zeros_like(delta)
    zero = jnp.zeros((len(layout.supports), 6), q.dtype)

    def poses(delta):
        coordinates = Coordinates(model)
        return coordinates.frames(coordinates.retract(q, delta), jnp.zeros_like(delta), supports_at(model, zero, zero)).pose()

    at, pull = jax.vjp(poses, delta)
    p, R = jnp.zeros_like(at.p), jnp.zeros_like(at.R)
    t, still = jnp.zeros((), q.dtype), jnp.zeros(3, q.dtype)
    for load, weight in zip(loads, weights, strict=True):
        i = layout.frame(load.on)
        F, M = load.wrench(t, Frame(at.p[i], at.R[i], still, still))
        p = p.at[i].add(weight * F)
        R = R.at[i].add(weight * product(skew(M), at.R[i]) / 2)  # as <[M] R, [w] R>/2 = M . w
    return pull(Pose(p, R))[0]


def stiffness_of_loads(model: Model, q, loads: tuple[Load, ...], weights: Float[Array, "n"]) -> Float[Array, "nv nv"]:
    """dQ/dDelta."""
    zero = jnp.zeros(model.layout.nv, q.dtype)
    if not loads:
        return jnp.zeros((len(zero), len(zero)), q.dtype)
    return jax.jacfwd(lambda delta: generalized(model, q, loads, weights, delta))(zero)


def residual(model: Model, q, raised: Raised, factor=1.0) -> Float[Array, "nv"]:
    """dV/dDelta - lambda Q."""
    nv = model.layout.nv
    Q = generalized(model, q, raised.loads, raised.weights, jnp.zeros(nv, q.dtype))
    return slope(with_gravity(model, factor * raised.gravity), q)[:nv] - factor * Q


def tangent(model: Model, q, raised: Raised, factor=1.0) -> Float[Array, "nv nv"]:
    """K = d2V/dDelta2 - lambda dQ/dDelta."""
    K = expansion(with_gravity(model, factor * raised.gravity), q, base=False)[2]
    return K - factor * stiffness_of_loads(model, q, raised.loads, raised.weights)


def follow(model: Model, q, raised: Raised, scale: Float[Array, "nv"], size: Float[Array, ""]):
    """(q, lambda, path, whether K turns negative ahead): as far along the path from the unloaded equilibrium q as it goes."""

    def nondimensional(q, factor):
        return residual(model, q, raised, factor) * scale, tangent(model, q, raised, factor) * scale * scale[:, None]

    top = jnp.max(jnp.abs(jnp.linalg.eigvalsh(nondimensional(q, 0.0)[1])), initial=0.0)

    def spectrum(K):
        """The smallest eigenvalue, relative to the largest without loads."""
        return jnp.min(jnp.linalg.eigvalsh((K + K.T) / 2), initial=jnp.inf) / jnp.where(top > 0, top, 1.0)

    def newton(carry, _):
        q, factor, _ = carry
        r, K = nondimensional(q, factor)
        unit = jnp.max(jnp.abs(K), initial=0.0)
        y = -jnp.linalg.solve(K + SHIFT * jnp.where(unit > 0, unit, 1.0) * jnp.eye(len(scale), dtype=K.dtype), r)
        longest = jnp.max(jnp.abs(y), initial=0.0)
        y = y * jnp.where(longest > size / 2, size / 2 / longest, 1.0)
        return (Coordinates(model).retract(q, scale * y), factor, longest), None

    def step(carry):
        q, factor, length, n, path = carry
        target = jnp.minimum(1.0, factor + length)
        (tried, _, move), _ = jax.lax.scan(newton, (q, target, size), None, length=ITERATIONS)
        smallest = spectrum(nondimensional(tried, target)[1])
        good = (move <= CONVERGED * size) & (smallest > -SINGULAR) & jnp.isfinite(tried).all()
        path = Path(path.factor.at[n].set(jnp.where(good, target, jnp.nan)), path.smallest.at[n].set(jnp.where(good, smallest, jnp.nan)))
        q, factor = jnp.where(good, tried, q), jnp.where(good, target, factor)
        return q, factor, jnp.where(good, 2 * length, length / 4), n + 1, path

    zero = jnp.zeros((), q.dtype)
    empty = jnp.full(MOST + 1, jnp.nan, q.dtype)
    start = Path(empty.at[0].set(0.0), empty.at[0].set(spectrum(nondimensional(q, zero)[1])))
    q, factor, _, _, path = jax.lax.while_loop(
        lambda c: (c[1] < 1) & (c[2] > LEAST) & (c[3] <= MOST), step, (q, zero, jnp.asarray(FIRST, q.dtype), 1, start)
    )
    return q, factor, path, _negative_ahead(nondimensional, spectrum, model, q, factor, scale, size)


def _negative_ahead(nondimensional, spectrum, model, q, factor, scale, size) -> Bool[Array, ""]:
    """Whether K turns negative within a size of the model along its softest motion: behind a limit point it does, under a force
    that is too large for any displacement it does not."""
    _, vectors = jnp.linalg.eigh((K := nondimensional(q, factor)[1]) + K.T)
    softest = vectors[:, 0] / jnp.max(jnp.abs(vectors[:, 0]), initial=1e-300)
    moves = size * jnp.concatenate([s := jnp.logspace(-4, 0, 9, dtype=q.dtype), -s])
    ahead = jax.vmap(lambda s: spectrum(nondimensional(Coordinates(model).retract(q, scale * s * softest), factor)[1]))(moves)
    return jnp.any(ahead < -SINGULAR)
