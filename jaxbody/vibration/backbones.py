"""Range of validity of the linear model: the curvature of each mode's backbone curve, frequency
over amplitude, by the method of Lindstedt and Poincaré.

With x the coordinates about the equilibrium, L = T - V and K phi = w^2 M phi, the periodic motion
that tends to the mode for small a is

    x = a phi cos(s) + a^2 (c0 + c2 cos(2 s)) + O(a^3),   s = w (1 + gamma a^2) t

It makes the average of L over s stationary (Whitham). At order a^4 this average is
A + B0' c0 + B2' c2 - c0' K c0/2 - c2' (K - 4 w^2 M) c2/4,

    A  = w^2 T2/16 - V4/64                     V3, V4, T1, T2: derivatives of V and T along the
                                               motion at constant speeds phi
    B0 = (w^2 (t - b) - g)/4                   g = grad V3/3,
    t = grad T1   (V3 and T1 as cubic forms of phi)
    B2 = (w^2 (t + 3 b) - g)/8                 b the inertial force at constant speeds phi

so that K c0 = B0, (K - 4 w^2 M) c2 = 2 B2, and with m = phi' M phi

    gamma = -2 (2 A + B0' c0 + B2' c2)/(w^2 m)

In a model with closures, x are the independent coordinates, which the others follow: v = N(q) u at
each point of a motion at constant speeds u. (B0 and B2 are (w^2 d - g)/4 and
(4 w^2 p - w^2 d - g)/8 with d the gradient of phi' M(x) phi, p the derivative of M(x) phi along
phi; t = d/2 + p and b = p - d/2.) Straight lines x = a u of these coordinates are motions at
constant speeds u; all derivatives are taken along them. For x'' + w^2 x + alpha x^2 + beta x^3 = 0,
gamma is 3 beta/(8 w^2) - 5 alpha^2/(12 w^4). Source: Nayfeh and Mook, Nonlinear Oscillations
(1979), 2.3.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, Int, module_of, rows_or_nan, tangent_or_nan
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import MESSAGES, Status
from jaxbody.core.results import Labeled, Result, dataset, warn_if_failed
from jaxbody.geometry.frames import Frame
from jaxbody.geometry.vectors import rotate, rotate_back
from jaxbody.lagrange import kinetic, potential
from jaxbody.mechanics.free_motions import speeds_on_closures
from jaxbody.model.joints.frame_tables import inertial_tables, of_table
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.layouts import Layout
from jaxbody.model.models import scale_of, size_of
from jaxbody.model.preconditions import check_potential, check_without_memory
from jaxbody.model.storage import KindTable
from jaxbody.numerics.eigenproblems import ZERO
from jaxbody.vibration.linearizations import Linearization, check_system
from jaxbody.vibration.natural_modes import modes_of

# relative distance of w_j^2 from 4 w^2 below which mode j resonates with the second harmonic
RESONANT = 1e-3
COUPLED = 1e-9  # smallest nondimensional force that excites a mode, above rounding
AT_REST = 1e-6  # largest distance from the equilibrium, relative to the size of the model


class Backbones(Labeled, Result):
    """The backbone curve of each mode, by ascending frequency: w(a) = w (1 + gamma a^2), with the
    amplitude a of the mode's largest component in m or rad.

    `frequency` [Hz] of small motions; `shapes` (columns phi, the largest component 1) by
    `coordinates`, with closures the independent ones; `largest`, the index of that component
    (rotations weighted with the size of the model); `curvature` gamma [1/m2 or 1/rad2], negative
    where the mode softens; `drift` c0 and `second_harmonic` c2 (columns), the mean and the second
    harmonic of the motion per a^2; `stiffness`, `third` and `fourth`, the derivatives of V along
    the straight line a phi of the chart. `status` of each mode: UNSTABLE, SINGULAR_K,
    INTERNAL_RESONANCE or NOT_CONVERGED, with gamma NaN, where the mode has no backbone."""

    index = "mode"
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
    independent: tuple[int, ...] = field(static=True)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The names of the rows of shapes, drift and second harmonic."""
        return tuple(self.layout.coordinates[i] for i in self.independent)

    @property
    def turns(self) -> np.ndarray:
        """Whether each of the `coordinates` is an angle."""
        return self.layout.turns[np.array(self.independent, int)]

    def at(self, amplitude: Any) -> Float[Array, "nv"]:
        """Return the frequencies [Hz] at amplitudes a [m or rad] (one for all modes or one for
        each), to second order."""
        return self.frequency * (1 + self.curvature * jnp.asarray(amplitude) ** 2)

    def force_within(self, percent: float) -> Float[Array, "nv"]:
        """Return the amplitudes up to which the restoring force along phi is within `percent` of
        the linear one:

        |V'''| a/(2 V'') + |V''''| a^2/(6 V'') = percent/100; the result depends on the chart where
        bodies turn about several axes."""
        xp = module_of(self.third)
        b, c, p = (
            abs(self.third) / (2 * self.stiffness),
            abs(self.fourth) / (6 * self.stiffness),
            percent / 100,
        )
        square = b**2 + 4 * c * p
        return xp.where(
            square > 0,
            2 * p / (b + xp.where(square > 0, square, 1.0) ** 0.5),
            xp.where(xp.isnan(square), xp.nan, xp.inf),
        )

    def frequency_within(self, percent: float) -> Float[Array, "nv"]:
        """Return the amplitudes up to which the frequency is within `percent` of that of small
        motions, sqrt(percent/100/|gamma|)."""
        return (percent / 100 / abs(self.curvature)) ** 0.5

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: frequency, curvature and the derivatives of V by mode, shapes
        by mode and named coordinate."""
        largest = np.asarray(self.largest)
        return dataset(
            {
                "frequency": (("mode",), self.frequency, "Hz"),
                "curvature": (("mode",), self.curvature, "1/m2 or 1/rad2"),
                "stiffness": (("mode",), self.stiffness, "N/m or N m"),
                "third": (("mode",), self.third, "N/m2 or N m"),
                "fourth": (("mode",), self.fourth, "N/m3 or N m"),
                "largest": (("mode",), np.asarray(self.coordinates)[largest], ""),
                "shape": (("coordinate", "mode"), self.shapes, "largest component 1"),
                "drift": (("coordinate", "mode"), self.drift, "per amplitude^2"),
                "second_harmonic": (
                    ("coordinate", "mode"),
                    self.second_harmonic,
                    "per amplitude^2",
                ),
                "status": (("mode",), self.status, ""),
            },
            {"mode": list(range(1, largest.shape[-1] + 1)), "coordinate": list(self.coordinates)},
            "backbone_curves",
        )

    @tables.summarized("Backbones", 1, curvature="curvature [1/m2, 1/rad2]")
    def _tables(self) -> list[tables.PrintedTable]:
        rows = []
        for i, (force, frequency) in enumerate(
            zip(self.force_within(5), self.frequency_within(5), strict=True)
        ):
            largest, status = int(self.largest[i]), Status(int(self.status[i]))
            unit = "rad" if self.turns[largest] else "m"
            change = status.name if status else f"{self.curvature[i]:+.4g} /{unit}2"
            limits = ("", "") if status else (_amplitude(force, unit), _amplitude(frequency, unit))
            rows.append((str(i + 1), self.frequency[i], self.coordinates[largest], change, *limits))
        failures = [Status(code) for code in np.unique(self.status).tolist() if code]
        notes = [f"{failure.name}: {MESSAGES[failure]}" for failure in failures]
        return [
            tables.PrintedTable(
                "Backbones",
                (
                    "mode",
                    "frequency [Hz]",
                    "largest component",
                    "change of frequency",
                    "force within 5 %",
                    "frequency within 5 %",
                ),
                rows,
                "; ".join(["amplitudes of the largest component", *notes]),
            )
        ]


def _amplitude(value: Any, unit: str) -> str:
    return f"up to {value:.3g} {unit}" if np.isfinite(value) else "any"


def backbone_curves(lin: Linearization, *, allow_float32: bool = False) -> Backbones:
    """Compute the change of natural frequencies with amplitude, and the amplitude up to which the
    linear model is valid, without damping.

        w(a) = w (1 + gamma a^2 + ...),   a the amplitude of the largest component of the mode [m
                                          or rad]

    gamma is exact: quadratic forces and inertia act through all other modes. It does not exist
    where another mode has the same frequency, or has twice the frequency and is coupled (a 3:1
    resonance is not detected); near such a resonance it is valid for small amplitudes only. The
    result is differentiable with respect to the model in forward and reverse mode.
    Errors: FLOAT32 unless `allow_float32`; warns UNSTABLE, SINGULAR_K, INTERNAL_RESONANCE, and
    NOT_CONVERGED where the state is not an equilibrium. Source: Nayfeh and Mook, Nonlinear
    Oscillations (1979), 2.3 and 6.

    A pendulum softens as 1 - a^2/16:

    >>> bob = jb.Body(mass=1.0, inertia=[1e-3, 1e-3, 1e-3], com=[0, 0, -0.5])
    >>> model = jb.Model(
    ...     bodies={"bob": bob},
    ...     joints={"bob": jb.Hinge("world", axis=[0, 1, 0])},
    ...     gravity=[0, 0, -9.81],
    ... )
    >>> curves = jb.vibration.backbone_curves(jb.linearize(model, jb.equilibrium(model)))
    >>> round(float(curves.curvature[0]), 12), round(float(curves.frequency_within(1.0)[0]), 12)
    (-0.0625, 0.4)
    """
    check_system(lin, "backbone_curves", allow_float32=allow_float32)
    check_without_memory("backbone_curves", lin.model)
    check_potential("backbone_curves", lin.model)
    return warn_if_failed(_backbones(lin))


@program
def _backbones(lin: Linearization) -> Backbones:
    model, K, M, straight = (
        lin.model,
        (lin.K + lin.K.T) / 2,
        (lin.M + lin.M.T) / 2,
        Straight(Coordinates(lin.model)),
    )
    frozen = jax.lax.stop_gradient(lin)
    (_, shapes, _, values, cluster, _), size = modes_of(frozen), size_of(frozen.model)
    scale = scale_of(frozen.model, size)[np.array(lin.independent, int)]
    MS = frozen.M @ shapes
    top = jnp.max(jnp.abs(values))
    single = jnp.sum(cluster[:, None] == cluster[None], 0) == 1
    oscillates = values > ZERO * top
    valid, rigid = single & oscillates, jnp.abs(values) <= ZERO * top
    largest = jnp.argmax(jnp.abs(shapes) / scale[:, None], axis=0)

    def solve(D, near, B):
        """Return the solution x of D x = B without components of the modes in `near`, the null
        vectors of D, which B does not excite."""
        return jnp.linalg.solve(D + top * (MS * near.astype(MS.dtype)[None]) @ MS.T, B)

    def one(phi, value, i, good):
        phi, value = _mode(K, M, phi / phi[i], value, i, good)
        square = jnp.where(good, value, 1.0)  # w^2
        m = jnp.sum(phi * (M @ phi))
        force, V3, V4, g = _stiffening(straight, lin.state.q, phi, scale / scale[i])
        T2, t, b = _inertia(straight, lin.state.q, phi)
        A = square * T2 / 16 - V4 / 64
        B0 = (square * (t - b) - g) / 4
        B2 = (square * (t + 3 * b) - g) / 8
        doubled = jnp.abs(values - 4 * square) <= RESONANT * 4 * square
        c0, c2 = solve(K, rigid, B0), solve(K - 4 * square * M, doubled, 2 * B2)
        gamma = -2 * (2 * A + jnp.sum(B0 * c0) + jnp.sum(B2 * c2)) / (square * m)
        least = COUPLED * square * jnp.sqrt(m) / (size * scale[i])
        drifts = jnp.any(rigid & (jnp.abs(shapes.T @ B0) > least))
        resonates = jnp.any(doubled & (jnp.abs(shapes.T @ B2) > least))
        # near: whether the state is an equilibrium
        near = jnp.max(jnp.abs(solve(K, rigid, force)) / scale) <= AT_REST * size
        return phi, value, gamma, c0, c2, jnp.sum(phi * (K @ phi)), V3, V4, near, drifts, resonates

    phi, value, gamma, c0, c2, V2, V3, V4, near, drifts, resonates = jax.vmap(
        one, in_axes=(1, 0, 0, 0)
    )(shapes, values, largest, valid)
    failures = {
        Status.NOT_CONVERGED: (lin.status == Status.NOT_CONVERGED) | ~near,
        Status.UNSTABLE: values < -ZERO * top,
        Status.SINGULAR_K: ~oscillates | drifts,
        Status.INTERNAL_RESONANCE: ~single | resonates,
    }
    status = jnp.select(list(failures.values()), [code.value for code in failures], Status.OK.value)
    ok = status == Status.OK
    gamma, c0, c2, V2, V3, V4 = (
        rows_or_nan(ok if x.ndim == 1 else ok[:, None], x) for x in (gamma, c0, c2, V2, V3, V4)
    )
    frequency = jnp.where(
        valid, jnp.sqrt(jnp.where(valid, value, 1.0)) / (2 * jnp.pi), modes_of(lin)[0]
    )
    return Backbones(
        frequency,
        phi.T,
        largest,
        gamma,
        c0.T,
        c2.T,
        V2,
        V3,
        V4,
        status,
        model.layout,
        lin.independent,
    )


@jax.custom_jvp
def _mode(K, M, phi, value, i, single):
    """Return (phi, w^2), where phi_i = 1, with the derivatives of a mode whose frequency is
    single:

    (K - w^2 M) dphi - M phi dw^2 = -(dK - w^2 dM) phi,
    dphi_i = 0. Those of `eigh` are NaN where other frequencies coincide."""
    return phi, value


@_mode.defjvp
def _mode_jvp(primals, tangents):
    K, M, _, _, i, single = primals
    phi, value = _mode(*primals)
    n = len(phi)
    unit = (jnp.arange(n) == i).astype(phi.dtype)
    bordered = jnp.block(
        [[K - value * M, -(M @ phi)[:, None]], [unit[None], jnp.zeros((1, 1), phi.dtype)]]
    )
    bordered = jnp.where(single, bordered, jnp.eye(n + 1, dtype=phi.dtype))
    right = -(tangents[0] @ phi - value * (tangents[1] @ phi))
    change = tangent_or_nan(
        single, jnp.linalg.solve(bordered, jnp.concatenate([right, jnp.zeros(1, phi.dtype)]))
    )
    return (phi, value), (change[:n], change[n])


class Straight(NamedTuple):
    """Motions at constant speeds u of the independent coordinates; they are the straight lines of
    the chart."""

    coordinates: Coordinates

    def speeds(self, q: Float[Array, "nq"], u: Float[Array, "nf"]) -> Float[Array, "nv"]:
        """Return v, the speeds of all coordinates."""
        return speeds_on_closures(self.coordinates, q, u) if self.coordinates.model.closures else u

    def frames(self, q: Float[Array, "nq"], u: Float[Array, "nf"]) -> Frame:
        return self.coordinates.at_rest(q, self.speeds(q, u))

    def rate(self, q: Float[Array, "nq"], u: Float[Array, "nf"]) -> Float[Array, "nq"]:
        """Return q'."""
        return self.coordinates.rate(q, self.speeds(q, u))

    def derivatives(
        self,
        function: Callable[[Array], Array],
        q: Float[Array, "nq"],
        u: Float[Array, "nf"],
        order: int,
    ) -> tuple[Array, ...]:
        """Return the value of function(q) and its derivatives along the motion, up to an order."""
        if order == 0:
            return (function(q),)
        values, rates = jax.jvp(
            lambda q: self.derivatives(function, q, u, order - 1), (q,), (self.rate(q, u),)
        )
        return (*values, rates[-1])


