"""Equations of motion of closed loops, and the choice of the equations that suit a model.

    c(q(t), Xi(t)) = 0   closures, and with them   c' = J v + c_t = 0,   c'' = J v' + (c'' at v' = 0) = 0
    [M J'; J 0] [v'; lambda] = [Q; -(c'' at v' = 0)]

with the multipliers lambda: closures push with -J' lambda. c' and c'' are derivatives of c along the motion, of supports too.

An integration keeps c'' at zero, and so c and c' only up to its errors. The projection P(t, y) brings a state back to c = c' = 0 by Newton
steps in the metric of M,

    [M J'; J 0] [Delta; mu] = [0; -c],   q <- q (+) Delta,   and the same for v with c'

with M and J of the state it starts from.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from jaxbody.compilation.compile_options import jit_unoptimized
from jaxbody.core.arrays import Array, Float
from jaxbody.geometry.closures import Closure
from jaxbody.geometry.frames import Frame, Instant, Pose
from jaxbody.inputs.loads import Load
from jaxbody.mechanics.constraints import CLOSED, closed_on, each_closure, gaps
from jaxbody.mechanics.element_states import completed
from jaxbody.mechanics.energies import inertial_tables
from jaxbody.mechanics.equations_of_motion import Dynamics, FreeBodies, JointedBodies, all_free
from jaxbody.mechanics.kinematics import Motions, jacobian
from jaxbody.models.memories import holding
from jaxbody.models.models import Model
from jaxbody.models.sizes import size_of
from jaxbody.models.states import State
from jaxbody.numerics.small_systems import SaddlePoint, saddle_point

STEPS = 3  # of the projection: each takes the gap times the error of a step


class ClosedLoops(JointedBodies):
    """Bodies on joints and closures."""

    def unpack(self, y: Float[Array, "ny"], t: Any = None) -> State:
        return super().unpack(y if t is None else self.projected(t, y))

    def _accelerations(self, mass, forces, now: Instant, J) -> Float[Array, "nv"]:
        return self._saddle(mass, now, J).solve(forces, -self._changes(now))[0]

    def _saddle(self, mass: Float[Array, "nv nv"], frames: Frame, J) -> SaddlePoint:
        model = self.model
        slopes = self.closure_slopes(frames, *J)
        rank = min(slopes.shape) if model.independent is None else model.layout.nv - len(model.independent)
        return saddle_point(mass, slopes, rank)

    def projected(self, t: Float[Array, ""], y: Float[Array, "ny"]) -> Float[Array, "ny"]:
        """P(t, y); NaN where the steps do not come close."""
        q, v, z = self.model.layout.split(y)
        coordinates, supports = self.coordinates, self.coordinates.supports_moving(self.motions, t)
        frames, axes = coordinates.frames_and_axes(q, v, supports)
        J = jacobian(self.model.layout, frames, *axes)
        saddle, still = self._saddle(self.inertia(frames, *J)[0], frames, J), jnp.zeros_like(v)

        def closer(state, _):
            q, v = state
            frames = coordinates.frames(q, v, supports)
            c, rates = gaps(self.model, coordinates, frames), self._rates(frames)
            return (coordinates.retract(q, saddle.solve(still, -c)[0]), v + saddle.solve(still, -rates)[0]), jnp.max(jnp.abs(c))

        (q, v), gap = jax.lax.scan(closer, (q, v), length=STEPS)
        near = jax.lax.stop_gradient(gap[-1] <= CLOSED * size_of(self.model))
        return jnp.where(near, self.model.layout.pack(State(q, v, z)), jnp.nan)

    def closed(self, t: Float[Array, ""], state: State) -> tuple[State, Float[Array, "2"]]:
        """The state on the closures next to another, and how far that is from them: the largest |c|, of the size of the model, and the
        largest |c'| of the largest speed of a coordinate."""
        coordinates, supports = self.coordinates, self.coordinates.supports_moving(self.motions, t)
        before = coordinates.frames(state.q, state.v, supports)
        q, size = closed_on(coordinates, supports, state.q), size_of(self.model)
        rates = self._rates(coordinates.frames(q, state.v, supports))
        closed = super().unpack(self.projected(t, self.pack(State(q, state.v, state.z))))
        speeds = jnp.abs(jnp.concatenate([state.v, closed.v]) * jnp.tile(jnp.where(self.model.layout.turns, size, 1.0), 2))
        fastest = jnp.max(speeds, initial=0.0)
        gap, rate = (jnp.max(jnp.abs(x)) for x in (gaps(self.model, coordinates, before), rates))
        return closed, jax.lax.stop_gradient(jnp.stack([gap / size, rate / jnp.where(fastest > 0, fastest, 1.0)]))

    def _rates(self, frames: Frame) -> Float[Array, "n"]:
        """c'."""
        return jnp.concatenate(each_closure(self.coordinates, lambda closure, rest, ends: _rate(closure, rest, *ends), _plain(frames)))

    def _changes(self, now: Instant) -> Float[Array, "n"]:
        """c'' for the accelerations of the frames."""

        def change(closure, rest, ends, changes):
            return jax.jvp(lambda A, B: _rate(closure, rest, A, B), ends, changes)[1]

        return jnp.concatenate(each_closure(self.coordinates, change, _plain(now), now.changes()))

    def closure_slopes(self, frames: Frame, lin: Float[Array, "nb nv 3"], ang: Float[Array, "nb nv 3"]) -> Float[Array, "n nv"]:
        """J, from the velocities of the bodies per unit of each speed."""
        twists = jnp.concatenate([lin, ang], -1)
        still = jnp.zeros((self.model.layout.first_body, *twists.shape[1:]), twists.dtype)

        def slopes(closure, rest, ends, moving):
            J = _slopes(closure, rest, *ends)
            return jnp.sum(J[:, :, None] * jnp.concatenate(moving, -1).T[None], 1)

        return jnp.concatenate(each_closure(self.coordinates, slopes, _plain(frames), jnp.concatenate([still, twists])))


