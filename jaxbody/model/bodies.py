"""Bodies, which have mass, and supports, whose motion is imposed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np

from jaxbody.core.arrays import Array, Float, checked, concrete, vector
from jaxbody.core.errors import JaxbodyError, Problem, Problems, warn
from jaxbody.geometry.fields import Described, field, nan_outside, take
from jaxbody.geometry.points_and_orientations import IDENTITY, as_quaternion, matrix

EPS = np.finfo(np.float64).eps
# indices in (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) of the entries of the matrix
PLACES_OF_SIX = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])


class Body(Described, eqx.Module):
    """A rigid body.

    Args:
        mass: [kg]
        inertia: about the center of mass in body axes [kg m2]: three principal moments, six numbers
            (Ixx, Iyy, Izz, Ixy, Ixz, Iyz: entries of the matrix, signs included) or the 3 x 3
            matrix; default: a point mass. In a model that moves in the xy plane only the moment I
            about z has an effect; [I/2, I/2, I] is then suitable (a flat body)
        com: the center of mass in body coordinates [m]
        position: position of the reference point O in the reference pose, where the search for
            equilibrium starts [m]
        orientation: rotation from body to world in the reference pose: unit quaternion w, x, y, z,
            rotation matrix or `jb.EulerAngles`

    A body of several parts: `Body.of_parts`.

    Errors, all at once: BAD_MASS, NOT_SYMMETRIC, NOT_POSITIVE, TRIANGLE, BAD_ROTATION,
    BAD_QUATERNION, BAD_SHAPE, NON_FINITE, COMPLEX, NOT_A_NUMBER.

    >>> float(jb.Body(mass=3.0, inertia=[0.3, 0.9, 1.2]).inertia[1, 1])
    0.9
    """

    mass: Float[Array, ""] = field(
        "kg",
        "positive",
        code="BAD_MASS",
        hint="Leave out parts without mass, or give them a small mass.",
    )
    inertia: Float[Array, "3 3"] = field("kg m2", "inertia")
    com: Float[Array, "3"] = field("m")
    position: Float[Array, "3"] = field("m")
    orientation: Float[Array, "4"] = field("", "rotation")

    def __init__(
        self, mass, inertia=(0, 0, 0), *, com=(0, 0, 0), position=(0, 0, 0), orientation=IDENTITY
    ):
        with Problems() as problems:
            take(self, problems, mass=mass)
            self.com = vector(com, "Body.com", problems)
            self.inertia = _inertia(inertia, self.mass, self.com, problems)
            self.position = vector(position, "Body.position", problems)
            self.orientation = as_quaternion(orientation, "Body.orientation", problems)

    @classmethod
    def of_parts(cls, parts: Sequence[Body], *, position=(0, 0, 0), orientation=IDENTITY) -> Body:
        """Combine several bodies in one rigid body; `position` and `orientation` of each part are
        relative to the whole.

            m = sum m_i,   c = sum m_i c_i/m,   I = sum R_i I_i R_i' + m_i (|d_i|^2 - d_i d_i'),
            d_i = c_i - c

        `position` and `orientation` are those of the whole, as for a Body. Error: NO_PARTS.

        >>> hammer = jb.Body.of_parts(
        ...     [
        ...         jb.Body(mass=0.2, inertia=[0, 2e-3, 2e-3]),
        ...         jb.Body(mass=0.5, position=[0.15, 0, 0]),
        ...     ]
        ... )
        >>> round(float(hammer.com[0]), 6), round(float(hammer.inertia[2, 2]), 6)
        (0.107143, 0.005214)
        """
        if not parts or not all(isinstance(part, Body) for part in parts):
            raise JaxbodyError(
                Problem(
                    "NO_PARTS",
                    "Body.of_parts",
                    f"has {parts!r:.60}",
                    parts,
                    "one body or more",
                    "Give [jb.Body(...), ...], each with its position and orientation in the "
                    "whole.",
                )
            )
        turns = [matrix(part.orientation) for part in parts]
        places = [part.position + R @ part.com for part, R in zip(parts, turns, strict=True)]
        mass = sum(part.mass for part in parts)
        com = sum(part.mass * place for part, place in zip(parts, places, strict=True)) / mass
        inertia = sum(
            R @ part.inertia @ R.T + part.mass * (d @ d * np.eye(3) - d[:, None] * d[None])
            for part, R, d in zip(parts, turns, [place - com for place in places], strict=True)
        )
        return cls(mass, inertia, com=com, position=position, orientation=orientation)


class Support(Described, eqx.Module):
    """A frame whose motion is imposed. `position` [m] and `orientation` (as for a body) are its
    reference pose, from which the motion is measured.

    >>> jb.Support(position=[0, -1, 0]).position.tolist()
    [0.0, -1.0, 0.0]
    """

    position: Float[Array, "3"] = field("m")
    orientation: Float[Array, "4"] = field("", "rotation")

    def __init__(self, position=(0, 0, 0), orientation=IDENTITY):
        with Problems() as problems:
            self.position = vector(position, "Support.position", problems)
            self.orientation = as_quaternion(orientation, "Support.orientation", problems)


def _inertia(value: Any, mass: Any, com: Any, problems: Problems) -> Any:
    """Return a body's inertia as a symmetric 3 x 3 matrix [kg m2]. The round-off allowed in its
    check is relative to the inertia about the reference point, I + m (c'c - c c'), from which users
    often compute it."""
    where = "Body.inertia"
    array = checked(
        value,
        ((3,), (6,), (3, 3)),
        where,
        problems,
        "Give three principal moments, (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) or the matrix.",
    )
    if array is None:
        return np.eye(3)
    I = _matrix_of(array)
    known, m, c = concrete(I), concrete(mass), concrete(com)
    if known is None:
        return nan_outside((I + I.T) / 2, "inertia", 2, 2 * mass * (com @ com))
    check_inertia(
        known,
        64
        * EPS
        * (abs(np.trace(known)) + (2 * abs(m) * c @ c if m is not None and c is not None else 0)),
        where,
        problems,
    )
    return (I + I.T) / 2


def check_inertia(known: np.ndarray, round_off: float, where: str, problems: Problems) -> None:
    """Check an inertia matrix [kg m2], within a tolerance of `round_off` [kg m2]. Errors:
    NOT_SYMMETRIC, NOT_POSITIVE, TRIANGLE."""
    trace = np.trace(known)
    difference = known - known.T
    moments = np.linalg.eigvalsh((known + known.T) / 2)
    shown = ", ".join(f"{m:.6g}" for m in moments)
    signs = "Are the signs of the products right?" + (
        " With the other signs it is valid: give entries of the matrix, such as Ixy = -sum m x y."
        if _is_valid(2 * np.diag(np.diag(known)) - known, round_off)
        else ""
    )
    if np.abs(difference).max() > 1e-9 * abs(trace):
        xy, xz, yz = difference[0, 1], difference[0, 2], difference[1, 2]
        problems.add(
            "NOT_SYMMETRIC",
            where,
            f"is not symmetric: I - I' = {xy:.3g} (xy), {xz:.3g} (xz), {yz:.3g} (yz)",
            value=difference,
            limit=f"{1e-9 * abs(trace):.3g}",
            hint="Give (I + I')/2 if that is intended.",
        )
    elif moments[0] < -round_off:
        problems.add(
            "NOT_POSITIVE",
            where,
            f"has principal moments {shown} kg m2",
            value=moments,
            limit=">= 0",
            hint=f"Is it about the center of mass? {signs}",
        )
    elif moments[0] + moments[1] - moments[2] < -round_off:
        problems.add(
            "TRIANGLE",
            where,
            f"has principal moments {shown} kg m2: the largest exceeds the sum of the "
            f"others by {moments[2] - moments[0] - moments[1]:.3g}",
            value=moments,
            limit="at most the sum of the two others",
            hint=(
                "For motion in a plane give half of it about the axes in the plane, where it has "
                f"no effect: {moments[2] / 2:.6g}, {moments[2] / 2:.6g}, {moments[2]:.6g}."
            )
            if moments[1] <= round_off
            else f"Is it about the center of mass? {signs} Are all units the same?",
        )


def _is_valid(I: np.ndarray, round_off: float) -> bool:
    low, middle, high = np.linalg.eigvalsh(I)
    return bool(min(low, low + middle - high) >= -round_off)


def _matrix_of(array):
    """Return the 3 x 3 inertia matrix given by three, six or nine numbers."""
    if array.shape == (3,):
        return array * np.eye(3)
    return array if array.shape == (3, 3) else array[PLACES_OF_SIX]


def warn_of_tiny(
    names: tuple[str, ...], sizes: np.ndarray, what: str = "mass", unit: str = "kg"
) -> None:
    """Warn TINY_MASS of a mass, or an inertia, below 1e-12 of the largest, which makes the
    equations stiff."""
    for name, size in zip(names, sizes, strict=True):
        if 0 < size < 1e-12 * sizes.max():
            warn(
                "TINY_MASS",
                f"{what} of '{name}' is {size:.3g} {unit}, {size / sizes.max():.1g} of the "
                "largest: its equations will be stiff",
            )


def warn_of_points(bodies: dict[str, Body]) -> None:
    """Warn ZERO_MOMENT of free bodies that have no inertia about an axis."""
    for name, body in bodies.items():
        known = concrete(body.inertia)
        if known is None:
            continue
        moments, axes = np.linalg.eigh(known)
        massless_axes = [
            np.round(axis + 0.0, 3).tolist()
            for moment, axis in zip(moments, axes.T, strict=True)
            if moment <= 64 * EPS * np.trace(known)
        ]
        if massless_axes:
            axis = "any axis" if len(massless_axes) == 3 else f"{massless_axes[0]} of its axes"
            warn(
                "ZERO_MOMENT",
                f"'{name}' is free to turn and has no inertia about {axis}: static results are "
                "valid; modes and simulations need an inertia, or a joint that prevents this "
                "rotation",
            )