def _stiffening(
    straight: Straight, q: Float[Array, "nq"], phi: Float[Array, "nf"], step: Float[Array, "nf"]
):
    """Return grad V, V3, V4 and g, the third derivatives along phi, phi and unit vectors e, by
    polarization; `step` scales e:

    6 V3(u, u, e) = V3(u + e) - V3(u - e) - 2 V3(e)"""
    coordinates, e = straight.coordinates, jnp.diag(step)

    def derivatives(u):
        return straight.derivatives(
            lambda q: potential(coordinates.model, coordinates.at_rest(q)), q, u, 4
        )

    _, V1, _, V3, V4 = jax.vmap(derivatives)(
        jnp.concatenate([phi[None], phi[None] + e, phi[None] - e, e])
    )
    plus, minus, own = jnp.split(V3[1:], 3)
    return V1[1 + 2 * len(phi) :] / step, V3[0], V4[0], (plus - minus - 2 * own) / (6 * step)


def _inertia(straight: Straight, q: Float[Array, "nq"], phi: Float[Array, "nf"]):
    """Return T2, t = grad T1 and b, by the Newton-Euler equations: b is the virtual power of the
    rates of momentum and angular momentum of each body, and of the inertial forces of elements."""
    model = straight.coordinates.model
    bodies = model.bodies.rows

    def velocities(u):
        frames = straight.frames(q, u)[model.layout.first_body :]
        return frames.velocity(bodies.com), frames.w

    def momenta(q):
        frames = straight.frames(q, phi)[model.layout.first_body :]
        return bodies.mass[:, None] * frames.velocity(bodies.com), rotate(
            frames.R, rotate(bodies.inertia, rotate_back(frames.R, frames.w))
        )

    def along(u, order):
        return straight.derivatives(lambda q: kinetic(model, straight.frames(q, u)), q, u, order)[
            -1
        ]

    rates = jax.jvp(momenta, (q,), (straight.rate(q, phi),))[1]
    (b,) = jax.vjp(velocities, jnp.zeros_like(phi))[1](rates)
    for table in inertial_tables(model):
        b = b + _force_of_inertia(straight, table, q, phi)
    return along(phi, 2), jax.grad(lambda u: along(u, 1))(phi), b


def _force_of_inertia(
    straight: Straight, table: KindTable, q: Float[Array, "nq"], phi: Float[Array, "nf"]
) -> Float[Array, "nf"]:
    """Return de/dDelta' (d/dt dT/de_dot - dT/de) at constant speeds phi, for the elements of a
    table."""

    def of(q, u, function):
        frames = straight.frames(q, u)
        return of_table(
            straight.coordinates.model,
            frames,
            table,
            lambda element, *ends: function(element, *element.rates(*ends)),
        )

    rate = jax.jvp(
        lambda q: of(q, phi, lambda s, e, e_dot: s.momentum(e, e_dot)),
        (q,),
        (straight.rate(q, phi),),
    )[1]
    force = rate - of(q, phi, lambda s, e, e_dot: jax.grad(s.kinetic_energy)(e, e_dot))
    return jax.vjp(lambda u: of(q, u, lambda s, e, e_dot: e_dot), jnp.zeros_like(phi))[1](force)[0]
