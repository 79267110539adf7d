"""Damped and gyroscopic modes: the poles of M x'' + D x' + K x = 0, in pairs, with their
complex shapes."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Complex, Float, Inexact, Int
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Status
from jaxbody.core.results import warn_if_failed
from jaxbody.geometry.vectors import cross
from jaxbody.mechanics.equilibrium_solvers import SINGULAR
from jaxbody.mechanics.force_balances import GROWS
from jaxbody.mechanics.internal_coordinates import following
from jaxbody.model.models import scaled
from jaxbody.numerics.eigenproblems import (
    cholesky_of_mass,
    companion,
    first_order,
    pole_clusters,
    poles,
    refused_if_shared,
    rows_of_one_size,
)
from jaxbody.numerics.precisions import reachable
from jaxbody.vibration.linearizations import Linearization, LinearSystem, check_system
from jaxbody.vibration.natural_modes import ModalResult
from jaxbody.vibration.spins import SpinLinearization

# largest pole that counts as zero, relative to the largest pole: the error of a double pole at zero
REST = 1e-7
# imaginary parts that count as rounding, relative to the pole and to the largest pole
SPLIT, SPLIT_AT_REST = 1e-9, 1e-13


class ComplexModes(ModalResult):
    """n modes, each a pair of poles s [1/s] of (s^2 M + s D + K) u = 0, by ascending
    natural frequency.

    An oscillating mode has conjugate `poles`, s = -zeta w +- i w sqrt(1 - zeta^2); an overdamped
    mode has two real ones, the slower first. `frequency` [Hz], damped, |Im s|/(2 pi);
    `natural_frequency` [Hz], |s1 s2|^(1/2)/(2 pi); `damping_ratio` zeta = -(s1 + s2)/(2 |s1
    s2|^(1/2)), above 1 where overdamped; `decay_rate` -Re s [1/s] of the slower pole; `shapes`
    (columns, complex) of the first pole, u* M u = 1, the component of largest modulus real and
    positive; massless coordinates of elements with memory have no rows. Each of these coordinates
    has one single real pole, in `relaxations` [1/s], the slowest first: the real poles with the
    largest share of energy in massless coordinates. So have states of force elements, by their
    participation in the poles; conjugate pairs are among them where real poles are too few.
    `cluster`: equal numbers for modes whose poles
    coincide (derivatives as in `modes`). `status`: UNSTABLE if a mode grows, SINGULAR_K if one has
    a pole at zero; SINGULAR_M, NONFINITE as in `modes`."""

    natural_frequency: Float[Array, "n"]
    decay_rate: Float[Array, "n"]
    poles: Complex[Array, "n 2"]
    relaxations: Inexact[Array, "ny"]

    def roots(self):
        return np.asarray(self.poles)[:, 0]

    def growing_and_still(self):
        return np.asarray(self.decay_rate) < 0, np.asarray(self.natural_frequency) == 0

    def explain(self) -> str:
        grows = np.asarray(self.decay_rate) < 0
        if int(self.status) != Status.UNSTABLE or not grows.any():
            return super().explain()
        kinds = {
            "flutter": grows & (np.asarray(self.frequency) > 0),
            "divergence": grows & (np.asarray(self.frequency) == 0),
        }
        each = [f"{kind} in mode {i + 1}" for kind, of in kinds.items() for i in np.flatnonzero(of)]
        return f"{tables.counted(int(grows.sum()), 'mode')} of growing motion: {', '.join(each)}"

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: frequencies, damping ratio, decay rate, poles and shapes by
        mode."""
        return self.labeled(
            "complex modes",
            natural_frequency=(("mode",), self.natural_frequency, "Hz"),
            decay_rate=(("mode",), self.decay_rate, "1/s"),
            pole=(("mode", "pair"), self.poles, "1/s"),
            **(
                {"relaxation": (("branch",), self.relaxations, "1/s")}
                if np.shape(self.relaxations)[-1]
                else {}
            ),
        )

    @tables.summarized(
        "Complex modes", 1, frequency="frequency [Hz]", damping_ratio="damping ratio"
    )
    def _tables(self) -> list[tables.PrintedTable]:
        natural = np.asarray(self.natural_frequency)
        decay = tables.without_dust(self.decay_rate, natural.max(initial=0.0)) + 0.0
        poles = np.asarray(self.relaxations)
        poles = poles if np.any(np.imag(poles)) else np.real(poles)
        rows = [(str(i + 1), pole) for i, pole in enumerate(poles)]
        relaxations = [tables.PrintedTable("", ("relaxation", "pole [1/s]"), rows)] if rows else []
        return relaxations + self.table(
            "Complex modes",
            {
                "frequency [Hz]": self.frequency,
                "natural frequency [Hz]": natural,
                "damping ratio": tables.without_dust(self.damping_ratio, 1.0),
                "decay rate [1/s]": decay,
            },
        )


