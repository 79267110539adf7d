"""Modes compared, by the modal assurance criterion, and followed along a parameter, through crossings.

MAC_ij = |x_i* W y_j|^2/((x_i* W x_i) (y_j* W y_j)),   1 for the same shape, 0 for shapes that are orthogonal in W
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbody.core import tables
from jaxbody.core.arrays import concrete, float_array
from jaxbody.core.compile_options import jit_unoptimized
from jaxbody.core.datasets import dataset
from jaxbody.core.errors import JaxbodyError, Problem, Status, is_concrete
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.models.layouts import Layout
from jaxbody.numerics.eigenproblems import together
from jaxbody.vibrations.damped_modes import ComplexModes, complex_modes
from jaxbody.vibrations.linearizations import Linearization
from jaxbody.vibrations.mode_names import mark_note
from jaxbody.vibrations.natural_modes import Modes, modes
from jaxbody.vibrations.spins import SpinLinearization

LEAST_MAC = 0.8  # below it a mode may be another than at the value before


class Branches(Result):
    """Modes along a parameter, each column one mode followed from the first value, where they ascend.

    `frequency` [Hz] (damped ones about a spin), `damping_ratio`, `shapes` (value, coordinate, mode), `order`: which of the ascending modes each is, `mac` of each with
    itself at the value before. `names`: of the modes at the first value. `status` of each value: LOST_BRANCH where one is below 0.8: give values in between; else that of its modes."""

    values: Float[Array, "k"]
    frequency: Float[Array, "k n"]
    damping_ratio: Float[Array, "k n"]
    shapes: Float[Array, "k nv n"]
    order: Int[Array, "k n"]
    mac: Float[Array, "k n"]
    status: Int[Array, "k"]
    first: Modes | ComplexModes

    @property
    def layout(self) -> Layout:
        return self.first.layout

    @property
    def names(self) -> tuple[str, ...]:
        """Of the modes at the first value, by what has most of their kinetic energy there."""
        return self.first.names

    def to_xarray(self) -> Any:
        """An xarray.Dataset: frequency, damping ratio, MAC and shape by value and mode."""
        variables = {
            "frequency": (("value", "mode"), self.frequency, "Hz"),
            "damping_ratio": (("value", "mode"), self.damping_ratio, ""),
            "mac": (("value", "mode"), self.mac, ""),
            "order": (("value", "mode"), self.order, ""),
            "shape": (("value", "coordinate", "mode"), self.shapes, "mass-normalized"),
            "status": (("value",), self.status, ""),
        }
        count = np.shape(self.frequency)[-1]
        coordinates = {"value": np.asarray(self.values), "mode": list(range(1, count + 1)), "coordinate": list(self.layout.coordinates)}
        return dataset(variables, coordinates, "branches")

    def _tables(self) -> list[tables.PrintedTable]:
        if self.frequency.ndim > 2 or not is_concrete(self.frequency) or self.frequency.shape[1] > 12:
            return [tables.PrintedTable("Branches", ("", ""), [("frequency [Hz]", self.frequency)])]
        heads = ("value", *(f"{i + 1} [Hz]" for i in range(self.frequency.shape[1])), "least MAC")
        rows = [(tables.number(x), *f, m.min()) for x, f, m in zip(*map(np.asarray, (self.values, self.frequency, self.mac)), strict=True)]
        named = f"at the first value {'; '.join(f'{i + 1}: {name}' for i, name in enumerate(self.names))}"
        return [tables.PrintedTable("Branches", heads, rows, "; ".join(filter(None, [self.report(), named, mark_note(self.names)])))]


def mac(one: Modes | ComplexModes | Any, other: Modes | ComplexModes | Any, *, mass: Any = None) -> Float[Array, "n m"]:
    """The modal assurance criterion of every mode of one set with every one of another (results of `modes`, `complex_modes`, or arrays with a column for each).

        MAC_ij = |x_i* W y_j|^2/((x_i* W x_i) (y_j* W y_j))

    With W = `mass`, lin.M, displacements and rotations weigh by their energy and natural modes are orthogonal; without it W = 1, which depends on units where
    shapes hold both. Errors: BAD_SHAPE. Source: R. J. Allemang, Sound and Vibration 37 (2003) 14.

    >>> mac([[1.0, 0.0], [0.0, 1.0]], [[1.0, 1.0], [0.0, 1.0]]).round(12).tolist()
    [[1.0, 0.5], [0.0, 0.5]]
    """
    X, Y = (x.shapes if isinstance(x, Modes | ComplexModes) else jnp.asarray(x) for x in (one, other))
    if X.ndim != 2 or Y.ndim != 2 or X.shape[0] != Y.shape[0]:
        hint = "Give a column for each mode and a row for each coordinate, the same in both."
        raise JaxbodyError(
            Problem("BAD_SHAPE", "mac", f"has shapes {X.shape} and {Y.shape}", (X.shape, Y.shape), "(nv, n) and (nv, m)", hint)
        )
    W = jnp.eye(len(X)) if mass is None else jnp.asarray(mass)
    if W.shape != (len(X), len(X)):
        raise JaxbodyError(Problem("BAD_SHAPE", "mac.mass", f"has shape {W.shape}", W.shape, f"({len(X)}, {len(X)})", "Give lin.M."))
    return _mac(X, Y, W)


@jit_unoptimized
def _mac(X: Array, Y: Array, W: Float[Array, "nv nv"]) -> Float[Array, "n m"]:
    def norm(Z):
        return jnp.sum(jnp.conj(Z) * (W @ Z), 0).real

    return jnp.abs(jnp.conj(X).T @ (W @ Y)) ** 2 / (norm(X)[:, None] * norm(Y))


def track(linearized: Callable[[Any], Linearization | SpinLinearization], values: Any) -> Branches:
    """Frequencies of modes along a parameter, each mode followed by its shape: `linearized(value)` gives the linearization at each of `values`.

    From one value to the next modes are matched by their MAC in M, the best pair first. Where frequencies coincide only their space counts, and what a mode was
    before is kept, so that crossings are followed and veerings seen as such. About a steady spin the modes are those of `complex_modes`. Differentiable where
    single modes are. Errors: BAD_SHAPE, NON_FINITE of values; warns LOST_BRANCH.

    >>> car = jb.presets.half_car()
    >>> def linearized(stiffness):
    ...     model = replace(car, {"front spring.stiffness": stiffness})
    ...     return linearize(model, equilibrium(model))
    >>> track(linearized, [1.8e4, 2.2e4, 2.6e4]).order.tolist()
    [[0, 1], [0, 1], [0, 1]]
    """
    given = float_array(values, "track.values")
    known = concrete(given)
    if given.ndim != 1 or not given.size:
        raise JaxbodyError(Problem("BAD_SHAPE", "track.values", f"has shape {given.shape}", given.shape, "(k,)", "Give a list of values."))
    if known is not None and not np.isfinite(known).all():
        raise JaxbodyError(Problem("NON_FINITE", "track.values", "holds what is not finite", known, "finite", "Give finite values."))

    def one(value):
        lin = linearized(value)
        found = complex_modes(lin) if isinstance(lin, SpinLinearization) else modes(lin)
        return found, lin.M

    found, M = eqx.filter_vmap(one)(jnp.asarray(given))
    result = _track(jnp.asarray(given), found, M)
    warn_if_failed(result)
    return result


@jit_unoptimized
def _track(values: Float[Array, "k"], found: Modes | ComplexModes, M: Float[Array, "k nv nv"]) -> Branches:
    n = found.frequency.shape[1]
    frozen = jax.lax.stop_gradient((found.shapes, M))

    def step(carry, given):
        """Reference shapes and labels (alike for references that cannot be told apart) to those at the next value."""
        reference, label = carry
        shapes, M, cluster = given
        theirs, ours = together(cluster), together(label)
        both = _mac(reference, shapes, M)
        in_spaces = ours.astype(both.dtype) @ both @ theirs.astype(both.dtype)
        best = in_spaces / jnp.minimum(jnp.sum(ours, 1)[:, None], jnp.sum(theirs, 0))
        order = _matched(best)
        chosen = shapes[:, order]
        shared = jnp.sum(theirs, 0)[order] > 1
        amounts = jnp.conj(shapes).T @ (M @ reference) * theirs[:, order]  # the reference in the space that it is matched with
        kept = shapes @ amounts
        kept = kept / jnp.sqrt(jnp.sum(jnp.conj(kept) * (M @ kept), 0).real)
        label = jnp.where(shared, label, n + jnp.arange(n))
        return (jnp.where(shared, kept, chosen), label), (order, best[jnp.arange(n), order])

    start = (frozen[0][0], found.cluster[0])
    _, (order, quality) = jax.lax.scan(step, start, (*frozen, found.cluster))

    def along(x):
        return jnp.take_along_axis(x, order, axis=1)

    lost = jnp.any(quality < LEAST_MAC, axis=1)
    status = jnp.where((found.status == Status.OK) & lost, Status.LOST_BRANCH.value, found.status)
    shapes = jnp.take_along_axis(found.shapes, order[:, None], axis=2)
    first = jax.tree.map(lambda x: x[0] if eqx.is_array(x) else x, found)
    return Branches(values, along(found.frequency), along(found.damping_ratio), shapes, order, quality, status, first)


def _matched(score: Float[Array, "n n"]) -> Int[Array, "n"]:
    """For each row its column, the largest score first."""
    n = len(score)

    def choose(_, carry):
        order, left = carry
        row, column = jnp.divmod(jnp.argmax(left), n)
        return order.at[row].set(column), left.at[row].set(-1.0).at[:, column].set(-1.0)

    return jax.lax.fori_loop(0, n, choose, (jnp.zeros(n, int), score))[0]
