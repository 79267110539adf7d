"""Constrained minimization by IPOPT's interior-point method through CasADi, an optional dependency
of 280 MB."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

Sizes = list[tuple[int, int]]
# u -> f, its gradient, c, its Jacobian
At = Callable[[np.ndarray], tuple[float, np.ndarray, np.ndarray, np.ndarray]]


def minimize_by_ipopt(
    at: At,
    u: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    limits: tuple[np.ndarray, np.ndarray],
    iterations: int,
    tolerance: float,
) -> int:
    """Minimize f(u) within bounds on u and limits on c(u), with second derivatives by
    limited-memory updates, and return the number of iterations.

    Args:
        at: u -> f, its gradient, c and its Jacobian; it also keeps the best point.
        u: the initial guess.
        bounds: lower and upper bounds on u.
        limits: lower and upper limits of c.
        iterations: largest number of iterations.
        tolerance: IPOPT's convergence tolerance.

    Source: A. Waechter, L. Biegler, Mathematical Programming 106 (2006) 25."""
    import casadi  # pyright: ignore

    n, m = len(u), len(limits[0])

    class Callback(casadi.Callback):
        """The base class of functions that CasADi calls, with dense matrices of the given sizes."""

        def __init__(self, name: str, given: Sizes, returned: Sizes, options: Any):
            casadi.Callback.__init__(self)
            self.given, self.returned = given, returned
            self.construct(name, options)

        def get_n_in(self):
            return len(self.given)

        def get_n_out(self):
            return len(self.returned)

        def get_sparsity_in(self, i):
            return casadi.Sparsity.dense(*self.given[i])

        def get_sparsity_out(self, i):
            return casadi.Sparsity.dense(*self.returned[i])

    class Slopes(Callback):
        """The derivatives of f and c with respect to u; CasADi also passes their values."""

        def eval(self, given):
            _, slopes, _, jacobian = at(np.asarray(given[0]).ravel())
            return [slopes[None], jacobian]

    class Values(Callback):
        """The values of f and c at u."""

        def eval(self, given):
            f, _, c, _ = at(np.asarray(given[0]).ravel())
            return [f, c]

        def has_jacobian(self):
            return True

        def get_jacobian(self, name, inputs, outputs, options):
            # CasADi does not keep a reference
            self.slopes = Slopes(name, [*self.given, *self.returned], [(1, n), (m, n)], options)
            return self.slopes

    values, x = Values("values", [(n, 1)], [(1, 1), (m, 1)], {}), casadi.MX.sym("u", n)
    f, c = values(x)
    options = {
        "print_time": False,
        "error_on_fail": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": iterations,
        "ipopt.tol": tolerance,
        "ipopt.hessian_approximation": "limited-memory",
    }
    solver = casadi.nlpsol("solver", "ipopt", {"x": x, "f": f, "g": c}, options)
    solver(x0=u, lbx=bounds[0], ubx=bounds[1], lbg=limits[0], ubg=limits[1])
    return int(solver.stats()["iter_count"])
