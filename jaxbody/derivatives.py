"""First and second derivatives of V, T and R in structured form, a tenth of the work of jax.hessian, which remains their definition.

    slope     dV/d(Delta, Xi) = -d/d(v, Xi') of the virtual power, sum of F . v + M . w over the frames
    K         the symmetric part of d slope/d(Delta, Xi): what the increments of rotations add is skew
    M         sum of m J_C' J_C + J_w' J J_w,   J the velocities of the bodies per unit of (v, Xi')
    C         sum of J_e' R'' J_e,              J_e the rates of the deformations per unit of (v, Xi')

Rows: the speeds v, then six for each support.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbody.frames import Frame, Pose
from jaxbody.kinematics import Coordinates
from jaxbody.mechanics import each_element, wrenches
from jaxbody.models import Model, reference_poses
from jaxbody.rotations import product, rotate_back, skew

Vector = Float[Array, "n"]
Square = Float[Array, "n n"]


def slope(model: Model, q: Float[Array, "nq"], xi: Float[Array, "nxi"]) -> Vector:
    """dV/d(Delta, Xi) at rest, supports displaced by a small Xi."""
    F, M = wrenches(model, _moving(model, q, xi, jnp.zeros(model.layout.nv + model.layout.nxi, q.dtype)))

    def virtual_power(speeds):
        frames = _moving(model, q, xi, speeds)
        return jnp.sum(F * frames.v) + jnp.sum(M * frames.w)

    return -jax.grad(virtual_power)(jnp.zeros(model.layout.nv + model.layout.nxi, q.dtype))


def stiffness(model: Model, q: Float[Array, "nq"], *, base: bool = True) -> tuple[Vector, Square]:
    """dV/d(Delta, Xi) and K | -K~ | K_bb as one matrix, supports at their reference poses; without `base`, those of Delta alone."""
    n, nxi = model.layout.nv, model.layout.nxi
    size = n + nxi if base else n

    def displaced(x):
        x = jnp.concatenate([x, jnp.zeros(n + nxi - size, x.dtype)])
        g = slope(model, q + Coordinates(model).rate(q, x[:n]), x[n:])[:size]
        return g, g

    D, g = jax.jacfwd(displaced, has_aux=True)(jnp.zeros(size, q.dtype))
    return g, (D + D.T) / 2


def mass(model: Model, q: Float[Array, "nq"]) -> Square:
    """M | -M~ | M_bb as one matrix."""
    bodies, first = model.bodies.rows, model.layout.first_body

    def velocities(speeds):
        moving = _moving(model, q, jnp.zeros(model.layout.nxi, q.dtype), speeds)[first:]
        return moving.velocity(bodies.com), rotate_back(moving.R, moving.w)

    J_C, J_w = jax.jacfwd(velocities)(jnp.zeros(model.layout.nv + model.layout.nxi, q.dtype))
    turning = jnp.einsum("bij,bjn->bin", (bodies.inertia + jnp.swapaxes(bodies.inertia, -1, -2)) / 2, J_w)
    return jnp.einsum("b,bim,bin->mn", bodies.mass, J_C, J_C) + jnp.einsum("bim,bin->mn", J_w, turning)


def damping(model: Model, q: Float[Array, "nq"], v: Float[Array, "nv"]) -> Square:
    """C | -C~ | C_bb as one matrix, at the speeds v."""
    xi = jnp.zeros(model.layout.nxi, q.dtype)

    def rates(speeds):
        return tuple(each_element(model, _moving(model, q, xi, speeds), lambda s, A, B: s.rates(A, B)))

    speeds = jnp.concatenate([v, xi])
    C = jnp.zeros((len(speeds), len(speeds)), q.dtype)
    for table, (e, e_dot), (_, J) in zip(model.elements, rates(speeds), jax.jacfwd(rates)(speeds), strict=True):
        rows, n = len(table), len(speeds)
        second = jax.vmap(lambda s, e, e_dot: jax.hessian(lambda x, s=s, e=e: s.dissipation(e, x))(e_dot))(table.rows, e, e_dot)
        J = J.reshape(rows, -1, n)
        C += jnp.einsum("eim,eij,ejn->mn", J, second.reshape(rows, J.shape[1], J.shape[1]), J)
    return C


def _moving(model: Model, q, xi, speeds) -> Frame:
    """Frames for speeds (v, Xi'), supports displaced to first order by Xi: R0 + [phi] R0."""
    still = reference_poses(model)[0]
    xi, xi_dot = xi.reshape(-1, 6), speeds[model.layout.nv :].reshape(-1, 6)
    pose = Pose(still.p + xi[:, :3], still.R + product(skew(xi[:, 3:]), still.R))
    supports = Frame(pose.p, pose.R, xi_dot[:, :3], xi_dot[:, 3:])
    return Coordinates(model).frames(q, speeds[: model.layout.nv], supports)
