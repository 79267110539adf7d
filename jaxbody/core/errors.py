"""Errors: one exception, one warning, a missing extra, and the statuses that jitted code returns
instead of raising."""

from __future__ import annotations

import difflib
import enum
import importlib
import sys
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from jaxbody.core.codes import CODES
from jaxbody.core.progress_lines import clear

# most failed samples, and most problems, in the message of an error; its attribute `problems` has
# all of them
MOST_PROBLEMS, MOST_LINES = 20, 10
EXTRAS = {
    "pandas": "xarray",
    "asammdf": "mdf",
    "loky": "cluster",
    "zarr": "cluster",
    "rainflow": "fatigue",
    "arviz_stats": "posterior",
    "blackjax": "posterior",
}
EXTRAS |= dict.fromkeys(("h5py", "nptdms", "pyarrow", "pyuff"), "files") | dict.fromkeys(
    ("imageio_ffmpeg", "viser"), "view"
)
# packages whose lines are not shown as the place of a warning
SKIPPED = {"jaxbody", "equinox", "jax", "jaxtyping", "beartype", "contextlib", "functools"}


@dataclass(frozen=True)
class Problem:
    """One problem of an input: its code, place, message, value, allowed values and remedy."""

    code: str
    where: str
    message: str
    value: Any = None
    limit: str = ""
    hint: str = ""

    def __str__(self) -> str:
        limit, hint = (
            f" (allowed: {self.limit})" if self.limit else "",
            f" {self.hint}" if self.hint else "",
        )
        return f"{self.where}: {self.message.rstrip('.')}{limit}.{hint} [{self.code}]"


class JaxbodyError(ValueError):
    """The exception that jaxbody raises, with all `problems` of a call; the fields of the first
    problem, such as `code`, are also its attributes. `jb.error_codes()` lists all codes.

    >>> jb.JaxbodyError(Problem("BAD_MASS", "plate", "has a mass of -3 kg")).code
    'BAD_MASS'
    """

    def __init__(self, *problems: Problem):
        self.problems, first = problems, problems[0]
        self.code, self.where, self.value, self.limit, self.hint = (
            first.code,
            first.where,
            first.value,
            first.limit,
            first.hint,
        )
        shown = [str(problem) for problem in problems[:MOST_LINES]]
        shown += [f"... and {len(problems) - MOST_LINES} more in `problems`"] * (
            len(problems) > MOST_LINES
        )
        super().__init__(
            shown[0]
            if len(problems) == 1
            else f"{len(problems)} problems:\n  " + "\n  ".join(shown)
        )


class JaxbodyWarning(UserWarning):
    """The warning that jaxbody issues, with its `code`. To turn warnings into errors:
    `warnings.simplefilter("error", JaxbodyWarning)`.

    >>> jb.JaxbodyWarning("TINY_MASS", "mass of 'bolt' is tiny").code
    'TINY_MASS'
    """

    def __init__(self, code: str, message: str):
        self.code = code
        super().__init__(f"{message} [{code}]")


def warn(code: str, message: str) -> None:
    """Issue a JaxbodyWarning with this code at the user's line."""
    warn_of(JaxbodyWarning(code, message))


def warn_of(warning: Warning) -> None:
    """Issue a warning at the innermost line outside of the packages in SKIPPED."""
    frame, level = sys._getframe(1), 2
    while (
        frame.f_back is not None
        and frame.f_globals.get("__name__", "").partition(".")[0] in SKIPPED
    ):
        frame, level = frame.f_back, level + 1
    clear()
    warnings.warn(warning, stacklevel=level)