def _plain(frames: Frame) -> Frame:
    return Frame(frames.p, frames.R, frames.v, frames.w)


def _rate(closure: Closure, rest: Pose, A: Frame, B: Frame) -> Float[Array, "rows"]:
    """c' of one closure."""
    return jax.jvp(lambda *poses: closure.gap(*poses, rest), (A.pose(), B.pose()), (A.rates(), B.rates()))[1]


def _slopes(closure: Closure, rest: Pose, A: Frame, B: Frame) -> Float[Array, "rows 12"]:
    """c' per unit of the velocities and angular velocities of A and B."""

    def rate(x):
        return _rate(closure, rest, Frame(A.p, A.R, x[0, 0], x[0, 1]), Frame(B.p, B.R, x[1, 0], x[1, 1]))

    return jax.vmap(rate)(jnp.eye(12, dtype=A.p.dtype).reshape(12, 2, 2, 3)).T


def dynamics_of(model: Model, motions: Motions, loads: tuple[Load, ...] = ()) -> Dynamics:
    """A model under imposed motions and loads, in the form that suits it."""
    return _form_of(model)(model, motions, loads)


def _form_of(model: Model) -> type[Dynamics]:
    if model.closures:
        return ClosedLoops
    return FreeBodies if all_free(model.layout) and not inertial_tables(model) else JointedBodies


@jit_unoptimized
def state_slopes(model: Model, state: State) -> Float[Array, "ny ny"]:
    """df/dy of y' = f(t, y) at t = 0, with the supports at rest in their reference poses."""
    dynamics = dynamics_of(model, ())
    state = completed(model, state, dynamics.coordinates.at_rest(state.q))
    zero = jnp.zeros((), state.q.dtype)
    return jax.jacfwd(lambda y: dynamics.rate(zero, y))(dynamics.pack(state))


def acceleration(model: Model, state: State, t: Any = 0.0, motions: Motions = (), loads: tuple[Load, ...] = ()) -> Float[Array, "nv"]:
    """dv/dt from the equations of motion, in the speeds of the state."""
    return dynamics_of(holding(model, state.z), motions, loads).acceleration(jnp.asarray(t, state.q.dtype), state.q, state.v)
