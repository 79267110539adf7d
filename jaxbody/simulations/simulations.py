"""The exact motion: diffrax integrates the equations of motion under imposed motions of the supports."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from equinox import combine, is_array, partition
from jaxtyping import Array, Bool, Float, Int

from jaxbody.core import tables
from jaxbody.core.arguments import check_kind, named, positive, whole
from jaxbody.core.arrays import check_times, concrete, device_array, float_array
from jaxbody.core.compile_options import jit_quickly
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, is_concrete, unknown, warn
from jaxbody.core.progress_lines import working
from jaxbody.core.results import Result, warn_if_failed, without_derivatives
from jaxbody.geometry.frames import Pose
from jaxbody.inputs.loads import Load, loads_of
from jaxbody.inputs.motions import AtRest, Motion, as_motion, check_motion
from jaxbody.inputs.samples import kinks_of
from jaxbody.laws.measured_curves import has_range
from jaxbody.mechanics.canonical_equations import Canonical
from jaxbody.mechanics.energies import beyond_laws, each_element, kinetic, lost_power, potential
from jaxbody.mechanics.equations_of_motion import Dynamics, table_of_free
from jaxbody.mechanics.failure_causes import at_jump, jumps_passed, without_number_ahead
from jaxbody.mechanics.hessians import matrices
from jaxbody.mechanics.kinematics import Coordinates, Motions, table_of
from jaxbody.models.leaf_paths import by_name
from jaxbody.models.models import Model
from jaxbody.models.preconditions import check_precision, check_state, unattached
from jaxbody.models.sizes import size_of
from jaxbody.models.states import State
from jaxbody.numerics import dormand_prince_steps
from jaxbody.numerics.gauss_collocations import Gauss
from jaxbody.numerics.lanes import in_lanes
from jaxbody.numerics.precisions import in_float64, reachable
from jaxbody.statics.equilibria import without_inertia
from jaxbody.statics.rest_states import Rest, as_initial, beginning

MAX_STEPS = 100_000
MANY, OFTEN = 15, 0.15  # rejected steps, and their share of those accepted; a jump of force costs 18 at rtol 1e-3, 30 to 90 by default
STABLE = 2.8  # longest step times rate at which the classical Runge-Kutta method is stable; explicit ones of diffrax are near
FINEST = {"float64": 0.0, "float32": 1.5e-5}  # local error, below which float32 takes ever shorter steps for nothing
SAFETY = 0.1  # local error over rtol, as solvers interpolate between steps to a lower order than they step
CONSTANT = diffrax.ConstantStepSize | diffrax.StepTo
KINDS = {"solver": diffrax.AbstractSolver, "stepsize_controller": diffrax.AbstractStepSizeController, "adjoint": diffrax.AbstractAdjoint}
EXAMPLES = {"solver": "diffrax.Tsit5()", "stepsize_controller": "diffrax.ConstantStepSize()", "adjoint": "diffrax.ForwardMode()"}
OWN_STEPS = diffrax.ConstantStepSize | None
STATUSES = (
    (diffrax.RESULTS.successful, Status.OK),
    (diffrax.RESULTS.max_steps_reached, Status.MAX_STEPS),
    (diffrax.RESULTS.dt_min_reached, Status.DT_MIN),
)


class Trajectory(Result):
    """A motion at `times` [s]: `state`, and by name `poses`, `elongations` [m], `forces` [N], `energies` [J], `powers` [W],
    `reactions` [N, N m]. `status` MAX_STEPS, DT_MIN, NONFINITE or NOT_CONVERGED where the integration ended early; samples after that are NaN; TABLE_RANGE where a table was left.
    `statistics`: steps taken and rejected."""

    times: Float[Array, "nt"]
    state: State
    status: Int[Array, ""]
    statistics: dict[str, Any]
    end: tuple[Array, State]
    model: Model
    motions: Motions
    loads: tuple[Load, ...] = ()

    @property
    def poses(self) -> dict[str, Pose]:
        """Of every body and support: `.p` (nt, 3) position of its origin, `.R` (nt, 3, 3) orientation, `.quaternion`."""
        frames = self.at_samples(_frames)
        names = self.model.layout.frames[1:]
        return {name: jax.tree.map(lambda x, i=i: jnp.take(x, i + 1, axis=self.times.ndim), frames) for i, name in enumerate(names)}

    @property
    def elongations(self) -> dict[str, Array]:
        """Of each spring (nt,), tension positive; of a bushing its deformations (nt, 6)."""
        return self._of_elements(_deformations)

    @property
    def forces(self) -> dict[str, Array]:
        """Of each spring the tension (nt,) with its damper's part; of a bushing its six forces and moments (nt, 6)."""
        return self._of_elements(_forces)

    @property
    def energies(self) -> dict[str, Array]:
        """kinetic, potential and total [J], each (nt,)."""
        T, V = self.at_samples(_energies)
        return {"kinetic": T, "potential": V, "total": T + V}

    @property
    def powers(self) -> dict[str, Array]:
        """damping: power lost in dampers, the sum of dR/de_dot . e_dot; supports, loads: power that the imposed motions and
        the loads put in [W], each (nt,)."""
        return {
            "damping": self.at_samples(_damping_power),
            "supports": self.at_samples(_support_power, loads=True),
            "loads": self.at_samples(_load_power, loads=True),
        }

    @property
    def reactions(self) -> dict[str, tuple[Array, Array]]:
        """Of each support the force and the moment about its origin, world axes, that everything on it exerts, each (nt, 3)."""
        force, moment = self.at_samples(_reactions, loads=True)
        axis = self.times.ndim
        return {name: (jnp.take(force, i, axis=axis), jnp.take(moment, i, axis=axis)) for i, name in enumerate(self.model.layout.supports)}

    def _of_elements(self, function: Callable) -> dict[str, Array]:
        return by_name(tuple(table.names for table in self.model.elements), self.at_samples(function), axis=self.times.ndim)

    def at_samples(self, function: Callable, *more: Any, loads: bool = False) -> Any:
        """function(model, motions, t, state, *more) at every sample, with `loads` (..., state, loads, *more); leading axes of a batch kept;
        compiled once for each function."""
        with_loads = (self.loads,) if loads else ()
        return _evaluate(function, self.times.ndim - 1, self.model, self.motions, with_loads, self.times, self.state, more)

    def explain(self) -> str:
        t, status = float(self.end[0]), Status(int(self.status))
        taken, rejected = (int(self.statistics[f"num_{kind}_steps"]) for kind in ("accepted", "rejected"))
        told = f"at t = {t:.6g} s of {float(self.times[-1]):.6g} s, {taken} steps accepted, {rejected} rejected; samples after it are NaN"
        if status in (Status.MAX_STEPS, Status.DT_MIN):
            jump = at_jump(self.model, self.motions, *self.end)
            usual = in_float64(self.state.q.dtype) or "try a larger max_steps, a looser rtol, or solver=diffrax.Kvaerno5() for stiff models"
            told += "; " + (jump or usual)
        if status == Status.TABLE_RANGE:
            return self._beyond()
        if status == Status.NONFINITE:
            told += "; first bad: " + (without_number_ahead(self.model, self.motions, self.loads, *self.end) or self._accelerations())
        return told

    def _accelerations(self) -> str:
        """What is bad where all that acts is finite."""
        layout, q = self.model.layout, self.end[1].q
        massless = without_inertia(layout, matrices(self.model, State(q, np.zeros(layout.nv)))[0])
        return "the accelerations: " + "; ".join(massless) if massless else f"the state of '{layout.bodies[0]}'"

    def _beyond(self) -> str:
        """Which elements leave their tables, and when first."""
        beyond = np.asarray(self.at_samples(_beyond_laws))
        parts = [
            f"'{name}' first at t = {float(self.times[np.argmax(column)]):.6g} s, in {column.sum()} of {len(column)} samples"
            for name, column in zip(self.model.element_names, beyond.T, strict=True)
            if column.any()
        ]
        return "; ".join(parts) + ": its law went on straight with its end slope"

    def to_xarray(self) -> Any:
        """An xarray.Dataset over time: positions and quaternions of bodies, elongations and forces of springs, energies."""
        from jaxbody.core.datasets import trajectory_dataset

        return trajectory_dataset(self)

    def _tables(self) -> list[tables.Table]:
        if self.times.ndim > 1 or not is_concrete(self.state.q):
            return [
                tables.Table(
                    "Trajectories",
                    ("", ""),
                    [("states", self.state.q), ("status", self.report() if is_concrete(self.status) else "traced")],
                )
            ]
        rows = [
            (name, *(f"{low:.4g} .. {high:.4g}" for low, high in zip(np.nanmin(p, 0), np.nanmax(p, 0), strict=True)))
            for name, p in ((name, np.asarray(pose.p)) for name, pose in self.poses.items())
        ]  # fmt: skip
        springs = [
            (name, f"{np.nanmin(e):.4g} .. {np.nanmax(e):.4g}", f"{np.nanmin(f):.4g} .. {np.nanmax(f):.4g}")
            for name, e, f in ((name, np.asarray(e), np.asarray(self.forces[name])) for name, e in self.elongations.items())
            if e.ndim == 1
        ]
        jumps = [message for _, message in jumps_passed(self.model, self.motions, self.times, self.state)]
        title = f"Trajectory, {len(self.times)} samples, {float(self.times[0]):.4g} to {float(self.times[-1]):.4g} s"
        return [
            tables.Table(title, ("frame", "x [m]", "y [m]", "z [m]"), rows),
            tables.Table("", ("spring", "elongation [m]", "tension [N]"), springs, "; ".join([self.report(), *jumps])),
        ]


