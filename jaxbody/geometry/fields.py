"""What the numbers of a field are, said once, where it stands: unit and domain, in the words of its owner where they depend on it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import numpy as np

from jaxbody.core.arrays import concrete, scalar
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.core.units import KNOWN

DOMAINS = ("any", "nonnegative", "positive", "fraction", "definite", "direction", "rotation", "inertia", "configuration", "speeds")
LIMITS = {  # in words, and the code of the error where the field has none; "symmetric" is what is definite where no sign is asked
    "nonnegative": (">= 0", "NEGATIVE"),
    "positive": ("> 0", "NOT_POSITIVE"),
    "fraction": ("0 to 1", "NOT_A_FRACTION"),
    "definite": (">= 0", "NEGATIVE"),
    "symmetric": ("symmetric", "NOT_SYMMETRIC"),
}


@dataclass(frozen=True)
class Kind:
    """What numbers are: `unit` ("" where they have none; of parts of the last axis by commas, of the axis before it by semicolons), `domain`, and what is
    said of numbers that are not in it, an error's code and a hint."""

    unit: str = ""
    domain: str = "any"
    code: str = ""
    hint: str = ""


def field(unit: str = "", domain: str = "any", *, code: str = "", hint: str = "", words: dict[str, str] | None = None, **options) -> Any:
    """A field of an element, law, joint, load, motion or sensor that says what its numbers are.

    From it follow what `replace` refuses, how `fit` and `tune` move the number, what bounds it may have, and the unit in tables. A field without it has
    no unit and may take any value.

    Args:
        unit: "N/m", or a formula in the words of what holds the owner: "force/argument" of a law is N s/m in a damper, N m/rad about an angle.
        domain: any, nonnegative, positive (a fit moves both by their logarithm, and so keeps their sign), fraction (from 0 to 1), definite (a symmetric
            matrix without negative eigenvalues, or a row of such numbers), direction (a unit vector), rotation (a unit quaternion) or inertia;
            of a state, configuration or speeds (the coordinates of the joints, and their rates);
            "nonnegative unless allow_negative" is any where the owner's `allow_negative` is true.
        code, hint: of the error where a number is not in its domain; NEGATIVE, NOT_POSITIVE or NOT_A_FRACTION without a code.
        words: of a field that holds laws or signals, what their formulas mean here: {"force": "N m", "argument": "rad"}.
        options: of equinox.field: default, converter, static.

    Error: UNKNOWN_DOMAIN.

    >>> class Cubic(jb.laws.Law):
    ...     coefficient: jax.Array = field("force/argument^3", "nonnegative")
    ...     def force(self, x):
    ...         return self.coefficient * x**3
    >>> model = Model(bodies={"mass": Body(mass=1.0)}, joints={"mass": Guide("world", axis=[0, 0, 1])}, elements={
    ...     "spring": SpringDamper(("mass", [0, 0, 0]), ("world", [0, 0, 1]), spring=Cubic(jnp.array(8.0)))})
    >>> replace(model, {"spring.spring.coefficient": -8.0})
    Traceback (most recent call last):
    jaxbody.core.errors.JaxbodyError: replace['spring.spring.coefficient']: is -8 N/m3 (allowed: >= 0). [NEGATIVE]
    """
    if domain.partition(" unless ")[0] not in DOMAINS:
        raise JaxbodyError(Problem("UNKNOWN_DOMAIN", "field.domain", f"is {domain!r}", domain, ", ".join(DOMAINS)))
    return eqx.field(metadata={"kind": Kind(unit, domain, code, hint), "words": words or {}}, **options)


def kind_of(owner: Any, name: str, words: dict[str, str] | None = None) -> Kind:
    """What the numbers of an owner's field are; words: those that what holds the owner gives to it."""
    kind, _ = _said(owner, name)
    domain, _, flag = kind.domain.partition(" unless ")
    if flag and getattr(owner, flag):
        domain = "symmetric" if domain == "definite" else "any"
    return Kind(resolved(kind.unit, owner, words or {}), domain, kind.code, kind.hint)


def kind_along(root: Any, keys: tuple[Any, ...]) -> Kind:
    """What the numbers are to which keys of JAX lead from a root, words being passed on along the way."""
    kind, words, owner = Kind(), {}, root
    for key in keys:
        name = getattr(key, "name", None)
        if isinstance(name, str):
            kind = kind_of(owner, name, words)
            words = {**words, **{word: resolved(text, owner, words) for word, text in _said(owner, name)[1].items()}}
            owner = getattr(owner, name, None)
        else:
            index: Any = getattr(key, "key", getattr(key, "idx", None))
            owner = owner[index] if isinstance(owner, dict | list | tuple) else None
    return kind


