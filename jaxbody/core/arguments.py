"""Checks of arguments other than arrays: dicts, names, whole and positive numbers, random keys,
objects, functions from the user."""

import operator
from collections.abc import Callable, Collection, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import checked, concrete, nan_unless
from jaxbody.core.errors import Problems, warn
from jaxbody.core.jax_internals import Tracer

USE_JNP = "Write it with jax.numpy: jnp.sin for np.sin and math.sin, jnp.where for if."


def plain(name: Any) -> Any:
    """Return a name, or a tuple of names, as Python strings, as JAX treats NumPy strings as
    arrays."""
    if isinstance(name, tuple):
        return tuple(map(plain, name))
    return str(name) if isinstance(name, str) else name


def kind_of(value: Any) -> str:
    """Return the kind of a value in words: "a list", "an Equilibrium", "the class Tsit5"."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    name = type(value).__name__
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"


def checked_dict(things: Any, where: str, kind: str, problems: Problems) -> dict[Any, Any]:
    """Return the dict with Python strings as names; empty if `things` is not a dict, with a problem
    added.

    Args:
        things: the argument, a dict or None.
        where: its place in the call, for messages.
        kind: what it should hold, for messages, such as "name: body".
        problems: collects the problem.
    """
    if things is None:
        return {}
    if not isinstance(things, Mapping):
        problems.add(
            "WRONG_KIND",
            where,
            f"is {kind_of(things)}",
            value=things,
            limit=f"a dict {{{kind}}}",
            hint=f'Write {where.rpartition(".")[2]}={{"...": {kind.partition(": ")[2]}}}.',
        )
        return {}
    return {plain(name): thing for name, thing in things.items()}


def whole_number(
    value: Any, where: str, problems: Problems, least: int = 1, code: str = "BAD_NUMBER"
) -> Any:
    """Return the value as an int if it is a whole number, `least` or more; 1e5 counts as whole.
    Otherwise add a problem. Traced numbers are returned unchanged.

    Args:
        value: the argument.
        where: its place in the call, for messages.
        problems: collects the problem.
        least: the smallest number allowed, returned in place of a wrong one; 1 by default.
        code: code of the problem.
    """
    if isinstance(value, Tracer):
        return value
    number: Any = int(value) if isinstance(value, float) and value.is_integer() else value
    try:
        valid = operator.index(number) >= least and not isinstance(value, bool)
    except TypeError:
        valid = False
    if not valid:
        problems.add(
            code, where, f"is {value!r:.60}", value=value, limit=f"a whole number >= {least}"
        )
        return least
    return number


def positive_number(value: Any, where: str, problems: Problems, code: str = "BAD_NUMBER") -> Any:
    """Return the value if it is one finite number above zero.

    Otherwise return None, with a problem added. A traced number becomes NaN if it is not above
    zero."""
    number = checked(value, ((),), where, problems)
    known = None if number is None else concrete(number)
    if known is not None and not known > 0:
        problems.add(code, where, f"is {value}", value=value, limit="> 0")
        return None
    return number if number is None or known is not None else nan_unless(number > 0, number)


def check_one_of(
    value: Any,
    known: Collection[str],
    code: str,
    where: str,
    problems: Problems,
    hint: str = "Give one of these.",
) -> None:
    """Check that a word is one of the known words.

    Args:
        value: the argument.
        known: the known words.
        code: code of the problem.
        where: its place in the call, for messages.
        problems: collects the problem.
        hint: what to do, for the message.
    """
    if value not in known:
        problems.add(
            code,
            where,
            f"is {value!r:.60}",
            value=value,
            limit=(" or " if len(known) == 2 else " ").join(known),
            hint=hint,
        )


def check_key(key: Any, where: str, problems: Problems, needed: str = "") -> None:
    """Check a random key of JAX, typed or of the old kind.

    Args:
        key: the argument.
        where: its place in the call, for messages.
        problems: collects the problem.
        needed: the reason why a key is required, for the hint; "" if the key may be None.
    """
    if key is None:
        if needed:
            problems.add("NO_KEY", where, "is missing", hint=f"{needed} key=jax.random.key(...).")
        return
    if isinstance(key, jax.Array | np.ndarray):
        typed = jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
        if (typed and not key.ndim) or (key.dtype == np.uint32 and key.ndim == 1):
            return
    try:
        seed = operator.index(key)
    except TypeError:
        seed = 0
    message = f"is {key!r:.60}".splitlines()[0]
    problems.add(
        "WRONG_KIND",
        where,
        message,
        value=key,
        limit="one key of jax.random",
        hint=f"Write key=jax.random.key({seed}).",
    )


def warn_of_degrees(angle: Any, where: str) -> None:
    """Issue the warning UNIT for an angle [rad] of more than one turn, which may be in degrees."""
    known = concrete(angle)
    if known is not None and (largest := float(np.abs(known).max(initial=0.0))) > 2 * np.pi:
        warn(
            "UNIT",
            f"{where} is {largest:.4g} rad, more than a turn; if it is in degrees, write "
            f"np.deg2rad({largest:.4g})",
        )


def check_kind(
    value: Any, kinds: type | tuple[type, ...], where: str, wanted: str, problems: Problems
) -> None:
    """Check that an object is of one of these kinds; a class given instead of an instance has its
    own hint.

    Args:
        value: the argument.
        kinds: class or classes of which it may be.
        where: its place in the call, for messages.
        wanted: these kinds in words.
        problems: collects the problem.
    """
    if not isinstance(value, kinds):
        hint = f"Write {value.__name__}(...)." if isinstance(value, type) else f"Give {wanted}."
        problems.add(
            "WRONG_KIND", where, f"is {kind_of(value)}", value=value, limit=wanted, hint=hint
        )


def is_own(part: Any) -> bool:
    """Return whether an equinox module is of a class that the user wrote, or wraps a function."""
    return not type(part).__module__.startswith("jaxbody.") or type(part).__name__.endswith(
        "Function"
    )


def check_returned(
    call: Callable[[Any, Any], Any],
    module: Any,
    shape: tuple[int, ...],
    where: str,
    problems: Problems,
    of: str = "jnp.array(0.1)",
) -> None:
    """Check that JAX can trace a function of the user, and that it returns an array of this shape;
    nothing is computed or compiled.

    Args:
        call: call(module, number) calls the function.
        module: the module that holds it.
        shape: the shape that it must return.
        where: its place in the call, for messages.
        problems: collects the problems: NOT_TRACEABLE, FUNCTION_FAILED, BAD_SHAPE.
        of: an example of its argument as text, for the hint.
    """
    returns = "one number" if shape == () else f"{shape[0]} numbers in one array"
    try:
        out = jax.eval_shape(call, module, jax.ShapeDtypeStruct((), jnp.result_type(float)))
    except jax.errors.JAXTypeError:
        problems.add(
            "NOT_TRACEABLE",
            where,
            (
                "cannot be traced by JAX: it passes its argument to numpy or math, "
                "or asks for its value"
            ),
            limit="functions of jax.numpy",
            hint=USE_JNP,
        )
    except Exception as error:  # a function of the user may raise anything
        text = (str(error).splitlines() or [""])[0]
        problems.add(
            "FUNCTION_FAILED",
            where,
            f"raises {type(error).__name__}: {text:.200}",
            limit=returns,
            hint=f"Call it by itself with {of}; it must return {returns}.",
        )
    else:
        returned = getattr(out, "shape", None)
        if returned != shape:
            message = (
                f"returns a {type(out).__name__}"
                if returned is None
                else f"returns shape {returned}"
            )
            hint = (
                f"Return jnp.array([...]), {returns}."
                if shape
                else "Return one number, of shape ()."
            )
            problems.add("BAD_SHAPE", where, message, value=returned, limit=str(shape), hint=hint)
