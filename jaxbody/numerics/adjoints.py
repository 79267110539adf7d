"""Explicit Runge-Kutta steps of `diffrax.diffeqsolve` in fast loops, with derivatives in
both modes."""

import dataclasses
from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.flatten_util import ravel_pytree

from jaxbody.core.arguments import kind_of
from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Problems, Status
from jaxbody.core.results import without_derivatives
from jaxbody.numerics import step_blocks
from jaxbody.numerics.precisions import reachable
from jaxbody.numerics.runge_kutta_steps import (
    DEFECT,
    QUIET,
    InitialValueProblem,
    Jumps,
    method_of,
)

RESULTS = diffrax.RESULTS
POINTS = 13  # between the ends of a step at which it is checked, besides samples


class Driven(diffrax.ODETerm):
    """The term y' = driven(u, y, args) with u = drive(t, args), the part that depends on time only.

    `BlockAdjoint` computes u for all stages of a step at once. Both functions are traced once for
    each shape, also where diffeqsolve needs only their shapes; give functions that are defined
    once, in a module. `project`: a function (u, y, at_y, args) -> the state nearest to y that
    fulfills the constraints; `driven` then returns (y', at_y), with at_y the values at y that the
    projection needs; None without constraints. `jumps`: instants at which the state jumps."""

    drive: Callable[[Any, Any], Any]
    driven: Callable[[Any, Any, Any], Any]
    project: Callable[[Any, Any, Any, Any], Any] | None
    jumps: Jumps | None

    def __init__(
        self,
        drive: Callable[[Any, Any], Any],
        driven: Callable[[Any, Any, Any], Any],
        project: Any = None,
        jumps: Jumps | None = None,
    ):
        self.project, self.jumps = project, jumps
        self.drive, self.driven = (eqx.filter_jit(part, inline=True) for part in (drive, driven))  # pyright: ignore
        self.vector_field = jax.tree_util.Partial(
            _whole if project is None else _rate_of_whole, self.drive, self.driven
        )

    def projected(self, t, y, args):
        """Return the state nearest to y that fulfills the constraints at the time t."""
        u = self.drive(t, args)
        return self.project(u, y, self.driven(u, y, args)[1], args)  # pyright: ignore[reportOptionalCall]


def _whole(drive, driven, t, y, args):
    return driven(drive(t, args), y, args)


def _rate_of_whole(drive, driven, t, y, args):
    return _whole(drive, driven, t, y, args)[0]


class Unstarted(diffrax.AbstractStepSizeController):
    """A controller that leaves the first step to `BlockAdjoint`: diffeqsolve then neither evaluates
    the rate nor checks dt0."""

    controller: diffrax.AbstractStepSizeController

    def wrap(self, direction):
        return Unstarted(self.controller.wrap(direction))

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        return t1, None

    def adapt_step_size(self, *args, **kwargs):
        return self.controller.adapt_step_size(*args, **kwargs)


class Lasting(diffrax.AbstractAdaptiveStepSizeController):
    """A step size controller: diffrax.PIDController(rtol, atol, norm) with a shortest step. The
    integration ends only if a step is rejected and the next one would be shorter than that; a step
    that is short because it ends at a kink may be followed by longer ones."""

    rtol: Any
    atol: Any
    norm: Any
    shortest: Any

    def wrap(self, direction):
        return self

    def _rules(self):
        return diffrax.PIDController(rtol=self.rtol, atol=self.atol, norm=self.norm)

    def init(self, *args, **kwargs):
        return self._rules().init(*args, **kwargs)

    def adapt_step_size(self, *args, **kwargs):
        kept, t0, t1, jump, state, result = self._rules().adapt_step_size(*args, **kwargs)
        stuck = ~jnp.asarray(kept) & (t1 - t0 < self.shortest)
        return kept, t0, t1, jump, state, RESULTS.where(stuck, RESULTS.dt_min_reached, result)  # pyright: ignore[reportArgumentType]


def _of_solver(name: str) -> Any:
    return property(lambda self: getattr(self.solver, name))


