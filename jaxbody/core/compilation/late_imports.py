"""Names of a package that are imported from its modules at their first use: importing all of them
takes three times as long as importing those that a simulation needs, and a model uses only one or
two of the force laws."""

import importlib.util
import sys
from collections.abc import Callable
from typing import Any


def late_names(
    package: str,
    names: dict[str, tuple[str, ...]],
    modules: dict[str, str] | None = None,
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package whose names are imported at their
    first use; its stub lists the same names for editors and type checkers.

    Args:
        package: name of the package, such as "jaxbody.model.laws"
        names: {module in the package: public names}
        modules: {public name of a module: module}
    """
    places = {name: (module, name) for module, those in names.items() for name in those}
    modules = modules or {}

    def __getattr__(name: str) -> Any:
        if name in modules:
            thing = importlib.import_module(f"{package}.{modules[name]}")
        elif name in places:
            module, attribute = places[name]
            thing = getattr(importlib.import_module(f"{package}.{module}"), attribute)
        else:
            raise AttributeError(f"module '{package}' has no attribute '{name}'{successor(name)}")
        setattr(sys.modules[package], name, thing)
        return thing

    def successor(name: str) -> str:
        """Return the module that has a name, for the message; "" if there is none. Python asks for
        submodules, and inspection for private names, in the same way."""
        if name[0] == "_" or importlib.util.find_spec(f"{package}.{name}"):
            return ""
        homes = [each for each in modules if name in __getattr__(each).__all__]
        return f"; use {package}.{homes[0]}.{name}" if homes else ""

    public = sorted([*places, *modules])
    return __getattr__, lambda: public, public
