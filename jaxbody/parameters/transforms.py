"""How a free parameter is moved in a fit: by numbers u that are zero at the start, unbounded and of the order of one.

nonnegative     x = x0 exp(u)                         stiffness, damping, lengths; what is positive alike: mass
fraction        x = x0 e^u/(1 + x0 (e^u - 1))         between 0 and 1
definite        X = L(u) L(u)'                        6 x 6 stiffness and damping; L lower, logarithms on its diagonal
inertia         I = tr(S) 1 - S, S definite           so that masses of no sign but plus can have it (log-Cholesky of the pseudo-inertia)
rotation        q = exp(u) q0                         orientations; coordinates of an initial state
direction       n = (n0 + B u)/|n0 + B u|             axes of joints
of instruments  x = x0 + s u                          gain (either sign) and bias, s of the order of the record where x0 is smaller; delay, of a sample
anything else   x = x0 + s u                          s the largest of |x0|, or a size of the model where x0 is zero
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbody.core.arrays import concrete, module_of
from jaxbody.core.errors import Problem, Problems
from jaxbody.geometry import rotations
from jaxbody.geometry.vectors import cross, dot
from jaxbody.mechanics.kinematics import Chart
from jaxbody.models.leaf_paths import Leaf
from jaxbody.models.models import Model

FAR = 5.0  # in u: less than a hundredth of the start, which counts as zero where it has no effect


class Parametrization(eqx.Module):
    """A leaf as a function of u."""

    start: Float[Array, "*x"]

    @property
    def size(self) -> int:
        """How many numbers u has."""
        return self.start.size

    @abstractmethod
    def value(self, u: Float[Array, "n"]) -> Float[Array, "*x"]: ...

    def labels(self) -> list[str]:
        """The suffix of each u: "", or its index."""
        return [""] if self.start.ndim == 0 else [str(list(i)).replace(" ", "") for i in np.ndindex(self.start.shape)]

    def ended(self, u: np.ndarray) -> np.ndarray:
        """The end of the domain that each u is near, in a word: "zero" for a logarithm far below that of the start."""
        return np.full(u.shape, "")


class Elementwise(Parametrization):
    """Each number rises with a u of its own, so that bounds and priors of the number are also bounds and priors of u."""

    @abstractmethod
    def inverse(self, x: Any) -> np.ndarray:
        """u of a value, infinite at the end of the domain and beyond."""

    @abstractmethod
    def slope(self, x: np.ndarray) -> np.ndarray:
        """dx/du."""


class Positive(Elementwise):
    """x = x0 exp(u)."""

    def ended(self, u):
        return np.where(u < -FAR, "zero", "")

    def value(self, u):
        return self.start * module_of(u).exp(u.reshape(self.start.shape))

    def inverse(self, x):
        with np.errstate(divide="ignore"):
            return np.log(np.maximum(np.asarray(x, float), 0.0) / np.asarray(self.start)).ravel()

    def slope(self, x):
        return x


class Shifted(Elementwise):
    """x = x0 + s u."""

    scale: Float[Array, ""]

    def value(self, u):
        return self.start + self.scale * u.reshape(self.start.shape)

    def inverse(self, x):
        return ((np.asarray(x, float) - np.asarray(self.start)) / float(self.scale)).ravel()

    def slope(self, x):
        return np.full_like(x, self.scale)


class Fraction(Elementwise):
    """x = x0 e^u/(1 + x0 (e^u - 1))."""

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


class Definite(Parametrization):
    """X = L(u) L(u)'."""

    @property
    def size(self) -> int:
        n = self.start.shape[0]
        return n * (n + 1) // 2

    def value(self, u):
        n = self.start.shape[0]
        L0 = jnp.linalg.cholesky(self.start)
        diagonal = jnp.diag(L0)
        rows, columns = np.tril_indices(n, -1)
        below = L0[rows, columns] + u[n:] * jnp.sqrt(diagonal[rows] * diagonal[columns])
        L = jnp.zeros((n, n), u.dtype).at[rows, columns].set(below) + jnp.diag(diagonal * jnp.exp(u[:n]))
        return L @ L.T

    def labels(self):
        n = self.start.shape[0]
        rows, columns = np.tril_indices(n, -1)
        return [f"[{i},{i}]" for i in range(n)] + [f"[{i},{j}]" for i, j in zip(rows, columns, strict=True)]

    def ended(self, u):
        return np.where((2 * u < -FAR) & (np.arange(len(u)) < len(self.start)), "zero", "")


class Inertia(Parametrization):
    """About the center of mass I = tr(S) 1 - S, with S = sum of m x x' the second moment of mass.

    S is definite if and only if I is of masses that are positive everywhere (P. Wensing, S. Kim, J.-J. Slotine, IEEE Robotics and Automation
    Letters 3 (2018) 60): then its principal moments hold the triangle inequality."""

    @property
    def size(self) -> int:
        return 6

    def value(self, u):
        S = Definite(0.5 * jnp.trace(self.start) * jnp.eye(3) - self.start).value(u)
        return jnp.trace(S) * jnp.eye(3) - S

    def labels(self):
        return [f"[second moment {label[1:]}" for label in Definite(self.start).labels()]

    ended = Definite.ended


