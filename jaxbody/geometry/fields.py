"""Fields whose unit and domain are stated once, in the class; a unit may be a formula of words
whose units the owner defines. Laws, elements, bodies and other objects that consist of numbers are
printed as the class, and each field with its numbers and unit."""

import re
from dataclasses import dataclass, fields
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import concrete, nan_unless, scalar
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.core.jax_internals import Tracer
from jaxbody.core.units import KNOWN

ROWS = ("increasing", "rising")
DOMAINS = (
    "any",
    "nonnegative",
    "positive",
    "fraction",
    "definite",
    "direction",
    "rotation",
    "inertia",
    *ROWS,
    "configuration",
    "speeds",
)
# limit as text and default code of the error of each domain; "symmetric" is "definite" without a
# condition on signs
LIMITS = {
    "nonnegative": (">= 0", "NEGATIVE"),
    "positive": ("> 0", "NOT_POSITIVE"),
    "fraction": ("0 to 1", "NOT_A_FRACTION"),
    "increasing": ("more than the number before", "TABLE_UNSORTED"),
    "rising": ("not less than the number before", "TABLE_FALLS"),
    "definite": (">= 0", "NEGATIVE"),
    "symmetric": ("symmetric", "NOT_SYMMETRIC"),
}


@dataclass(frozen=True)
class Kind:
    """The kind of the numbers of a field: `unit`, `domain`, and `code` and `hint` of the error for
    numbers outside the domain.

    The unit is "" where there is none; commas separate the units of parts of the last axis,
    semicolons those of the axis before it."""

    unit: str = ""
    domain: str = "any"
    code: str = ""
    hint: str = ""


def field(
    unit: str = "",
    domain: str = "any",
    *,
    code: str = "",
    hint: str = "",
    words: dict[str, str] | None = None,
    **options,
) -> Any:
    """Define a field of an element, law, joint, load, motion or sensor, with the unit and domain of
    its numbers.

    These determine the values that `replace` refuses, the variable that `fit` and `tune` use for
    the number, its possible bounds, and its unit in tables. A field without them has no unit and
    may have any value.

    Args:
        unit: such as "N/m", or a formula in words of the object that holds the owner:
            "force/argument" of a law is N s/m in a damper and N m/rad in a spring about an angle
        domain: any, nonnegative, positive (for both a fit uses the logarithm, which keeps the
            sign), fraction (from 0 to 1), definite (a symmetric matrix without negative
            eigenvalues, or a row of such numbers), direction (a unit vector), rotation (a unit
            quaternion) or inertia; for a row of numbers, increasing or rising (not falling; a fit
            uses the logarithms of its steps); for a state, configuration or speeds (the coordinates
            of the joints, and their rates); "nonnegative unless allow_negative" is any where the
            owner's `allow_negative` is true
        code, hint: code and hint of the error for a number outside its domain; default code:
            NEGATIVE, NOT_POSITIVE or NOT_A_FRACTION
        words: for a field that holds laws or signals, the words of their formulas: {"force": "N m",
            "argument": "rad"}
        options: options of equinox.field: default, converter, static

    Error: UNKNOWN_DOMAIN.

    >>> class Cubic(jb.laws.Law):
    ...     coefficient: jax.Array = jb.field("force/argument^3", "nonnegative")
    ...     def force(self, x):
    ...         return self.coefficient * x**3
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0)},
    ...     joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
    ...     elements={
    ...         "spring": jb.SpringDamper(
    ...             ("mass", [0, 0, 0]), ("world", [0, 0, 1]), spring=Cubic(jnp.array(8.0))
    ...         )
    ...     },
    ... )
    >>> jb.replace(model, {"spring.spring.coefficient": -8.0})  # doctest: +NORMALIZE_WHITESPACE
    Traceback (most recent call last):
    jaxbody.core.errors.JaxbodyError: replace['spring.spring.coefficient']: is -8 N/m3
    (allowed: >= 0). [NEGATIVE]
    """
    if domain.partition(" unless ")[0] not in DOMAINS:
        raise JaxbodyError(
            Problem("UNKNOWN_DOMAIN", "field.domain", f"is {domain!r}", domain, ", ".join(DOMAINS))
        )
    return eqx.field(
        metadata={"kind": Kind(unit, domain, code, hint), "words": words or {}}, **options
    )


