"""Comparison of modes by the modal assurance criterion (MAC), and tracking of modes along a
parameter, including through crossings.

MAC_ij = |x_i* W y_j|^2/((x_i* W x_i) (y_j* W y_j)),   1 for the same shape, 0 for shapes that are
                                                       orthogonal in W
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, Inexact, Int, float_array, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem, Status
from jaxbody.core.results import Labeled, Result, dataset, warn_if_failed
from jaxbody.model.layouts import Layout
from jaxbody.numerics.eigenproblems import together
from jaxbody.vibration.damped_modes import ComplexModes, complex_modes
from jaxbody.vibration.linearizations import Linearization
from jaxbody.vibration.mode_names import mark_note
from jaxbody.vibration.natural_modes import Modes, modes
from jaxbody.vibration.spins import SpinLinearization

LEAST_MAC = 0.8  # MAC below which a mode may not be that at the previous value


class Branches(Labeled, Result):
    """Modes tracked along a parameter, each column one mode; their frequencies ascend at the first
    of the `values` of the parameter.

    `frequency` [Hz] (damped about a spin), `damping_ratio`, `shapes` (value, coordinate, mode),
    `order`: the index of each among the ascending modes, `mac` of each with the same mode at the
    previous value, `names` of the modes at the first value. `status` of each value: LOST_BRANCH
    where a MAC is below 0.8 (give values in between); otherwise that of its modes."""

    index = "value"
    values: Float[Array, "k"]
    frequency: Float[Array, "k n"]
    damping_ratio: Float[Array, "k n"]
    shapes: Inexact[Array, "k nv n"]
    order: Int[Array, "k n"]
    mac: Float[Array, "k n"]
    status: Int[Array, "k"]
    first: Modes | ComplexModes

    @property
    def layout(self) -> Layout:
        return self.first.layout

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the modes at the first value, from the body and direction with most of their
        kinetic energy."""
        return self.first.names

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: frequency, damping ratio, MAC and shape by value and mode."""
        return dataset(
            {
                "frequency": (("value", "mode"), self.frequency, "Hz"),
                "damping_ratio": (("value", "mode"), self.damping_ratio, ""),
                "mac": (("value", "mode"), self.mac, ""),
                "order": (("value", "mode"), self.order, ""),
                "shape": (("value", "coordinate", "mode"), self.shapes, "mass-normalized"),
                "status": (("value",), self.status, ""),
            },
            {
                "value": np.asarray(self.values),
                "mode": list(range(1, 1 + np.shape(self.frequency)[-1])),
                "coordinate": list(self.layout.with_mass),
            },
            "branches",
        )

    @tables.summarized("Branches", 2, frequency="frequency [Hz]")
    def _tables(self) -> list[tables.PrintedTable]:
        n = self.frequency.shape[-1]
        if n > 12:
            return [tables.PrintedTable("Branches", ("", ""), [("frequency [Hz]", self.frequency)])]
        heads = ("value", *(f"{i + 1} [Hz]" for i in range(n)), "least MAC")
        rows = [
            (tables.number(x), *f, m.min())
            for x, f, m in zip(self.values, self.frequency, self.mac, strict=True)
        ]
        names = "; ".join(f"{i + 1}: {name}" for i, name in enumerate(self.names))
        notes = [self.report(), f"at the first value {names}", mark_note(self.names)]
        return [tables.PrintedTable("Branches", heads, rows, "; ".join(filter(None, notes)))]


def mac(
    one: Modes | ComplexModes | Any, other: Modes | ComplexModes | Any, *, mass: Any = None
) -> Float[Array, "n m"]:
    """Compute the modal assurance criterion of every mode of one set with every mode of another:
    results of `modes`, `complex_modes`, or arrays of columns.

        MAC_ij = |x_i* W y_j|^2/((x_i* W x_i) (y_j* W y_j))

    With W = `mass`, for example lin.M, displacements and rotations are weighted by their energy and
    natural modes are orthogonal; by default W = 1, which depends on units if shapes have both.
    Errors: BAD_SHAPE. Source: R. J. Allemang, Sound and Vibration 37 (2003) 14.

    >>> jb.vibration.mac([[1.0, 0.0], [0.0, 1.0]], [[1.0, 1.0], [0.0, 1.0]]).round(12).tolist()
    [[1.0, 0.5], [0.0, 0.5]]
    """
    X, Y = (
        x.shapes if isinstance(x, Modes | ComplexModes) else jnp.asarray(x) for x in (one, other)
    )
    if X.ndim != 2 or Y.ndim != 2 or X.shape[0] != Y.shape[0]:
        raise JaxbodyError(
            Problem(
                "BAD_SHAPE",
                "mac",
                f"has shapes {X.shape} and {Y.shape}",
                (X.shape, Y.shape),
                "(nv, n) and (nv, m)",
                "Give a column for each mode and a row for each coordinate, the same in both.",
            )
        )
    W = jnp.eye(len(X)) if mass is None else jnp.asarray(mass)
    if W.shape != (len(X), len(X)):
        raise JaxbodyError(
            Problem(
                "BAD_SHAPE",
                "mac.mass",
                f"has shape {W.shape}",
                W.shape,
                f"({len(X)}, {len(X)})",
                "Give lin.M.",
            )
        )
    return _mac(X, Y, W)


@program
def _mac(X: Array, Y: Array, W: Float[Array, "nv nv"]) -> Float[Array, "n m"]:
    def norm(Z):
        return jnp.sum(jnp.conj(Z) * (W.astype(Z.dtype) @ Z), 0).real

    return jnp.abs(jnp.conj(X).T @ (W.astype(Y.dtype) @ Y)) ** 2 / (
        norm(X)[:, None] * norm(Y)[None]
    )


def track_modes(
    linearized: Callable[[Any], Linearization | SpinLinearization], values: Any
) -> Branches:
    """Follow modes along a parameter by their shapes; `linearized(value)` returns the linearization
    at each of `values`.

    From each value to the next, modes are matched by their MAC in M, beginning with the best pair.
    Where frequencies coincide, the space of their shapes is matched and the previous shapes are
    kept, so that crossings are followed and veerings are not mistaken for crossings. About a steady
    spin, and with force elements, the modes are those of `complex_modes`. The result is
    differentiable where single modes are. Errors: BAD_SHAPE, NON_FINITE for values; warns
    LOST_BRANCH.

    >>> car = jb.presets.half_car()
    >>> def linearized(stiffness):
    ...     model = jb.replace(car, {"front spring.stiffness": stiffness})
    ...     return jb.linearize(model, jb.equilibrium(model))
    >>> jb.vibration.track_modes(linearized, [1.8e4, 2.2e4, 2.6e4]).order.tolist()
    [[0, 1], [0, 1], [0, 1]]
    """
    given = float_array(values, "track_modes.values")
    if given.ndim != 1 or not given.size:
        raise JaxbodyError(
            Problem(
                "BAD_SHAPE",
                "track_modes.values",
                f"has shape {given.shape}",
                given.shape,
                "(k,)",
                "Give a list of values.",
            )
        )
    if is_concrete(given) and not np.isfinite(given).all():
        raise JaxbodyError(
            Problem(
                "NON_FINITE",
                "track_modes.values",
                "has values that are not finite",
                given,
                "finite",
                "Give finite values.",
            )
        )

    def one(value):
        lin = linearized(value)
        M = lin.M[: lin.nv, : lin.nv]
        if isinstance(lin, SpinLinearization) or lin.model.forces:
            return complex_modes(lin), M
        return modes(lin), M

    given = jnp.asarray(given)
    return warn_if_failed(_track(given, *eqx.filter_vmap(one)(given)))


@program
def _track(
    values: Float[Array, "k"], at_values: Modes | ComplexModes, M: Float[Array, "k nv nv"]
) -> Branches:
    n = at_values.frequency.shape[1]
    frozen = jax.lax.stop_gradient((at_values.shapes, M))
    if at_values.model.closures:  # M is in the independent coordinates
        layout = at_values.model.layout
        own = np.append(
            np.array(at_values.model.independent, int), np.arange(layout.nv, len(layout.with_mass))
        )
        frozen = frozen[0][:, own], frozen[1]

    def step(carry, given):
        """Match the modes at the next value to reference shapes; references of one cluster have
        equal labels."""
        reference, label = carry
        shapes, M, cluster = given
        at_value, at_reference = together(cluster), together(label)
        both = _mac(reference, shapes, M)
        in_spaces = at_reference.astype(both.dtype) @ both @ at_value.astype(both.dtype)
        best = in_spaces / jnp.minimum(
            jnp.sum(at_reference, 1)[:, None], jnp.sum(at_value, 0)[None]
        ).astype(both.dtype)
        order = _matched(best)
        shared = jnp.sum(at_value, 0)[order] > 1
        amounts = (
            jnp.conj(shapes).T
            @ (M.astype(reference.dtype) @ reference)
            * at_value[:, order].astype(shapes.dtype)
        )  # coordinates of the reference in its matching space
        projected = shapes @ amounts
        squares = jnp.conj(projected) * (M.astype(projected.dtype) @ projected)
        size = jnp.sqrt(jnp.sum(squares, 0, keepdims=True).real)
        projected = projected / size.astype(projected.dtype)
        label = jnp.where(shared, label, n + jnp.arange(n))
        return (jnp.where(shared, projected, shapes[:, order]), label), (
            order,
            best[jnp.arange(n), order],
        )

    given = (*frozen, at_values.cluster)
    _, (order, quality) = jax.lax.scan(step, (frozen[0][0], at_values.cluster[0]), given)

    def along(x):
        return jnp.take_along_axis(x, order, axis=1)

    lost_branch = jnp.any(quality < LEAST_MAC, axis=1)
    status = jnp.where(
        (at_values.status == Status.OK) & lost_branch, Status.LOST_BRANCH.value, at_values.status
    )
    shapes = jnp.take_along_axis(at_values.shapes, order[:, None], axis=2)
    first = jax.tree.map(lambda x: x[0] if eqx.is_array(x) else x, at_values)
    return Branches(
        values,
        along(at_values.frequency),
        along(at_values.damping_ratio),
        shapes,
        order,
        quality,
        status,
        first,
    )


def _matched(score: Float[Array, "n n"]) -> Int[Array, "n"]:
    """Return the column matched to each row, the largest score first."""
    n = len(score)

    def choose(_, carry):
        order, remaining = carry
        row, column = jnp.divmod(jnp.argmax(remaining), n)
        return order.at[row].set(column), remaining.at[row].set(-1.0).at[:, column].set(-1.0)

    return jax.lax.fori_loop(0, n, choose, (jnp.zeros(n, int), score))[0]
