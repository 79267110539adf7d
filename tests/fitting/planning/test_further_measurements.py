"""What would help a fit most: closed cases, and expected fits of the same measurements."""

import jax.numpy as jnp
import numpy as np
import pytest
from rigs import mass_on_spring

import jaxbody as jb

FREE = ["mass.mass", "spring.stiffness"]
SENSOR = {"x": jb.Position("mass", axis="z")}


def fall(noise=None, measured=None, times=None):
    """The mass let go 1 cm from rest, which tells k/m alone."""
    return jb.Experiment(
        jnp.linspace(0.0, 2.0, 101) if times is None else times,
        sensors=SENSOR,
        initial=jb.State(jnp.array([0.01]), jnp.zeros(1)),
        noise=noise,
        measured=measured,
    )


def test_a_response_determines_what_free_motion_does_not():
    model = mass_on_spring()
    fit = jb.expected_fit(model, {"fall": fall(noise=1e-4)}, free=FREE)
    further = jb.fitting.further_measurements(fit)
    assert np.isinf(further.before).all()
    assert further.measurements[0] == "position of mass along z by a force on mass along z"
    assert np.isfinite(further.after[0]).all()
    # one more sensor of the same motion tells nothing of the undetermined direction
    assert len(further.measurements) == 1
    text = str(further)
    assert "mass.mass, spring.stiffness" in text and "noise of 1 %" in text


def test_errors_are_those_of_the_expected_fit_of_both():
    """The same sensor once more in the same run, with 1 % of the rms of its record."""
    model, prior = mass_on_spring(), {"mass.mass": (9.0, 0.9)}
    fit = jb.expected_fit(model, {"fall": fall(noise=1e-2)}, free=FREE, priors=prior)
    further = jb.fitting.further_measurements(fit, share=0.5)
    row = further.measurements.index("position of mass along z in fall")
    record = np.asarray(fit.predicted["fall"]["x"])
    both = {"fall": fall(noise=1e-2), "again": fall(noise=0.5 * record.std())}
    expected = jb.expected_fit(model, both, free=FREE, priors=prior)
    np.testing.assert_allclose(further.after[row], np.sqrt(np.diag(expected.covariance)), rtol=1e-8)
    np.testing.assert_allclose(further.before, np.sqrt(np.diag(fit.covariance)), rtol=1e-8)
    assert len(jb.fitting.further_measurements(fit, most=1).measurements) == 1
    with pytest.raises(jb.JaxbodyError, match="BAD_NUMBER"):
        jb.fitting.further_measurements(fit, share=-1.0)


def test_validations_say_which_record_would_help_most(rng):
    """A run under a known force would determine what free motion does not; a longer free one would
    help where a prior does."""
    model, t = mass_on_spring(), jnp.linspace(0.0, 2.0, 101)
    pull = {"pull": jb.Force("mass", force=[0, 0, 20.0])}

    def record(**acting):
        motion = jb.simulate(model, t, **acting)
        x = jb.measure(motion, SENSOR)["x"] + 1e-4 * rng.normal(size=t.shape)
        return jb.Experiment(t, sensors=SENSOR, measured={"x": x}, **acting)

    free = record(initial=jb.State(jnp.array([0.01]), jnp.zeros(1)))
    pulled = record(loads=pull)
    with pytest.warns(jb.JaxbodyWarning, match="NOT_IDENTIFIABLE"):
        fit = jb.fit(model, {"free": free}, free=FREE)
    checked = jb.validate(fit, {"pulled": pulled})
    assert checked.further == "fitted too, pulled.x would determine mass.mass, spring.stiffness"
    assert checked.further in str(checked)
    known = jb.fit(model, {"free": free}, free=FREE, priors={"mass.mass": (9.0, 0.9)})
    checked = jb.validate(known, {"pulled": pulled, "free again": free})
    assert checked.further.startswith("fitted too, pulled.x would help most: the largest")
    alone = jb.validate(known, {"free again": free})
    assert alone.further == ""  # the mass is known by its prior alone, as before
