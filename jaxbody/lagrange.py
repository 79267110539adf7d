"""The scalar functions that define a model: kinetic energy T, potential energy V, Rayleigh dissipation R. Everything else is a derivative.

Each takes the model, a state and, for supports away from their reference poses, Xi and its rate (6 numbers for each support).
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxbody.compilation.compile_options import program
from jaxbody.core.arrays import Array, Float
from jaxbody.geometry.frames import Frame
from jaxbody.geometry.vectors import dot, rotate, rotate_back
from jaxbody.joints.element_tables import Xi, each_element, frames_of, inertial_tables, of_table
from jaxbody.laws.memories import InState, memories
from jaxbody.models.memories import holding, rest_states
from jaxbody.models.models import Model
from jaxbody.models.preconditions import check_state
from jaxbody.models.states import State


def kinetic_energy(model: Model, state: State, xi: Xi = None, xi_dot: Xi = None) -> Float[Array, ""]:
    """T = sum of 1/2 m v_C^2 + 1/2 w' J_C w over the bodies, and of the energies of elements with inertia [J].

    Source: (10), (11) of the paper.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, gravity=[0, 0, -10.0])
    >>> state = State(model.reference.q, jnp.array([0, 0, 3.0, 0, 0, 0]))
    >>> float(kinetic_energy(model, state))
    9.0
    """
    return _energy(kinetic, model, state, xi, xi_dot)


def potential_energy(model: Model, state: State, xi: Xi = None) -> Float[Array, ""]:
    """V = sum over the elements of their energies - sum of m g . C over the bodies [J]. Source: (22), (60) of the paper.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1], position=[0, 0, 1.5])}, gravity=[0, 0, -10.0])
    >>> float(potential_energy(model, model.reference))
    30.0
    """
    return _energy(potential, model, state, xi, None)


def dissipation(model: Model, state: State, xi: Xi = None, xi_dot: Xi = None) -> Float[Array, ""]:
    """R = sum over the elements, 1/2 c e_dot^2 for a linear damper [W]; 2 R is the power dissipated by linear dampers.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, gravity=[0, 0, -10.0])
    >>> state = State(model.reference.q, jnp.array([0, 0, 3.0, 0, 0, 0]))
    >>> float(dissipation(model, state))
    0.0
    """
    return _energy(rayleigh, model, state, xi, xi_dot)


def lagrangian(model: Model, state: State, xi: Xi = None, xi_dot: Xi = None) -> Float[Array, ""]:
    """L = T - V [J]. Source: (12) of the paper.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, gravity=[0, 0, -10.0])
    >>> state = State(model.reference.q, jnp.array([0, 0, 3.0, 0, 0, 0]))
    >>> float(lagrangian(model, state))
    9.0
    """
    return _energy(kinetic_less_potential, model, state, xi, xi_dot)


def _energy(energy: Callable[[Model, Frame], Array], model: Model, state: State, xi: Xi, xi_dot: Xi) -> Float[Array, ""]:
    check_state(model, state, "state")
    return _of_state(energy, model, state, xi, xi_dot)


@program
def _of_state(energy: Callable[[Model, Frame], Array], model: Model, state: State, xi: Xi, xi_dot: Xi) -> Float[Array, ""]:
    frames = frames_of(model, state, xi, xi_dot)
    z = state.z if state.z.shape[-1] or not model.layout.nz else rest_states(model, frames.pose())
    return energy(holding(model, z), frames)


def kinetic_less_potential(model: Model, frames: Frame) -> Float[Array, ""]:
    """L of a table of frames."""
    return kinetic(model, frames) - potential(model, frames)


def kinetic(model: Model, frames: Frame) -> Float[Array, ""]:
    """T of a table of frames."""
    bodies, moving = model.bodies.rows, frames[model.layout.first_body :]
    v_C = moving.velocity(bodies.com)
    w_B = rotate_back(moving.R, moving.w)
    T = 0.5 * jnp.sum(bodies.mass * dot(v_C, v_C) + dot(w_B, rotate(bodies.inertia, w_B)))
    inertial = (of_table(model, frames, table, lambda s, *F: s.kinetic_energy(*s.rates(*F))) for table in inertial_tables(model))
    inner = (jax.vmap(lambda law: law.kinetic())(law) for law in memories(model.elements, InState) if law.law.inertial)
    return sum(map(jnp.sum, (*inertial, *inner)), T)


def gravity_energy(model: Model, frames: Frame) -> Float[Array, ""]:
    """-sum of m g . C."""
    bodies = model.bodies.rows
    return -jnp.sum(bodies.mass * dot(frames[model.layout.first_body :].point(bodies.com), model.gravity[None]))


def potential(model: Model, frames: Frame) -> Float[Array, ""]:
    """V of a table of frames."""
    return gravity_energy(model, frames) + sum(jnp.sum(e) for e in each_element(model, frames, lambda s, *F: s.potential(*F)))


def rayleigh(model: Model, frames: Frame) -> Float[Array, ""]:
    """R of a table of frames."""
    return sum((jnp.sum(e) for e in each_element(model, frames, lambda s, *F: s.dissipation(*s.rates(*F)))), jnp.zeros((), frames.p.dtype))
