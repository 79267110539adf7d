"""The free parameters of a fit: which leaves paths and patterns mean, one or several tied; their bounds and priors."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxbody.arrays import concrete
from jaxbody.channels import Measurement
from jaxbody.errors import Problem, Problems
from jaxbody.experiments import Experiment
from jaxbody.models import Model
from jaxbody.naming import Leaf, leaves_of, matching
from jaxbody.parametrizations import OF_CHAINS, Parametrization, Positive, Shifted, of_instrument, pair_of, parametrize, sound_bounds
from jaxbody.statics import size_of


class Free(eqx.Module):
    """A free parameter: where it is, once or, tied, several times, each in a run ("" for the model); and how it moves."""

    places: tuple[tuple[str, Leaf], ...] = eqx.field(static=True)
    form: Parametrization

    @property
    def path(self) -> str:
        """Its first place."""
        return self.places[0][1].path

    @property
    def name(self) -> str:
        """All its places: "left.stiffness = right.stiffness"."""
        return " = ".join(leaf.path for _, leaf in self.places)

    @property
    def run(self) -> str:
        """The one measurement whose readings alone it moves, or ""."""
        owners = {owner for owner, _ in self.places}
        return owners.pop() if len(owners) == 1 else ""

    def leaves(self, run: str) -> list[Leaf]:
        return [leaf for owner, leaf in self.places if owner == run]


def choose(model: Model, experiments: dict[str, Measurement], patterns: list[str]) -> tuple[Free, ...]:
    """The free parameters that the patterns mean, each with its parametrization; what "a = b" means is one parameter."""
    problems = Problems()
    roots = {"": model, **experiments}
    leaves = [(run, leaf) for run, tree in roots.items() for leaf in leaves_of(tree, f"{run}." if run else "")]
    owner = {leaf: run for run, leaf in leaves}
    arrays = {run: jax.tree.leaves(tree) for run, tree in roots.items()}
    sides = {pattern: [side.strip() for side in str(pattern).split("=")] for pattern in patterns}
    for pattern in [pattern for pattern, group in sides.items() if len(group) > 1 and not all(group)]:
        hint = 'Say "left.stiffness = right.stiffness".'
        problems.add(
            "UNKNOWN_PATH", "fit.free", f"'{pattern}' ties nothing on one side", value=pattern, limit="a path on both sides", hint=hint
        )
    absent = {f"{run}.{path}": hint for run, experiment in experiments.items() for path, hint in experiment.absent().items()}
    named = dict.fromkeys(side for group in sides.values() for side in group if side or len(group) == 1)
    found = {"": [], **matching(list(owner), named, "fit.free", problems, absent)}
    chosen: list[Leaf] = []
    groups: list[list[Leaf]] = []
    for pattern, group in sides.items():
        meant = list(dict.fromkeys(leaf for side in group for leaf in found[side]))
        for leaf in meant:
            if leaf in chosen:
                problems.add("LISTED_TWICE", "fit.free", f"names {leaf.path} twice, by '{pattern}' too", value=pattern)
        chosen += meant
        groups += [meant] if len(group) > 1 and meant else [[leaf] for leaf in meant]
    if not chosen and not problems.found:
        problems.add("NOTHING_FREE", "fit.free", "is empty", limit="at least one path")
    size = size_of(model)
    free = []
    for group in groups:
        starts = [leaf.read(arrays[owner[leaf]]) for leaf in group]
        known = [concrete(start) for start in starts]
        for leaf, start in zip(group[1:], known[1:], strict=True):
            if start is not None and known[0] is not None and (np.shape(start) != np.shape(known[0]) or (start != known[0]).any()):
                told = f"starts at {start}, but is to equal {group[0].path}, which starts at {known[0]}"
                problems.add("TIED_APART", leaf.path, told, value=start, limit=str(known[0]), hint="Set both alike with jb.replace.")
        run, leaf = owner[group[0]], group[0]
        experiment, name = experiments.get(run), leaf.path.removeprefix(f"{run}.").removesuffix(f".{leaf.field}")
        if isinstance(experiment, Experiment) and name in experiment.sensors and leaf.field in OF_CHAINS:
            form = of_instrument(leaf.field, starts[0], experiment, name)
        else:
            form = parametrize(leaf.path, starts[0], model, size)
        if isinstance(form, Problem):
            problems.found.append(form)
        else:
            free.append(Free(tuple((owner[leaf], leaf) for leaf in group), form))
    problems.raise_if_any()
    return tuple(free)


def limits_of(free: tuple[Free, ...], bounds: dict[str, tuple[Any, Any]], method: Any) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of u, from bounds of values."""
    problems = Problems()
    low, high = [np.full(f.form.size, -np.inf) for f in free], [np.full(f.form.size, np.inf) for f in free]
    if bounds and not (isinstance(method, str) and method == "least_squares"):
        problems.add("BAD_BOUNDS", "fit.bounds", 'are kept by method="least_squares" only', value=method)
    if not _is_dict(bounds, "fit.bounds", "BAD_BOUNDS", "(lower, upper)", problems):
        bounds = {}
    place = {leaf: i for i, f in enumerate(free) for _, leaf in f.places}
    for pattern, leaves in matching(list(place), bounds, "fit.bounds", problems).items():
        for leaf in leaves:
            i = place[leaf]
            form, where = free[i].form, f"fit.bounds['{leaf.path}']"
            ends = pair_of(bounds[pattern], form.start.shape)
            if sound_bounds(form, ends, bounds[pattern], where, problems):
                low[i], high[i] = (form.inverse(end) for end in ends)  # pyright: ignore
    problems.raise_if_any()
    return np.concatenate(low), np.concatenate(high)


def _is_dict(given: Any, where: str, code: str, pair: str, problems: Problems) -> bool:
    if not isinstance(given, dict):
        told, hint = f"is {given!r:.60}", f'Write {{"s.stiffness": {pair}}}; a pattern such as "*.stiffness" will do too.'
        problems.add(code, where, told, value=given, limit="a dict of pairs by path", hint=hint)
    return isinstance(given, dict)


def priors_of(free: tuple[Free, ...], priors: dict[str, tuple[Any, Any]]) -> dict[str, tuple[Array, Array]]:
    """{path: (mean, standard deviation)} of free parameters, as arrays of their shapes."""
    problems = Problems()
    if not _is_dict(priors, "fit.priors", "BAD_PRIOR", "(mean, standard deviation)", problems):
        priors = {}
    forms = {leaf: f for f in free for _, leaf in f.places}
    found = {}
    for pattern, leaves in matching(list(forms), priors, "fit.priors", problems).items():
        for leaf in leaves:
            form, pair = forms[leaf].form, pair_of(priors[pattern], forms[leaf].form.start.shape)
            where = f"fit.priors['{leaf.path}']"
            if not isinstance(form, Positive | Shifted):
                problems.add("BAD_PRIOR", where, "has no prior of its own", hint="Priors are for scalars and vectors.")
            elif pair is None or not np.isfinite(pair).all() or not (pair[1] > 0).all():
                told = f"is {priors[pattern]!r:.60}"
                problems.add("BAD_PRIOR", where, told, value=priors[pattern], limit="(mean, standard deviation > 0), finite")
            else:
                found[forms[leaf].path] = (jnp.asarray(pair[0]), jnp.asarray(pair[1]))
    problems.raise_if_any()
    return found
