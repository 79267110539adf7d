"""Numbers from users: checked and converted to float arrays once, when they are given."""

from datetime import date
from numbers import Real
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float, Inexact, Int, PRNGKeyArray  # noqa: F401  for annotations, with Array

from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.core.jax_internals import Tracer

# for annotations: numbers from the user stay NumPy arrays, on no device, until they are used in a
# computation
Array = jax.Array | np.ndarray


def float_array(value: Any, where: str = "value") -> np.ndarray | jax.Array:
    """Return a number, list, array or data frame as a float64 NumPy array, or as a JAX array if any
    part of it is traced.

    With NumPy, building a model uses no device and does not depend on the x64 switch. Errors:
    COMPLEX, NOT_A_NUMBER."""
    traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value))
    if isinstance(value, np.ma.MaskedArray):
        value = np.ma.filled(value.astype(float), np.nan)  # a gap, not the number behind the mask
    try:
        array = jnp.asarray(value) if traced else np.asarray(value)
        # numbers of several kinds
        if array.dtype == object and all(isinstance(x, Real) for _, x in np.ndenumerate(array)):
            array = array.astype(np.float64)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        # ragged rows, or an object that does not convert
        array = np.array(None)
    if jnp.issubdtype(array.dtype, jnp.complexfloating):
        raise JaxbodyError(
            Problem(
                "COMPLEX",
                where,
                f"is complex ({array.dtype})",
                value,
                "real numbers",
                "Give real numbers.",
            )
        )
    if array.dtype.kind == "m" or not (
        jnp.issubdtype(array.dtype, jnp.number) or array.dtype == bool
    ):  # durations are integers to NumPy
        text, hint = _not_a_number(value, array.dtype.kind)
        message = f"is {value!r:.60}".splitlines()[0] + f", which is not an array of numbers{text}"
        raise JaxbodyError(Problem("NOT_A_NUMBER", where, message, value, "numbers", hint))
    return array.astype(float if traced else np.float64)


def _not_a_number(value: Any, kind: str) -> tuple[str, str]:
    """Return text that names the first element of an array or list that is not a number, and a hint
    for the message. `kind`: the kind of NumPy's type, "m" for durations, "M" for dates."""
    hint = "Give a number, or a list or array of numbers."
    try:
        elements: Any = np.asarray(value, object)
        if kind in "mM" or isinstance(elements.flat[0], date):
            return (
                "",
                (
                    'Give seconds: of dates (t - t[0]) / np.timedelta64(1, "s"), of durations t / '
                    'np.timedelta64(1, "s").'
                ),
            )
        rows = elements.ndim == 1 and all(
            isinstance(x, list | tuple | np.ndarray) for x in elements
        )
        index, x = next(
            (i, x)
            for i, x in np.ndenumerate(elements)
            if (len(x) != len(elements[0]) if rows else not isinstance(x, Real))
        )
    except (TypeError, ValueError, RuntimeError, StopIteration, IndexError):
        return "", hint
    what = f"has length {len(x)}, the first one {len(elements[0])}" if rows else f"is {x!r:.40}"
    return f": element {list(map(int, index))} {what}" if index else "", hint


def time_array(value: Any, where: str) -> np.ndarray | jax.Array:
    """Return times [s] as `float_array` does. Error: NOT_A_NUMBER, also for True and False."""
    array = float_array(value, where)
    if str(getattr(value, "dtype", "")) in ("bool", "boolean") or (
        isinstance(value, list | tuple) and bool in map(type, value)
    ):
        raise JaxbodyError(
            Problem(
                "NOT_A_NUMBER",
                where,
                "are True and False, not times",
                value,
                "numbers",
                "Give times [s]; is this a comparison, such as t > 0?",
            )
        )
    return array


def numbers(value: Any, where: str) -> Any:
    """Return an array of floats unchanged; lists, integers and single numbers as an array of
    floats. Error: NOT_A_NUMBER."""
    return (
        float_array(value, where) if getattr(value, "dtype", np.dtype(int)).kind in "biu" else value
    )


