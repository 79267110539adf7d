"""Points, directions and orientations as users give them: unit quaternions, rotation matrices,
Euler angles with their sequence."""

import re
from functools import reduce
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import (
    Array,
    Float,
    as_numpy,
    checked,
    concrete,
    module_of,
    nan_unless,
    of_unit_length,
    vector,
)
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.geometry import rotations

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")  # along and about axes
ORDER = ("first", "second", "third")


def of_length_1(n: Any, where: str, problems: Problems) -> Any:
    """Return rows divided by their lengths. Error: ZERO_AXIS."""
    known = concrete(n)
    if known is None:
        return n / jnp.linalg.norm(n, axis=-1, keepdims=True)
    if not known.any(-1).all():
        problems.add(
            "ZERO_AXIS",
            where,
            "has length zero",
            value=known,
            limit="> 0",
            hint="Give a direction, such as [0, 0, 1].",
        )
        return n
    return of_unit_length(known)


def direction(given, where: str, problems: Problems) -> Any:
    """Return the unit vector along x, y or z, given by name, or along a direction of any length.
    Errors: BAD_DIRECTION, ZERO_AXIS."""
    if not isinstance(given, str):
        n = checked(given, ((3,),), where, problems)
        return np.array([0.0, 0, 1]) if n is None else of_length_1(n, where, problems)
    if given not in tuple("xyz"):
        problems.add(
            "BAD_DIRECTION",
            where,
            f"is {given!r}",
            value=given,
            limit="x y z",
            hint="Give one of these, or three numbers.",
        )
    return np.eye(3)["xyz".find(given)]


def ends(given, kind: str, problems: Problems):
    """Return ((name, ...), [point, ...]) of (name, point) pairs; a name alone means the origin O of
    its frame. Errors: BAD_END, SELF_SPRING."""
    names, coordinates = [], []
    for end, order in zip(given, ORDER, strict=False):
        where = f"{kind}, {order} end"
        if isinstance(end, str):
            end = (end, (0, 0, 0))
        if not (isinstance(end, tuple | list) and len(end) == 2 and isinstance(end[0], str)):
            problems.add(
                "BAD_END",
                where,
                f"is {end!r:.60}",
                value=end,
                limit='"body", or ("body", [x, y, z])',
                hint="Give the name of a body, a support or `world`, and a point in its frame if "
                "that is not its origin.",
            )
            end = ("?", (0, 0, 0))
        names.append(plain(end[0]))
        coordinates.append(vector(end[1], f"{where} ({end[0]})", problems))
    twice = [name for i, name in enumerate(names) if name in names[:i] and name != "?"]
    if twice:
        problems.add(
            "SELF_SPRING",
            kind,
            f"has {'both ends' if len(names) == 2 else 'two of its ends'} on '{twice[0]}'",
            value=twice[0],
            limit="different bodies or supports",
            hint="It would exert no force: name another body or support at one end.",
        )
    return tuple(names), coordinates


IDENTITY = (1.0, 0.0, 0.0, 0.0)
AXES = "xyz"


class EulerAngles(eqx.Module):
    """An orientation by Euler angles: R = R_1 R_2 R_3 about axes that turn with the frame, R_3 R_2
    R_1 about fixed axes.

    `sequence`: the axis of each turn, one to three letters; capitals ("ZYX": yaw, then pitch, then
    roll) for axes that turn with the frame (intrinsic), small letters ("xyz") for the fixed axes of
    the parent (extrinsic). `angles` [rad], one for each letter. Errors: BAD_SEQUENCE, BAD_SHAPE,
    NON_FINITE, DEGREES.

    >>> [round(float(x), 6) for x in np.asarray(jb.EulerAngles("ZYX", [np.pi / 2, 0, 0]))]
    [0.707107, 0.0, 0.0, 0.707107]
    """

    sequence: str = eqx.field(static=True)
    angles: Float[Array, "n"]

    def __init__(self, sequence: str, angles):
        with Problems() as problems:
            if (
                not isinstance(sequence, str)
                or not re.fullmatch("[xyz]{1,3}|[XYZ]{1,3}", sequence)
                or any(a == b for a, b in pairwise(sequence))
            ):
                raise JaxbodyError(
                    Problem(
                        "BAD_SEQUENCE",
                        "EulerAngles.sequence",
                        f"is {sequence!r}",
                        sequence,
                        "one to three of XYZ, or of xyz",
                        'Capitals: axes that turn with the frame ("ZYX": yaw, pitch, roll); small '
                        "letters: fixed axes; no axis twice in a row.",
                    )
                )
            self.sequence = sequence
            self.angles = checked(
                angles,
                ((len(sequence),),),
                "EulerAngles.angles",
                problems,
                "One angle [rad] for each letter of the sequence.",
            )
            known = None if self.angles is None else concrete(self.angles)
            if known is not None and (np.abs(known) > 2 * np.pi).any():
                problems.add(
                    "DEGREES",
                    "EulerAngles.angles",
                    f"is {known.tolist()} rad",
                    value=known,
                    limit="2 pi",
                    hint="Are these degrees? np.deg2rad converts them.",
                )

    def _quaternion(self, xp):
        turns = [
            [xp.cos(angle / 2), *(xp.sin(angle / 2) * float(letter == axis) for axis in AXES)]
            for letter, angle in zip(self.sequence.lower(), self.angles, strict=True)
        ]
        if self.sequence.islower():
            return xp.stack(reduce(lambda q, turn: _product(turn, q), turns))
        return xp.stack(reduce(_product, turns))

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self._quaternion(np), dtype)

    def __jax_array__(self):
        return self._quaternion(jnp)