@dataclass
class Problems:
    """A list of the problems of a call, reported together: `with Problems() as problems:` raises
    one error with all of them at the end of the block."""

    collected: list[Problem] = field(default_factory=list)

    def __enter__(self) -> Problems:
        return self

    def __exit__(self, raised: type | None, *_: Any) -> None:
        if raised is None:
            self.raise_if_any()

    def add(
        self,
        code: str,
        where: str,
        message: str,
        *,
        value: Any = None,
        limit: str = "",
        hint: str = "",
    ) -> None:
        self.collected.append(Problem(code, where, message, value, limit, hint))

    def gather(
        self,
        function: Callable[[], Any],
        placed: Callable[[Problem], Problem] = lambda problem: problem,
    ) -> Any:
        """Return the result of `function`; None if it raises, with its problems added.

        `placed` changes each problem, for instance adds its line in a file."""
        try:
            return function()
        except JaxbodyError as error:
            self.collected += map(placed, error.problems)
            return None

    def raise_if_any(self) -> None:
        if self.collected:
            raise JaxbodyError(*self.collected)


def import_extra(module: str, where: str) -> Any:
    """Return a module of an optional package. Error: MISSING_EXTRA."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise JaxbodyError(
            Problem(
                "MISSING_EXTRA",
                where,
                f"needs the optional package {package}: {error}",
                package,
                hint=f"Install it: pip install 'jaxbody[{EXTRAS.get(package, package)}]'.",
            )
        ) from None


class Status(enum.IntEnum):
    """How a computation ended. Jitted code returns these numbers, one per sample; 0 is good.

    >>> jb.Status(2).name
    'UNSTABLE'
    """

    OK = 0
    NOT_CONVERGED = 1
    UNSTABLE = 2
    SINGULAR_K = 3
    MAX_STEPS = 4
    DT_MIN = 5
    NONFINITE = 6
    NOT_IDENTIFIABLE = 7
    NEVER_MOVED = 8
    AT_BOUND = 9
    TABLE_RANGE = 10
    NO_EQUILIBRIUM = 11
    LIMIT_POINT = 12
    NOT_SYMMETRIC = 13
    UNBALANCED = 14
    NEGATIVE_LENGTH = 15
    INTERNAL_RESONANCE = 16
    NOT_STEADY = 17
    LOST_BRANCH = 18
    DEFECTIVE = 20
    IMPROPER = 21
    COARSE = 22
    NOT_POSITIVE = 23
    INTERRUPTED = 24
    INFEASIBLE = 25
    SINGULAR_M = 26
    STALE = 27
    LOST = 28
    NOT_CLOSED = 29
    SINGULAR_CLOSURE = 30
    UNDAMPED = 31
    FAR_OFF = 32
    NOISY_INPUT = 33
    NONFINITE_FORCE = 34
    NOT_STABILIZABLE = 35


MESSAGES = {status: CODES[status.name][0] for status in Status}


def error_codes() -> str:
    """Return all codes of errors, warnings and statuses as text: what each means, and what to do.

    >>> print(jb.error_codes())  # doctest: +ELLIPSIS
    ALGEBRAIC_LOOP        a force reads an acceleration that it causes itself; ...
    """
    return "\n".join(f"{code:22}{meaning}; {remedy}" for code, (meaning, remedy) in CODES.items())


def check_known(name: Any, where: str, known: Iterable[Any]) -> None:
    """Raise UNKNOWN_NAME unless a name is one of the known names."""
    check_all_known((name,), where, known)


def check_all_known(names: Iterable[Any], where: str, known: Iterable[Any]) -> None:
    """Raise one error that lists UNKNOWN_NAME for each unknown name."""
    known = tuple(known)
    problems = [unknown(name, where, known) for name in names if name not in known]
    if problems:
        raise JaxbodyError(*problems)


def unknown(name: str, where: str, known: tuple[str, ...]) -> Problem:
    """Return the problem of an unknown name, with the nearest known one."""
    near = difflib.get_close_matches(str(name), known := tuple(map(str, known)), 1)
    hint = (
        (f"Did you mean '{near[0]}'? " if near else "")
        + "Known: "
        + ", ".join(known[:12])
        + (", ..." if len(known) > 12 else "")
        + "."
    )
    return Problem("UNKNOWN_NAME", where, f"'{name}' is unknown.", name, hint=hint)
