"""Sensitivities of quantities to parameters: exact slopes, and the values after a decrease or an
increase of each parameter."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Float, Int
from jaxbody.core.errors import JaxbodyError, Problem, Status
from jaxbody.core.progress_lines import working
from jaxbody.core.results import warn_if_failed
from jaxbody.design.design_programs import Evaluate, OfQuantities, Program, labels_of
from jaxbody.design.searches import one_thread
from jaxbody.fitting.parameters.spaces import space_of
from jaxbody.model.models import Model
from jaxbody.model.preconditions import check_precision

SHOWN = 5  # parameters printed for each quantity


class Sensitivities(OfQuantities):
    """Result of `sensitivities`: `nominal` values of the `quantities`, their `slopes` d q/d x
    (quantities, parameters), and their values `low` and `high` with each of the `parameters`
    lower and higher by the relative `change`. `ranked(quantity)` lists the parameters, the
    strongest first."""

    nominal: Float[np.ndarray, "m"]
    slopes: Float[np.ndarray, "m n"]
    low: Float[np.ndarray, "m n"]
    high: Float[np.ndarray, "m n"]
    status: Int[np.ndarray, ""]
    parameters: tuple[str, ...]
    change: float

    def ranked(self, quantity: str) -> tuple[str, ...]:
        return tuple(self.parameters[i] for i in self.order(quantity))

    def order(self, quantity: str) -> np.ndarray:
        row = self.row(quantity)
        return np.argsort(
            -np.maximum(
                abs(self.low[row] - self.nominal[row]), abs(self.high[row] - self.nominal[row])
            ),
            kind="stable",
        )

    def _tables(self) -> list[tables.PrintedTable]:
        rows: list[tuple[Any, ...]] = []
        for row, name in enumerate(self.quantities):
            first: tuple[Any, ...] = (name, self.nominal[row])
            for i in self.order(name)[:SHOWN]:
                changes = self.slopes[row, i], self.low[row, i], self.high[row, i]
                rows.append((*first, self.parameters[i], *changes))
                first = ("", "")
        heads = (
            "quantity",
            "value",
            "parameter",
            "slope",
            f"{100 * self.change:g} % less",
            f"{100 * self.change:g} % more",
        )
        return [
            tables.PrintedTable("Sensitivities, the strongest first", heads, rows, self.failure)
        ]


def sensitivities(
    model: Model,
    evaluate: Evaluate,
    *,
    free: str | Iterable[str],
    change: float = 0.1,
    progress: bool | None = None,
) -> Sensitivities:
    """Compute how quantities depend on parameters, which are changed one at a time from their
    values in the model.

        d q/d x exactly;   q(x (1 - change)),   q(x (1 + change))

    Args:
        model, evaluate, free, progress: as in `tune`.
        change: relative change of each parameter. Parameters without a scale, such as a
            coordinate that is 0, change by this fraction of the model's size, orientations by
            `change` radians.

    Errors: those of `tune` about these arguments, BAD_CHANGE. Warns NONFINITE.

    >>> def sag(model):
    ...     return {"sag": model["body"].mass * 9.81 / model["suspension"].stiffness}
    >>> result = jb.design.sensitivities(
    ...     jb.presets.quarter_car(),
    ...     sag,
    ...     free=["suspension.stiffness", "body.mass", "tyre.stiffness"],
    ... )
    >>> result.ranked("sag")
    ('suspension.stiffness', 'body.mass', 'tyre.stiffness')
    """
    check_precision("sensitivities", model)
    if not 0 < change < 1:
        raise JaxbodyError(
            Problem(
                "BAD_CHANGE",
                "sensitivities.change",
                f"is {change}",
                change,
                "between 0 and 1",
                "0.1 is ten percent.",
            )
        )
    space = space_of(model, free, "sensitivities")
    up, down = (
        np.concatenate([parameter.form.changed(part) for parameter in space.parameters])
        for part in (change, -change)
    )
    U = np.concatenate([np.zeros((1, space.size)), np.diag(down), np.diag(up)])
    program = Program(space, evaluate, "", {}, progress=progress)
    with one_thread(), working("sensitivities", progress) as program.line:
        values, slopes = map(np.array, zip(*map(program, U), strict=True))
    low, high = np.split(values[1:].T, 2, axis=1)
    finite = np.isfinite(values).all() and np.isfinite(slopes[0]).all()
    return warn_if_failed(
        Sensitivities(
            values[0],
            slopes[0] / space.numbers(U[0])[1],
            low,
            high,
            np.asarray(0 if finite else Status.NONFINITE.value),
            tuple(space.labels),
            change,
            quantities=tuple(labels_of(program.shapes)),
        )
    )
