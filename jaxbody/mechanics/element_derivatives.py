"""Derivatives of the elements at a state, for all linearizations: of their deformations in (Delta,
Xi), and of their energies in these."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.core.compilation.compile_options import program
from jaxbody.geometry.frames import Frame
from jaxbody.lagrange import gravity_energy
from jaxbody.mechanics.dynamics import on_coordinates
from jaxbody.mechanics.hessians import Configuration, configuration_at, frame_twists
from jaxbody.model.elements.elements import Element
from jaxbody.model.elements.second_derivatives import damping_matrix, potential_derivatives
from jaxbody.model.elements.user_energies import OfFrames
from jaxbody.model.joints.element_tables import each_element
from jaxbody.model.joints.kinematics import Coordinates, frames_displaced
from jaxbody.model.models import Model
from jaxbody.model.states import State


class ElementDerivatives(NamedTuple):
    """Derivatives of the k deformations e of each of ne elements: J = de/d(Delta, Xi), V''(e) and
    R''(e, e_dot). For energies written by the user, e are the displacements and rotations of their
    frames."""

    J: Float[Array, "ne k n"]
    stiffness: Float[Array, "ne k k"]
    damping: Float[Array, "ne k k"]

    def elastic(self) -> Float[Array, "ne n n"]:
        """Return J' V'' J of each element."""
        return jnp.swapaxes(self.J, 1, 2) @ self.stiffness @ self.J


def element_derivatives(at: Configuration) -> list[ElementDerivatives]:
    """Return the derivatives for each table of elements, at the speeds of the configuration."""

    def of(element, *frames: Frame):
        if isinstance(element, OfFrames):
            n = 6 * len(frames)
            slopes = jnp.split(jnp.eye(n, dtype=frames[0].p.dtype), len(frames), 1)
            return (
                slopes,
                potential_derivatives(element, *frames)[1],
                damping_matrix(element, *frames),
            )
        e, e_dot = element.rates(*frames)
        k = e.size
        return (
            deformation_slopes(element, *frames),
            element.tangent(e).reshape(k, k),
            jax.jacfwd(lambda rate: element.damping_force(e, rate))(e_dot).reshape(k, k),
        )

    twists = frame_twists(at)
    return [
        ElementDerivatives(on_coordinates(at.model, table, slopes, twists), *second)
        for table, (slopes, *second) in zip(
            at.model.elements, each_element(at.model, at.frames, of), strict=True
        )
    ]


def deformation_slopes(element: Element, *frames: Frame) -> list[Float[Array, "k 6"]]:
    """Return de/d(displacement and rotation) of each frame of an element."""

    def deformation(moves):
        return element.deformation(
            *(f.pose().displaced(move) for f, move in zip(frames, moves, strict=True))
        ).reshape(-1)

    return jax.jacfwd(deformation)([jnp.zeros(6, frames[0].p.dtype)] * len(frames))


@program
def gravity_stiffness(model: Model, state: State) -> Float[Array, "nv nv"]:
    """Return the Hessian of the potential energy of the weights."""
    return jax.hessian(lambda d: gravity_energy(model, frames_displaced(model, state, d)))(
        jnp.zeros(model.layout.nv, state.q.dtype)
    )


@program
def split_stiffness(model: Model, state: State):
    """Return elastic and geometric stiffness of every element, table by table: V'' de de, and the
    rest of the Hessian, V' d2e."""
    zero = jnp.zeros(n := model.layout.nv, state.q.dtype)

    def potentials(d):
        return each_element(
            model,
            frames_displaced(model, state, d),
            lambda s, *F: s.potential(*(f.pose() for f in F)),
        )

    if not model.elements:
        return [], []
    elastic = [
        x.elastic()[:, :n, :n]
        for x in element_derivatives(configuration_at(Coordinates(model), state.q))
    ]
    return elastic, [k - e for k, e in zip(jax.hessian(potentials)(zero), elastic, strict=True)]
