"""Derivatives and batches outside a jit: programs like that of the function itself, with the same options.

JAX compiles a jitted function that is differentiated or batched outside a jit without its options: the gradient of a frequency then took
three times as long to compile. Here such a call is one operation whose derivative, linearization and batch are operations of the same
kind, each of them a jitted function with the options. A gradient calls its pullbacks from last to first: what the first of them returns
says with what the one before it will be called, and so on; they are traced and compiled ahead, while XLA compiles those that come first.
"""

from __future__ import annotations

import functools
import itertools
import weakref
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from jaxbody.compilation.array_functions import KEPT, jitted
from jaxbody.compilation.derived_programs import Batch, Jvp, OneByOne, Pullback, Reach, Tangents, apart, is_real, pullback_of
from jaxbody.compilation.kept_programs import NUMBERS, Options, Results, call, compiled_by_jax, on_first_device, structs, types_of_results
from jaxbody.compilation.shared_settings import little_garbage
from jaxbody.core.jax_internals import (
    Tracer,
    Zero,
    chosen,
    merged,
    new_operation,
    traces_shared,
    transpose_with_sums,
    unknown,
)

FEW = 16  # members of a batch up to which it is compiled like one of them
OFTEN = 100  # calls after which a program is optimized, or a batch becomes a loop: a fit of a plate loses 25 ms each, and 2 s to compile
NOT_OPTIMIZED = ("xla_backend_optimization_level", 0)  # an option of functions that take milliseconds


def run(program: Callable[..., Results], options: tuple[Options, Options], arrays: Sequence[Any]) -> Results:
    """program(*arrays), compiled with these options, those of batches of more than FEW last, as one operation for the derivative or the
    batch that is under way."""
    return _program_p.bind(*arrays, program=program, options=options), types_of_results(program, _types_of(arrays))[1]


@functools.lru_cache(KEPT)
def calls_of(program: Callable[..., Any]) -> Iterator[int]:
    """The number of its calls so far, counted by who asks."""
    return itertools.count()


# The operation, and the linear one that stands for its tangents while a linear function is made


