"""Kalman filters of small motions: the states estimated from noisy sensors with the least variance,
continuous or at samples, and output feedback by the estimate."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Complex, Float, Int, is_concrete, nan_unless
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.vibration.control.laws import LinearFeedback
from jaxbody.vibration.control.regulators import (
    Regulator,
    free_mode,
    noise_of,
    poles_of,
    poles_table,
    readings_at_rest,
    split_inputs,
    status_of,
    weights,
)
from jaxbody.vibration.control.riccati_equations import (
    REST,
    between_samples,
    solution,
)
from jaxbody.vibration.state_spaces import StateSpace, state_space


class Estimator(Result):
    """The estimate z of the states x from the readings y of sensors with noise,

        z' = A z + B u + L (y - C z - D u),   or sampled   z = z0 + L (y - C z0 - D u),
                                                           z0_next = A z + B u,

    u the known inputs. `covariance` of x - z; sampled, `prior` is that of x - z0, before a reading.
    `innovation`: standard deviations of y - C z0 - D u, or continuous the roots of its intensities;
    `poles` of the error (of z where sampled).

    `unseen` projects on motions that do not decay and that no sensor sees, such as a displacement
    of the whole road: they are not estimated, and covariance, L and z do not contain them."""

    L: Float[Array, "nx ny"]
    covariance: Float[Array, "nx nx"]
    prior: Float[Array, "nx nx"]
    innovation: Float[Array, "ny"]
    poles: Complex[Array, "nx"]
    status: Int[Array, ""]
    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]
    D: Float[Array, "ny nu"]
    unseen: Float[Array, "nx nx"]
    every: Any
    states: tuple[str, ...] = field(static=True)
    known: tuple[str, ...] = field(static=True)
    sensors: tuple[str, ...] = field(static=True)
    units: tuple[str, ...] = field(static=True)

    def explain(self) -> str:
        if int(self.status) == Status.NOT_STABILIZABLE:
            mode = free_mode(self.A.T, self.C.T, 0 * self.A, self.every, self.states)
            return f"{', '.join(map(repr, self.sensors))} do not see {mode}"
        improper = int(self.status) == Status.IMPROPER and self.every is not None
        return (
            "a sensor that is sampled reads white noise at once; give it a lag" if improper else ""
        )

    def feedback(self, regulator: Regulator) -> tuple[Array, Array, Array]:
        """Return A_c, B_c and C_c of the feedback of readings y about rest, z' = A_c z + B_c y, u =
        C_c z; sampled, z_next = A_c z + B_c y with the next reading y, and u = C_c z_next from then
        on.

        Errors: OTHER_MODEL for a regulator of other states, drives or samples; NOT_READ where it
        needs motions that no sensor sees."""
        return _feedback(self, self._checked(regulator))

    def law(self, lin: Any, sensors: dict[str, Any], regulator: Regulator) -> LinearFeedback:
        """Return the law of a controller that reads these sensors and feeds back the estimate.
        Errors: those of `feedback`."""
        A, B, C = self.feedback(regulator)
        C, D = (C, 0 * C @ B) if self.every is None else (C @ A, C @ B)
        return LinearFeedback(A, B, C, D, readings_at_rest(lin, sensors))

    def cost(self, regulator: Regulator) -> Float[Array, ""]:
        """Return the mean of y'Qy + u'Ru with feedback of the estimate, under the noise of the
        regulator, which is also that of this estimator: tr(P B_w W B_w') + tr(R_u K S K'), S the
        covariance of x - z. Errors: those of `feedback`, NO_NOISE."""
        if regulator.cost is None:
            raise JaxbodyError(
                Problem("NO_NOISE", "cost.regulator", "has no noise", hint="Give lqr(noise=...).")
            )
        K, time = self._checked(regulator).K, 1.0 if self.every is None else self.every
        return regulator.cost + jnp.trace(regulator.weight @ K @ self.covariance @ K.T) / time

    def _checked(self, regulator: Regulator) -> Regulator:
        """Return the regulator if it is one for this estimator, with K NaN, if traced, where it
        needs what no sensor sees."""
        times = (self.every, regulator.every)
        if (
            regulator.states != self.states
            or not set(regulator.drives) <= set(self.known)
            or times.count(None) == 1
            or (is_concrete(times) and times[0] != times[1])
        ):
            raise JaxbodyError(
                Problem(
                    "OTHER_MODEL",
                    "estimator.regulator",
                    "has other states, drives or samples",
                    regulator.states,
                    ", ".join(self.states),
                    "Give both the same inputs, every= and sensors with a lag.",
                )
            )
        blind = jnp.any(jnp.abs(regulator.K @ self.unseen) > 1e-6 * jnp.max(jnp.abs(regulator.K)))
        if is_concrete(blind) and blind:
            raise JaxbodyError(
                Problem(
                    "NOT_READ",
                    "estimator.regulator",
                    "feeds back a motion that does not decay and that no sensor sees",
                    regulator.drives,
                    hint="Add a sensor of it, or leave out outputs that contain it.",
                )
            )
        return dataclasses.replace(regulator, K=nan_unless(~blind, regulator.K))

    @tables.summarized("Estimator", 2, L="gains", innovation="innovation")
    def _tables(self) -> list[tables.PrintedTable]:
        each = [*zip(self.sensors, self.innovation, self.units, strict=True)]
        heads = ("state", "standard deviation", *(f"{y} [1/({unit})]" for y, _, unit in each))
        deviations = np.sqrt(np.diagonal(self.covariance))
        return [
            tables.PrintedTable(
                "Estimator", heads, [*zip(self.states, deviations, *self.L.T, strict=True)]
            ),
            tables.PrintedTable("Innovations", ("sensor", "standard deviation", "unit"), each),
            poles_table(self.poles, self.every, self.failure),
        ]


def kalman(
    lin: Any,
    sensors: dict[str, Any],
    *,
    inputs: dict[str, Any],
    noise: Any,
    sensor_noise: Any,
    every: Any = None,
) -> Estimator:
    """Compute the linear estimator of least variance of the states of small motions under white
    noise, in the steady state.

        A S + S A' - (S C' + N) V^-1 (C S + N') + B_w W B_w' = 0,   L = (S C' + N) V^-1,
        N = B_w W D_w',   V = V_y + D_w W D_w'

    Sampled, process noise between samples is integrated exactly. Motions that do not decay and that
    no sensor sees, as the displacement of the whole road seen by relative sensors, are left out; if
    one grows there is no estimator. Derivatives of any order.

    Args:
        lin: `linearize(model, equilibrium(model))`.
        sensors: {name: sensor}.
        inputs: {name: port}; all without noise are known.
        noise: {input: intensity} of white noise, [unit^2 s], two-sided, as in `lqr`.
        sensor_noise: {component: intensity [unit^2 s], sampled the variance [unit^2]}, or a vector,
            or a matrix.
        every: time between samples [s]; by default continuous.

    Errors: those of `state_space`, UNKNOWN_NAME, BAD_SHAPE, NON_FINITE, BAD_NUMBER; warns IMPROPER,
    also where a sampled sensor reads white noise at once, NOT_POSITIVE, NOT_STABILIZABLE if no
    sensor sees a motion that grows; all results are then NaN. Source: B. D. O. Anderson, J. B.
    Moore, Optimal Filtering (1979).

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
    ... )
    >>> estimator = jb.control.kalman(
    ...     jb.linearize(model, model.reference),
    ...     {"place": jb.Position("mass", axis="z")},
    ...     inputs={"push": jb.PointForce("mass")},
    ...     noise={"push": 1.0},
    ...     sensor_noise={"place": 1.0},
    ... )
    >>> [round(float(gain), 9) for gain in estimator.L[:, 0]]  # the root of 2, and 1
    [1.414213562, 1.0]
    """
    space = state_space(lin, inputs, sensors)
    return estimator_of(space, noise, sensor_noise, every)


def estimator_of(space: StateSpace, noise: Any, sensor_noise: Any, every: Any) -> Estimator:
    """Return the estimator of a state space; see `kalman`."""
    with Problems() as problems:
        known, W, every = split_inputs(space, noise, every, "kalman", problems)
        V = weights(sensor_noise, space.outputs, "kalman.sensor_noise", problems)
    return warn_if_failed(_estimator(space, W, V, known, every))


@program
def _estimator(space: StateSpace, W, V, known: tuple[int, ...], every) -> Estimator:
    (spread, direct), which, n, m = (
        noise_of(space, W),
        np.array(known, int),
        len(space.A),
        len(known),
    )
    A, B, C, sampled, eye = (
        space.A,
        space.B[:, which],
        space.C,
        every is not None,
        np.eye(len(space.A)),
    )
    V_y, N, decay = V + direct @ W @ direct.T, space.B @ W @ direct.T, 1.0
    if sampled:
        system = jnp.block([[A, B], [jnp.zeros((m, n + m))]])
        noise = jnp.pad(spread, ((0, m), (0, m)))
        held, noise, _ = between_samples(system.T, noise, jnp.asarray(every))
        A, B, spread, V_y, N, decay = held[:n, :n].T, held[n:, :n].T, noise[:n, :n], V, 0 * N, 0.0
    rows = C / (jnp.linalg.norm(C, axis=1, keepdims=True) + 1e-300)
    _, unseen = solution(A, eye, rows.T @ rows, eye, jnp.zeros_like(A), rows, sampled=sampled)
    seen = eye - unseen
    # in place of motions that no sensor sees, something decays
    left, excited, N = seen @ A @ seen - decay * unseen, seen @ space.B @ W, seen @ N
    S, _ = solution(left.T, C.T, seen @ spread @ seen.T, V_y, N, excited.T, sampled=sampled)
    drift = poles_of(A @ unseen)
    drift = jnp.abs(drift) - 1 if sampled else jnp.real(drift)
    S = nan_unless(jnp.max(drift) <= REST * jnp.linalg.norm(A), S)
    innovation = C @ S @ C.T + V if sampled else V_y
    L = jnp.linalg.solve(innovation, C @ S + N.T).T
    after, status = eye - L @ C, status_of(space, S, V, W)
    improper = sampled & jnp.any(direct @ W != 0)
    return Estimator(
        L=L,
        covariance=after @ S @ after.T + L @ V @ L.T if sampled else S,
        prior=S,
        innovation=jnp.sqrt(jnp.diagonal(innovation)),
        poles=poles_of(A @ after if sampled else A - L @ C),
        status=jnp.where(improper, Status.IMPROPER.value, status),
        A=A,
        B=B,
        C=C,
        D=space.D[:, which],
        unseen=unseen,
        every=every,
        states=space.states,
        known=tuple(space.inputs[i] for i in known),
        sensors=space.outputs,
        units=space.output_units,
    )


@program
def _feedback(estimator: Estimator, regulator: Regulator) -> tuple[Array, Array, Array]:
    K, L, seen = regulator.K, estimator.L, np.eye(len(estimator.A)) - estimator.unseen
    which = np.array([estimator.known.index(name) for name in regulator.drives])
    ahead = seen @ (estimator.A - estimator.B[:, which] @ K)
    if estimator.every is None:
        return ahead - L @ (estimator.C - estimator.D[:, which] @ K) - estimator.unseen, L, -K
    return ahead - L @ (estimator.C @ ahead - estimator.D[:, which] @ K), L, -K
