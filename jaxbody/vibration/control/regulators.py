"""Linear-quadratic regulators of small motions: the feedback u = -K x of least mean y'Qy + u'Ru,
continuous or held between samples."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from equinox import field

from jaxbody.core import tables
from jaxbody.core.arguments import checked_dict, positive_number
from jaxbody.core.arrays import Array, Complex, Float, Int, checked, is_concrete, nan_unless
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, unknown
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.model.forces.force_elements import scaled_reading
from jaxbody.model.inputs.port_inputs import Input
from jaxbody.model.joints.frame_tables import at_rest
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.numerics.eigenproblems import poles
from jaxbody.vibration.control.laws import LinearFeedback, state_feedback
from jaxbody.vibration.control.margins import Margins, of_loop
from jaxbody.vibration.control.riccati_equations import between_samples, solution
from jaxbody.vibration.state_spaces import StateSpace, state_space

DIRECT = 1e-12  # part of what reaches an output in a second that counts as reaching it at once
SEEN = 1e-9  # relative size of what counts as within reach of an input
NOT_READ = 1e-9  # relative error of a feedback by readings


class Regulator(Result):
    """The feedback u = -K x of the `drives` on the `states`, with x' = A x + B u, or with samples
    each `every` seconds x_next = A x + B u.

    `P`: the least cost from x is x'Px; `cost`: the mean of y'Qy + u'Ru under the noise, None
    without noise, infinite where an output reads white noise at once; `poles` of the closed loop
    (of z where sampled), among them, unchanged, those that the cost does not see; `weight`: the
    cost of another feedback is higher by the mean of e' weight e, e = u + K x; `unseen` projects on
    motions that do not decay and that the cost does not see, on which P and K are zero."""

    K: Float[Array, "nu nx"]
    P: Float[Array, "nx nx"]
    cost: Float[Array, ""] | None
    poles: Complex[Array, "nx"]
    status: Int[Array, ""]
    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    weight: Float[Array, "nu nu"]
    unseen: Float[Array, "nx nx"]
    every: Any
    ports: tuple[Input, ...]
    inputs: tuple[str, ...] = field(static=True)
    states: tuple[str, ...] = field(static=True)
    drives: tuple[str, ...] = field(static=True)
    drive_units: tuple[str, ...] = field(static=True)

    def explain(self) -> str:
        if int(self.status) != Status.NOT_STABILIZABLE:
            return ""
        mode = free_mode(self.A, self.B, self.unseen, self.every, self.states)
        return f"{', '.join(map(repr, self.drives))} cannot reach {mode}"

    def gains(self, lin: Any, reads: dict[str, Any]) -> Float[Array, "nu ny"]:
        """Return gains G with u = -G y on readings y = C x of `reads` {name: sensor}, about their
        values at rest: G C = K. A column for each component; of many G, the smallest.

        Errors: NOT_READ where the readings do not determine K x, or feel an input at once; those
        of `state_space`."""
        space = state_space(lin, dict(zip(self.inputs, self.ports, strict=True)), reads)
        lagged = tuple(name for name in space.states if name not in self.states)
        names, own = (*self.states, *lagged, *space.inputs), (*space.states, *space.inputs)
        K = jnp.pad(self.K, ((0, 0), (0, len(names) - len(self.states))))
        read = jnp.zeros((len(space.outputs), len(names)), K.dtype)
        places = np.array([names.index(name) for name in own])
        read = read.at[:, places].set(jnp.concatenate([space.C, space.D], 1))
        size = jnp.linalg.norm(read, axis=1) + 1e-300
        G = K @ jnp.linalg.pinv(read / size[:, None]) / size[None]
        close = jnp.abs(G @ read - K) <= NOT_READ * (jnp.abs(G) @ jnp.abs(read) + jnp.abs(K))
        if is_concrete(close) and not close.all():
            lacking = [f"'{names[i]}'" for i in np.flatnonzero(~np.asarray(close).all(0))[:6]]
            raise JaxbodyError(
                Problem(
                    "NOT_READ",
                    "regulator.gains.reads",
                    f"{', '.join(space.outputs)} do not give the feedback of {', '.join(lacking)}",
                    reads,
                    "readings y = C x with G C = K",
                    "Read more, but no accelerations that an input causes; or estimate the states.",
                )
            )
        return nan_unless(close.all(), G)

    def law(self, lin: Any, reads: dict[str, Any]) -> LinearFeedback:
        """Return the law u = -G (y - y0) of a controller that reads `reads`, with G as in `gains`
        and y0 the readings at rest. Errors: those of `gains`."""
        return state_feedback(self.gains(lin, reads), readings_at_rest(lin, reads))

    def margins(self) -> Margins:
        """Compute the margins of the loop of each drive, opened there, the others closed:
        L = K_i (s - A + sum_(j != i) B_j K_j)^-1 B_i."""
        return warn_if_failed(_margins(self))

    @tables.summarized("Regulator", 2, K="gains", cost="cost")
    def _tables(self) -> list[tables.PrintedTable]:
        units = zip(self.drives, self.drive_units, strict=True)
        heads = ("state", *(f"{name} [{unit}]" for name, unit in units))
        gains = [*zip(self.states, *self.K, strict=True)]
        cost = "" if self.cost is None else f"cost {self.cost:.6g}"
        note = "; ".join(filter(None, [cost, self.failure]))
        return [
            tables.PrintedTable("Regulator, u = -K x", heads, gains),
            poles_table(self.poles, self.every, note),
        ]


def lqr(
    lin: Any,
    Q: Any,
    R: Any,
    *,
    inputs: dict[str, Any],
    outputs: dict[str, Any],
    noise: Any = None,
    every: Any = None,
) -> Regulator:
    """Compute the feedback u = -K x that makes the integral of y'Qy + u'Ru least from every state,
    and so its mean under white noise; y = C x + D u.

        A'P + PA - (PB + N) R_u^-1 (B'P + N') + C'QC = 0,   N = C'QD,   R_u = R + D'QD,
        K = R_u^-1 (B'P + N'),   cost = tr(P B_w W B_w')

    Motions that do not decay and that the cost does not see, such as a displacement of the whole
    road, are left as they are. Sampled, u is held; system, noise and cost between samples are
    integrated exactly. Derivatives of any order.

    Args:
        lin: `linearize(model, equilibrium(model))`.
        Q: weights of the outputs' components, in 1/unit^2: {name: weight}, zero where left out, or
            a vector, or a symmetric matrix.
        R: those of the drives.
        inputs: {name: port}; all without noise are drives.
        outputs: {name: sensor}, what is to be small.
        noise: {input: intensity} of white noise [unit^2 s], two-sided, E[w(t) w(t + s)] = W
            delta(s); by default none.
        every: time between samples [s]; by default continuous.

    Errors: those of `state_space`, UNKNOWN_NAME, BAD_SHAPE, NON_FINITE, BAD_NUMBER; warns
    IMPROPER, NOT_POSITIVE (Q, R or the noise), NOT_STABILIZABLE if the cost sees a motion that does
    not decay and that the drives cannot reach; all results are then NaN. Source: B. D. O. Anderson,
    J. B. Moore, Optimal Control: Linear Quadratic Methods (1990).

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
    ... )
    >>> regulator = jb.control.lqr(
    ...     jb.linearize(model, model.reference),
    ...     {"place": 1.0},
    ...     {"push": 1.0},
    ...     inputs={"push": jb.PointForce("mass")},
    ...     outputs={"place": jb.Position("mass", axis="z")},
    ... )
    >>> [round(float(k), 9) for k in regulator.K[0]]  # 1 and the root of 2
    [1.0, 1.414213562]
    """
    space = state_space(lin, inputs, outputs)
    return regulator_of(space, tuple(inputs.values()), Q, R, noise, every)


def readings_at_rest(lin: Any, reads: dict[str, Any]) -> Float[Array, "ny"]:
    """Return the readings at the state of rest of a linearization."""
    now = at_rest(Coordinates(lin.held).at_rest(lin.state.q))
    each = (scaled_reading(sensor, sensor.reading(lin.held, now)) for sensor in reads.values())
    return jnp.concatenate([jnp.ravel(x) for x in each])


def regulator_of(
    space: StateSpace, ports: tuple[Input, ...], Q: Any, R: Any, noise: Any, every: Any
) -> Regulator:
    """Return the regulator of a state space with these ports as inputs; see `lqr`."""
    with Problems() as problems:
        drives, W, every = split_inputs(space, noise, every, "lqr", problems)
        Q = weights(Q, space.outputs, "lqr.Q", problems)
        R = weights(R, tuple(space.inputs[i] for i in drives), "lqr.R", problems)
    return warn_if_failed(_regulator(space, ports, Q, R, W if noise else None, drives, every))


def split_inputs(
    space: StateSpace, noise: Any, every: Any, where: str, problems: Problems
) -> tuple[tuple[int, ...], Any, Any]:
    """Return the indices of the inputs without noise, the intensities of all inputs as a matrix,
    and the time between samples; errors are added to `problems`."""
    noise = checked_dict(noise, f"{where}.noise", "input: intensity", problems)
    known = tuple(i for i, name in enumerate(space.inputs) if name not in noise)
    W = weights(noise, space.inputs, f"{where}.noise", problems)
    return known, W, every if every is None else positive_number(every, f"{where}.every", problems)


def weights(given: Any, names: tuple[str, ...], where: str, problems: Problems) -> Any:
    """Return {name: weight}, a vector or a matrix as a symmetric matrix; errors are added to
    `problems`."""
    if isinstance(given, dict):
        problems.collected += [unknown(name, where, names) for name in given if name not in names]
        given = [given.get(name, 0.0) for name in names]
    n = len(names)
    array = checked(given, ((n,), (n, n)), where, problems, f"Give one for each of {n}.")
    array = jnp.zeros(n) if array is None else jnp.asarray(array, float)
    return jnp.diag(array) if array.ndim == 1 else (array + array.T) / 2


def noise_of(space: StateSpace, W: Float[Array, "m m"]) -> tuple[Array, Array]:
    """Return B W B', and D where it is more than rounding: what reaches outputs at once."""
    at_once = jnp.abs(space.D) > DIRECT * jnp.abs(space.C) @ jnp.abs(space.B)
    return space.B @ W @ space.B.T, jnp.where(at_once, space.D, 0.0)