class Wrapped(diffrax.AbstractAdaptiveSolver, diffrax.AbstractWrappedSolver):
    """The base class of solvers that wrap the user's solver and change its steps. They must not be
    nested: diffrax passes the tolerances of the controller to an implicit solver through one
    wrapper only."""

    solver: diffrax.AbstractSolver  # pyright: ignore[reportIncompatibleVariableOverride]

    term_structure = _of_solver("term_structure")
    interpolation_cls = _of_solver("interpolation_cls")
    term_compatible_contr_kwargs = _of_solver("term_compatible_contr_kwargs")
    root_finder = _of_solver("root_finder")  # of an implicit solver: diffrax sets its tolerances
    scan_kind = _of_solver("scan_kind")  # of a Runge-Kutta method: set by adjoints of diffrax
    order = _of_solver("order")
    strong_order = _of_solver("strong_order")
    error_order = _of_solver("error_order")
    init = _of_solver("init")
    func = _of_solver("func")

    def projected_step(self, terms, t0, t1, y0, args, solver_state, made_jump) -> Any:
        """Make a step that ends at P(y1), where P is the projection of a `Driven` term, if any.

        Its error is what remains after the projection, P(y1) - P(y1 - error), and the rate at the
        start of a step is evaluated again."""
        if getattr(within(terms), "project", None) is None:
            return self.solver.step(terms, t0, t1, y0, args, solver_state, made_jump)
        y1, error, dense, solver_state, result = self.solver.step(
            terms, t0, t1, y0, args, solver_state, jnp.array(True)
        )
        if error is None:
            return within(terms).projected(t1, y1, args), None, dense, solver_state, result
        there, other = jax.vmap(lambda y: within(terms).projected(t1, y, args))(
            jnp.stack([y1, y1 - error])
        )
        return (
            there,
            jnp.where(jnp.isfinite(there), there - other, jnp.inf),
            dense,
            solver_state,
            result,
        )


class Projected(Wrapped):
    """A solver that projects the state after each step onto the constraints."""

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump) -> Any:
        return self.projected_step(terms, t0, t1, y0, args, solver_state, made_jump)


