"""Solvers of diffrax whose steps end with a projection."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from diffrax import AbstractAdaptiveSolver, AbstractSolver, AbstractWrappedSolver

from jaxbody.numerics.adjoints import within


class Projected(AbstractAdaptiveSolver, AbstractWrappedSolver):
    """A solver whose steps end at P(y1), with P of a `Driven` term. Its error is what is left after the projection, P(y1) - P(y1 - error),
    and the rate at the start of a step is evaluated again."""

    solver: AbstractSolver  # pyright: ignore[reportIncompatibleVariableOverride]

    @property
    def term_structure(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.solver.term_structure

    @property
    def interpolation_cls(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.solver.interpolation_cls

    @property
    def term_compatible_contr_kwargs(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.solver.term_compatible_contr_kwargs

    @property
    def root_finder(self):
        """That of an implicit solver, to which diffeqsolve gives the tolerances of the controller."""
        return self.solver.root_finder  # pyright: ignore[reportAttributeAccessIssue]

    def order(self, terms):
        return self.solver.order(terms)

    def strong_order(self, terms):
        return self.solver.strong_order(terms)

    def error_order(self, terms):
        return self.solver.error_order(terms)

    def init(self, terms, t0, t1, y0, args):
        return self.solver.init(terms, t0, t1, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump) -> Any:
        y1, error, dense, solver_state, result = self.solver.step(terms, t0, t1, y0, args, solver_state, jnp.array(True))
        if error is None:
            return within(terms).projected(t1, y1, args), None, dense, solver_state, result
        there, other = jax.vmap(lambda y: within(terms).projected(t1, y, args))(jnp.stack([y1, y1 - error]))
        return there, jnp.where(jnp.isfinite(there), there - other, jnp.inf), dense, solver_state, result

    def func(self, terms, t0, y0, args):
        return self.solver.func(terms, t0, y0, args)
