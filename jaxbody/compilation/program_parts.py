"""A traced program in parts: operations that stand alone, and all between two of them as one part."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

from jaxbody.core.jax_internals import Literal


class Part(NamedTuple):
    """Operations of a program, which one it is if it stands alone, and variables: what the part needs, and what later ones need of it."""

    alone: Any
    equations: list[Any]
    needed: list[Any]
    kept: list[Any]


def parts_of(jaxpr: Any, stands_alone: Callable[[Any], bool]) -> list[Part]:
    """The parts of a program, in their order."""
    groups = [(key is not None, list(own)) for key, own in itertools.groupby(jaxpr.eqns, lambda e: id(e) if stands_alone(e) else None)]
    parts, later = [], {v for v in jaxpr.outvars if not isinstance(v, Literal)}
    for alone, equations in reversed(groups):
        made = dict.fromkeys(v for equation in equations for v in equation.outvars)
        needed = list(dict.fromkeys(v for e in equations for v in e.invars if not isinstance(v, Literal) and v not in made))
        parts.append(Part(equations[0] if alone else None, equations, needed, [v for v in made if v in later]))
        later.update(needed)
    return parts[::-1]


def read(values: dict[Any, Any], variables: list[Any]) -> list[Any]:
    """The values of variables, and constants as they are."""
    return [v.val if isinstance(v, Literal) else values[v] for v in variables]
