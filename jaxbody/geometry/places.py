"""Points and directions as users give them."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import plain
from jaxbody.core.arrays import checked, concrete, of_unit_length, vector
from jaxbody.core.errors import Problems

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")  # along and about axes
ORDER = ("first", "second", "third")


def of_length_1(n: Any, where: str, problems: Problems) -> Any:
    """Rows divided by their lengths. Error: ZERO_AXIS."""
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
    """The unit vector along x, y or z, given by name, or along a direction of any length. Errors:
    BAD_DIRECTION, ZERO_AXIS."""
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


def ends(given, kind: str, problems: Problems, *, points: bool = True):
    """((name, ...), [point, ...]) of (name, point) pairs; where `points` is False, a pair may be a
    name alone."""
    names, coordinates = [], []
    for end, order in zip(given, ORDER, strict=False):
        where = f"{kind}, {order} end"
        if not points and isinstance(end, str):
            end = (end, (0, 0, 0))
        if not (isinstance(end, tuple | list) and len(end) == 2 and isinstance(end[0], str)):
            problems.add(
                "BAD_END",
                where,
                f"is {end!r:.60}",
                value=end,
                limit='("body", [x, y, z])',
                hint="Give the name of a body, a support or `world`, and a point in its frame.",
            )
            end = ("?", (0, 0, 0))
        names.append(plain(end[0]))
        coordinates.append(vector(end[1], f"{where} ({end[0]})", problems))
    twice = [name for i, name in enumerate(names) if name in names[:i] and name != "?"]
    if twice:
        hint = "It would exert no force: name another body or support at one end."
        which = "has both ends" if len(names) == 2 else "has two of its ends"
        problems.add(
            "SELF_SPRING",
            kind,
            f"{which} on '{twice[0]}'",
            value=twice[0],
            limit="different bodies or supports",
            hint=hint,
        )
    return tuple(names), coordinates
