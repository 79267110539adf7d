"""Inputs of small motions: the motion of a support along or about one axis, a force or moment on
a body, the command of a drive."""

from typing import Any

import equinox as eqx

from jaxbody.core.arguments import check_one_of, plain
from jaxbody.core.arrays import Array, Float, vector
from jaxbody.core.errors import Problem, Problems, unknown
from jaxbody.geometry.fields import field
from jaxbody.geometry.points_and_orientations import DIRECTIONS
from jaxbody.geometry.points_and_orientations import direction as unit_direction
from jaxbody.model.forces.drives import drive_tables

KINDS = ("displacement", "velocity", "acceleration")
UNITS = (("m", "m/s", "m/s2"), ("rad", "rad/s", "rad/s2"))


class BaseMotion(eqx.Module):
    """An input: the motion of a support along or about a world axis through its origin, `direction`
    x, y, z, rx, ry or rz.

    `kind` of the input: displacement [m, rad], velocity or acceleration. Errors:
    BAD_DIRECTION, BAD_KIND.

    >>> jb.BaseMotion("base", "z", kind="acceleration").unit
    'm/s2'
    """

    on: str = eqx.field(static=True, converter=plain)
    direction: str = eqx.field(static=True, converter=plain)
    kind: str = eqx.field(static=True, converter=plain)

    def __init__(self, on: str, direction: str, *, kind: str = "displacement"):
        with Problems() as problems:
            check_one_of(direction, DIRECTIONS, "BAD_DIRECTION", "BaseMotion.direction", problems)
            check_one_of(kind, KINDS, "BAD_KIND", "BaseMotion.kind", problems)
        self.on, self.direction, self.kind = on, direction, kind

    @property
    def unit(self) -> str:
        return UNITS[len(self.direction) - 1][KINDS.index(self.kind)]

    def problem(self, model: Any, where: str) -> Problem | None:
        known = model.layout.supports
        return None if self.on in known else unknown(self.on, where, known)


class PointForce(eqx.Module):
    """An input: a force [N] at a point of a body along x, y, z or a vector, in world axes; or a
    moment [N m] about them: rx, ry, rz.

    `point` is in the axes of the body. Errors: BAD_DIRECTION, ZERO_AXIS, BAD_SHAPE, NON_FINITE.

    >>> jb.PointForce("engine", [0, 0, 0.2], "z").unit, jb.PointForce("engine", direction="rx").unit
    ('N', 'N m')
    """

    on: str = eqx.field(static=True, converter=plain)
    point: Float[Array, "3"] = field("m")
    axis: Float[Array, "3"] = field("", "direction")
    turns: bool = field(static=True)

    def __init__(self, on: str, point=(0, 0, 0), direction: Any = "z"):
        with Problems() as problems:
            self.on, self.point = on, vector(point, "PointForce.point", problems)
            self.turns = isinstance(direction, str) and direction in DIRECTIONS[3:]
            self.axis = unit_direction(
                direction[-1:] if self.turns else direction, "PointForce.direction", problems
            )

    @property
    def unit(self) -> str:
        return "N m" if self.turns else "N"

    def problem(self, model: Any, where: str) -> Problem | None:
        known = model.layout.bodies
        return None if self.on in known else unknown(self.on, where, known)


class Command(eqx.Module):
    """An input: a command [N] of a drive, an Actuator or ControlledDamper, in addition to that of
    its controller.

    >>> jb.Command("actuator").unit
    'N'
    """

    on: str = eqx.field(static=True, converter=plain)
    unit = "N"

    def problem(self, model: Any, where: str) -> Problem | None:
        return unknown_drive(self.on, model, where)


def unknown_drive(name: str, model: Any, where: str) -> Problem | None:
    """Return the problem of a name that is no drive of the model."""
    known = tuple(name for table in drive_tables(model) for name in table.names)
    return None if name in known else unknown(name, where, known)


Input = BaseMotion | PointForce | Command
