"""Bodies, which have mass, and supports, whose motion is imposed."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from jaxbody import rotations
from jaxbody.arrays import checked, concrete, shaped
from jaxbody.errors import Problems, warn

IDENTITY = (1.0, 0.0, 0.0, 0.0)
EPS = np.finfo(np.float64).eps


class Body(eqx.Module):
    """A rigid body.

    mass [kg]; inertia about the centre of mass in body axes [kg m2]: three principal moments, six numbers
    (Ixx, Iyy, Izz, Ixy, Ixz, Iyz: entries of the matrix, signs included) or the 3 x 3 matrix; `com`, the centre of mass in body
    coordinates [m]; `position` of the reference point O [m] and `orientation` (unit quaternion w, x, y, z or rotation matrix, body to
    world) in the reference pose, where the search for equilibrium starts.

    Errors, all found at once: BAD_MASS, NOT_SYMMETRIC, NOT_POSITIVE, TRIANGLE, BAD_ROTATION, BAD_QUATERNION, BAD_SHAPE, NON_FINITE,
    COMPLEX, NOT_A_NUMBER.

    >>> Body(mass=3.0, inertia=[0.3, 0.9, 1.2]).inertia[1, 1]
    np.float64(0.9)
    """

    mass: Float[Array, ""]
    inertia: Float[Array, "3 3"]
    com: Float[Array, "3"]
    position: Float[Array, "3"]
    orientation: Float[Array, "4"]

    def __init__(self, mass, inertia, *, com=(0, 0, 0), position=(0, 0, 0), orientation=IDENTITY):
        problems = Problems()
        self.mass = _mass(mass, problems)
        self.com = vector(com, "Body.com", problems)
        self.inertia = _inertia(inertia, self.mass, self.com, problems)
        self.position = vector(position, "Body.position", problems)
        self.orientation = as_quaternion(orientation, "Body.orientation", problems)
        problems.raise_if_any()


class Support(eqx.Module):
    """A frame whose motion is imposed; `position` [m] and `orientation` (as of a body) are its reference pose, motions count from there.

    >>> Support(position=[0, -1, 0]).position.tolist()
    [0.0, -1.0, 0.0]
    """

    position: Float[Array, "3"]
    orientation: Float[Array, "4"]

    def __init__(self, position=(0, 0, 0), orientation=IDENTITY):
        problems = Problems()
        self.position = vector(position, "Support.position", problems)
        self.orientation = as_quaternion(orientation, "Support.orientation", problems)
        problems.raise_if_any()


def scalar(value: Any, where: str, problems: Problems) -> Any:
    """A number. Error: BAD_SHAPE."""
    return shaped(value, (), where, problems)


def vector(value: Any, where: str, problems: Problems) -> Any:
    """Three numbers. Error: BAD_SHAPE."""
    return shaped(value, (3,), where, problems)


def as_quaternion(value: Any, where: str, problems: Problems) -> Any:
    """A unit quaternion of a quaternion (length 1 within 1e-3) or of a rotation matrix (orthogonal within 1e-12)."""
    array = checked(value, ((4,), (3, 3)), where, problems, "Give a quaternion w, x, y, z or a rotation matrix.")
    if array is None:
        return np.array(IDENTITY)
    known = concrete(array)
    if known is None:
        return array if array.shape == (4,) else rotations.from_matrix(array)
    if known.shape == (4,):
        length = np.linalg.norm(known)
        if abs(length - 1) > 1e-3:
            hint = "All four numbers are zero." if length == 0 else "Divide it by its length; the order is w, x, y, z."
            problems.add("BAD_QUATERNION", where, f"has length {length:.6g}", value=known, limit="1 within 1e-3", hint=hint)
            return np.array(IDENTITY)
        return known / length
    error, det = np.linalg.norm(known.T @ known - np.eye(3)), np.linalg.det(known)
    if error > 1e-12 or det < 0:
        problems.add(
            "BAD_ROTATION",
            where,
            f"is no rotation: |R'R - I| = {error:.2g}, det R = {det:.6g}",
            value=known,
            limit="|R'R - I| <= 1e-12, det R = 1",
            hint="Make its axes right-handed." if det < 0 else "If it is rounded, orthonormalize it: U V' of its SVD U S V'.",
        )
        return np.array(IDENTITY)
    return _quaternion(known)


def _quaternion(R: np.ndarray) -> np.ndarray:
    """The unit quaternion of a rotation matrix, as the dominant eigenvector of 4 q q' - I; in NumPy, as checks run before any compiler."""
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    S = R + R.T
    K = np.block([[np.array([[np.trace(R)]]), np.array([[x, y, z]])], [np.array([[x], [y], [z]]), S - np.trace(R) * np.eye(3)]])
    q = np.linalg.eigh(K)[1][:, -1]
    return q if q[0] >= 0 else -q