def complex_modes(
    lin: Linearization | SpinLinearization, *, allow_float32: bool = False
) -> ComplexModes:
    """Compute damped frequencies, damping ratios, decay rates and complex shapes of small motions,
    for any C, also about a steady spin.

        (s^2 M + s (C + G) + K) u = 0

    Elements with memory are included without approximation, whatever their relaxation times. K and
    D need not be symmetric. On the CPU the results of single poles are differentiable, and sums
    over coinciding poles; at a double pole with one shape, as at critical damping, the derivative
    is infinite and given as NaN. Errors: FLOAT32 unless `allow_float32`; warns UNSTABLE,
    SINGULAR_K, or with the status of `lin` if that is not OK. Source: D. J. Inman, Vibration with
    Control (2006), 3.4 and 4.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     elements={
    ...         "s": jb.Spring(
    ...             ("mass", [0, 0, 0]),
    ...             ("world", [0, 1, 0]),
    ...             stiffness=50.0,
    ...             free_length=1.0,
    ...             damping=12.0,
    ...         )
    ...     },
    ... )
    >>> damped = jb.complex_modes(jb.linearize(model, model.reference))
    >>> (
    ...     round(float(damped.decay_rate[0]), 9),
    ...     round(float(damped.damping_ratio[0]), 9),
    ...     round(float(damped.frequency[0] * 2 * jnp.pi), 9),
    ... )
    (3.0, 0.6, 4.0)
    """
    check_system(lin, "complex_modes", LinearSystem, allow_float32=allow_float32)
    return warn_if_failed(_complex_modes(lin))


@program
def _complex_modes(lin: LinearSystem) -> ComplexModes:
    # nondimensional matrices; the results do not depend on the scaling
    n, unit = lin.nv, jax.lax.stop_gradient(lin.scale)
    M, D, K = (scaled(X, unit) for X in (lin.M, lin.D, lin.K))
    finite, massless = (
        jnp.isfinite(jnp.stack([M, D, K])).all(),
        jnp.isnan(cholesky_of_mass(M[:n, :n])).any(),
    )
    # LAPACK may not terminate on NaN
    M, D, K = (jnp.where(finite & ~massless, X, np.eye(len(M))) for X in (M, D, K))
    M = M.at[:n, :n].set(
        (M[:n, :n] + M[:n, :n].T) / 2
    )  # states may have rows that read accelerations
    A = first_order(M, D, K, n)[0] if lin.massless else companion(M, D, K)
    s, X = poles(A)
    relaxations, fastest = (
        jnp.zeros(0, K.dtype),
        jnp.max(jnp.abs(jax.lax.stop_gradient(s)), initial=0.0),
    )
    stiffness = A[n:, :n]
    if lin.massless:
        # rounding turns equal real poles, such as those of equal branches, into complex pairs
        seen = jax.lax.stop_gradient(s)
        rounding = SPLIT * jnp.abs(seen) + reachable(SPLIT_AT_REST, fastest.dtype, 256) * fastest
        s = jax.lax.complex(
            jnp.real(s), jnp.where(jnp.abs(jnp.imag(seen)) <= rounding, 0.0, jnp.imag(s))
        )
        shares = _participation(X, n) if lin.model.forces else _energy_shares(s, X, M, K, n)
        single, others = _relaxing(*jax.lax.stop_gradient((s, shares)), lin.massless)
        relaxations = s[single]
        if lin.model.forces:
            stiffness, K = rows_of_one_size(K), K[:n, :n]
        else:
            relaxations = jnp.where(relaxations.imag == 0, relaxations.real, jnp.nan)
            K = K[:n, :n] + K[:n, n:] @ following(K, n, lin.massless)[n:]
            stiffness = jnp.linalg.solve(M[:n, :n], K)
        s, X, M, unit = s[others], X[:, others], M[:n, :n], unit[:n]
    frozen, U = jax.lax.stop_gradient((s, X[:n]))
    pairs = _paired(frozen, U, M, K)
    both = s[pairs]
    singular = jnp.linalg.svd(stiffness, compute_uv=False)
    at_rest = (jnp.min(singular, initial=jnp.inf) <= SINGULAR * jnp.max(singular, initial=0.0)) & (
        jnp.abs(both) <= REST * fastest
    )
    rigid = jnp.any(at_rest, axis=1)
    one, other = jnp.where(at_rest, 0.0, both).T
    product = (one * other).real
    w = jnp.sqrt(jnp.where(product > 0, product, 1.0))
    natural = jnp.where(product > 0, w, jnp.where(rigid, 0.0, jnp.nan)) / (2 * jnp.pi)
    ratio = jnp.where(product > 0, -(one + other).real / (2 * w), jnp.nan)
    own_status = jnp.select(
        # about a spin, one mode has zero frequency: a change of the spin angle or speed
        [
            ~finite,
            massless,
            jnp.any(
                jnp.concatenate([one.real, other.real, relaxations.real])
                > reachable(GROWS, fastest.dtype, 256) * fastest
            ),
            jnp.sum(rigid) > int(isinstance(lin, SpinLinearization)),
        ],
        [
            Status.NONFINITE.value,
            Status.SINGULAR_M.value,
            Status.UNSTABLE.value,
            Status.SINGULAR_K.value,
        ],
        Status.OK.value,
    )
    shapes = refused_if_shared(X[:n] * unit[:, None].astype(X.dtype), pole_clusters(frozen))[
        :, pairs[:, 0]
    ]
    shapes = _normalized(shapes, M / unit[None] / unit[:, None])
    if lin.model.closures:
        shapes = _turned(lin.expanded(shapes))
    status = lin.kept_status(own_status)
    valid = jnp.where(finite & ~massless, 1.0, jnp.nan)
    steady = jnp.where(status == Status.NOT_STEADY, jnp.nan, valid)
    frequency, natural, ratio, decay = (
        x * steady
        for x in (
            jnp.abs(one.imag) / (2 * jnp.pi),
            natural,
            ratio,
            -jnp.maximum(one.real, other.real),
        )
    )
    cluster, both = pole_clusters(frozen[pairs[:, 0]]), jnp.stack([one, other], -1) * valid
    relaxations = relaxations * valid
    return ComplexModes(
        frequency,
        ratio,
        shapes * valid,
        cluster,
        status,
        lin.M[:n, :n],
        lin.model,
        lin.basis,
        natural,
        decay,
        both,
        relaxations,
    )


