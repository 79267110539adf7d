"""Names of a package that are imported from its modules at their first use.

To import all modules takes three times as long as to import those that a simulation needs, and a
model has one or two of the laws of forces."""

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
    """Return `__getattr__`, `__dir__` and `__all__` of a package whose names are imported at their
    first use; its stub lists the same names for editors and type checkers.

    Args:
        package: name of the package, such as "jaxbody.model.laws"
        modules: {module in it: public names}
        whole: {public name of a module: module}; None: no modules
        successors: {name that was public: what its error message adds}; None: no such names
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
        imported = importlib.import_module(f"{package}.{module}")
        thing = getattr(imported, attribute) if attribute else imported
        setattr(sys.modules[package], name, thing)
        return thing

    names = sorted(places)
    return __getattr__, lambda: names, names
