"""Natural frequencies and modes of small motions: K phi = w^2 M phi."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from equinox import field, filter_jit
from jaxtyping import Array, Float, Int

from jaxbody import tables
from jaxbody.checks import check_precision
from jaxbody.errors import Status, is_concrete
from jaxbody.linearizations import Linearization
from jaxbody.models import Layout
from jaxbody.results import Result, warn_if_failed

ZERO = 1e-10  # eigenvalues, relative to the largest, that count as zero
SYMMETRIC = 1e-8  # largest K - K' relative to the largest K, below which it is round-off
CLUSTERED = 1e-6  # relative distance of squared frequencies below which branches cannot be told apart


class Modes(Result):
    """Natural modes, ascending: `frequency` [Hz], `shapes` (columns, phi' M phi = 1, largest component positive), `damping_ratio`, `eigenvalues` w^2
    [rad2/s2], and `cluster`, equal numbers for frequencies that coincide: their branches have no derivatives of their own, only
    sums over the cluster do. A negative eigenvalue has frequency NaN and status UNSTABLE, a zero one 0 and SINGULAR_K."""

    frequency: Float[Array, "nv"]
    shapes: Float[Array, "nv nv"]
    damping_ratio: Float[Array, "nv"]
    eigenvalues: Float[Array, "nv"]
    cluster: Int[Array, "nv"]
    status: Int[Array, ""]
    layout: Layout = field(static=True)

    def explain(self) -> str:
        status = Status(int(self.status))
        if status == Status.UNSTABLE:
            return f"{int(jnp.sum(jnp.isnan(self.frequency)))} mode(s) grow instead of oscillating"
        if status == Status.SINGULAR_K:
            return f"{int(jnp.sum(self.frequency == 0))} mode(s) of zero frequency"
        return ""

    def to_xarray(self) -> Any:
        """An xarray.Dataset: frequency, damping ratio and shape by mode and named coordinate."""
        from jaxbody.exports import modes_dataset

        return modes_dataset(self)

    def _tables(self) -> list[tables.Table]:
        if self.frequency.ndim > 1 or not is_concrete(self.frequency):
            return [tables.Table("Modes", ("", ""), [("frequency [Hz]", self.frequency)])]
        largest = [self.layout.coordinates[int(i)] for i in jnp.argmax(jnp.abs(self.shapes), axis=0)]
        shared = [int(jnp.sum(self.cluster == c)) > 1 for c in self.cluster]
        rows = [
            (str(i + 1), f, z, name + (" (coincides)" if together else ""))
            for i, (f, z, name, together) in enumerate(zip(self.frequency, self.damping_ratio, largest, shared, strict=True))
        ]
        return [
            tables.Table(
                "Modes",
                ("mode", "frequency [Hz]", "damping ratio", "largest component"),
                rows,
                "" if int(self.status) == 0 else self.report(),
            )
        ]


def modes(lin: Linearization, *, allow_float32: bool = False) -> Modes:
    """Natural frequencies, mass-normalized shapes and damping ratios of small motions.

        K phi = w^2 M phi,   frequency = w/(2 pi),   damping ratio = phi' C phi/(2 w)

    The damping ratio is exact where C is diagonal in the modes and right to first order in C otherwise. Errors: FLOAT32 unless `allow_float32`; warns UNSTABLE, SINGULAR_K.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, joints={"mass": Guide("world", axis=[0, 1, 0])},
    ...               elements={"s": Spring(("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=50.0, free_length=1.0, damping=2.0)})
    >>> found = modes(linearize(model, equilibrium(model)))
    >>> round(float(found.frequency[0]), 6), round(float(found.damping_ratio[0]), 6)
    (0.795775, 0.1)
    """
    check_precision("modes", lin.model, needs_float64=not allow_float32)
    result = _modes(lin)
    warn_if_failed(result)
    return result


@filter_jit
def _modes(lin: Linearization) -> Modes:
    M, K = (lin.M + lin.M.T) / 2, (lin.K + lin.K.T) / 2
    L = jnp.linalg.cholesky(M)
    half = jax.scipy.linalg.solve_triangular(L, K, lower=True)
    A = jax.scipy.linalg.solve_triangular(L, half.T, lower=True)
    values, vectors = jnp.linalg.eigh((A + A.T) / 2)
    shapes = jax.scipy.linalg.solve_triangular(L, vectors, lower=True, trans=1)
    largest = jnp.take_along_axis(shapes, jnp.argmax(jnp.abs(shapes), axis=0)[None], 0)
    shapes = shapes * jnp.where(largest < 0, -1.0, 1.0)
    top = jnp.max(jnp.abs(values), initial=0.0)
    positive, negative = values > ZERO * top, values < -ZERO * top
    w = jnp.sqrt(jnp.where(positive, values, 1.0))
    frequency = jnp.where(positive, w / (2 * jnp.pi), jnp.where(negative, jnp.nan, 0.0))
    damping = jnp.where(positive, jnp.sum(shapes * (lin.C @ shapes), 0) / (2 * w), jnp.nan)
    apart = jnp.concatenate([jnp.zeros(1, bool), jnp.diff(values) > CLUSTERED * jnp.abs(values[1:]) + ZERO * top])
    here = jnp.select([negative.any(), (~positive).any()], [Status.UNSTABLE.value, Status.SINGULAR_K.value], Status.OK.value)
    skew = jnp.max(jnp.abs(lin.K - lin.K.T), initial=0.0) > SYMMETRIC * jnp.max(jnp.abs(lin.K), initial=0.0)
    frequency = jnp.where(skew, jnp.nan, frequency)
    here = jnp.where(skew, Status.NOT_SYMMETRIC.value, here)
    failed = jnp.isin(lin.status, jnp.array([Status.NOT_CONVERGED, Status.NO_EQUILIBRIUM, Status.LIMIT_POINT]))
    status = jnp.where(failed, lin.status, here)
    return Modes(frequency, shapes, damping, values, jnp.cumsum(apart), status, lin.model.layout)
