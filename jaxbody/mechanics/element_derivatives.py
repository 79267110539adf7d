"""Derivatives of the elements at a state, for all linearizations: of their deformations in (Delta, Xi), and of their energies in these."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbody.geometry.frames import Frame
from jaxbody.mechanics.energies import each_element, end_rows
from jaxbody.mechanics.hessians import Configuration, frame_twists


class ElementDerivatives(NamedTuple):
    """Of the k deformations e of each of ne elements: J = de/d(Delta, Xi), V''(e) and R''(e, e_dot)."""

    J: Float[Array, "ne k n"]
    stiffness: Float[Array, "ne k k"]
    damping: Float[Array, "ne k k"]

    def elastic(self) -> Float[Array, "ne n n"]:
        """J' V'' J of each element."""
        return jnp.swapaxes(self.J, 1, 2) @ self.stiffness @ self.J


def element_derivatives(at: Configuration) -> list[ElementDerivatives]:
    """The derivatives for each table of elements, at the speeds of the configuration."""

    def of(element, *frames: Frame):
        e, e_dot = element.rates(*frames)
        k = e.size

        def deformation(moves):
            return element.deformation(*(f.pose().displaced(move) for f, move in zip(frames, moves, strict=True))).reshape(k)

        slopes = jax.jacfwd(deformation)([jnp.zeros(6, e.dtype)] * len(frames))
        damping = jax.jacfwd(lambda rate: element.damping_force(e, rate))(e_dot)
        return slopes, jax.hessian(element.energy)(e).reshape(k, k), damping.reshape(k, k)

    twists = frame_twists(at)
    results = []
    for table, (slopes, *second) in zip(at.model.elements, each_element(at.model, at.frames, of), strict=True):
        rows = end_rows(at.model, table)
        J: Any = sum(slope @ jnp.swapaxes(twists[row], 1, 2) for slope, row in zip(slopes, rows, strict=True))
        results.append(ElementDerivatives(J, *second))
    return results
