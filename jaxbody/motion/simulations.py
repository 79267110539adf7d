"""Nonlinear motion: the equations of motion integrated under imposed motions of the supports, and
as a function of time, state and model for your own solver."""

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import (
    check_one_of,
    checked_dict,
)
from jaxbody.core.arrays import (
    Array,
    Float,
    check_times,
    concrete,
    device_array,
    float_array,
    is_concrete,
    part_of,
    time_text,
)
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, unknown, warn
from jaxbody.core.progress_lines import working
from jaxbody.core.results import warn_if_failed, without_derivatives
from jaxbody.mechanics.closed_loops import rates
from jaxbody.mechanics.failure_causes import force_jump_messages, force_jumps_along
from jaxbody.mechanics.quasi_static_states import Rest, as_initial, initial_state_of
from jaxbody.model.forces.controllers import check_continuous
from jaxbody.model.inputs.loads import Load, loads_of
from jaxbody.model.inputs.motions import AtRest, Motion, as_motion, check_motion
from jaxbody.model.joints.kinematics import Chart, Motions
from jaxbody.model.models import Model, size_of
from jaxbody.model.preconditions import check_moves, check_precision, check_state, unattached
from jaxbody.model.states import State
from jaxbody.motion.integrations import (
    check_steps,
    integrate,
    most_steps,
    signals_of_run,
    warn_of_long_steps,
    warn_of_slow_sampling,
    warn_of_what_steps_pass_over,
)
from jaxbody.motion.trajectories import Trajectory

MAX_STEPS = 100_000  # or PER_SAMPLE times the number of samples, if that is more
# number of rejected steps, and their ratio to accepted ones, from which a jump of a force is
# suspected; a jump costs 18 rejected steps at rtol 1e-3, 30 to 90 by default
MANY, OFTEN = 15, 0.15
# distance of an attached body from all supports, in sizes of the model, above which a motion is
# reported as diverged
FAR = 1e6
# gap of an initial state, relative to the size of the model or to the largest speed, above which it
# is moved onto the closures with a warning
OPEN = 1e-6


