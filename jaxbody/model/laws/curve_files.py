"""Measured curves from text files: two columns, in the units that the file states."""

from pathlib import Path
from typing import Any

from jaxbody.core import units
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.core.source_files import check_file
from jaxbody.records.text_tables import read_text

LENGTHS = (units.LENGTH, units.ANGLE, units.SPEED, units.ANGULAR_RATE)
FORCES = (units.FORCE, units.MOMENT)


def read_columns(path: Path, *, largest: float, **text: Any) -> list[Any]:
    """Read two columns of a text file of at most `largest` bytes; return them in SI units."""
    check_file(path, largest)
    contents = read_text(path.read_bytes(), path.name, **text)
    with Problems() as problems:
        where, width = f"{path.name}:{contents.head}", len(contents.columns)
        if width != 2:
            raise JaxbodyError(
                Problem(
                    "BAD_SHAPE",
                    where,
                    f"has {width} column{'s' * (width > 1)}",
                    width,
                    "two",
                    (
                        "First elongation or its rate, then force or moment; separator= states "
                        "what separates them."
                    ),
                )
            )
        columns, read_dimensions = [], []
        for (name, column), dimensions in zip(
            contents.columns.items(), (LENGTHS, FORCES), strict=True
        ):
            if column.unit is None:
                problems.add(
                    "NO_UNIT",
                    where,
                    f"states no unit for column '{name}'",
                    limit="elongation [mm], force [N]",
                    hint="Write a line of names with units above the numbers.",
                )
                continue
            unit = problems.gather(lambda column=column: units.parse(column.unit or "", where))
            if unit is not None and unit.dimension not in dimensions:
                problems.add(
                    "WRONG_DIMENSION",
                    where,
                    f"has '{name}' in '{unit.text}'",
                    value=unit.text,
                    limit=" or ".join(units.si_words(dimension) for dimension in dimensions),
                    hint="First elongation or its rate, then force or moment.",
                )
            columns.append(column.values * (unit.factor if unit else 1.0))
            read_dimensions.append(unit and unit.dimension)
    if (read_dimensions[0] in (units.ANGLE, units.ANGULAR_RATE)) != (
        read_dimensions[1] == units.MOMENT
    ):
        raise JaxbodyError(
            Problem(
                "WRONG_DIMENSION",
                where,
                "has an angle with a force, or a length with a moment",
                tuple(contents.columns),
                "[m] and [N], or [rad] and [N m]",
                "An angle needs a moment, an elongation a force.",
            )
        )
    return columns
