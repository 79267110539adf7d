"""Checks that several public functions make before they compute, in NumPy: precision, memory,
attachment, states."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import kind_of
from jaxbody.core.arrays import concrete
from jaxbody.core.errors import JaxbodyError, Problem, Problems, warn
from jaxbody.model.forces.controllers import check_continuous
from jaxbody.model.layouts import WORLD
from jaxbody.model.models import Model, refuse_batch
from jaxbody.model.states import State

MOST_MEMORY = 8e9  # bytes that the matrices of a model may take
PER_ELEMENT = 2000  # bytes for each element: 1400 were measured with 10 000 springs
# bytes for each number of a matrix: 33 were measured with 300 coordinates and 200 frequencies
PER_FREQUENCY = 40
_warned_of_float32 = False


def check_precision(where: str, model: Model, *, allow_float32: bool | None = True) -> None:
    """Refuse anything that is not one model. Warn once about float32; refuse it with closures,
    which it cannot fulfill, and unless `allow_float32` is True (None: the calling function has no
    such option). A change of the x64 switch after the model was built is an error."""
    global _warned_of_float32
    if not isinstance(model, Model):
        raise JaxbodyError(
            Problem(
                "WRONG_KIND",
                f"{where}.model",
                f"is a {type(model).__name__}",
                model,
                "jb.Model",
                "Give the model first.",
            )
        )
    refuse_batch(model, f"{where}.model")
    x64 = jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]
    dtype = model.gravity.dtype
    if x64 != (dtype == jnp.float64):
        raise JaxbodyError(
            Problem(
                "X64_CHANGED",
                where,
                f"the model is {dtype}, but jax_enable_x64 is {x64} now",
                dtype,
                "one precision throughout",
                "Build the model again, or leave the switch alone after building it.",
            )
        )
    if x64:
        return
    switch = 'jax.config.update("jax_enable_x64", True) before building the model'
    if not allow_float32 or model.closures:
        message = "cannot close loops in float32" if model.closures else "is unreliable in float32"
        hint = f"Say {switch}" + (
            "." if allow_float32 is None or model.closures else "; or allow_float32=True."
        )
        raise JaxbodyError(Problem("FLOAT32", where, message, dtype, "float64", hint))
    if not _warned_of_float32:
        _warned_of_float32 = True
        warn("FLOAT32", f"{where}: computing in float32, with about 7 digits; for 16, use {switch}")


def check_independent(where: str, model: Model) -> None:
    """Refuse a model whose independent coordinates are not known. Error: CLOSED_LOOPS."""
    if model.independent is None:
        raise JaxbodyError(
            Problem(
                "CLOSED_LOOPS",
                f"{where}.model",
                "was built from numbers that are being traced",
                limit="a model with closures and given numbers",
                hint="Build it outside of jit and change its numbers by jb.replace.",
            )
        )


def check_moves(where: str, model: Model) -> None:
    """Refuse a model without coordinates. Error: NOTHING_MOVES."""
    if not model.layout.nv:
        raise JaxbodyError(
            Problem(
                "NOTHING_MOVES",
                f"{where}.model",
                "has no body that can move: all are fixed or driven",
                0,
                "a coordinate or more",
                "Free a body; jb.equilibrium gives the forces on supports.",
            )
        )


def check_small_motions(where: str, model: Model) -> None:
    """Check that a model has small motions: precision, moving coordinates that are independent and
    no sampled controllers. Errors: those of the checks below, SAMPLED."""
    for check in (check_precision, check_moves, check_independent, check_continuous):
        check(where, model)


def check_memory(where: str, model: Model, frequencies: int = 0) -> None:
    """Check the memory for about ten matrices of all coordinates, for the contributions of all
    elements, and for complex matrices at `frequencies` frequencies. Error: TOO_LARGE."""
    coordinates, elements = model.layout.nv, sum(len(table.names) for table in model.elements)
    needed = 10 * 8 * coordinates**2 + PER_ELEMENT * elements
    at_frequencies = PER_FREQUENCY * frequencies * coordinates**2
    if needed + at_frequencies > MOST_MEMORY:
        at, needed = (
            f" at {frequencies} frequencies" if at_frequencies > needed else "",
            needed + at_frequencies,
        )
        fewer = (
            "Give fewer frequencies at a time"
            if at
            else "Join bodies that move together (jb.Fixed, Body.of_parts)"
        )
        raise JaxbodyError(
            Problem(
                "TOO_LARGE",
                f"{where}.model",
                (
                    f"has {coordinates} coordinates and {elements} elements, whose matrices{at} "
                    f"need about {needed / 1e9:.3g} GB"
                ),
                needed,
                f"{MOST_MEMORY / 1e9:g} GB",
                f"{fewer}, or increase jaxbody.model.preconditions.MOST_MEMORY.",
            )
        )


def check_attached(model: Model) -> None:
    """Check that every body has a path of elements, joints and closures to the world or
    a support."""
    loose = unattached(model)
    if loose:
        raise JaxbodyError(
            *(
                Problem(
                    "UNATTACHED",
                    f"bodies['{name}']",
                    "has no path of elements or joints to world or a support",
                    name,
                    hint="It has no equilibrium; attach it or leave it out.",
                )
                for name in loose
            )
        )


def unattached(model: Model) -> list[str]:
    """Return the bodies without a path of elements, joints and closures to the world or a
    support."""
    links = [
        link for table in (*model.elements, *model.forces, *model.closures) for link in table.links
    ]
    links += [
        link
        for link in zip(model.layout.bodies, model.layout.parents, strict=True)
        if model.layout.block(link[0]).nv < 6
    ]
    tied, frontier = set(), {WORLD, *model.layout.supports}
    while frontier:
        tied |= frontier
        frontier = {end for link in links for end in link if tied & set(link)} - tied
    return [name for name in model.layout.bodies if name not in tied]


def check_without_memory(where: str, model: Model) -> None:
    """Refuse a model with elements with memory, in functions that do not support them. Error:
    MEMORY."""
    if model.layout.nz:
        raise JaxbodyError(
            Problem(
                "MEMORY",
                f"{where}.model",
                (
                    "has elements with memory, which it does not take yet: "
                    f"{', '.join(model.layout.states[:4])}"
                ),
                limit="laws without memory",
                hint="Replace their laws.",
            )
        )


def check_potential(where: str, model: Model) -> None:
    """Refuse a model with force elements, in functions that need a potential energy. Error:
    NO_POTENTIAL."""
    if model.forces:
        raise JaxbodyError(
            Problem(
                "NO_POTENTIAL",
                f"{where}.model",
                f"has elements without a potential: {', '.join(model.force_names[:4])}",
                limit="elements with a potential energy",
                hint="Leave them out, or use equilibrium, linearize, complex_modes and simulate.",
            )
        )


def check_state(model: Model, state: Any, where: str) -> None:
    """Check that q, v and z have the model's shapes and precision, are finite and have unit
    quaternions; all problems in one error."""
    with Problems() as problems:
        if not isinstance(state, State):
            raise JaxbodyError(
                Problem(
                    "WRONG_KIND",
                    where,
                    f"is {kind_of(state)}",
                    state,
                    "jb.State(q, v)",
                    "Examples are model.reference and equilibrium(model).state.",
                )
            )
        layout = model.layout
        for name, count in (("q", layout.nq), ("v", layout.nv), ("z", layout.nz)):
            value = getattr(state, name)
            if np.shape(value) != (count,):
                if name == "z" and np.shape(value) == (0,):  # states at rest
                    continue
                counts = {block.owner: getattr(block, "n" + name) for block in layout.blocks}
                parts = (
                    ", ".join(f"{owner} {n}" for owner, n in counts.items() if n)
                    or "no element has memory"
                )
                problems.add(
                    "BAD_SHAPE",
                    f"{where}.{name}",
                    f"has shape {np.shape(value)}",
                    value=np.shape(value),
                    limit=f"({count},)",
                    hint=f"Expected ({count},): {parts}.",
                )
                continue
            number, one = getattr(value, "dtype", None), model.gravity.dtype
            if (
                count
                and number in (np.float32, np.float64)
                and jax.dtypes.canonicalize_dtype(number) != one
            ):
                problems.add(
                    "X64_CHANGED",
                    f"{where}.{name}",
                    f"is {number}, the model {one}",
                    value=number,
                    limit="one precision",
                    hint=(
                        f"Give jb.State(numpy.asarray(state.q, '{one}'), "
                        f"numpy.asarray(state.v, '{one}'))."
                    ),
                )
                continue
            known = concrete(value)
            if known is not None and not np.isfinite(known).all():
                problems.add(
                    "NON_FINITE",
                    f"{where}.{name}",
                    f"is {known[~np.isfinite(known)][0]} at index "
                    f"{np.flatnonzero(~np.isfinite(known))[0]}",
                    value=known,
                    limit="finite",
                )
            elif known is not None and name == "q":
                for block in layout.joints:
                    part = known[layout.q_slices[block.owner]][-4:]
                    if block.quaternion and abs(np.linalg.norm(part) - 1) > 1e-3:
                        problems.add(
                            "BAD_QUATERNION",
                            f"{where}.q",
                            f"of '{block.owner}' has a quaternion of length "
                            f"{np.linalg.norm(part):.6g}",
                            value=part,
                            limit="1 within 1e-3",
                        )
