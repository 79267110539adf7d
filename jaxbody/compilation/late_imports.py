"""Names of a package that are imported from its modules at their first use: a model has one or two of the laws of forces, whose modules
take a tenth of what an equilibrium imports."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from typing import Any


def late_names(package: str, modules: dict[str, tuple[str, ...]]) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package whose names are imported from its modules at their first use; its stub says the
    same to editors and type checkers.

    Args:
        package: "jaxbody.laws"
        modules: {module: public names in it}
    """
    places = {name: module for module, names in modules.items() for name in names}

    def __getattr__(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        thing = getattr(importlib.import_module(f"{package}.{places[name]}"), name)
        setattr(sys.modules[package], name, thing)
        return thing

    names = sorted(places)
    return __getattr__, lambda: names, names
