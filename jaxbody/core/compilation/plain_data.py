"""Values as plain text and arrays, and back: names, numbers and tuples of them, never code.

Classes and functions are written by name. Only those of jaxbody and of the libraries that it uses
are known, because their source belongs to an installed version. Other values have no text: the
error `Unnamed` describes them."""

import dataclasses
import enum
import importlib
import json
import sys
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxbody.core.jax_internals import Tracer

LIBRARIES = ("jaxbody", "diffrax", "equinox", "jax", "lineax", "optimistix")


class Unnamed(Exception):
    """The error for a value that cannot be written as text, with a description of the value."""


def text_of(value: Any, arrays: list[Any] | None = None, allow: Sequence[str] = ()) -> str:
    """Return the text of a value; equal values have equal texts.

    Args:
        value: the value.
        arrays: a list to which the arrays of the value are added; the text states their places in
            it. None: a value with arrays is an error.
        allow: names of other modules whose classes and functions may be written.

    Error: Unnamed."""
    return json.dumps(_Writer(arrays, allow).encoded(value), separators=(",", ":"))


def value_of(text: str, arrays: Sequence[Any] = (), allow: Sequence[str] = ()) -> Any:
    """Return the value that `text_of` has written as this text, with these arrays. Error:
    ValueError if the text does not describe a value."""
    try:
        return _Reader(arrays, allow).decoded(json.loads(text))
    except (AttributeError, ImportError, IndexError, KeyError, RuntimeError, TypeError) as error:
        # RecursionError is a RuntimeError
        raise ValueError(f"not the text of a value: {error!r}") from None


@dataclasses.dataclass
class _Writer:
    """Writes values as lists of plain values, the first of which names the kind of the value."""

    arrays: list[Any] | None
    allow: Sequence[str]

    def encoded(self, x: Any) -> Any:
        kind = type(x)
        if x is None or kind in (bool, int, str):
            return x
        if kind in WRITERS:
            return [kind.__name__, *WRITERS[kind](self, x)]
        if isinstance(x, enum.Enum):
            return ["enum", self.name(kind), x.name]
        if isinstance(x, np.dtype):
            return ["dtype", x.str if x.isbuiltin else _refused(x)]
        if isinstance(x, np.generic):
            return ["number", x.dtype.str, x.tobytes().hex()]
        if isinstance(x, np.ndarray | jax.Array):
            return self.array(x)
        if isinstance(x, type) or (
            callable(x) and hasattr(x, "__qualname__") and not hasattr(x, "__self__")
        ):
            return ["name", self.name(x)]
        return self.object(x)

    def all(self, items: Any) -> list[Any]:
        return [self.encoded(item) for item in items]

    def array(self, x: Any) -> Any:
        """Return the place of an array in the list of arrays, to which it is added."""
        if self.arrays is None or isinstance(x, Tracer) or x.dtype.kind not in "biufc":
            return _refused(x)
        place = next((i for i, other in enumerate(self.arrays) if other is x), len(self.arrays))
        self.arrays += [x] if place == len(self.arrays) else []
        return ["array", "numpy" if isinstance(x, np.ndarray) else "jax", place]

    def object(self, x: Any) -> Any:
        kind = type(x)
        names = _fields(kind)
        if names is not None:
            fields = {name: self.encoded(getattr(x, name)) for name in names if hasattr(x, name)}
            # of an equinox module; versions before 0.13.3 keep them in the order of a set
            if "wrapper_fields" in fields:
                fields["wrapper_fields"][1:] = sorted(fields["wrapper_fields"][1:], key=json.dumps)
            return ["object", self.name(kind), *map(list, fields.items())]
        # an object that stands for a missing value is written by the name of the variable that
        # holds it
        home = "equinox._module._module" if kind is object else kind.__module__
        names = (
            [name for name, one in vars(sys.modules[home]).items() if one is x]
            if home.split(".")[0] in LIBRARIES
            else []
        )
        return ["name", f"{home}:{names[0]}"] if names else _refused(x)

    def name(self, thing: Any) -> str:
        """Return "module:name" of a class or function that can be imported by this name. Error:
        Unnamed."""
        module, name = getattr(thing, "__module__", None) or "", getattr(thing, "__qualname__", "")
        if module == "builtins" and isinstance(thing, type):
            return f"builtins:{name}"
        if (module.split(".")[0] not in LIBRARIES and module not in self.allow) or not _same(
            _found(module, name), thing
        ):
            _refused(thing)
        return f"{module}:{name}"


