"""Progress lines: a computation that takes longer than five seconds reports its progress on a
terminal or in a notebook.

A thread writes the last reports of the outermost computation and of those within it, and clears the
line at the end.
"""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
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
    """The lines of one outermost computation on the screen."""

    def __init__(self, lines: list[Line], screen: TextIO):
        self.lines, self.screen, self.start, self.width = lines, screen, time.monotonic(), 0

    def write(self) -> None:
        elapsed = time.monotonic() - self.start
        if elapsed < AFTER or not self.lines:
            return
        text = f"{elapsed:.0f} s, " + ", ".join(map(str, self.lines))
        text = text[: shutil.get_terminal_size().columns - 1]
        self.screen.write("\r" + text.ljust(self.width))
        self.screen.flush()
        self.width = len(text)

    def clear(self) -> None:
        if self.width:
            self.screen.write("\r" + " " * self.width + "\r")
            self.screen.flush()
            self.width = 0


class _Clock:
    """The thread that writes, asleep while there are no displays."""

    def __init__(self):
        self.lock, self.wake = threading.Lock(), threading.Event()
        self.displays: list[_Display] = []
        self.thread: threading.Thread | None = None

    def add(self, display: _Display) -> None:
        with self.lock:
            self.displays.append(display)
            self.wake.set()
            if self.thread is None or not self.thread.is_alive():
                self.thread = threading.Thread(target=self._run, daemon=True)
                self.thread.start()

    def remove(self, display: _Display) -> None:
        with self.lock:
            self.displays.remove(display)
            display.clear()

    def clear(self) -> None:
        with self.lock:
            for display in self.displays:
                display.clear()

    def _run(self) -> None:
        while True:
            self.wake.wait()
            time.sleep(EVERY)
            with self.lock:
                if self.displays:
                    self.displays[-1].write()
                else:
                    self.wake.clear()


_clock = _Clock()
_local = threading.local()  # the lines of this thread, outermost first


def clear() -> None:
    """Clear the line before other output; it is written again later."""
    _clock.clear()


def screen() -> TextIO | None:
    """stderr of a terminal or stdout of a notebook; None if there is neither."""
    if sys.stderr is not None and sys.stderr.isatty():
        return sys.stderr
    ipython: Any = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return sys.stdout if hasattr(shell, "kernel") else None


@contextmanager
def working(name: str, progress: bool | None = None) -> Iterator[Line]:
    """A progress line for the duration of a `with` block, shown after five seconds where progress
    is None.

    False turns it off; so does True, because reports are then printed on lines of their own."""
    lines = _local.__dict__.setdefault("lines", [])
    line, outermost = Line(name), not lines
    stream = screen() if outermost and progress is None else None
    display = None if stream is None else _Display(lines, stream)
    lines.append(line)
    if display is not None:
        _clock.add(display)
    try:
        yield line
    finally:
        lines.pop()
        if display is not None:
            _clock.remove(display)
