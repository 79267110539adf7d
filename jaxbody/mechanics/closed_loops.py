"""Equations of motion of closed loops, Lagrange's equations as `lagrange.py` states them, and the
choice of the equations that suit a model.

    c(q(t), Xi(t)) = 0   closures, and with them   c' = J v + c_t = 0,
    c'' = J v' + (c'' at v' = 0) = 0
    [M J'; J 0] [v'; lambda] = [Q; -(c'' at v' = 0)]

with the multipliers lambda: closures push with -J' lambda. c' and c'' are derivatives of c along
the motion, of supports too.

An integration keeps c'' at zero, and so c and c' only up to its errors. The projection P(t, y)
brings a state back to c = c' = 0 by Newton steps in the metric of M,

    [M J'; J 0] [Delta; mu] = [0; -c],   q <- q (+) Delta,   and the same for v with c'

with M and J of the state from which the projection starts.
"""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxbody.lagrange as lagrange
from jaxbody.core.arrays import Array, Bool, Float
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Status
from jaxbody.geometry.closures import Closure, Coupling
from jaxbody.geometry.frames import Frame, Instant, Pose
from jaxbody.mechanics.constraints import CLOSED, RANK, closed_on
from jaxbody.mechanics.dynamics import Dynamics, FreeBodies, JointedBodies, all_free, generalized
from jaxbody.mechanics.free_motions import FreeMotions
from jaxbody.model.element_states import holding
from jaxbody.model.inputs.loads import Load
from jaxbody.model.joints.frame_tables import (
    completed,
    drawn,
    each_closure,
    gaps_from,
    inertial_tables,
    moving_slides,
    rank,
    reads_accelerations,
    state_rates,
    states_after_samples,
)
from jaxbody.model.joints.kinematics import Motions, frames_at_time, jacobian
from jaxbody.model.models import Model, scale_of, size_of
from jaxbody.model.states import State
from jaxbody.numerics.small_systems import SaddlePoint, saddle_point

STEPS = 3  # of the projection; each multiplies the gap by the relative error of a step
# smallest singular value of closures, relative to the largest, below which an integration that
# ended there is said to have ended for this reason
SINGULAR = 1e-4


class Closing(NamedTuple):
    """The distance of a state from the closures: the largest `gap` c, relative to the size of the
    model; the largest `rate` c', relative to the largest speed of a coordinate, zero at rest; and
    `left`, the largest c where the search for a closed state ended, relative to the size."""

    gap: Float[Array, ""]
    rate: Float[Array, ""]
    left: Float[Array, ""]