def _fields(kind: type) -> tuple[str, ...] | None:
    """Return the names of the fields of a class; None if unknown."""
    if issubclass(kind, tuple):
        return getattr(kind, "_fields", None)
    if dataclasses.is_dataclass(kind):
        return tuple(f.name for f in dataclasses.fields(kind))
    return (
        tuple(kind.__annotations__)
        if kind.__module__.startswith("jaxbody.") and "__annotations__" in vars(kind)
        else None
    )


def _same(found: Any, thing: Any) -> bool:
    return found is thing or getattr(found, "__wrapped__", found) is getattr(
        thing, "__wrapped__", thing
    )


def _found(module: str, name: str) -> Any:
    thing: Any = sys.modules.get(module)
    for part in name.split("."):
        thing = getattr(thing, part, None)
    return thing


def _refused(x: Any) -> Any:
    raise Unnamed(
        f"{getattr(x, '__module__', type(x).__module__)}."
        f"{getattr(x, '__qualname__', type(x).__qualname__)}"
    )


@dataclasses.dataclass
class _Reader:
    """Reads the values from the lists that `_Writer` makes."""

    arrays: Sequence[Any]
    allow: Sequence[str]

    def decoded(self, x: Any) -> Any:
        if not isinstance(x, list):
            if x is None or isinstance(x, bool | int | str):
                return x
            raise ValueError(f"unknown text {x!r:.60}")
        return READERS[x[0]](self, *x[1:])

    def all(self, *items: Any) -> Any:
        return map(self.decoded, items)

    def named(self, text: str) -> Any:
        module, _, name = text.partition(":")
        if module == "builtins":
            thing: Any = {kind.__name__: kind for kind in BUILTINS}[name]
            return thing
        if module.split(".")[0] not in LIBRARIES and module not in self.allow:
            raise ValueError(f"{module} is not known")
        importlib.import_module(module)
        thing = _found(module, name)
        if thing is None:
            raise ValueError(f"there is no {text}")
        return thing

    def object(self, name: str, *fields: list[Any]) -> Any:
        kind, values = self.named(name), {field: self.decoded(y) for field, y in fields}
        if not isinstance(kind, type):
            raise ValueError(f"{name} is no class")
        known = _fields(kind)
        if known is None or set(values) - set(known):
            raise ValueError(f"{name} has no {sorted(set(values) - set(known or ()))}")
        if issubclass(kind, tuple):
            return kind(**values)
        made = object.__new__(kind)
        for field, value in values.items():
            object.__setattr__(made, field, value)
        return made

    def array(self, kind: str, place: int) -> Any:
        x = self.arrays[place]
        return x if kind == "numpy" else jax.device_put(x)


WRITERS: dict[type, Callable[[_Writer, Any], Sequence[Any]]] = {
    float: lambda write, x: [x.hex()],
    complex: lambda write, x: [x.real.hex(), x.imag.hex()],
    tuple: _Writer.all,
    list: _Writer.all,
    set: lambda write, x: sorted(write.all(x), key=json.dumps),
    frozenset: lambda write, x: sorted(write.all(x), key=json.dumps),
    dict: lambda write, x: [write.all(item) for item in x.items()],
}
BUILTINS = (bool, int, float, complex, str, tuple, list, dict, set, frozenset, type(None))
READERS: dict[str, Callable[..., Any]] = {
    "float": lambda read, x: float.fromhex(x),
    "complex": lambda read, re, im: complex(float.fromhex(re), float.fromhex(im)),
    "tuple": lambda read, *items: tuple(read.all(*items)),
    "list": lambda read, *items: list(read.all(*items)),
    "set": lambda read, *items: set(read.all(*items)),
    "frozenset": lambda read, *items: frozenset(read.all(*items)),
    "dict": lambda read, *items: {read.decoded(key): read.decoded(y) for key, y in items},
    "enum": lambda read, kind, name: read.named(kind)[name],
    "dtype": lambda read, name: np.dtype(name),
    "number": lambda read, dtype, data: np.frombuffer(bytes.fromhex(data), dtype)[0],
    "name": _Reader.named,
    "object": _Reader.object,
    "array": _Reader.array,
}
