"""Small motions about a steady spin: the Jacobian of the equations of motion, with its gyroscopic and centrifugal parts.

With q = q0(t) (+) delta, v = v0 + nu along the motion q0(t) at constant speeds v0, the equations of motion are, to first order,

    delta' = E delta + nu,   nu' = A delta + B nu        so   M delta'' + (C + G) delta' + K delta = 0,
    C + G = -M (E + B),   K = -M (A - B E)

E is the rotation of the chart with the motion (w x for a free body). The motion is steady if v0' = 0 and these matrices are constant along
it.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.compilation.compile_options import jit_unoptimized
from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Status
from jaxbody.core.results import warn_if_failed
from jaxbody.inputs.motions import AtRest
from jaxbody.mechanics.closed_loops import dynamics_of
from jaxbody.mechanics.equations_of_motion import Dynamics
from jaxbody.mechanics.hessians import configuration_at, damping, mass, stiffness
from jaxbody.models.models import Model
from jaxbody.models.preconditions import check_precision, check_state, check_without_memory
from jaxbody.models.sizes import scale_of, scaled, size_of
from jaxbody.models.states import State
from jaxbody.numerics.precisions import reachable
from jaxbody.vibrations.linearizations import LinearSystem

STEADY = 1e-8  # change of speeds and of matrices, relative to their terms, below which it is round-off
ALONG = (0.7, 1.9, 4.1)  # rad of spin at which the matrices must be the same; no two in a simple ratio


class SpinLinearization(LinearSystem):
    """M delta'' + (C + G) delta' + K delta = 0 about a steady motion `state`; rows and columns as in `coordinates`.

    The chart is that of `linearize`, about the moving body. `G`: gyroscopic, skew; `K`: the total stiffness, `K_centrifugal` its part due
    to the motion. `status` NOT_STEADY if the state is not a steady motion; the matrices are then those of an instant."""

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
        if not int(self.status):
            return ""
        worst = int(np.argmax(np.abs(self.acceleration)))
        message = f"the largest change of speed is {float(self.acceleration[worst]):.3g} /s2 in '{self.coordinates[worst]}'"
        return message + "; spin a body about its axis of symmetry, in equilibrium, without loads or dampers that turn with it or brake it"


def linearize_spin(model: Model, at: State) -> SpinLinearization:
    """Mass, damping, gyroscopic and stiffness matrix of small motions about a steady motion, such as that of a rotor, with the supports at
    rest.

        M delta'' + (C + G) delta' + K delta = 0

    The Jacobian of the equations of motion at (q, v). It must not depend on time: a spinning body must be axisymmetric about its axis of
    spin, free or on a hinge, and elements must be attached to it on that axis. Errors: BAD_SHAPE, NON_FINITE for the state; warns
    NOT_STEADY.
    Source: G. Genta, Dynamics of Rotating Systems (2005), 2.3.

    A disk with 0.2 kg m2 about its axis z, spinning at 30 rad/s, has G = 0.2 x 30 between its transverse rotations:

    >>> spring = Spring(("disk", [0, 0, 0.5]), ("world", [0, 0, 1]), stiffness=10.0)
    >>> model = Model(bodies={"disk": Body(mass=1.0, inertia=[0.1, 0.1, 0.2])}, elements={"s": spring})
    >>> lin = linearize_spin(replace(model, {"s.free_length": 0.5}), State(model.reference.q, jnp.array([0, 0, 0, 0, 0, 30.0])))
    >>> round(float(lin.G[3, 4]), 9)
    6.0
    """
    check_precision("linearize_spin", model)
    check_without_memory("linearize_spin", model)
    check_state(model, at, "at")
    return warn_if_failed(_linearize_spin(model, at))


@jit_unoptimized
def _linearize_spin(model: Model, state: State) -> SpinLinearization:
    q, v = state.q, state.v
    dynamics = dynamics_of(model, tuple(AtRest() for _ in model.layout.supports))
    M, D, K, v_dot = _second_order(dynamics, q, v)
    at = configuration_at(dynamics.coordinates, q, v, base=False)
    C, K_rest = damping(at), stiffness(at)
    size = size_of(model)
    scale = scale_of(model, size)
    fastest = jnp.max(jnp.abs(v / scale) / size, initial=0.0)  # rad/s, of translations in sizes of the model
    period = jnp.where(fastest > 0, 1 / jnp.where(fastest > 0, fastest, 1.0), 0.0)

    def matrices(angle):
        return _second_order(dynamics, dynamics.coordinates.retract(q, v * period * angle), v)[1:3]

    def largest(X):
        return jnp.max(jnp.abs(scaled(X, scale)), (-2, -1), initial=0.0)

    later_D, later_K = jax.vmap(matrices)(jnp.array(ALONG, q.dtype))
    inertia = largest(M)
    stiff = jnp.maximum(largest(K), inertia * fastest**2)
    steady = reachable(STEADY, M.dtype, 1024)
    changes = (largest(later_D - D[None]) > steady * (largest(D) + inertia * fastest)) | (largest(later_K - K[None]) > steady * stiff)
    accelerates = jnp.max(jnp.abs(M @ v_dot * scale), initial=0.0) > steady * stiff * size
    status = jnp.where(accelerates | changes.any(), Status.NOT_STEADY.value, Status.OK.value)
    return SpinLinearization(M, C, K, status, state, model, D - C, K - K_rest, v_dot)


def _second_order(dynamics: Dynamics, q: Float[Array, "nq"], v: Float[Array, "nv"]):
    """M, C + G, K and v', at any state."""
    coordinates, n = dynamics.coordinates, len(v)
    zero = jnp.zeros_like(v)

    def rates(x):
        delta, nu = x[:n], x[n:]
        moved, along = jax.jvp(lambda q: coordinates.retract(q, delta), (q,), (coordinates.rate(q, v),))
        v_dot = dynamics.acceleration(jnp.zeros((), q.dtype), moved, v + nu)
        return (coordinates.rate(moved, v + nu) - along, v_dot), v_dot

    (chart, J), v_dot = jax.jacfwd(rates, has_aux=True)(jnp.concatenate([zero, zero]))
    turns = jax.jacfwd(lambda delta: coordinates.retract(q, delta))(zero)
    E = jnp.linalg.solve(turns.T @ turns, turns.T @ chart[:, :n])
    A, B = J[:, :n], J[:, n:]
    M = mass(configuration_at(coordinates, q, base=False))
    return M, -M @ (E + B), -M @ (A - B @ E), v_dot