def simulate(
    model: Model,
    times,
    *,
    motion: dict[str, Motion | Callable] | None = None,
    loads: dict[str, Load] | None = None,
    initial: State | str | None = None,
    rtol: float = 1e-8,
    solver: diffrax.AbstractSolver | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    dt0: float | None = None,
    max_steps: int = MAX_STEPS,
    progress: bool | None = None,
) -> Trajectory:
    """The motion from `initial` (without it, the reference pose at rest) at times[0], sampled at `times` [s].

    initial: a State, or "rest", in equilibrium on supports as they stand and move at times[0], loads left out.
    motion: {support: motion}; a support without one is at rest. loads: {name: load} on bodies. rtol (in float32 1.5e-4 at least): ten times the relative local error that
    the step control allows in any component, so that samples between steps hold it too; absolute errors a hundredth of it times the size of the model (velocities: size times its fastest frequency, roughly). Without
    solver the method is Dopri8 in loops of our own (`integrators`), with steps of its own choice or, with stepsize_controller=diffrax.ConstantStepSize(), of dt0 [s];
    with other solvers, stepsize_controllers and adjoints, which are diffrax's objects, diffrax integrates. dt0 is else the first step. Both modes
    work by default, and forward over reverse; for few parameters adjoint=diffrax.ForwardMode() is faster, and with other solvers forward mode needs it. A batch by jax.vmap runs in chunks of 40, each member with steps of its own;
    with constant steps it takes half the time, but nothing controls the error: compare with a shorter dt0. progress: how long it has taken, on a terminal or in a
    notebook after five seconds; False is silent, True shows diffrax's meter, and diffrax integrates.

    What rtol leaves after 10 s on a shaking base, of a plate on 5 springs and of three boxes on 14: the largest error [m, rad], the relative error of a derivative by
    reverse mode, and the time (tests/benchmarks/tolerances.py):

        rtol                  1e-3   1e-4   1e-5   1e-6   1e-7   1e-8   1e-9   1e-10
        error, plate          2e-6   2e-7   3e-8   5e-9   8e-10  1e-10  3e-11  4e-12
        error, boxes          2e-5   3e-6   6e-7   9e-8   1e-8   2e-9   4e-10  7e-11
        derivative            2e-3   1e-4   1e-5   2e-6   2e-7   3e-8   4e-9   6e-10
        time                  0.3    0.35   0.45   0.6    0.8    1      1.3    1.7

    For motions to look at, 1e-5 is plenty. The default is for derivatives, whose errors are a hundred times as large, and for what compares runs: fits, tunings, differences.

    Errors: times unsorted, repeated, NaN or outside a sampled motion (T_RANGE), wrong initial state, UNKNOWN_NAME of a support, UNKNOWN_BODY of a load. An integration that ends early
    warns, and returns what it has with a status. Warns SPRING_COLLAPSED of a spring that passes through zero length and HALF_TURN of a Bushing or Torsion past half a
    turn, with the time, where samples show it and many steps were rejected; printed, a trajectory says so in any case.

    >>> import jax.numpy as jnp
    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, joints={"mass": Guide("base", axis=[0, 1, 0])}, supports={"base": Support()},
    ...               elements={"s": Spring(("mass", [0, 0, 0]), ("base", [0, 1, 0]), stiffness=50.0, free_length=1.0)})
    >>> trajectory = simulate(model, jnp.linspace(0, 1, 11), motion={"base": Harmonic(frequency=1.0, translation=[0, 0.1, 0])})
    >>> trajectory.poses["mass"].p.shape
    (11, 3)
    """
    check_precision("simulate", model)
    problems, initial = Problems(), as_initial(initial)
    motions = problems.gather(lambda: motions_of(model, motion))
    loads_on = problems.gather(lambda: loads_of(loads, model.layout.bodies))
    max_steps = problems.gather(lambda: check_steps(solver, stepsize_controller, dt0, rtol, max_steps, "simulate", adjoint))
    times = problems.gather(lambda: check_run(model, times, motions or (), {} if loads_on is None else loads or {}, initial))
    problems.raise_if_any()
    initial = beginning(model, motions, times[0], initial, "simulate.initial")
    loose = unattached(model)
    if loose:
        warn("UNATTACHED", f"nothing ties {', '.join(loose)} to world or a support")
    meter = diffrax.TextProgressMeter() if progress else diffrax.NoProgressMeter()
    tolerance, step = (None if x is None else device_array(float_array(x)) for x in (rtol, dt0))  # Python numbers would be compiled in
    if isinstance(stepsize_controller, diffrax.ConstantStepSize) and is_concrete(model, initial, step):
        _warn_of_long_steps(model, model.reference if initial is None else initial, float(step), solver)  # pyright: ignore[reportArgumentType]
    with working("simulate", progress), _forward_mode_explained(adjoint):
        result = integrate(
            model, times, motions, loads_on, initial, tolerance, solver, stepsize_controller, adjoint, step, max_steps, meter
        )
        if is_concrete(result.status):
            jax.block_until_ready(result.status)
    warn_if_failed(result)
    _warn_of_jumps(result)
    return result


