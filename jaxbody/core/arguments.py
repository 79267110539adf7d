"""Arguments that are no arrays: things by name, names, whole and positive numbers, objects of other libraries, functions of the user."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import checked, concrete
from jaxbody.core.errors import Problems, warn
from jaxbody.core.jax_internals import Tracer

USE_JNP = "Write it with jax.numpy: jnp.sin for np.sin and math.sin, jnp.where for if."


def plain(name: Any) -> Any:
    """A name, or a tuple of them, as Python's text: NumPy's would be an array to JAX."""
    if isinstance(name, tuple):
        return tuple(map(plain, name))
    return str(name) if isinstance(name, str) else name


def kind_of(value: Any) -> str:
    """ "a list", "an Equilibrium", "the class Tsit5"."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    name = type(value).__name__
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"


def checked_dict(things: Any, where: str, kind: str, problems: Problems) -> dict[str, Any]:
    """Things by name, their names as Python's text; none where they are no dict, and `problems` says so."""
    if things is None:
        return {}
    if not isinstance(things, Mapping):
        hint = f'Write {where.rpartition(".")[2]}={{"...": {kind.partition(": ")[2]}}}.'
        problems.add("WRONG_KIND", where, f"is {kind_of(things)}", value=things, limit=f"a dict {{{kind}}}", hint=hint)
        return {}
    return {plain(name): thing for name, thing in things.items()}


def whole_number(value: Any, where: str, problems: Problems, least: int = 1, code: str = "BAD_NUMBER") -> Any:
    """A whole number, `least` or more; 1e5 is one. What jit traces stays as it is."""
    if isinstance(value, Tracer):
        return value
    number = int(value) if isinstance(value, float) and value.is_integer() else value
    try:
        good = operator.index(number) >= least and not isinstance(value, bool)
    except TypeError:
        good = False
    if not good:
        problems.add(code, where, f"is {value!r:.60}", value=value, limit=f"a whole number >= {least}")
        return least
    return number


def positive_number(value: Any, where: str, problems: Problems, code: str = "BAD_NUMBER") -> Any:
    """One finite number above zero; None where it is not, and `problems` says so."""
    number = checked(value, ((),), where, problems)
    known = None if number is None else concrete(number)
    if known is not None and not known > 0:
        problems.add(code, where, f"is {value}", value=value, limit="> 0")
        return None
    return number


def check_key(key: Any, where: str, problems: Problems, needed: str = "") -> None:
    """A key of JAX, of the new kind or the old; a number is none. None is good where nothing is said of what needs one."""
    if key is None:
        if needed:
            problems.add("NO_KEY", where, "is missing", hint=f"{needed} key=jax.random.key(...).")
        return
    if isinstance(key, jax.Array | np.ndarray):
        new = jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
        if (new and not key.ndim) or (key.dtype == np.uint32 and key.ndim == 1):
            return
    try:
        seed = operator.index(key)
    except TypeError:
        seed = 0
    told = f"is {key!r:.60}".splitlines()[0]
    problems.add("WRONG_KIND", where, told, value=key, limit="one key of jax.random", hint=f"Write key=jax.random.key({seed}).")


def warn_of_degrees(angle: Any, where: str) -> None:
    """UNIT: an angle of more than a turn where a part of one is usual."""
    known = concrete(angle)
    if known is not None and (largest := float(np.abs(known).max(initial=0.0))) > 2 * np.pi:
        warn("UNIT", f"{where} is {largest:.4g} rad, more than a turn; if it is in degrees, write np.deg2rad({largest:.4g})")


def check_kind(value: Any, kinds: type | tuple[type, ...], where: str, wanted: str, problems: Problems) -> None:
    """An object of one of these kinds; a class in place of its object is a common slip."""
    if not isinstance(value, kinds):
        hint = f"Write {value.__name__}(...)." if isinstance(value, type) else f"Give {wanted}."
        problems.add("WRONG_KIND", where, f"is {kind_of(value)}", value=value, limit=wanted, hint=hint)


def is_own(part: Any) -> bool:
    """True of a module whose class is the user's, and of one that holds a bare function."""
    return not type(part).__module__.startswith("jaxbody.") or type(part).__name__ == "Function"


def check_returned(call: Callable[[Any, Any], Any], module: Any, shape: tuple[int, ...], where: str, problems: Problems) -> None:
    """call(module, number) must be one that JAX can trace, and return an array of this shape; nothing is computed or compiled.

    Errors: NOT_TRACEABLE, FUNCTION_FAILED, BAD_SHAPE."""
    returns = "one number" if shape == () else f"{shape[0]} numbers in one array"
    try:
        out = jax.eval_shape(call, module, jax.ShapeDtypeStruct((), jnp.result_type(float)))
    except jax.errors.JAXTypeError:
        told = "cannot be traced by JAX: it gives its argument to numpy or math, or asks for its value"
        problems.add("NOT_TRACEABLE", where, told, limit="functions of jax.numpy", hint=USE_JNP)
    except Exception as error:  # whatever a function of the user's may raise
        text = (str(error).splitlines() or [""])[0]
        hint = f"Call it by itself with jnp.array(0.1); it must return {returns}."
        problems.add("FUNCTION_FAILED", where, f"raises {type(error).__name__}: {text:.200}", limit=returns, hint=hint)
    else:
        found = getattr(out, "shape", None)
        if found != shape:
            told = f"returns a {type(out).__name__}" if found is None else f"returns shape {found}"
            hint = f"Return jnp.array([...]), {returns}." if shape else "Return one number, of shape ()."
            problems.add("BAD_SHAPE", where, told, value=found, limit=str(shape), hint=hint)
