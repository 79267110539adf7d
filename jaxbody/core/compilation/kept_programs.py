"""Programs on disk: JAX's own cache of compiled code, in a folder that is the user's own."""

import os
from pathlib import Path

import jax
from jax.experimental.compilation_cache import compilation_cache

from jaxbody.core.errors import JaxbodyError, Problem


def keep_programs(folder: str | os.PathLike | None = None) -> Path:
    """Let JAX keep its compiled programs on disk, for later processes, and return the folder.

    Args:
        folder: a folder of your own that no other user may read or write, created if it does not
            exist; by default `jaxbody` in your cache folder (XDG_CACHE_HOME or ~/.cache).

    This is JAX's persistent cache, for programs of any size and time of compilation. If JAX has a
    folder already (JAX_COMPILATION_CACHE_DIR), that one is used. A later process traces its
    functions again, which is the greater part of the time, but compiles only those that have
    changed. Call it before the first computation; the command `jaxbody` does.

    Errors: UNSAFE_FOLDER for a folder that is not yours or not of mode 0700, NOT_SAVED where it
    cannot be made.

    >>> import jaxbody as jb
    >>> folder = jb.keep_programs()  # doctest: +SKIP
    """
    path = (
        Path(folder)
        if folder is not None
        else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxbody"
    )
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        state = path.stat()
    except OSError as error:
        raise JaxbodyError(
            Problem("NOT_SAVED", str(path), str(error), hint="Name another folder.")
        ) from None
    if hasattr(os, "getuid") and (state.st_uid != os.getuid() or state.st_mode & 0o077):
        raise JaxbodyError(
            Problem(
                "UNSAFE_FOLDER",
                str(path),
                (
                    f"belongs to user {state.st_uid} and has mode {state.st_mode & 0o777:04o}, so "
                    "that others might change programs in it"
                ),
                path,
                "your own, mode 0700",
                f"Name a folder of your own, or make it private: chmod 700 {path}",
            )
        )
    present = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if present:
        return Path(present)
    jax.config.update("jax_compilation_cache_dir", str(path))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    compilation_cache.reset_cache()  # JAX looks for its folder once only
    return path
