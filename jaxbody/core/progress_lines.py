"""Progress lines: a computation that takes longer than five seconds reports its progress on a
terminal or in a notebook.

A thread writes the last reports of the outermost computation and of those within it; the line is
cleared at the end.
"""

import shutil
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, TextIO

AFTER, EVERY = 5.0, 1.0  # s until the first line, and between lines


class Line:
    """The progress of one computation: `line(progress)` replaces its last report."""

    def __init__(self, name: str):
        self.name, self.progress = name, ""

    def __call__(self, progress: str) -> None:
        self.progress = progress

    def __str__(self) -> str:
        return f"{self.name}: {self.progress}" if self.progress else self.name


class _Display:
    """The lines of one outermost computation on the screen, written every second by a thread."""

    def __init__(self, lines: list[Line], screen: TextIO):
        self.lines, self.screen, self.start, self.width = lines, screen, time.monotonic(), 0
        self.ended = threading.Event()

    def run(self) -> None:
        while not self.ended.wait(EVERY):
            with _lock:
                if _displays[-1:] == [self]:
                    self.write()

    def write(self) -> None:
        elapsed = time.monotonic() - self.start
        if elapsed < AFTER or not self.lines:
            return
        text = f"{elapsed:.0f} s, " + ", ".join(map(str, self.lines))
        text = text[: shutil.get_terminal_size().columns - 1]
        self._replace(text.ljust(self.width))
        self.width = len(text)

    def clear(self) -> None:
        if self.width:
            self._replace(" " * self.width + "\r")
            self.width = 0

    def _replace(self, text: str) -> None:
        self.screen.write("\r" + text)
        self.screen.flush()


_displays: list[_Display] = []  # of all threads that compute; the last one is written
_lock = threading.Lock()  # guards the displays and their output
_local = threading.local()  # the lines of this thread, outermost first


def clear() -> None:
    """Clear the line before other output; it is written again later."""
    with _lock:
        for display in _displays:
            display.clear()


def screen() -> TextIO | None:
    """Return stderr of a terminal or stdout of a notebook; None if there is neither."""
    if sys.stderr is not None and sys.stderr.isatty():
        return sys.stderr
    ipython: Any = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return sys.stdout if hasattr(shell, "kernel") else None


@contextmanager
def working(name: str, progress: bool | None = None) -> Iterator[Line]:
    """Show a progress line during a `with` block, after five seconds, if `progress` is None.

    False turns it off; so does True, because reports are then printed on lines of their own."""
    lines = _local.__dict__.setdefault("lines", [])
    stream = None if lines or progress is not None else screen()
    line = Line(name)
    lines.append(line)
    try:
        with nullcontext() if stream is None else _shown(_Display(lines, stream)):
            yield line
    finally:
        lines.pop()


@contextmanager
def _shown(display: _Display) -> Iterator[None]:
    with _lock:
        _displays.append(display)
    threading.Thread(target=display.run, daemon=True).start()
    try:
        yield
    finally:
        display.ended.set()
        with _lock:
            _displays.remove(display)
            display.clear()
