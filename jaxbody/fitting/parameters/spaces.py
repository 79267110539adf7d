"""The space of free parameters of a fit or a design: model and runs as functions of numbers u,
which are zero at the start.

Each parameter contains the leaves that it sets, the factors of ties between them, its form as a
function of u, its bounds and its prior. The space of a design is that of a fit without runs. The
hard points of a suspension are parameters by their names and move every part attached to them.
Searches may begin at random points between the bounds of u.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import checked_dict
from jaxbody.core.arrays import Array, Float, device_array
from jaxbody.core.errors import Problem, Problems
from jaxbody.fitting.parameters.ties_and_bounds import (
    Factor,
    check_alike,
    equation,
    limits_of,
    prior_of,
    ties,
    times,
)
from jaxbody.fitting.parameters.transforms import (
    Elementwise,
    Fraction,
    Parametrization,
    Positive,
    Rotated,
    Shifted,
    parametrize,
)
from jaxbody.geometry import fields
from jaxbody.geometry.fields import Kind
from jaxbody.model.leaf_paths import Leaf, leaves_of, matching, write
from jaxbody.model.models import Model, size_of
from jaxbody.suspension.suspensions import Suspension


class Parameter(eqx.Module):
    """A free parameter.

    `places`: pairs (owner, leaf) of the leaves that it sets; several leaves are tied by `factors`.
    The owner is a run, or "" for the model or its suspension. `form`: its value as a function of
    its u; `low` and `high`: bounds of these u; `prior`: mean and standard deviation."""

    places: tuple[tuple[str, Leaf], ...] = eqx.field(static=True)
    factors: tuple[Factor, ...] = eqx.field(static=True)
    form: Parametrization
    low: Float[np.ndarray, "n"]
    high: Float[np.ndarray, "n"]
    prior: tuple[Array, Array] | None = None

    @property
    def path(self) -> str:
        """The path of its first leaf."""
        return self.places[0][1].path

    @property
    def run(self) -> str:
        """The run, if the parameter affects the readings of only one; else ""."""
        owners = {owner for owner, _ in self.places}
        return owners.pop() if len(owners) == 1 else ""

    def name(self, most: int | None = None) -> str:
        """Return the paths of its leaves, at most `most` of them: "left.stiffness =
        right.stiffness"."""
        more = " = ..." if most is not None and len(self.places) > most else ""
        return equation([leaf.path for _, leaf in self.places[:most]], self.factors[:most]) + more


