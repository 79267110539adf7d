"""Natural frequencies and modes of small motions, K phi = w^2 M phi, and modal damping: a damping
ratio for each mode, which damps the motion relative to the quasi-static response to the supports.

With phi' M phi = 1 and x = Delta - K^-1 K~ Xi, each mode dissipates the power
2 zeta w (phi' M x')^2, which adds to C, C~ and C_bb

    M phi (2 zeta w) phi' M,    M phi (2 zeta/w) phi' K~,    K~' phi (2 zeta/w^3) phi' K~

summed over the modes of positive frequency. Source: A. K. Chopra, Dynamics of Structures
(2012), 11.4.
"""

import dataclasses
from abc import abstractmethod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import (
    Array,
    Float,
    Inexact,
    Int,
    checked,
    device_array,
    is_concrete,
)
from jaxbody.core.compilation.compile_options import OPTIMIZED, program, program_with
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status
from jaxbody.core.results import Labeled, Result, dataset, warn_if_failed
from jaxbody.mechanics.failure_causes import massless_motions
from jaxbody.model.layouts import Layout
from jaxbody.model.models import Model
from jaxbody.numerics.eigenproblems import (
    ZERO,
    averaged,
    clusters,
    natural,
    refused_in_clusters,
    together,
)
from jaxbody.numerics.lanes import in_lanes
from jaxbody.numerics.precisions import reachable
from jaxbody.vibration.linearizations import Linearization, check_system
from jaxbody.vibration.mode_names import Basis, mark_note, names_of_shapes

STIFFNESSES = ("relaxed", "instantaneous")
SYMMETRIC = 1e-8  # largest K - K' relative to the largest K, below which it is round-off


class ModalResult(Labeled, Result):
    """The base class of natural and complex modes: `shapes` (columns) in the coordinates of the
    model and those of elements with mass, `M` the mass matrix of the linear system."""

    index = "mode"
    frequency: Float[Array, "n"]
    damping_ratio: Float[Array, "n"]
    shapes: Inexact[Array, "nv n"]
    cluster: Int[Array, "n"]
    status: Int[Array, ""]
    M: Float[Array, "nf nf"]
    model: Model
    basis: Basis

    @property
    def layout(self) -> Layout:
        return self.model.layout

    @property
    def names(self) -> tuple[str, ...]:
        """Each mode by the body and direction with most of its kinetic energy (of complex modes the
        mean over a period), or several bodies that share it, or the coordinate of an element with
        mass, as in `mode_energies`."""
        return names_of_shapes(
            self.model, self.basis, self.M, self.shapes, self.cluster, self.roots()
        )

    @abstractmethod
    def roots(self) -> np.ndarray:
        """Return the frequency or pole of each mode."""

    @abstractmethod
    def growing_and_still(self) -> tuple[np.ndarray, np.ndarray]:
        """Return which modes grow, and which have zero frequency."""

    def explain(self) -> str:
        status, (growing, still) = Status(int(self.status)), self.growing_and_still()
        if status == Status.NOT_SYMMETRIC:
            return "use complex_modes (in commands --damped)"
        if status == Status.SINGULAR_M:
            return "; ".join(massless_motions(self.layout, self.M, self.model.independent))
        marked = {
            Status.UNSTABLE: (growing, "growing motion"),
            Status.SINGULAR_K: (still, "zero frequency"),
        }.get(status)
        return f"{tables.counted(int(marked[0].sum()), 'mode')} of {marked[1]}" if marked else ""

    def labeled(self, kind: str, **own: tuple[tuple[str, ...], Any, str]) -> Any:
        """Return a dataset of the variables of all modal results, and of the class's `own`
        variables."""
        return dataset(
            {
                "frequency": (("mode",), self.frequency, "Hz"),
                "damping_ratio": (("mode",), self.damping_ratio, ""),
                "shape": (("coordinate", "mode"), self.shapes, "mass-normalized"),
                "cluster": (("mode",), self.cluster, ""),
                "status": ((), self.status, ""),
                **own,
            },
            {
                "mode": list(range(1, 1 + np.shape(self.frequency)[-1])),
                "coordinate": list(self.layout.with_mass),
            },
            kind,
        )

    def table(self, title: str, columns: dict[str, Any]) -> list[tables.PrintedTable]:
        """Return a table with a row for each mode: its number, these columns, and its name."""
        names = self.names
        rows = [
            (str(i + 1), *row) for i, row in enumerate(zip(*columns.values(), names, strict=True))
        ]
        note = "; ".join(filter(None, [self.failure, mark_note(names)]))
        return [tables.PrintedTable(title, ("mode", *columns, "most energy in"), rows, note)]


