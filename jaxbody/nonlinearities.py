"""How far the linear model is good: the curvature of each mode's backbone, frequency over amplitude, by Lindstedt and Poincaré.

With x the chart about the equilibrium, L = T - V and K phi = w^2 M phi, the periodic motion that begins as the mode is

    x = a phi cos(s) + a^2 (c0 + c2 cos(2 s)) + O(a^3),   s = w (1 + gamma a^2) t

It makes the average of L over s stationary (Whitham). At order a^4 this average is A + B0' c0 + B2' c2 - 1/2 c0' K c0 - 1/4 c2' (K - 4 w^2 M) c2,

    A  = w^2 tau''/32 - V''''/64          tau(x) = phi' M(x) phi = 2 T(x, phi);  V'''' and tau'' along phi
    B0 = (w^2 grad tau - grad nu)/4       nu(x)  = phi' (Hessian of V at x) phi
    B2 = w^2 p'/2 - (w^2 grad tau + grad nu)/8          p(x) = M(x) phi, p' its derivative along phi

so that K c0 = B0, (K - 4 w^2 M) c2 = 2 B2, and with m = phi' M phi

    gamma = -4 (A + (B0' c0 + B2' c2)/2)/(w^2 m)

For x'' + w^2 x + alpha x^2 + beta x^3 = 0 this is 3 beta/(8 w^2) - 5 alpha^2/(12 w^4) (Nayfeh and Mook, Nonlinear Oscillations, 1979, 2.1).
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from equinox import field, filter_jit
from jaxtyping import Array, Float, Int

from jaxbody import tables
from jaxbody.checks import check_precision
from jaxbody.errors import MESSAGES, Status, is_concrete
from jaxbody.frames import Frame
from jaxbody.kinematics import Coordinates, supports_at
from jaxbody.linearizations import Linearization
from jaxbody.mechanics import kinetic, potential
from jaxbody.models import Layout, Model
from jaxbody.results import Result, warn_if_failed
from jaxbody.rotations import cross
from jaxbody.statics import scale_of, size_of
from jaxbody.vibrations import ZERO, _modes

RESONANT = 1e-3  # relative distance of w_j^2 from 4 w^2 below which mode j answers the second harmonic without bound
COUPLED = 1e-9  # nondimensional force on a mode, above rounding, that makes it answer
AT_REST = 1e-6  # distance from the equilibrium, relative to the size of the model, that a state may have


class Backbones(Result):
    """The backbone of each mode, ascending: w(a) = w (1 + gamma a^2), a the amplitude of the mode's largest component, m or rad.

    `frequency` [Hz], of small motions; `shapes` (columns phi, the largest component 1), `largest` which that is (rotations times the size of the model),
    `curvature` gamma [1/m2 or 1/rad2], negative where the mode softens; `drift` c0 and `second_harmonic` c2 (columns), what the mean and
    the second harmonic of the motion are per a^2; `stiffness`, `third` and `fourth`, the derivatives of V along the straight line a phi of
    the chart. `status` is one of each mode: UNSTABLE, SINGULAR_K, INTERNAL_RESONANCE or NOT_CONVERGED, and gamma NaN, where the mode
    has no backbone of its own."""

    frequency: Float[Array, "nv"]
    shapes: Float[Array, "nv nv"]
    largest: Int[Array, "nv"]
    curvature: Float[Array, "nv"]
    drift: Float[Array, "nv nv"]
    second_harmonic: Float[Array, "nv nv"]
    stiffness: Float[Array, "nv"]
    third: Float[Array, "nv"]
    fourth: Float[Array, "nv"]
    status: Int[Array, "nv"]
    layout: Layout = field(static=True)

    def at(self, amplitude: Any) -> Float[Array, "nv"]:
        """The frequencies [Hz] at amplitudes a (one, or one of each mode), to second order."""
        return self.frequency * (1 + self.curvature * jnp.asarray(amplitude) ** 2)

    def force_within(self, percent: float) -> Float[Array, "nv"]:
        """The amplitudes up to which the restoring force along phi is within a percentage of the linear one:

        |V'''| a/(2 V'') + |V''''| a^2/(6 V'') = percent/100; it depends on the chart where bodies turn about several axes."""
        b, c, p = jnp.abs(self.third) / (2 * self.stiffness), jnp.abs(self.fourth) / (6 * self.stiffness), percent / 100
        square = b**2 + 4 * c * p
        bent = square > 0
        return jnp.where(bent, 2 * p / (b + jnp.sqrt(jnp.where(bent, square, 1.0))), jnp.where(jnp.isnan(square), jnp.nan, jnp.inf))

    def frequency_within(self, percent: float) -> Float[Array, "nv"]:
        """The amplitudes up to which the frequency is within a percentage of that of small motions, sqrt(percent/100/|gamma|)."""
        return jnp.sqrt(percent / 100 / jnp.abs(self.curvature))

    def to_xarray(self) -> Any:
        """An xarray.Dataset: frequency, curvature and the derivatives of V by mode, shapes by mode and named coordinate."""
        from jaxbody.exports import backbones_dataset

        return backbones_dataset(self)

    def _tables(self) -> list[tables.Table]:
        if self.frequency.ndim > 1 or not is_concrete(self.frequency):
            return [tables.Table("Backbones", ("", ""), [("curvature [1/m2, 1/rad2]", self.curvature)])]
        rows = []
        for i, (force, frequency) in enumerate(zip(self.force_within(5), self.frequency_within(5), strict=True)):
            largest, status = int(self.largest[i]), Status(int(self.status[i]))
            unit = "rad" if self.layout.turns[largest] else "m"
            change = status.name if status else f"{self.curvature[i]:+.4g} /{unit}2"
            limits = ("", "") if status else (_milli(force, unit), _milli(frequency, unit))
            rows.append((str(i + 1), self.frequency[i], self.layout.coordinates[largest], change, *limits))
        failed = sorted({Status(int(code)) for code in self.status if code})
        heads = ("mode", "frequency [Hz]", "largest component", "change of frequency", "force within 5 %", "frequency within 5 %")
        note = "; ".join(["amplitudes of the largest component", *(f"{status.name}: {MESSAGES[status]}" for status in failed)])
        return [tables.Table("Backbones", heads, rows, note)]