def kind_of(owner: Any, name: str, words: dict[str, str] | None = None) -> Kind:
    """Return the kind of the field `name` of `owner`; `words`: {word: unit} for formulas of units,
    from the object that contains the owner."""
    kind, _ = _stated(owner, name)
    domain, _, flag = kind.domain.partition(" unless ")
    if flag and getattr(owner, flag):
        domain = "symmetric" if domain == "definite" else "any"
    return Kind(resolved(kind.unit, owner, words or {}), domain, kind.code, kind.hint)


def words_for(owner: Any, name: str, words: dict[str, str]) -> dict[str, str]:
    """Return {word: unit} for the object in the field `name` of `owner`: the words that apply to
    the owner, and those that the field defines."""
    return {
        **words,
        **{word: resolved(text, owner, words) for word, text in _stated(owner, name)[1].items()},
    }


def kind_along(root: Any, keys: tuple[Any, ...]) -> Kind:
    """Return the kind of the numbers at a path of JAX keys from a root, with the words from all
    objects on the path."""
    return _along(root, keys)[0]


def words_along(root: Any, keys: tuple[Any, ...]) -> dict[str, str]:
    """Return {word: unit} for the words that formulas of units may contain, such as "force", in the
    object at a path of JAX keys from a root."""
    return _along(root, keys)[1]


def _along(root: Any, keys: tuple[Any, ...]) -> tuple[Kind, dict[str, str]]:
    kind, words, owner = Kind(), {}, root
    for key in keys:
        name = getattr(key, "name", None)
        if isinstance(name, str):
            kind = kind_of(owner, name, words)
            words = words_for(owner, name, words)
            owner = getattr(owner, name, None)
        else:
            index: Any = getattr(key, "key", getattr(key, "idx", None))
            owner = owner[index] if isinstance(owner, dict | list | tuple) else None
    return kind, words


def _stated(owner: Any, name: str) -> tuple[Kind, dict[str, str]]:
    stated = getattr(type(owner), "__dataclass_fields__", {}).get(name)
    metadata = stated.metadata if stated is not None else {}
    return metadata.get("kind", Kind()), metadata.get("words", {})


def resolved(unit: str, owner: Any, words: dict[str, str]) -> str:
    """Return a unit with its words replaced: by the given words, by the `words` of the owner's
    class, or by an attribute of the owner that is a unit; "" if a word is missing."""
    own = getattr(owner, unit, unit) if unit.isidentifier() else unit
    text, words = own if isinstance(own, str) else unit, {**getattr(owner, "words", {}), **words}
    return "; ".join(
        ", ".join(_reduced(part, words) for part in row.split(",")) for row in text.split(";")
    )


def _reduced(unit: str, words: dict[str, str]) -> str:
    """Return a product of units with each unit once: "N/m" for "force/argument" with force in N and
    argument in m."""
    powers = _powers(unit, words)
    if any(name not in KNOWN for name in powers):
        return ""
    above, below = (
        " ".join(
            f"{name}{abs(n) if abs(n) > 1 else ''}" for name, n in powers.items() if n * sign > 0
        )
        for sign in (1, -1)
    )
    return f"{above or 1}/{below}" if below else above


def _powers(unit: str, words: dict[str, str]) -> dict[str, int]:
    powers: dict[str, int] = {}
    for sign, part in zip((1, -1), unit.split("/"), strict=False):
        for name, power in re.findall(r"([^\s\d^]+)\^?(\d*)", part):
            for symbol, n in (_powers(words[name], {}) if name in words else {name: 1}).items():
                powers[symbol] = powers.get(symbol, 0) + sign * n * int(power or 1)
    return powers


