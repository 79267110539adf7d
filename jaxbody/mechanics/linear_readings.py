"""Readings of sensors to first order in small motions, as outputs of responses and state spaces."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.mechanics.equations_of_motion import Dynamics
from jaxbody.models.states import Instant, State


def reading_rows(lin: Any, sensors: list[Any], wrenches: Float[Array, "nu nb 6"]) -> tuple[Float[Array, "ny 3 n"], Float[Array, "ny nu"]]:
    """The derivatives of each reading in x = (Delta, Xi), x' and x'' about the equilibrium, and in forces u, with the `wrenches` per unit
    of u: force and moment on each body about its origin, in world axes. Accelerations are those of x'': no equation of motion is solved."""
    model, q, layout = lin.model, lin.state.q, lin.model.layout
    dynamics, accelerated = Dynamics(model, (), lin.loads), any(sensor.accelerations for sensor in sensors)
    zero, t = jnp.zeros(layout.nv + layout.nxi, q.dtype), jnp.zeros((), q.dtype)

    def readings(x, rate, change, u):
        def moving(s):
            (delta, xi), (v, xi_dot) = (jnp.split(y, [layout.nv]) for y in (x + s * rate, rate + s * change))
            state = State(dynamics.coordinates.retract(q, delta), v)
            supports = dynamics.coordinates.supports_at(xi.reshape(-1, 6), xi_dot.reshape(-1, 6))
            frames = dynamics.coordinates.frames(state.q, v, supports)
            return (frames.v, frames.w), (frames, state)

        a = alpha = None
        transmitted = (None, None)
        if accelerated:
            (_, (a, alpha), (frames, state)) = jax.jvp(moving, (t,), (jnp.ones_like(t),), has_aux=True)
            if any(sensor.reactions for sensor in sensors):
                extra = jnp.tensordot(u, wrenches, 1)
                transmitted = dynamics.transmitted_wrenches(t, frames, a, alpha, (extra[:, :3], extra[:, 3:]))
        else:
            frames, state = moving(t)[1]
        now = Instant(frames.p, frames.R, frames.v, frames.w, state, a, alpha, *transmitted)
        return jnp.stack([sensor.reading(model, now) for sensor in sensors])

    *rows, direct = jax.jacfwd(readings, (0, 1, 2, 3))(zero, zero, zero, jnp.zeros(len(wrenches), q.dtype))
    return jnp.stack(rows, 1), direct
