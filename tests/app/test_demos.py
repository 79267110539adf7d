"""The command `jaxbody demo`: its printed numbers are those of closed forms and of the engine in
its file, and the browser opens with --open."""

import re
import webbrowser

import numpy as np
import pytest

from jaxbody.app import commands


@pytest.mark.long
def test_the_demo_finds_the_engine_of_its_file_and_shows_the_report(tmp_path, capsys, monkeypatch):
    """The engine bounces at sqrt(sum of k/m), as the stiffnesses have nearly no moment about its
    center of mass; the fit finds the mass and the strut of the file."""
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    assert commands.main(["demo", "--open", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    bounce = float(re.search(r"5 +(\S+) .*bounce", said)[1])
    assert abs(bounce / (np.sqrt(1050e3 / 180) / (2 * np.pi)) - 1) < 1e-3
    rows = re.findall(r"^  (engine.mass|strut.spring\S+) +\S+ +(\S+) +(\S+) +\S+ +\S+$", said, re.M)
    assert [float(truth) for _, truth, _ in rows] == [180, 250e3]
    assert all(abs(float(estimate) / float(truth) - 1) < 0.01 for _, truth, estimate in rows)
    lowest = float(re.search(r"lowest +\S+ +(\S+) +Hz +>= 6", said)[1])
    assert lowest > 6 - 1e-6
    page = tmp_path / "engine.html"
    assert opened == [page.as_uri()] and page.read_text().count("<h2") >= 7
