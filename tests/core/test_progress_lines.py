"""Progress lines: shown after five seconds on a terminal or in a notebook, and nowhere else."""

import io
import re
import sys
import time
import types
import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core import progress_lines
from jaxbody.core.errors import warn
from jaxbody.core.progress_lines import Line, working

TIMES = np.linspace(0, 1, 21)


class Screen(io.StringIO):
    """A terminal that records what was written."""

    def isatty(self):
        return True


def at_terminal(monkeypatch):
    """A terminal on which lines appear at once."""
    monkeypatch.setattr(progress_lines, "AFTER", 0.0)
    monkeypatch.setattr(progress_lines, "EVERY", 0.005)
    monkeypatch.setattr(sys, "stderr", Screen())
    return sys.stderr


def until_written(stream, words):
    end = time.monotonic() + 20
    while words not in stream.getvalue() and time.monotonic() < end:
        time.sleep(0.005)
    return stream.getvalue()


def test_the_line_of_a_long_computation_appears_and_is_cleared(monkeypatch):
    terminal = at_terminal(monkeypatch)
    with working("fit") as line:
        line("evaluation 7")
        with working("simulate"):
            until_written(terminal, " s, fit: evaluation 7, simulate")
        line("evaluation 8")
        # as wide as the line that it replaces
        until_written(terminal, " s, fit: evaluation 8" + " " * len(", simulate"))
    written = terminal.getvalue()
    assert (
        re.search(r"\r\d+ s, fit: evaluation 7, simulate\r", written)
        and "evaluation 8" in written
        and "\n" not in written
    )
    assert re.search(r"\r +\r$", written)


def test_a_warning_stands_on_a_line_of_its_own(monkeypatch):
    terminal = at_terminal(monkeypatch)
    with working("fit"), pytest.warns(jb.JaxbodyWarning, match="MISSING"):
        until_written(terminal, " s, fit")
        monkeypatch.setattr(progress_lines, "AFTER", 1e9)  # no further line
        time.sleep(0.05)
        warn("MISSING", "something")
        assert re.search(r"fit\r +\r$", terminal.getvalue())


@pytest.mark.parametrize("progress", [False, True])
def test_progress_is_switched_off_for_inner_computations_too(monkeypatch, progress):
    terminal = at_terminal(monkeypatch)
    with working("tune", progress), working("simulate"):
        time.sleep(0.05)
    assert terminal.getvalue() == ""


def test_nothing_before_five_seconds_and_nothing_without_a_terminal(monkeypatch):
    assert progress_lines.AFTER == 5.0
    monkeypatch.setattr(progress_lines, "EVERY", 0.005)
    for stream, after in ((Screen(), 5.0), (io.StringIO(), 0.0)):
        monkeypatch.setattr(sys, "stderr", stream)
        monkeypatch.setattr(progress_lines, "AFTER", after)
        with working("fit"):
            time.sleep(0.05)
        assert stream.getvalue() == ""


def test_a_notebook_shows_progress_and_an_ipython_shell_only_at_a_terminal(monkeypatch):
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    for shell, stream in (
        (types.SimpleNamespace(kernel=1), sys.stdout),
        (types.SimpleNamespace(), None),
        (None, None),
    ):
        monkeypatch.setitem(
            sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda shell=shell: shell)
        )
        assert progress_lines.screen() is stream


def on_guide():
    spring = jb.Spring(
        ("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0, free_length=1.0, damping=0.3
    )
    body = jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])
    return jb.Model(
        bodies={"mass": body},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
        elements={"spring": spring},
    )


def run():
    x = 1 + 0.1 * np.cos(6 * TIMES) + 1e-3 * np.sin(40 * TIMES)
    initial = jb.State(jnp.array([0.1]), jnp.array([0.0]))
    return {
        "run": jb.Experiment(
            TIMES,
            initial=initial,
            sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
            measured={"x": x},
        )
    }


def stiff(model):
    k = model["spring"].stiffness
    return {"f": (k - 40) ** 2, "g": (k - 20) ** 2}


BOUNDS = {"spring.stiffness": (10.0, 100.0)}
FREE = ["spring.stiffness"]
CALLS = {
    "simulate": (lambda: jb.simulate(on_guide(), TIMES), "simulate"),
    "fit": (lambda: jb.fit(on_guide(), run(), free=FREE), "fit: evaluation 1: cost"),
    "multistart": (
        lambda: jb.fitting.multistart(on_guide(), run(), free=FREE, starts=2),
        "multistart: starts 2 of 2: least cost",
    ),
    "multiple_shooting": (
        lambda: jb.fitting.multiple_shooting(on_guide(), run(), free=FREE, segments=2),
        "multiple shooting: all segments, slack",
    ),
    "interval_coverage": (
        lambda: jb.fitting.interval_coverage(jb.fit(on_guide(), run(), free=FREE), replicates=16),
        "interval_coverage: 16 of 16 replicates",
    ),
    "profile_likelihood": (
        lambda: jb.fitting.profile_likelihood(jb.fit(on_guide(), run(), free=FREE), FREE[0]),
        "profile_likelihood: point 1 below the estimate, tau",
    ),
    "diagnose": (lambda: jb.diagnose(on_guide(), run()), "diagnose: 'run'"),
    "tune": (
        lambda: jb.tune(on_guide(), stiff, free=FREE, minimize="f", bounds=BOUNDS),
        "tune: evaluation 1, f 100",
    ),
    "pareto": (
        lambda: jb.pareto(
            on_guide(), stiff, free=FREE, minimize=["f", "g"], bounds=BOUNDS, points=3
        ),
        "pareto: design 4 of about 5",
    ),
    "sweep": (
        lambda: jb.sweep(on_guide(), stiff, {FREE[0]: [1.0, 2.0, 3.0]}),
        "sweep: 3 of 3 models",
    ),
    "sensitivities": (
        lambda: jb.design.sensitivities(on_guide(), stiff, free=FREE),
        "sensitivities: evaluation 1",
    ),
    "tolerances": (
        lambda: jb.tolerances(on_guide(), stiff, {FREE[0]: 1.0}, samples=5),
        "tolerances: derivatives and 5 samples",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", CALLS)
def test_every_long_computation_reports_its_progress(name, monkeypatch, capsys):
    """The reports to the line are recorded; without a terminal none is printed."""
    reports = []
    make, report = Line.__init__, Line.__call__
    monkeypatch.setattr(
        Line, "__init__", lambda self, name: (reports.append(name), make(self, name))[1]
    )
    monkeypatch.setattr(
        Line,
        "__call__",
        lambda self, progress: (reports.append(f"{self.name}: {progress}"), report(self, progress))[
            1
        ],
    )
    call, words = CALLS[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        call()
    assert any(report.startswith(words) for report in reports), reports
    assert capsys.readouterr() == ("", "")