def _warn_of_jumps(result: Trajectory) -> None:
    """Springs that shrank to a point and elements past half a turn: looked for where so many steps were rejected as a jump of force costs."""
    if not is_concrete(result.statistics):
        return
    accepted, rejected = (int(result.statistics[f"num_{kind}_steps"]) for kind in ("accepted", "rejected"))
    known = without_derivatives(result) if rejected >= max(MANY, OFTEN * accepted) else None
    if known is not None and is_concrete(known):
        for code, message in jumps_passed(known.model, known.motions, known.times, known.state):
            warn(code, f"simulate: {message}")


@contextmanager
def _forward_mode_explained(adjoint: Any) -> Iterator[None]:
    """What is wrong, where JAX says that one of diffrax's functions has derivatives in reverse mode only."""
    try:
        yield
    except TypeError as error:
        if "forward-mode" not in str(error):
            raise
        message = "has derivatives in reverse mode only with this solver; jax.jvp, jacfwd or hessian asks for forward mode"
        hint = "Give adjoint=diffrax.ForwardMode(), or leave solver= and stepsize_controller= out: both modes then work."
        raise JaxbodyError(Problem("NO_FORWARD_MODE", "simulate.adjoint", message, adjoint, hint=hint)) from None


def check_steps(
    solver: diffrax.AbstractSolver | None,
    stepsize_controller: diffrax.AbstractStepSizeController | None,
    dt0: Any,
    rtol: Any,
    max_steps: Any,
    where: str,
    adjoint: diffrax.AbstractAdjoint | None = None,
) -> int:
    """Objects of diffrax where such are meant; Gauss has constant steps, these have a length; rtol and dt0 are positive. Returns max_steps, a whole number."""
    problems = Problems()
    given = {"solver": solver, "stepsize_controller": stepsize_controller, "adjoint": adjoint}
    for name, value in given.items():
        if value is not None:
            check_kind(value, KINDS[name], f"{where}.{name}", f"an object of diffrax, as {EXAMPLES[name]}", problems)
    if isinstance(adjoint, diffrax.RecursiveCheckpointAdjoint) and isinstance(stepsize_controller, CONSTANT):
        words = "is RecursiveCheckpointAdjoint, which with constant steps gives wrong gradients where samples lie on steps"
        problems.add("WRONG_GRADIENT", f"{where}.adjoint", words, value=adjoint, hint="Use diffrax.DirectAdjoint() or ForwardMode().")
    if isinstance(solver, Gauss) and not isinstance(stepsize_controller, CONSTANT):
        told = "is Gauss, which has no estimate of its error, by which a controller could choose steps"
        hint = "Give stepsize_controller=diffrax.ConstantStepSize() and dt0= a tenth of the shortest period."
        problems.add("NO_ERROR_ESTIMATE", f"{where}.solver", told, value=solver, hint=hint)
    if isinstance(stepsize_controller, diffrax.ConstantStepSize) and dt0 is None:
        problems.add("NO_STEP", f"{where}.dt0", "is missing", hint="Constant steps need dt0=... seconds.")
    if dt0 is not None:
        positive(dt0, f"{where}.dt0", problems)
    positive(rtol, f"{where}.rtol", problems)
    steps = whole(max_steps, f"{where}.max_steps", problems)
    problems.raise_if_any()
    return steps