def _relaxing(
    s: Complex[Array, "m"], shares: Float[Array, "m"], ny: int
) -> tuple[Int[Array, "ny"], Int[Array, "k"]]:
    """Return the indices of the poles of ny coordinates without mass, the slowest first, and those
    of the other poles: the real ones with the largest shares, then pairs with the largest ones."""
    order = jnp.lexsort((-jnp.abs(jnp.imag(s)), -shares, jnp.imag(s) != 0))
    single, others = order[:ny], jnp.sort(order[ny:])
    return single[jnp.argsort(-jnp.real(s[single]), stable=True)], others


def _energy_shares(s: Complex[Array, "m"], X: Complex[Array, "m m"], M, K, n: int):
    """Return the share of the energy of each pole in massless coordinates, beyond that of slow
    motions."""
    U, Y = X[:n], X[2 * n :]
    T = following(K, n, len(K) - n).astype(X.dtype)
    follows, K_yy = T[n:] @ U, K[n:, n:].astype(X.dtype)

    def energy(A, x):
        return jnp.sum(jnp.conj(x) * (A.astype(x.dtype) @ x), 0).real

    own, whole = (
        energy(K_yy, Y - follows),
        energy(K, jnp.concatenate([U, follows])) + jnp.abs(s) ** 2 * energy(M[:n, :n], U),
    )
    return own / (own + jnp.abs(whole))


def _participation(X: Complex[Array, "m m"], n: int) -> Float[Array, "m"]:
    """Return the participation of the states after the first 2 n in each pole: the share of the
    products of right and left eigenvectors."""
    parts = jnp.abs(X * jnp.linalg.inv(X).T)
    return jnp.round(jnp.nan_to_num(jnp.sum(parts[2 * n :], 0) / jnp.sum(parts, 0)), 9)


