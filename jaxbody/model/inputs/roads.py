"""Roads: the imposed motions of the supports under the wheels of a vehicle that drives along a
profile of heights."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, checked, concrete, device_array, float_array, shaped
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, take
from jaxbody.model.inputs.motions import Motion
from jaxbody.model.inputs.samples import kinks_between_lines

FEWEST = 16  # least number of pieces of a profile that are summed (see `_window`)


class Road(Motion):
    """The road under a wheel of a moving vehicle: Xi = (0, 0, z_f(s), 0, 0, 0) at the distance
    s = position + speed t, with

        z_f(s) = 1/L int_{s - L/2}^{s + L/2} z ds,

    the average over the contact patch of the tyre, which envelops short bumps (Sayers uses
    L = 0.25 m), or z if L = 0.

    The axes of the model travel with the vehicle, with z up.

    Args:
        distances: along the road [m], increasing
        heights: z [m] at the distances, linear between them, constant before the first and after
            the last
        speed: speed of the vehicle [m/s]
        position: distance of the wheel ahead of the vehicle's origin [m], negative behind it, as
            for a rear wheel
        footprint: L, length of the contact patch [m]; 0: a point

    All numbers may be free in a fit. z_f is NaN if the footprint is later changed to more than
    twice its length and then covers more than 16 pieces of the profile.

    The profile has a kink at every point, at which adaptive steps end: for a rough road use
    constant steps, no longer than the time between points. Springs and dampers follow the profile
    exactly; a joint on the support would miss the jumps of velocity at kinks.

    Errors: NOT_INCREASING distances, BAD_FOOTPRINT below zero, BAD_SHAPE, NON_FINITE,
    COMPLEX, NOT_A_NUMBER.
    Source: M. W. Sayers, On the calculation of international roughness index from longitudinal road
    profile, TRR 1501, 1995.

    >>> front = jb.inputs.Road([0.0, 10.0, 20.0], [0.0, 0.0, 0.5], speed=10.0, position=1.5)
    >>> front(jnp.array(1.05)).tolist()
    [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    """

    distances: Float[Array, "n"] = field("m")
    heights: Float[Array, "n"] = field("m")
    speed: Float[Array, ""] = field("m/s", converter=device_array)
    position: Float[Array, ""] = field("m", converter=device_array)
    footprint: Float[Array, ""] = field(
        "m",
        "nonnegative",
        code="BAD_FOOTPRINT",
        hint="Give the length of the contact patch, or 0 for none.",
        converter=device_array,
    )
    window: int = field(static=True)

    def __init__(self, distances, heights, *, speed, position=0.0, footprint=0.0):
        with Problems() as problems:
            s = _points(distances, "Road.distances", problems)
            z = _points(heights, "Road.heights", problems, None if s is None else len(s))
            _check_increasing(s, problems)
            take(self, problems, speed=speed, position=position, footprint=footprint)
        self.window = _window(s, self.footprint)
        self.distances, self.heights = device_array(s), device_array(z)

    @classmethod
    def kerb(cls, height, *, at, ramp, speed, position=0.0, footprint=0.0) -> Road:
        """Return a level road with one step, which is a straight ramp from one height to the other.

        Args:
            height: height of the step [m], negative downwards
            at: distance at which the ramp begins [m]
            ramp: its length [m]
            speed: speed of the vehicle [m/s]
            position: position of the wheel ahead of the vehicle's origin [m]
            footprint: length of the contact patch [m]

        >>> jb.inputs.Road.kerb(0.1, at=5.0, ramp=0.02, speed=8.0).heights.tolist()
        [0.0, 0.1]
        """
        with Problems() as problems:
            start, length = (
                shaped(at, (), "Road.kerb at", problems),
                shaped(ramp, (), "Road.kerb ramp", problems),
            )
        return cls(
            [start, start + length],
            [0.0, height],
            speed=speed,
            position=position,
            footprint=footprint,
        )

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        z = self.felt(self.position + self.speed * t)
        return jnp.zeros(6, z.dtype).at[2].set(z)

    def kinks(self):
        at = kinks_between_lines(self.distances, self.heights)
        patch = jnp.concatenate([at - self.footprint / 2, at + self.footprint / 2])
        times = (patch - self.position) / jnp.where(self.speed != 0, self.speed, 1.0)
        return jnp.where((self.speed != 0) & jnp.isfinite(patch), times, jnp.inf)

    def after(self, t0):
        return eqx.tree_at(lambda road: road.position, self, self.position + self.speed * t0)

    def felt(self, s: Float[Array, ""]) -> Float[Array, ""]:
        """Return z_f at the distance s [m] of the middle of the patch: the sum over the pieces of
        the profile in the patch of length times height at the middle, over the footprint. Lengths
        are counted from s, because differences of antiderivatives lose all digits far along a long
        road."""
        last, half = len(self.distances) - 1, self.footprint / 2
        rear = jax.lax.stop_gradient(s - half)
        behind = jnp.searchsorted(self.distances, rear, side="right", method="scan_unrolled") - 1
        first = jnp.clip(behind, 0, last - self.window).astype(int)
        # by indices: a slice with a variable start would copy the whole profile in a loop
        points, z = (x[first + np.arange(self.window + 1)] for x in (self.distances, self.heights))
        d = points - s
        edges = jnp.clip(d, -half, half)
        middles = (edges[1:] + edges[:-1]) / 2
        pieces = jnp.diff(edges) * (z[:-1] + jnp.diff(z) / jnp.diff(points) * (middles - d[:-1]))
        area = (edges[0] + half) * z[0] + jnp.sum(pieces) + (half - edges[-1]) * z[-1]
        average = area / jnp.where(half > 0, self.footprint, 1.0)
        covered = (d[-1] >= half) | (first + self.window == last)
        return jnp.where(covered, jnp.where(half > 0, average, jnp.interp(0.0, d, z)), jnp.nan)


def _window(distances, footprint) -> int:
    """Return the number of pieces in the window: those under a patch of twice the length, rounded
    up to a power of two so that few programs are compiled; all pieces if distances or footprint are
    traced."""
    s, length = concrete(distances), concrete(footprint)
    last = len(distances) - 1
    if s is None or length is None:
        return last
    under = int(np.max(np.searchsorted(s, s + 2 * length) - np.arange(last + 1))) + 1
    return min(last, max(FEWEST, 2 ** int(np.ceil(np.log2(under)))))


def _points(value, where: str, problems: Problems, n: int | None = None) -> Any:
    """Return n finite numbers, or two or more if n is None; a problem is added if they are not."""
    numbers = problems.gather(lambda: float_array(value, where))
    if numbers is None:
        return None
    return checked(
        numbers,
        ((n or max(2, numbers.size),),),
        where,
        problems,
        "Give two points or more." if n is None else "Give one height for each distance.",
    )


def _check_increasing(distances, problems: Problems) -> None:
    known = None if distances is None else concrete(distances)
    if known is None or (np.diff(known) > 0).all():
        return
    i = int(np.flatnonzero(np.diff(known) <= 0)[0])
    problems.add(
        "NOT_INCREASING",
        "Road.distances",
        f"has {known[i + 1]:.9g} m after {known[i]:.9g} m, at index {i + 1}",
        value=i + 1,
        limit="increasing",
        hint="Sort the points; replace a step by a short ramp.",
    )
