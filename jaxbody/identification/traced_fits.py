"""Fits inside jit and vmap, by optimistix: one program, differentiable in forward mode by the implicit function theorem."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array

from jaxbody.core.errors import Status
from jaxbody.identification.residuals import Task, away, residual_and_jacobian


@eqx.filter_custom_jvp  # the task's solver and step controller may hold functions
def _residual(task: Task, size, u):
    """r/size, whose derivative in u is the J that comes with r: a loop linearized by itself would run twice."""
    return residual_and_jacobian(task, u)[0] / size


@_residual.def_jvp
def _residual_jvp(primals, tangents):
    task, size, u = primals
    r, J, _ = residual_and_jacobian(task, u)
    return r / size, J @ tangents[2] / size


@eqx.filter_jit
def _minimize(task: Task, u, method, most: int) -> tuple[Array, Array, Array]:
    """The optimum by optimistix, a status and the number of steps."""
    signal = sum(jnp.sum((away(e, name) / e.channels[name].spread(task.noise[run][name])) ** 2) for run, e in task.experiments.items() for name in e.channels)  # fmt: skip
    size = jnp.sqrt(jnp.where(signal > 0, signal, 1.0))  # residuals over it are of the order of one, from where such methods set out
    found = optimistix.least_squares(lambda u, args: _residual(*args, u), method, u, (task, size), options={"jac": "fwd"}, max_steps=most, throw=False)  # fmt: skip
    failed = found.result != optimistix.RESULTS.successful
    return found.value, jnp.where(failed, Status.NOT_CONVERGED.value, Status.OK.value), found.stats["num_steps"]


@eqx.filter_jit
def solve(task: Task, u, method, most: int) -> tuple[Array, Array, Array]:
    """`_minimize`, in one program inside jit and vmap too, differentiable in forward mode by the implicit function theorem."""
    numbers, rest = eqx.partition(method, eqx.is_array)
    arrays, static = eqx.partition(task, eqx.is_array)

    @jax.custom_jvp
    def optimum(arrays, u, numbers):
        return _minimize(eqx.combine(jax.lax.stop_gradient(arrays), static), u, eqx.combine(numbers, rest), most)

    @optimum.defjvp
    def optimum_jvp(primals, tangents):
        arrays = primals[0]
        u, status, steps = optimum(*primals)

        def gradient(along):
            """Of the cost, u moved and the task moved along its tangent; one program for both derivatives."""
            moved = jax.tree.map(lambda x, dx: x if dx.dtype == jax.dtypes.float0 else x + along[-1] * dx, arrays, tangents[0])
            r, J, _ = residual_and_jacobian(eqx.combine(moved, static), u + along[:-1])
            return J.T @ r

        slopes = jax.jacfwd(gradient)(jnp.zeros(task.size + 1))
        H, change = slopes[:, :-1], slopes[:, -1]
        still = [np.zeros(jnp.shape(x), jax.dtypes.float0) for x in (status, steps)]
        return (u, status, steps), (-jnp.linalg.solve(jnp.where(status == 0, H, jnp.nan), change), *still)

    return optimum(arrays, u, numbers)
