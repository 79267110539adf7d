"""Functions that lower packages call and upper ones define, such as those that draw a result or
assemble closed loops. `jaxbody/__init__` registers them by name; they are imported at their first
use."""

from importlib import import_module
from typing import Any

_PLACES: dict[str, tuple[str, str]] = {}


def hand_down(**places: tuple[str, str]) -> None:
    """Register functions: name=(module, function)."""
    _PLACES.update(places)


def handed_down(name: str) -> Any:
    """Return the function of this name."""
    module, function = _PLACES[name]
    return getattr(import_module(module), function)
