"""Transforms of free parameters to numbers u that are zero at the start, unbounded and of the order
of one, by domain.

nonnegative, positive  x = x0 exp(u)                   stiffness, damping, lengths, mass
fraction               x = x0 e^u/(1 + x0 (e^u - 1))   between 0 and 1
increasing, rising     steps x_i - x_(i-1) exp(u)      rows of tables, the first number as others
definite               X = L(u) L(u)'                  6 x 6; L lower triangular, diagonal by exp
inertia                I = tr(S) 1 - S, S definite     of positive masses (log-Cholesky of S)
rotation               q = exp(u) q0                   orientations; coordinates of an initial state
direction              n = (n0 + B u)/|n0 + B u|       axes of joints
gains, biases, delays  x = x0 + s u                    s: |x0| or 1; rms; sampling interval
others                 x = x0 + s u                    s the largest |x0|; if zero, the model's size
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, concrete, indices, module_of
from jaxbody.core.errors import Problem
from jaxbody.geometry import rotations
from jaxbody.geometry.vectors import cross, dot
from jaxbody.model.joints.kinematics import Chart
from jaxbody.model.leaf_paths import Leaf
from jaxbody.model.models import Model

FAR = 5.0  # u < -FAR is less than a hundredth of the start: zero if it has no effect
ROUNDING = 1e-15  # value relative to its start, below which it is zero, at a bound of zero
# smallest u of a step in a row: 1e-11 of its start, so that rounding makes no two numbers equal
LEAST = -25.0


class Parametrization(eqx.Module):
    """A leaf as a function of u."""

    start: Float[Array, "*x"]

    @property
    def size(self) -> int:
        """The length of u."""
        return len(self.labels())

    @abstractmethod
    def value(self, u: Float[Array, "n"]) -> Float[Array, "*x"]: ...

    def labels(self) -> list[str]:
        """Return the suffix of each u: "", or its index."""
        return indices(self.start.shape)

    def numbers(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the number that each u determines and its derivative with respect to u; u itself
        and 1 if a number depends on several u."""
        return u, np.ones_like(u)

    def changed(self, fraction: float) -> np.ndarray:
        """Return the u that changes each number by this fraction of itself, or of its scale if it
        may have either sign."""
        return np.full(self.size, fraction)

    def unbounded(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of u if none are given."""
        return np.full(self.size, -np.inf), np.full(self.size, np.inf)

    def ended(self, u: np.ndarray) -> np.ndarray:
        """Return for each u the limit of the domain that its number is close to, "zero" or "one",
        or "" if it is close to neither; a number far below the initial one is close to zero."""
        return np.full(u.shape, "")


class Elementwise(Parametrization):
    """Each number is an increasing function of one u, so that bounds of the number are bounds of
    u."""

    @abstractmethod
    def inverse(self, x: Any) -> np.ndarray:
        """Return the u that gives the value x; infinite at the limits of the domain and beyond."""

    @abstractmethod
    def slope(self, x: np.ndarray) -> np.ndarray:
        """Return dx/du at the value x."""

    def numbers(self, u):
        x = np.asarray(jax.tree.map(np.asarray, self).value(u)).ravel()
        slope = self.slope(x)
        return np.where(np.abs(x) < 1e-12 * np.abs(slope), 0.0, x), slope


class Positive(Elementwise):
    """A positive number x = x0 exp(u)."""

    def ended(self, u):
        return np.where(u < -FAR, "zero", "")

    def changed(self, fraction):
        return np.full(self.size, np.log1p(fraction))

    def value(self, u):
        return self.start * module_of(u).exp(u.reshape(self.start.shape))

    def inverse(self, x):
        with np.errstate(divide="ignore"):
            return np.log(np.maximum(np.asarray(x, float), 0.0) / np.asarray(self.start)).ravel()

    def slope(self, x):
        return x


class Shifted(Elementwise):
    """A number of any value, x = x0 + s u, with one scale s, or one for each number in x."""

    scale: Float[Array, "..."]

    def value(self, u):
        x = self.start + self.scale * u.reshape(self.start.shape)
        rounding = abs(x) < ROUNDING * abs(self.start)  # at a bound of zero
        return x - jax.lax.stop_gradient(module_of(u).where(rounding, x, 0.0))

    def inverse(self, x):
        return ((np.asarray(x, float) - np.asarray(self.start)) / np.asarray(self.scale)).ravel()

    def slope(self, x):
        return np.full_like(x, self.scale)


class Fraction(Elementwise):
    """A number from 0 to 1, x = x0 e^u/(1 + x0 (e^u - 1))."""

    def value(self, u):
        return 1 / (1 + (1 / self.start - 1) * module_of(u).exp(-u.reshape(self.start.shape)))

    def inverse(self, x):
        x, start = np.clip(np.asarray(x, float), 0.0, 1.0), np.asarray(self.start)
        with np.errstate(divide="ignore"):
            return np.log(x * (1 - start) / start / (1 - x)).ravel()

    def slope(self, x):
        return x * (1 - x)

    def ended(self, u):
        return np.select([u < -FAR, u > FAR], ["zero", "one"], "")


class Ordered(Parametrization):
    """Increasing numbers: x_0 = x0_0 + s u_0, x_i - x_(i-1) = (x0_i - x0_(i-1)) exp(u_i)."""

    scale: Float[Array, ""]

    def value(self, u):
        return module_of(u).cumsum(self._steps(u))

    def _steps(self, u: Any) -> Any:
        """Return the first number, and the step to each following one."""
        xp = module_of(u)
        return xp.concatenate(
            [
                self.start[:1] + self.scale * u[:1],
                xp.diff(self.start) * xp.exp(xp.maximum(u[1:], LEAST)),
            ]
        )

    def numbers(self, u):
        steps = np.asarray(self._steps(u))
        return steps, np.r_[self.scale, steps[1:]]

    def changed(self, fraction):
        return np.r_[fraction, np.full(self.size - 1, np.log1p(fraction))]

    def labels(self):
        return ["[0]", *(f"[{i}] - [{i - 1}]" for i in range(1, len(self.start)))]

    def ended(self, u):
        return np.where((u < -FAR) & (np.arange(len(u)) > 0), "zero", "")


class Definite(Parametrization):
    """A positive definite matrix X = L(u) L(u)', with a triangular matrix L."""

    def value(self, u):
        n = self.start.shape[0]
        L0 = jnp.linalg.cholesky(self.start)
        diagonal = jnp.diag(L0)
        rows, columns = np.tril_indices(n, -1)
        below = L0[rows, columns] + u[n:] * jnp.sqrt(diagonal[rows] * diagonal[columns])
        L = jnp.zeros((n, n), u.dtype).at[rows, columns].set(below) + jnp.diag(
            diagonal * jnp.exp(u[:n])
        )
        return L @ L.T

    def labels(self):
        n = self.start.shape[0]
        below = zip(*np.tril_indices(n, -1), strict=True)
        return [f"[{i},{i}]" for i in range(n)] + [f"[{i},{j}]" for i, j in below]

    def ended(self, u):
        return np.where((2 * u < -FAR) & (np.arange(len(u)) < len(self.start)), "zero", "")


class Inertia(Parametrization):
    """An inertia about the center of mass, I = tr(S) 1 - S, with S = sum of m x x' the second
    moment of mass.

    S is definite if and only if I is the inertia of positive masses (P. Wensing, S. Kim, J.-J.
    Slotine, IEEE Robotics and Automation Letters 3 (2018) 60); its principal moments then satisfy
    the triangle inequality."""

    def value(self, u):
        S = Definite(0.5 * jnp.trace(self.start) * jnp.eye(3) - self.start).value(u)
        return jnp.trace(S) * jnp.eye(3) - S

    def labels(self):
        return [f"[second moment {label[1:]}" for label in Definite(self.start).labels()]

    ended = Definite.ended


class Rotated(Parametrization):
    """A unit quaternion q = exp(u) q0, with the rotation vector u."""

    def value(self, u):
        return rotations.multiply(rotations.exp_quaternion(u), self.start)

    def labels(self):
        return ["[turn x]", "[turn y]", "[turn z]"]


class Direction(Parametrization):
    """A unit vector n = (n0 + B u)/|n0 + B u|, or several in rows."""

    def value(self, u):
        tilt = tilted if self.start.ndim == 1 else jax.vmap(tilted)
        return tilt(self.start, u.reshape(*self.start.shape[:-1], 2))

    def labels(self):
        return [
            f"[{', '.join(map(str, (*row, tilt)))}]"
            for row in np.ndindex(self.start.shape[:-1])
            for tilt in ("tilt 1", "tilt 2")
        ]


def tilted(n: Float[Array, "3"], u: Float[Array, "2"]) -> Float[Array, "3"]:
    """Return the direction n tilted along two directions normal to it."""
    other = jnp.eye(3, dtype=u.dtype)[jnp.argmin(jnp.abs(n))]
    b = cross(n, other)
    b = b / jnp.sqrt(dot(b, b))
    moved = n + u[0] * b + u[1] * cross(n, b)
    return moved / jnp.sqrt(dot(moved, moved))


class InitialConfiguration(Parametrization):
    """Coordinates q of an initial state, or of several in rows: q = q0 (+) u in the chart."""

    model: Model

    def value(self, u):
        retract, lead = Chart(self.model).retract, self.start.shape[:-1]
        return (jax.vmap(retract) if lead else retract)(self.start, u.reshape(*lead, -1))

    def labels(self):
        return [
            f"[{', '.join(map(str, (*row, name)))}]"
            for row in np.ndindex(self.start.shape[:-1])
            for name in self.model.layout.coordinates
        ]


def parametrize(leaf: Leaf, start: Array, model: Model, size: Array) -> Parametrization | Problem:
    """Return the parametrization for the domain of a leaf, or the problem START_ON_BOUND if its
    start is at a limit of the domain."""
    path, domain, value = leaf.path, leaf.kind.domain, concrete(start)
    if domain == "configuration":
        return InitialConfiguration(start, model)
    if domain == "definite" and start.ndim < 2:
        domain = "nonnegative"
    if domain in UNBOUNDED:
        return UNBOUNDED[domain](start)
    if domain not in STARTS:
        largest = jnp.max(jnp.abs(start))
        return Shifted(start, jnp.where(largest > 0, largest, size))
    form, inside, problem, limit, hint = STARTS[domain]
    if value is not None and not inside(value):
        zero = [
            label
            for label, x in zip(indices(value.shape), value.ravel(), strict=True)
            if form is Positive and x == 0
        ]
        if 0 < len(zero) < value.size:  # such as a bushing that is damped along x alone
            hint = (
                f"{path} is free as a whole, and its {', '.join(zero)} are zero. {hint[:-1]} there "
                "as well; or leave it fixed, and free the number of an element of its own that "
                "acts along one direction, such as the damper of a SpringDamper."
            )
        return Problem("START_ON_BOUND", path, f"starts at {value}, {problem}", value, limit, hint)
    return form(start)


def _thick(inertia: np.ndarray) -> bool:
    """Return whether the body is neither flat nor thin, so that its second moments of mass are
    positive."""
    moments = np.linalg.eigvalsh(inertia)
    return bool(moments[0] + moments[1] - moments[2] > 1e-9 * moments.sum())


UNBOUNDED = {"rotation": Rotated, "direction": Direction}
NUMBER = (
    Positive,
    lambda x: (x > 0).all(),
    "which has no logarithm",
    "> 0",
    "Start at a positive number of the size that you expect.",
)
ROW = (
    lambda x: Ordered(x, jnp.max(jnp.abs(x))),
    lambda x: (np.diff(x) > 0).all(),
    "with a step of zero, which has no logarithm",
    "increasing",
    "Start with numbers that all differ.",
)
STARTS = {  # form, whether a start is inside the domain, the message if it is not, limit, hint
    "nonnegative": NUMBER,
    "positive": NUMBER,
    "increasing": ROW,
    "rising": ROW,
    "fraction": (
        Fraction,
        lambda x: ((x > 0) & (x < 1)).all(),
        "at a limit of its range",
        "between 0 and 1",
        "Start between 0 and 1.",
    ),
    "definite": (
        Definite,
        lambda x: np.linalg.eigvalsh(x).min() > 0,
        "a matrix that is not positive definite",
        "eigenvalues > 0",
        "Start at a positive definite matrix.",
    ),
    "inertia": (
        Inertia,
        _thick,
        "the inertia of a flat or thin body",
        "each principal moment less than the sum of the other two",
        "Give the body some thickness, with masses on both sides of its plane or line.",
    ),
}