def simulate(
    model: Model,
    times,
    *,
    motion: dict[str, Motion | Callable] | None = None,
    loads: dict[str, Load] | None = None,
    initial: State | Rest | str | None = None,
    rtol: float | Array = 1e-8,
    solver: diffrax.AbstractSolver | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    dt0: float | Array | None = None,
    max_steps: int | None = None,
    progress: bool | None = None,
    equations: str = "structured",
) -> Trajectory:
    """Integrate the motion from `initial` at times[0], sampled at `times` [s], which may be far
    from zero, such as Unix times: the integration counts time from times[0], and evaluates motions
    and loads by their method `after(times[0])`.

    Args:
        motion: {support: motion}; a support without an entry is at rest.
        loads: {name: load} on bodies; by default none.
        initial: a State, or "rest": in equilibrium on the supports in their poses and motion at
            times[0], without loads; by default the reference pose at rest. With closures the motion
            starts from the nearest state that fulfills them.
        rtol: ten times the relative local error allowed in any component, so that samples between
            steps also meet it; at least 1.5e-4 in float32. The absolute error is rtol/100 times
            the size of the model (for velocities, times its fastest frequency, roughly), or
            without extent times an estimate of how far it moves, from its start, gravity, loads
            and supports.
        solver: a diffrax solver; by default Dopri8.
        stepsize_controller: a diffrax controller; by default the error controls the steps; with
            diffrax.ConstantStepSize() they are dt0.
        adjoint: a diffrax adjoint; by default jb.BlockAdjoint(), with which forward and reverse
            mode work, and forward over reverse. For few parameters diffrax.ForwardMode() is faster;
            with a `solver` forward mode requires it, or jb.BlockAdjoint().
        dt0: the first step, or the constant step [s]; by default chosen automatically.
        max_steps: the largest number of steps; by default 100,000, or 30 for each sample if that
            is more.
        equations: "structured", or "lagrange": those of L = T - V and R by JAX's derivatives, as
            `lagrange.py` states them, more slowly.
        progress: None shows the time taken on a terminal or in a notebook after five seconds; False
            is silent, True shows diffrax's meter.

    With a solver, another stepsize_controller or adjoint, or progress=True, diffrax's own loop
    replaces the blocks. A batch by jax.vmap runs in chunks of 40, each member with its own steps;
    constant steps take half the time, but nothing controls the error: compare with a shorter dt0.

    Results are at the requested times; for diffrax's SaveAt (dense, steps, a function) and Event
    use `jb.equations_of_motion`.

    Steps end at kinks of motions and loads and where records begin to act. After a step that gives
    no information about the next one, as at rest or in free flight, the next step is checked
    between its ends and at `times` before it is accepted, also with other solvers that estimate the
    error; sample where something short may act. Constant steps are not checked: warns STEP_TOO_LONG
    if a motion or load changes within one of them.

    Errors by rtol after 10 s on a shaking base, of a plate on 5 springs and three boxes on 14: the
    largest error [m, rad], the relative error of a derivative by reverse mode, and the time
    (tests/benchmarks/tolerances.py):

        rtol                  1e-3   1e-4   1e-5   1e-6   1e-7   1e-8   1e-9   1e-10
        error, plate          2e-6   2e-7   3e-8   5e-9   8e-10  1e-10  3e-11  4e-12
        error, boxes          2e-5   3e-6   6e-7   9e-8   1e-8   2e-9   4e-10  7e-11
        derivative            2e-3   1e-4   1e-5   2e-6   2e-7   3e-8   4e-9   6e-10
        time                  0.3    0.35   0.45   0.6    0.8    1      1.3    1.7

    For plots 1e-5 is sufficient. The default is chosen for derivatives, whose errors are a hundred
    times as large, and for comparisons of runs, as in fits, tuning and finite differences.

    Errors: times unsorted, repeated, NaN or outside a sampled motion (T_RANGE), wrong initial
    state, UNKNOWN_NAME for a support, UNKNOWN_BODY for a load, CLOSED_LOOPS for jb.Gauss with
    closures, NOTHING_MOVES. An integration that ends early warns, and returns its samples with a
    status. Warns NOT_CLOSED for an initial state that is off the closures by more than 1e-6 of the
    model's size, SPRING_COLLAPSED for a spring that passes through zero length and HALF_TURN for a
    Bushing or Torsion past half a turn, with the time, if samples show it and many steps were
    rejected; the `summary()` of a trajectory always shows it. Warns DIVERGED for a body that is a
    million sizes of the model away from where it is attached.

    >>> import jax.numpy as jnp
    >>> spring = jb.Spring(
    ...     ("mass", [0, 0, 0]), ("base", [0, 1, 0]), stiffness=50.0, free_length=1.0
    ... )
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("base", axis=[0, 1, 0])},
    ...     supports={"base": jb.Support()},
    ...     elements={"s": spring},
    ... )
    >>> trajectory = jb.simulate(
    ...     model,
    ...     jnp.linspace(0, 1, 11),
    ...     motion={"base": jb.Harmonic(frequency=1.0, translation=[0, 0.1, 0])},
    ... )
    >>> trajectory.poses["mass"].p.shape
    (11, 3)
    """
    check_precision("simulate", model)
    if not model.layout.nz:  # elements with memory relax even between fixed bodies
        check_moves("simulate", model)
    initial = as_initial(initial)
    with Problems() as problems:
        motions = problems.gather(lambda: motions_of(model, motion))
        loads_on = problems.gather(lambda: loads_of(loads, model.layout.bodies))
        check_one_of(
            equations, ("structured", "lagrange"), "BAD_METHOD", "simulate.equations", problems
        )
        max_steps = problems.gather(
            lambda: check_steps(
                solver, stepsize_controller, dt0, rtol, max_steps, "simulate", adjoint
            )
        )
        times = problems.gather(
            lambda: check_run(
                model, times, motions or (), {} if loads_on is None else loads or {}, initial
            )
        )
    max_steps = most_steps(len(times), MAX_STEPS) if max_steps is None else max_steps
    initial = initial_state_of(model, motions, part_of(times, 0), initial, "simulate.initial")
    unattached_bodies = unattached(model)
    if unattached_bodies:
        warn("UNATTACHED", f"nothing connects {', '.join(unattached_bodies)} to world or a support")
    meter = diffrax.TextProgressMeter() if progress else diffrax.NoProgressMeter()
    # as arrays, because Python numbers would be constants of the program
    tolerance, step = (None if x is None else device_array(float_array(x)) for x in (rtol, dt0))
    warn_of_what_steps_pass_over(model, motions, loads or {}, times, stepsize_controller, step)
    warn_of_slow_sampling(model, initial)
    if isinstance(stepsize_controller, diffrax.ConstantStepSize) and is_concrete(
        model, initial, step
    ):
        warn_of_long_steps(
            model,
            initial,
            float(step),  # pyright: ignore[reportArgumentType]
            solver,  # pyright: ignore[reportArgumentType]
        )
    with working("simulate", progress), _forward_mode_explained(adjoint):
        result = integrate(
            model,
            times,
            motions,
            loads_on,
            initial,
            tolerance,
            solver,
            stepsize_controller,
            adjoint,
            step,
            max_steps,
            meter,
            equations,
        )
        if is_concrete(result.status):
            jax.block_until_ready(result.status)
    warn_if_failed(result)
    if initial is not None:  # the reference pose may be drawn open
        _warn_of_open(result)
    _warn_of_escape(result, unattached_bodies)
    return _with_jumps(result)


