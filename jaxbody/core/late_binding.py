"""Functions that the lower packages call and upper ones define, by the names under which
`jaxbody/__init__` hands them down: what draws a result, what assembles closed loops. They are
imported at their first use."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_PLACES: dict[str, tuple[str, str]] = {}


def hand_down(**places: tuple[str, str]) -> None:
    """Say where functions are: name=(module, function)."""
    _PLACES.update(places)


def handed_down(name: str) -> Any:
    """The function of this name."""
    module, function = _PLACES[name]
    return getattr(import_module(module), function)