def status_of(space: StateSpace, P: Array, positive: Array, *semidefinite: Any) -> Array:
    """Return the status of a result, from the solution P of its Riccati equation and the matrices
    that must be positive definite and semidefinite."""
    good = jnp.linalg.eigvalsh(positive)[0] > 0
    for values in map(jnp.linalg.eigvalsh, semidefinite):
        good = good & (values[0] >= -1e-12 * values[-1])
    finite, solved = (jnp.isfinite(x).all() for x in (space.A @ space.B, P))
    failures = (Status.NONFINITE.value, Status.NOT_POSITIVE.value, Status.NOT_STABILIZABLE.value)
    own = jnp.select([~finite, ~good, ~solved], failures, Status.OK.value)
    return jnp.where(space.status == Status.OK, own, space.status)


def poles_of(A: Float[Array, "n n"]) -> Complex[Array, "n"]:
    """Return the poles by ascending size; NaN where A is not finite."""
    finite = jnp.isfinite(A).all()  # LAPACK may not terminate on NaN
    s, _ = poles(jnp.where(finite, A, np.eye(len(A))))
    return jnp.where(finite, s[jnp.argsort(jnp.abs(s))], jnp.nan)


@program
def _regulator(space: StateSpace, ports, Q, R, W, drives: tuple[int, ...], every) -> Regulator:
    which, n, m = np.array(drives, int), len(space.A), len(drives)
    A, B, y = space.A, space.B[:, which], jnp.concatenate([space.C, space.D[:, which]], 1)
    J, time = (y.T @ Q @ y).at[n:, n:].add(R), jnp.asarray(1.0 if every is None else every)
    spread, direct = noise_of(space, jnp.zeros((len(space.inputs),) * 2) if W is None else W)
    cost = 0.0 if W is None else jnp.where(jnp.any(Q @ direct @ W != 0), jnp.inf, 0.0)
    if every is not None:
        held, J, within = between_samples(jnp.block([[A, B], [jnp.zeros((m, n + m))]]), J, time)
        cost = cost + jnp.trace(within[:n, :n] @ spread) / time
        A, B, spread = held[:n, :n], held[:n, n:], between_samples(A.T, spread, time)[1]
    Q_x, N, R_u = J[:n, :n], J[:n, n:], J[n:, n:]
    P, unseen = solution(A, B, Q_x, R_u, N, Q @ space.C, sampled=every is not None)
    weight, reach = (R_u, P) if every is None else (R_u + B.T @ P @ B, P @ A)
    K = jnp.linalg.solve(weight, B.T @ reach + N.T)
    return Regulator(
        K=K,
        P=P,
        cost=None if W is None else cost + jnp.trace(P @ spread) / time,
        poles=poles_of(A - B @ K),
        status=status_of(space, P, R, Q, *(() if W is None else (W,))),
        A=A,
        B=B,
        weight=weight,
        unseen=unseen,
        every=every,
        ports=ports,
        inputs=space.inputs,
        states=space.states,
        drives=tuple(space.inputs[i] for i in drives),
        drive_units=tuple(space.input_units[i] for i in drives),
    )