def _warn_of_long_steps(model: Model, initial: State, dt: float, solver: diffrax.AbstractSolver | None) -> None:
    """Constant steps must be short beside the fastest small motion about the start, y' = A y."""
    (M, C, K), n = matrices(model, initial), model.layout.nv
    rates = np.linalg.solve(np.asarray(M), np.concatenate([-K, -C], 1)) if n else np.zeros((0, 0))
    fastest = np.abs(np.linalg.eigvals(np.concatenate([np.eye(n, 2 * n, n), rates]))).max(initial=0.0)
    if dt * fastest > STABLE and not isinstance(solver, diffrax.AbstractImplicitSolver):
        remedy = f"Take dt0 below {STABLE / fastest:.3g} s, leave the steps to the default controller, or use an implicit solver"
        warn(
            "STEP_TOO_LONG",
            f"dt0 times the fastest rate, {fastest:.4g} rad/s, is {dt * fastest:.3g} > {STABLE}, where RK4 turns unstable. {remedy}",
        )


def motions_of(model: Model, motion: dict[str, Any] | None, where: str = "motion") -> Motions:
    """One motion for each support, in their order."""
    problems, supports = Problems(), model.layout.supports
    given = named(motion, where, "support: jb.Harmonic(...)", problems)
    problems.found += [unknown(name, where, supports) for name in given if name not in supports]
    motions = {name: problems.gather(lambda name=name: as_motion(given.get(name, AtRest()), f"{where}['{name}']")) for name in supports}
    problems.raise_if_any()
    for name, one in motions.items():
        check_motion(one, f"{where}['{name}']", problems)
    problems.raise_if_any()
    return tuple(motions.values())


