"""States of the elements with memory: their rates, their scales, and the state of a model completed by them."""

from __future__ import annotations

import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry.frames import Frame
from jaxbody.laws.memories import Held, Relaxed, memories
from jaxbody.mechanics.energies import of_table
from jaxbody.mechanics.kinematics import Coordinates
from jaxbody.models.memories import relaxed, rest_states
from jaxbody.models.models import Model
from jaxbody.models.states import State


def state_rates(model: Model, frames: Frame) -> Float[Array, "nz"]:
    """z' of a model that holds its states, in these frames."""
    return _joined(model, frames, Held, lambda element, *ends: element.state_rates(*element.rates(*ends)))


def state_scales(model: Model, reference: Frame, size: Float[Array, ""]) -> Float[Array, "nz"]:
    """The scale of each state: its change per unit of the deformation in the reference pose, times the size of the model, 1 rad for an
    angle; the scale of the deformation where a state does not follow it."""

    def scales(element, *ends):
        e = element.deformation(*(end.pose() for end in ends))
        follows = jnp.abs(element.sensitivities(e))
        return jnp.where(follows > 0, follows, 1.0)

    return _joined(relaxed(model), reference, Relaxed, scales) * jnp.where(model.layout.follows_angles, 1.0, size)


def completed(model: Model, state: State, frames: Frame | None = None) -> State:
    """The state with the z of rest in these frames where it has none; by default with the supports in their reference poses."""
    if not model.layout.nz or state.z.shape[-1]:
        return state
    frames = Coordinates(model).at_rest(state.q) if frames is None else frames
    return State(state.q, state.v, rest_states(model, frames.pose()))


def _joined(model: Model, frames: Frame, kind: type, function) -> Float[Array, "nz"]:
    """function(element, A, B, ...) of the elements with memory, in the order of z."""
    tables = [table for table in model.elements if memories(table.rows, kind)]
    return jnp.concatenate([of_table(model, frames, table, function).reshape(-1) for table in tables])
