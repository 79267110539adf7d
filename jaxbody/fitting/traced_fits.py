"""Fits inside jit and vmap by optimistix: one program, differentiable in forward mode by the
implicit function theorem."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from jaxbody.core.arrays import Array
from jaxbody.core.compilation.compile_options import program_with
from jaxbody.core.errors import Status
from jaxbody.fitting.residuals import (
    Task,
    options_of,
    residual_and_jacobian,
    residuals_of_mean,
)


# not jax.custom_jvp: the task's solver and step controller may contain functions
@eqx.filter_custom_jvp
def _residual(task: Task, size, u):
    """r/size, with the Jacobian that is evaluated together with r as its derivative, because JAX
    would otherwise run the simulation twice."""
    return residual_and_jacobian(task, u)[0] / size


@_residual.def_jvp
def _residual_jvp(primals, tangents):
    task, size, u = primals
    r, J, _ = residual_and_jacobian(task, u)
    return r / size, J @ tangents[2] / size


def _minimize(task: Task, u, method, max_steps: int) -> tuple[Array, Array, Array]:
    """The optimum by optimistix, a status and the number of steps."""
    signal = sum(
        jnp.sum((residuals_of_mean(e, name) / e.channels[name].spread(task.noise[run][name])) ** 2)
        for run, e in task.experiments.items()
        for name in e.channels
    )
    # scales the residuals to the order of one, which such methods expect
    size = jnp.sqrt(jnp.where(signal > 0, signal, 1.0))
    result = optimistix.least_squares(
        lambda u, args: _residual(*args, u),
        method,
        u,
        (task, size),
        options={"jac": "fwd"},
        max_steps=max_steps,
        throw=False,
    )
    failed = result.result != optimistix.RESULTS.successful
    return (
        result.value,
        jnp.where(failed, Status.NOT_CONVERGED.value, Status.OK.value),
        result.stats["num_steps"],
    )


@program_with(options_of)
def solve(task: Task, u, method, max_steps: int) -> tuple[Array, Array, Array]:
    """`_minimize` with its derivative: one program, also inside jit and vmap.

    H du = -dg for the change dg of the gradient of the cost at fixed u, H the exact Hessian of
    the cost."""
    numbers, rest = eqx.partition(method, eqx.is_array)
    arrays, static = eqx.partition(task, eqx.is_array)

    @jax.custom_jvp
    def optimum(arrays, u, numbers):
        return _minimize(
            eqx.combine(jax.lax.stop_gradient(arrays), static),
            u,
            eqx.combine(numbers, rest),
            max_steps,
        )

    @optimum.defjvp
    def optimum_jvp(primals, tangents):
        arrays = primals[0]
        u, status, steps = optimum(*primals)

        def gradient(along):
            """The gradient of the cost after steps of u and of the task along its tangent; one
            program for both derivatives."""
            moved = jax.tree.map(
                lambda x, dx: x if dx.dtype == jax.dtypes.float0 else x + along[-1] * dx,
                arrays,
                tangents[0],
            )
            r, J, _ = residual_and_jacobian(eqx.combine(moved, static), u + along[:-1])
            return J.T @ r

        slopes = jax.jacfwd(gradient)(jnp.zeros(task.space.size + 1))
        H, change = slopes[:, :-1], slopes[:, -1]
        zeros: list[Any] = [np.zeros(jnp.shape(x), jax.dtypes.float0) for x in (status, steps)]
        return (u, status, steps), (
            -jnp.linalg.solve(jnp.where(status == 0, H, jnp.nan), change),
            zeros[0],
            zeros[1],
        )

    return optimum(arrays, u, numbers)
