"""Checks of users' elements and laws when a model is built: the types of their fields and of the
results of their functions."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np

from jaxbody.core.arguments import check_returned, is_own
from jaxbody.core.arrays import concrete, float_array
from jaxbody.core.errors import Problem, Problems, unknown
from jaxbody.model.laws.law_states import memories
from jaxbody.model.laws.laws import Law, parts


def check_leaves(problems: Problems, where: str, thing: Any) -> None:
    """Check that an element, or a function written by the user, holds only numbers, functions and
    static fields."""
    for keys, leaf in jax.tree_util.tree_leaves_with_path(thing):
        if not isinstance(leaf, np.ndarray | jax.Array):
            problems.gather(
                partial(float_array, leaf, where + jax.tree_util.keystr(keys)),
                lambda problem: replace(
                    problem,
                    hint="Declare what is not a number as a static field: mode: str = "
                    "equinox.field(static=True).",
                ),
            )


def unknown_frame(name: str, where: str, known: tuple[str, ...], what: str) -> Problem:
    """Return the problem of an unknown name of a frame; `what` is "body", "parent" or another role
    of the frame."""
    problem = unknown(name, where, known)
    return replace(
        problem,
        code="UNKNOWN_BODY",
        message=f"{what} {problem.message}",
        limit="a body, a support or world" if "world" in known else "a body",
    )


def check_laws(problems: Problems, elements: dict[str, Any]) -> None:
    """Check that JAX can trace the laws written by the user and that they return one number, or,
    with memory, one rate for each state; each structure is traced once."""
    checked = set()
    for name, element in elements.items():
        for field, law in vars(element).items():
            if (
                isinstance(law, Law)
                and any(map(is_own, parts(law)))
                and (structure := jax.tree.structure(law)) not in checked
            ):
                checked.add(structure)
                where = f"elements[{name!r}].{field}"
                for part in memories(law):
                    _check_memory(part, where, problems)
                if not memories(law):
                    check_returned(lambda law, x: law.force(x), law, (), where, problems)


def _check_memory(law: Any, where: str, problems: Problems) -> None:
    """Check the functions of a law with memory written by the user, and that its hysteretic states
    are constant at rest. Error: RELAXES."""
    zero = np.zeros(len(law.states))
    functions = {
        "restoring_force": (lambda law, x: law.restoring_force(x, x, zero + x), ()),
        "rate": (lambda law, x: law.rate(x, x, zero + x), zero.shape),
        "energy": (lambda law, x: law.energy(x, law.configuration(zero + x)), ()),
    }
    if law.inertial:
        functions["kinetic_energy"] = (lambda law, x: law.kinetic(zero + x), ())
    for name, (function, shape) in functions.items():
        check_returned(function, law, shape, f"{where}.{name}", problems)
    if law.has_rows or problems.collected or any(concrete(x) is None for x in jax.tree.leaves(law)):
        return
    rates = np.stack(
        [
            np.asarray(law.rate(np.float64(e), np.zeros(()), np.asarray(zero + z)))
            for e, z in ((0.0, 1e-3), (1e-3, -1.0))
        ]
    )
    if not (rates == 0).all():
        problems.add(
            "RELAXES",
            where,
            f"has the rate {rates[np.nonzero(rates)][0]:.3g} at rest",
            value=rates,
            limit="0 at e' = 0",
            hint="Derive it from jb.laws.Viscoelastic, whose coordinates relax.",
        )
