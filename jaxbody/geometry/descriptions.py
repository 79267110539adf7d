"""Printed form of laws, elements, bodies and other objects that consist of numbers: the class, and
each field with its numbers and unit."""

from dataclasses import fields
from typing import Any

import jax
import numpy as np

from jaxbody.core import tables
from jaxbody.core.jax_internals import Tracer
from jaxbody.geometry.fields import kind_of, units_of, words_for

MOST_NUMBERS = 7  # most numbers printed of a row; of a longer row the range is printed
# longest text printed for another object, such as a network [characters]; in place of a longer one
# the count of its numbers is printed
LONGEST = 80
MATRICES = ("definite", "symmetric", "inertia")


class Described:
    """An object that prints with the numbers and units of its fields: Stop(gap=0.06 m,
    stiffness=200000 N/m, engagement=0.01 m).

    A unit is left out where it depends on an unknown owner: a linear law may be that of a spring or
    of a damper."""

    def __init_subclass__(cls, init: bool = True, **options: Any) -> None:
        """`init=False` tells type checkers that a class has the constructor of its base class."""
        super().__init_subclass__(**options)

    def __repr__(self) -> str:
        return self._described({})

    def _described(self, words: dict[str, str]) -> str:
        """Return the text. `words`: {word: unit} for formulas of units such as "force/argument",
        from the object that contains this one."""
        # `self` is a dataclass derived from this class
        of_class = fields(self)  # pyright: ignore[reportArgumentType]
        values = {each.name: (getattr(self, each.name, None), each.default) for each in of_class}
        shown = {
            name: text_of(self, name, words)
            for name, (value, default) in values.items()
            if value is not None and value is not default
        }
        alone = len(values) == 1
        return (
            f"{type(self).__name__}("
            f"{', '.join(text if alone else f'{name}={text}' for name, text in shown.items())})"
        )


def text_of(owner: Any, name: str, words: dict[str, str] | None = None) -> str:
    """Return a field of an object as text: numbers with their unit, or the description of a law or
    signal.

    >>> text_of(
    ...     jb.SpringDamper(
    ...         ("mass", [0, 0, 0]), ("world", [0, 0, 1]), spring=20e3, free_length=0.9
    ...     ),
    ...     "spring",
    ... )
    'Linear(20000 N/m)'
    """
    value, words = getattr(owner, name), words or {}
    if isinstance(value, Described):
        return value._described(words_for(owner, name, words))
    if isinstance(value, Tracer):
        return "traced"
    if not isinstance(getattr(value, "shape", None), tuple):
        shown = getattr(value, "__name__", repr(value)) if callable(value) else repr(value)
        if len(shown) <= LONGEST:
            return shown
        count = sum(np.size(x) for x in jax.tree.leaves(value) if hasattr(x, "shape"))
        return f"{type(value).__name__}({tables.counted(count, 'number')})"
    kind, array = kind_of(owner, name, words), np.asarray(value)
    units = units_of(kind, array.shape)
    if (
        kind.domain in MATRICES
        and array.ndim == 2
        and not np.any(array - np.diag(np.diagonal(array)))
    ):
        return f"diag{_row(np.diagonal(array), np.reshape(units, array.shape).diagonal().tolist())}"
    if array.ndim > 1:
        return tables.number(array)
    return _row(array, units) if array.ndim else f"{tables.number(array)} {units[0]}".rstrip()


def _row(numbers: np.ndarray, units: list[str]) -> str:
    """Return a row as text: [1 2 3] m, [1 N/m, 2 N/m2], or [200 numbers from 0 to 1] m."""
    if len(set(units)) > 1:
        values = [f"{tables.number(x)} {unit}" for x, unit in zip(numbers, units, strict=True)]
        return f"[{', '.join(values)}]"
    ends = (
        f"{numbers.size} numbers from {tables.number(numbers.min(initial=np.inf))} to "
        f"{tables.number(numbers.max(initial=-np.inf))}"
    )
    return (
        f"[{tables.number(numbers) if numbers.size <= MOST_NUMBERS else ends}] "
        f"{units[0] if units else ''}"
    ).rstrip()
