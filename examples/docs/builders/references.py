"""Pages of the reference: one for every public name, in the order of the packages, from docstrings
and fields."""

import dataclasses
import inspect
import re
import textwrap
from pathlib import Path
from typing import Any

import jaxbody as jb
from jaxbody.core.codes import CODES
from jaxbody.geometry.fields import Kind

from .docstrings import _prose, to_rst

# with their purposes, from the ground up
PACKAGES = re.findall(r"^    (\w+) +(\S.*)$", jb.__doc__ or "", re.M)
FAMILIES = (
    "Element",
    "joints.Joint",
    "sensors.Sensor",
    "inputs.Load",
    "inputs.Motion",
    "closures.Closure",
    "signals.Signal",
    "laws.Law",
    "control.ControlLaw",
)  # members share methods
# public modules, with their packages
OPEN = {name: module.split(".")[0] for name, module in jb._MODULES.items()}


def public_names() -> dict[str, list[str]]:
    """The public names of each package as they follow `jb.`, those of open modules with the name of
    the module."""
    names: dict[str, list[str]] = {package: [] for package, _ in PACKAGES}
    for module, public in jb._NAMES.items():
        names[module.split(".")[0]] += public
    for module, package in OPEN.items():
        inside = getattr(jb, module)
        names[package] += [
            f"{module}.{name}"
            for name in dir(inside)
            if getattr(inside, name) is not getattr(jb, name, None)
        ]
    return {package: sorted(found, key=str.lower) for package, found in names.items() if found}


EVERY = [name for names in public_names().values() for name in names]
TWINS = {name for name in EVERY if name != name.lower() and name.lower() in EVERY}


def place(name: str) -> str:
    """The name of the page of a name: on some machines Fit.html and fit.html are one file."""
    return f"{name}_class" if name in TWINS else name


def thing(name: str) -> Any:
    found = jb
    for part in name.split("."):
        found = getattr(found, part)
    return found


def result_of(name: str) -> type | None:
    """The class of the result of a function, where it is no public name itself."""
    found = inspect.unwrap(thing(name))
    if inspect.isclass(found):
        return None
    kind = inspect.get_annotations(found, eval_str=True).get("return")
    ours = inspect.isclass(kind) and kind.__module__.startswith("jaxbody")
    return kind if ours and kind not in map(thing, EVERY) else None


def _title(text: str) -> list[str]:
    """The title of a page without a table of contents, which leaves room for code."""
    return [":hide-toc:", "", text, "=" * len(text), ""]


def page(name: str, described: set[type]) -> str:
    """The page of a name, as reStructuredText; the class of a result is described on the first page
    whose function returns it."""
    found, full = thing(name), f"jaxbody.{name}"
    lines = _title(name)
    if inspect.isclass(found):
        *_, first = (other for other in EVERY if thing(other) is found)
        if name != first:  # a second public name, as forces.ControlLaw is of control.ControlLaw
            return "\n".join(
                [
                    *lines,
                    f"It is :py:class:`{first} <jaxbody.{first}>`:",
                    "",
                    f".. autoclass:: {full}",
                    "   :no-index:",
                    "",
                ]
            )
        lines += [f".. autoclass:: {full}", "", *_members(found, full)]
        return "\n".join(lines)
    lines += [f".. autofunction:: {full}", ""]
    kind = result_of(name)
    if kind and kind not in described:
        described.add(kind)
        title, where = f"Result: {kind.__name__}", f"{kind.__module__}.{kind.__name__}"
        lines += [
            title,
            "-" * len(title),
            "",
            f".. autoclass:: {where}",
            "   :no-index-entry:",
            "",
            *_members(kind, where),
        ]
    elif kind:
        lines += [f"The result is a :py:class:`~{kind.__module__}.{kind.__name__}`.", ""]
    return "\n".join(lines)


def _members(kind: type, where: str) -> list[str]:
    """A table of the fields, then properties and methods with their docstrings; those of
    jaxbody alone."""
    lines = _fields(kind)
    own = [base for base in kind.__mro__ if base.__module__.startswith("jaxbody")]
    family = next(
        (name for name in FAMILIES if issubclass(kind, thing(name)) and kind is not thing(name)),
        None,
    )
    if family:
        own, inherited = own[:1], {name for base in own[1:] for name in vars(base)}
        lines += [f"Its methods are those of :py:class:`{family} <jaxbody.{family}>`.", ""]
    else:
        inherited = set()
    hidden = inherited | {
        name
        for base in kind.__mro__
        for name, x in vars(base).items()
        if name.startswith("_") or x is None
    }
    names = [
        name
        for base in own
        for name, x in vars(base).items()
        if name not in hidden and _is_member(kind, name, x)
    ]
    for name in sorted(set(names), key=names.index):
        found = inspect.getattr_static(kind, name)
        lines += (
            _property(where, name, found)
            if isinstance(found, property)
            else [f".. automethod:: {where}.{name}", "   :no-index-entry:", ""]
        )
    return lines