def _said(owner: Any, name: str) -> tuple[Kind, dict[str, str]]:
    found = getattr(type(owner), "__dataclass_fields__", {}).get(name)
    metadata = found.metadata if found is not None else {}
    return metadata.get("kind", Kind()), metadata.get("words", {})


def resolved(unit: str, owner: Any, words: dict[str, str]) -> str:
    """A unit without words: those given, those of the owner's class (`words`), or an attribute of the owner that is one itself; "" where one is missing."""
    own = getattr(owner, unit, unit) if unit.isidentifier() else unit
    text, words = own if isinstance(own, str) else unit, {**getattr(owner, "words", {}), **words}
    return "; ".join(", ".join(_reduced(part, words) for part in row.split(",")) for row in text.split(";"))


def _reduced(unit: str, words: dict[str, str]) -> str:
    """A product of units, each once: "N/m" where "force/argument" is "N" over "m"."""
    powers = _powers(unit, words)
    if any(name not in KNOWN for name in powers):
        return ""
    above, below = (" ".join(f"{name}{abs(n) if abs(n) > 1 else ''}" for name, n in powers.items() if n * sign > 0) for sign in (1, -1))
    return f"{above or 1}/{below}" if below else above


def _powers(unit: str, words: dict[str, str]) -> dict[str, int]:
    powers: dict[str, int] = {}
    for sign, part in zip((1, -1), unit.split("/"), strict=False):
        for name, power in re.findall(r"([^\s\d^]+)\^?(\d*)", part):
            for symbol, n in (_powers(words[name], {}) if name in words else {name: 1}).items():
                powers[symbol] = powers.get(symbol, 0) + sign * n * int(power or 1)
    return powers


def units_of(kind: Kind, shape: tuple[int, ...]) -> list[str]:
    """The unit of each number of an array; of a row where the unit is a matrix's, that of its first block; "" where there are not as many as parts."""
    blocks = np.array([[unit.strip() for unit in row.split(",")] for row in kind.unit.split(";")])
    blocks = blocks[:1, :1] if len(blocks) > 1 and len(shape) < 2 else blocks
    last, before = (1, 1, *shape)[-1], (1, 1, *shape)[-2]
    if last % blocks.shape[1] or before % blocks.shape[0]:
        return [""] * int(np.prod(shape))
    whole = np.repeat(np.repeat(blocks, last // blocks.shape[1], 1), before // blocks.shape[0], 0)
    return np.broadcast_to(whole, (*shape[:-2], before, last)).ravel().tolist()


def take(owner: Any, problems: Problems, **values) -> None:
    """Sets fields of an owner that is being made to numbers, each in its domain."""
    for name, value in values.items():
        where = f"{type(owner).__name__}.{name}"
        setattr(owner, name, scalar(value, where, problems))
        if not any(problem.where == where for problem in problems.collected):
            check_domain(getattr(owner, name), kind_of(owner, name), where, problems)


def check_domain(value: Any, kind: Kind, where: str, problems: Problems) -> None:
    """Numbers are in their domain, as far as their signs go. Errors: the field's own, NEGATIVE, NOT_POSITIVE, NOT_A_FRACTION; NOT_SYMMETRIC of a matrix."""
    known = concrete(value)
    if known is None or kind.domain not in LIMITS:
        return
    limit, code = LIMITS[kind.domain]
    if kind.domain in ("definite", "symmetric"):
        _check_definite(known, kind, where, problems)
    elif (bad := {"nonnegative": known < 0, "positive": known <= 0, "fraction": (known < 0) | (known > 1)}[kind.domain]).any():
        worst = float(known[bad].min())
        problems.add(kind.code or code, where, f"is {worst:g} {kind.unit}".rstrip(), value=worst, limit=limit, hint=kind.hint)


def _check_definite(known: np.ndarray, kind: Kind, where: str, problems: Problems) -> None:
    largest, difference = np.abs(known).max(), known - known.T
    if known.ndim == 2 and np.abs(difference).max() > 1e-9 * largest:
        message = f"is not symmetric: largest |K - K'| = {np.abs(difference).max():.3g}"
        hint = "No potential energy belongs to such a matrix; give (K + K')/2 if that is meant."
        problems.add("NOT_SYMMETRIC", where, message, value=difference, limit=f"{1e-9 * largest:.3g}", hint=hint)
        return
    values = known if known.ndim == 1 else np.linalg.eigvalsh(known)
    if kind.domain == "definite" and values.min() < -1e-12 * np.abs(values).max():
        message = f"has {'coefficients' if known.ndim == 1 else 'eigenvalues'} " + ", ".join(f"{v:.6g}" for v in values)
        problems.add(kind.code or "NEGATIVE", where, message, value=values, limit=">= 0", hint=kind.hint)