def checked(
    value: Any, shapes: tuple[tuple[int, ...], ...], where: str, problems: Problems, hint: str = ""
) -> Any:
    """Return a finite float array of one of the shapes; None if it is not, with a problem added.

    Args:
        value: the argument.
        shapes: the allowed shapes.
        where: its place in the call, for messages.
        problems: collects the problem.
        hint: what to do about a wrong shape; by default how many numbers to give.
    """
    array = problems.gather(lambda: float_array(value, where))
    if array is None:
        return None
    if array.shape not in shapes:
        limit = " or ".join(map(str, shapes))
        counts = ["one number" if shape == () else f"{shape[0]} numbers" for shape in shapes]
        hint = hint or f"Give {' or '.join(counts)}."
        problems.add(
            "BAD_SHAPE",
            where,
            f"has shape {array.shape}",
            value=array.shape,
            limit=limit,
            hint=hint,
        )
        return None
    known = concrete(array)
    if known is not None and not np.isfinite(known).all():
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(known))[0])
        message = (
            f"is {known.tolist()}" if known.size <= 6 else f"is {known[first]} at {list(first)}"
        )
        problems.add(
            "NON_FINITE", where, message, value=known, limit="finite", hint="Give finite numbers."
        )
        return None
    return array


def shaped(value: Any, shape: tuple[int, ...], where: str, problems: Problems) -> Any:
    """Return a finite float array of this shape; zeros where it is not, with a problem added."""
    array = checked(value, (shape,), where, problems)
    return np.zeros(shape) if array is None else array


def device_array(value: Any) -> jax.Array:
    """Return the value as a JAX array, float64 or, where x64 is off, float32; numbers are converted
    without compiling a program."""
    return jnp.asarray(
        np.asarray(value, jnp.result_type(float)) if module_of(value) is np else value, float
    )


def functions_as_nodes(tree: Any) -> Any:
    """Return the tree with each leaf that is a function, such as the activation of a network,
    replaced by a pytree node that can be called."""
    return jax.tree.map(lambda leaf: jax.tree_util.Partial(leaf) if callable(leaf) else leaf, tree)


def stack(rows: list[Any]) -> jax.Array:
    """Return rows of equal shape as one JAX array."""
    if any(isinstance(row, jax.Array) for row in rows):
        return jnp.stack([device_array(row) for row in rows])
    return device_array(np.stack(rows))


def module_of(*x: Any) -> Any:
    """Return the module numpy if all are NumPy arrays or Python numbers, else jax.numpy."""
    return np if all(isinstance(y, np.ndarray | np.generic | float | int) for y in x) else jnp


def as_numpy(x: Any) -> Any:
    """Return x as a NumPy array, so that single operations with it are not compiled by JAX; x
    itself while it is traced."""
    return x if isinstance(x, Tracer) else np.asarray(x)


def part_of(x: Array, index: Any) -> Array:
    """Return x[index] as the same kind of array, without compiling a program for it."""
    return (
        x[index]
        if isinstance(x, Tracer | np.ndarray)
        else jnp.asarray(np.asarray(np.asarray(x)[index]), x.dtype)
    )


def indices(shape: tuple[int, ...]) -> list[str]:
    """Return the index of each number of an array, as text: "[0,1]", or "" for a scalar."""
    return [str(list(i)).replace(" ", "") if i else "" for i in np.ndindex(shape)]


def concrete(value: Any) -> np.ndarray | None:
    """Return the value as a NumPy array; None while it is traced."""
    return None if isinstance(value, Tracer) else np.asarray(value)


def nan_unless(valid: Any, x: Any) -> jax.Array:
    """Return x where `valid` is True, else NaN with NaN as its derivative."""
    return x * jnp.where(valid, jnp.ones((), x.dtype), jnp.nan)


@jax.custom_jvp
def rows_or_nan(valid: Any, x: Any) -> jax.Array:
    """Return x where `valid` is True, else NaN with NaN as its derivative. Derivatives of valid
    rows remain.

    `nan_unless` would lose those in reverse mode, and `jnp.where` has derivatives of zero where x
    is not valid."""
    return jnp.where(valid, x, jnp.nan)


@rows_or_nan.defjvp
def _rows_or_nan_jvp(primals, tangents):
    return rows_or_nan(*primals), tangent_or_nan(primals[0], tangents[1])