def _types_of(arrays: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(map(jax.typeof, arrays))


def _program_jvp(primals, tangents, *, program, options):
    moved = tuple(type(t) is not Zero and jax.typeof(t).dtype != jax.dtypes.float0 for t in tangents)
    moving = chosen(tangents, moved)
    if any(map(unknown, moving)):
        out = run(program, options, primals)[0]
        types = tuple(jax.typeof(y) for y in out if is_real(y))
        if all(map(_is_array, [*primals, *out])):
            _called.append(Called(program, moved, options, [weakref.ref(x) for x in (*primals, *out)]))
        parameters = dict(program=program, moved=moved, options=options, types=types)
        tangents_out = _tangents_p.bind(*primals, *out, *moving, **parameters) if types else []
    else:
        count = len(types_of_results(program, _types_of(primals))[0])
        out = run(Jvp(program, moved), options, [*primals, *moving])[0]
        out, tangents_out = out[:count], out[count:]
    return out, merged(list(map(is_real, out)), tangents_out, [Zero(jax.typeof(y).to_tangent_aval()) for y in out])


def _program_batch(args, axes, *, program, options):
    size = next(x.shape[axis] for x, axis in zip(args, axes, strict=True) if axis is not None)
    if size <= FEW and NOT_OPTIMIZED in options[1] and not any(map(_is_sharded, args)):
        loop = OneByOne(program, tuple(axes))
        if all(map(_is_number, args)) and on_first_device(args) and next(calls_of(loop)) < OFTEN:
            return _of_each(loop, options[0], args)
        out, remainder = run(loop, options, args)
    else:
        out, remainder = run(Batch(program, tuple(axes), size), options if size <= FEW else (options[1],) * 2, args)
    return out, remainder.value[1]


def _of_each(batch: OneByOne, options: Options, args: Sequence[Any]) -> tuple[list[Any], list[int | None]]:
    """The results of a batch, by a call of f itself for each member, which compiles nothing where f has been called."""
    on = tuple(axis is not None for axis in batch.axes)
    rows = zip(*(np.moveaxis(np.asarray(x), axis, 0) for x, axis in zip(args, batch.axes, strict=True) if axis is not None), strict=True)
    members = [merged(on, row, args) for row in rows]
    own = types_of_results(Reach(batch.of, on), _types_of(members[0]))[1].value
    first, *others = [call(batch.of, options, member)[0] for member in members]
    stacked = jax.device_put([np.stack(y) for y, o in zip(zip(first, *others, strict=True), own, strict=True) if o])
    return merged(own, stacked, first), [0 if o else None for o in own]


def _is_array(x: Any) -> bool:
    return isinstance(x, jax.Array) and not isinstance(x, Tracer)


def _is_number(x: Any) -> bool:
    return not isinstance(x, Tracer) and getattr(getattr(x, "dtype", None), "kind", "") in NUMBERS


def _is_sharded(x: Any) -> bool:
    return _is_array(x) and len(x.devices()) > 1


_program_p = new_operation(
    "program",
    lambda *args, program, options: call(program, options[0], args)[0],
    inside=lambda *args, program, options: jitted(program)(*args)[0],  # of a jit, where a linear function from outside of it is called
    typed=lambda *types, program, **_: types_of_results(program, types)[0],
    several=True,
    batch=_program_batch,
    jvp=_program_jvp,
)


def _tangents(*args, program, moved, options, types):
    """f'(x) x' of (x, y, x')."""
    known, moving = apart(args, moved)
    x = known[: len(moved)]
    return run(Tangents(Jvp(program, moved), len(known) - len(x)), options, [*x, *moving])[0]


def _tangents_transpose(cotangents, so_far, *args, program, moved, options, types):
    (known, moving), (_, sums) = apart(args, moved), apart(so_far, moved)
    given, summed = [type(w) is not Zero for w in cotangents], [s is not None for s in sums]
    pullback = pullback_of(program, moved, given, summed)
    arrays = [*known, *chosen(cotangents, given), *chosen(sums, summed)]
    with traces_shared(), little_garbage():
        if all(map(_is_array, arrays)) and compiled_by_jax(arrays):
            _compile_ahead(pullback, options, arrays)
        out, needed = run(pullback, options, arrays)
    return [None] * len(known) + merged(needed.value, out, [Zero(x.aval) for x in moving])


def _tangents_jvp(primals, tangents, **params):
    moved = [type(t) is not Zero for t in tangents]

    def of_moved(*given):
        return _tangents(*merged(moved, given, primals), **params)

    return jax.jvp(of_moved, chosen(primals, moved), chosen(tangents, moved))


def _tangents_batch(args, axes, **params):
    out = jax.vmap(functools.partial(_tangents, **params), tuple(axes))(*args)
    return out, [0] * len(out)


_tangents_p = new_operation(
    "tangents_of_program",
    _tangents,
    typed=lambda *_, types, **__: list(types),
    several=True,
    batch=_tangents_batch,
    jvp=_tangents_jvp,
)
SUMS = transpose_with_sums(_tangents_p, _tangents_transpose)


# Pullbacks that follow each other


@dataclass(frozen=True, eq=False)
class Called:
    """A call y = f(x) with tangents of those x that are `moved`, whose pullback may follow; its arrays as long as others hold them."""

    of: Callable[..., Results]
    moved: tuple[bool, ...]
    options: tuple[Options, Options]
    references: list[weakref.ref[Any]]

    def x_and_y(self) -> list[Any]:
        """None for those that are gone."""
        return [reference() for reference in self.references]


_called: deque[Called] = deque(maxlen=64)


def _compile_ahead(pullback: Pullback, options: tuple[Options, Options], arrays: Sequence[Any]) -> None:
    """Compile a pullback at its first call, and those that follow."""
    types = _types_of(arrays)
    compiling = _compiling(pullback, options, types)
    if not compiling:
        for program, its_options, given in itertools.chain([(pullback, options, types)], _following(pullback, types, arrays)):
            if not (begun := _compiling(program, its_options, given)):
                lowered = jitted(program, its_options[0]).trace(*structs(given)).lower()  # pyright: ignore[reportFunctionMemberAccess]
                executor = ThreadPoolExecutor(1)
                begun.append(executor.submit(lambda lowered=lowered: lowered.compile()))
                executor.shutdown(wait=False)
    compiling[0].result()


@functools.lru_cache(KEPT)
def _compiling(program: Callable[..., Any], options: tuple[Options, Options], types: tuple[Any, ...]) -> list[Future[Any]]:
    """Where a program is compiled ahead, if it is."""
    return []


def _following(pullback: Pullback, types: tuple[Any, ...], arrays: Sequence[Any]) -> Iterator[tuple[Pullback, Any, tuple[Any, ...]]]:
    """The pullbacks that JAX calls after this one with these arrays, where nothing else depends on what earlier calls have made: each with
    its options and the types of its arguments."""
    calls = reversed(_called.copy())
    if not any(called.of is pullback.of.of and all(x is y for x, y in zip(called.x_and_y(), arrays, strict=False)) for called in calls):
        return
    cotangents = _cotangents(pullback, types, arrays)
    for called in calls:  # before this one
        known, n = called.x_and_y(), len(called.moved)
        moving, real = chosen(known[:n], called.moved), [y for y in known[n:] if y is not None and is_real(y)]
        given, ids = [id(y) in cotangents for y in real], list(map(id, moving))
        summed = [SUMS and x in cotangents and ids.index(x) == i for i, x in enumerate(ids)]
        if any(given) and not any(x is None for x in known):
            pullback = pullback_of(called.of, called.moved, given, summed)
            own = [cotangents[id(x)] for x in (*chosen(real, given), *chosen(moving, summed))]
            types = (*_types_of(known), *own)
            yield pullback, called.options, types
            cotangents |= _cotangents(pullback, types, known)


def _cotangents(pullback: Pullback, types: tuple[Any, ...], arrays: Sequence[Any]) -> dict[int, Any]:
    """{id of each x that has a cotangent after a pullback: the type of it}, of arrays that begin with x."""
    moving, (_, sums) = chosen(arrays[: len(pullback.of.moved)], pullback.of.moved), apart(types, pullback.summed)
    out, needed = types_of_results(pullback, types)
    return {id(x): t for x, t in zip((*chosen(moving, pullback.summed), *chosen(moving, needed.value)), (*sums, *out), strict=True)}
