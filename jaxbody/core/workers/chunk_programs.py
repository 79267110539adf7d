"""Programs as data: one process traces the program of a batch of one width; any other process loads
it, keeps it by its name, and runs it on chunks of rows.

`jax.export` writes a program with all that it depends on but its arguments, so that neither
functions of the user nor JAX's own objects are sent. A chunk has any number of rows; the program
computes `width` of them at a time, on each device of the process."""

from __future__ import annotations

import functools
import hashlib
import os
import re
import socket
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib import metadata
from typing import Any

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, PartitionSpec

from jaxbody.core.compilation.compile_options import OPTIMIZED
from jaxbody.core.errors import JaxbodyError, Problem

KEPT = 16  # most programs kept in a worker, and for one function in its caller
WORD = r'(?:"(?:[^"\\]|\\.)*"|[^()"])*'
CUSTOM_CALL = re.compile(r"stablehlo\.custom_call @(\w+)")
# references to lines of the source, in the text of a program
LOCATION = re.compile(rf"^#loc.*\n| loc\({WORD}(?:\({WORD}\))?\)", re.M)

# because with jaxlib 0.10 two programs with LAPACK in one process may wait for each other forever
one_at_a_time = threading.Lock()

Types = dict[str, tuple[tuple[int, ...], str]]  # {name: shape and type of an array}


