"""Road unevenness by ISO 8608: a power spectral density over distance, its spectrum in time at a
speed, and sample profiles."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import check_key
from jaxbody.core.arrays import Array, Float, PRNGKeyArray, device_array, scalar
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.vibration.spectra import PowerLaw, check_not_negative

CLASSES = "ABCDEFGH"
SMOOTHEST = 16e-6  # m3, the geometric mean of class A
REFERENCE = 0.1  # cycle/m
MOST_POINTS = 10_000_000


class RoadRoughness(eqx.Module):
    """The heights of a road as a one-sided power spectral density over n [cycle/m], Gd(n) = level
    (n/0.1)^-exponent, level = Gd(0.1 cycle/m) [m3].

    Errors: NEGATIVE, BAD_SHAPE, NON_FINITE. Source: ISO 8608, where the exponent is 2.

    >>> float(jb.vibration.RoadRoughness.iso("C").level)
    0.000256
    """

    level: Float[Array, ""]
    exponent: Float[Array, ""]

    def __init__(self, level, *, exponent=2.0):
        with Problems() as problems:
            self.level = scalar(level, "RoadRoughness.level", problems)
            self.exponent = scalar(exponent, "RoadRoughness.exponent", problems)
            check_not_negative(self.level, "RoadRoughness.level", problems)

    @classmethod
    def iso(cls, road_class: str) -> RoadRoughness:
        """Return the roughness of a road class, A (smooth) to H, at the geometric mean of its
        limits: 16e-6 m3 for A, and four times as much for each following class. Error:
        BAD_CLASS."""
        if road_class not in tuple(CLASSES):
            raise JaxbodyError(
                Problem(
                    "BAD_CLASS",
                    "RoadRoughness.iso",
                    f"is {road_class!r}",
                    road_class,
                    " ".join(CLASSES),
                    "Give a letter.",
                )
            )
        return cls(SMOOTHEST * 4.0 ** CLASSES.index(road_class))

    def at_speed(self, speed) -> PowerLaw:
        """Return the spectrum of displacement under a wheel at a speed U [m/s], Gd(f/U)/U."""
        return PowerLaw(
            self.level,
            exponent=self.exponent,
            reference=REFERENCE,
            unit="m2/(cycle/m)",
            speed=speed,
        )

    def __call__(self, n: Float[Array, "k"]) -> Float[Array, "k"]:
        """Return the density of displacement Gd(n) [m3] at spatial frequencies n [cycle/m]."""
        return self.level * (n / REFERENCE) ** -self.exponent


def road_profile(
    road: RoadRoughness, *, length, spacing, key: PRNGKeyArray
) -> tuple[Float[Array, "k"], Float[Array, "k"]]:
    """Generate a road profile, (distances, heights) [m], for a Road.

        z(s) = sum over k of sqrt(2 Gd(k/L)/L) cos(2 pi k s/L + p_k),   k/L up to 1/(2 spacing)

    with random phases p_k: each road has exactly this density at all k/L, mean zero, and is
    periodic. Its longest wavelength is its length.

    Args:
        road: unevenness of the road.
        length: length L of the road [m].
        spacing: distance between its points [m].
        key: random key for the phases; the same key gives the same road.

    Errors: BAD_LENGTH, WRONG_KIND.

    >>> distances, heights = jb.vibration.road_profile(
    ...     jb.vibration.RoadRoughness.iso("C"), length=100.0, spacing=0.1, key=jax.random.key(0)
    ... )
    >>> wheel = jb.inputs.Road(distances, heights, speed=20.0)
    >>> distances.shape
    (1001,)
    """
    if not isinstance(road, RoadRoughness):
        raise JaxbodyError(
            Problem(
                "WRONG_KIND",
                "road_profile.road",
                f"is a {type(road).__name__}",
                road,
                "RoadRoughness",
                'Give RoadRoughness.iso("C").',
            )
        )
    with Problems() as problems:
        check_key(key, "road_profile.key", problems, "A road needs")
    length, spacing = float(length), float(spacing)
    if not (0 < spacing < length / 4 and length / spacing <= MOST_POINTS):
        raise JaxbodyError(
            Problem(
                "BAD_LENGTH",
                "road_profile.length",
                f"is {length:g} m in steps of {spacing:g} m",
                length,
                f"4 to {MOST_POINTS} steps",
                "Give both in meters.",
            )
        )
    n = round(length / spacing)
    step = length / n
    k = np.arange(1, (n + 1) // 2)
    phase = jax.random.uniform(key, k.shape, maxval=2 * np.pi)
    amplitude = jnp.sqrt(2 * road(device_array(k / (n * step))) / (n * step))
    turned = jnp.exp(jax.lax.complex(jnp.zeros_like(phase), phase))
    waves = amplitude.astype(turned.dtype) * turned * n / 2
    heights = jnp.fft.irfft(jnp.pad(waves, (1, n // 2 - len(k))), n)
    return device_array(step * np.arange(n + 1)), jnp.append(heights, heights[0])
