"""Load paths: equilibrium under loads that are raised step by step from zero, with Newton's method
at each step.

    dV/dDelta = lambda Q,   K = d2V/dDelta2 - lambda dQ/dDelta,   lambda from 0 to 1

Q is the generalized force of the loads with respect to Delta; that of force elements is not
multiplied by lambda. A step is taken if Newton's method
converges, with K positive definite at every iteration, so that the path stays on the stable branch
of the unloaded equilibrium; otherwise the step is divided by four.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float, stack
from jaxbody.geometry.frames import Frame, Pose
from jaxbody.geometry.vectors import cross, dot, product, rotate, skew
from jaxbody.mechanics.free_motions import moved, on_closures
from jaxbody.mechanics.hessians import Configuration, DeadForces, configuration_at, slope, stiffness
from jaxbody.model.elements.second_derivatives import turning
from jaxbody.model.inputs.loads import Load
from jaxbody.model.joints.frame_tables import Acting, at_rest, exerted, exerted_by_loads, total
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.models import Model, scaled
from jaxbody.numerics.precisions import NEWTON, reachable

# steps of lambda: the first step, the smallest step, and the largest number of steps
FIRST, LEAST, MOST = 0.25, 1e-5, 64
ITERATIONS = 10  # most iterations of Newton's method within a step
CONVERGED = 1e-10  # size of the last step of Newton's method, relative to that of the model
# largest move of an iteration, in sizes of the model; a larger one may reach another branch
FARTHEST = 0.25
SHIFT = 1e-11  # keeps a free motion from making the system singular
SINGULAR = 1e-10


class AppliedLoads(eqx.Module):
    """The loads raised with lambda: each load at time 0, times its weight, and a change of gravity.

    Loads of one class on one body may be stacked into one entry of `loads`, whose numbers have a
    further axis, with a row of weights, so that they are traced once."""

    loads: tuple[Load, ...]
    weights: Float[Array, "n"] | tuple[Float[Array, "..."], ...]
    gravity: Float[Array, "*cases 3"]

    def each(self, function, *more):
        """Return function(loads, *more) for each load case: for each row of the weights, of the
        changes of gravity and of the arrays `more`."""

        def one(weights, gravity, *more):
            return function(AppliedLoads(self.loads, weights, gravity), *more)

        return jax.vmap(one)(self.weights, self.gravity, *more)


def in_full(loads: tuple[Load, ...], dtype: Any) -> AppliedLoads:
    """Return these loads, each once, and no change of gravity."""
    return AppliedLoads(loads, jnp.ones(len(loads), dtype), jnp.zeros(3, dtype))


def alike(loads: Sequence[Load]) -> tuple[tuple[Load, ...], list[list[int]]]:
    """Return groups of loads of the same structure, each stacked into one load, and the indices of
    the loads in each group."""
    groups: dict[Any, list[int]] = {}
    for i, load in enumerate(loads):
        numbers, structure = jax.tree.flatten(load)
        groups.setdefault((structure, *map(np.shape, numbers)), []).append(i)
    return tuple(
        jax.tree.map(lambda *rows: stack(list(rows)), *(loads[i] for i in group))
        for group in groups.values()
    ), list(groups.values())


def summed(function: Callable, load: Load, weight: Float[Array, "*k"]) -> Any:
    """Return function(load, weight), summed over the loads of a stack."""
    if weight.ndim == 0:
        return function(load, weight)
    return jax.tree.map(lambda x: jnp.sum(x, 0), jax.vmap(function)(load, weight))


class Path(eqx.Module):
    """The steps taken: lambda and the smallest eigenvalue of the nondimensional K over its largest
    without loads; NaN after the last."""

    factor: Float[Array, "n"]
    smallest: Float[Array, "n"]


def with_gravity(model: Model, change: Float[Array, "3"]) -> Model:
    """Return the model with g + `change` [m/s2]."""
    return eqx.tree_at(lambda m: m.gravity, model, model.gravity + change)


def with_load_gravity(
    at: Configuration, applied: AppliedLoads, factor: Float[Array, ""] | float = 1.0
) -> Configuration:
    """Return the configuration with the fraction `factor` of the change of gravity in `applied`
    added to the gravity of its model."""
    return eqx.tree_at(
        lambda at: at.coordinates.model, at, with_gravity(at.model, factor * applied.gravity)
    )


def acting_at_rest(
    model: Model, frames: Frame, applied: AppliedLoads, factor: Float[Array, ""] | float
) -> Acting:
    """Return the forces and moments of loads, times `factor`, and of the force elements of a model
    that holds its states, on frames at rest."""
    now, parts = at_rest(frames), []

    def one(load, weight):
        wrenches = (wrench for _, wrench in exerted_by_loads(model, now, (load,)))
        return [tuple(factor * weight * x for x in wrench) for wrench in wrenches]

    for load, weight in zip(applied.loads, applied.weights, strict=True):
        parts += [
            ((name,), x) for name, x in zip(load.between, summed(one, load, weight), strict=True)
        ]
    return parts + exerted(model, now)


def generalized_force(
    at: Configuration,
    applied: AppliedLoads,
    factor: Float[Array, ""] | float = 1.0,
    delta: Float[Array, "nv"] | None = None,
) -> Float[Array, "nv"]:
    """Return Q at q (+) Delta for the rates of Delta, by default at q, from the virtual power sum
    of F . v* + M . w*: that of loads, times `factor`, and that of force elements."""
    coordinates, q = at.coordinates, at.q
    delta = jnp.zeros(at.model.layout.nv, q.dtype) if delta is None else delta
    if not applied.loads and not at.model.forces:
        return jnp.zeros_like(delta)
    poses, pull = jax.vjp(
        lambda delta: coordinates.at_rest(coordinates.retract(q, delta)).pose(), delta
    )
    F, M = total(at.model, acting_at_rest(at.model, poses.at_rest(), applied, factor))
    return pull(Pose(F, product(skew(M), poses.R) / 2))[0]  # as <[M] R, [w] R>/2 = M . w


def stiffness_of_loads(
    at: Configuration, applied: AppliedLoads, factor: Float[Array, ""] | float = 1.0
) -> Float[Array, "nv nv"]:
    """Return dQ/dDelta."""
    zero = jnp.zeros(at.model.layout.nv, at.q.dtype)
    if not applied.loads and not at.model.forces:
        return jnp.zeros((len(zero), len(zero)), at.q.dtype)
    return jax.jacfwd(lambda delta: generalized_force(at, applied, factor, delta))(zero)


def residual(
    at: Configuration, applied: AppliedLoads, factor: Float[Array, ""] | float = 1.0
) -> Float[Array, "nv"]:
    """Return dV/dDelta - lambda Q for lambda = `factor`; `at` has no columns for the base."""
    return slope(with_load_gravity(at, applied, factor)) - generalized_force(at, applied, factor)


def tangent(
    at: Configuration, applied: AppliedLoads, factor: Float[Array, ""] | float = 1.0
) -> Float[Array, "nv nv"]:
    """Return K = d2V/dDelta2 - lambda dQ/dDelta for lambda = `factor`; `at` has no columns for the
    base."""
    return stiffness(with_load_gravity(at, applied, factor)) - stiffness_of_loads(
        at, applied, factor
    )


def dead_forces(at: Configuration, applied: AppliedLoads) -> DeadForces:
    """Return the dead forces of the loads at time 0; NaN where a load is not a dead force."""
    layout, t = at.model.layout, jnp.zeros((), at.q.dtype)
    V, G, Q = (
        t,
        [jnp.zeros(6, t.dtype)] * len(layout.bodies),
        [jnp.zeros((3, 3), t.dtype)] * len(layout.bodies),
    )
    for load, weight in zip(applied.loads, applied.weights, strict=True):
        i, frame = layout.bodies.index(load.on), at.frames[layout.frame(load.on)]

        def of(load, weight, frame=frame):
            arm, pull = (
                rotate(frame.R, load.point),
                jnp.where(weight == 0, 0.0, -weight * load.dead_force(t)),
            )
            return (
                dot(pull, frame.p + arm),
                jnp.concatenate([pull, cross(arm, pull)]),
                turning(arm, pull),
            )

        dV, dG, dQ = summed(of, load, weight)
        V, G[i], Q[i] = V + dV, G[i] + dG, Q[i] + dQ
    return DeadForces(V, jnp.stack(G), jnp.stack(Q))


class _At(eqx.Module):
    """A point of the path, or an iterate near it: configuration, lambda, nondimensional K."""

    q: Float[Array, "nq"]
    factor: Float[Array, ""]
    K: Float[Array, "nv nv"]


def follow_load_path(
    coordinates: Coordinates,
    q,
    applied: AppliedLoads,
    scale: Float[Array, "nv"],
    size: Float[Array, ""],
):
    """Return (q, K, lambda, path, whether K turns negative ahead) at the end of the path from the
    unloaded equilibrium q.

    The body of the only loop is one iteration of Newton's method, so that K is compiled once."""
    n, dtype = len(scale), q.dtype
    converged, shift, zero_stiffness = (
        reachable(CONVERGED, dtype, NEWTON),
        reachable(SHIFT, dtype, 8),
        reachable(SINGULAR, dtype),
    )

    def nondimensional(q, factor):
        at = configuration_at(coordinates, q, base=False)
        return on_closures(
            coordinates,
            q,
            residual(at, applied, factor) * scale,
            scaled(tangent(at, applied, factor), scale),
            scale,
        )

    def iterate(carry):
        at, q, target, length, iteration, steps, top, path = carry
        r, K = nondimensional(q, target)
        unit = jnp.max(jnp.abs(K), initial=0.0)
        y = -jnp.linalg.solve(
            K + shift * jnp.where(unit > 0, unit, 1.0) * np.eye(n, dtype=dtype), r
        )
        longest = jnp.max(jnp.abs(y), initial=0.0)
        shifted = moved(coordinates, q, scale * y)
        values = jnp.linalg.eigvalsh((K + K.T) / 2)
        top = jnp.where(steps == 0, jnp.max(jnp.abs(values), initial=0.0), top)
        smallest = jnp.min(values, initial=jnp.inf) / jnp.where(top > 0, top, 1.0)
        arrived = longest <= converged * size
        good = arrived & (smallest > -zero_stiffness)
        ended = (
            arrived
            | (smallest < -zero_stiffness)
            | (iteration >= ITERATIONS)
            | ~(longest <= FARTHEST * size)
        )
        path = Path(
            *(
                x.at[steps].set(jnp.where(good, new, x[steps]))
                for x, new in ((path.factor, target), (path.smallest, smallest))
            )
        )
        at = jax.tree.map(lambda new, old: jnp.where(good, new, old), _At(shifted, target, K), at)
        length = jnp.where(ended, jnp.where(good, 2 * length, length / 4), length)
        return (
            at,
            jnp.where(ended, at.q, shifted),
            jnp.where(ended, jnp.minimum(1.0, at.factor + length), target),
            length,
            jnp.where(ended, 0, iteration + 1),
            jnp.where(good, steps + 1, steps),
            top,
            path,
        )

    def unfinished(carry):
        at, _, _, length, _, steps, _, _ = carry
        return (at.factor < 1) & (length > LEAST) & (steps < MOST)

    zero = jnp.zeros((), dtype)
    empty = jnp.full(MOST, jnp.nan, dtype)
    start = _At(q, zero, jnp.zeros((n, n), dtype))
    at, *_, path = jax.lax.while_loop(
        unfinished,
        iterate,
        (start, q, zero, jnp.asarray(FIRST / 2, dtype), 0, jnp.array(0), zero, Path(empty, empty)),
    )
    return (
        at.q,
        at.K,
        at.factor,
        path,
        _negative_ahead(nondimensional, coordinates, at, scale, size),
    )


def _negative_ahead(
    nondimensional, coordinates: Coordinates, at: _At, scale, size
) -> Bool[Array, ""]:
    """Return whether K turns negative within one size of the model along its softest motion: true
    beyond a limit point, false under a force that no displacement can balance."""
    vectors = jnp.linalg.eigh(at.K + at.K.T)[1]
    softest = vectors[:, 0] / jnp.max(jnp.abs(vectors[:, 0]), initial=1e-300)
    moves = size * jnp.concatenate([s := jnp.logspace(-4, 0, 9, dtype=at.q.dtype), -s])

    def smallest(s):
        K = nondimensional(moved(coordinates, at.q, scale * s * softest), at.factor)[1]
        values = jnp.linalg.eigvalsh((K + K.T) / 2)
        return jnp.min(values, initial=jnp.inf) / jnp.max(jnp.abs(values), initial=1e-300)

    return jnp.any(jax.vmap(smallest)(moves) < -reachable(SINGULAR, at.q.dtype))