class ClosedLoops(JointedBodies):
    """Bodies on joints and closures."""

    rests: list[Pose]  # poses of the second frame of each closure on the first, as drawn
    size: Float[Array, ""]

    def __init__(self, model: Model, motions: Motions, loads: tuple[Load, ...] = ()):
        Dynamics.__init__(self, model, motions, loads)
        self.rests, self.size = drawn(self.coordinates), jax.lax.stop_gradient(size_of(model))

    def driven_on_closures(
        self, t: Float[Array, ""], y: Float[Array, "ny"]
    ) -> tuple[Float[Array, "ny"], SaddlePoint]:
        """Return dy/dt, and the equations [M J'; J 0] from which it follows."""
        q, v, z = self.model.layout.split(y)
        here: Any = self.holding(z)
        v_dot, now, J, saddle = here.solved(t, q, v)
        rates = here.state_rates(v_dot, now, J)
        return self.model.layout.pack(State(self.coordinates.rate(q, v), v_dot, rates)), saddle

    def _solve(self, t, q, v):
        return self.solved(t, q, v)[:3]

    def solved(self, t, q, v):
        """Return v', the frames at time t with the accelerations that they have for v' = 0, the
        velocities of the bodies per unit of each component of v, and [M J'; J 0]."""
        now, axes = self._bias(t, q, v)
        J = jacobian(self.model.layout, now, *axes)
        saddle = self._saddle(now, q, J)
        return (
            saddle.solve(generalized(*J, *self._net(now)), -self._changes(now))[0],
            now,
            J,
            saddle,
        )

    def multipliers(
        self, t: Float[Array, ""], state: State
    ) -> tuple[Float[Array, "n"], Bool[Array, "n"]]:
        """Return lambda, with the least norm where it is not unique, and which of its components
        are unique."""
        return self._balancing(self.accelerated(t, state))

    def _balancing(
        self, now: Instant, extra: tuple[Array, Array] | None = None
    ) -> tuple[Float[Array, "n"], Bool[Array, "n"]]:
        """Return lambda for given accelerations, from J' lambda = Q - M v', and which of its
        components are unique. `extra`: forces and moments on the bodies in addition to the
        loads."""
        layout = self.model.layout
        frames, axes = self.coordinates.frames_and_axes(
            now.state.q, now.state.v, _plain(now)[1 : layout.first_body]
        )
        J = jacobian(layout, frames, *axes)
        F, M = (
            self._net(now)
            if extra is None
            else (x + y for x, y in zip(self._net(now), extra, strict=True))
        )
        scale = scale_of(self.model, self.size)
        slopes = self._slopes(frames, now.state.q, J) * scale[None]
        free = FreeMotions(slopes, jnp.linalg.pinv(slopes, rtol=RANK))
        return free.multipliers(-scale * generalized(*J, F, M)), free.unique

    def with_reactions(self, now: Instant, extra: tuple[Array, Array] | None = None) -> Instant:
        """Return `now` with F and M as in a tree of joints on which the closures act as well, with
        the forces that balance the accelerations."""
        first = self.model.layout.first_body
        F, M = jnp.split(self._wrenches(now, self._balancing(now, extra)[0]), 2, -1)
        of_bodies = F[first:], M[first:]
        if extra is not None:
            of_bodies = of_bodies[0] + extra[0], of_bodies[1] + extra[1]
        now, fixed = super().with_reactions(now, of_bodies), (np.arange(len(F)) < first)[:, None]
        on_fixed = (
            jnp.asarray(of_joints) + jnp.where(fixed, x, 0.0)
            for of_joints, x in ((now.F, F), (now.M, M))
        )
        return replace(now, **dict(zip("FM", on_fixed, strict=True)))

    def _wrenches(self, now: Instant, multipliers: Float[Array, "n"]) -> Float[Array, "nf 6"]:
        """Return force and moment about its origin that closures exert on each frame. Those of
        couplings are zero: their forces act along coordinates, in the joints."""
        frame, tables = self.model.layout.frame, self.model.closures
        ends = np.array(
            [
                [frame(end) for end in link]
                for table in tables
                for link in table.links
                for _ in table.rows.rows
            ]
        )

        def acting(closure, rest, ends):
            slopes = _slopes(closure, rest, *ends)
            return jnp.zeros_like(slopes) if isinstance(closure, Coupling) else slopes

        coordinates = moving_slides(self.model.layout, now.state.q, now.state.v)
        slopes = each_closure(self.model, self.rests, acting, (_plain(now),), (coordinates,))
        each = -multipliers[:, None, None] * jnp.concatenate(slopes).reshape(-1, 2, 6)
        return jnp.zeros((len(now.p), 6), now.p.dtype).at[ends].add(each)

    def _saddle(self, frames: Frame, q: Float[Array, "nq"], J: tuple[Array, Array]) -> SaddlePoint:
        """Return the system [M J'; J 0]; `J` here: the velocities of the bodies per unit of each
        component of v."""
        return saddle_point(
            self.inertia(frames, *J)[0], self._slopes(frames, q, J), rank(self.model)
        )

    def _slopes(
        self, frames: Frame, q: Float[Array, "nq"], J: tuple[Array, Array]
    ) -> Float[Array, "n nv"]:
        """Return dc/dDelta from the velocities of the bodies per unit of each speed."""
        twists, zero = jnp.concatenate(J, -1), jnp.zeros(self.model.layout.nv, q.dtype)
        speeds = np.array([j for _, j in self.model.layout.coordinate_places.values()], int)
        along = (
            jnp.zeros((len(speeds), len(zero), 6), q.dtype)
            .at[np.arange(len(speeds)), speeds, 0]
            .set(1.0)
        )
        still = jnp.zeros((self.model.layout.first_body, *twists.shape[1:]), twists.dtype)

        def slopes(closure, rest, ends, moving):
            return jnp.sum(
                _slopes(closure, rest, *ends)[:, :, None] * jnp.concatenate(moving, -1).T[None], 1
            )

        return jnp.concatenate(
            each_closure(
                self.model,
                self.rests,
                slopes,
                (_plain(frames), jnp.concatenate([still, twists])),
                (moving_slides(self.model.layout, q, zero), along),
            )
        )

    def slopes(self, t: Float[Array, ""], state: State) -> Float[Array, "n nv"]:
        """Return dc/dDelta, for increments in meters."""
        supports = self.coordinates.supports_moving(self.motions, t)
        frames, axes = self.coordinates.frames_and_axes(state.q, state.v, supports)
        return (
            self._slopes(frames, state.q, jacobian(self.model.layout, frames, *axes))
            * scale_of(self.model, self.size)[None]
        )

    def smallest(self, t: Float[Array, ""], state: State) -> Float[Array, ""]:
        """Return the smallest singular value of dc/dDelta that belongs to an independent condition,
        relative to the largest."""
        values = jnp.linalg.svdvals(jax.lax.stop_gradient(self.slopes(t, state)))
        return values[rank(self.model) - 1] / jnp.maximum(values[0], 1e-300)

    def _rates(
        self, frames: Frame, q: Float[Array, "nq"], v: Float[Array, "nv"]
    ) -> Float[Array, "n"]:
        """Return c', the rates of the conditions of all closures."""
        return jnp.concatenate(
            each_closure(
                self.model,
                self.rests,
                lambda closure, rest, ends: _rate(closure, rest, *ends),
                (_plain(frames),),
                (moving_slides(self.model.layout, q, v),),
            )
        )

    def _changes(self, now: Instant) -> Float[Array, "n"]:
        """Return c'' for the accelerations of the frames at v' = 0."""
        coordinates = moving_slides(self.model.layout, now.state.q, now.state.v)
        return jnp.concatenate(
            each_closure(
                self.model,
                self.rests,
                lambda closure, rest, ends, changes: jax.jvp(
                    partial(_rate, closure, rest), ends, changes
                )[1],
                (_plain(now), now.changes()),
                (coordinates, coordinates.rates().at_rest()),
            )
        )

    def projected(self, t: Float[Array, ""], y: Float[Array, "ny"]) -> Float[Array, "ny"]:
        """Return the projection P(t, y) of the state onto the closures."""
        q, v, _ = self.model.layout.split(y)
        frames, axes = self.coordinates.frames_and_axes(
            q, v, self.coordinates.supports_moving(self.motions, t)
        )
        return self.closer(
            t, y, self._saddle(frames, q, jacobian(self.model.layout, frames, *axes))
        )

    def closer(
        self, t: Float[Array, ""], y: Float[Array, "ny"], saddle: SaddlePoint
    ) -> Float[Array, "ny"]:
        """Return the projection P(t, y), computed with the equations `saddle`, [M J'; J 0] at y;
        NaN where the steps do not converge to the closures."""
        q, v, z = self.model.layout.split(y)
        supports, still = self.coordinates.supports_moving(self.motions, t), jnp.zeros_like(v)

        def step(state, _):
            q, v = state
            frames = self.coordinates.frames(q, v, supports)
            c = gaps_from(self.model, self.rests, frames, q)
            v = v + saddle.solve(still, -self._rates(frames, q, v))[0]
            q = self.coordinates.retract(q, saddle.solve(still, -c)[0])
            return (q, v), jnp.max(jnp.abs(c))

        (q, v), gap = jax.lax.scan(step, (q, v), length=STEPS)
        near = jax.lax.stop_gradient(gap[-1] <= CLOSED * self.size)
        return jnp.where(near, self.model.layout.pack(State(q, v, z)), jnp.nan)

    def ended(self, code: Array, t: Float[Array, ""], state: State, closing: Closing) -> Array:
        """Return NOT_CLOSED where no motion starts, SINGULAR_CLOSURE where it ends because closures
        become dependent, and `code` otherwise."""
        early = [Status.DT_MIN.value, Status.NONFINITE.value, Status.MAX_STEPS.value]
        singular = jnp.isin(code, jnp.array(early)) & (self.smallest(t, state) < SINGULAR)
        code = jnp.where(singular, Status.SINGULAR_CLOSURE.value, code)
        return jnp.where(closing.left > CLOSED, Status.NOT_CLOSED.value, code)

    def begun(self, t: Float[Array, ""], state: State) -> tuple[State, Closing]:
        """Return the nearest state that fulfills the closures, and the distance of the given state
        from them."""
        supports = self.coordinates.supports_moving(self.motions, t)
        before = gaps_from(
            self.model, self.rests, self.coordinates.frames(state.q, state.v, supports), state.q
        )
        q = closed_on(self.coordinates, self.rests, supports, state.q)
        frames = self.coordinates.frames(q, state.v, supports)
        nearest, rates = State(q, state.v, state.z), self._rates(frames, q, state.v)
        closed = self.unpack(self.projected(t, self.pack(nearest)))
        left = jnp.max(jnp.abs(gaps_from(self.model, self.rests, frames, q))) / self.size
        given, fastest = (
            jnp.max(jnp.abs(v) * jnp.where(self.model.layout.turns, self.size, 1.0))
            for v in (state.v, closed.v)
        )
        rate = jnp.where(
            given > 0,
            jnp.max(jnp.abs(rates)) / jnp.maximum(jnp.maximum(given, fastest), 1e-300),
            0.0,
        )
        reached = jax.tree.map(
            lambda new, old: jnp.where(left <= CLOSED, new, old), closed, nearest
        )
        far = Closing(jnp.max(jnp.abs(before)) / self.size, rate, left)
        return reached, jax.lax.stop_gradient(far)