class Space(eqx.Module):
    """A model, its suspension if there is one, and the runs of its measurements as functions of u:
    `place(u)`."""

    model: Model
    parameters: tuple[Parameter, ...]
    runs: dict[str, Any] = eqx.field(default_factory=dict)
    suspension: Suspension | None = None

    @property
    def size(self) -> int:
        return sum(parameter.form.size for parameter in self.parameters)

    @property
    def prior_rows(self) -> int:
        """The number of residuals of priors, which are last."""
        return sum(p.form.start.size for p in self.parameters if p.prior is not None)

    @property
    def parts(self) -> list[tuple[Parameter, slice]]:
        """Each parameter with its part of u."""
        ends = np.cumsum([0, *(parameter.form.size for parameter in self.parameters)]).tolist()
        return [
            (parameter, slice(i, j))
            for parameter, (i, j) in zip(self.parameters, pairwise(ends), strict=True)
        ]

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The lower and the upper bounds of u."""
        low, high = (
            [np.zeros(0), *(getattr(parameter, end) for parameter in self.parameters)]
            for end in ("low", "high")
        )
        return np.concatenate(low), np.concatenate(high)

    @property
    def labels(self) -> list[str]:
        """The name of each u by its first path: "AB.stiffness", "mount 1.a[0]"."""
        return [
            parameter.path + suffix
            for parameter in self.parameters
            for suffix in parameter.form.labels()
        ]

    @property
    def names(self) -> list[str]:
        """The name of each u by all its paths: "left.stiffness = right.stiffness"."""
        return [
            parameter.name() + suffix
            for parameter in self.parameters
            for suffix in parameter.form.labels()
        ]

    def units(self, parameter: Parameter) -> list[str]:
        """Return the unit of each number of a parameter."""
        return units_of(parameter.places[0][1], self.model, parameter.form.start)

    def values(self, u: Float[Array, "n"]) -> dict[str, Array]:
        """Return {path of the first leaf: value} of each parameter."""
        return {parameter.path: parameter.form.value(u[own]) for parameter, own in self.parts}

    def place(self, u: Float[Array, "n"]) -> tuple[Model, dict[str, Any]]:
        """Return the model and the runs at u."""
        design, runs = self.designed(u)
        return model_of(design), runs

    def designed(self, u: Float[Array, "n"]) -> tuple[Model | Suspension, dict[str, Any]]:
        """Return the suspension, or else the model, and the runs at u."""
        values = self.values(u)
        new: dict[str, dict[Leaf, Array]] = {owner: {} for owner in ("", *self.runs)}
        for parameter in self.parameters:
            for (owner, leaf), factor in zip(parameter.places, parameter.factors, strict=True):
                new[owner][leaf] = times(values[parameter.path], factor)
        if self.suspension is None:
            return write(self.model, new[""]), {
                name: write(run, new[name]) for name, run in self.runs.items()
            }
        points = {
            leaf.path: new[""].pop(leaf)
            for leaf in hard_points_of(self.suspension)
            if leaf in new[""]
        }
        moved = self.suspension.moved(points)
        runs = {
            name: write(run.on(self.suspension, moved), new[name])
            for name, run in self.runs.items()
        }
        return eqx.tree_at(
            lambda suspension: suspension.model, moved, write(moved.model, new[""])
        ), runs

    def of_model(self, runs: dict[str, Any]) -> tuple[Space, np.ndarray]:
        """Return the space of the parameters of the model alone, without priors, with other runs,
        and which u of this space they are."""
        own = np.array([not p.run for p, _ in self.parts for _ in range(p.form.size)], bool)
        kept = tuple(replace(p, prior=None) for p in self.parameters if not p.run)
        return Space(self.model, kept, dict(runs), self.suspension), own

    def arguments(self, u: Float[Array, "n"]) -> tuple[Any, ...]:
        """Return the arguments of a function of the design at u: the suspension, or else the model,
        and the runs if there are any."""
        design, runs = self.designed(u)
        return (design, runs) if runs else (design,)

    def numbers(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the number that each u determines and its derivative with respect to u; for
        orientations and matrices u itself and 1."""
        x, slopes = zip(
            *(parameter.form.numbers(u[own]) for parameter, own in self.parts), strict=True
        )
        return np.concatenate(x), np.concatenate(slopes)

    def ended(self, u: np.ndarray) -> np.ndarray:
        """Return for each component of u the limit of the domain that its parameter is close to,
        "zero" or "one"; "" if it is close to neither."""
        return np.concatenate([parameter.form.ended(u[own]) for parameter, own in self.parts])


def model_of(design: Model | Suspension) -> Model:
    """Return the model of a suspension, or the model itself."""
    return design.model if isinstance(design, Suspension) else design


def arrays_of(model: Model, suspension: Suspension | None) -> list[Any]:
    """Return the arrays that the leaves of a design refer to by index: those of the model, then the
    hard points of its suspension."""
    return jax.tree.leaves(model if suspension is None else (model, suspension.hard_points))


def hard_points_of(suspension: Suspension) -> list[Leaf]:
    """Return the leaves of the hard points, in the order of `arrays_of`."""
    first = jax.tree.structure(suspension.model).num_leaves
    return [
        Leaf(name, first + i, None, 1, Kind("m"))
        for i, name in enumerate(sorted(suspension.hard_points))
    ]