def _warn_of_open(result: Trajectory) -> None:
    """Warn about an initial state that had to be moved onto the closures."""
    if (
        result.closing is None
        or not is_concrete(result.closing)
        or int(result.status) == Status.NOT_CLOSED
    ):
        return
    gap, rate, _ = map(float, result.closing)
    if gap > OPEN:
        warn(
            "NOT_CLOSED",
            f"simulate: the initial state is open by {gap:.3g} of the size of the model, and "
            "starts from the nearest closed one",
        )
    elif rate > OPEN:
        warn(
            "NOT_CLOSED",
            f"simulate: the initial speeds open closures at {rate:.3g} of the largest; the motion "
            "starts with the nearest that do not",
        )


def _warn_of_escape(result: Trajectory, unattached_bodies: list[str]) -> None:
    """Warn about bodies that move away from all supports and the world by more than FAR sizes of
    the model, with the time of the first sample that shows it."""
    if not is_concrete(result):
        return
    far = FAR * float(size_of(result.model))
    if not np.abs(np.asarray(result.state.q)).max(initial=0.0) > far:
        return
    places = {name: np.asarray(pose.p) for name, pose in result.poses.items()}
    moves = {name: p - p[0] for name, p in places.items()}
    left = [np.zeros(3), *(moves[name] for name in result.model.layout.supports)]
    for name in result.model.layout.bodies:
        beyond = (
            np.min([np.linalg.norm(moves[name] - move, axis=-1) for move in left], axis=0) > far
        )
        if beyond.any() and name not in unattached_bodies:
            t = time_text(result.times[np.argmax(beyond)], result.times)
            warn(
                "DIVERGED",
                f"simulate: '{name}' is more than {FAR:.0e} times the size of the model away from "
                f"t = {t} s on; look for negative damping or stiffness, or a load that grows",
            )


def _with_jumps(result: Trajectory) -> Trajectory:
    """Return the result after warnings about springs that pass through zero length and elements
    past half a turn, if as many steps were rejected as a jump of force costs."""
    if not is_concrete(result.statistics):
        return result
    accepted, rejected = (
        int(result.statistics[f"num_{kind}_steps"]) for kind in ("accepted", "rejected")
    )
    primal = without_derivatives(result) if rejected >= max(MANY, OFTEN * accepted) else None
    if primal is None or not is_concrete(primal):
        return result
    jumps = force_jumps_along(primal.model, primal.motions, primal.times, primal.state)
    for code, message in force_jump_messages(primal.model, jumps, primal.times):
        warn(code, f"simulate: {message}")
    return dataclasses.replace(result, jumps=jumps)


@contextmanager
def _forward_mode_explained(adjoint: Any) -> Iterator[None]:
    """Replace JAX's error for a function of diffrax that has derivatives in reverse mode only."""
    try:
        yield
    except TypeError as error:
        if "forward-mode" not in str(error):
            raise
        raise JaxbodyError(
            Problem(
                "NO_FORWARD_MODE",
                "simulate.adjoint",
                "has derivatives in reverse mode only with this solver; jax.jvp, jacfwd and "
                "hessian need forward mode",
                adjoint,
                hint="Give adjoint=diffrax.ForwardMode(), or leave solver= and "
                "stepsize_controller= out: both modes then work.",
            )
        ) from None


def motions_of(model: Model, motion: dict[str, Any] | None, where: str = "motion") -> Motions:
    """Return one motion for each support, in the order of the supports."""
    supports = model.layout.supports
    with Problems() as problems:
        given = checked_dict(motion, where, "support: jb.Harmonic(...)", problems)
        problems.collected += [
            unknown(name, where, supports) for name in given if name not in supports
        ]
        motions = {
            name: problems.gather(
                lambda name=name: as_motion(given.get(name, AtRest()), f"{where}['{name}']")
            )
            for name in supports
        }
    for name, one in motions.items():
        check_motion(one, f"{where}['{name}']", problems)
    problems.raise_if_any()
    return tuple(motions.values())


def check_run(
    model: Model, times, motions: Motions, loads: dict[str, Load], initial: Any
) -> Float[Array, "nt"]:
    """Return the times, after a check that they increase, that motions and loads cover them, and
    that the initial state has the right shape."""
    with Problems() as problems:
        checked = check_times(times, problems, "times", minimum=2)
    assert checked is not None
    check_covered(checked, signals_of_run(model, motions, loads), problems)
    problems.raise_if_any()
    if initial is not None and not isinstance(initial, Rest):
        check_state(model, initial, "initial")
    return device_array(checked)


