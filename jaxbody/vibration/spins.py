"""Small motions about a steady spin: the Jacobian of the equations of motion, with its gyroscopic
and centrifugal parts.

With q = q0(t) (+) delta, v = v0 + nu along the motion q0(t) at constant speeds v0, the equations of
motion are, to first order,

    delta' = E delta + nu,
    nu' = A delta + B nu        so   M delta'' + (C + G) delta' + K delta = 0,
    C + G = -M (E + B),   K = -M (A - B E)

E is the rotation of the chart with the motion (w x for a free body). The motion is steady if
v0' = 0 and these matrices are constant along it. With closures delta and nu are those of the
independent coordinates: q = q0 (+) N(q0) delta, v = N(q) (v0 + nu).
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Status
from jaxbody.core.results import warn_if_failed
from jaxbody.lagrange import force_matrices
from jaxbody.mechanics.closed_loops import dynamics_of
from jaxbody.mechanics.constraints import how_open
from jaxbody.mechanics.dynamics import Dynamics
from jaxbody.mechanics.free_motions import closure_stiffness, dependent_motions, speeds_on_closures
from jaxbody.mechanics.hessians import configuration_at, damping, mass, slope, stiffness
from jaxbody.model.inputs.motions import AtRest
from jaxbody.model.models import Model, scale_of, scaled, size_of
from jaxbody.model.preconditions import (
    check_small_motions,
    check_state,
    check_without_memory,
)
from jaxbody.model.states import State
from jaxbody.numerics.precisions import reachable
from jaxbody.vibration.linearizations import NEARLY_CLOSED, SINGULAR_CLOSURES, LinearSystem
from jaxbody.vibration.mode_names import basis_of

# change of speeds and of matrices, relative to their terms, below which it is round-off
STEADY = 1e-8
# angles of spin [rad] at which the matrices must be the same; no two have a simple ratio
ALONG = (0.7, 1.9, 4.1)


class SpinLinearization(LinearSystem):
    """M delta'' + (C + G) delta' + K delta = 0 about a steady motion `state`; rows and columns as
    in `coordinates`.

    The chart is that of `linearize`, about the moving body. `G`: gyroscopic, skew; `K`: the total
    stiffness, `K_centrifugal` its part due to the motion. `status` NOT_STEADY if the state is not a
    steady motion; the matrices are then those of an instant."""

    G: Float[Array, "nv nv"]
    K_centrifugal: Float[Array, "nv nv"]
    acceleration: Float[Array, "nv"]
    printed = ("M", "C", "G", "K")
    exported = ("M", "C", "G", "K", "K_centrifugal")

    @property
    def D(self) -> Float[Array, "nv nv"]:
        return self.C + self.G

    def note(self):
        return self.report()

    def explain(self) -> str:
        if int(self.status) != Status.NOT_STEADY:
            return ""
        worst = int(np.argmax(np.abs(self.acceleration)))
        return (
            f"the largest change of speed is {float(self.acceleration[worst]):.3g} /s2 in "
            f"'{self.coordinates[worst]}'; spin a body about its axis of symmetry, in equilibrium, "
            "without loads or dampers that turn with it or brake it"
        )


def linearize_spin(model: Model, at: State) -> SpinLinearization:
    """Compute the mass, damping, gyroscopic and stiffness matrices of small motions about a steady
    motion, such as that of a rotor, with the supports at rest.

        M delta'' + (C + G) delta' + K delta = 0

    They are the Jacobian of the equations of motion at (q, v), which must not depend on time: a
    spinning body must be axisymmetric about its axis of spin, free or on a hinge, and elements must
    be attached to it on that axis. Errors: BAD_SHAPE, NON_FINITE for the state, CLOSED_LOOPS for a
    model with closures built from traced numbers, NOTHING_MOVES; warns NOT_STEADY, and NOT_CLOSED,
    also for speeds that do not fit the closures, and SINGULAR_CLOSURE.
    Source: G. Genta, Dynamics of Rotating Systems (2005), 2.3.

    A disk with 0.2 kg m2 about its axis z, spinning at 30 rad/s, has G = 0.2 x 30 between its
    transverse rotations:

    >>> spring = jb.Spring(("disk", [0, 0, 0.5]), ("world", [0, 0, 1]), stiffness=10.0)
    >>> model = jb.Model(
    ...     bodies={"disk": jb.Body(mass=1.0, inertia=[0.1, 0.1, 0.2])}, elements={"s": spring}
    ... )
    >>> lin = jb.vibration.linearize_spin(
    ...     jb.replace(model, {"s.free_length": 0.5}),
    ...     jb.State(model.reference.q, jnp.array([0, 0, 0, 0, 0, 30.0])),
    ... )
    >>> round(float(lin.G[3, 4]), 9)
    6.0
    """
    check_small_motions("linearize_spin", model)
    check_without_memory("linearize_spin", model)
    check_state(model, at, "at")
    return warn_if_failed(_linearize_spin(model, at))


@program
def _linearize_spin(model: Model, state: State) -> SpinLinearization:
    q, own = state.q, np.array(model.independent or (), int)
    dynamics, v = dynamics_of(model, tuple(AtRest() for _ in model.layout.supports)), state.v[own]
    M, D, K, v_dot = _second_order(dynamics, q, v)
    at = configuration_at(dynamics.coordinates, q, state.v, base=False)
    C, K_rest, moves = damping(at), stiffness(at), None
    if model.forces:
        n = len(state.v)
        C, K_rest = (
            H + part[:n, :n]
            for H, part in zip((C, K_rest), force_matrices(model, state, ())[1:], strict=True)
        )
    if model.closures:
        moves, nv = (
            dependent_motions(dynamics.coordinates, q, slope(at), tuple(own.tolist())),
            len(state.v),
        )
        C, K_rest = (
            moves.of(C),
            moves.of(
                K_rest + closure_stiffness(dynamics.coordinates, q, moves.multipliers)[:nv, :nv]
            ),
        )
    size = size_of(model)
    all_scales = scale_of(model, size)
    scale = all_scales[own]
    # largest speed [rad/s], for translations in sizes of the model per second
    fastest = jnp.max(jnp.abs(state.v / all_scales) / size, initial=0.0)
    period = jnp.where(fastest > 0, 1 / jnp.where(fastest > 0, fastest, 1.0), 0.0)

    def matrices(angle):
        return _second_order(
            dynamics, dynamics.coordinates.retract(q, state.v * period * angle), v
        )[1:3]

    def largest(X):
        return jnp.max(jnp.abs(scaled(X, scale)), (-2, -1), initial=0.0)

    later_D, later_K = jax.vmap(matrices)(jnp.array(ALONG, q.dtype))
    inertia = largest(M)
    stiff = jnp.maximum(largest(K), inertia * fastest**2)
    steady = reachable(STEADY, M.dtype, 1024)
    changes = (largest(later_D - D[None]) > steady * (largest(D) + inertia * fastest)) | (
        largest(later_K - K[None]) > steady * stiff
    )
    accelerates = jnp.max(jnp.abs(M @ v_dot * scale), initial=0.0) > steady * stiff * size
    status = jnp.where(accelerates | changes.any(), Status.NOT_STEADY.value, Status.OK.value)
    if moves is not None:
        apart = jnp.max(jnp.abs((moves.N @ v - state.v) / all_scales))
        fails = [
            moves.smallest < SINGULAR_CLOSURES,
            (apart > NEARLY_CLOSED * fastest * size)
            | (how_open(dynamics.coordinates, q) > NEARLY_CLOSED),
        ]
        status = jnp.select(fails, [Status.SINGULAR_CLOSURE.value, Status.NOT_CLOSED.value], status)
    return SpinLinearization(
        M, C, K, status, state, model, basis_of(at), D - C, K - K_rest, v_dot, dependent=moves
    )


def _second_order(dynamics: Dynamics, q: Float[Array, "nq"], v: Float[Array, "nf"]):
    """Return M, C + G, K and v' of the independent coordinates, at any state."""
    coordinates, n, own = (
        dynamics.coordinates,
        len(v),
        np.array(dynamics.model.independent or (), int),
    )
    zero = jnp.zeros_like(v)

    def whole(q, speeds):  # N(q) times those of the independent coordinates
        return speeds_on_closures(coordinates, q, speeds) if dynamics.model.closures else speeds

    def displaced(q, delta):
        return coordinates.retract(q, whole(q, delta))

    def rates(x):
        delta, nu = x[:n], x[n:]
        moved, along = jax.jvp(
            lambda q: displaced(q, delta), (q,), (coordinates.rate(q, whole(q, v)),)
        )
        speeds = whole(moved, v + nu)
        v_dot = dynamics.acceleration(jnp.zeros((), q.dtype), moved, speeds)[own]
        return (coordinates.rate(moved, speeds) - along, v_dot), v_dot

    (chart, J), v_dot = jax.jacfwd(rates, has_aux=True)(jnp.concatenate([zero, zero]))
    turns = jax.jacfwd(lambda delta: displaced(q, delta))(zero)
    E = jnp.linalg.solve(turns.T @ turns, turns.T @ chart[:, :n])
    A, B = J[:, :n], J[:, n:]
    M, N = (
        mass(configuration_at(coordinates, q, base=False)),
        jax.jacfwd(lambda delta: whole(q, delta))(zero),
    )
    M = N.T @ M @ N
    return M, -M @ (E + B), -M @ (A - B @ E), v_dot
