"""Checks of users' elements and laws when a model is built: the types of their fields and of the results of their functions."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np

from jaxbody.core.arguments import check_returned, is_own
from jaxbody.core.arrays import float_array
from jaxbody.core.errors import JaxbodyError, Problems
from jaxbody.elements.elements import Element
from jaxbody.laws.laws import Law, parts


def check_leaves(problems: Problems, elements: dict[str, Element]) -> None:
    """Check that elements hold only numbers, functions and static fields."""
    for name, element in elements.items():
        for keys, leaf in jax.tree_util.tree_leaves_with_path(element):
            if not isinstance(leaf, np.ndarray | jax.Array):
                where = f"elements[{name!r}]{jax.tree_util.keystr(keys)}"
                try:
                    float_array(leaf, where)
                except JaxbodyError as error:
                    hint = "Declare what is not a number as a static field: mode: str = equinox.field(static=True)."
                    problems.collected += [replace(problem, hint=hint) for problem in error.problems]


def check_laws(problems: Problems, elements: dict[str, Element]) -> None:
    """Check that JAX can trace users' laws and that they return one number; each structure is traced once."""
    checked = set()
    for name, element in elements.items():
        for field, law in vars(element).items():
            if isinstance(law, Law) and any(map(is_own, parts(law))) and (structure := jax.tree.structure(law)) not in checked:
                checked.add(structure)
                check_returned(lambda law, x: law.force(x), law, (), f"elements[{name!r}].{field}", problems)
