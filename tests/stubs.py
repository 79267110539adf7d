"""The stubs of `jaxbody` and of its packages of names, for editors and type checkers, from the
lists in their `__init__.py`: `python tests/stubs.py` writes them."""

from pathlib import Path

import jaxbody as jb

PACKAGES = [
    jb,
    *(getattr(jb, name) for name in jb._MODULES if hasattr(getattr(jb, name), "_NAMES")),
]


def stub(package) -> str:
    """Return the text of the stub of a package."""
    home = package.__name__
    lines = [
        f"from {home}.{module} import {name} as {name}"
        for module, names in package._NAMES.items()
        for name in names
    ]
    for name, module in getattr(package, "_MODULES", {}).items():
        *above, last = f"{home}.{module}".split(".")
        lines.append(f"from {'.'.join(above)} import {last} as {name}")
    text = f'"""What `{home}` offers, written by `python tests/stubs.py`."""\n\n'
    return text + "\n".join(sorted(lines)) + ("\n\n__version__: str\n" if package is jb else "\n")


def place(package) -> Path:
    return Path(package.__file__).with_suffix(".pyi")


if __name__ == "__main__":
    for each in PACKAGES:
        place(each).write_text(stub(each))
