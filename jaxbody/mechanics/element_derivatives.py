"""Derivatives of the elements at a state, for all that is linear: of their deformations in (Delta, Xi), and of their energies in these."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbody.geometry.frames import Frame
from jaxbody.mechanics.energies import each_element
from jaxbody.mechanics.hessians import Configuration, frame_twists


class ElementDerivatives(NamedTuple):
    """Of the k deformations e of each of ne elements: J = de/d(Delta, Xi), V''(e) and R''(e, e_dot)."""

    J: Float[Array, "ne k n"]
    stiffness: Float[Array, "ne k k"]
    damping: Float[Array, "ne k k"]

    def quadratic(self, H: Float[Array, "ne k k"], x: Float[Array, "n m"]) -> Float[Array, "ne m m"]:
        """(J x)' H (J x) of each element."""
        e = self.J @ x
        return jnp.swapaxes(e, 1, 2) @ H @ e


def element_derivatives(at: Configuration) -> list[ElementDerivatives]:
    """Table by table, at the speeds of the configuration."""

    def of(element, *frames: Frame):
        e, e_dot = element.rates(*frames)
        k = e.size

        def deformation(moves):
            return element.deformation(*(f.pose().displaced(move) for f, move in zip(frames, moves, strict=True))).reshape(k)

        slopes = jax.jacfwd(deformation)([jnp.zeros(6, e.dtype)] * len(frames))
        damping = jax.jacfwd(lambda rate: element.damping_force(e, rate))(e_dot)
        return slopes, jax.hessian(element.energy)(e).reshape(k, k), damping.reshape(k, k)

    twists, frame = frame_twists(at), at.model.layout.frame
    results = []
    for table, (slopes, *second) in zip(at.model.elements, each_element(at.model, at.frames, of), strict=True):
        ends = [np.array([frame(name) for name in end]) for end in zip(*table.links, strict=True)]
        J: Any = sum(slope @ jnp.swapaxes(twists[end], 1, 2) for slope, end in zip(slopes, ends, strict=True))
        results.append(ElementDerivatives(J, *second))
    return results