def _plain(frames: Frame) -> Frame:
    return Frame(frames.p, frames.R, frames.v, frames.w)


def _rate(closure: Closure, rest: Pose, A: Frame, B: Frame) -> Float[Array, "rows"]:
    """Return c' of one closure."""
    return jax.jvp(
        lambda a, b: closure.gap(a, b, rest), (A.pose(), B.pose()), (A.rates(), B.rates())
    )[1]


def _slopes(closure: Closure, rest: Pose, A: Frame, B: Frame) -> Float[Array, "rows 12"]:
    """Return c' per unit of the velocities and angular velocities of A and B."""

    def rate(x):
        return _rate(
            closure, rest, Frame(A.p, A.R, x[0, 0], x[0, 1]), Frame(B.p, B.R, x[1, 0], x[1, 1])
        )

    return jax.vmap(rate)(jnp.eye(12, dtype=A.p.dtype).reshape(12, 2, 2, 3)).T


class LagrangeBodies(JointedBodies):
    """Bodies on joints of any kind, by Lagrange's equations; y = (q, v, z)."""

    def driven(self, u: Any, y: Float[Array, "ny"]) -> Float[Array, "ny"]:
        return _lagrange_rate(self, u, y)[0]


class LagrangeLoops(ClosedLoops):
    """Bodies on joints and closures, by Lagrange's equations; y = (q, v, z)."""

    def driven_on_closures(
        self, t: Float[Array, ""], y: Float[Array, "ny"]
    ) -> tuple[Float[Array, "ny"], Any]:
        return _lagrange_rate(self, t, y)


