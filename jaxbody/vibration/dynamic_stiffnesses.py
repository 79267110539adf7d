"""Dynamic stiffness of an element: the force under a harmonic deformation about a preload, as in
tests of mounts.

    small amplitude     K(w) = dF/de at rest + i w dF/de'
                               - (V_ey + i w R_ey) (V_yy + i w R_yy - w^2 T_yy)^-1 (V_ye + i w R_ye)
    amplitude X         K(w) = first harmonic of the steady force under e = e0 + X cos(w t), over X

y are coordinates of the element. The steady state with amplitude is periodic, z(T) = z(0), which
Newton's method solves over one period of classical Runge-Kutta steps; its derivatives are those of
an implicit function. Half of the steps have equal lengths; the others are concentrated where the
rates have kinks, which reduce the order of accuracy of a step, such as that of |z| in hysteresis or
the end of a gap.
"""

import itertools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Complex, Float, Int, device_array, rows_or_nan, scalar
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status
from jaxbody.core.results import Labeled, Result, dataset, warn_if_failed
from jaxbody.model.elements.bushings import DIRECTIONS, Mount
from jaxbody.model.elements.elements import Element
from jaxbody.model.elements.springs import LawForces, Spring
from jaxbody.model.laws import law_states, laws
from jaxbody.model.laws.law_states import Apart, Held, Relaxed, with_states
from jaxbody.model.laws.memory_laws import Memory
from jaxbody.vibration.frequency_responses import check_frequencies

STEPS = 1000  # Runge-Kutta steps of equal length in a period, and number of those at kinks
PERIODS, NEWTON = 3, 6  # periods integrated before Newton's method, and its steps
STABLE = 2.5  # largest product of a step and the relaxation rate of a state
SEARCH = 60  # steps of the search for the deformation of a preload
ROUNDING = 1e-9  # change of the periodic state in the last step, relative to the state


