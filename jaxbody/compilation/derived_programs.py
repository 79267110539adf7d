"""Functions of arrays that are made from another one: its derivatives, its pullback, batches of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from jaxbody.compilation.array_functions import Remainder, jitted, without_weak_type
from jaxbody.compilation.kept_programs import Results
from jaxbody.compilation.program_parts import reach, with_known_results
from jaxbody.core.jax_internals import chosen, jaxpr_as_fun, merged, only_what_is_needed, unbatched


@dataclass(frozen=True)
class Derived(ABC):
    """A function of arrays that is made from another one, f."""

    of: Callable[..., Results]

    @property
    def __name__(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]  # as of a function
        return f"{self.of.__name__}_{type(self).__name__.lower()}"

    @abstractmethod
    def __call__(self, *arrays: Any) -> Results: ...


@dataclass(frozen=True)
class Jvp(Derived):
    """(x, x') to (f(x), f'(x) x'), for tangents of all x that are `moved` and of all results that are real."""

    moved: tuple[bool, ...]

    def __call__(self, *args: Any) -> Results:
        x = args[: len(self.moved)]

        def of_moved(*given):
            out, remainder = jitted(self.of)(*merged(self.moved, given, x))
            return [y for y in out if is_real(y)], (out, remainder)

        _, tangents, (out, remainder) = jax.jvp(of_moved, chosen(x, self.moved), list(args[len(x) :]), has_aux=True)
        return [*out, *tangents], remainder


@dataclass(frozen=True)
class Tangents(Derived):
    """(x, x') to f'(x) x', of a Jvp."""

    count: int  # results of f

    def __call__(self, *args: Any) -> Results:
        out, remainder = jitted(self.of)(*args)
        return out[self.count :], remainder


@dataclass(frozen=True)
class Cotangents(Derived):
    """(x, y, w) to w f'(x), for all x that are `moved` and those w of real results y = f(x) that are `given`. It is made of the program of
    f without what the other results need, as zero times an infinite derivative is no number, and without what leads to y alone."""

    moved: tuple[bool, ...]
    given: tuple[bool, ...]

    def __call__(self, *args: Any) -> Results:
        known, w = apart(args, self.given)
        x, y = known[: len(self.moved)], known[len(self.moved) :]
        wanted = merged([is_real(of) for of in y], self.given, [False] * len(y))
        program: Any = jitted(self.of)
        part, used = with_known_results(program.trace(*x).jaxpr, list(self.moved), wanted)
        function = jaxpr_as_fun(only_what_is_needed(part))
        own = jax.lax.stop_gradient([y[i] for i in used])
        _, back = jax.vjp(lambda *moving: function(*merged(self.moved, moving, x), *own), *chosen(x, self.moved))
        return list(back(list(w))), Remainder(None)


@dataclass(frozen=True)
class Pullback(Derived):
    """(x, y, w, s) to s + w f'(x) of Cotangents, for those x on which they depend, and for the s of those x that are `summed`."""

    of: Cotangents  # pyright: ignore
    summed: tuple[bool, ...]

    @property
    def __name__(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return f"{self.of.of.__name__}_pullback"

    def __call__(self, *args: Any) -> Results:
        given, sums = apart(args, self.summed)
        program: Any = jitted(self.of)
        w = sum(self.of.given)
        needed = reach(program.trace(*given).jaxpr, [False] * (len(given) - w) + [True] * w)
        out, sums = program(*given)[0], merged(self.summed, sums, [None] * len(self.summed))
        return [without_weak_type(y if s is None else s + y) for s, y in chosen([*zip(sums, out, strict=True)], needed)], Remainder(needed)


def pullback_of(f: Callable[..., Results], moved: Sequence[bool], given: Sequence[bool], summed: Sequence[bool]) -> Pullback:
    """The pullback of f with these patterns, as `Cotangents` and `Pullback` name them."""
    return Pullback(Cotangents(f, tuple(moved), tuple(given)), tuple(summed))


@dataclass(frozen=True)
class Batch(Derived):
    """f for members along these axes, None for arrays that all members share; results that they share have no axis."""

    axes: tuple[int | None, ...]
    size: int

    def __call__(self, *x: Any) -> Results:
        shared: list[Any] = []
        remainder: list[Remainder] = []

        def member(*x):
            out, other = jitted(self.of)(*x)
            remainder.append(other)
            shared.extend(y if unbatched(y) else None for y in out)
            return [y for y in out if not unbatched(y)]

        own = jax.vmap(member, self.axes, axis_size=self.size)(*x)
        batched = [y is None for y in shared]
        return merged(batched, own, shared), Remainder((remainder[0], [0 if b else None for b in batched]))


@dataclass(frozen=True)
class Reach(Derived):
    """Which results of f depend on the arguments that are `on`."""

    on: tuple[bool, ...]

    def __call__(self, *x: Any) -> Results:
        program: Any = jitted(self.of)
        return [], Remainder(reach(program.trace(*x).jaxpr, list(self.on)))


@dataclass(frozen=True)
class OneByOne(Derived):
    """A Batch of few members as a loop over them, of which one is traced and compiled: half the time of a first result, and as fast again
    where operations are so small that their calls take longer than they do."""

    axes: tuple[int | None, ...]

    @property
    def __name__(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return f"{self.of.__name__}_batch"

    def __call__(self, *x: Any) -> Results:
        on = [axis is not None for axis in self.axes]
        rows = [jnp.moveaxis(y, axis, 0) for y, axis in zip(x, self.axes, strict=True) if axis is not None]
        of_one = merged(on, [jax.ShapeDtypeStruct(y.shape[1:], y.dtype) for y in rows], x)
        program: Any = jitted(self.of)
        own, remainder = reach(program.trace(*of_one).jaxpr, on), []

        def member(rows):
            out, other = program(*merged(on, rows, x))
            remainder.append(other)
            return out

        looped = jax.lax.map(lambda rows: chosen(member(rows), own), rows)
        shared = looped if all(own) else member([jax.lax.index_in_dim(y, 0, keepdims=False) for y in rows])
        return merged(own, looped, shared), Remainder((remainder[0], [0 if o else None for o in own]))


def is_real(y: Any) -> bool:
    """Whether y has tangents: of real or complex numbers."""
    return jnp.issubdtype(y.dtype, jnp.inexact)


def apart(args: Sequence[Any], moved: Sequence[bool]) -> tuple[Sequence[Any], Sequence[Any]]:
    """What is known, and the tangents or cotangents at the end."""
    n = len(args) - sum(moved)
    return args[:n], args[n:]