def space_of(
    design: Model | Suspension,
    free: str | Iterable[str],
    where: str,
    *,
    runs: dict[str, Any] | None = None,
    bounds: dict[str, Any] | None = None,
    priors: dict[str, Any] | None = None,
    between: bool = False,
) -> Space:
    """Return the space of the free parameters.

    Args:
        design: the start: a model, or a suspension, whose hard points are paths by their names.
        free: paths, patterns and ties, of the model and the runs.
        where: name of the calling function, for messages.
        runs: {name: measurement}, by default none.
        bounds, priors: {path or pattern: (lower, upper)} and {path or pattern: (mean,
            standard deviation)}, by default none.
        between: True to scale u by the bounds, so that a lower bound of zero can be reached, which
            a logarithm never reaches.

    Errors: WRONG_KIND, UNKNOWN_PATH, LISTED_TWICE, NOTHING_FREE, TIED_APART, BAD_TIE,
    START_ON_BOUND, START_OUTSIDE, BAD_BOUNDS, BAD_PRIOR.
    """
    runs, model = runs or {}, model_of(design)
    suspension = design if isinstance(design, Suspension) else None
    with Problems() as problems:
        bounds = checked_dict(bounds, f"{where}.bounds", "path: (lower, upper)", problems)
        priors = checked_dict(
            priors, f"{where}.priors", "path: (mean, standard deviation)", problems
        )
        if not isinstance(free, str | Iterable):
            problems.add(
                "WRONG_KIND",
                f"{where}.free",
                f"is {free!r:.60}",
                value=free,
                limit="paths or patterns",
                hint='Name the unknowns: free=["*.stiffness", "mass.mass"].',
            )
            problems.raise_if_any()
        own = [*leaves_of(model), *([] if suspension is None else hard_points_of(suspension))]
        owner = dict.fromkeys(own, "") | {
            leaf: run for run, tree in runs.items() for leaf in leaves_of(tree, f"{run}.")
        }
        arrays = {"": arrays_of(model, suspension)} | {
            name: jax.tree.leaves(tree) for name, tree in runs.items()
        }
        absent = {
            f"{name}.{path}": hint
            for name, run in runs.items()
            for path, hint in run.absent().items()
        }
        selected = ties(
            list(owner),
            [free] if isinstance(free, str) else free,
            f"{where}.free",
            problems,
            absent,
        )
        if problems.collected:  # bounds of these paths would be reported, too
            bounds, priors = {}, {}
        leaves, size, parameters = [leaf for tie in selected for leaf in tie], size_of(model), []
        bounded, expected = (
            _by_leaf(leaves, given, f"{where}.{of}", problems)
            for given, of in ((bounds, "bounds"), (priors, "priors"))
        )
        for tie in selected:
            first, starts = next(iter(tie)), [leaf.read(arrays[owner[leaf]]) for leaf in tie]
            form = parametrize(first, starts[0], model, size)
            if owner[first] and isinstance(form, Shifted):
                form = _of_run(
                    form,
                    runs[owner[first]].scale_of(
                        first.path.removeprefix(f"{owner[first]}."), first.kind.unit
                    ),
                )
            limits = [
                (leaf, factor, given)
                for leaf, factor in tie.items()
                for given in bounded.get(leaf, ())
            ]
            low, high = limits_of(form, starts[0], limits, f"{where}.bounds", problems)
            if between and (
                isinstance(form, Shifted | Positive) or first.kind.domain == "nonnegative"
            ):
                form = _between(form, starts[0], low, high, size)
            if isinstance(form, Problem):
                problems.collected.append(form)
                continue
            check_alike(tie, starts, form, problems)
            low, high = (
                (form.inverse(low), form.inverse(high))
                if limits and isinstance(form, Elementwise)
                else form.unbounded()
            )
            given = [
                (leaf, factor, given)
                for leaf, factor in tie.items()
                for given in expected.get(leaf, ())
            ]
            parameters.append(
                Parameter(
                    tuple((owner[leaf], leaf) for leaf in tie),
                    tuple(tie.values()),
                    form,
                    low,
                    high,
                    prior_of(form, given, f"{where}.priors", problems),
                )
            )
    return Space(model, tuple(parameters), runs, suspension)