def _property(where: str, name: str, found: property) -> list[str]:
    """A property with the type as it is written in the code."""
    module, _, owner = where.rpartition(".")
    kind = getattr(found.fget, "__annotations__", {}).get("return", "")
    options = [
        f"   :module: {module}",
        *([f"   :type: {written(kind)}"] if kind else []),
        "   :no-index-entry:",
    ]
    text = to_rst(inspect.cleandoc(found.__doc__ or ""))
    return [
        f".. py:property:: {owner}.{name}",
        *options,
        "",
        *(f"   {line}" if line else "" for line in text),
        "",
    ]


def _is_member(kind: type, name: str, found: Any) -> bool:
    function = found.fget if isinstance(found, property) else getattr(found, "__func__", found)
    return bool(inspect.getdoc(inspect.getattr_static(kind, name))) and (
        callable(function) and not inspect.isclass(function)
    )


def _fields(kind: type) -> list[str]:
    """The fields of a class: kind and shape, unit, allowed values."""
    found = [
        each
        for each in (dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ())
        if not each.name.startswith("_")
    ]
    if not found:
        return []
    kinds = [each.metadata.get("kind", Kind()) for each in found]
    stated = any(each.unit or each.domain != "any" for each in kinds)
    lines = [
        "**Fields**",
        "",
        ".. list-table::",
        "   :header-rows: 1",
        "",
        "   * - field",
        "     - kind and shape",
    ]
    lines += ["     - unit", "     - allowed"] if stated else []
    for each, about in zip(found, kinds, strict=True):
        lines += [f"   * - ``{each.name}``", f"     - {_shape(each.type)}"]
        lines += (
            [
                f"     - {_prose(about.unit)}",
                f"     - {_prose('' if about.domain == 'any' else about.domain)}",
            ]
            if stated
            else []
        )
    return [*lines, ""]


KINDS = {"Float": "real", "Int": "integer", "Bool": "boolean", "Complex": "complex"}


def _shape(annotation: Any) -> str:
    """Kind and shape in words; a type that is no array as code."""
    text = written(annotation)
    found = re.fullmatch(r"(\w+)\[Array, ['\"]([^'\"]*)['\"]\]( \| None)?", text)
    if not found:
        return f"``{text}``"
    shape = _prose(f"({', '.join(found[2].split())})") if found[2] else "number"
    return f"{KINDS.get(found[1], found[1].lower())} {shape}{' or None' if found[3] else ''}"


def written(annotation: Any) -> str:
    """An annotation as the code writes it."""
    return (
        annotation
        if isinstance(annotation, str)
        else short_types(inspect.formatannotation(annotation))
    )


def short_types(text: str) -> str:
    """Types of a signature by their short names; an array that may be of JAX or of NumPy once."""
    text = text.replace("~", "")
    text = re.sub(
        r"\b(?:jaxbody|jaxtyping|jaxlib|jax|numpy|np|typing|diffrax)\.(?:\w+\.)*(?=\w)", "", text
    )
    text = text.replace("Array | ndarray", "Array")
    array = r"(\w+\[Array, (['\"].*?['\"])\])"
    text = re.sub(rf"{array}(?:,| \|) \w+\[ndarray, \2\]", r"\1", text)
    return re.sub(
        rf"Union\[{array}(, NoneType)?\]",
        lambda found: found[1] + " | None" * bool(found[3]),
        text,
    )


def first_sentence(text: str | None) -> str:
    paragraph = " ".join((text or "").split("\n\n")[0].split())
    return re.split(r"(?<=[a-z)\]`\"'])[.:;] ", paragraph + " ")[0].rstrip(" .:;")


def package_page(package: str, purpose: str, names: list[str]) -> str:
    lines = [*_title(package), _prose(purpose), "", ".. list-table::", "   :widths: 25 75", ""]
    for name in names:
        lines += [
            f"   * - :doc:`{name} <{place(name)}>`",
            f"     - {_prose(first_sentence(inspect.getdoc(thing(name))))}",
        ]
    return "\n".join(
        [
            *lines,
            "",
            ".. toctree::",
            "   :hidden:",
            "",
            *(f"   {place(name)}" for name in names),
            "",
        ]
    )