class Watched(Wrapped):
    """A solver that projects the state after each step onto the constraints, and checks the step
    between its ends, as `BlockAdjoint` does.

    After a step with an error far below the tolerance, the interpolation of the next one is checked
    at points between its ends and at the sample times, otherwise in its middle only, where half
    the digits suffice:

        defect = h (f(t, y(t)) - y'(t))

    A step whose defect is too large gets an infinite error, so that any controller rejects it."""

    times: Float[Array, "nt"]
    rtol: Any
    atol: Any

    def init(self, terms, t0, t1, y0, args):
        return self.solver.init(terms, t0, t1, y0, args), jnp.zeros_like(y0[0])

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump) -> Any:
        y1, error, dense, inner, result = self.projected_step(
            terms, t0, t1, y0, args, solver_state[0], made_jump
        )
        if error is None:
            return y1, error, dense, (inner, solver_state[1]), result
        between, terms, args = without_derivatives(
            (self.interpolation_cls(t0=t0, t1=t1, **dense), terms, args)
        )
        begin, end, times, size = lax.stop_gradient(
            (t0, t1, self.times, jnp.maximum(jnp.abs(y0), jnp.abs(y1)))
        )
        tolerance = self.atol + self.rtol * size
        quiet, first = (
            lax.stop_gradient(solver_state[1]) < QUIET,
            jnp.searchsorted(times, begin, side="right").astype(int),
        )
        allowed = tolerance * jnp.where(quiet, DEFECT, self.rtol**-0.5)

        def at(i):
            sample = times[jnp.minimum(first + i - POINTS, len(times) - 1)]
            return jnp.where(i < POINTS, begin + (end - begin) * (i + 1) / (POINTS + 1), sample)

        def look(carry):
            i, _ = carry
            t = at(i)
            defect = (end - begin) * (
                terms.vf(t, between.evaluate(t), args) - between.derivative(t)
            )
            return jnp.where(quiet, i + 1, 2 * POINTS + len(times)), jnp.all(
                jnp.abs(defect) <= allowed
            )

        def more(carry):
            i, good = carry
            return good & ((i < POINTS) | ((first + i - POINTS < len(times)) & (at(i) < end)))

        _, good = lax.while_loop(more, look, (jnp.where(quiet, 0, POINTS // 2), jnp.array(True)))
        ratio = jnp.max(jnp.abs(lax.stop_gradient(error)) / tolerance)
        changed = jnp.max(jnp.abs(lax.stop_gradient(y1 - y0)) / tolerance) > self.rtol**-0.5
        return (
            y1,
            jnp.where(good, error, jnp.inf),
            dense,
            (inner, jnp.where(changed, ratio, 0.0)),
            result,
        )


class BlockAdjoint(diffrax.AbstractAdjoint):
    """An adjoint of `diffrax.diffeqsolve` for small systems on a CPU: explicit Runge-Kutta steps in
    blocks of 128, in loops that compile to fast code. Reverse mode, forward mode and forward over
    reverse work.

        k_i = h f(t + c_i h, y + sum_j a_ij k_j),   y(t + h) = y + sum_i b_i k_i,
        y(t + theta h) = y + sum_i p_i(theta) k_i
        error = norm(sum_i e_i k_i / (atol + rtol |y|)),
        next h = safety h error^(-1/order), within its limits
        defect = norm((h f(t + theta h, y(t + theta h)) - sum_i p_i'(theta) k_i)
                      /(atol + rtol |y|)),
        checked in steps that follow one with a very small error

    f is the vector field of the term, a, b, c, e and p are those of the solver. A block keeps the
    polynomials of its steps and computes the samples between them at its end. Reverse mode keeps
    the state at the start of each block with the lengths of its steps, and repeats the block; step
    lengths are constants in both modes. In a batch by jax.vmap every member has its own steps.

    Args:
        times: sample times, ascending from t0 to t1, in place of `SaveAt(ts=times)`; by default
            those of saveat. diffrax checks these while the program runs, by calls of the host, and
            JAX never stores a program that calls the host.
        first: the first or the constant step, in place of dt0 for the same reason; by default dt0
            or, if that is None, a length computed from the rates at the start.
        forward_only: True for forward mode only, as with diffrax.ForwardMode(), at less cost.

    Solvers are explicit Runge-Kutta methods of diffrax, such as Dopri8, Tsit5 or Heun;
    stepsize_controller is ConstantStepSize() or PIDController(rtol, atol), also with a norm,
    safety and limits, and in ClipStepSizeController(step_ts=...); saveat may have t0, t1, ts and
    fn. Samples after an early end are NaN. `stats["status"]` is a jb.Status, which distinguishes
    NONFINITE from DT_MIN.

    Errors, all at once: WRONG_KIND for a solver, controller, saveat, event or progress meter that
    is not supported, and for max_steps=None; TOO_LARGE for derivatives that would reserve more than
    8 GB for max_steps.

    >>> import diffrax, jax, jax.numpy as jnp
    >>> def end(k):
    ...     oscillator = diffrax.ODETerm(lambda t, y, k: jnp.stack([y[1], -k * y[0]]))
    ...     y0, steps = jnp.array([1.0, 0.0]), diffrax.PIDController(rtol=1e-10, atol=1e-12)
    ...     path = diffrax.diffeqsolve(
    ...         oscillator,
    ...         diffrax.Dopri8(),
    ...         0.0,
    ...         1.0,
    ...         None,
    ...         y0,
    ...         k,
    ...         stepsize_controller=steps,
    ...         adjoint=jb.BlockAdjoint(),
    ...     )
    ...     return path.ys[-1, 0]
    >>> print(
    ...     f"{end(4.0):.6f} {jax.grad(end)(4.0):.6f} {jax.jacfwd(end)(4.0):.6f}"
    ... )  # cos 2 and -sin 2 / 4
    -0.416147 -0.227324 -0.227324
    """

    times: Float[Array, "nt"] | None = None
    first: Float[Array, ""] | None = None
    forward_only: bool = eqx.field(static=True, default=False)

    def loop(
        self,
        *,
        args,
        terms,
        solver,
        stepsize_controller,
        event,
        saveat,
        t0,
        t1,
        dt0,
        max_steps,
        init_state,
        progress_meter,
        **_,
    ):
        control, kinks = _steps_of(stepsize_controller)
        _check(solver, control, event, saveat, max_steps, progress_meter)
        sub = saveat.subs
        times: Any = (
            jnp.concatenate([x for x in (t0[None], sub.ts, t1[None]) if x is not None])
            if self.times is None
            else self.times
        )
        y0, unravel = ravel_pytree(init_state.y)
        if control is not None and control.dtmin is None:
            control = dataclasses.replace(
                control, dtmin=reachable(1e-13, times.dtype, 1) * (times[-1] - times[0])
            )
        project = jumps = None
        if self.times is not None and isinstance(term := within(terms), Driven):
            drive, rate, project, jumps = term.drive, term.driven, term.project, term.jumps
            arguments = args
        else:
            drive, rate, arguments = _time, _rate, (_field(terms, t0, y0, unravel, args), args)
        first = dt0 if self.first is None else self.first
        method = method_of(solver)
        problem = without_derivatives(
            InitialValueProblem(
                drive, rate, method, max_steps, control, first, kinks, project, jumps
            )
        )
        if self.forward_only:
            ended = step_blocks.solve(problem, arguments, y0, times)
        else:
            ended = step_blocks.solve_both_ways((arguments, y0, times), problem=problem)
        t_end, course = times[0] + ended.tau, ended.course
        # without those added at t0 and t1
        inner = slice(1, -1) if self.times is None else slice(None)
        saved = (
            [(t0[None], y0[None])] * sub.t0
            + [(times[inner], ended.samples[inner])]
            + [(t_end[None], ended.y[None])] * sub.t1
        )
        ts, ys = (jnp.concatenate(x) for x in zip(*saved, strict=True))
        good, at_most = course.code == Status.OK.value, course.code == Status.MAX_STEPS.value
        short = RESULTS.where(at_most, RESULTS.max_steps_reached, RESULTS.dt_min_reached)  # pyright: ignore
        final = dataclasses.replace(
            init_state,
            y=unravel(ended.y),  # pyright: ignore
            tprev=t_end,
            result=RESULTS.where(good, RESULTS.successful, short),  # pyright: ignore
            num_steps=course.accepted + course.rejected,
            num_accepted_steps=course.accepted,
            num_rejected_steps=course.rejected,
            save_state=dataclasses.replace(
                init_state.save_state,
                ts=ts,
                ys=jax.vmap(lambda t, y: sub.fn(t, unravel(y), args))(ts, ys),
            ),
        )
        return final, {"status": course.code}


def within(terms: Any) -> Any:
    """Return the term that the user gave: for integration backward in time, diffeqsolve wraps it in
    another."""
    return getattr(terms, "term", terms)


def _field(terms, t0, y0, unravel, args) -> Callable[[Array, Array, Any], Array]:
    """Return the vector field as a function of vectors. Arrays in its closure become leaves of the
    function, so that derivatives with respect to them exist."""

    def field(t, y, args):
        return ravel_pytree(
            terms.vf_prod(t, unravel(y), args, terms.contr(jnp.zeros_like(t), jnp.ones_like(t)))
        )[0]

    return eqx.filter_closure_convert(field, t0, y0, args)


def _time(t, arguments):
    return t


def _rate(t, y, arguments):
    field, args = arguments
    return field(t, y, args)


def _steps_of(controller: Any) -> tuple[Any, Array | None]:
    """Return a PIDController, None for constant steps, or any other controller; and times at which
    steps end."""
    kinks, controller = (
        None,
        controller.controller if isinstance(controller, Unstarted) else controller,
    )
    if (
        isinstance(controller, diffrax.ClipStepSizeController)
        and controller.jump_ts is None
        and controller.store_rejected_steps is None
    ):
        controller, kinks = controller.controller, controller.step_ts
    return None if isinstance(controller, diffrax.ConstantStepSize) else controller, kinks


def _check(solver, control, event, saveat, max_steps, meter) -> None:
    """Check that a `BlockAdjoint` supports these options. Errors, all at once: WRONG_KIND."""
    explicit = isinstance(solver, diffrax.AbstractERK) and len(solver.tableau.c) > 0  # pyright: ignore
    integral = isinstance(control, diffrax.PIDController) and (
        (control.pcoeff, control.icoeff, control.dcoeff, control.dtmax) == (0, 1, 0, None)
        and not (control.dtmin is not None and control.force_dtmin)
    )
    steps = (
        "diffrax.ConstantStepSize() or PIDController(rtol=..., atol=...), with default "
        "coefficients, no dtmax and no force_dtmin"
    )
    plain = not (saveat.dense or saveat.solver_state or saveat.controller_state or saveat.made_jump)
    saved = plain and isinstance(saveat.subs, diffrax.SubSaveAt) and not saveat.subs.steps
    with Problems() as problems:
        for name, value, fits, limit in (
            (
                "solver",
                solver,
                explicit,
                "an explicit Runge-Kutta method of diffrax with two stages or more",
            ),
            ("stepsize_controller", control, control is None or integral, steps),
            ("saveat", saveat, saved, "diffrax.SaveAt of t0, t1, ts and fn alone"),
            ("event", event, event is None, "None"),
            ("max_steps", max_steps, max_steps is not None, "a number"),
            (
                "progress_meter",
                meter,
                isinstance(meter, diffrax.NoProgressMeter),
                "diffrax.NoProgressMeter()",
            ),
        ):
            if not fits:
                problems.add(
                    "WRONG_KIND",
                    f"BlockAdjoint.{name}",
                    f"is {kind_of(value)}",
                    value=value,
                    limit=limit,
                )