def check_run(model: Model, times, motions: Motions, loads: dict[str, Load], initial: State | None) -> Float[Array, "nt"]:
    """Times that increase and that motions and loads cover, an initial state of the right shape."""
    problems = Problems()
    checked = check_times(times, problems, "times", minimum=2)
    problems.raise_if_any()
    assert checked is not None
    asked = concrete(checked)
    timed = [(f"motion['{name}']", motion) for name, motion in zip(model.layout.supports, motions, strict=False)]
    timed += [(f"loads['{name}']", signal) for name, load in loads.items() for signal in load.signals()]
    for where, function in timed:
        span = [concrete(t) for t in function.covers()]
        if asked is None or any(t is None for t in span):
            continue
        first, last = (float(t) for t in span)  # pyright: ignore[reportArgumentType]
        slack = 1e-9 * (asked[-1] - asked[0])
        if asked[0] < first - slack or asked[-1] > last + slack:
            problems.add(
                "T_RANGE",
                where,
                f"covers {first:.9g} to {last:.9g} s, asked {asked[0]:.9g} to {asked[-1]:.9g} s",
                value=(asked[0], asked[-1]),
                limit=f"{first:.9g} to {last:.9g} s",
                hint="Ask for less, or sample for longer.",
            )
    problems.raise_if_any()
    if initial is not None and not isinstance(initial, Rest):
        check_state(model, initial, "initial")
    return device_array(checked)


