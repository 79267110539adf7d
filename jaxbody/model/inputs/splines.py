"""An unknown imposed motion: a uniform cubic B-spline whose coefficients are identified in
the fit."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, checked, device_array, shaped
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field
from jaxbody.model.inputs.motions import Motion, as_motion
from jaxbody.model.inputs.samples import kinks_between_cubics
from jaxbody.model.inputs.signals import Signal

AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
MOST = 100_000  # largest number of intervals


class Spline(Motion):
    """An imposed motion by a spline, Xi(t) = sum_j B_j(t) values_j . directions, with B_j the cubic
    B-splines on equal intervals from `start` to `stop` [s]. It is C2 for any values, and each value
    acts over four intervals only. In a fit, "run1.base.values" may be free, for a base whose motion
    was measured poorly or not at all. `values` (m, k) has a column [m or rad] for each direction.
    Times before start or after stop are an error.

    Args:
        start, stop: first and last time [s]
        interval: length of an interval [s], about a third of the shortest period of interest;
            there must be fewer coefficients than samples
        along: directions of translation, rows of three, in world axes
        about: axes of rotation, rows of three, in world axes
        like: motion that the initial values fit by least squares; None: they are zero

    Errors, all at once: BAD_SPAN, BAD_INTERVAL, NO_DIRECTION, BAD_SHAPE, NON_FINITE, TOO_LARGE.
    Source: C. de Boor, A Practical Guide to Splines, 1978, ch. IX.

    >>> import jax.numpy as jnp
    >>> near = jb.inputs.Spline(
    ...     0.0,
    ...     1.0,
    ...     interval=0.05,
    ...     along=[[1, 0, 0]],
    ...     like=jb.Harmonic(frequency=1.0, translation=[0.01, 0, 0]),
    ... )
    >>> near.values.shape, round(float(near(jnp.array(0.5))[0]), 5)
    ((23, 1), -0.01)
    """

    start: Float[Array, ""] = field("s")
    stop: Float[Array, ""] = field("s")
    values: Float[Array, "m k"] = field("m")
    directions: Float[Array, "k 6"] = field(", rad/m")

    def __init__(
        self, start, stop, *, interval, along: Any = AXES, about: Any = (), like: Any = None
    ):
        with Problems() as problems:
            t0, t1, step = (
                shaped(x, (), f"Spline.{name}", problems)
                for name, x in (("start", start), ("stop", stop), ("interval", interval))
            )
            rows = [
                _rows(value, f"Spline.{name}", problems)
                for name, value in (("along", along), ("about", about))
            ]
        n = _intervals(float(t0), float(t1), float(step), problems)
        if not sum(map(len, rows)):
            problems.add(
                "NO_DIRECTION",
                "Spline",
                "has no direction to move in",
                hint="Give along= or about=.",
            )
        problems.raise_if_any()
        zero = [np.zeros_like(row) for row in rows]
        self.directions = device_array(
            np.concatenate([np.hstack([rows[0], zero[0]]), np.hstack([zero[1], rows[1]])])
        )
        self.start, self.stop = device_array(t0), device_array(t1)
        self.values = jnp.zeros((n + 3, len(self.directions)), self.directions.dtype)
        if like is not None:
            self.values = _near(self, as_motion(like))

    def covers(self) -> tuple[Any, Any]:
        return self.start, self.stop

    def kinks(self):
        t = jnp.linspace(self.start, self.stop, len(self.values) - 2)
        return kinks_between_cubics(
            t, self.values[1:-1], jnp.diff(self.values, 2, axis=0) / (t[1] - t[0]) ** 2
        )

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        i, weights = self._weights(t)
        return weights @ self.values[i + np.arange(4)] @ self.directions

    def after(self, t0):
        return eqx.tree_at(
            lambda motion: (motion.start, motion.stop), self, (self.start - t0, self.stop - t0)
        )

    def _weights(self, t: Float[Array, ""]):
        """Return the index of the first of the four coefficients at time t, and their weights; u is
        the position in the interval."""
        n = self.values.shape[0] - 3
        s = (t - self.start) / (self.stop - self.start) * n
        i = jnp.clip(jnp.floor(jax.lax.stop_gradient(s)), 0, n - 1)
        u = s - i
        w = (
            jnp.stack(
                [(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]
            )
            / 6
        )
        return i.astype(int), w


def _intervals(start: float, stop: float, interval: float, problems: Problems) -> int:
    if not start < stop:
        problems.add(
            "BAD_SPAN",
            "Spline.stop",
            f"is {stop:g} s",
            value=stop,
            limit=f"> {start:g} s",
            hint="Give the first time, then the last.",
        )
    elif not interval > 0:
        problems.add(
            "BAD_INTERVAL",
            "Spline.interval",
            f"is {interval:g} s",
            value=interval,
            limit="> 0",
            hint="Give its length in seconds.",
        )
    elif (stop - start) / interval > MOST:
        problems.add(
            "TOO_LARGE",
            "Spline.interval",
            f"makes {(stop - start) / interval:.3g} intervals",
            value=interval,
            limit=f"{MOST}",
            hint="Is it in seconds?",
        )
    else:
        return max(1, int(np.ceil((stop - start) / interval * (1 - 1e-12))))
    return 1


def _rows(value: Any, where: str, problems: Problems) -> np.ndarray:
    """Return directions as rows (k, 3)."""
    shape = (len(value), 3) if hasattr(value, "__len__") else (1, 3)
    if shape[0] == 0:
        return np.zeros((0, 3))
    array = checked(value, (shape,), where, problems, "Give rows of three numbers, [[1, 0, 0]].")
    return np.zeros((0, 3)) if array is None else np.asarray(array)


@eqx.filter_jit
def _design(spline: Spline, times: Float[Array, "n"]) -> Float[Array, "n m"]:
    """Return the B-splines B_j at the times [s], one row for each time."""

    def row(t):
        i, weights = spline._weights(t)
        return jnp.zeros(spline.values.shape[0], weights.dtype).at[i + np.arange(4)].set(weights)

    return jax.vmap(row)(times)


def _near(spline: Spline, motion: Signal) -> Array:
    """Return the values with which the spline fits the motion by least squares, at four times for
    each value."""
    times = jnp.linspace(spline.start, spline.stop, 4 * spline.values.shape[0])
    targets = np.asarray(jax.jit(jax.vmap(motion))(times))
    components = np.linalg.lstsq(np.asarray(spline.directions).T, targets.T, rcond=None)[0].T
    return device_array(
        np.linalg.lstsq(np.asarray(_design(spline, times)), components, rcond=None)[0]
    )
