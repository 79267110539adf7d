"""Laws through measured points, from arrays or files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, concrete
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, kind_of, nan_outside
from jaxbody.model.laws.laws import Law, row_of_numbers


class Tabulated(Law):
    """A law that interpolates measured points by monotone cubics (Fritsch, Carlson, SIAM J. Numer.
    Anal. 17 (1980) 238, slopes of Fritsch and Butland): between x_i and x_{i+1}, with
    h = x_{i+1} - x_i and u = (x - x_i)/h,

        F = (1 + 2u)(1 - u)^2 F_i + u^2 (3 - 2u) F_{i+1} + h u (1 - u)^2 m_i - h u^2 (1 - u) m_{i+1}

    U is its exact integral. Beyond the points F continues with the slope at the end, and results
    have the status TABLE_RANGE. It needs at least four points: `x` [m or m/s], increasing, and
    `forces` [N], not decreasing. `Tabulated.read` reads them from a file with units. Errors, all at
    once: TABLE_SHORT, TABLE_UNSORTED, TABLE_DUPLICATE, TABLE_FALLS, BAD_SHAPE, NON_FINITE.

    >>> float(jb.laws.Tabulated([-1, 0, 1, 2], [-10, 0, 10, 40]).force(jnp.array(3.0))) > 70
    True
    """

    x: Float[Array, "n"] = field("argument", "increasing", hint="Sort the points by x.")
    forces: Float[Array, "n"] = field(
        "force", "rising", hint="If the force is meant to decrease, use a Polynomial or a function."
    )

    def __init__(self, x, forces):
        with Problems() as problems:
            self.x, self.forces = (
                row_of_numbers(v, f"Tabulated.{name}", problems)
                for name, v in (("x", x), ("forces", forces))
            )
            _check_table(self.x, self.forces, problems)
        for name in ("x", "forces"):
            if concrete(values := getattr(self, name)) is None:
                setattr(self, name, nan_outside(values, kind_of(self, name).domain, 1))

    @classmethod
    def read(
        cls,
        path,
        *,
        separator: str | None = None,
        decimal: str = ".",
        encoding: str = "utf-8",
        skip: int = 0,
        footer: int = 0,
        largest: float = 1e8,
    ) -> Tabulated:
        """Read the law from a text file of two columns below their names and units, `elongation
        [mm], force [kN]`.

        Args:
            path: path of the file; its lines that start with # are comments. Units: length or angle
                or their rates, then force or moment
            separator: separator between the columns; None: that of the first line of numbers
            decimal: "," for decimal commas
            encoding: encoding of the text
            skip: number of lines to leave out at the start
            footer: number of lines to leave out at the end
            largest: largest size of the file [bytes]

        Errors: those of text files in `read_record`, NO_UNIT, UNKNOWN_UNIT, WRONG_DIMENSION,
        BAD_SHAPE unless there are two columns, and those of the table.
        """
        # with parts of `records`, for the few models that have tables
        from jaxbody.model.laws.curve_files import read_columns

        return cls(
            *read_columns(
                Path(path),
                largest=largest,
                separator=separator,
                decimal=decimal,
                encoding=encoding,
                skip=skip,
                footer=footer,
            )
        )

    def force(self, x):
        u, h, (F0, F1, m0, m1), before, after = self._cell(x)
        inside = (
            (1 + 2 * u) * (1 - u) ** 2 * F0
            + u**2 * (3 - 2 * u) * F1
            + h * u * (1 - u) ** 2 * m0
            - h * u**2 * (1 - u) * m1
        )
        slopes = self._slopes()
        return inside + slopes[0] * before + slopes[-1] * after

    def potential(self, x):
        return self._from_start(x) - self._from_start(jnp.zeros_like(x))

    def beyond(self, x):
        return (x < self.x[0]) | (x > self.x[-1])

    def _from_start(self, x):
        """Return the integral of F from the first point."""
        u, h, (F0, F1, m0, m1), before, after = self._cell(x)
        inside = h * (
            (u - u**3 + u**4 / 2) * F0
            + (u**3 - u**4 / 2) * F1
            + h * (u**2 / 2 - 2 * u**3 / 3 + u**4 / 4) * m0
            - h * (u**3 / 3 - u**4 / 4) * m1
        )
        steps, m = jnp.diff(self.x), self._slopes()
        cells = steps * (self.forces[1:] + self.forces[:-1]) / 2 + steps**2 * (m[:-1] - m[1:]) / 12
        whole = jnp.sum(jnp.where(jnp.arange(len(cells)) < self._index(x), cells, 0.0))
        F_first, F_last = self.forces[0], self.forces[-1]
        return (
            whole
            + inside
            + F_first * before
            + m[0] * before**2 / 2
            + F_last * after
            + m[-1] * after**2 / 2
        )

    def _index(self, x):
        return jnp.clip(jnp.sum(self.x <= jax.lax.stop_gradient(x)) - 1, 0, self.x.shape[0] - 2)

    def _cell(self, x):
        """Return the position u in the cell, its width, forces and slopes at both ends, and the
        distances of x before the first and after the last point."""
        i, m = self._index(x), self._slopes()
        inside = jnp.where(x < self.x[0], self.x[0], jnp.where(x > self.x[-1], self.x[-1], x))
        x_of, F_of = jnp.asarray(self.x), jnp.asarray(self.forces)
        h = x_of[i + 1] - x_of[i]
        before, after = (
            jnp.where(x < self.x[0], x - self.x[0], 0.0),
            jnp.where(x > self.x[-1], x - self.x[-1], 0.0),
        )
        return (inside - x_of[i]) / h, h, (F_of[i], F_of[i + 1], m[i], m[i + 1]), before, after

    def _slopes(self) -> Float[Array, "n"]:
        """Return the slopes at the points: inside, the weighted harmonic mean of the slopes of the
        two chords; at the ends, the slope of the parabola through three points, limited so that the
        curve is monotone."""
        h, d = jnp.diff(self.x), jnp.diff(self.forces) / jnp.diff(self.x)
        rising = d[:-1] * d[1:] > 0
        left, right = jnp.where(rising, d[:-1], 1.0), jnp.where(rising, d[1:], 1.0)
        w1, w2 = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
        inner = jnp.where(rising, (w1 + w2) / (w1 / left + w2 / right), 0.0)
        first = _end_slope(h[0], h[1], d[0], d[1])
        last = _end_slope(h[-1], h[-2], d[-1], d[-2])
        return jnp.concatenate([first[None], inner, last[None]])


def _end_slope(h0, h1, d0, d1):
    m = ((2 * h0 + h1) * d0 - h0 * d1) / (h0 + h1)
    bounded = jnp.where((jnp.sign(d0) != jnp.sign(d1)) & (jnp.abs(m) > 3 * jnp.abs(d0)), 3 * d0, m)
    return jnp.where(jnp.sign(m) != jnp.sign(d0), 0.0, bounded)


def has_range(tree: Any) -> bool:
    """Return whether the tree holds a law with a limited range."""
    return any(
        isinstance(leaf, Tabulated)
        for leaf in jax.tree.leaves(tree, is_leaf=lambda x: isinstance(x, Tabulated))
    )


def _check_table(x: Any, forces: Any, problems: Problems) -> None:
    x, F = concrete(x), concrete(forces)
    if problems.collected or x is None or F is None:
        return
    if len(x) != len(F):
        problems.add(
            "BAD_SHAPE",
            "Tabulated.forces",
            f"has {len(F)} numbers for {len(x)} of x",
            value=len(F),
            limit=f"{len(x)}",
        )
        return
    if len(x) < 4:
        problems.add(
            "TABLE_SHORT",
            "Tabulated.x",
            f"has {len(x)} points",
            value=len(x),
            limit="at least 4",
            hint="Measure more points.",
        )
    steps, rises = np.diff(x), np.diff(F)
    for code, bad, verb, hint in (
        ("TABLE_DUPLICATE", steps == 0, "repeats", "Keep one force for each x, such as the mean."),
        ("TABLE_UNSORTED", steps < 0, "goes back", "Sort the points by x."),
    ):
        if bad.any():
            i = int(np.flatnonzero(bad)[0])
            problems.add(
                code,
                "Tabulated.x",
                f"{verb} at index {i + 1}: {x[i]:g}, then {x[i + 1]:g}",
                value=i + 1,
                limit="increasing",
                hint=hint,
            )
    if (steps > 0).all() and (rises < 0).any():
        i = int(np.flatnonzero(rises < 0)[0])
        problems.add(
            "TABLE_FALLS",
            "Tabulated.forces",
            f"falls from {F[i]:g} to {F[i + 1]:g} N between x = {x[i]:g} and {x[i + 1]:g}",
            value=i + 1,
            limit="not falling",
            hint=(
                "Is tension positive? Smooth a noisy record; if the force is meant to decrease, "
                "use a Polynomial or a function."
            ),
        )
