"""Random starts of searches, between the bounds of u."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from jaxbody.core.errors import Problems
from jaxbody.fitting.parameters.spaces import Parameter, Space
from jaxbody.fitting.parameters.transforms import Elementwise, Fraction, Rotated

# standard deviation of u of directions, matrices and rows in order, which have no bounds
SPREAD = 0.3


def around(space: Space, count: int, spread: float, seed: int) -> np.ndarray:
    """Points (count, n) of a Sobol sequence between the bounds of u; without a bound from -spread
    or up to spread."""
    from scipy.stats import qmc

    low, high = (
        np.where(np.isfinite(end), end, sign * spread)
        for end, sign in zip(space.bounds, (-1, 1), strict=True)
    )
    unit = qmc.Sobol(len(low), rng=np.random.default_rng(seed)).random_base2(
        int(np.ceil(np.log2(count)))
    )[:count]
    return low + (high - low) * unit


def drawn(
    space: Space, low: np.ndarray, high: np.ndarray, count: int, key: Any, where: str
) -> np.ndarray:
    """The model, and random starts, uniform between these bounds of u, (count, n). Orientations are
    uniform over all rotations, fractions uniform between their bounds or in their domain; no key
    means that of 0. Error: NO_BOUNDS."""
    if count == 1:
        return np.zeros((1, space.size))
    key = jax.random.key(0) if key is None else key
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)).ravel())
    with Problems() as problems:
        u = [
            _drawn(parameter, low[own], high[own], count, rng, where, problems)
            for parameter, own in space.parts
        ]
    return np.concatenate([np.zeros((1, space.size)), np.concatenate(u, 1)[1:]])


def _drawn(
    parameter: Parameter,
    low: np.ndarray,
    high: np.ndarray,
    count: int,
    rng: np.random.Generator,
    where: str,
    problems: Problems,
):
    form, shape = parameter.form, (count, parameter.form.size)
    if isinstance(form, Rotated):
        q = rng.normal(size=(count, 4))
        q = q / np.linalg.norm(q, axis=1, keepdims=True)
        sine = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
        angle = 2 * np.arctan2(sine, q[:, :1])
        return q[:, 1:] / sine * np.where(angle > np.pi, angle - 2 * np.pi, angle)
    if isinstance(form, Fraction):  # bounded by its domain
        ends = [np.asarray(form.value(end)) for end in (low, high)]
        return np.array([form.inverse(rng.uniform(*ends)) for _ in range(count)])
    if not isinstance(form, Elementwise):
        return SPREAD * rng.normal(size=shape)
    if not np.isfinite(high - low).all():
        limit, hint = "both finite", "Random starts need bounds."
        problems.add(
            "NO_BOUNDS", f"{where}['{parameter.path}']", "is missing", limit=limit, hint=hint
        )
    return rng.uniform(low, high, shape) if not problems.collected else np.zeros(shape)