def _by_leaf(
    leaves: list[Leaf], given: dict[str, Any], where: str, problems: Problems
) -> dict[Leaf, list[Any]]:
    """Return {leaf: values in `given`}, for all patterns that match the leaf."""
    values: dict[Leaf, list[Any]] = {}
    for pattern, matches in matching(leaves, given, where, problems).items():
        for leaf in matches:
            values.setdefault(leaf, []).append(given[pattern])
    return values


def _of_run(form: Shifted, scale: Any) -> Shifted:
    """Return x0 + s u with the scale s that a measurement gives for one of its parameters; the form
    itself if it gives none."""
    return (
        form
        if scale is None
        else Shifted(form.start, jnp.maximum(jnp.max(jnp.abs(form.start)), scale))
    )


def _between(
    form: Parametrization | Problem, start: Array, low: np.ndarray, high: np.ndarray, size: Any
) -> Parametrization | Problem:
    """Return x0 + s u with s half the distance between the bounds, also for a positive number with
    a lower bound of zero; the form itself if a bound is infinite."""
    finite = np.isfinite(high - low).all()
    if isinstance(form, Shifted):
        return Shifted(start, device_array((high - low).max() / 2)) if finite else form
    if (low == 0).all() and (finite or isinstance(form, Problem)):
        return _between(Shifted(start, size), start, low, high, size)
    return form


def units_of(leaf: Leaf, model: Model, value: Array) -> list[str]:
    """Return the unit of each number of a leaf, for an initial state those of the coordinates; ""
    for none, as of a quaternion, or if unknown."""
    if leaf.kind.domain not in ("configuration", "speeds"):
        return fields.units_of(leaf.kind, value.shape)
    row = model.layout.v_units if leaf.kind.domain == "speeds" else model.layout.q_units
    return list(row) * (value.size // len(row))


def around(space: Space, count: int, spread: float, seed: int) -> np.ndarray:
    """Return `count` points (count, n) of a Sobol sequence between the bounds of u; where u has no
    bound, -spread or spread is used."""
    from scipy.stats import qmc

    low, high = (
        np.where(np.isfinite(end), end, sign * spread)
        for end, sign in zip(space.bounds, (-1, 1), strict=True)
    )
    sequence = qmc.Sobol(len(low), rng=np.random.default_rng(seed))
    return low + (high - low) * sequence.random_base2((count - 1).bit_length())[:count]


def drawn(
    space: Space, low: np.ndarray, high: np.ndarray, count: int, key: Any, where: str
) -> np.ndarray:
    """Return u = 0 and random starts (count, n), uniform between the bounds `low` and `high` of u.
    Orientations are uniform over all rotations, fractions uniform between their bounds or in their
    domain. Without a key that of 0 is used. Error: NO_BOUNDS."""
    if count == 1:
        return np.zeros((1, space.size))
    key = jax.random.key(0) if key is None else key
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)).ravel())
    with Problems() as problems:
        u = [
            _drawn(parameter, low[own], high[own], count, rng, where, problems)
            for parameter, own in space.parts
        ]
    return np.concatenate([np.zeros((1, space.size)), np.concatenate(u, 1)[1:]])


def _drawn(
    parameter: Parameter,
    low: np.ndarray,
    high: np.ndarray,
    count: int,
    rng: np.random.Generator,
    where: str,
    problems: Problems,
):
    form, shape = parameter.form, (count, parameter.form.size)
    if isinstance(form, Rotated):
        from scipy.spatial.transform import Rotation  # slow to import

        return Rotation.from_quat(rng.normal(size=(count, 4)), scalar_first=True).as_rotvec()
    if isinstance(form, Fraction):  # bounded by its domain
        ends = [np.asarray(form.value(end)) for end in (low, high)]
        return np.array([form.inverse(rng.uniform(*ends)) for _ in range(count)])
    if not isinstance(form, Elementwise):
        return 0.3 * rng.normal(size=shape)  # directions, matrices, rows in order: without bounds
    if not np.isfinite(high - low).all():
        problems.add(
            "NO_BOUNDS",
            f"{where}['{parameter.path}']",
            "is missing",
            limit="both finite",
            hint="Random starts need bounds.",
        )
    return rng.uniform(low, high, shape) if not problems.collected else np.zeros(shape)
