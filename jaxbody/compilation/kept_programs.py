"""Programs on disk: what one process has traced, later ones of the same structure load.

The text of a program names all that it depends on; its hash is the name of two files: what the program returns, and its code for a CPU,
which a later process runs without tracing and lowering anything. On other devices the second one is what `jax.export` makes of it, which is
lowered again, and compiled code is in the cache of JAX beside them.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import sys
import tempfile
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import jax
from jax.experimental.compilation_cache import compilation_cache

from jaxbody.compilation.array_functions import KEPT, Options, Remainder, jitted, known_to_xla
from jaxbody.compilation.plain_data import LIBRARIES, Unnamed, text_of, value_of
from jaxbody.compilation.program_parts import programs_inside
from jaxbody.compilation.shared_settings import little_garbage, without_cache
from jaxbody.core import tables
from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.core.jax_internals import code_can_be_run, code_of, runner

FORM = "jaxbody program 1"
NUMBERS = tuple("biufc")  # kinds of types of NumPy; keys of random numbers have none
LARGEST = 500e6  # bytes of all files; the oldest are removed
Runner = Callable[[Sequence[Any]], list[Any]]
Results = tuple[list[Any], Remainder]  # arrays or their types, and all else


@dataclass(eq=False)
class KeptPrograms:
    """What `keep_programs` has loaded from its folder, saved there and left out, with the reason; it prints as a table.

    `loaded`, `saved`: names of functions; `left_out`: {name: reason}.

    >>> print(KeptPrograms(Path("programs"), saved=["equilibrium_of"]))
    Programs in programs
      function        state
      equilibrium_of  saved
    """

    folder: Path
    loaded: list[str] = field(default_factory=list)
    saved: list[str] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    functions: dict[Any, Runner] = field(default_factory=dict)  # {(program, options, types): what runs it}
    codes: list[str] = field(default_factory=list)  # files of the code that was loaded or saved
    ahead: dict[str, Future[Runner | None]] = field(default_factory=dict)  # the same by file, loaded before it is needed

    def __repr__(self) -> str:
        rows: list[tuple[str, str]] = [(name, "loaded") for name in self.loaded] + [(name, "saved") for name in self.saved]
        return tables.text(tables.PrintedTable(f"Programs in {self.folder}", ("function", "state"), rows + list(self.left_out.items())))

    def types_of_results(self, program: Callable[..., Any], types: tuple[Any, ...]) -> Results:
        """Types of the arrays that a program returns, and all else that it returns."""
        name = self.name_of(program, types)
        try:
            if name is not None:
                results, remainder = value_of((self.read(name + ".types") or b"").decode())
                return list(results), remainder
        except ValueError:
            pass
        results, remainder = _traced(program, types)
        try:
            if name is not None:
                self.write(name + ".types", text_of((tuple(results), remainder)).encode(), program.__name__)
        except Unnamed as error:
            self.left_out[program.__name__] = f"it returns {error}, which has no text"
        return results, remainder

    def results(self, program: Callable[..., Any], options: Options, types: tuple[Any, ...], arrays: Sequence[Any]) -> list[Any]:
        """The arrays that a program returns for arrays of these types; what runs it is loaded, or else made and saved."""
        key = program, options, types
        if key in self.functions:
            return self.functions[key](arrays)
        name = self.name_of(program, types)
        if name is None:
            self.functions[key] = _not_kept(program, options)
            return self.functions[key](arrays)
        code = hashlib.sha256(f"{name} {options} {_settings()}".encode()).hexdigest() + ".code"
        run = self.ahead[code].result() if code in self.ahead else self.loaded_code(code)
        results = None if run is None else _first_results(run, arrays)
        if run is None or results is None:
            all_types = *types, *types_of_results(program, types)[0]
            is_code = code_can_be_run() and all(getattr(t.dtype, "kind", "") in NUMBERS for t in all_types)
            make, file = (self.compiled, code) if is_code else (self.exported, name)
            self.functions[key] = make(program, options, types, file)
            return self.functions[key](arrays)
        self.loaded.append(program.__name__)
        self.codes.append(code)
        self.functions[key] = run
        return results

    def compiled(self, program: Callable[..., Any], options: Options, types: tuple[Any, ...], file: str) -> Runner:
        """What runs the program, whose code is saved."""
        alone = jax.jit(_alone(program), keep_unused=True, compiler_options=known_to_xla(options))
        traced = alone.trace(*structs(types))
        if _calls_python(traced.jaxpr):
            self.left_out[program.__name__] = "calls a function of Python while it runs"
            return _not_kept(program, options)
        with without_cache():  # code from there would lack functions when it is saved again
            compiled = traced.lower().compile()
        if self.write(file, zlib.compress(code_of(compiled), 1), program.__name__):
            self.saved.append(program.__name__)
            self.codes.append(file)
        return lambda arrays: compiled(*arrays)

    def exported(self, program: Callable[..., Any], options: Options, types: tuple[Any, ...], name: str) -> Runner:
        """What runs the exported program, which is loaded or else saved under its name."""
        import jax.export

        file = name + ".program"
        data = self.read(file)
        if data is not None:
            self.loaded.append(program.__name__)
        else:
            try:
                data = jax.export.export(jax.jit(_alone(program)))(*structs(types)).serialize()
            except Exception as error:  # a callback, or an operation that this version of JAX cannot export
                self.left_out[program.__name__] = f"{type(error).__name__}: {error}".splitlines()[0]
                return _not_kept(program, options)
            if self.write(file, bytes(data), program.__name__):
                self.saved.append(program.__name__)
        exported = jax.export.deserialize(bytearray(data))  # also what was just made: it has other types than what it is made from

        def kept(*arrays):
            return exported.call(*arrays)

        kept.__name__ = program.__name__
        compiled = jax.jit(kept, compiler_options=known_to_xla(options)).lower(*structs(types)).compile()
        return lambda arrays: compiled(*arrays)

    def loaded_code(self, name: str) -> Runner | None:
        """What runs the code in a file; None where there is none, or none that can be loaded."""
        data = self.read(name)
        if data is None:
            return None
        return runner(zlib.decompress(data))

    def load_ahead(self, task: str) -> None:
        """Begin to load the code that the last process with this task used, while this one reads its input and imports what it needs."""
        names = (self.read(_file_of(task)) or b"").decode().split()
        executor = ThreadPoolExecutor(1)
        self.ahead |= {name: executor.submit(self.loaded_code, name) for name in names}
        executor.shutdown(wait=False)

    def note_task(self, task: str) -> None:
        """Write down for `load_ahead` which code this process has used."""
        if self.codes != list(self.ahead):
            self.write(_file_of(task), "\n".join(self.codes).encode(), task)

    def name_of(self, program: Callable[..., Any], types: tuple[Any, ...]) -> str | None:
        """The name of the files of a program; None where it depends on something that has no text, such as a function of a user."""
        try:
            text = text_of((program, types))
        except Unnamed as error:
            self.left_out[program.__name__] = f"depends on {error}, which jaxbody cannot name"
            return None
        return hashlib.sha256(f"{_versions()} {_precision()} {text}".encode()).hexdigest()

    def read(self, name: str) -> bytes | None:
        """The content of a file; None if there is none, or if it is not what was written under this name."""
        try:
            heading, _, data = (self.folder / name).read_bytes().partition(b"\n")
            os.utime(self.folder / name)
        except OSError:
            return None
        return data if heading == _heading(name, data) else None

    def write(self, name: str, data: bytes, function: str) -> bool:
        """Write a file at once, so that other processes see all of it or nothing; the oldest files make room. A file that cannot be
        written is left out."""
        try:
            handle, path = tempfile.mkstemp(dir=self.folder)
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(_heading(name, data) + b"\n" + data)
                os.replace(path, self.folder / name)
            except OSError:
                os.unlink(path)
                raise
            self.make_room()
        except OSError as error:
            self.left_out[function] = f"could not be written: {error}"
            return False
        return True

    def make_room(self) -> None:
        """Remove the oldest files until all are within LARGEST; those of JAX count, too."""
        files = []
        for path in self.folder.rglob("*"):
            try:
                if path.is_file():
                    files.append((path.stat().st_mtime, path.stat().st_size, path))
            except OSError:  # another process has removed it
                continue
        total = sum(size for _, size, _ in files)
        for _, size, path in sorted(files):
            if total <= LARGEST:
                break
            path.unlink(missing_ok=True)
            total -= size


_kept: KeptPrograms | None = None


def keep_programs(folder: str | os.PathLike | None = None) -> KeptPrograms:
    """Keep traced and compiled programs on disk for later processes, which then start in a fraction of the time.

    Args:
        folder: a folder of your own that no other user may read or write; by default `jaxbody` in your cache folder (XDG_CACHE_HOME or
            ~/.cache). It is made if there is none.

    A later process loads a program for a model of the same structure, whatever its numbers, if jaxbody, JAX, the other libraries and the
    processor are the same. Programs that depend on a function or class of your own are not kept, as their source is unknown; the result
    lists them. On a CPU it is their compiled code that is kept, for the same options of XLA and JAX; elsewhere they are lowered again. All
    other programs are left to JAX's own cache of compiled code, which is set unless it is already. All files together stay below 500 MB.
    Call it before the first computation; the command `jaxbody` does.

    Errors: UNSAFE_FOLDER for a folder that is not yours or not of mode 0700, NOT_SAVED where it cannot be made.

    >>> import jaxbody as jb
    >>> kept = jb.keep_programs()  # doctest: +SKIP
    >>> print(kept)                # doctest: +SKIP
    """
    global _kept
    path = Path(folder) if folder is not None else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxbody"
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        state = path.stat()
    except OSError as error:
        raise JaxbodyError(Problem("NOT_SAVED", str(path), str(error), hint="Name another folder.")) from None
    if hasattr(os, "getuid") and (state.st_uid != os.getuid() or state.st_mode & 0o077):
        message = f"belongs to user {state.st_uid} and has mode {state.st_mode & 0o777:04o}, so that others might change programs in it"
        hint = f"Name a folder of your own, or make it private: chmod 700 {path}"
        raise JaxbodyError(Problem("UNSAFE_FOLDER", str(path), message, path, "your own, mode 0700", hint))
    if _kept is None or _kept.folder != path:
        _kept = KeptPrograms(path)
        _kept.make_room()
    if not jax.config.jax_compilation_cache_dir:  # pyright: ignore
        jax.config.update("jax_compilation_cache_dir", str(path / "compiled"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
        compilation_cache.reset_cache()  # JAX looks for its folder once only
    return _kept


def known(program: Callable[..., Any], types: tuple[Any, ...], fact: str, find: Callable[[], bool]) -> bool:
    """A fact about a program that `find` finds by tracing it, which is kept if `keep_programs` was called."""
    if _kept is None or (name := _kept.name_of(program, types)) is None:
        return find()
    kept = _kept.read(f"{name}.{fact}")
    if kept is None:
        kept = str(find()).encode()
        _kept.write(f"{name}.{fact}", kept, program.__name__)
    return kept == b"True"


def call(program: Callable[..., Any], options: Options, arrays: Sequence[Any]) -> Results:
    """What a program returns, compiled with these options, kept if `keep_programs` was called."""
    with little_garbage():
        if _kept is None or not _as_usual(arrays):
            return jitted(program, options)(*arrays)
        arrays = [x if isinstance(x, jax.Array) else jax.device_put(x) for x in arrays]
        types = tuple(map(jax.typeof, arrays))
        return list(_kept.results(program, options, types, arrays)), types_of_results(program, types)[1]


def compiled_by_jax(arrays: Sequence[Any]) -> bool:
    """Whether JAX alone keeps what a program is compiled to for these arrays, so that it can be compiled ahead for their types."""
    return _kept is None and _as_usual(arrays)


def _as_usual(arrays: Sequence[Any]) -> bool:
    return not _debugging() and on_first_device(arrays)


def _first_results(run: Runner, arrays: Sequence[Any]) -> list[Any] | None:
    """What code from a file returns; None where XLA finds that it is incomplete, which it does only when it runs."""
    try:
        return jax.block_until_ready(run(arrays))
    except jax.errors.JaxRuntimeError:
        return None


def _debugging() -> bool:
    """Whether JAX runs operations one by one, or looks for NaN in the results of a program."""
    return any(getattr(jax.config, f"jax_{name}") for name in ("disable_jit", "debug_nans", "debug_infs"))


def on_first_device(arrays: Sequence[Any]) -> bool:
    """Whether all arrays are where JAX computes by default; those of NumPy are nowhere yet."""
    first = {jax.devices()[0]}
    return all(x.devices() == first for x in arrays if isinstance(x, jax.Array))


def _not_kept(program: Callable[..., Any], options: Options) -> Runner:
    """What runs a program that is compiled in this process alone."""
    return lambda arrays: jitted(program, options)(*arrays)[0]


def _alone(program: Callable[..., Any]) -> Callable[..., list[Any]]:
    """The program without all that it returns beside arrays."""

    def alone(*arrays):
        return jitted(program)(*arrays)[0]

    alone.__name__ = program.__name__
    return alone


def _calls_python(jaxpr: Any) -> bool:
    """Whether a program calls functions of this process while it runs, so that its code is of no use to others."""
    return any("callback" in equation.primitive.name or any(map(_calls_python, programs_inside(equation))) for equation in jaxpr.eqns)


def types_of_results(program: Callable[..., Any], types: tuple[Any, ...]) -> Results:
    """Types of the arrays that a program returns for arrays of these types, and all else that it returns."""
    return _types_of_results(program, types, _kept)


@functools.lru_cache(KEPT)
def _types_of_results(program, types, kept):
    with little_garbage():
        return _traced(program, types) if kept is None else kept.types_of_results(program, types)


def _traced(program: Callable[..., Any], types: tuple[Any, ...]) -> Results:
    results, remainder = jax.eval_shape(jitted(program), *structs(types))
    return [jax.typeof(x) for x in results], remainder


def structs(types: tuple[Any, ...]) -> list[jax.ShapeDtypeStruct]:
    """Arguments of these types with which JAX traces a function."""
    return [jax.ShapeDtypeStruct(t.shape, t.dtype, weak_type=getattr(t, "weak_type", False)) for t in types]


def _heading(name: str, data: bytes) -> bytes:
    return f"{FORM} {name} {hashlib.sha256(data).hexdigest()}".encode()


@functools.cache
def _versions() -> str:
    """All that a program depends on and that does not change in a process: source and libraries, Python, processor."""
    libraries = [f"{name} {metadata.version(name)}" for name in sorted({*LIBRARIES, "jaxlib", "numpy"} - {"jaxbody"})]
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = " ".join(sorted({line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))}))
    except OSError:
        processor = platform.processor()
    return repr((hash_of_source(), libraries, sys.version_info[:2], platform.machine(), processor, FORM))


@functools.cache
def hash_of_source() -> str:
    """A hash of all files of jaxbody."""
    source = hashlib.sha256()
    for file in sorted(_sources(resources.files("jaxbody")), key=str):
        source.update(file.read_bytes())
    return source.hexdigest()


def _sources(folder: Any) -> list[Any]:
    return [file for x in folder.iterdir() for file in (_sources(x) if x.is_dir() else [x] if x.name.endswith(".py") else [])]


def _settings() -> str:
    """All that compiled code depends on beside its program: options of XLA and of JAX, but not whether it comes from a cache."""
    options = sorted((name, value) for name, value in jax.config.values.items() if "cache" not in name)  # pyright: ignore
    return repr((os.environ.get("XLA_FLAGS", ""), options))


def _file_of(task: str) -> str:
    return hashlib.sha256(f"{_versions()} {task}".encode()).hexdigest() + ".task"


def _precision() -> str:
    """Switches of JAX that change what is traced, and the device."""
    names = ("jax_enable_x64", "jax_default_matmul_precision", "jax_debug_nans", "jax_numpy_dtype_promotion")
    return repr(([str(getattr(jax.config, name)) for name in names], jax.default_backend(), jax.devices()[0].device_kind))