class Rotation(Parametrization):
    """q = exp(u) q0."""

    @property
    def size(self) -> int:
        return 3

    def value(self, u):
        return rotations.multiply(rotations.exp_quaternion(u), self.start)

    def labels(self):
        return ["[turn x]", "[turn y]", "[turn z]"]


class Direction(Parametrization):
    """n = (n0 + B u)/|n0 + B u|."""

    @property
    def size(self) -> int:
        return 2

    def value(self, u):
        least = jnp.eye(3, dtype=u.dtype)[jnp.argmin(jnp.abs(self.start))]
        b = cross(self.start, least)
        b = b / jnp.sqrt(dot(b, b))
        moved = self.start + u[0] * b + u[1] * cross(self.start, b)
        return moved / jnp.sqrt(dot(moved, moved))

    def labels(self):
        return ["[tilt 1]", "[tilt 2]"]


class InitialConfiguration(Parametrization):
    """The coordinates of an initial state, or of several in rows, moved in the chart."""

    model: Model

    @property
    def size(self) -> int:
        return int(np.prod(self.start.shape[:-1])) * self.model.layout.nv

    def value(self, u):
        retract, lead = Chart(self.model).retract, self.start.shape[:-1]
        return (jax.vmap(retract) if lead else retract)(self.start, u.reshape(*lead, -1))

    def labels(self):
        rows = np.ndindex(self.start.shape[:-1])
        return [f"[{', '.join(map(str, (*row, name)))}]" for row in rows for name in self.model.layout.coordinates]


def parametrize(leaf: Leaf, start: Array, model: Model, size: Array) -> Parametrization | Problem:
    """The parametrization that suits the domain of a leaf, or what is wrong with its start."""
    path, domain, known = leaf.path, leaf.kind.domain, concrete(start)
    if domain == "configuration":
        return InitialConfiguration(start, model)
    if domain == "definite" and start.ndim < 2:
        domain = "nonnegative"
    if domain in UNBOUNDED:
        return UNBOUNDED[domain](start)
    if domain not in STARTS:
        largest = jnp.max(jnp.abs(start))
        return Shifted(start, jnp.where(largest > 0, largest, size))
    form, inside, where, limit, hint = STARTS[domain]
    if known is not None and not inside(known):
        return Problem("START_ON_BOUND", path, f"starts at {known}, {where}", known, limit, hint)
    return form(start)


def _thick(inertia: np.ndarray) -> bool:
    moments = np.linalg.eigvalsh(inertia)
    return moments[0] + moments[1] - moments[2] > 1e-9 * moments.sum()


UNBOUNDED = {"rotation": Rotation, "direction": Direction}
NUMBER = (Positive, lambda x: (x > 0).all(), "where its logarithm has no value", "> 0", "Start at a small positive number.")
STARTS = {  # form, whether a start is inside, what it is else, limit, hint
    "nonnegative": NUMBER,
    "positive": NUMBER,
    "fraction": (Fraction, lambda x: ((x > 0) & (x < 1)).all(), "at an end of its range", "between 0 and 1", "Start between 0 and 1."),
    "definite": (
        Definite,
        lambda x: np.linalg.eigvalsh(x).min() > 0,
        "a matrix that is not positive definite",
        "eigenvalues > 0",
        "Start at a definite matrix.",
    ),
    "inertia": (
        Inertia,
        _thick,
        "that of a flat or thin body",
        "each principal moment less than the sum of the other two",
        "Give it some thickness: masses on both sides of its plane or line.",
    ),
}


def pair_of(given: Any, shape: tuple[int, ...]) -> list[np.ndarray] | None:
    """A pair, (lower, upper) or (mean, deviation), as arrays of the shape; None where it is not one."""
    try:
        lower, upper = given
        return [np.broadcast_to(np.asarray(end, float), shape) for end in (lower, upper)]
    except (TypeError, ValueError):
        return None


def sound_bounds(
    form: Parametrization, ends: list[np.ndarray] | None, given: Any, where: str, problems: Problems, slack: float = 0.0
) -> bool:
    """Whether bounds, as given and as a pair of arrays, are some and hold the start; what is wrong goes to `problems`."""
    start = np.asarray(form.start)
    if not isinstance(form, Elementwise):
        problems.add("BAD_BOUNDS", where, "has no bounds of its own", hint="Bound scalars and vectors only.")
    elif ends is None:
        problems.add("BAD_BOUNDS", where, f"is {given!r:.60}", value=given, limit="(lower, upper)")
    elif np.isnan(ends).any():
        hint = "A side without a bound is -inf or inf."
        problems.add("BAD_BOUNDS", where, f"is {given!r:.60}, which has a NaN", value=given, limit="numbers", hint=hint)
    elif not (ends[0] < ends[1]).all():
        problems.add("BAD_BOUNDS", where, f"has lower {given[0]} >= upper {given[1]}", value=given, limit="lower < upper")
    elif ((start < ends[0] - slack) | (start > ends[1] + slack)).any():
        distance = np.maximum(ends[0] - start, start - ends[1]).max()
        told, limit = f"does not hold the start {start}, by {distance:.4g}", f"{given[0]} to {given[1]}"
        problems.add("START_OUTSIDE", where, told, value=start, limit=limit, hint="Move the start or the bound.")
    else:
        return True
    return False
