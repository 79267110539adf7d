"""What a base acceleration excites: participation and effective masses of modes, what outputs
read of each mode and of the rest, and combinations of their peaks.

What a base acceleration excites: participation and effective masses of modes, and what outputs
read of each mode and of the rest.

With Xi'' = e a(t), S = K^-1 K~ and y = Delta - S Xi, modes phi (phi' M phi = 1) and y = sum
phi_j q_j,

    q_j'' + 2 zeta_j w_j q_j' + w_j^2 q_j = -Gamma_j a,   Gamma_j = phi_j' (M S - M~) e,
    effective mass Gamma_j^2

    output = sum_j Gamma_j (Y0 phi_j x_j + Y1 phi_j x_j' + Y2 phi_j (x_j'' + a)) + g a

where x_j is the displacement of an oscillator of w_j and zeta_j on this base, and g what the modes
leave out of the acceleration of the rest. The slow motion S Xi of the supports itself, which
strains nothing where they move as one body, is not part of it.

Source: A. K. Chopra, Dynamics of Structures (2012), 13.1 and 13.2, in whose words M S - M~ is the
mass matrix times the influence vector.


Combinations of the peaks of modes, whose times are unknown: SRSS, CQC, and the sum of
absolute values.

    SRSS       R^2 = sum_j R_j^2,   modes of one frequency are one mode, R_j their sum
    CQC        R^2 = sum_ij rho_ij R_i R_j,   r = w_i/w_j,
               rho_ij = 8 sqrt(z_i z_j) (r z_i + z_j) r^1.5
                        /((1 - r^2)^2 + 4 z_i z_j r (1 + r^2) + 4 (z_i^2 + z_j^2) r^2)
    absolute   R = sum_j |R_j|, an upper bound

rho_ij is the correlation of the displacements of two oscillators under one white noise. Source:
A. Der Kiureghian, Earthquake Eng. Struct. Dyn. 9 (1981) 419; E. L. Wilson, A. Der Kiureghian,
E. P. Bayo, same volume, 187.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import checked_dict
from jaxbody.core.arrays import Array, Float, Int
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems, Status, unknown
from jaxbody.geometry.points_and_orientations import DIRECTIONS
from jaxbody.model.inputs.port_inputs import BaseMotion
from jaxbody.numerics.eigenproblems import clusters, natural, together
from jaxbody.vibration.linearizations import Linearization
from jaxbody.vibration.natural_modes import modes_of
from jaxbody.vibration.ports import Ports, port_matrices

FAILED = (
    Status.UNSTABLE,
    Status.SINGULAR_K,
    Status.NOT_SYMMETRIC,
    Status.SINGULAR_M,
    Status.NONFINITE,
)


class Excited(NamedTuple):
    """The excitations of a model: for each a name, such as "base x", the supports that move
    together, and the direction."""

    names: tuple[str, ...]
    supports: tuple[tuple[str, ...], ...]
    directions: tuple[str, ...]
    spectra: tuple[Any, ...]


class ModalExcitation(eqx.Module):
    """Modes with the `participation` (excitations, modes) and effective `mass` [kg; kg m2 about an
    axis], and what outputs read per unit of each mode's x, x' and x'' + a, (3, outputs, modes),
    with `rest` (outputs, excitations) per unit of the base acceleration."""

    frequency: Float[Array, "n"]
    damping: Float[Array, "n"]
    cluster: Int[Array, "n"]
    participation: Float[Array, "ne n"]
    readings: Float[Array, "3 ny n"]
    rest: Float[Array, "ny ne"]
    status: Int[Array, ""]

    @property
    def mass(self) -> Float[Array, "ne n"]:
        return self.participation**2


def excited(lin: Linearization, given: Any, where: str, problems: Problems) -> Excited:
    """The excitations in {support, or several that move together: {direction: spectrum or record}}.
    Errors: WRONG_KIND, UNKNOWN_NAME, BAD_DIRECTION."""
    names, supports, directions, spectra = [], [], [], []
    known = lin.model.layout.supports
    for moved, each in checked_dict(
        given, where, "support: {direction: spectrum}", problems
    ).items():
        together = moved if isinstance(moved, tuple) else (moved,)
        problems.collected += [
            unknown(name, where, known) for name in together if name not in known
        ]
        if not isinstance(each, dict) or not each:
            hint = f'Write {{{moved!r}: {{"x": ...}}}}.'
            problems.add(
                "WRONG_KIND",
                f"{where}[{moved!r}]",
                f"is a {type(each).__name__}",
                value=each,
                limit="{direction: spectrum}",
                hint=hint,
            )
            continue
        for direction, spectrum in each.items():
            if direction not in DIRECTIONS:
                problems.add(
                    "BAD_DIRECTION",
                    f"{where}[{moved!r}]",
                    f"has {direction!r}",
                    value=direction,
                    limit=" ".join(DIRECTIONS),
                )
            names.append(f"{' and '.join(map(str, together))} {direction}")
            supports.append(together)
            directions.append(direction)
            spectra.append(spectrum)
    if not names and not problems.collected:
        hint = 'Write {"base": {"x": spectrum}}.'
        problems.add(
            "WRONG_KIND", where, "has no excitation", value=given, limit="at least one", hint=hint
        )
    return Excited(tuple(names), tuple(supports), tuple(directions), tuple(spectra))


def modal_excitation(
    lin: Linearization, bases: Excited, sensors: tuple[Any, ...]
) -> ModalExcitation:
    """Modes, participations and readings of outputs; massless coordinates of elements follow, as
    in `modes`."""
    lin = lin.condensed
    inputs = tuple(
        BaseMotion(name, direction, kind="acceleration")
        for together, direction in zip(bases.supports, bases.directions, strict=True)
        for name in together
    )
    counts = np.repeat(np.arange(len(bases.names)), [len(together) for together in bases.supports])
    together = np.eye(len(bases.names))[counts]
    return _modal_excitation(lin, port_matrices(lin, inputs, sensors), together)


@program
def _modal_excitation(
    lin: Linearization, ports: Ports, together: Float[Array, "nu ne"]
) -> ModalExcitation:
    frequency, _, damping, _, _, status = modes_of(lin)
    values, shapes = natural(lin.K, lin.M)
    cluster, nv = clusters(values), lin.M.shape[-1]
    e = ports.X @ together.astype(lin.M.dtype)
    slow = jnp.linalg.solve(lin.K, lin.K_tilde @ e)
    participation = (shapes.T @ (lin.M @ slow - lin.M_tilde @ e)).T
    readings = ports.Y[:, :, :nv] @ shapes
    ground = ports.Y[2, :, :nv] @ slow + ports.Y[2, :, nv:] @ e
    gain = None if ports.chains is None else ports.chains.gain[:, None]
    rest = ground - readings[2] @ participation.T
    if gain is not None:
        readings, rest = readings * gain[None], rest * gain
    bad = jnp.isin(status, jnp.array([failed.value for failed in FAILED]))
    nan = jnp.where(bad, jnp.nan, 1.0)
    return ModalExcitation(
        frequency, damping, cluster, participation * nan, readings * nan, rest * nan, status
    )


COMBINATIONS = ("SRSS", "CQC", "absolute")


def correlations(
    frequency: Float[Array, "n"], damping: Float[Array, "n"], cluster: Int[Array, "n"]
) -> Float[Array, "n n"]:
    """rho_ij, 1 within a cluster of coinciding frequencies, and 0 between modes without damping."""
    same = together(cluster)
    zi, zj, r = damping[:, None], damping[None], frequency[:, None] / frequency[None]
    product = zi * zj
    root = jnp.sqrt(jnp.where(product > 0, product, 1.0)) * (product > 0).astype(product.dtype)
    below = (1 - r**2) ** 2 + 4 * product * r * (1 + r**2) + 4 * (zi**2 + zj**2) * r**2
    return jnp.where(same, 1.0, 8 * root * (r * zi + zj) * r**1.5 / jnp.where(same, 1.0, below))


def combined(
    modal: Float[Array, "*b n"], rest: Float[Array, "*b"], rho: Float[Array, "n n"], combine: str
):
    """The combined peak of signed peaks of modes and of the rest, which is not correlated with
    them, and the shares of all, (..., n + 1).

    `rho`: correlations, of SRSS those within clusters alone."""
    if combine == "absolute":
        same = (rho == 1).astype(modal.dtype)
        each = jnp.abs(modal @ (same / jnp.sum(same, 0)[None]))
        parts = jnp.concatenate([each, jnp.abs(rest)[..., None]], -1)
        total = jnp.sum(parts, -1)
    else:
        parts = jnp.concatenate([modal * (modal @ rho), rest[..., None] ** 2], -1)
        total = root(jnp.sum(parts, -1))
    return total, parts


def root(square: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """The square root, with the derivative zero at zero."""
    positive = square > 0
    return jnp.where(
        jnp.isnan(square),
        square,
        jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0),
    )
