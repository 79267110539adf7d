"""Modal damping: a damping ratio for each natural mode, of the motion relative to the quasi-static
response to the supports.

With K phi = w^2 M phi, phi' M phi = 1 and x = Delta - K^-1 K~ Xi, each mode dissipates the power 2
zeta w (phi' M x')^2, which adds to C, C~ and C_bb

    M phi (2 zeta w) phi' M,    M phi (2 zeta/w) phi' K~,    K~' phi (2 zeta/w^3) phi' K~

summed over the modes of positive frequency. Source: A. K. Chopra, Dynamics of Structures
(2012), 11.4.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float, checked, concrete, device_array, float_array
from jaxbody.core.compilation.compile_options import OPTIMIZED, program_with
from jaxbody.core.errors import Problems, Status
from jaxbody.numerics.eigenproblems import ZERO, averaged, clusters, natural, together
from jaxbody.vibration.linearizations import Linearization
from jaxbody.vibration.natural_modes import modes_of

NO_MODES = (Status.UNSTABLE, Status.NOT_SYMMETRIC, Status.SINGULAR_M, Status.NONFINITE)


def with_modal_damping(lin: Linearization, ratios: Any, where: str) -> Linearization:
    """The linearization with damping ratios added to its modes, one for all or one for each, in
    ascending order; its status is that of `modes` if these fail.

    Errors: BAD_SHAPE, NON_FINITE, NEGATIVE."""
    if ratios is None:
        return lin
    n = lin.M.shape[-1]
    with Problems() as problems:
        given = checked(
            float_array(ratios, where),
            ((), (n,)),
            where,
            problems,
            f"Give one for all modes or one for each of {n}.",
        )
        known = None if given is None else concrete(given)
        if known is not None and (known < 0).any():
            problems.add(
                "NEGATIVE",
                where,
                f"has {known.min():g}",
                value=float(known.min()),
                limit=">= 0",
                hint="It would add energy.",
            )
    C, C_tilde, C_bb, status = _added(lin, jnp.broadcast_to(device_array(given), (n,)))
    return dataclasses.replace(lin, C=C, C_tilde=C_tilde, C_bb=C_bb, status=status)


@program_with(OPTIMIZED)
def _added(lin: Linearization, ratios: Float[Array, "nv"]) -> tuple[Array, ...]:
    *_, status = modes_of(lin)
    values, shapes = natural(lin.K, lin.M)
    cluster, top = clusters(values), jnp.max(jnp.abs(values), initial=0.0)
    oscillates = values > ZERO * top
    zeta = averaged(ratios, cluster)
    fixed, phi = jax.lax.stop_gradient((values, shapes))
    shared = together(cluster) & (jnp.sum(together(cluster), 0) > 1)[None]
    # zero, with the derivative of phi' K phi - w^2 phi' M phi within a cluster, which that of its
    # eigenvalues lacks
    coupling = jnp.where(shared, phi.T @ (lin.K @ phi) - phi.T @ (lin.M @ phi) * fixed[None], 0.0)
    coupling = coupling - jax.lax.stop_gradient(coupling)

    def weights(power: float) -> Float[Array, "nv nv"]:
        """2 zeta w^power of the modes, as a matrix between those that coincide."""
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