def units_of(kind: Kind, shape: tuple[int, ...]) -> list[str]:
    """Return the unit of each number of an array.

    If the units are those of a matrix, a row has the first of them. The units are "" if the shape
    cannot be divided into one part per unit."""
    blocks = np.array([[unit.strip() for unit in row.split(",")] for row in kind.unit.split(";")])
    blocks = blocks[:1, :1] if len(blocks) > 1 and len(shape) < 2 else blocks
    last, before = (1, 1, *shape)[-1], (1, 1, *shape)[-2]
    if last % blocks.shape[1] or before % blocks.shape[0]:
        return [""] * int(np.prod(shape))
    whole = np.repeat(np.repeat(blocks, last // blocks.shape[1], 1), before // blocks.shape[0], 0)
    return np.broadcast_to(whole, (*shape[:-2], before, last)).ravel().tolist()


def take(owner: Any, problems: Problems | None = None, **values) -> None:
    """Set fields of an object in its constructor, and check their domains. Errors are added to
    `problems`, or raised if it is None."""
    collector = Problems() if problems is None else problems
    for name, value in values.items():
        where = f"{type(owner).__name__}.{name}"
        number = scalar(value, where, collector)
        if not any(problem.where == where for problem in collector.collected):
            number = in_domain(number, kind_of(owner, name), where, collector)
        setattr(owner, name, number)
    if problems is None:
        collector.raise_if_any()


def in_domain(value: Any, kind: Kind, where: str, problems: Problems) -> Any:
    """Return the value after a check of its signs and symmetry; a traced value has NaN in place of
    numbers outside of the domain.

    Errors: that of the field, or NEGATIVE, NOT_POSITIVE, NOT_A_FRACTION; NOT_SYMMETRIC for a
    matrix."""
    known = concrete(value)
    if known is None:
        return nan_outside(value, kind.domain, value.ndim)
    if kind.domain in ("definite", "symmetric"):
        _check_definite(known, kind, where, problems)
    elif kind.domain in LIMITS:
        _check_signs(known, kind, where, problems)
    return value


def nan_outside(value: jax.Array, domain: str, rank: int, scale: Any = 0.0) -> jax.Array:
    """Return traced numbers with NaN where they are not in the domain; the last `rank` axes are one
    value. Results computed from them are NaN and have a status, as no error can be raised. An
    inertia is compared with its trace and `scale` [kg m2]."""
    limited = (domain in LIMITS and (domain != "symmetric" or rank == 2)) or domain == "inertia"
    return nan_unless(_inside(value, domain, rank, scale), value) if limited else value


def _inside(x: jax.Array, domain: str, rank: int, scale: Any) -> Any:
    small = max(1e-9, 64 * float(jnp.finfo(x.dtype).eps))
    if domain == "inertia":
        x, scale = jax.lax.stop_gradient((x, scale))
        moments = jnp.linalg.eigvalsh(x)
        excess = moments[..., 2] - moments[..., 0] - moments[..., 1]
        return (excess <= small * (jnp.abs(moments.sum(-1)) + scale))[..., None, None]
    if domain in ROWS:
        steps = jnp.diff(x)
        return (steps > 0 if domain == "increasing" else steps >= 0).all(-1, keepdims=True)
    if domain == "definite" and rank < 2:
        return x >= -1e-3 * small * jnp.abs(x).max(-1, keepdims=True)
    if domain in ("definite", "symmetric") and rank == 2:
        x = jax.lax.stop_gradient(x)
        largest = jnp.abs(x).max((-2, -1), keepdims=True)
        symmetric = (jnp.abs(x - jnp.swapaxes(x, -1, -2)) <= small * largest).all(
            (-2, -1), keepdims=True
        )
        return (
            symmetric
            if domain == "symmetric"
            else symmetric & (jnp.linalg.eigvalsh(x)[..., :1, None] >= -1e-3 * small * largest)
        )
    if domain == "fraction":
        return (x >= 0) & (x <= 1)
    return x > 0 if domain == "positive" else x >= 0


def _check_signs(known: np.ndarray, kind: Kind, where: str, problems: Problems) -> None:
    limit, code = LIMITS[kind.domain]
    x, dx = (known[..., 1:], np.diff(known)) if kind.domain in ROWS else (known, known)
    bad = {
        "nonnegative": x < 0,
        "positive": x <= 0,
        "fraction": (x < 0) | (x > 1),
        "increasing": dx <= 0,
        "rising": dx < 0,
    }[kind.domain]
    if bad.any():
        worst = float(x[bad].min())
        problems.add(
            kind.code or code,
            where,
            f"is {worst:g} {kind.unit}".rstrip(),
            value=worst,
            limit=limit,
            hint=kind.hint,
        )


def _check_definite(known: np.ndarray, kind: Kind, where: str, problems: Problems) -> None:
    largest, difference = np.abs(known).max(), known - known.T
    if known.ndim == 2 and np.abs(difference).max() > 1e-9 * largest:
        problems.add(
            "NOT_SYMMETRIC",
            where,
            f"is not symmetric: largest |K - K'| = {np.abs(difference).max():.3g}",
            value=difference,
            limit=f"{1e-9 * largest:.3g}",
            hint="Such a matrix has no potential energy; give (K + K')/2 if you mean its "
            "symmetric part.",
        )
        return
    values = known if known.ndim == 1 else np.linalg.eigvalsh(known)
    if kind.domain == "definite" and values.min() < -1e-12 * np.abs(values).max():
        message = f"has {'coefficients' if known.ndim == 1 else 'eigenvalues'} " + ", ".join(
            f"{v:.6g}" for v in values
        )
        problems.add(
            kind.code or "NEGATIVE", where, message, value=values, limit=">= 0", hint=kind.hint
        )


MOST_NUMBERS = 7  # most numbers printed of a row; of a longer row the range is printed
# longest text printed for another object, such as a network [characters]; in place of a longer one
# the count of its numbers is printed
LONGEST = 80
MATRICES = ("definite", "symmetric", "inertia")


class Described:
    """An object that prints with the numbers and units of its fields: Stop(gap=0.06 m,
    stiffness=200000 N/m, engagement=0.01 m).

    A unit is left out where it depends on an unknown owner: a linear law may be that of a spring or
    of a damper."""

    def __init_subclass__(cls, init: bool = True, **options: Any) -> None:
        """`init=False` tells type checkers that a class has the constructor of its base class."""
        super().__init_subclass__(**options)

    def __repr__(self) -> str:
        return self._described({})

    def _described(self, words: dict[str, str]) -> str:
        """Return the text. `words`: {word: unit} for formulas of units such as "force/argument",
        from the object that contains this one."""
        # `self` is a dataclass derived from this class
        of_class = fields(self)  # pyright: ignore[reportArgumentType]
        values = {each.name: (getattr(self, each.name, None), each.default) for each in of_class}
        shown = {
            name: text_of(self, name, words)
            for name, (value, default) in values.items()
            if value is not None and value is not default
        }
        alone = len(values) == 1
        return (
            f"{type(self).__name__}("
            f"{', '.join(text if alone else f'{name}={text}' for name, text in shown.items())})"
        )


def text_of(owner: Any, name: str, words: dict[str, str] | None = None) -> str:
    """Return a field of an object as text: numbers with their unit, or the description of a law or
    signal.

    >>> text_of(
    ...     jb.SpringDamper(
    ...         ("mass", [0, 0, 0]), ("world", [0, 0, 1]), spring=20e3, free_length=0.9
    ...     ),
    ...     "spring",
    ... )
    'Linear(20000 N/m)'
    """
    value, words = getattr(owner, name), words or {}
    if isinstance(value, Described):
        return value._described(words_for(owner, name, words))
    if isinstance(value, Tracer):
        return "traced"
    if not isinstance(getattr(value, "shape", None), tuple):
        shown = getattr(value, "__name__", repr(value)) if callable(value) else repr(value)
        if len(shown) <= LONGEST:
            return shown
        count = sum(np.size(x) for x in jax.tree.leaves(value) if hasattr(x, "shape"))
        return f"{type(value).__name__}({tables.counted(count, 'number')})"
    kind, array = kind_of(owner, name, words), np.asarray(value)
    units = units_of(kind, array.shape)
    if (
        kind.domain in MATRICES
        and array.ndim == 2
        and not np.any(array - np.diag(np.diagonal(array)))
    ):
        return f"diag{_row(np.diagonal(array), np.reshape(units, array.shape).diagonal().tolist())}"
    if array.ndim > 1:
        return tables.number(array)
    return _row(array, units) if array.ndim else f"{tables.number(array)} {units[0]}".rstrip()


def _row(numbers: np.ndarray, units: list[str]) -> str:
    """Return a row as text: [1 2 3] m, [1 N/m, 2 N/m2], or [200 numbers from 0 to 1] m."""
    if len(set(units)) > 1:
        values = [f"{tables.number(x)} {unit}" for x, unit in zip(numbers, units, strict=True)]
        return f"[{', '.join(values)}]"
    ends = (
        f"{numbers.size} numbers from {tables.number(numbers.min(initial=np.inf))} to "
        f"{tables.number(numbers.max(initial=-np.inf))}"
    )
    return (
        f"[{tables.number(numbers) if numbers.size <= MOST_NUMBERS else ends}] "
        f"{units[0] if units else ''}"
    ).rstrip()
