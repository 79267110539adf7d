"""Progress lines: what takes longer than five seconds says how far it is, on a terminal or in a notebook, unless switched off.

A thread writes what the outermost computation and those within it said last; when it ends, the line goes. Without a terminal or a notebook nothing is written.
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
    """What a computation says of itself: `line(words)` replaces what it said before."""

    def __init__(self, what: str):
        self.what, self.words = what, ""

    def __call__(self, words: str) -> None:
        self.words = words

    def __str__(self) -> str:
        return f"{self.what}: {self.words}" if self.words else self.what


class _Shown:
    """The lines of one outermost computation, on the screen."""

    def __init__(self, lines: list[Line], screen: TextIO):
        self.lines, self.screen, self.begun, self.width = lines, screen, time.monotonic(), 0

    def write(self) -> None:
        lasted = time.monotonic() - self.begun
        if lasted < AFTER or not self.lines:
            return
        text = f"{lasted:.0f} s, " + ", ".join(map(str, self.lines))
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
    """The thread that writes, asleep while nothing is shown."""

    def __init__(self):
        self.lock, self.wake = threading.Lock(), threading.Event()
        self.shown: list[_Shown] = []
        self.thread: threading.Thread | None = None

    def add(self, one: _Shown) -> None:
        with self.lock:
            self.shown.append(one)
            self.wake.set()
            if self.thread is None or not self.thread.is_alive():
                self.thread = threading.Thread(target=self._run, daemon=True)
                self.thread.start()

    def remove(self, one: _Shown) -> None:
        with self.lock:
            self.shown.remove(one)
            one.clear()

    def clear(self) -> None:
        with self.lock:
            for one in self.shown:
                one.clear()

    def _run(self) -> None:
        while True:
            self.wake.wait()
            time.sleep(EVERY)
            with self.lock:
                if self.shown:
                    self.shown[-1].write()
                else:
                    self.wake.clear()


_clock = _Clock()
_mine = threading.local()  # the lines of this thread, outermost first


def clear() -> None:
    """Take the line away, for what else is printed now; the next one comes by itself."""
    _clock.clear()


def screen() -> TextIO | None:
    """A terminal's stderr, or a notebook's stdout; None where there is neither."""
    if sys.stderr is not None and sys.stderr.isatty():
        return sys.stderr
    ipython: Any = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return sys.stdout if hasattr(shell, "kernel") else None


@contextmanager
def working(what: str, progress: bool | None = None) -> Iterator[Line]:
    """A line for as long as this lasts. progress: None shows it after five seconds; False does not, nor does True, which asks for a report that stays."""
    lines = _mine.__dict__.setdefault("lines", [])
    line, outermost = Line(what), not lines
    seen = screen() if outermost and progress is None else None
    one = None if seen is None else _Shown(lines, seen)
    lines.append(line)
    if one is not None:
        _clock.add(one)
    try:
        yield line
    finally:
        lines.pop()
        if one is not None:
            _clock.remove(one)
