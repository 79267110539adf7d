"""Kinks: quantities whose derivatives jump, and the elements that cause them because they rest at a
kink of their law.

jump = [g(h) - g(-h)] - [g(2 h) - g(h)] - [g(-h) - g(-2 h)],
g a derivative: of the order of h^3 where it is smooth
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Status
from jaxbody.mechanics.equilibria import equilibrium_of
from jaxbody.model.models import Model
from jaxbody.model.sizes import size_of

OFFSETS = np.array([-2.0, -1.0, 1.0, 2.0])
NEAR = 1e-3  # h in u
CLOSE = 1e-4  # h of a deformation, relative to the size of the model
SUDDEN = 0.1  # smallest ratio of a jump to the derivative


def discontinuous(g: np.ndarray) -> np.ndarray:
    """Whether a derivative jumps between the four points along the first axis."""
    return np.isfinite(g).all(0) & (
        np.abs((g[2] - g[1]) - (g[3] - g[2]) - (g[1] - g[0])) > SUDDEN * np.abs(g).max(0)
    )


def jumping(
    slopes_at: Callable[[np.ndarray], np.ndarray], u: np.ndarray, along: np.ndarray
) -> np.ndarray:
    """Which rows of slopes_at (b, n) -> (b, m, n) jump near u along a direction."""
    size = np.linalg.norm(along)
    if not size:
        return np.zeros(0, bool)
    return discontinuous(slopes_at(u + NEAR * OFFSETS[:, None] * along / size) @ (along / size))


def at_kinks(model: Model) -> list[str]:
    """The elements whose stiffness V''(e), or its derivative, jumps at the equilibrium, such as a
    stop that just touches."""
    status, slopes = _near_rest(model)
    if int(status) not in (Status.OK, Status.UNSTABLE, Status.SINGULAR_K):
        return []
    names = []
    for table, both in zip(model.elements, slopes, strict=True):
        jumps = [discontinuous(np.asarray(g).T) for g in both]
        names += [name for i, name in enumerate(table.names) if any(jump[i] for jump in jumps)]
    return names


@program
def _near_rest(model: Model):
    """Status of the equilibrium, and V'' and V''' near it for elements with one deformation."""
    eq = equilibrium_of(model, None, 200, None)
    steps = CLOSE * size_of(model) * OFFSETS

    def slopes(element, e):
        second = jax.grad(jax.grad(element.energy))
        return tuple(jax.vmap(f)(e + steps) for f in (second, jax.grad(second)))

    pairs = zip(model.elements, eq.deformations, strict=True)
    return eq.status, tuple(
        jax.vmap(slopes)(table.rows, e) if jnp.ndim(e) == 1 else () for table, e in pairs
    )
