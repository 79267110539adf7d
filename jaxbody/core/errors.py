"""Errors: one exception, one warning, a missing extra, and the status codes that jitted code returns instead of raising."""

from __future__ import annotations

import difflib
import enum
import importlib
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import jax

from jaxbody.core.jax_internals import Tracer
from jaxbody.core.progress_lines import clear

MOST_PROBLEMS = 20
MOST_LINES = 10  # of a message; `problems` holds them all
EXTRAS = {"xarray": ("xarray",), "ipopt": ("casadi",), "files": ("pyarrow", "h5py", "pyuff", "nptdms"), "mdf": ("asammdf",)}  # packages
SKIPPED = {"jaxbody", "equinox", "jax", "contextlib", "functools"}  # packages whose lines do not help a user


@dataclass(frozen=True)
class Problem:
    """One problem of an input: where it is, what is wrong, and what to do about it."""

    code: str
    where: str
    message: str
    value: Any = None
    limit: str = ""
    hint: str = ""

    def __str__(self) -> str:
        limit = f" (allowed: {self.limit})" if self.limit else ""
        hint = f" {self.hint}" if self.hint else ""
        return f"{self.where}: {self.message.rstrip('.')}{limit}.{hint} [{self.code}]"


class JaxbodyError(ValueError):
    """The one exception of jaxbody. `problems` lists all problems of a call; the fields of the first are also attributes of the error.

    >>> try:
    ...     Body(mass=-3.0, inertia=[1.0, 1.0, 1.0])
    ... except JaxbodyError as error:
    ...     error.code
    'BAD_MASS'
    """

    def __init__(self, *problems: Problem):
        self.problems = problems
        first = problems[0]
        self.code, self.where, self.value, self.limit, self.hint = first.code, first.where, first.value, first.limit, first.hint
        shown = [str(problem) for problem in problems[:MOST_LINES]]
        if len(problems) > MOST_LINES:
            shown.append(f"... and {len(problems) - MOST_LINES} more in `problems`")
        super().__init__(shown[0] if len(problems) == 1 else f"{len(problems)} problems:\n  " + "\n  ".join(shown))


class JaxbodyWarning(UserWarning):
    """The one warning of jaxbody, with its `code`. To turn warnings into errors: `warnings.simplefilter("error", JaxbodyWarning)`.

    >>> JaxbodyWarning("TINY_MASS", "mass of 'bolt' is tiny").code
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
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in SKIPPED:
        frame, level = frame.f_back, level + 1
    clear()
    warnings.warn(warning, stacklevel=level)


@dataclass
class Problems:
    """Collects problems, so that one error holds all of them."""

    collected: list[Problem] = field(default_factory=list)

    def add(self, code: str, where: str, message: str, *, value: Any = None, limit: str = "", hint: str = "") -> None:
        self.collected.append(Problem(code, where, message, value, limit, hint))

    def gather(self, function: Callable[[], Any]) -> Any:
        """The result of `function`; None where it raises, and its problems are collected."""
        try:
            return function()
        except JaxbodyError as error:
            self.collected += error.problems
            return None

    def raise_if_any(self) -> None:
        if self.collected:
            raise JaxbodyError(*self.collected)


def import_extra(module: str, where: str) -> Any:
    """A module of a package that is installed with an extra of jaxbody. Error: MISSING_EXTRA."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        extra = next(name for name, packages in EXTRAS.items() if package in packages)
        hint = f"Install it: pip install 'jaxbody[{extra}]'."
        raise JaxbodyError(Problem("MISSING_EXTRA", where, f"needs the package {package}, an extra: {error}", package, hint=hint)) from None


class Status(enum.IntEnum):
    """How a computation ended. Jitted code returns these numbers, one per sample; 0 is good.

    >>> Status(2).name
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


MESSAGES = {
    Status.OK: "ok",
    Status.NOT_CONVERGED: "the search for a solution did not converge",
    Status.UNSTABLE: "the equilibrium is unstable",
    Status.SINGULAR_K: "the stiffness matrix is singular: something is free to move",
    Status.MAX_STEPS: "the integration reached its largest number of steps",
    Status.DT_MIN: "the step size fell below its smallest value",
    Status.NONFINITE: "a value is not finite",
    Status.NOT_IDENTIFIABLE: "the data do not determine all free parameters",
    Status.NEVER_MOVED: "a free parameter has no effect on the data",
    Status.AT_BOUND: "a parameter ended at its bound",
    Status.TABLE_RANGE: "a law was used beyond the points of its table",
    Status.NO_EQUILIBRIUM: "no equilibrium was found",
    Status.LIMIT_POINT: "the load cannot be raised further: the stiffness vanishes there",
    Status.NOT_SYMMETRIC: "K is not symmetric, as a load has no potential: there are no real modes",
    Status.UNBALANCED: "the free lengths cannot balance the pose",
    Status.NEGATIVE_LENGTH: "a free length would have to be negative",
    Status.INTERNAL_RESONANCE: "the frequency of a mode, or twice it, is also that of another mode: the two interact",
    Status.NOT_STEADY: "the motion is not steady: its speeds change, or the matrices of small motions about it do",
    Status.LOST_BRANCH: "a mode changed too much from one value to the next to be followed",
    Status.DEFECTIVE: "modes coincide: rounding errors dominate their sum",
    Status.IMPROPER: "an output needs a derivative of an input",
    Status.COARSE: "the frequencies are too far apart to resolve what lies between them",
    Status.NOT_POSITIVE: "the matrix of power spectral densities is not positive semidefinite",
    Status.INTERRUPTED: "the computation was interrupted",
    Status.INFEASIBLE: "not all limits can be met",
    Status.SINGULAR_M: "the mass matrix is singular: a coordinate has no inertia",
    Status.STALE: "the equilibrium does not belong to this model: forces do not balance there",
}


def is_concrete(*trees: Any) -> bool:
    """True when nothing in the trees is being traced, so that values can be read."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees))


def unknown(name: str, where: str, known: tuple[str, ...]) -> Problem:
    """The problem of an unknown name, with the nearest known one."""
    known = tuple(map(str, known))
    near = difflib.get_close_matches(str(name), known, 1)
    hint = (f"Did you mean '{near[0]}'? " if near else "") + "Known: " + ", ".join(known[:12]) + (", ..." if len(known) > 12 else "") + "."
    return Problem("UNKNOWN_NAME", where, f"'{name}' is unknown.", name, hint=hint)