class DynamicStiffness(Labeled, Result):
    """The complex `stiffness` (nf,) of an element in its `unit` at `frequencies` [Hz]: `magnitude`
    and `loss_angle` [rad], storage and loss stiffness.

    `deformation` [m, rad] is that under the preload. `status` NOT_CONVERGED, with NaN, where no
    deformation carries the preload, no steady state was found, or a state relaxes in less than
    about a thousandth of a period (then the small-amplitude stiffness is exact)."""

    index = "frequency"
    frequencies: Float[Array, "nf"]
    stiffness: Complex[Array, "nf"]
    deformation: Float[Array, ""]
    status: Int[Array, ""]
    unit: str = eqx.field(static=True, default="N/m")

    @property
    def magnitude(self) -> Float[Array, "nf"]:
        """|K|."""
        return jnp.abs(self.stiffness)

    @property
    def loss_angle(self) -> Float[Array, "nf"]:
        """The angle by which the force leads the deformation [rad]."""
        return jnp.angle(self.stiffness)

    def explain(self) -> str:
        return (
            "no deformation carries the preload, or the steady state was not found"
            if int(self.status)
            else ""
        )

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset by frequency: storage and loss stiffness, magnitude and loss
        angle."""
        return dataset(
            {
                "storage": (("frequency",), jnp.real(self.stiffness), self.unit),
                "loss": (("frequency",), jnp.imag(self.stiffness), self.unit),
                "magnitude": (("frequency",), self.magnitude, self.unit),
                "loss_angle": (("frequency",), self.loss_angle, "rad"),
                "status": ((), self.status, ""),
            },
            {"frequency": ("frequency", np.asarray(self.frequencies), {"units": "Hz"})},
            "dynamic stiffness",
        )

    @tables.summarized("Dynamic stiffness", 1, stiffness="stiffness")
    def _tables(self) -> list[tables.PrintedTable]:
        rows = [
            (f, abs(K), float(np.angle(K, deg=True)))
            for f, K in zip(self.frequencies, self.stiffness, strict=True)
        ]
        return [
            tables.PrintedTable(
                "Dynamic stiffness",
                ("frequency [Hz]", f"magnitude [{self.unit}]", "loss angle [deg]"),
                rows,
                self.failure,
            )
        ]


def dynamic_stiffness(
    element: Element | laws.Law,
    frequencies,
    *,
    preload: Any = 0.0,
    amplitude: Any = None,
    direction: str | None = None,
) -> DynamicStiffness:
    """Compute the complex stiffness of an element under a harmonic deformation exp(i w t) about its
    preload.

    Args:
        element: an element with laws (SpringDamper, Torsion, AntiRollBar, Mount), a Spring, or
            a law
        frequencies: frequencies [Hz] (nf,); 0 Hz is allowed without an amplitude: the static
            stiffness
        preload: static force [N, N m], with relaxed branches; tension is positive; default 0
        amplitude: amplitude X of the deformation [m, rad]; the stiffness is then the first harmonic
            of the steady force over X, to about 1e-8; default: a small amplitude
        direction: direction of a Mount: x, y, z, rx, ry or rz

    The result is differentiable in forward and reverse mode with respect to the element's numbers,
    at an amplitude to about 1e-4 where rates have kinks. Errors: WRONG_KIND, BAD_DIRECTION,
    BAD_FREQUENCY, NOT_POSITIVE. Warns NOT_CONVERGED.

    >>> rubber = jb.laws.Linear(2e4) + jb.laws.Maxwell(stiffness=6e4, relaxation_time=0.01)
    >>> stiffness = jb.vibration.dynamic_stiffness(rubber, [10.0])
    >>> (
    ...     round(float(stiffness.magnitude[0]), 6),
    ...     round(float(jnp.rad2deg(stiffness.loss_angle[0])), 6),
    ... )
    (45806.759305, 36.161108)
    """
    f = check_frequencies(frequencies, "dynamic_stiffness.frequencies", static=amplitude is None)
    spring, damper, unit = _laws_of(element, direction)
    with Problems() as problems:
        force = scalar(preload, "dynamic_stiffness.preload", problems)
        size = (
            None
            if amplitude is None
            else scalar(amplitude, "dynamic_stiffness.amplitude", problems)
        )
        if size is not None and isinstance(size, np.ndarray) and size <= 0:
            problems.add(
                "NOT_POSITIVE",
                "dynamic_stiffness.amplitude",
                f"is {size:g}",
                value=float(size),
                limit="> 0",
            )
    result = _stiffness(
        spring, damper, f, device_array(force), None if size is None else device_array(size)
    )
    return warn_if_failed(DynamicStiffness(f, *result, unit=unit))  # pyright: ignore[reportCallIssue]


def _laws_of(element: Any, direction: str | None) -> tuple[laws.Law | None, laws.Law | None, str]:
    """Return the laws of the deformation and of its rate, and the unit of the stiffness."""
    if isinstance(element, Mount):
        if direction not in DIRECTIONS:
            raise JaxbodyError(
                Problem(
                    "BAD_DIRECTION",
                    "dynamic_stiffness.direction",
                    f"is {direction!r}",
                    direction,
                    ", ".join(DIRECTIONS),
                )
            )
        damper = _linear(element.damping[DIRECTIONS.index(direction)])
        return getattr(element, direction), damper, "N m/rad" if direction[0] == "r" else "N/m"
    if isinstance(element, LawForces):
        angle = type(element).__dataclass_fields__["spring"].metadata["words"]["argument"] == "rad"
        return *(
            getattr(element, name) for name in ("spring", "damper")
        ), "N m/rad" if angle else "N/m"  # pyright: ignore[reportReturnType]
    if isinstance(element, Spring):
        return _linear(element.stiffness), _linear(element.damping), "N/m"
    if isinstance(element, laws.Law):
        return element, None, "N/m"
    raise JaxbodyError(
        Problem(
            "WRONG_KIND",
            "dynamic_stiffness.element",
            f"is a {type(element).__name__}",
            element,
            "a law, or an element with laws such as SpringDamper or Mount",
        )
    )


def _linear(coefficient: Any) -> laws.Law:
    return eqx.tree_at(lambda law: law.coefficient, laws.Linear(0.0), coefficient)


def _bound(spring: laws.Law | None, make) -> Any:
    """Return the spring with each law with memory replaced by make(law, i, j), with its states at
    the indices from i to j - 1."""
    counts = [len(law.states) for law in law_states.memories(spring)]
    places = itertools.pairwise(itertools.accumulate(counts, initial=0))

    def one(law):
        return make(law, *next(places)) if isinstance(law, Memory) else law

    return jax.tree.map(one, spring, is_leaf=with_states)


@program
def _stiffness(
    spring,
    damper,
    f: Float[Array, "nf"],
    preload: Float[Array, ""],
    amplitude: Float[Array, ""] | None,
):
    """Return (stiffness, deformation, status)."""
    at_rest = _bound(spring, lambda law, i, j: Relaxed(law, jnp.zeros(j - i, f.dtype)))
    e0, carried = _deformation_of(at_rest, preload)
    z0 = jnp.concatenate([jnp.zeros(0, f.dtype), *law_states.rest_states(at_rest, e0)])
    w = 2 * jnp.pi * f
    if amplitude is None:
        K = jax.vmap(lambda w: _small(spring, damper, e0, z0, w))(w)
        steady = jnp.array(True)
    else:
        K, steady = jax.vmap(lambda w: _large(spring, damper, e0, z0, w, amplitude))(w)
    status = jnp.where(carried & jnp.all(steady), Status.OK.value, Status.NOT_CONVERGED.value)
    return rows_or_nan(carried, K), rows_or_nan(carried, e0), status


def _deformation_of(at_rest, preload):
    """Return the deformation under a static force, by Newton's method with a bounded step, and
    whether it converged, so that the spring force equals the given one."""
    frozen, wanted = jax.lax.stop_gradient((at_rest, preload))

    def step(law, e, force):
        slope = laws.slope(law, e)
        return (laws.force(law, e) - force) / jnp.where(slope == 0, 1.0, slope)

    def iterate(_, e):
        change = step(frozen, e, wanted)
        most = (
            0.5 * jnp.abs(e)
            + jnp.abs(wanted) / jnp.maximum(jnp.abs(laws.slope(frozen, jnp.zeros_like(e))), 1e-300)
            + 1e-12
        )
        return e - jnp.clip(change, -most, most)

    e = jax.lax.fori_loop(0, SEARCH, iterate, jnp.zeros_like(preload))
    missing = jnp.abs(laws.force(frozen, e) - wanted)
    return e - step(at_rest, e, preload), missing <= 1e-8 * jnp.abs(wanted)


def _small(spring, damper, e0, z0, w):
    """Return K at a small amplitude."""
    apart = _bound(spring, lambda law, i, j: Apart(law, z0[i:j], jnp.zeros(j - i, z0.dtype)))
    zero = jnp.zeros_like(e0)
    damping = jax.grad(lambda rate: law_states.rate_force(apart, damper, e0, rate))(zero)
    K = jax.lax.complex(laws.slope(apart, e0), w * damping)
    if law_states.has_rows(apart):
        V_ye, V_yy, R_ye, R_yy, T_yy = law_states.inner(apart, e0, zero)
        rows = jax.lax.complex(V_ye, w * R_ye)
        K = K - jnp.sum(
            rows * jnp.linalg.solve(jax.lax.complex(V_yy - w**2 * T_yy, w * R_yy), rows)
        )
    return K


def _large(spring, damper, e0, z0, w, X):
    """Return K at the amplitude X, and whether the periodic state was found."""
    T = 2 * jnp.pi / w
    even = T / STEPS * jnp.arange(STEPS + 1, dtype=w.dtype)

    def rates(given, t, z):
        spring, damper, X, e0 = given
        e, e_dot = e0 + X * jnp.cos(w * t), -X * w * jnp.sin(w * t)
        held = _bound(spring, lambda law, i, j: Held(law, z[i:j]))
        F = laws.force(held, e) + law_states.rate_force(held, damper, e, e_dot)
        z_dot = jnp.concatenate([jnp.zeros(0, z.dtype), *law_states.state_rates(held, e, e_dot)])
        return z_dot, jnp.stack([F * jnp.cos(w * t), -F * jnp.sin(w * t)])

    def period(given, z, times):
        """Return z after a period and the integral of F exp(-i w t), and the rates at the beginning
        of each step."""

        def step(carry, i):
            z, total = carry
            t, h = times[i], times[i + 1] - times[i]
            k1, f1 = rates(given, t, z)
            k2, f2 = rates(given, t + h / 2, z + h / 2 * k1)
            k3, f3 = rates(given, t + h / 2, z + h / 2 * k2)
            k4, f4 = rates(given, t + h, z + h * k3)
            return (
                z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4),
                total + h / 6 * (f1 + 2 * f2 + 2 * f3 + f4),
            ), jnp.append(k1, f1)

        return jax.lax.scan(step, (z, jnp.zeros(2, z.dtype)), jnp.arange(len(times) - 1))

    given = spring, damper, X, e0
    frozen, start = jax.lax.stop_gradient((given, z0))

    def closure(z, times):
        return jax.jacfwd(lambda z: period(frozen, z, times)[0][0] - z)(z)

    def newton(_, z):
        return z - jnp.linalg.lstsq(closure(z, even), period(frozen, z, even)[0][0] - z)[0]

    z, good = start, jnp.array(True)
    if len(z0):
        z = jax.lax.fori_loop(0, PERIODS, lambda _, z: period(frozen, z, even)[0][0], z)
        z = jax.lax.fori_loop(0, NEWTON, newton, z)
    times = _graded(even, jax.lax.stop_gradient(period(frozen, z, even)[1]))
    if len(z0):
        slopes = jax.lax.stop_gradient(closure(z, times))
        z = jax.lax.stop_gradient(z - jnp.linalg.solve(slopes, period(frozen, z, times)[0][0] - z))
        # its value is zero; it adds the derivative of the periodic state
        change = jnp.linalg.solve(slopes, period(given, z, times)[0][0] - z)
        rate = jax.vmap(lambda t: _fastest(jax.jacfwd(lambda z: rates(frozen, t, z)[0])(z)))(
            even[: -1 : STEPS // 8]
        )
        size = jnp.max(jnp.abs(z), initial=0.0) + jnp.abs(jax.lax.stop_gradient(X))
        good = (jnp.max(jnp.abs(jax.lax.stop_gradient(change))) <= 1e-6 * size) & (
            jnp.max(rate) * even[1] <= STABLE
        )
        z = z - change
    total = period(given, z, times)[0][1]
    K = jax.lax.complex(*(total * (w / jnp.pi / X)))
    return rows_or_nan(good, K), good


def _graded(even: Float[Array, "n"], rates: Float[Array, "m k"]) -> Float[Array, "_"]:
    """Return the end times of twice as many steps as in `even`: half of them of equal length, half
    distributed in proportion to the second differences of the rates, relative to the largest rate.
    Each half period has the same number of steps, so that the deformation turns back at the end of
    a step."""
    size = jnp.max(jnp.abs(rates), 0)
    around = jnp.concatenate([rates[-1:], rates, rates[:1]])
    bend = jnp.sum(jnp.abs(jnp.diff(around, 2, axis=0)) / jnp.where(size > 0, size, 1.0)[None], 1)
    bend = (bend + jnp.roll(bend, -1)).reshape(2, -1)  # at both ends of a step
    total = jnp.sum(bend, 1, keepdims=True)
    share = jnp.where(total > 0, bend / jnp.where(total > 0, total, 1.0), 0.0) + 1 / bend.shape[1]
    reached = jnp.cumsum(share, 1) / jnp.sum(share, 1, keepdims=True)
    wanted = jnp.arange(len(rates), dtype=even.dtype) / len(rates)
    halves = jnp.stack([even[: len(rates) // 2 + 1], even[len(rates) // 2 :]])
    at = jax.vmap(jnp.interp, (None, 0, 0))(
        wanted, jnp.pad(reached, ((0, 0), (1, 0))), halves
    ).ravel()
    return jnp.append(at, even[-1])


def _fastest(A: Float[Array, "n n"]) -> Float[Array, ""]:
    """Return an estimate of the largest modulus of the eigenvalues, |A^32|^(1/32): unlike a norm of
    A, it hardly depends on the different units of coordinates and rates."""
    for _ in range(5):
        A = A @ A
    return jnp.max(jnp.abs(A)) ** (1 / 32)