@jit_quickly
def integrate(model, times, motions, loads, initial, rtol, solver, stepsize_controller, adjoint, dt0, max_steps, meter) -> Trajectory:
    """The jitted core of `simulate`: it knows arrays only, and never raises."""
    dynamics = Dynamics(model, motions, loads)
    initial = dynamics.coordinates.reference if initial is None else initial
    own = solver is None and isinstance(stepsize_controller, OWN_STEPS) and isinstance(adjoint, diffrax.ForwardMode | None) and isinstance(meter, diffrax.NoProgressMeter)  # fmt: skip
    by = _by_blocks if own else _by_diffrax
    form = Canonical(dynamics) if isinstance(solver, Gauss) else dynamics
    y0 = form.pack(initial, times[0])
    samples, t_end, y_end, code, accepted, rejected = by(form, y0, times, rtol, solver, stepsize_controller, adjoint, dt0, max_steps, meter)  # fmt: skip
    finite = jnp.isfinite(samples).all(1)
    blown = (code == Status.OK.value) & ~finite.all()  # which constant steps do not notice
    last = jnp.maximum(jnp.argmin(finite) - 1, 0)
    t_end, y_end = jnp.where(blown, times[last], t_end), jnp.where(blown, samples[last], y_end)
    code = jnp.where(blown, Status.NONFINITE.value, code)
    good = (finite & (times <= t_end))[:, None]
    y = jnp.concatenate([_nan_unless(good, jnp.where(good, samples, y_end)), y_end[None]])
    unpacked = jax.vmap(form.unpack)(y, jnp.append(times, t_end))
    state, ended = jax.tree.map(lambda x: x[:-1], unpacked), jax.tree.map(lambda x: x[-1], unpacked)
    if has_range(model.elements):
        beyond = jax.vmap(lambda t, state: jnp.any(beyond_laws(model, table_of(model, motions, t, state))))(times, state)
        code = jnp.where((code == Status.OK.value) & jnp.any(beyond), Status.TABLE_RANGE.value, code)
    statistics = {"num_accepted_steps": accepted, "num_rejected_steps": rejected}
    return Trajectory(times, state, code, statistics, (t_end, ended), model, motions, loads)


