"""Results of a batch in a Zarr store: an array for each quantity with the chunks of the batch, and
`status`, written last, as their flag.

    store.zarr/zarr.json      with the plan of the batch: hashes and sizes that a call must
                              have in common with the one that made it
              frequency/c/7/0  the results of chunk 7
              status/c/7       of its rows: 0 for complete ones, LOST without results

Chunks are written by the caller, several at a time if each has its own chunks: no file is written
by two of them, so that no locks are needed.
"""

import hashlib
import json
import secrets
import shutil
from collections.abc import Iterable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, Status, import_extra
from jaxbody.core.source_files import writing
from jaxbody.core.workers.chunk_programs import Types

PLAN, STATUS = "jaxbody", "status"
FORMAT = 1


def hash_of(*things: Any) -> str:
    """Return a short hash of arrays and words."""
    made = hashlib.sha256()
    for thing in things:
        array = np.asarray(thing) if isinstance(thing, np.ndarray | jax.Array) else None
        made.update(
            repr(thing).encode()
            if array is None
            else f"{array.shape} {array.dtype}".encode() + array.tobytes()
        )
    return made.hexdigest()[:16]


def nothing(dtype: str) -> float:
    """Return the value that stands for a missing result."""
    return np.nan if np.dtype(dtype).kind == "f" else 0


class ChunkStore:
    """A store of the results of a batch on disk.

    Args:
        path: its folder, created if it does not exist.
        plan: {word: text or number} that identifies the call.
        inputs, results: {name: (shape of a row, type)} of the inputs and of the results.
        dimension: name of the dimension over the rows.
        count: number of rows.
        size: number of rows in a chunk.

    Errors: OTHER_STORE, NOT_SAVED, BAD_NAME, MISSING_EXTRA."""

    def __init__(
        self,
        path: Path,
        plan: dict[str, Any],
        inputs: Types,
        results: Types,
        *,
        dimension: str = "design",
        count: int,
        size: int,
    ):
        self.zarr = import_extra("zarr", "out")
        self.path, self.inputs, self.dimension = path, tuple(inputs), dimension
        self.count, self.size = count, size
        plan, arrays = (
            {"format": FORMAT, **plan, f"{dimension}s": count, "chunk": size},
            inputs | results,
        )
        for name in [*inputs, *results]:
            if (
                "/" in name
                or name.startswith("__")
                or name in ("", ".", "..", STATUS)
                or name in inputs.keys() & results.keys()
            ):
                raise JaxbodyError(
                    Problem(
                        "BAD_NAME",
                        "out",
                        f"cannot have an array {name!r}",
                        name,
                        "no '/'; not 'status', nor the name of an input",
                        "Rename the quantity: names are folders of the store.",
                    )
                )
        if not path.exists():
            self._make(plan, arrays)
        self._check(plan)
        with self._writing():
            root = self.zarr.open_group(path, mode="r+")
        self.arrays = {name: root[name] for name in [*arrays, STATUS]}

    def _make(self, plan: dict[str, Any], arrays: Types) -> None:
        """Create the store under another name and rename it: if several processes do so, one of
        them succeeds, and all find a complete store."""
        new = self.path.with_name(f"{self.path.name}.{secrets.token_hex(4)}.new")
        with ExitStack() as stack, self._writing():
            stack.callback(shutil.rmtree, new, ignore_errors=True)
            root = self.zarr.open_group(new, mode="w-", attributes={PLAN: plan})
            for name, (shape, dtype) in {**arrays, STATUS: ((), "int8")}.items():
                fill = Status.INTERRUPTED.value if name == STATUS else nothing(dtype)
                names = [self.dimension, *(f"{name}_{i}" for i in range(len(shape)))]
                root.create_array(
                    name,
                    shape=(self.count, *shape),
                    chunks=(plan["chunk"], *(max(n, 1) for n in shape)),
                    dtype=dtype,
                    fill_value=fill,
                    dimension_names=names,
                )
            try:
                new.rename(self.path)
            except OSError:
                if not self.path.exists():
                    raise

    def _check(self, plan: dict[str, Any]) -> None:
        """Error: OTHER_STORE if the plan of the store is not that of the call."""
        try:
            stored = json.loads((self.path / "zarr.json").read_text())["attributes"][PLAN]
        except (OSError, ValueError, KeyError, TypeError):
            raise JaxbodyError(
                Problem(
                    "OTHER_STORE",
                    str(self.path),
                    "is no store of jaxbody",
                    self.path,
                    hint="Name a folder that does not exist yet.",
                )
            ) from None
        differing = [word for word in {**plan, **stored} if plan.get(word) != stored.get(word)]
        if differing:
            each = [f"{word} {stored.get(word)} there, {plan.get(word)} here" for word in differing]
            raise JaxbodyError(
                Problem(
                    "OTHER_STORE",
                    str(self.path),
                    f"is of another call: {'; '.join(each)}",
                    self.path,
                    hint="Repeat the call that it is from, or name another folder.",
                )
            )

    def complete(self) -> set[int]:
        """Return the chunks with results."""
        return self._with_status(Status.OK)

    def lost(self) -> set[int]:
        """Return the chunks that were given up."""
        return self._with_status(Status.LOST)

    def _with_status(self, status: Status) -> set[int]:
        first_rows = self.arrays[STATUS][:][:: self.size]  # all rows of a chunk have its status
        return set(np.flatnonzero(first_rows == status).tolist())

    def write(self, chunk: int, arrays: dict[str, np.ndarray], *, lost: bool = False) -> None:
        """Write the rows of a chunk, without results if it is lost, and then its status. Error:
        NOT_SAVED."""
        rows = slice(chunk * self.size, min((chunk + 1) * self.size, self.count))
        with self._writing():
            for name, values in arrays.items():
                self.arrays[name][rows] = values
            self.arrays[STATUS][rows] = np.int8(Status.LOST if lost else Status.OK)

    def read(self, names: Iterable[str]) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return arrays of all rows in memory, NaN or zero where results are missing, and the
        status of each row."""
        return {name: self.arrays[name][:] for name in names}, self.arrays[STATUS][:].astype(int)

    def _writing(self) -> AbstractContextManager[None]:
        return writing(
            self.path,
            (
                "Its complete chunks are kept: with room or permission to write, the "
                "same call continues."
            ),
        )

    def opened(self, title: str) -> Any:
        """Return the store as an xarray.Dataset that reads its arrays when they are used."""
        xarray = import_extra("xarray", "out")
        return (
            xarray.open_zarr(self.path, consolidated=False, chunks=None)
            .set_coords(list(self.inputs))
            .assign_attrs(title=title)
        )