def _lagrange_rate(
    dynamics: Dynamics, t: Float[Array, ""], y: Float[Array, "ny"]
) -> tuple[Float[Array, "ny"], Any]:
    """Return dy/dt, and the equations of v' and lambda."""
    model = dynamics.model
    q, v, z = model.layout.split(y)
    v_dot, z_dot, equations = lagrange.rates(
        model, State(q, v, z), dynamics.motions, dynamics.loads, t
    )
    return model.layout.pack(State(dynamics.coordinates.rate(q, v), v_dot, z_dot)), equations


def dynamics_of(
    model: Model, motions: Motions, loads: tuple[Load, ...] = (), equations: str = "structured"
) -> Dynamics:
    """Return the equations of motion of a model under imposed motions and loads, in the form that
    suits the model."""
    coupled = inertial_tables(model) or reads_accelerations(model)
    bodies = FreeBodies if all_free(model.layout) and not coupled else JointedBodies
    forms = {"structured": (bodies, ClosedLoops), "lagrange": (LagrangeBodies, LagrangeLoops)}
    return forms[equations][bool(model.closures)](model, motions, loads)


@program
def state_slopes(model: Model, state: State) -> Float[Array, "ny ny"]:
    """Return df/dy of y' = f(t, y) at t = 0, with the supports at rest in their reference poses."""
    dynamics = dynamics_of(model, ())
    state = completed(model, state, dynamics.coordinates.at_rest(state.q))
    zero = jnp.zeros((), state.q.dtype)
    return jax.jacfwd(lambda y: dynamics.rate(zero, y))(dynamics.pack(state))


def rates(
    model: Model, state: State, t: Float[Array, ""], motions: Motions, loads: tuple[Load, ...]
) -> tuple[Float[Array, "nv"], Float[Array, "nz"]]:
    """Return dv/dt and dz/dt."""
    held, v_dot = holding(model, state.z), acceleration(model, state, t, motions, loads)
    if not model.layout.nz:
        return v_dot, state.z
    return v_dot, state_rates(held, seen_by_forces(held, motions, loads, t, state))


def seen_by_forces(
    model: Model, motions: Motions, loads: tuple[Load, ...], t: Float[Array, ""], state: State
) -> Instant:
    """Return the frames of a model that holds its states, with accelerations if force elements read
    them."""
    if reads_accelerations(model):
        return dynamics_of(model, motions, loads).accelerated(t, state)
    return frames_at_time(model, motions, t, state)


def after_samples(
    dynamics: Dynamics, t: Float[Array, ""], y: Float[Array, "ny"]
) -> Float[Array, "ny"]:
    """Return y after the samples that controllers take at time t."""
    state = dynamics.unpack(y, t)
    held = holding(dynamics.model, state.z)
    now = seen_by_forces(held, dynamics.motions, dynamics.loads, t, state)
    z = states_after_samples(held, now)
    return jnp.asarray(y).at[len(y) - len(z) :].set(z)


def acceleration(
    model: Model, state: State, t: Any = 0.0, motions: Motions = (), loads: tuple[Load, ...] = ()
) -> Float[Array, "nv"]:
    """Return dv/dt from the equations of motion, for the speeds of the state."""
    return dynamics_of(holding(model, state.z), motions, loads).acceleration(
        jnp.asarray(t, state.q.dtype), state.q, state.v
    )
