"""Two measured gliders: the parameters that the record determines, and those that it does not."""

import os
import pathlib
import runpy
import warnings
from types import SimpleNamespace
from unittest import mock

import equinox as eqx
import numpy as np
import optax
import pytest
from data import data
from report_pages import Page, check_golden, numbers

import jaxbody as jb

pytestmark = pytest.mark.long  # the example itself, with its assertions, is run by .ci/run


@pytest.fixture(scope="module")
def gliders():
    """The names of the notebook, and a fit in which both masses are free."""
    file = data("gliders", "real_double_linear_h_1.txt")
    path = pathlib.Path(__file__).parents[2] / "examples" / "gliders.py"
    found = {"JAXBODY_DATA": str(file.parents[1]), "MPLBACKEND": "Agg"}
    with mock.patch.dict(os.environ, found), warnings.catch_warnings():
        # The first 11 s do not show the damping of the right spring: whether it ends at zero is up
        # to rounding
        warnings.filterwarnings("ignore", "(?s).*AT_BOUND", jb.JaxbodyWarning)
        with pytest.warns(jb.JaxbodyWarning, match="CORRELATED_RESIDUALS"):
            names = SimpleNamespace(**runpy.run_path(str(path)))
    names.track = names.run_of(names.record)
    with pytest.warns(jb.JaxbodyWarning, match="NOT_IDENTIFIABLE"):
        names.loose = jb.fit(
            names.fit.model,
            {"track": names.fit.experiments["track"]},
            free=[*names.free, "glider1.mass"],
        )
    return names


def test_the_record_is_explained_and_the_outer_springs_are_equal(gliders):
    fit = gliders.fit
    assert fit.ok
    for name in ("x1", "x2"):
        x = gliders.record[name]
        rms = np.sqrt(np.mean((np.asarray(fit.predicted["track"][name]) - x) ** 2))
        # plain two-mass fits of this record reach 1.23 % and 1.13 %
        assert rms <= 0.0125 * np.std(x)
    left, right = float(fit.model["left"].stiffness), float(fit.model["right"].stiffness)
    assert abs(left / right - 1) < 0.01
    # the published data's mass ratio by such fits
    assert float(fit.model["glider2"].mass) == pytest.approx(2.48, abs=0.01)


def test_correlated_residuals_are_reported(gliders):
    assert gliders.fit.correlation > 0.5
    assert "residuals are correlated" in str(gliders.fit)


def test_the_masses_themselves_are_reported_as_undetermined(gliders):
    loose = gliders.loose
    assert loose.status == jb.Status.NOT_IDENTIFIABLE
    assert len(loose.unidentified) == 1
    for path in (
        "glider1.mass",
        "glider2.mass",
        "left.stiffness",
        "middle.stiffness",
        "right.stiffness",
    ):
        assert f"{path} up" in loose.unidentified[0] or "more" in loose.unidentified[0]
        assert np.isinf(loose.standard_errors[path])
    assert np.isfinite(loose.standard_errors["track.initial.v"]).all()


@pytest.mark.long
def test_optax_reaches_the_optimum_that_scipy_reaches(gliders):
    """With the noise stated, so that both weigh the two sensors alike."""
    noise = {name: float(level) for name, level in gliders.fit.noise["track"].items()}
    track = eqx.tree_at(lambda e: e.noise, gliders.track, noise, is_leaf=lambda x: x is None)
    # the first 11 s leave it at zero, where no search starts
    start = jb.replace(gliders.half.model, {"right.damping": 0.1})
    with pytest.warns(jb.JaxbodyWarning, match="residuals are correlated"):  # they are, by 0.6
        by_optax, by_scipy = (
            jb.fit(start, {"track": track}, free=gliders.free, method=method)
            for method in (optax.lbfgs(), "least_squares")
        )
    for path, expected in by_scipy.estimates.items():
        print(path, np.abs(by_optax.estimates[path] - expected).max() / np.abs(expected).max())
        np.testing.assert_allclose(
            by_optax.estimates[path],
            expected,
            rtol=0,
            atol=1e-6 * np.abs(expected).max(),
            err_msg=path,
        )


def test_the_report_of_the_fit_holds_its_numbers(gliders, tmp_path):
    page = Page(jb.report({"Fit": gliders.fit}, tmp_path / "gliders.html"))
    stated = {row[0]: row[1] for row in numbers(page)[0][1:]}
    for path, value in gliders.fit.estimates.items():
        if np.ndim(value) == 0:
            assert stated[path] == pytest.approx(float(value), rel=1e-5)  # six printed digits
    check_golden("gliders", page)
