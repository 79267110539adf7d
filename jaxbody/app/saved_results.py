"""What a command found, saved with --out: tables as text, Parquet or netCDF, or a picture."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core.datasets import Labeled
from jaxbody.core.errors import JaxbodyError, Problem, import_extra
from jaxbody.core.source_files import writing
from jaxbody.core.tables import PrintedTable, in_numpy


def save(outcome: Any, path: Path) -> None:
    """Save an outcome in the format of the path's extension. Errors: UNKNOWN_FORMAT, MISSING_EXTRA, NOT_SAVED."""
    with writing(path):
        if path.suffix == ".csv":
            path.write_text("\n".join(_text(table) for table in _tables(outcome)), encoding="utf-8")
        elif path.suffix == ".parquet":
            import_extra("pyarrow", "--out")
            _frame(outcome).to_parquet(path)
        elif path.suffix == ".nc":
            _dataset(outcome).to_netcdf(path, engine="scipy")
        elif outcome.draw is None:
            raise JaxbodyError(Problem("UNKNOWN_FORMAT", "--out", "is a picture, which this command does not draw", path, ".csv"))
        else:
            outcome.draw().figure.savefig(path, dpi=130)


def _tables(outcome: Any) -> list[PrintedTable]:
    if outcome.series is not None:
        return [outcome.series()]
    return [table for result in outcome.results if hasattr(result, "_tables") for table in in_numpy(result)._tables()]


def _labeled(outcome: Any) -> Labeled:
    """The first result that has labeled arrays."""
    labeled = next((result for result in outcome.results if isinstance(result, Labeled)), None)
    if labeled is None:
        raise JaxbodyError(Problem("UNKNOWN_FORMAT", "--out", "is for labeled numbers, which this command has none of", limit=".csv"))
    return labeled


def _frame(outcome: Any) -> Any:
    """A table of pandas, of the series or of a result; complex columns as two real ones, which Parquet knows."""
    if outcome.series is not None:
        table = outcome.series()
        return import_extra("pandas", "--out").DataFrame(np.array(table.rows, float), columns=list(table.columns))
    frame = _labeled(outcome).to_pandas()
    for name in [name for name in frame if np.iscomplexobj(frame[name])]:
        frame = frame.assign(**_halves(name, frame[name].to_numpy())).drop(columns=name)
    return frame


def _dataset(outcome: Any) -> Any:
    """A dataset of xarray, of the series over its first column or of a result; complex arrays as two real ones, which netCDF knows."""
    if outcome.series is not None:
        table = outcome.series()
        (index, over), *columns = zip(table.columns, np.array(table.rows, float).T, strict=True)
        return import_extra("xarray", "--out").Dataset({_plain(name): (_plain(index), x) for name, x in columns}, {_plain(index): over})
    data = _labeled(outcome).to_xarray()
    for name in [name for name, x in data.data_vars.items() if np.iscomplexobj(x)]:
        data = data.assign(_halves(name, data[name])).drop_vars(name)
    return data


def _halves(name: str, x: Any) -> dict[str, Any]:
    return {f"{name}_real": x.real, f"{name}_imaginary": x.imag}


def _plain(name: str) -> str:
    """A name without the slash that netCDF keeps for groups."""
    return name.replace("/", " per ")


def _text(table: PrintedTable) -> str:
    """A table as lines of comma-separated values, with its title and note as comments."""
    lines = io.StringIO()
    rows = csv.writer(lines, lineterminator="\n")
    for comment in (table.title, table.note):
        lines.write(f"# {comment}\n" if comment else "")
    rows.writerow(table.columns)
    rows.writerows(table.rows)
    return lines.getvalue()