def _mass(value: Any, problems: Problems) -> Any:
    mass = checked(value, ((),), "Body.mass", problems)
    known = None if mass is None else concrete(mass)
    if known is not None and known <= 0:
        hint = "Leave out what has no mass, or give it a small one."
        problems.add("BAD_MASS", "Body.mass", f"is {known:g} kg", value=float(known), limit="> 0", hint=hint)
    return np.ones(()) if mass is None else mass


def _inertia(value: Any, mass: Any, com: Any, problems: Problems) -> Any:
    """The 3 x 3 matrix, of which T sees the symmetric part alone. What round-off may do to it is measured by the inertia about the
    reference point, I + m (c'c - c c'): that is where an inertia about the centre of mass often comes from."""
    where = "Body.inertia"
    hint = "Give three principal moments, (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) or the matrix."
    array = checked(value, ((3,), (6,), (3, 3)), where, problems, hint)
    if array is None:
        return np.eye(3)
    I = _matrix_of(array)
    known, m, c = concrete(I), concrete(mass), concrete(com)
    if known is None:
        return (I + I.T) / 2
    trace = np.trace(known)
    round_off = 64 * EPS * (abs(trace) + (2 * abs(m) * c @ c if m is not None and c is not None else 0))
    difference = known - known.T
    moments = np.linalg.eigvalsh((known + known.T) / 2)
    told = ", ".join(f"{m:.6g}" for m in moments)
    if np.abs(difference).max() > 1e-9 * abs(trace):
        xy, xz, yz = difference[0, 1], difference[0, 2], difference[1, 2]
        problems.add(
            "NOT_SYMMETRIC",
            where,
            f"is not symmetric: I - I' = {xy:.3g} (xy), {xz:.3g} (xz), {yz:.3g} (yz)",
            value=difference,
            limit=f"{1e-9 * abs(trace):.3g}",
            hint="Give (I + I')/2 if that is meant.",
        )
    elif moments[0] < -round_off or trace <= 0:
        problems.add(
            "NOT_POSITIVE",
            where,
            f"has principal moments {told} kg m2",
            value=moments,
            limit=">= 0, not all 0",
            hint="Is it about the centre of mass? Are the signs of the products right?",
        )
    elif moments[0] + moments[1] - moments[2] < -round_off:
        deficit = moments[2] - moments[0] - moments[1]
        problems.add(
            "TRIANGLE",
            where,
            f"has principal moments {told} kg m2: the largest exceeds the sum of the others by {deficit:.3g}",
            value=moments,
            limit="at most the sum of the two others",
            hint="Is it about the centre of mass? Are the signs of the products right? Are the units one and the same?",
        )
    return (I + I.T) / 2


def _matrix_of(array):
    """The 3 x 3 matrix of three, six or nine numbers."""
    if array.shape == (3, 3):
        return array
    unit = np.zeros((6, 3, 3))
    for n, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]):
        unit[n, i, j] = unit[n, j, i] = 1
    return (array[:, None, None] * unit[: array.shape[0]]).sum(0)


def warn_of_tiny(names: tuple[str, ...], sizes: np.ndarray, what: str = "mass", unit: str = "kg") -> None:
    """TINY_MASS: a mass, or an inertia, below 1e-12 of the largest makes the motion stiff."""
    for name, size in zip(names, sizes, strict=True):
        if size < 1e-12 * sizes.max():
            warn("TINY_MASS", f"{what} of '{name}' is {size:.3g} {unit}, {size / sizes.max():.1g} of the largest: its motion will be stiff")