@program
def _margins(regulator: Regulator) -> Margins:
    A, B, K, rest = (
        regulator.A,
        regulator.B,
        regulator.K,
        np.eye(len(regulator.A)) - regulator.unseen,
    )
    # in place of motions that no loop sees, something decays
    A = rest @ A @ rest - (1.0 if regulator.every is None else 0.0) * regulator.unseen - B @ K

    def of_drive(b, k):
        return of_loop(A + b[:, None] * k[None], b, k, 0.0, regulator.every)

    return Margins(*jax.vmap(of_drive)(B.T, K), regulator.drives)  # pyright: ignore[reportCallIssue]


def free_mode(A: Any, B: Any, unseen: Any, every: Any, states: tuple[str, ...]) -> str:
    """Return, of the motions that do not decay and that B does not reach, the fastest growing: its
    pole [1/s], and the states with the largest shares of its right and left eigenvectors. It is
    looked for in NumPy, as results are printed without a program of JAX."""
    eye, rate = np.eye(len(A)), np.linalg.norm(A)
    A = (eye - unseen) @ A @ (eye - unseen) - (0.0 if every else rate) * unseen
    reached = np.asarray((eye - unseen) @ B)
    for _ in range(len(A)):  # the columns of B, A B, A^2 B, ...
        both = np.concatenate([reached, A @ reached / rate], 1)
        reached = scipy.linalg.orth(both / np.linalg.norm(both), rcond=SEEN)
    U = scipy.linalg.null_space(reached.T)
    U = U if U.size else eye
    s, left, right = scipy.linalg.eig(U.T @ A @ U, left=True)
    s = in_seconds(s, every)
    i = np.argmax(np.real(s))
    share = np.abs(U @ left[:, i]) + np.abs(U @ right[:, i])
    names = [f"'{states[j]}'" for j in np.argsort(-share)[:3] if share[j] > share.max() / 3]
    return f"the motion of {', '.join(names)} with the pole {s[i]:.4g} 1/s"


def in_seconds(s: Any, every: Any) -> np.ndarray:
    """Return poles in 1/s; those of a sampled system as ln(z)/T."""
    return np.asarray(s) if every is None else np.log(np.asarray(s) + 1e-300) / float(every)


def poles_table(s: Any, every: Any, note: str) -> tables.PrintedTable:
    """Return a table of poles, one of each pair."""
    s = in_seconds(s, every)
    size = np.abs(s[np.isfinite(s)]).max(initial=0.0)
    parts = (tables.without_dust(x, size) for x in (np.real(s), np.imag(s)))
    rows = [(x, y, -x / (np.hypot(x, y) or 1.0)) for x, y in zip(*parts, strict=True) if not y < 0]
    heads = ("real part [1/s]", "imaginary part [1/s]", "damping ratio")
    return tables.PrintedTable("Poles", heads, rows, note)