def tangent_or_nan(valid: Any, x: Any) -> jax.Array:
    """Return a tangent x where it is valid, else NaN, for use in custom_jvp rules: JAX can
    transpose it for reverse mode, where a derivative of zero remains zero."""

    def backward(_, slope):
        return jnp.where(valid | (slope == 0), slope, jnp.nan)

    return jax.lax.custom_linear_solve(
        lambda x: x, x, lambda _, x: jnp.where(valid, x, jnp.nan), backward
    )


def is_concrete(*trees: Any) -> bool:
    """Return whether nothing in the trees is traced, so that values can be read."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees))


def scalar(value: Any, where: str, problems: Problems) -> Any:
    """Return one finite number; zero where it is not, with a problem added."""
    return shaped(value, (), where, problems)


def vector(value: Any, where: str, problems: Problems) -> Any:
    """Return three finite numbers; zeros where they are not, with a problem added."""
    return shaped(value, (3,), where, problems)


def of_unit_length(rows: np.ndarray) -> np.ndarray:
    """Return rows divided by their lengths. A row of length 1 to rounding is unchanged, so that it
    is the same if it is given again."""
    length = np.linalg.norm(rows, axis=-1, keepdims=True)
    return np.where(
        np.abs(length - 1) <= 4 * jnp.finfo(jnp.result_type(float)).eps, rows, rows / length
    )


def time_text(t: Any, times: Any, digits: int = 6) -> str:
    """Return a time [s] as text, with `digits` digits after the leading digits that all `times`
    have in common, such as those of Unix times."""
    known = np.asarray(times, float)
    known = known[np.isfinite(known)]
    shared = (
        np.log10(max(np.abs(known).max() / (np.ptp(known) or np.inf), 1.0)) if len(known) else 0
    )
    return f"{float(t):.{min(digits + int(shared), 17)}g}"


def check_times(
    times, problems: Problems, where: str = "times", minimum: int = 1, *, kept: bool = False
) -> np.ndarray | jax.Array | None:
    """Return increasing, finite, one-dimensional times [s]; None if they are not, with a problem
    added.

    Args:
        times: the argument.
        problems: collects the problem.
        where: its place in the call, for messages.
        minimum: the least number of times.
        kept: True: times must increase in the precision in which they are given; False: also after
            conversion to JAX's float type, which is float32 where x64 is off.
    """
    times = problems.gather(lambda given=times: time_array(given, where))
    if times is None:
        return None
    known = concrete(times)
    if times.ndim != 1 or times.shape[0] < minimum:
        code = "NO_DATA" if times.size == 0 or times.ndim == 1 else "BAD_SHAPE"
        problems.add(
            code,
            where,
            f"has shape {times.shape}",
            value=times.shape,
            limit=f"(n,) with n >= {minimum}",
            hint=f"Give at least {minimum} times.",
        )
        return None
    if known is None:
        return times
    if not np.isfinite(known).all():
        i = int(np.flatnonzero(~np.isfinite(known))[0])
        problems.add(
            "NAN_TIME",
            where,
            f"is {known[i]} at index {i}",
            value=float(known[i]),
            limit="finite",
            hint="Cut the record, or drop the samples whose time is unknown.",
        )
        return None
    steps = np.diff(known if kept else known.astype(jnp.result_type(float)))
    if (steps <= 0).any():
        i = int(np.flatnonzero(steps <= 0)[0])
        code, word = (
            ("DUPLICATE_TIME", "repeats") if steps[i] == 0 else ("UNSORTED_TIME", "goes back")
        )
        hint = "Sort the samples and drop duplicates."
        if steps[i] == 0 and steps.dtype == np.float32:
            word, hint = (
                "repeats in float32",
                hint[:-1] + ", and subtract the first time or enable float64.",
            )
        first, second = (time_text(t, known[i : i + 2], 9) for t in known[i : i + 2])
        problems.add(
            code,
            where,
            f"{word} at index {i + 1}: {first} s, then {second} s",
            value=i + 1,
            limit="increasing",
            hint=hint,
        )
        return None
    return times