@dataclass(frozen=True)
class ChunkProgram:
    """A program: (arrays that all rows share, arrays of `width` rows) -> {name: array of `width`
    results}."""

    # a hash of the program, without lines of the source, and of what follows the data: the same in
    # every process
    name: str
    data: bytes
    width: int
    results: Types  # of one row
    options: tuple[tuple[str, Any], ...]  # of compilation
    x64: bool
    versions: tuple[tuple[str, str], ...]

    def __call__(
        self, shared: Sequence[np.ndarray], rows: Sequence[np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Return the results of a chunk of rows; its last row is repeated to fill up the last
        `width`. Error: OTHER_WORKER."""
        loaded, count, parts = self.loaded(), len(rows[0]), []
        with one_at_a_time, precision(self.x64):
            for first in range(0, count, loaded.width):
                given = [filled(x, first, loaded.width) for x in rows]
                parts.append(
                    {name: np.asarray(y) for name, y in loaded.call(shared, given).items()}
                )
        return {name: np.concatenate([part[name] for part in parts])[:count] for name in parts[0]}

    def loaded(self) -> LoadedProgram:
        """Return the compiled program, kept in this process by its name. Error: OTHER_WORKER if
        this process would not compute the same numbers as the caller."""
        with one_at_a_time, precision(self.x64):
            self._check()
            return kept(_loaded, self.name, lambda: _compiled(self))

    def _check(self) -> None:
        for (name, own), (_, wanted) in zip(versions(), self.versions, strict=True):
            if own != wanted:
                raise other_worker(f"has {name} {own}", f"{name} {wanted}")
        own, wanted = str(jnp.result_type(float)), "float64" if self.x64 else "float32"
        if own != wanted:
            raise other_worker(f"computes in {own}", wanted)


@dataclass(frozen=True)
class LoadedProgram:
    """A program compiled for the devices of this process, which together compute `width` rows at a
    time."""

    call: Callable[..., dict[str, jax.Array]]
    width: int


def exported(
    function: Callable[..., Any], shared: Sequence[Any], rows: Sequence[Any], width: int, where: str
) -> ChunkProgram:
    """Return function(shared, rows), whose results are {name: array of `width` rows}, as data.

    Args:
        function: a function of two lists of arrays.
        shared: arrays that all rows share.
        rows: arrays over the rows, any number of them.
        width: number of rows that are computed at a time.
        where: the place in the call, for messages.

    Error: NOT_SENT."""
    given = [jax.ShapeDtypeStruct((width, *x.shape[1:]), x.dtype) for x in rows]
    program = jax.jit(function)
    # errors of the user's own functions are raised as they are
    results = types_of(jax.eval_shape(program, list(shared), given))
    given = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in shared], given
    try:
        made = _export(program, given)
        data, text = bytes(made.serialize()), LOCATION.sub("", made.mlir_module())
    except Exception as error:  # a callback, or an operation that this version of JAX cannot export
        raise JaxbodyError(
            Problem(
                "NOT_SENT",
                where,
                f"cannot be sent to workers: {str(error).splitlines()[0]:.200}",
                limit="a program without callbacks",
                hint=(
                    "Leave out callbacks, such as jax.debug.print and pure_callback, or compute "
                    "without workers= and out=."
                ),
            )
        ) from error
    x64: bool = jax.config.read("jax_enable_x64")
    rest: Any = (width, results, OPTIMIZED, x64, versions())
    return ChunkProgram(hashlib.sha256(f"{text} {rest}".encode()).hexdigest(), data, *rest)


def _export(program: Any, given: tuple[Any, ...]) -> jax.export.Exported:
    """Export a program that may call LAPACK or a device's library, which other versions of jaxlib
    may lack; workers have the same version."""
    try:
        return jax.export.export(program)(*given)
    except ValueError as error:
        names = set(CUSTOM_CALL.findall(str(error)))
        if not names or any("callback" in name for name in names):
            raise
        return jax.export.export(
            program, disabled_checks=list(map(jax.export.DisabledSafetyCheck.custom_call, names))
        )(*given)


def filled(x: np.ndarray, first: int, width: int) -> np.ndarray:
    """Return `width` rows from the first on, where the last row is repeated to fill them up."""
    return x[np.minimum(np.arange(first, first + width), len(x) - 1)]


def types_of(arrays: dict[str, Any]) -> Types:
    """Return shapes, without the axis of rows, and types of arrays."""
    return {name: (tuple(x.shape[1:]), str(x.dtype)) for name, x in arrays.items()}


@functools.cache
def versions() -> tuple[tuple[str, str], ...]:
    """Return the versions on which numbers depend: jaxbody, JAX and its compiler, and the kind of
    device. The name of a program is a hash of all that it computes."""
    return (
        *((name, metadata.version(name)) for name in ("jaxbody", "jax", "jaxlib")),
        ("device", jax.default_backend()),
    )


def precision(x64: bool) -> AbstractContextManager:
    """Return a context in which this thread computes in float64, or in float32."""
    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(x64)
    from jax.experimental import enable_x64  # pyright: ignore  before version 0.8

    return enable_x64(x64)


def worker_name() -> str:
    """Return the name of this process in messages."""
    return f"{socket.gethostname()}:{os.getpid()}"


def other_worker(message: str, wanted: Any) -> JaxbodyError:
    """Return the error of a worker that differs from the caller."""
    return JaxbodyError(
        Problem(
            "OTHER_WORKER",
            f"worker {worker_name()}",
            message,
            limit=f"{wanted}, as the caller",
            hint=(
                "Install the same versions for the caller and all workers, and set the same "
                "options before JAX starts."
            ),
        )
    )


_loaded: dict[str, LoadedProgram] = {}


def kept(known: dict[Any, Any], key: Any, make: Callable[[], Any]) -> Any:
    """Return the result of `make`, which is called once for each of the last KEPT keys."""
    if key not in known:
        while len(known) >= KEPT:
            known.pop(next(iter(known)))
        known[key] = make()
    return known[key]


def _compiled(program: ChunkProgram) -> LoadedProgram:
    """Compile a program for the devices of this process.

    Each device runs the same program on its own rows, so that results do not depend on the number
    of devices."""
    # jaxlib finds LAPACK only after such a call
    jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((2, 2), jnp.result_type(float)))
    exported = jax.export.deserialize(bytearray(program.data))
    devices = (
        [] if b"lapack" in program.data and jax.default_backend() == "cpu" else jax.local_devices()
    )  # see `one_at_a_time`
    width, call = program.width, exported.call
    if len(devices) > 1:
        mesh = jax.make_mesh(
            (len(devices),), ("device",), axis_types=(AxisType.Auto,), devices=devices
        )
        here, apart = PartitionSpec(), PartitionSpec("device")
        call = jax.shard_map(
            call, mesh=mesh, in_specs=(here, apart), out_specs=apart, check_vma=False
        )
        width *= len(devices)

    (shared, rows), _ = jax.tree.unflatten(exported.in_tree, exported.in_avals)
    wide = [jax.ShapeDtypeStruct((width, *x.shape[1:]), x.dtype) for x in rows]
    same = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in shared]
    compiled = jax.jit(call, compiler_options=dict(program.options)).lower(same, wide).compile()
    return LoadedProgram(compiled, width)


@dataclass(frozen=True)
class ComputedChunk:
    """A finished chunk: its results, and the name of its worker."""

    results: dict[str, np.ndarray]
    worker: str


@dataclass(frozen=True)
class FailedChunk:
    """The failure of a chunk: the reason why it has no results, and in `refused` the problem if its
    worker cannot compute any chunk. It is not an exception, because some exceptions cannot be
    sent."""

    message: str
    refused: Problem | None = None


def compute_chunk(
    program: ChunkProgram,
    shared: Sequence[np.ndarray],
    rows: Sequence[np.ndarray],
    function: Callable[..., Any] | None = None,
) -> ComputedChunk | FailedChunk:
    """Compute a chunk, by its program or by a function of jaxbody that calls it: function(program,
    shared, rows) -> results."""
    try:
        results = program(shared, rows) if function is None else function(program, shared, rows)
        return ComputedChunk(results, worker_name())
    except JaxbodyError as error:
        return FailedChunk(str(error), error.problems[0])
    except Exception as error:
        return FailedChunk(f"{type(error).__name__}: {error!s:.200}")