def codes_page() -> str:
    """The table of error codes, each with an anchor."""
    lines = [
        *_title("Error codes"),
        *to_rst(CODES_TEXT),
        ".. list-table::",
        "   :header-rows: 1",
        "   :widths: 26 37 37",
        "",
    ]
    lines += ["   * - code", "     - what it means", "     - what to do"]
    for code, (meaning, remedy) in CODES.items():
        lines += [
            f"   * - .. _code-{code.lower()}:",
            "",
            f"       ``{code}``",
            f"     - {_prose(meaning)}",
            f"     - {_prose(remedy)}",
        ]
    return "\n".join([*lines, ""])


CODES_TEXT = textwrap.dedent("""\
    Errors are raised as `JaxbodyError`, warnings are `JaxbodyWarning`; both state the object, the value, the limit and a remedy, and have a
    `code`. An error lists all problems of an input at once, in `problems`. A computation returns its `Status` in `status`, one for each
    member of a batch; it warns where the status is not OK, and `raise_if_failed()` turns that into an error.

    `print(jb.error_codes())` prints this table.
    """)  # noqa: E501


def signatures_page() -> str:
    """Return the table of all public signatures, names of arguments with their defaults."""
    lines = [*_title("Signatures"), *to_rst(SIGNATURES_TEXT)]
    for package, names in public_names().items():
        lines += [package, "-" * len(package), ""]
        lines += [f"- ``{signature_of(name)}``" for name in names] + [""]
    return "\n".join(lines)


def signature_of(name: str) -> str:
    """Return a name with its arguments and their defaults, without types."""
    signature = inspect.signature(thing(name))
    plain = [
        each.replace(annotation=inspect.Parameter.empty) for each in signature.parameters.values()
    ]
    text = str(signature.replace(parameters=plain, return_annotation=inspect.Signature.empty))
    return " ".join(f"{name}{text}".replace("<factory>", "...").split())


SIGNATURES_TEXT = """\
All public names with their arguments; those after a star are given by name.

"""


def pages() -> dict[str, str]:
    """All pages of the reference by path."""
    names, described = public_names(), set()
    found = {
        f"reference/{place(name)}.rst": page(name, described)
        for package in names.values()
        for name in package
    }
    purposes = dict(PACKAGES)
    for package, inside in names.items():
        found[f"reference/{package}_package.rst"] = package_page(package, purposes[package], inside)
    listing = [f"   reference/{package}_package" for package in names]
    table: list[str] = []
    for package in names:
        table += [
            f"   * - :doc:`{package} <reference/{package}_package>`",
            f"     - {_prose(purposes[package])}",
        ]
    found["reference.rst"] = "\n".join(
        [
            *_title("Reference"),
            *to_rst(REFERENCE_TEXT),
            ".. list-table::",
            "   :widths: 20 80",
            "",
            *table,
            "",
            ".. toctree::",
            "   :hidden:",
            "",
            *listing,
            "",
        ]
    )
    found["codes.rst"] = codes_page()
    found["signatures.rst"] = signatures_page()
    return found


REFERENCE_TEXT = textwrap.dedent("""\
    Every public name, by package, from the ground up: a package uses only those above it. `import jaxbody as jb` has what a first script
    needs; families of names stand in modules, as in `jb.laws.Linear` and `jb.sensors.Gyro`. [All signatures](signatures) are one table.

    Numbers are in SI units and radians, frequencies in hertz, vectors in world axes unless stated otherwise. Shapes stand in signatures
    and tables: `Float[Array, "nt 3"]` is an array of real numbers with nt rows of three. Letters of shapes are

    - nq, nv, nz: coordinates, speeds and states of elements of a model
    - nxi: six components for each support
    - ne: elements
    - nt: sample times
    - nf: frequencies
    - n, m, k: counts that the text explains
    """)  # noqa: E501


def write(folder: Path, found: dict[str, str]) -> None:
    """Write pages that changed and delete those that no longer exist, so that a second build reads
    only what is new."""
    for path in folder.rglob("*"):
        if path.is_file() and str(path.relative_to(folder)) not in found:
            path.unlink()
    for name, text in found.items():
        path = folder / name
        if not path.exists() or path.read_text() != text:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