def _milli(amplitude: Any, unit: str) -> str:
    return f"up to {1000 * amplitude:.3g} m{unit}" if np.isfinite(amplitude) else "at any"


def backbones(lin: Linearization, *, allow_float32: bool = False) -> Backbones:
    """How the natural frequencies change with amplitude, and up to which amplitude the linear model is good, without damping.

        w(a) = w (1 + gamma a^2 + ...),   a the amplitude of the largest component of the mode [m or rad]

    The coefficient is exact: it has what quadratic forces and inertia add through all other modes. The mode must move alone: where its frequency
    is another's too, or its double is and they are coupled, there is no such coefficient (a 3:1 resonance is not looked for). Differentiable with respect to the
    model in forward and reverse mode. Errors: FLOAT32 unless `allow_float32`; warns UNSTABLE, SINGULAR_K, INTERNAL_RESONANCE, and NOT_CONVERGED
    where the state is not an equilibrium. Source: Nayfeh and Mook, Nonlinear Oscillations (1979), 2.3 and 6.

    A pendulum softens as 1 - a^2/16:

    >>> bob = Body(mass=1.0, inertia=[1e-3, 1e-3, 1e-3], com=[0, 0, -0.5])
    >>> model = Model(bodies={"bob": bob}, joints={"bob": Hinge("world", axis=[0, 1, 0])}, gravity=[0, 0, -9.81])
    >>> found = backbones(linearize(model, equilibrium(model)))
    >>> round(float(found.curvature[0]), 12), round(float(found.frequency_within(1.0)[0]), 12)
    (-0.0625, 0.4)
    """
    check_precision("backbones", lin.model, needs_float64=not allow_float32)
    result = _backbones(lin)
    warn_if_failed(result)
    return result


@filter_jit
def _backbones(lin: Linearization) -> Backbones:
    model, K, M = lin.model, (lin.K + lin.K.T) / 2, (lin.M + lin.M.T) / 2
    frozen = jax.lax.stop_gradient(lin)
    linear, size = _modes(frozen), size_of(frozen.model)
    scale = scale_of(frozen.model, size)
    values, shapes, MS = linear.eigenvalues, linear.shapes, frozen.M @ linear.shapes
    top = jnp.max(jnp.abs(values))
    alone = jnp.sum(linear.cluster[:, None] == linear.cluster, 0) == 1
    oscillates = values > ZERO * top
    valid = alone & oscillates
    largest = jnp.argmax(jnp.abs(shapes) / scale[:, None], axis=0)

    def solve(D, near, B):
        """x with D x = B; modes near to a null vector of D are left out of x, as they may be where B does not drive them."""
        kept = D + top * (MS * near) @ MS.T
        return jnp.linalg.solve(kept, B)

    def one(phi, value, i, good):
        phi, value = _mode(K, M, phi / phi[i], value, i, good)
        square = jnp.where(good, value, 1.0)  # w^2
        m = jnp.sum(phi * (M @ phi))
        (_, grad_nu, g3), (p1, p2), grad_tau = _derivatives(lin, phi)
        V3, V4, tau2 = jnp.sum(phi * grad_nu), jnp.sum(phi * g3), jnp.sum(phi * p2)
        A = square * tau2 / 32 - V4 / 64
        B0 = (square * grad_tau - grad_nu) / 4
        B2 = square * p1 / 2 - (square * grad_tau + grad_nu) / 8
        still = jnp.abs(values) <= ZERO * top
        doubled = jnp.abs(values - 4 * square) <= RESONANT * 4 * square
        c0, c2 = solve(K, still, B0), solve(K - 4 * square * M, doubled, 2 * B2)
        gamma = -2 * (2 * A + jnp.sum(B0 * c0) + jnp.sum(B2 * c2)) / (square * m)
        least = COUPLED * square * jnp.sqrt(m) / (size * scale[i])
        drifts = jnp.any(still & (jnp.abs(shapes.T @ B0) > least))
        resonates = jnp.any(doubled & (jnp.abs(shapes.T @ B2) > least))
        return phi, value, gamma, c0, c2, jnp.sum(phi * (K @ phi)), V3, V4, drifts, resonates

    phi, value, gamma, c0, c2, V2, V3, V4, drifts, resonates = jax.vmap(one, in_axes=(1, 0, 0, 0))(shapes, values, largest, valid)
    slope = jax.grad(_potential(lin))(jnp.zeros_like(values))
    away = jnp.abs(solve(K, jnp.abs(values) <= ZERO * top, slope)) / scale
    lost = (lin.status == Status.NOT_CONVERGED) | ~(jnp.max(away) <= AT_REST * size)
    failures = {
        Status.NOT_CONVERGED: jnp.broadcast_to(lost, valid.shape),
        Status.UNSTABLE: values < -ZERO * top,
        Status.SINGULAR_K: ~oscillates | drifts,
        Status.INTERNAL_RESONANCE: ~alone | resonates,
    }
    status = jnp.select(list(failures.values()), [code.value for code in failures], Status.OK.value)
    ok = status == Status.OK
    gamma, c0, c2, V2, V3, V4 = (jnp.where(ok if x.ndim == 1 else ok[:, None], x, jnp.nan) for x in (gamma, c0, c2, V2, V3, V4))
    frequency = jnp.where(valid, jnp.sqrt(jnp.where(valid, value, 1.0)) / (2 * jnp.pi), linear.frequency)
    return Backbones(frequency, phi.T, largest, gamma, c0.T, c2.T, V2, V3, V4, status, model.layout)


