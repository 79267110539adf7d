"""Several equilibria: searches from many starts at once, and their results in order of energy, with
the stability of each."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import check_key, positive_number, whole_number
from jaxbody.core.arrays import Array, Float
from jaxbody.core.compilation.compile_options import OPTIMIZED, program_with
from jaxbody.core.errors import Problems, Status
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.mechanics.equilibria import NOT_AT_REST, Equilibrium, equilibrium_at
from jaxbody.mechanics.equilibrium_solvers import (
    SINGULAR,
    SearchResult,
    descend,
    eigenvalue_signs,
)
from jaxbody.mechanics.free_motions import is_closed, moved, on_closures
from jaxbody.mechanics.hessians import configuration_at, expansion, slope, stiffness
from jaxbody.mechanics.load_paths import in_full
from jaxbody.model.element_states import relaxed
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.models import Model, scale_of, scaled, size_of
from jaxbody.model.preconditions import (
    check_attached,
    check_memory,
    check_potential,
    check_precision,
)

# difference of energy, relative to the range of energies, below which two solutions may be the same
SAME = 1e-9
DESCENT_STEPS, NEWTON_STEPS = 200, 60


class Equilibria(Result):
    """Equilibria in order of energy, those of equal energy in order of distance: `solutions` (n
    Equilibrium objects), and arrays (n,): `energies` [J], `stable`, `negative` (number of negative
    eigenvalues of K), `distances` (largest displacement of a body from the reference pose [m]) and
    `hits` (number of searches that ended there). `status` is NOT_CONVERGED if no search ended at an
    equilibrium."""

    status: Any
    solutions: tuple[Equilibrium, ...]
    distances: np.ndarray
    hits: np.ndarray
    searches: int = eqx.field(static=True)

    @property
    def energies(self) -> np.ndarray:
        return np.array([float(eq.energy) for eq in self.solutions])

    @property
    def stable(self) -> np.ndarray:
        return np.array([bool(eq.stable) for eq in self.solutions])

    @property
    def negative(self) -> np.ndarray:
        return np.array([int(eq.negative) for eq in self.solutions])

    def __len__(self) -> int:
        return len(self.solutions)

    def __getitem__(self, i: int):
        return self.solutions[i]

    def _tables(self) -> list[tables.PrintedTable]:
        rows = [
            (
                str(i),
                eq.energy,
                "stable" if eq.stable else f"unstable ({int(eq.negative)})",
                d,
                str(int(n)),
            )
            for i, (eq, d, n) in enumerate(
                zip(self.solutions, self.distances, self.hits, strict=True)
            )
        ]
        return [
            tables.PrintedTable(
                "Equilibria",
                ("", "energy [J]", "stability", "distance [m]", "searches"),
                rows,
                f"{int(self.hits.sum())} of {self.searches} searches ended in these; there may be "
                "more",
            )
        ]


def find_equilibria(
    model: Model, *, starts: int = 64, spread: float = 1.0, key: Array | None = None
) -> Equilibria:
    """Find equilibria, stable and unstable, by searches from many configurations at once: from
    each, one search descends and one follows Newton's method on dV/dDelta = 0 to saddles and maxima
    as well.

    Args:
        starts: number of configurations: the reference pose and random ones.
        spread: standard deviation of the random displacements, in units of the model's size; that
            of rotations is 2 `spread` rad.
        key: random key of the configurations; by default jax.random.key(0).

    With closures each search starts from the nearest configuration that fulfills them, on whichever
    branch of the mechanism that is, and stays on them; positions in which closures are dependent
    are left out.

    Nothing guarantees that all equilibria are found. Those connected by a free motion (singular K,
    equal energy) count as one. Errors: UNATTACHED, WRONG_KIND for a key; warns NOT_CONVERGED if no
    search ends at an equilibrium.

    >>> rod = jb.Body(mass=1.0, inertia=[0.1, 0.1, 0.01], com=[0, 0, -0.5])
    >>> model = jb.Model(
    ...     bodies={"rod": rod},
    ...     gravity=[0, 0, -9.81],
    ...     joints={"rod": jb.Hinge("world", axis=[0, 1, 0])},
    ... )
    >>> jb.find_equilibria(model, starts=16).stable.tolist()
    [True, False]
    """
    check_precision("find_equilibria", model)
    check_potential("find_equilibria", model)
    check_memory("find_equilibria", model)
    check_attached(model)
    with Problems() as problems:
        starts = whole_number(starts, "find_equilibria.starts", problems)
        positive_number(spread, "find_equilibria.spread", problems)
        check_key(key, "find_equilibria.key", problems)
    batch = _search(model, jax.random.key(0) if key is None else key, starts, float(spread))
    status, energies = np.asarray(batch.status), np.asarray(batch.energy)
    converged = [int(i) for i in np.argsort(energies) if status[i] not in NOT_AT_REST]
    tolerance = SAME * (np.ptp(energies[converged]) if converged else 0.0) + 1e-300
    distinct: list[Equilibrium] = []
    hits: list[int] = []
    for i in converged:
        eq = jax.tree.map(lambda x, i=i: x[i], batch)
        same = [j for j, other in enumerate(distinct) if _same(eq, other, tolerance)]
        if same:
            hits[same[0]] += 1
        else:
            distinct.append(eq)
            hits.append(1)
    distances = np.array(
        [distance_between(model, eq.state.q, model.reference.q) for eq in distinct]
    )
    levels = np.cumsum(np.diff([eq.energy for eq in distinct], prepend=-np.inf) > tolerance)
    order = np.lexsort((distances, levels))
    return warn_if_failed(
        Equilibria(
            status=np.array((Status.OK if distinct else Status.NOT_CONVERGED).value),
            solutions=tuple(distinct[i] for i in order),
            distances=distances[order],
            hits=np.array(hits, int)[order],
            searches=len(status),
        )
    )


def _same(one: Equilibrium, other: Equilibrium, tolerance: float) -> bool:
    """Return whether two equilibria have the same configuration, or the same energy and a free
    motion between them."""
    if abs(float(one.energy) - float(other.energy)) > tolerance:
        return False
    near = float(distance_between(one.model, one.state.q, other.state.q)) <= 1e-5 * float(
        size_of(one.model)
    )
    return near or int(one.status) == int(other.status) == Status.SINGULAR_K


@program_with(OPTIMIZED)
def _search(model: Model, key: Array, starts: int, spread: float) -> Equilibrium:
    size, coordinates = size_of(model), Coordinates(relaxed(model))
    scale = scale_of(model, size)
    reach = spread * size * scale * jnp.where(model.layout.turns, 2.0, 1.0)
    moves: Any = reach[None] * jax.random.normal(key, (starts, len(scale)), size.dtype)
    q = jax.vmap(lambda move: moved(coordinates, coordinates.reference.q, move))(
        moves.at[0].set(0.0)
    )

    def descent(q):
        return descend(coordinates, q, scale, size, DESCENT_STEPS)

    def newton_search(q):
        """Search by Newton's method on dV/dDelta, which also stops at saddles and maxima."""

        def step(carry, _):
            q, _ = carry
            _, g, K = expansion(configuration_at(coordinates, q, base=False))
            g, K = on_closures(coordinates, q, g * scale, scaled(K, scale), scale)
            y = -jnp.linalg.pinv(K, rtol=SINGULAR, hermitian=True) @ g
            longest = jnp.max(jnp.abs(y), initial=0.0)
            y = y * jnp.where(longest > size / 4, size / 4 / longest, 1.0)
            unit = jnp.max(jnp.abs(K), initial=0.0)
            done = (longest <= 1e-9 * size) & (
                jnp.max(jnp.abs(g), initial=0.0) <= 1e-9 * unit * size
            )
            return (moved(coordinates, q, scale * y), done), None

        (q, done), _ = jax.lax.scan(step, (q, jnp.array(False)), None, length=NEWTON_STEPS)
        at = configuration_at(coordinates, q, base=False)
        _, K = on_closures(coordinates, q, slope(at) * scale, scaled(stiffness(at), scale), scale)
        return q, eigenvalue_signs(K), done & is_closed(coordinates, q), jnp.array(NEWTON_STEPS)

    def equilibrium(q, signs, converged, steps):
        status = jnp.where(converged, Status.OK.value, Status.NOT_CONVERGED.value)
        negative, singular = signs
        return equilibrium_at(
            coordinates,
            SearchResult(q, negative, singular, status, steps, jnp.ones((), q.dtype)),
            in_full((), q.dtype),
            model,
        )

    both = [jax.vmap(search)(q) for search in (descent, newton_search)]
    return jax.vmap(equilibrium)(*jax.tree.map(lambda *x: jnp.concatenate(x), *both))


def distance_between(
    model: Model, one: Float[Array, "nq"], other: Float[Array, "nq"]
) -> Float[Array, ""]:
    """Return the largest displacement of a body between two configurations [m], with rotations
    times the size of the model."""
    both = jax.vmap(Coordinates(model).at_rest)(jnp.stack([one, other]))
    moved, turned = (
        jnp.sqrt(jnp.sum((x[0] - x[1]) ** 2, axes))
        for x, axes in ((both.p, -1), (both.R, (-2, -1)))
    )
    return jnp.max(jnp.maximum(moved, size_of(model) * turned))
