"""The free parameters of a fit: the leaves that paths and patterns select, alone or tied; their bounds and priors."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array
from jaxbody.core.errors import Problem, Problems
from jaxbody.experiments.experiments import Experiment
from jaxbody.experiments.measurements import Measurement
from jaxbody.models.leaf_paths import Leaf, leaves_of, matching
from jaxbody.models.models import Model
from jaxbody.models.sizes import size_of
from jaxbody.parameters.ties import Factor, bounds_of_first, check_alike, equation, ties, times
from jaxbody.parameters.transforms import Elementwise, Ordered, Parametrization, Shifted, pair_of, parametrize, sound_bounds


class FreeParameter(eqx.Module):
    """A free parameter: the leaves it sets, several if tied, each in a measurement or the model (""), and its parametrization."""

    places: tuple[tuple[str, Leaf], ...] = eqx.field(static=True)
    factors: tuple[Factor, ...] = eqx.field(static=True)
    form: Parametrization

    @property
    def path(self) -> str:
        """The path of its first leaf."""
        return self.places[0][1].path

    @property
    def name(self) -> str:
        """The paths of all its leaves: "left.stiffness = right.stiffness"."""
        return equation([leaf.path for _, leaf in self.places], self.factors)

    @property
    def run(self) -> str:
        """The measurement, if it affects the readings of only one; else ""."""
        owners = {owner for owner, _ in self.places}
        return owners.pop() if len(owners) == 1 else ""

    def spread(self, value: Array, run: str) -> dict[Leaf, Array]:
        """The values of its leaves in a run, from the value of the first leaf."""
        return {leaf: times(value, factor) for (owner, leaf), factor in zip(self.places, self.factors, strict=True) if owner == run}


def choose(model: Model, experiments: dict[str, Measurement], patterns: list[str]) -> tuple[FreeParameter, ...]:
    """The free parameters selected by the patterns, with their parametrizations; "a = b" is one parameter."""
    with Problems() as problems:
        roots = {"": model, **experiments}
        leaves = [(run, leaf) for run, tree in roots.items() for leaf in leaves_of(tree, f"{run}." if run else "")]
        owner = {leaf: run for run, leaf in leaves}
        arrays = {run: jax.tree.leaves(tree) for run, tree in roots.items()}
        absent = {f"{run}.{path}": hint for run, experiment in experiments.items() for path, hint in experiment.absent().items()}
        selected = ties(list(owner), patterns, "fit.free", problems, absent)
        size = size_of(model)
        free = []
        for tie in selected:
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
    return tuple(free)


def limits_of(free: tuple[FreeParameter, ...], bounds: dict[str, tuple[Any, Any]], method: Any) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of u from bounds of the values."""
    with Problems() as problems:
        low, high = [np.full(f.form.size, -np.inf) for f in free], [np.full(f.form.size, np.inf) for f in free]
        if bounds and not (isinstance(method, str) and method == "least_squares"):
            problems.add("BAD_BOUNDS", "fit.bounds", 'are supported by method="least_squares" only', value=method)
        bounds = _pairs_by_path(bounds, "fit.bounds", "BAD_BOUNDS", "(lower, upper)", problems)
        place = {leaf: (i, factor) for i, f in enumerate(free) for (_, leaf), factor in zip(f.places, f.factors, strict=True)}
        for pattern, leaves in matching(list(place), bounds, "fit.bounds", problems).items():
            for leaf in leaves:
                i, factor = place[leaf]
                form, where = free[i].form, f"fit.bounds['{leaf.path}']"
                ends = pair_of(bounds[pattern], form.start.shape)
                ends = ends and bounds_of_first(ends, factor)
                if sound_bounds(form, ends, bounds[pattern], where, problems):
                    low[i], high[i] = np.maximum(low[i], form.inverse(ends[0])), np.minimum(high[i], form.inverse(ends[1]))  # pyright: ignore
    return np.concatenate(low), np.concatenate(high)


def _pairs_by_path(given: Any, where: str, code: str, pair: str, problems: Problems) -> dict[str, Any]:
    """The dict; empty if it is none, with a problem added."""
    if not isinstance(given, dict):
        message, hint = f"is {given!r:.60}", f'Write {{"s.stiffness": {pair}}} or a pattern such as "*.stiffness".'
        problems.add(code, where, message, value=given, limit="a dict of pairs by path", hint=hint)
        return {}
    return given


def priors_of(free: tuple[FreeParameter, ...], priors: dict[str, tuple[Any, Any]]) -> dict[str, tuple[Array, Array]]:
    """{path: (mean, standard deviation)} of free parameters, as arrays of their shapes."""
    with Problems() as problems:
        priors = _pairs_by_path(priors, "fit.priors", "BAD_PRIOR", "(mean, standard deviation)", problems)
        forms = {leaf: (f, np.asarray(factor)) for f in free for (_, leaf), factor in zip(f.places, f.factors, strict=True)}
        values = {}
        for pattern, leaves in matching(list(forms), priors, "fit.priors", problems).items():
            for leaf in leaves:
                (parameter, factor), form = forms[leaf], forms[leaf][0].form
                pair = pair_of(priors[pattern], form.start.shape)
                where = f"fit.priors['{leaf.path}']"
                if not isinstance(form, Elementwise | Ordered):
                    problems.add("BAD_PRIOR", where, "cannot have a prior", hint="Give priors for scalars and vectors only.")
                elif pair is None or not np.isfinite(pair).all() or not (pair[1] > 0).all():
                    message, given = f"is {priors[pattern]!r:.60}", priors[pattern]
                    problems.add("BAD_PRIOR", where, message, value=given, limit="(mean, standard deviation > 0), finite")
                else:
                    values[parameter.path] = (jnp.asarray(pair[0] / factor), jnp.asarray(pair[1] / np.abs(factor)))
    return values


def of_instrument(unit: str, start: Array, experiment: Experiment, sensor: str) -> Parametrization:
    """The parametrization of a gain, delay, bias or start of a sensor, x0 + s u, with a scale s that suits its unit: 1 for a gain, which
    may have either sign; the sampling interval for a delay; the rms of the record for a bias or start."""
    measured = experiment.measured[sensor]
    if unit == "":
        scale = jnp.ones(())
    elif unit == "s":
        scale = (experiment.times[-1] - experiment.times[0]) / (len(experiment.times) - 1)
    else:
        scale = jnp.sqrt(jnp.nanmean(measured**2))
    return Shifted(start, jnp.maximum(jnp.max(jnp.abs(start)), jnp.where(scale > 0, scale, 1.0)))
