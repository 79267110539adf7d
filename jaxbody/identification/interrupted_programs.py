"""A JAX function that asks Python for numbers on its way: what lies between the questions are parts of one program.

An optimizer of optax asks for values of the cost, in loops and branches of its line search. Operation by operation it would be a program
for each kind of operation; a callback that runs JAX can block. The function is traced once, and loops and branches that ask run in Python.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbody.compilation.compile_options import jit
from jaxbody.compilation.program_parts import parts_of, programs_inside, read
from jaxbody.core.jax_internals import Zero, new_operation, same_operation, shaped

Answer = Callable[[np.ndarray], tuple[Any, Any]]  # value and gradient of the cost at y
Run = Callable[[Answer, list[Any]], list[Any]]


def asked(y: Float[Array, "n"]) -> Float[Array, ""]:
    """The value of the cost at y, which Python will give; it can be differentiated."""
    return _asked_p.bind(y)[0]


def interrupted(function: Callable[..., Any], *like: Any, parts: Parts) -> Callable[..., Any]:
    """The function of (answer, *arguments) in which `answer` gives the values that the function gets from `asked`.

    Args:
        function: a JAX function; only loops (`while_loop`) and branches (`cond`) may ask
        like: arguments of the shapes and types that will be passed
        parts: those of other functions for the same program, which is compiled when one of them is first called
    """
    traced, out = jax.make_jaxpr(function, return_shape=True)(*like)
    run, tree = _divided(traced.jaxpr, parts), jax.tree.structure(out)

    def call(answer: Answer, *args: Any) -> Any:
        return jax.tree.unflatten(tree, run(answer, [*traced.consts, *jax.tree.leaves(args)]))

    return call


def _by_itself(*args: Any, **_: Any) -> Any:
    raise NotImplementedError("`asked` outside of `interrupted`, or in a batch")


def _asked_jvp(primals, tangents):
    value, gradient = _asked_p.bind(*primals)
    return [value, gradient], [gradient @ tangents[0], Zero(jax.typeof(gradient).to_tangent_aval())]


_asked_p = new_operation(
    "asked",
    _by_itself,
    typed=lambda y: [shaped((), y.dtype), shaped(y.shape, y.dtype)],
    several=True,
    batch=_by_itself,
    jvp=_asked_jvp,
)


class Parts:
    """The parts of a program between questions, as branches of one program, which compiles in less time than they would.

    All have the same arguments and results: as many arrays of each type as the part that needs most of them."""

    def __init__(self):
        self.branches: list[Callable[[dict[Any, list[Any]]], dict[Any, list[Any]]]] = []
        self.most: tuple[dict[Any, int], dict[Any, int]] = ({}, {})  # {type: number of arrays}, of arguments and of results

    def add(self, eqns: list[Any], needed: list[Any], kept: list[Any]) -> Run:
        """The part that these operations are, as a function of what it needs to what later ones need."""
        for most, variables in zip(self.most, (needed, kept), strict=True):
            for kind, own in _by_type(variables).items():
                most[kind] = max(most.get(kind, 0), len(own))

        def branch(given):
            values = {v: x for kind, own in _by_type(needed).items() for v, x in zip(own, given[kind], strict=False)}
            for eqn in eqns:
                values |= zip(eqn.outvars, same_operation(eqn, read(values, eqn.invars)), strict=True)
            return self.filled(1, kept, [jnp.asarray(values[v], v.aval.dtype) for v in kept])

        which = len(self.branches)
        self.branches.append(branch)

        def run(answer: Answer, args: list[Any]) -> list[Any]:
            results = {kind: iter(own) for kind, own in self.program(np.int32(which), self.filled(0, needed, args)).items()}
            return [next(results[_type(v)]) for v in kept]

        return run

    @functools.cached_property
    def program(self) -> Callable[..., Any]:
        def between(which, given):
            return jax.lax.switch(which, self.branches, given)

        return jit(between)

    def filled(self, end: int, variables: list[Any], values: list[Any]) -> dict[Any, list[Any]]:
        """{type: arrays} of a part, with zeros for those that it does not have."""
        lists: dict[Any, list[Any]] = {kind: [] for kind in self.most[end]}
        for v, x in zip(variables, values, strict=True):
            lists[_type(v)].append(np.asarray(x) if end == 0 else x)  # with no weak type, which would be another program
        return {kind: [*own, *(np.zeros(*kind) for _ in range(self.most[end][kind] - len(own)))] for kind, own in lists.items()}


def _type(v: Any) -> tuple[tuple[int, ...], str]:
    return v.aval.shape, v.aval.dtype.name


def _by_type(variables: list[Any]) -> dict[Any, list[Any]]:
    lists: dict[Any, list[Any]] = {}
    for v in variables:
        lists.setdefault(_type(v), []).append(v)
    return lists


def _asks(eqn: Any) -> bool:
    return eqn.primitive is _asked_p or any(_asks(part) for jaxpr in programs_inside(eqn) for part in jaxpr.eqns)


def _divided(jaxpr: Any, parts: Parts) -> Run:
    """Runs a program: operations that ask in Python, all between two of them as one part."""
    steps = []
    for alone, eqns, needed, kept in parts_of(jaxpr, _asks):
        asks = alone is not None
        steps.append((_question(alone, parts), alone.invars, alone.outvars) if asks else (parts.add(eqns, needed, kept), needed, kept))

    def run_all(answer: Answer, args: list[Any]) -> list[Any]:
        values = dict(zip([*jaxpr.constvars, *jaxpr.invars], args, strict=True))
        for run, given, results in steps:
            values |= zip(results, run(answer, read(values, given)), strict=True)
        return read(values, jaxpr.outvars)

    return run_all


def _question(eqn: Any, parts: Parts) -> Run:
    """How Python runs an operation that asks."""
    params = eqn.params
    if eqn.primitive is _asked_p:
        return lambda answer, args: [np.asarray(x, args[0].dtype) for x in answer(np.asarray(args[0]))]
    if eqn.primitive.name == "while":
        condition, body = (_closed(params[name], parts) for name in ("cond_jaxpr", "body_jaxpr"))
        n, m = params["cond_nconsts"], params["body_nconsts"]

        def loop(answer: Answer, args: list[Any]) -> list[Any]:
            known, constants, state = args[:n], args[n : n + m], args[n + m :]
            while condition(answer, [*known, *state])[0]:
                state = body(answer, [*constants, *state])
            return state

        return loop
    if eqn.primitive.name == "cond":
        branches = [_closed(branch, parts) for branch in params["branches"]]
        return lambda answer, args: branches[min(max(int(args[0]), 0), len(branches) - 1)](answer, args[1:])
    if eqn.primitive.name in ("jit", "pjit"):
        return _closed(params["jaxpr"], parts)
    raise NotImplementedError(f"The operation {eqn.primitive.name} cannot ask Python for numbers")


def _closed(closed: Any, parts: Parts) -> Run:
    run = _divided(closed.jaxpr, parts)
    return lambda answer, args: run(answer, [*closed.consts, *args])