@jax.custom_jvp
def _mode(K, M, phi, value, i, alone):
    """(phi, w^2) with the derivatives that a mode has where it is alone and phi_i = 1:

    (K - w^2 M) dphi - M phi dw^2 = -(dK - w^2 dM) phi,   dphi_i = 0. Those of `eigh` are NaN where other frequencies coincide."""
    return phi, value


@_mode.defjvp
def _mode_jvp(primals, tangents):
    K, M, _, _, i, alone = primals
    phi, value = _mode(*primals)
    n = len(phi)
    unit = (jnp.arange(n) == i).astype(phi.dtype)
    bordered = jnp.block([[K - value * M, -(M @ phi)[:, None]], [unit[None], jnp.zeros((1, 1), phi.dtype)]])
    bordered = jnp.where(alone, bordered, jnp.eye(n + 1, dtype=phi.dtype))
    right = -(tangents[0] @ phi - value * (tangents[1] @ phi))
    change = jnp.linalg.solve(bordered, jnp.concatenate([right, jnp.zeros(1, phi.dtype)]))
    return (phi, value), (change[:n], change[n])


def _potential(lin: Linearization):
    """V(x)."""
    coordinates, still = Coordinates(lin.model), _still(lin.model)
    speeds = jnp.zeros(lin.model.layout.nv, still.p.dtype)
    return lambda x: potential(lin.model, coordinates.frames(coordinates.retract(lin.state.q, x), speeds, still))


def _kinetic(lin: Linearization):
    """T(x, x'): the speeds v are not x' away from x = 0, so velocities are derivatives of the poses; R' = [w] R."""
    coordinates, still = Coordinates(lin.model), _still(lin.model)

    def pose(x):
        return coordinates.frames(coordinates.retract(lin.state.q, x), jnp.zeros_like(x), still).pose()

    def energy(x, x_dot):
        at, rate = jax.jvp(pose, (x,), (x_dot,))
        w = jnp.sum(cross(jnp.swapaxes(at.R, -1, -2), jnp.swapaxes(rate.R, -1, -2)), -2) / 2
        return kinetic(lin.model, Frame(at.p, at.R, rate.p, w))

    return energy


def _still(model: Model) -> Frame:
    none = jnp.zeros((len(model.layout.supports), 6), model.gravity.dtype)
    return supports_at(model, none, none)


def _derivatives(lin: Linearization, phi: Float[Array, "nv"]):
    """Along x = a phi at a = 0: the first three derivatives of grad V, of which the second is grad nu; the first two of p; and grad tau."""
    V, T, zero = _potential(lin), _kinetic(lin), jnp.zeros_like(phi)
    forces = _along(jax.grad(V), phi, 3)
    momenta = _along(lambda x: jax.grad(T, argnums=1)(x, phi), phi, 2)
    return forces, momenta, 2 * jax.grad(T)(zero, phi)


def _along(function, phi: Float[Array, "nv"], order: int) -> tuple[Array, ...]:
    """The derivatives of function(a phi) at a = 0, from the first to that of an order."""

    def next_one(f):
        def derivatives(a):
            last, (change, *_) = jax.jvp(f, (a,), (jnp.ones_like(a),))
            return (change, *last)

        return derivatives

    f = lambda a: (function(a * phi),)
    for _ in range(order):
        f = next_one(f)
    return f(jnp.zeros((), phi.dtype))[-2::-1]
