"""Motions that a stiffness or mass matrix does not resist, described in words."""

from typing import Any

import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.core.compilation.compile_options import program
from jaxbody.mechanics.equilibrium_solvers import SINGULAR
from jaxbody.mechanics.free_motions import on_closures
from jaxbody.mechanics.hessians import configuration_at, slope, stiffness
from jaxbody.model.element_states import resisting
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.layouts import Layout
from jaxbody.model.models import Model, scale_of, scaled, size_of
from jaxbody.model.states import State
from jaxbody.numerics.eigenproblems import MASSLESS
from jaxbody.numerics.precisions import reachable


@program
def resisting_stiffness(model: Model, state: State) -> Float[Array, "nv nv"]:
    """Return the scaled K with the tangents of hysteresis, along the closures if there are any."""
    coordinates = Coordinates(resisting(model, state.z))
    at, scale = configuration_at(coordinates, state.q, base=False), scale_of(model, size_of(model))
    return on_closures(
        coordinates, state.q, slope(at) * scale, scaled(stiffness(at), scale), scale
    )[1]


def zero_modes(model: Model, state: State) -> list[str]:
    """Return the motions that K does not resist at a state, as text: "'plate' free to turn about
    z". Motions of single coordinates come first."""
    K = np.asarray(resisting_stiffness(model, state))
    return describe_null_motions(model.layout.motions, K, reachable(SINGULAR, K.dtype), "free to")


def massless_motions(
    layout: Layout, M: Any, independent: tuple[int, ...] | None = None
) -> list[str]:
    """Return the motions that a mass matrix does not resist, as text; `independent`: the
    coordinates of the matrix, by default all."""
    M = np.asarray(M)
    size = np.sqrt(np.where(np.diagonal(M) > 0, np.diagonal(M), 1.0))
    motions = (
        layout.motions if independent is None else tuple(layout.motions[i] for i in independent)
    )
    motions += tuple(
        (owner, f"move {state}")
        for owner, _, state in (
            name.partition(", ") for name in layout.inner[: len(M) - len(motions)]
        )
    )
    return describe_null_motions(motions, M / size / size[:, None], MASSLESS, "has no inertia to")


def describe_null_motions(
    motions: tuple[tuple[str, str], ...], matrix: np.ndarray, tolerance: float, what: str
) -> list[str]:
    """Return texts on the motions whose eigenvalues are zero relative to the largest, each with
    `what` between body and motion. Motions of single coordinates come first."""
    values, vectors = np.linalg.eigh(matrix)
    null = vectors[:, np.abs(values) <= tolerance * max(np.abs(values).max(initial=0.0), 1e-300)]
    texts, rest = [], null
    for i, (body, motion) in enumerate(motions):
        unit = np.eye(len(motions))[i]
        if np.linalg.norm(unit - null @ (null.T @ unit)) < 1e-5:
            texts.append(f"'{body}' {what} {motion}")
            rest = rest - np.outer(unit, unit @ rest)
    u, s, _ = np.linalg.svd(rest, full_matrices=False)
    for vector in u.T[s > 1e-3]:
        largest = [int(i) for i in np.argsort(-np.abs(vector)) if abs(vector[i]) > 0.1][:4]
        parts = [
            f"{np.sign(vector[largest[0]]) * vector[i]:+.2f} ('{motions[i][0]}' {motions[i][1]})"
            for i in largest
        ]
        texts.append(f"{what} move together: " + " ".join(parts))
    return texts