@jax.custom_jvp
def _nan_unless(good: Bool[Array, "nt 1"], y: Float[Array, "nt ny"]) -> Float[Array, "nt ny"]:
    """y where it is good, else NaN; the derivatives too, of which `jnp.where` alone makes zeros in reverse mode."""
    return jnp.where(good, y, jnp.nan)


@_nan_unless.defjvp
def _nan_unless_jvp(primals, tangents):
    good, y = primals

    def backward(_, slope):
        return jnp.where(good | (slope == 0), slope, jnp.nan)

    change = jax.lax.custom_linear_solve(lambda x: x, tangents[1], lambda _, x: jnp.where(good, x, jnp.nan), backward)
    return _nan_unless(good, y), change


def _tolerances(coordinates: Coordinates, span, rtol):
    """rtol and atol of the local error, and the least step: constants to both modes."""
    coordinates, span, local = jax.lax.stop_gradient((coordinates, span, SAFETY * rtol))
    local = jnp.maximum(local, FINEST[local.dtype.name])
    return local, local / 100 * _scales(coordinates, span), reachable(1e-13, span.dtype, 1) * span


def _by_blocks(dynamics: Dynamics, y0, times, rtol, solver, controller, adjoint, dt0, max_steps, meter):
    """By the steps of `integrators`."""
    limits = _tolerances(dynamics.coordinates, times[-1] - times[0], rtol)
    signals = [signal for load in dynamics.loads for signal in load.signals()]
    constant = isinstance(controller, diffrax.ConstantStepSize)
    kinks = None if constant else kinks_of((*dynamics.motions, *signals))
    most = max_steps + (0 if kinks is None else len(kinks))
    first, kinks = jax.lax.stop_gradient((dt0, kinks))
    problem = dormand_prince_steps.Problem(Dynamics.drive, Dynamics.driven, *limits, first, most, kinks, constant)
    forward = isinstance(adjoint, diffrax.ForwardMode)
    ended = (
        dormand_prince_steps.solve(problem, dynamics, y0, times)
        if forward
        else dormand_prince_steps.solve_both_ways((dynamics, y0, times), problem=problem)
    )
    course = ended.course
    return ended.samples, times[0] + ended.tau, ended.y, course.code, course.accepted, course.rejected


def _by_diffrax(dynamics: Dynamics, y0, times, rtol, solver, controller, adjoint, dt0, max_steps, meter):
    """By the objects that the user gave, with defaults for what is missing."""
    adjoint = adjoint or (diffrax.DirectAdjoint() if isinstance(controller, CONSTANT) else diffrax.RecursiveCheckpointAdjoint())
    if controller is None:
        local, atol, shortest = _tolerances(dynamics.coordinates, times[-1] - times[0], rtol)
        controller = diffrax.PIDController(rtol=local, atol=atol, norm=optimistix.max_norm, dtmin=shortest, force_dtmin=False)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, dynamics: dynamics.rate(t, y)),
        solver or diffrax.Dopri8(),
        times[0],
        times[-1],
        dt0,
        y0,
        dynamics,
        saveat=diffrax.SaveAt(subs=[diffrax.SubSaveAt(ts=times), diffrax.SubSaveAt(t1=True)]),
        stepsize_controller=controller,
        adjoint=adjoint,
        max_steps=max_steps,
        throw=False,
        progress_meter=meter,
    )
    assert solution.ys is not None and solution.ts is not None
    code = jnp.select(
        [solution.result == result for result, _ in STATUSES], [status.value for _, status in STATUSES], Status.NOT_CONVERGED.value
    )
    t_end, y_end = solution.ts[1][-1], solution.ys[1][-1]
    ahead = t_end + (times[-1] - times[0]) * jnp.array([0.0, 1e-12, 1e-9, 1e-6])
    stuck = (code != Status.OK.value) & ~jnp.isfinite(jax.vmap(lambda t: dynamics.rate(t, y_end))(ahead)).all()
    steps = (solution.stats[f"num_{kind}_steps"] for kind in ("accepted", "rejected"))
    return solution.ys[0].at[0].set(y0), t_end, y_end, jnp.where(stuck, Status.NONFINITE.value, code), *steps


