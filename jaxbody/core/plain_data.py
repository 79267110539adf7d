"""Static values and structures of trees as plain text and back: names, numbers and tuples of them, never code.

Classes and functions are written by name; only those of jaxbody and of the libraries that it is built on are known, as their source is
that of an installed version. A value of another kind has no text: `Unnamed` says which.
"""

from __future__ import annotations

import dataclasses
import enum
import importlib
import json
import sys
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.core import ShapedArray
from jax.tree_util import PyTreeDef

from jaxbody.core.jax_internals import tree_of_node

LIBRARIES = ("jaxbody", "diffrax", "equinox", "jax", "lineax", "optimistix")


class Unnamed(Exception):
    """A value that has no text, with a description of it."""


def text_of(value: Any) -> str:
    """The text of a value; equal values have equal texts. Error: Unnamed."""
    return json.dumps(_encoded(value), separators=(",", ":"))


def value_of(text: str) -> Any:
    """The value of a text. Error: ValueError where the text is not that of a value."""
    try:
        return _decoded(json.loads(text))
    except (AttributeError, ImportError, IndexError, KeyError, RuntimeError, TypeError) as error:  # RecursionError is a RuntimeError
        raise ValueError(f"not the text of a value: {error!r}") from None


def _encoded(x: Any) -> Any:
    kind = type(x)
    if x is None or kind in (bool, int, str):
        return x
    if kind is float:
        return ["float", x.hex()]
    if kind is complex:
        return ["complex", x.real.hex(), x.imag.hex()]
    if kind in (tuple, list, set, frozenset):
        items = [_encoded(y) for y in x]
        return [kind.__name__, *(sorted(items, key=json.dumps) if kind in (set, frozenset) else items)]
    if kind is dict:
        return ["dict", *([_encoded(key), _encoded(y)] for key, y in x.items())]
    if isinstance(x, enum.Enum):
        return ["enum", _name(kind), x.name]
    if isinstance(x, np.dtype):
        return ["dtype", x.str if x.isbuiltin else _refused(x)]
    if isinstance(x, np.generic):
        return ["number", x.dtype.str, x.tobytes().hex()]
    if isinstance(x, ShapedArray):
        return ["type", list(x.shape), x.dtype.name, x.weak_type]
    if isinstance(x, PyTreeDef):
        node = x.node_data()
        if node is None:
            return ["leaf"] if x.num_leaves else ["empty"]
        return ["tree", _encoded(node[0]), _encoded(node[1]), *(_encoded(child) for child in x.children())]
    if isinstance(x, type) or (callable(x) and hasattr(x, "__qualname__") and not hasattr(x, "__self__")):
        return ["name", _name(x)]
    fields = getattr(kind, "_fields", None)
    if isinstance(x, tuple) and fields is not None:
        return ["object", _name(kind), *([name, _encoded(y)] for name, y in zip(fields, x, strict=True))]
    if dataclasses.is_dataclass(x):
        return ["object", _name(kind), *([f.name, _encoded(getattr(x, f.name))] for f in dataclasses.fields(x) if hasattr(x, f.name))]
    home = "equinox._module._module" if kind is object else kind.__module__  # of an object that stands for what is missing
    names = [name for name, one in vars(sys.modules[home]).items() if one is x] if home.split(".")[0] in LIBRARIES else []
    return ["name", f"{home}:{names[0]}"] if names else _refused(x)


def _name(thing: Any) -> str:
    """ "module:name" of a class or function that can be found by it."""
    module, name = getattr(thing, "__module__", None) or "", getattr(thing, "__qualname__", "")
    if module == "builtins" and isinstance(thing, type):
        return f"builtins:{name}"
    if module.split(".")[0] not in LIBRARIES or not _same(_found(module, name), thing):
        _refused(thing)
    return f"{module}:{name}"


def _same(found: Any, thing: Any) -> bool:
    return found is thing or getattr(found, "__wrapped__", found) is getattr(thing, "__wrapped__", thing)


def _found(module: str, name: str) -> Any:
    thing: Any = sys.modules.get(module)
    for part in name.split("."):
        thing = getattr(thing, part, None)
    return thing


def _refused(x: Any) -> Any:
    raise Unnamed(f"{getattr(x, '__module__', type(x).__module__)}.{getattr(x, '__qualname__', type(x).__qualname__)}")


def _decoded(x: Any) -> Any:
    if not isinstance(x, list):
        if x is None or isinstance(x, bool | int | str):
            return x
        raise ValueError(f"unknown text {x!r:.60}")
    return READERS[x[0]](*x[1:])


def _named(text: str) -> Any:
    module, _, name = text.partition(":")
    if module == "builtins":
        thing: Any = {kind.__name__: kind for kind in (bool, int, float, complex, str, tuple, list, dict, set, frozenset, type(None))}[name]
        return thing
    if module.split(".")[0] not in LIBRARIES:
        raise ValueError(f"{module} is not known")
    importlib.import_module(module)
    thing = _found(module, name)
    if thing is None:
        raise ValueError(f"there is no {text}")
    return thing


def _object(name: str, *fields: list[Any]) -> Any:
    kind, values = _named(name), {field: _decoded(y) for field, y in fields}
    if not isinstance(kind, type):
        raise ValueError(f"{name} is no class")
    if issubclass(kind, tuple):
        return kind(**values)
    made = object.__new__(kind)
    for field, value in values.items():
        object.__setattr__(made, field, value)
    return made


def _tree(kind: Any, data: Any, *children: Any) -> Any:
    return tree_of_node(_decoded(kind), _decoded(data), [_decoded(child) for child in children])


READERS: dict[str, Callable[..., Any]] = {
    "float": float.fromhex,
    "complex": lambda re, im: complex(float.fromhex(re), float.fromhex(im)),
    "tuple": lambda *items: tuple(map(_decoded, items)),
    "list": lambda *items: list(map(_decoded, items)),
    "set": lambda *items: set(map(_decoded, items)),
    "frozenset": lambda *items: frozenset(map(_decoded, items)),
    "dict": lambda *items: {_decoded(key): _decoded(y) for key, y in items},
    "enum": lambda kind, name: _named(kind)[name],
    "dtype": np.dtype,
    "number": lambda dtype, data: np.frombuffer(bytes.fromhex(data), dtype)[0],
    "type": lambda shape, dtype, weak: ShapedArray(tuple(shape), np.dtype(dtype), weak_type=weak),
    "leaf": lambda: jax.tree.structure(0),
    "empty": lambda: jax.tree.structure(None),
    "tree": _tree,
    "name": _named,
    "object": _object,
}