def check_covered(times, functions: list[tuple[str, Any]], problems: Problems) -> None:
    """Check that these motions and signals, each with its place in messages, cover the times."""
    requested = None if times is None else concrete(times)
    for where, function in functions:
        span = [concrete(t) for t in function.covers()]
        if requested is None or any(t is None for t in span):
            continue
        first, last = span
        assert first is not None and last is not None
        slack = 1e-9 * (requested[-1] - requested[0]) + 2 * np.spacing(np.abs(requested).max())
        if requested[0] < first - slack or requested[-1] > last + slack:
            known, wanted = (
                " to ".join(time_text(t, x, 9) for t in (x[0], x[-1]))
                for x in ((first, last), requested)
            )
            problems.add(
                "T_RANGE",
                where,
                f"covers {known} s, requested {wanted} s",
                value=(requested[0], requested[-1]),
                limit=f"{known} s",
                hint="Simulate a shorter time, or give longer samples.",
            )


class EquationsOfMotion(eqx.Module):
    """The function f(t, state, model) that `equations_of_motion` returns, with its motions and
    loads."""

    motions: Motions
    loads: tuple[Load, ...]

    def __call__(self, t: Any, state: State, model: Model) -> State:
        """Return the rates q', v' and z' of a state at time t [s]."""
        time = jnp.asarray(t, state.q.dtype)
        v_dot, z_dot = rates(model, state, time, self.motions, self.loads)
        return State(Chart(model).rate(state.q, state.v), v_dot, z_dot)

    def trajectory(self, times: Float[Array, "nt"], states: State, model: Model) -> Trajectory:
        """Return the states at these times, such as `ts` and `ys` of a solution, as a Trajectory,
        with poses, forces, energies, plots, and sensor readings by `measure`. Quaternions are
        normalized."""
        states = State(jax.vmap(model.layout.normalized)(states.q), states.v, states.z)
        return Trajectory(
            times=times,
            state=states,
            status=jnp.array(Status.OK.value),
            statistics={},
            end=(times[-1], jax.tree.map(lambda x: x[-1], states)),
            model=model,
            motions=self.motions,
            loads=self.loads,
        )


def equations_of_motion(
    model: Model, *, motion: dict[str, Any] | None = None, loads: dict[str, Load] | None = None
) -> EquationsOfMotion:
    """Return the equations of motion y' = f(t, y, model) for `diffrax.ODETerm`, with any solver,
    controller, adjoint, SaveAt and Event.

    y is a State, `f(t, y, model)` the State of its rates; give the model as `args`, with respect to
    which derivatives are taken. `f.trajectory(ts, ys, model)` converts the solution to a
    Trajectory. The equations are those that `simulate` integrates: structured, with multipliers of
    closures. `simulate` also projects each step onto the closures; your own solver does not, so
    that c drifts by its errors.

    Args:
        motion: {support: motion}; a support without an entry is at rest.
        loads: {name: load} on bodies; by default none.

    Errors: UNKNOWN_NAME for a support, UNKNOWN_BODY for a load, NOTHING_MOVES; MEMORY from f, of a
    state without the z of its elements.

    A mass on a spring falls until it has moved by 0.05 m:

    >>> import diffrax, optimistix
    >>> spring = jb.Spring(
    ...     ("mass", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=50.0, free_length=1.0
    ... )
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
    ...     elements={"s": spring},
    ...     gravity=[0, 0, -9.81],
    ... )
    >>> f = jb.equations_of_motion(model)
    >>> low = diffrax.Event(lambda t, y, args, **_: y.q[0] + 0.05, optimistix.Newton(1e-9, 1e-9))
    >>> done = diffrax.diffeqsolve(
    ...     diffrax.ODETerm(f),
    ...     diffrax.Tsit5(),
    ...     0.0,
    ...     2.0,
    ...     0.01,
    ...     model.reference,
    ...     args=model,
    ...     event=low,
    ...     stepsize_controller=diffrax.PIDController(rtol=1e-9, atol=1e-9),
    ... )
    >>> round(float(done.ts[0]), 6), round(float(jnp.arccos(1 - 0.05 * 25 / 9.81) / 5), 6)
    (0.102068, 0.102068)
    """
    check_precision("equations_of_motion", model)
    check_moves("equations_of_motion", model)
    check_continuous("equations_of_motion", model)
    with Problems() as problems:
        motions = problems.gather(lambda: motions_of(model, motion))
        loads_on = problems.gather(lambda: loads_of(loads, model.layout.bodies))
    return EquationsOfMotion(motions or (), loads_on or ())