def _scales(coordinates: Coordinates, span) -> Float[Array, "ny"]:
    """What is small for each component of y: the size of the model, 1 for angles; for velocities these times a fast frequency."""
    model = coordinates.model
    layout = model.layout
    size = size_of(model)
    rate = jnp.sqrt(_stiffness_sum(coordinates) / jnp.sum(model.bodies.rows.mass) + jnp.linalg.norm(model.gravity) / size) + 1 / span
    if not layout.floating:
        return jnp.concatenate([jnp.where(layout.angular, 1.0, size), rate * jnp.where(layout.turns, 1.0, size)])
    n = len(layout.bodies)
    return jnp.concatenate([jnp.full(3 * n, size), jnp.ones(4 * n, size.dtype), jnp.full(3 * n, rate * size), jnp.full(3 * n, rate)])


def _stiffness_sum(coordinates: Coordinates) -> Float[Array, ""]:
    """The sum over the elements of the largest second derivative of V(e) in the reference pose."""

    def stiffest(element, *frames):
        e = element.deformation(*(f.pose() for f in frames))
        return jnp.max(jnp.abs(jax.hessian(element.energy)(e)))

    reference = table_of_free(coordinates.supports.at_rest(), coordinates.bodies.at_rest())
    found = each_element(coordinates.model, reference, stiffest)
    return sum((jnp.sum(k) for k in found), jnp.zeros((), coordinates.model.gravity.dtype))


def _frames(model, motions, t, state) -> Pose:
    return table_of(model, motions, t, state).pose()


def _deformations(model, motions, t, state):
    return tuple(each_element(model, table_of(model, motions, t, state), lambda s, *F: s.deformation(*(f.pose() for f in F))))


def _forces(model, motions, t, state):
    return tuple(each_element(model, table_of(model, motions, t, state), lambda s, *F: s.force(*F)))


def _energies(model, motions, t, state):
    frames = table_of(model, motions, t, state)
    return kinetic(model, frames), potential(model, frames)


def _beyond_laws(model, motions, t, state):
    return beyond_laws(model, table_of(model, motions, t, state))


def _damping_power(model, motions, t, state):
    return lost_power(model, table_of(model, motions, t, state))


def _reactions(model, motions, t, state, loads):
    return Dynamics(model, motions, loads).reactions(t, state.q, state.v)


def _load_power(model, motions, t, state, loads):
    frames = table_of(model, motions, t, state)
    on = [frames[model.layout.frame(load.on)] for load in loads]
    done = [(*load.wrench(t, frame), frame) for load, frame in zip(loads, on, strict=True)]
    return sum((jnp.sum(F * frame.v) + jnp.sum(M * frame.w) for F, M, frame in done), jnp.zeros((), state.q.dtype))


def _support_power(model, motions, t, state, loads):
    dynamics = Dynamics(model, motions, loads)
    force, moment = dynamics.reactions(t, state.q, state.v)
    supports = dynamics.coordinates.supports_moving(motions, t)
    return -jnp.sum(force * supports.v) - jnp.sum(moment * supports.w)


@jit_quickly
def _evaluate(function: Callable, batch_axes: int, model, motions, loads, times, state, more):
    given, rest = partition((model, motions, loads), is_array)
    others, fixed = partition(more, is_array)

    def one(given, t, state, others):
        model, motions, loads = combine(given, rest)
        return function(model, motions, t, state, *loads, *combine(others, fixed))

    over_batch = jax.vmap(in_lanes(one), in_axes=(None, 0, 0, None))
    for _ in range(batch_axes):
        over_batch = jax.vmap(over_batch, in_axes=(0, 0, 0, None))
    return over_batch(given, times, state, others)