class Modes(ModalResult):
    """Natural modes, by ascending frequency: `frequency` [Hz], `shapes` (columns, phi' M phi = 1,
    largest component positive), `damping_ratio`, `eigenvalues` w^2 [rad2/s2], `cluster`, equal
    numbers for coinciding frequencies, and `names`, by the body and direction with most kinetic
    energy. For a negative eigenvalue the frequency is NaN and the status UNSTABLE; for a zero
    eigenvalue the frequency is 0 and the status SINGULAR_K. All are NaN where a coordinate has no
    inertia (SINGULAR_M; `M` is the mass matrix) or a matrix is not finite (NONFINITE).

    Of modes of coinciding frequencies only the space of their shapes is unique: `shapes` are a
    basis of it, and each mode has the mean of the damping ratios. A single frequency of a cluster
    has one-sided derivatives: `jax.jvp` and `jacfwd` give the one in the requested direction,
    `jax.grad` gives NaN, as for functions of a single shape. Sums over a cluster and functions of
    its space have derivatives in both modes; second derivatives exist for single modes."""

    eigenvalues: Float[Array, "n"]

    def roots(self):
        return np.asarray(self.frequency)

    def growing_and_still(self):
        return np.isnan(self.frequency), np.asarray(self.frequency) == 0

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: frequency, damping ratio and shape by mode and named
        coordinate."""
        return self.labeled("modes", eigenvalue=(("mode",), self.eigenvalues, "rad2/s2"))

    @tables.summarized("Modes", 1, frequency="frequency [Hz]")
    def _tables(self) -> list[tables.PrintedTable]:
        return self.table(
            "Modes",
            {
                "frequency [Hz]": self.frequency,
                "damping ratio": tables.without_dust(self.damping_ratio, 1.0),
            },
        )


def modes(lin: Linearization, *, stiffness: str = "relaxed", allow_float32: bool = False) -> Modes:
    """Compute natural frequencies, mass-normalized shapes and damping ratios of small motions.

        K phi = w^2 M phi,   frequency = w/(2 pi),   damping ratio = phi' C phi/(2 w)

    The damping ratio is exact where C is diagonal in the modes, otherwise accurate to first order
    in C.

    Args:
        stiffness: stiffness of elements with memory, "relaxed" (default): their massless
            coordinates follow slow motions, or "instantaneous": they are held, as in motions much
            faster than their relaxation; `complex_modes` needs neither assumption
        allow_float32: True to compute in float32; by default that is an error

    Errors: FLOAT32 unless `allow_float32`, BAD_OPTION; warns UNSTABLE, SINGULAR_K,
    SINGULAR_M, NONFINITE.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     elements={
    ...         "s": jb.Spring(
    ...             ("mass", [0, 0, 0]),
    ...             ("world", [0, 1, 0]),
    ...             stiffness=50.0,
    ...             free_length=1.0,
    ...             damping=2.0,
    ...         )
    ...     },
    ... )
    >>> natural = jb.modes(jb.linearize(model, jb.equilibrium(model)))
    >>> round(float(natural.frequency[0]), 6), round(float(natural.damping_ratio[0]), 6)
    (0.795775, 0.1)
    """
    check_system(lin, "modes", allow_float32=allow_float32)
    return warn_if_failed(_modes(without_inner_rows(lin, stiffness, "modes")))


def without_inner_rows(lin: Linearization, stiffness: str, where: str) -> Linearization:
    """Return the system in which elements with memory are relaxed or held. Error: BAD_OPTION."""
    if stiffness not in STIFFNESSES:
        raise JaxbodyError(
            Problem(
                "BAD_OPTION",
                f"{where}.stiffness",
                f"is {stiffness!r}",
                stiffness,
                " or ".join(map(repr, STIFFNESSES)),
            )
        )
    return lin.condensed if stiffness == "relaxed" else lin.instantaneous


@program
def _modes(lin: Linearization) -> Modes:
    frequency, shapes, damping_ratio, eigenvalues, cluster, status = modes_of(lin)
    shapes = lin.expanded(refused_in_clusters(shapes, cluster))
    if lin.dependent is not None:  # make the largest of all coordinates positive
        shapes = shapes * jnp.sign(
            jnp.take_along_axis(shapes, jnp.argmax(jnp.abs(shapes), 0)[None], 0)
        )
    return Modes(
        frequency, damping_ratio, shapes, cluster, status, lin.M, lin.model, lin.basis, eigenvalues
    )


@program
def modes_of(lin: Linearization) -> tuple[Array, ...]:
    """Return frequency, shapes, damping ratio, eigenvalues, cluster and status. The stiffness of
    elements with memory is the relaxed one, unless the system has no rows for them."""
    lin = lin.condensed
    values, shapes = natural(lin.K, lin.M)
    cluster = clusters(values)
    largest = jnp.max(jnp.abs(values), initial=0.0)
    zero = reachable(ZERO, values.dtype) * largest
    positive, negative = values > zero, values < -zero
    w = jnp.sqrt(jnp.where(positive, values, 1.0))
    finite, massless = jnp.isfinite(lin.M).all() & jnp.isfinite(lin.K).all(), jnp.isnan(values)
    frequency = jnp.where(positive, w / (2 * jnp.pi), jnp.where(negative | massless, jnp.nan, 0.0))
    damping = jnp.where(
        positive, averaged(jnp.sum(shapes * (lin.C @ shapes), 0), cluster) / (2 * w), jnp.nan
    )
    status = jnp.select(
        [~finite, massless.any(), negative.any(), (~positive).any()],
        [
            Status.NONFINITE.value,
            Status.SINGULAR_M.value,
            Status.UNSTABLE.value,
            Status.SINGULAR_K.value,
        ],
        Status.OK.value,
    )
    skew = in_lanes(
        lambda K: (
            jnp.max(jnp.abs(K - K.T), initial=0.0) > SYMMETRIC * jnp.max(jnp.abs(K), initial=0.0)
        )
    )(lin.K)
    frequency = jnp.where(skew, jnp.nan, frequency)
    status = jnp.where(skew, Status.NOT_SYMMETRIC.value, status)
    return frequency, shapes, damping, values, cluster, lin.kept_status(status)


NO_MODES = (Status.UNSTABLE, Status.NOT_SYMMETRIC, Status.SINGULAR_M, Status.NONFINITE)


def with_modal_damping(lin: Linearization, ratios: Any, where: str) -> Linearization:
    """Return the linearization with damping ratios added to its modes, one for all or one for each,
    in ascending order; its status is that of `modes` if these fail.

    Errors: BAD_SHAPE, NON_FINITE, NEGATIVE."""
    if ratios is None:
        return lin
    n = lin.M.shape[-1]
    with Problems() as problems:
        given = checked(
            ratios, ((), (n,)), where, problems, f"Give one for all modes or one for each of {n}."
        )
        if given is not None and is_concrete(given) and (given < 0).any():
            problems.add(
                "NEGATIVE",
                where,
                f"has {given.min():g}",
                value=float(given.min()),
                limit=">= 0",
                hint="It would add energy.",
            )
    C, C_tilde, C_bb, status = _added(lin, jnp.broadcast_to(device_array(given), (n,)))
    return dataclasses.replace(lin, C=C, C_tilde=C_tilde, C_bb=C_bb, status=status)


@program_with(OPTIMIZED)
def _added(lin: Linearization, ratios: Float[Array, "nv"]) -> tuple[Array, ...]:
    _, shapes, _, values, cluster, status = modes_of(lin)
    oscillates = values > ZERO * jnp.max(jnp.abs(values), initial=0.0)
    zeta = averaged(ratios, cluster)
    fixed, phi = jax.lax.stop_gradient((values, shapes))
    shared = together(cluster) & (jnp.sum(together(cluster), 0) > 1)[None]
    # its value is zero; it adds the derivative of phi' K phi - w^2 phi' M phi within a cluster,
    # which the derivatives of its eigenvalues lack
    coupling = jnp.where(shared, phi.T @ (lin.K @ phi) - phi.T @ (lin.M @ phi) * fixed[None], 0.0)
    coupling = coupling - jax.lax.stop_gradient(coupling)

    def weights(power: float) -> Float[Array, "nv nv"]:
        """Return 2 zeta w^power of the modes, as a matrix that couples only coinciding modes."""
        w2 = jnp.where(oscillates, jnp.where(shared.any(0), fixed, values), 1.0)
        slope = zeta * power * w2 ** (power / 2 - 1)
        return jnp.where(
            oscillates[None], jnp.diag(2 * zeta * w2 ** (power / 2)) + slope[None] * coupling, 0.0
        )

    left, right = lin.M @ shapes, lin.K_tilde.T @ shapes
    C, C_tilde, C_bb = (
        a @ weights(p) @ b.T
        for a, p, b in ((left, 1.0, left), (left, -1.0, right), (right, -3.0, right))
    )
    status = jnp.where(jnp.isin(status, jnp.array(NO_MODES)), status, lin.status)
    return lin.C + C, lin.C_tilde + C_tilde, lin.C_bb + C_bb, status