def _paired(s: Complex[Array, "m"], U: Complex[Array, "n m"], M, K) -> Int[Array, "n 2"]:
    """Return the indices of the pairs of poles of the modes, by ascending |s1 s2|: conjugate poles,
    and real ones adjacent in the order of u' K u/(u' M u), which is w^2 for both poles of an
    overdamped mode where damping is proportional."""
    n, imag = len(U), jnp.imag(s)
    oscillates = imag != 0
    stiff, mass = (jnp.sum(jnp.conj(U) * (A.astype(U.dtype) @ U), 0).real for A in (K, M))
    rayleigh = stiff / mass
    upper = jnp.sum(imag > 0)
    kind = jnp.where(imag > 0, 0, jnp.where(oscillates, 2, 1))
    line = jnp.lexsort((jnp.abs(imag), jnp.where(oscillates, jnp.abs(s), rayleigh), kind))
    i = jnp.arange(n)
    real = upper + 2 * (i - upper)
    pairs = jnp.where(
        (i < upper)[:, None], jnp.stack([i, 2 * n - upper + i], -1), jnp.stack([real, real + 1], -1)
    )
    pairs = line[pairs]
    one, other = pairs.T
    swapped = (imag[one] == 0) & (jnp.abs(s[one]) > jnp.abs(s[other]))
    pairs = jnp.where(swapped[:, None], pairs[:, ::-1], pairs)
    size = jnp.abs(s[one] * s[other])
    return pairs[jnp.lexsort((imag[pairs[:, 0]], size))]


def _normalized(shapes: Complex[Array, "nv n"], M: Float[Array, "nv nv"]) -> Complex[Array, "nv n"]:
    """Scale shapes so that u* M u = 1 and the component of largest modulus is real and positive."""
    shapes = _turned(shapes)
    size = jnp.sqrt(
        jnp.sum(jnp.conj(shapes) * (M.astype(shapes.dtype) @ shapes), 0, keepdims=True).real
    )
    return shapes / size.astype(shapes.dtype)


def _turned(shapes: Complex[Array, "nv n"]) -> Complex[Array, "nv n"]:
    """Turn shapes so that the component of largest modulus is real and positive."""
    largest = jnp.take_along_axis(shapes, jnp.argmax(jnp.abs(shapes), axis=0)[None], 0)
    return shapes * jnp.conj(largest) / jnp.abs(largest).astype(shapes.dtype)


def whirl(lin: SpinLinearization, modes: ComplexModes) -> Float[Array, "n"]:
    """Compute the direction of whirl of each mode about the axis of the spin: 1 for forward whirl
    on circles (with the spin), -1 for backward whirl, 0 for motion along straight lines.

        2 sum (m (a x b) + J (alpha x beta)) . n
        /sum (m (a . a + b . b) + J (alpha . alpha + beta . beta)),
        J = tr(inertia)/2

    for motions a cos(w t) + b sin(w t) of the centers of mass and alpha cos + beta sin of the
    rotations, perpendicular to the axis n of the fastest spinning body.

    A hanging, spinning top:

    >>> top = jb.Body(mass=1.0, inertia=[0.1, 0.1, 0.15], com=[0, 0, -1])
    >>> model = jb.Model(
    ...     bodies={"top": top}, joints={"top": jb.Ball("world")}, gravity=[0, 0, -9.81]
    ... )
    >>> lin = jb.vibration.linearize_spin(
    ...     model, jb.State(model.reference.q, jnp.array([0, 0, 30.0]))
    ... )
    >>> [round(float(x)) for x in jb.vibration.whirl(lin, jb.complex_modes(lin))]
    [0, -1, 1]
    """
    return _whirl(lin, modes.shapes)


@program
def _whirl(lin: SpinLinearization, shapes: Complex[Array, "nv n"]) -> Float[Array, "n"]:
    bodies, V = lin.model.bodies.rows, lin.basis.velocities
    spin = (V @ lin.state.v)[:, 3:]
    fastest = spin[jnp.argmax(jnp.sum(spin**2, -1))]
    n = fastest / jnp.maximum(jnp.linalg.norm(fastest), 1e-300)
    weights = bodies.mass, jnp.trace(bodies.inertia, axis1=-2, axis2=-1) / 2

    def one(u):
        whirling = size = jnp.zeros(())
        for weight, a, b in zip(
            weights, *(jnp.split(V @ x, 2, -1) for x in (u.real, -u.imag)), strict=True
        ):
            a, b = (x - jnp.sum(x * n[None], -1, keepdims=True) * n[None] for x in (a, b))
            whirling += jnp.sum(weight * (cross(a, b) @ n))
            size += jnp.sum(weight * jnp.sum(a * a + b * b, -1))
        return 2 * whirling / jnp.where(size > 0, size, 1.0)

    return jax.vmap(one, in_axes=1)(shapes)
