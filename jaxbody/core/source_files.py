"""Files of a user: extension, existence, kind, size and encoding are checked before they are read;
errors of files that cannot be written."""

import math
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from jaxbody.core.errors import JaxbodyError, Problem

OF_RECORDS = 5.0  # bytes of memory for each byte of a file of numbers


def check_file(
    path: Path, largest: float = math.inf, memory: float = OF_RECORDS, option: str = ""
) -> None:
    """Check that a path is a readable regular file, not empty, of at most `largest` bytes.

    A pipe or a device is refused before it is opened, because it might block or never end.

    Args:
        path: path of the file.
        largest: largest size [bytes].
        memory: bytes of memory for each byte of the file.
        option: option of the command that sets the limit; "": none.

    Errors: NO_FILE, IS_DIRECTORY, NOT_A_FILE, EMPTY_FILE, TOO_LARGE."""
    try:
        status = path.stat()
        if stat.S_ISREG(status.st_mode):
            path.open("rb").close()
    except (OSError, ValueError) as error:
        raise JaxbodyError(
            Problem(
                "NO_FILE",
                str(path)[-200:],
                f"cannot be read: {getattr(error, 'strerror', None) or error}",
                path,
                hint="Give the path of a file.",
            )
        ) from None
    if stat.S_ISDIR(status.st_mode):
        raise JaxbodyError(
            Problem(
                "IS_DIRECTORY",
                str(path),
                "is a directory",
                path,
                "a file",
                "Give the path of one file in it.",
            )
        )
    if not stat.S_ISREG(status.st_mode):
        raise JaxbodyError(
            Problem(
                "NOT_A_FILE",
                str(path),
                "is a pipe, a socket or a device",
                path,
                "a regular file",
                "Write its output to a file first.",
            )
        )
    if status.st_size == 0:
        raise JaxbodyError(
            Problem(
                "EMPTY_FILE",
                path.name,
                "has no bytes",
                0,
                "> 0",
                "Was it copied before it was fully written?",
            )
        )
    check_size(path.name, status.st_size, largest, memory=memory, option=option)


def check_size(
    name: str,
    size: float,
    largest: float,
    what: str = "bytes",
    memory: float = OF_RECORDS,
    option: str = "",
) -> None:
    """Check that a file, or its numbers at 8 bytes each, take at most `largest` bytes.

    Args:
        name: name of the file.
        size: size [bytes].
        largest: largest size [bytes].
        what: the unit of the size in the message.
        memory: bytes of memory for each byte of the file.
        option: option of the command that sets the limit; "": none.

    Error: TOO_LARGE."""
    if size > largest:
        setting = f"largest={1.1 * size:.2g}" + (f" ({option} {1.1 * size:.2g})" if option else "")
        raise JaxbodyError(
            Problem(
                "TOO_LARGE",
                name,
                f"has {size:.4g} {what}",
                size,
                f"{largest:.4g} bytes",
                (
                    f"Set {setting} if about {memory * size / 1e9:.2g} GB of memory are "
                    "free, or split the file."
                ),
            )
        )


def extension_of(path: Path, *known: str, hint: str = "") -> str:
    """Return the extension of a path in lower case, such as ".toml", which must be one of `known`.
    Error: UNKNOWN_FORMAT."""
    extension = path.suffix.lower()
    if extension not in known:
        raise JaxbodyError(
            Problem(
                "UNKNOWN_FORMAT",
                path.name,
                f"has the extension '{path.suffix}'",
                path.suffix,
                " ".join(known),
                hint,
            )
        )
    return extension


def decoded(data: bytes, name: str, encoding: str) -> str:
    """Return the text of bytes, without a byte order mark of UTF-8. Errors: ENCODING, with byte and
    offset; WRONG_FORMAT."""
    hint = 'Give encoding="latin-1", or the encoding in which it was written.'
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") and encoding == "utf-8":
        raise JaxbodyError(
            Problem("ENCODING", name, "is UTF-16", data[:2], encoding, 'Give encoding="utf-16".')
        )
    try:
        text = data.decode("utf-8-sig" if encoding == "utf-8" else encoding)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise JaxbodyError(
            Problem(
                "ENCODING",
                name,
                f"has byte 0x{data[error.start]:02x} at offset {error.start} (line {line}), which "
                f"is not {encoding}",
                error.start,
                encoding,
                hint,
            )
        ) from None
    except (LookupError, UnicodeError):
        raise JaxbodyError(
            Problem(
                "ENCODING", name, f"cannot be read as {encoding!r}", encoding, "an encoding", hint
            )
        ) from None
    if "\0" in text:
        raise JaxbodyError(
            Problem(
                "WRONG_FORMAT",
                name,
                f"has a zero byte at offset {text.index(chr(0))}",
                limit="text",
                hint="Is it a text file? If so, give its encoding, else its format.",
            )
        )
    return text


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Provide the path of a new file, which replaces this one at the end of the `with` block.

    Readers always see a complete file; a block that fails or is interrupted leaves nothing."""
    new = path.with_name(f"{path.name}.new")
    try:
        yield new
        new.replace(path)
    finally:
        with suppress(OSError):
            new.unlink()


@contextmanager
def writing(path: Path, hint: str = "Choose another path.") -> Iterator[None]:
    """Run a `with` block that writes a file. Error: NOT_SAVED."""
    try:
        yield
    except OSError as error:
        raise JaxbodyError(
            Problem(
                "NOT_SAVED",
                str(path),
                f"cannot be written: {error.strerror or error}",
                path,
                hint=hint,
            )
        ) from None