def _product(p: list[Any], q: list[Any]) -> list[Any]:
    """Return the quaternion product p q: the rotation q followed by p."""
    (a, b, c, d), (w, x, y, z) = p, q
    return [
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    ]


def product(p: Any, q: Any) -> Any:
    """Return the product p q of two quaternions, the rotation q followed by p; in NumPy unless one
    is traced."""
    p, q = as_numpy(p), as_numpy(q)
    return module_of(p, q).stack(_product(list(p), list(q)))


def as_quaternion(value: Any, where: str, problems: Problems) -> Any:
    """Return the unit quaternion of a quaternion (length 1 within 1e-3), a rotation matrix
    (orthogonal within 1e-12) or Euler angles. Errors: BAD_QUATERNION, BAD_ROTATION, those of
    `checked`."""
    array = checked(
        value,
        ((4,), (3, 3)),
        where,
        problems,
        "Give a quaternion w, x, y, z, a rotation matrix or jb.EulerAngles(sequence, angles).",
    )
    if array is None:
        return np.array(IDENTITY)
    known = concrete(array)
    if known is None:
        return array if array.shape == (4,) else rotations.from_matrix(_nan_unless_rotation(array))
    if known.shape == (4,):
        length = np.linalg.norm(known)
        if abs(length - 1) > 1e-3:
            problems.add(
                "BAD_QUATERNION",
                where,
                f"has length {length:.6g}",
                value=known,
                limit="1 within 1e-3",
                hint=(
                    "Divide it by its length; the order is w, x, y, z."
                    if length
                    else "All four numbers are zero."
                ),
            )
            return np.array(IDENTITY)
        return of_unit_length(known)
    error, det = np.linalg.norm(known.T @ known - np.eye(3)), np.linalg.det(known)
    if error > 1e-12 or det < 0:
        problems.add(
            "BAD_ROTATION",
            where,
            f"is not a rotation: |R'R - I| = {error:.2g}, det R = {det:.6g}",
            value=known,
            limit="|R'R - I| <= 1e-12, det R = 1",
            hint="Make its axes right-handed."
            if det < 0
            else "If it is rounded, orthonormalize it: U V' of its SVD U S V'.",
        )
        return np.array(IDENTITY)
    return _quaternion(known)


def _nan_unless_rotation(R: jax.Array) -> jax.Array:
    """Return a traced matrix, NaN if it is no rotation."""
    error = jnp.sqrt(jnp.sum((R.T @ R - jnp.eye(3, dtype=R.dtype)) ** 2))
    right = (error <= max(1e-12, 64 * float(jnp.finfo(R.dtype).eps))) & (jnp.linalg.det(R) > 0)
    return nan_unless(jax.lax.stop_gradient(right), R)


def _quaternion(R: np.ndarray) -> np.ndarray:
    """Return the unit quaternion of a rotation matrix, as the dominant eigenvector of 4 q q' - I;
    in NumPy, so that nothing is compiled."""
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    S = R + R.T
    K = np.block(
        [
            [np.array([[np.trace(R)]]), np.array([[x, y, z]])],
            [np.array([[x], [y], [z]]), S - np.trace(R) * np.eye(3)],
        ]
    )
    q = np.linalg.eigh(K)[1][:, -1]
    return q if q[0] >= 0 else -q


def matrix(q: Any) -> Any:
    """Return the rotation matrix of a unit quaternion; in NumPy unless it is traced, so that
    nothing is compiled."""
    q = known if (known := concrete(q)) is not None else q
    if not isinstance(q, np.ndarray):
        return rotations.matrix(q)
    w, v = q[0], q[1:]
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * cross
