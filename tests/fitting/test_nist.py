"""The search and the standard errors of `fit` against the certified values of NIST's datasets for
nonlinear regression.

tests/nist holds the 27 files as NIST publishes them (National Institute of Standards and
Technology, public domain): data, two starts, and values certified to eleven digits, computed in
128-bit arithmetic. Parameters move as most of a model's do, b = b0 + |b0| u.
"""

import pathlib
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbody.fitting.searches import Evaluations, by_scipy
from jaxbody.fitting.statistics.noises import ResidualSeries
from jaxbody.fitting.statistics.uncertainties import assess

FILES = sorted((pathlib.Path(__file__).parents[1] / "nist").glob("*.dat"))
exp, pi = jnp.exp, jnp.pi


def gauss(x, b):
    return (
        b[0] * exp(-b[1] * x)
        + b[2] * exp(-((x - b[3]) ** 2) / b[4] ** 2)
        + b[5] * exp(-((x - b[6]) ** 2) / b[7] ** 2)
    )


def lanczos(x, b):
    return b[0] * exp(-b[1] * x) + b[2] * exp(-b[3] * x) + b[4] * exp(-b[5] * x)


def cubics(x, b):
    return (b[0] + x * (b[1] + x * (b[2] + x * b[3]))) / (1 + x * (b[4] + x * (b[5] + x * b[6])))


def chwirut(x, b):
    return exp(-b[0] * x) / (b[1] + b[2] * x)


def saturation(x, b):
    return b[0] * (1 - exp(-b[1] * x))


def waves(x, b):
    wave = lambda period, c, s: c * jnp.cos(2 * pi * x / period) + s * jnp.sin(2 * pi * x / period)  # noqa: E731
    return b[0] + wave(12.0, b[1], b[2]) + wave(b[3], b[4], b[5]) + wave(b[6], b[7], b[8])


MODELS = {
    "Bennett5": lambda x, b: b[0] * (b[1] + x) ** (-1 / b[2]),
    "BoxBOD": saturation,
    "Chwirut1": chwirut,
    "Chwirut2": chwirut,
    "DanWood": lambda x, b: b[0] * x ** b[1],
    "ENSO": waves,
    "Eckerle4": lambda x, b: b[0] / b[1] * exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Gauss1": gauss,
    "Gauss2": gauss,
    "Gauss3": gauss,
    "Hahn1": cubics,
    "Kirby2": lambda x, b: (b[0] + b[1] * x + b[2] * x**2) / (1 + b[3] * x + b[4] * x**2),
    "Lanczos1": lanczos,
    "Lanczos2": lanczos,
    "Lanczos3": lanczos,
    "MGH09": lambda x, b: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda x, b: b[0] * exp(b[1] / (x + b[2])),
    "MGH17": lambda x, b: b[0] + b[1] * exp(-x * b[3]) + b[2] * exp(-x * b[4]),
    "Misra1a": saturation,
    "Misra1b": lambda x, b: b[0] * (1 - (1 + b[1] * x / 2) ** -2),
    "Misra1c": lambda x, b: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda x, b: b[0] * b[1] * x / (1 + b[1] * x),
    "Nelson": lambda x, b: b[0] - b[1] * x[:, 0] * exp(-b[2] * x[:, 1]),  # of log y
    "Rat42": lambda x, b: b[0] / (1 + exp(b[1] - b[2] * x)),
    "Rat43": lambda x, b: b[0] / (1 + exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Roszman1": lambda x, b: b[0] - b[1] * x - jnp.arctan(b[2] / (x - b[3])) / pi,
    "Thurber": cubics,
}


def read(path):
    """Starts (2, n), certified parameters and standard deviations, y and x."""
    text = path.read_text()
    rows = np.array(
        [
            row.split()
            for row in re.findall(r"^\s*b\d+\s*=\s*(.*)$", text, flags=re.M)
            if len(row.split()) == 4
        ],
        float,
    )
    table = np.array(
        [row.split() for row in text[text.rindex("Data:") :].splitlines()[1:] if row.strip()], float
    )
    y, x = table[:, 0], table[:, 1] if table.shape[1] == 2 else table[:, 1:]
    return rows[:, :2].T, rows[:, 2], rows[:, 3], np.log(y) if path.stem == "Nelson" else y, x


def digits(result, certified):
    """How many of the certified digits all numbers share."""
    return float(-np.log10(np.max(np.abs(result - certified) / np.abs(certified)) + 1e-12))


def solved(path, start):
    """Estimates, standard errors, and whether the search arrived."""
    starts, certified, deviations, y, x = read(path)
    b0, model = jnp.asarray(starts[start]), MODELS[path.stem]

    @jax.jit
    def residual_and_jacobian(u):
        residual = lambda u: model(x, b0 + jnp.abs(b0) * u) - y  # noqa: E731
        return residual(u), jax.jacfwd(residual)(u), None

    evaluate = Evaluations(residual_and_jacobian, 2000)
    free = np.full(len(b0), np.inf)
    u, arrived = by_scipy(evaluate, np.zeros(len(b0)), (-free, free))
    r, J, _ = evaluate(u)
    uncertainty = assess(
        r,
        J,
        [],
        [],
        [f"b{i}" for i in range(len(b0))],
        [ResidualSeries("y", "y", "", np.arange(len(y)), np.arange(len(y)), False)],
    )
    error, freedom = uncertainty.spread(np.diag(np.abs(b0)))
    np.testing.assert_allclose(freedom[np.isfinite(error)], len(y) - uncertainty.rank, rtol=1e-9)
    return np.asarray(b0 + np.abs(b0) * u), error, arrived, certified, deviations


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_certified_parameters_and_their_standard_deviations(path):
    result, error, arrived, certified, deviations = solved(path, 1)
    print(
        f"{path.stem}: {digits(result, certified):.1f} and {digits(error, deviations):.1f} digits"
    )
    # its residuals, 1e-13 of y, have three digits in float64
    known = 3 if path.stem == "Lanczos1" else 4
    assert arrived and digits(result, certified) >= 6 and digits(error, deviations) >= known


@pytest.mark.long
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_from_the_far_start_too_or_the_data_do_not_determine_the_parameters(path):
    """Three end where an exponential has died out before the first point, on a plateau: parameters
    have no number there."""
    result, error, arrived, certified, _ = solved(path, 0)
    print(f"{path.stem}: {digits(result, certified):.1f} digits, {arrived}")
    lost = path.stem in ("BoxBOD", "MGH10", "MGH17")
    assert np.isinf(error).any() if lost else arrived and digits(result, certified) >= 6
