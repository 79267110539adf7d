"""Why a computation failed, by name: which number is not finite, which bushing is turned too far, which spring has no length left."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbody.derivatives import second_order
from jaxbody.dynamics import acceleration
from jaxbody.elements import Bushing, LineElement
from jaxbody.kinematics import Coordinates, Motions, table_of
from jaxbody.loads import Load
from jaxbody.mechanics import each_element
from jaxbody.models import Model, State
from jaxbody.options import jit_as_it_is

AHEAD = (0.0, 1e-12, 1e-9, 1e-6, 1e-3)  # of the time past, or of a second where that is longer
DOWNHILL = (0.0, 1e-9, 1e-6, 1e-3)  # of the size of a model
FAR = 175.0  # degrees
POINT = 1e-6  # of the free length


def without_number_ahead(model: Model, motions: Motions, loads: tuple[Load, ...], t: Array, state: State) -> str:
    """The motion, element, load or body that first gives a number that is not finite, at this state or as it moves on; empty without such."""
    for ahead in np.maximum(np.abs(t), 1.0) * np.array(AHEAD, state.q.dtype):
        of_motions, of_elements, of_loads = jax.tree.map(np.asarray, _numbers(model, motions, loads, t, state, ahead))
        moment = f"at t = {float(t + ahead):.6g} s"
        for name, good in zip(model.layout.supports, of_motions, strict=True):
            if not good:
                return f"the motion of '{name}' {moment}"
        for name, (good, e, rate) in of_elements.items():
            if not good:
                at = f", at e = {e:.6g}, e' = {rate:.6g}" if e.ndim == 0 else ""
                return f"the force of element '{name}' {moment}{at}"
        for load, good in zip(loads, of_loads, strict=True):
            if not good:
                return f"a load, {type(load).__name__}, on '{load.on}' {moment}"
    bad = [name for name in model.layout.bodies if not np.isfinite(np.asarray(state.q[model.layout.q_slices[name]])).all()]
    return f"the coordinates of body '{bad[0]}'" if bad else ""


@jit_as_it_is
def _numbers(model: Model, motions: Motions, loads: tuple[Load, ...], t, state: State, ahead):
    """Which numbers are finite `ahead` of a state: of the motions, of the elements with their e and e_dot, of the loads."""
    change = acceleration(model, state, t, motions, loads)
    v = state.v + ahead * jnp.where(jnp.isfinite(change), change, 0.0)
    moved, moment = State(Coordinates(model).retract(state.q, ahead * state.v), v), t + ahead
    frames = table_of(model, motions, moment, moved)

    def numbers(element, *frames):
        e, rate = element.rates(*frames)
        return jnp.isfinite(element.force(*frames)).all(), e, rate

    on = [frames[model.layout.frame(load.on)] for load in loads]
    wrenches = [jnp.concatenate(load.wrench(moment, frame)) for load, frame in zip(loads, on, strict=True)]
    return (
        [jnp.isfinite(motion(moment)).all() for motion in motions],
        _rows(model, each_element(model, frames, numbers)),
        [jnp.isfinite(wrench).all() for wrench in wrenches],
    )


def _rows(model: Model, values: list[Any]) -> dict[str, Any]:
    """{name: what belongs to that element}."""
    return {
        name: jax.tree.map(lambda x, i=i: x[i], value)
        for table, value in zip(model.elements, values, strict=True)
        for i, name in enumerate(table.names)
    }


def without_number_downhill(model: Model, q: Float[Array, "nq"], slope: Float[Array, "nv"], size: float) -> list[str]:
    """The elements whose energy, force or stiffness is not finite at q or, else, a little down the slope."""
    down = np.where(np.isfinite(slope), -np.asarray(slope), 0.0)
    down = down * size / max(np.abs(down).max(initial=0.0), np.finfo(down.dtype).tiny)
    for far in DOWNHILL:
        good = _finite(model, q, far * down)
        if bad := [name for name, one in good.items() if not one]:
            return bad
    return []


@jit_as_it_is
def _finite(model: Model, q: Float[Array, "nq"], delta: Float[Array, "nv"]) -> dict[str, Bool[Array, ""]]:
    coordinates = Coordinates(model)
    frames = coordinates.at_rest(coordinates.retract(q, delta))

    def finite(element, *frames):
        parts = (element.potential(*(f.pose() for f in frames)), second_order(element, *frames))
        return jnp.stack([jnp.isfinite(part).all() for part in jax.tree.leaves(parts)]).all()

    return _rows(model, each_element(model, frames, finite))


def past_half_turn(model: Model, motions: Motions, t: Array, state: State) -> str:
    """The bushings that are turned by nearly half a turn, where their deformation jumps; empty without such."""
    angles = {name: float(np.rad2deg(angle)) for name, angle in _turns(model, motions, t, state).items()}
    far = [f"'{name}' is turned by {angle:.4g} degrees" for name, angle in angles.items() if angle > FAR]
    remedy = "a bushing is for less than half a turn, where its deformation jumps: let a joint (jb.Hinge, jb.Ball) guide what turns further, or hold it by springs"
    return f"{', '.join(far)}; {remedy}" if far else ""


@jit_as_it_is
def _turns(model: Model, motions: Motions, t, state: State) -> dict[str, Float[Array, ""]]:
    def turn(element, *frames):
        if not isinstance(element, Bushing):
            return jnp.zeros(())
        return jnp.sqrt(jnp.sum(element.deformation(*(f.pose() for f in frames))[3:] ** 2))

    return _rows(model, each_element(model, table_of(model, motions, t, state), turn))


def collapsed(model: Model, motions: Motions, t: Array, state: State) -> str:
    """The line elements that have shrunk to a point, where their direction jumps; empty without such."""
    shrunk = [f"'{name}' has shrunk to a point" for name, share in _shares(model, motions, t, state).items() if share < POINT]
    remedy = "its direction jumps there: let its ends pass beside each other, hold them apart by a stop, or use a Bushing"
    return f"{', '.join(shrunk)}; {remedy}" if shrunk else ""


@jit_as_it_is
def _shares(model: Model, motions: Motions, t, state: State) -> dict[str, Float[Array, ""]]:
    """Of line elements the length over the free length."""

    def share(element, *frames):
        if not isinstance(element, LineElement):
            return jnp.ones(())
        return jnp.where(element.free_length > 0, element.length(*(f.pose() for f in frames)) / element.free_length, 1.0)

    return _rows(model, each_element(model, table_of(model, motions, t, state), share))
