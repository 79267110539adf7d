"""Names of a package that are imported from its modules at their first use: importing all takes
three times as long as importing those that a simulation needs, and a model has one or two of the
laws of forces."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from typing import Any


def late_names(
    package: str,
    modules: dict[str, tuple[str, ...]],
    whole: dict[str, str] | None = None,
    successors: dict[str, str] | None = None,
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package whose names are imported from its modules
    at their first use; its stub says the same to editors and type checkers.

    Args:
        package: "jaxbody.model.laws"
        modules: {module in it: public names}
        whole: {public name of a module: module}
        successors: {name that was public: what the message says after it}
    """
    places = {name: (module, name) for module, names in modules.items() for name in names}
    places |= {name: (module, "") for name, module in (whole or {}).items()}
    instead = successors or {}

    def __getattr__(name: str) -> Any:
        if name not in places:
            raise AttributeError(
                f"module '{package}' has no attribute '{name}'{instead.get(name, '')}"
            )
        module, attribute = places[name]
        found = importlib.import_module(f"{package}.{module}")
        thing = getattr(found, attribute) if attribute else found
        setattr(sys.modules[package], name, thing)
        return thing

    names = sorted(places)
    return __getattr__, lambda: names, names
