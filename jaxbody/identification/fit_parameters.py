"""The free parameters of a fit: which leaves paths and patterns mean, one or several tied; their bounds and priors."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxbody.core.errors import Problem, Problems
from jaxbody.experiments.experiments import Experiment
from jaxbody.experiments.measurements import Measurement
from jaxbody.models.leaf_paths import Leaf, leaves_of, matching
from jaxbody.models.models import Model
from jaxbody.models.sizes import size_of
from jaxbody.parameters.ties import Factor, bounds_of_first, check_alike, equation, ties, times
from jaxbody.parameters.transforms import Elementwise, Parametrization, Shifted, pair_of, parametrize, sound_bounds


class FreeParameter(eqx.Module):
    """A free parameter: where it is, once or, tied by factors, several times, each in a run ("" for the model); and how it moves."""

    places: tuple[tuple[str, Leaf], ...] = eqx.field(static=True)
    factors: tuple[Factor, ...] = eqx.field(static=True)
    form: Parametrization

    @property
    def path(self) -> str:
        """Its first place."""
        return self.places[0][1].path

    @property
    def name(self) -> str:
        """All its places: "left.stiffness = right.stiffness"."""
        return equation([leaf.path for _, leaf in self.places], self.factors)

    @property
    def run(self) -> str:
        """The one measurement whose readings alone it moves, or ""."""
        owners = {owner for owner, _ in self.places}
        return owners.pop() if len(owners) == 1 else ""

    def spread(self, value: Array, run: str) -> dict[Leaf, Array]:
        """What its leaves in a run are at a value of the first."""
        return {leaf: times(value, factor) for (owner, leaf), factor in zip(self.places, self.factors, strict=True) if owner == run}


def parts_of(free: tuple[FreeParameter, ...]) -> list[slice]:
    """Which numbers of u each free parameter has."""
    ends = np.cumsum([0, *(f.form.size for f in free)]).tolist()
    return [slice(i, j) for i, j in pairwise(ends)]


def choose(model: Model, experiments: dict[str, Measurement], patterns: list[str]) -> tuple[FreeParameter, ...]:
    """The free parameters that the patterns mean, each with its parametrization; what "a = b" means is one parameter."""
    problems = Problems()
    roots = {"": model, **experiments}
    leaves = [(run, leaf) for run, tree in roots.items() for leaf in leaves_of(tree, f"{run}." if run else "")]
    owner = {leaf: run for run, leaf in leaves}
    arrays = {run: jax.tree.leaves(tree) for run, tree in roots.items()}
    absent = {f"{run}.{path}": hint for run, experiment in experiments.items() for path, hint in experiment.absent().items()}
    found = ties(list(owner), patterns, "fit.free", problems, absent)
    size = size_of(model)
    free = []
    for tie in found:
        group, starts = list(tie), [leaf.read(arrays[owner[leaf]]) for leaf in tie]
        run, leaf = owner[group[0]], group[0]
        experiment, name = experiments.get(run), leaf.path.removeprefix(f"{run}.").removesuffix(f".{leaf.field}")
        sensor = experiment.sensors.get(name) if isinstance(experiment, Experiment) else None
        form = parametrize(leaf, starts[0], model, size)
        if isinstance(experiment, Experiment) and sensor is not None and leaf.field in sensor.stages and isinstance(form, Shifted):
            form = of_instrument(leaf.kind.unit, starts[0], experiment, name)
        if isinstance(form, Problem):
            problems.collected.append(form)
        else:
            check_alike(tie, starts, form, problems)
            free.append(FreeParameter(tuple((owner[leaf], leaf) for leaf in group), tuple(tie.values()), form))
    problems.raise_if_any()
    return tuple(free)


def limits_of(free: tuple[FreeParameter, ...], bounds: dict[str, tuple[Any, Any]], method: Any) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of u, from bounds of values."""
    problems = Problems()
    low, high = [np.full(f.form.size, -np.inf) for f in free], [np.full(f.form.size, np.inf) for f in free]
    if bounds and not (isinstance(method, str) and method == "least_squares"):
        problems.add("BAD_BOUNDS", "fit.bounds", 'are kept by method="least_squares" only', value=method)
    if not _is_dict(bounds, "fit.bounds", "BAD_BOUNDS", "(lower, upper)", problems):
        bounds = {}
    place = {leaf: (i, factor) for i, f in enumerate(free) for (_, leaf), factor in zip(f.places, f.factors, strict=True)}
    for pattern, leaves in matching(list(place), bounds, "fit.bounds", problems).items():
        for leaf in leaves:
            i, factor = place[leaf]
            form, where = free[i].form, f"fit.bounds['{leaf.path}']"
            ends = pair_of(bounds[pattern], form.start.shape)
            ends = ends and bounds_of_first(ends, factor)
            if sound_bounds(form, ends, bounds[pattern], where, problems):
                low[i], high[i] = np.maximum(low[i], form.inverse(ends[0])), np.minimum(high[i], form.inverse(ends[1]))  # pyright: ignore
    problems.raise_if_any()
    return np.concatenate(low), np.concatenate(high)


def _is_dict(given: Any, where: str, code: str, pair: str, problems: Problems) -> bool:
    if not isinstance(given, dict):
        told, hint = f"is {given!r:.60}", f'Write {{"s.stiffness": {pair}}}; a pattern such as "*.stiffness" will do too.'
        problems.add(code, where, told, value=given, limit="a dict of pairs by path", hint=hint)
    return isinstance(given, dict)


def priors_of(free: tuple[FreeParameter, ...], priors: dict[str, tuple[Any, Any]]) -> dict[str, tuple[Array, Array]]:
    """{path: (mean, standard deviation)} of free parameters, as arrays of their shapes."""
    problems = Problems()
    if not _is_dict(priors, "fit.priors", "BAD_PRIOR", "(mean, standard deviation)", problems):
        priors = {}
    forms = {leaf: (f, np.asarray(factor)) for f in free for (_, leaf), factor in zip(f.places, f.factors, strict=True)}
    found = {}
    for pattern, leaves in matching(list(forms), priors, "fit.priors", problems).items():
        for leaf in leaves:
            (parameter, factor), form = forms[leaf], forms[leaf][0].form
            pair = pair_of(priors[pattern], form.start.shape)
            where = f"fit.priors['{leaf.path}']"
            if not isinstance(form, Elementwise):
                problems.add("BAD_PRIOR", where, "has no prior of its own", hint="Priors are for scalars and vectors.")
            elif pair is None or not np.isfinite(pair).all() or not (pair[1] > 0).all():
                told = f"is {priors[pattern]!r:.60}"
                problems.add("BAD_PRIOR", where, told, value=priors[pattern], limit="(mean, standard deviation > 0), finite")
            else:
                found[parameter.path] = (jnp.asarray(pair[0] / factor), jnp.asarray(pair[1] / np.abs(factor)))
    problems.raise_if_any()
    return found


def of_instrument(unit: str, start: Array, experiment: Experiment, sensor: str) -> Parametrization:
    """The parametrization of what an instrument makes of its readings, by its unit: a gain has none (either sign: an instrument may be turned
    round), a delay has seconds, bias and start those of the reading."""
    measured = experiment.measured[sensor]
    if unit == "":
        least = jnp.ones(())
    elif unit == "s":
        least = (experiment.times[-1] - experiment.times[0]) / (len(experiment.times) - 1)
    else:
        least = jnp.sqrt(jnp.nanmean(measured**2))
    return Shifted(start, jnp.maximum(jnp.max(jnp.abs(start)), jnp.where(least > 0, least, 1.0)))
