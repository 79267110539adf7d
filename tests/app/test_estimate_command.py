"""The command `estimate`: responses and modes from the records of a test."""

import shlex
import subprocess
import sys

import numpy as np
import pytest
from scipy.signal import lfilter

import jaxbody as jb
from jaxbody.app import commands

RATE = 128.0
MODES = ((5.0, 0.06, 1.0, 1.0), (12.0, 0.03, 1.0, -0.7))  # [Hz], damping ratio, left, right
SHAKER = "estimate shaker.csv --time t --input force --output left,right --segment 8"


def motions(force):
    """Displacements of two places: sampled free motions of two modes, convolved with a force."""
    y = np.zeros((2, len(force)))
    for f, zeta, *shape in MODES:
        w = 2 * np.pi * f
        p = np.exp(w * (-zeta + 1j * np.sqrt(1 - zeta**2)) / RATE)
        q = lfilter([0, p.imag / w / RATE], [1, -2 * p.real, abs(p) ** 2], force)
        y += np.outer(shape, q)
    return y


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Records of a test with a shaker, and of one with a hammer."""
    monkeypatch.chdir(tmp_path)
    rng, n = np.random.default_rng(0), 16384
    force = rng.normal(size=n)
    hits = 1e-3 * rng.normal(size=n)
    hits[100::2048] = 50.0
    for name, x in (("shaker", force), ("hammer", hits)):
        y = motions(x)
        y += 0.01 * y.std() * rng.normal(size=y.shape)
        table = np.stack([np.arange(n) / RATE, x, *1e3 * y], 1)
        head = "t [s],force [N],left [mm],right"
        np.savetxt(f"{name}.csv", table, "%.12g", ",", header=head, comments="")
    return tmp_path


def run(text, code=0):
    assert commands.main(shlex.split(text)) == code


def test_the_tables_are_those_of_python_and_both_pictures_are_saved(folder, capsys):
    run(f"{SHAKER} --unit right=mm --band 2:16 --out responses.png")
    said = capsys.readouterr()
    record = jb.read_record(
        "shaker.csv",
        time="t",
        channels={"force": "force", "left": "left", "right": ("right", "mm")},
    )
    responses = jb.modal.estimate_responses(
        record, inputs=["force"], outputs=["left", "right"], segment=8.0, band=(2, 16)
    )
    modes = jb.modal.identify_modes(responses)
    assert responses.summary() in said.out and modes.summary() in said.out
    assert "saved responses.png" in said.out and not said.err
    found = modes.identification
    errors = (found.frequency - [f for f, *_ in MODES]) / found.frequency_error
    assert np.abs(errors).max() < 4
    run(f"{SHAKER} --unit right=mm --band 2:16 --out modes.png --draw modes")
    run(f"{SHAKER} --unit right=mm --band 2:16 --out modes.csv")
    pictures = [(folder / name).read_bytes() for name in ("responses.png", "modes.png")]
    assert pictures[0] != pictures[1] and all(x[:4] == b"\x89PNG" for x in pictures)
    assert "damping ratio" in (folder / "modes.csv").read_text()


def test_hits_of_a_hammer_and_several_records(folder, capsys):
    """The damping of the exponential window is taken out again."""
    hit = "--segment 8 --pulse 0.05 --decay 1 --band 2:16"
    run(f"estimate hammer.csv hammer.csv --time t --input force --output left {hit}")
    said = capsys.readouterr().out
    assert "16 hits" in said
    rows = [line.split() for line in said.splitlines() if line.split()[:1] in (["1"], ["2"])]
    np.testing.assert_allclose([float(row[3]) for row in rows], [0.06, 0.03], rtol=0.05)


def test_what_is_wrong_is_said(folder, capsys):
    for words, message in (
        (SHAKER, "has no unit in the file"),
        (f"{SHAKER} --unit rihgt=mm", "Did you mean 'right'"),
        (f"{SHAKER} --unit right=mm --method H3", "BAD_METHOD"),
        (f"{SHAKER} --unit right=mm --out modes.txt", "UNKNOWN_FORMAT"),
        (f"{SHAKER.replace('left,', 'lift,')} --unit right=mm", "Did you mean left"),
        (f"{SHAKER} --unit right=mm --decay 1 --pulse 0.1 --input left", "ImpactWindow"),
    ):
        run(words, 2)
        assert message in capsys.readouterr().err
    with pytest.raises(SystemExit):
        commands.main(["estimate", "shaker.csv", "--input", "force"])


def test_responses_without_modes_are_printed_and_drawn(folder, capsys):
    run(f"{SHAKER} --unit right=mm --band 7:9 --out responses.png", 2)
    said = capsys.readouterr()
    assert "Frequency responses by H1" in said.out and "saved responses.png" in said.out
    assert "NO_DATA" in said.err


def test_a_wrong_format_is_refused_before_JAX_is_imported(folder):
    code = (
        "import sys; from jaxbody.app.commands import main\n"
        "code = main(['estimate', 'x.csv', '--input', 'f', '--output', 'y', '--out', 'x.txt'])\n"
        "print(code, 'jax' in sys.modules, 'numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["2", "False", "False"] and "x.txt" in done.stderr
