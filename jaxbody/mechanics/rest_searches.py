"""Searches for an equilibrium: by descent of the potential energy, or along the path of loads that
are raised from zero.

A model with closures is first moved to the nearest configuration that fulfils them, and stays on
them in all steps.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float, Int, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Status
from jaxbody.mechanics.constraints import closed
from jaxbody.mechanics.descents import descend, eigenvalue_signs
from jaxbody.mechanics.free_motions import is_closed
from jaxbody.mechanics.hessians import configuration_at
from jaxbody.mechanics.load_paths import AppliedLoads, Path, dead_forces, follow_load_path
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.memories import relaxed
from jaxbody.model.models import Model
from jaxbody.model.sizes import scale_of, size_of
from jaxbody.numerics.precisions import reachable
from jaxbody.numerics.xla_workarounds import any_of_batch

# distance from the start, in sizes of the model, beyond which the model falls without limit
RUNAWAY = 20
AT_REST = (Status.OK, Status.TABLE_RANGE)  # stable and isolated: a run may start there
LOADABLE = (*AT_REST, Status.SINGULAR_K)  # loads may be raised from there
# least ratio of eigenvalues of K at the start of a path; with only cubic springs a search ends
# at 1e-9
SOFTEST = 1e-7
# error of K at the end of a path, which is that of the last iterate, relative to its norm
ITERATED = 1e-10


class SearchResult(eqx.Module):
    """The end of a search: the configuration, the number of negative eigenvalues of K and whether
    one is zero, the status except for stability."""

    q: Float[Array, "nq"]
    negative: Int[Array, ""]
    singular: Bool[Array, ""]
    status: Int[Array, ""]
    steps: Int[Array, ""]
    factor: Float[Array, ""]
    path: Path | None = None
    descended: Any = False


def search_by_descent(
    coordinates: Coordinates,
    start: Float[Array, "nq"] | None,
    max_steps,
    applied: AppliedLoads | None = None,
) -> SearchResult:
    """The search by descent from the start, or from the reference pose."""
    frozen, applied = jax.lax.stop_gradient((coordinates, applied))
    start = frozen.reference.q if start is None else jax.lax.stop_gradient(start)
    size = size_of(frozen.model)
    if frozen.model.closures:
        start = closed(frozen, start)
    q, (negative, singular), converged, steps = descend(
        frozen, start, scale_of(frozen.model, size), size, max_steps, applied
    )
    moved = jnp.max(
        jnp.abs(q - start) * jnp.where(frozen.model.layout.angular, size, 1.0), initial=0.0
    )
    runaway = ~converged & (moved > RUNAWAY * size)
    status = jnp.select(
        [runaway, ~converged],
        [Status.NO_EQUILIBRIUM.value, Status.NOT_CONVERGED.value],
        Status.OK.value,
    )
    if frozen.model.closures:
        status = jnp.where(is_closed(frozen, start), status, Status.NOT_CLOSED.value)
    return SearchResult(q, negative, singular, status, steps, jnp.ones((), q.dtype))


def search_under_loads(
    model: Model, unloaded: Any, start, applied: AppliedLoads, max_steps: int, *, many: bool = False
) -> SearchResult:
    """The search under loads, by their path or by descent; `many`: for each row of the weights and
    changes of gravity.

    There are two programs, because few models need the second; inside a user's program both are
    part of it."""
    search, settled = along_path(model, unloaded, applied, many)

    def descended():
        return _by_descent(
            model, start, applied, max_steps, many, search, settled, unloaded.state.z
        )

    if is_concrete(settled):
        return search if np.asarray(settled).all() else descended()
    return jax.lax.cond(any_of_batch(~jnp.all(settled)), descended, lambda: search)


@program
def along_path(
    model: Model, unloaded: Any, applied: AppliedLoads, many: bool
) -> tuple[SearchResult, Bool[Array, "*n"]]:
    """The search along the load path from the unloaded equilibrium, and whether its result
    is valid: it is not if K is singular at the start, unless the path reached its end or a
    limit point."""
    frozen, loads, q0 = jax.lax.stop_gradient(
        (Coordinates(relaxed(model, unloaded.state.z)), applied, unloaded.state.q)
    )
    size = size_of(frozen.model)
    usable = jnp.isin(unloaded.status, jnp.array(LOADABLE))

    def one(applied, _):
        q, K, factor, path, ahead = follow_load_path(
            frozen, q0, applied, scale_of(frozen.model, size), size
        )
        status = jnp.where(
            factor >= 1,
            Status.OK.value,
            jnp.where(ahead, Status.LIMIT_POINT.value, Status.NO_EQUILIBRIUM.value),
        )
        negative, singular = eigenvalue_signs((K + K.T) / 2, ITERATED)
        search = SearchResult(
            q, negative, singular, status, unloaded.steps, factor, path, jnp.array(False)
        )
        return search, usable & (
            (factor >= 1)
            | (ahead & (factor > 0))
            | (path.smallest[0] > reachable(SOFTEST, q0.dtype))
        )

    starts = jnp.zeros(len(applied.gravity))
    return loads.each(one, starts) if many else one(loads, starts)


@program
def _by_descent(
    model: Model,
    start,
    applied: AppliedLoads,
    max_steps: int,
    many: bool,
    search: SearchResult,
    settled: Bool[Array, "*n"],
    z,
) -> SearchResult:
    """The search by descent of the potential of model and loads, where the result of the path is
    not valid."""
    coordinates = Coordinates(relaxed(model, z))

    def one(applied, others):
        on_path, settled = others
        descent = search_by_descent(coordinates, start, max_steps, applied)
        dead = jnp.isfinite(
            dead_forces(configuration_at(coordinates, descent.q, base=False), applied).V
        )
        status = jnp.where(dead, descent.status, Status.NO_EQUILIBRIUM.value)
        ok = status == Status.OK
        factor = jnp.where(ok, descent.factor, 0.0)
        descent = SearchResult(
            descent.q,
            descent.negative,
            descent.singular,
            status,
            descent.steps,
            factor,
            on_path.path,
            jnp.array(True),
        )
        return jax.tree.map(
            lambda a, b: jnp.where(settled | (~ok & (on_path.factor > 0)), a, b), on_path, descent
        )

    frozen, ends = jax.lax.stop_gradient(applied), (search, settled)
    return frozen.each(one, ends) if many else one(frozen, ends)


def no_loads(dtype) -> AppliedLoads:
    """No loads and no change of gravity."""
    return AppliedLoads((), jnp.zeros(0, dtype), jnp.zeros(3, dtype))
