"""Choices of measurements: published and exact cases, all subsets, bounds, and what is refused."""

from itertools import combinations

import jax.numpy as jnp
import numpy as np
import pytest
from rigs import mass_on_spring

import jaxbody as jb
from jaxbody.fitting.planning import criteria
from jaxbody.fitting.residuals import residual_and_jacobian


def best_of_all(J, n, kind, base=0.0, of=None):
    M = np.swapaxes(J, 1, 2) @ J
    return min(
        float(criteria.criterion(base + M[list(some)].sum(0), kind, of))
        for some in combinations(range(len(J)), n)
    )


def test_vertical_sensors_of_a_plate():
    """REFERENCES2 D4: the corners, 64 a^2 b^2; three that span half of the rectangle, 16 a^2 b^2
    (sets tie)."""
    places = [(x, y) for x in (-0.6, 0.0, 0.6) for y in (-0.4, 0.0, 0.4)]
    rows = {f"{x} {y}": np.array([1.0, y, -x]) for x, y in places}
    four, three = (jb.choose(rows, n=n) for n in (4, 3))
    assert set(four.names) == {"-0.6 -0.4", "-0.6 0.4", "0.6 -0.4", "0.6 0.4"}
    np.testing.assert_allclose(np.linalg.det(four.information), 3.6864, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.det(three.information), 0.9216, rtol=1e-12)
    np.testing.assert_allclose(four.efficiency, 1.0, atol=1e-4)
    angles = 2 * np.pi * np.arange(3) / 3
    circle = np.stack([np.ones(3), 0.5 * np.sin(angles), -0.5 * np.cos(angles)], 1)
    on_circle = jb.choose(dict(zip("abc", circle, strict=True)), n=3)
    np.testing.assert_allclose(np.linalg.det(on_circle.information), 0.421875, rtol=1e-12)


def test_sensors_of_modes_of_a_chain():
    """REFERENCES2 D5: masses 2, 5, 7, 10 for the first four modes, det 0.0472259781, the best of
    all 210 sets."""
    i, j = np.arange(1, 11), np.arange(1, 5)
    shapes = np.sin((2 * j - 1) * np.pi * i[:, None] / 21)
    shapes /= np.linalg.norm(shapes, axis=0)
    result = jb.choose({str(k): row for k, row in zip(i, shapes, strict=True)}, n=4)
    assert result.names == ("2", "5", "7", "10")
    np.testing.assert_allclose(np.linalg.det(result.information), 0.0472259781, rtol=1e-8)


@pytest.mark.parametrize("kind", criteria.KINDS)
@pytest.mark.parametrize("of", ["", " of 0, 2"])
def test_choices_against_all_subsets(rng, kind, of):
    """The best subset, and a bound that is below it, with an existing measurement too."""
    existing = rng.normal(size=(1, 3)) * 0.3
    for repeat in range(5):
        J = rng.normal(size=(12, 2, 3)) * 10 ** rng.uniform(-1, 1, (12, 1, 1))
        base = existing.T @ existing * (repeat % 2)
        result = jb.choose(
            {str(k): each for k, each in enumerate(J)},
            n=4,
            criterion=kind + of,
            existing=existing if repeat % 2 else None,
        )
        best = best_of_all(J, 4, kind, base, [0, 2] if of else None)
        scale = 1.0 if kind == "D" else best
        assert best - 1e-6 * scale <= result.value <= best + 0.03 * scale
        assert result.bound <= best + 1e-6 * scale
        size = 2 if of else 3
        part = np.exp((best - result.value) / size) if kind == "D" else best / result.value
        assert result.efficiency <= part + 1e-6


def test_averages_over_draws(rng):
    """Two models, between which no single one of two candidates is best."""
    one = np.array([[[2.0]], [[0.1]]])  # (draws, rows, parameters)
    other = np.array([[[0.5]], [[0.6]]])
    both = {"one": one, "other": other}
    assert jb.choose({name: x[0] for name, x in both.items()}, n=1).names == ("one",)
    assert jb.choose(both, n=1).names == ("other",)  # log 0.3 > log 0.2
    expected = -np.mean(np.log(other.ravel() ** 2))
    # as a part of 1e-10 of the information of all is added, so that a first choice can be compared
    np.testing.assert_allclose(jb.choose(both, n=1).value, expected, rtol=1e-8)


FREE = ["spring fl.stiffness", "spring rr.stiffness", "spring fl.damping", "car.mass"]


@pytest.fixture(scope="module")
def car():
    """The fit to expect of a full car on a four-post rig, with accelerometers at 24 places."""
    places = [(x, y) for x in np.linspace(-1.8, 1.8, 6) for y in np.linspace(-0.8, 0.8, 4)]
    rig = jb.MeasuredResponse(
        np.geomspace(0.7, 15.0, 12),
        inputs={"road": jb.BaseMotion("road fl", "z")},
        outputs={
            f"at {100 * x:.0f} {100 * y:.0f}": jb.Acceleration("car", [x, y, 0.0], axis="z")
            for x, y in places
        },
        noise=1.0,
    )
    return jb.expected_fit(
        jb.presets.full_car(), {"rig": rig}, free=FREE, priors={"car.mass": (1100.0, 200.0)}
    )


@pytest.mark.parametrize("kind", criteria.KINDS)
def test_sensors_of_a_full_car_against_all_subsets(car, kind):
    """At least 97 % of the best of all 2024 sets of three."""
    result = jb.choose(car, n=3, criterion=kind)
    r, J = map(np.asarray, residual_and_jacobian(car.task, jnp.asarray(car.u))[:2])
    assert len(r) == 24 * 12 * 2 + 1 and len(result.candidates) == 24
    each = J[:-1].reshape(24, 24, 4)  # channels in order of their names, as the candidates
    base = J[-1:].T @ J[-1:]
    assert result.candidates == tuple(sorted(result.candidates))
    best = best_of_all(each, 3, kind, base)
    part = np.exp((best - result.value) / 4) if kind == "D" else best / result.value
    assert 0.97 <= part <= 1 + 1e-6 and result.efficiency <= part + 1e-6
    errors = np.sqrt(np.diag(np.linalg.inv(result.information)))
    np.testing.assert_allclose(result.after, errors, rtol=1e-8)
    np.testing.assert_allclose(result.before, [np.inf, np.inf, np.inf, 200 / 1100], rtol=1e-12)


@pytest.mark.long
def test_runs_are_chosen_beside_a_fit(car):
    """Of two plans for a car whose left spring is known already, the one that tells of the other
    spring; as arithmetic of the information of both."""
    outputs = {"body": jb.Acceleration("car", axis="z")}
    plans = {
        name: jb.MeasuredResponse(
            [1.0, 2.0, 4.0, 8.0],
            inputs={"road": jb.BaseMotion(f"road {road}", "z")},
            outputs=outputs,
            noise=0.1,
        )
        for name, road in (("left", "fl"), ("right", "rr"))
    }
    first = jb.expected_fit(jb.presets.full_car(), {"left": plans["left"]}, free=FREE)
    result = jb.choose(plans, n=1, existing=first, each="run", criterion="largest interval of *rr*")
    assert result.names == ("right",) and result.candidates == ("left", "right")
    both = jb.expected_fit(jb.presets.full_car(), plans, free=FREE)
    expected = [both.covariance[i, i] ** 0.5 for i in range(4)]
    np.testing.assert_allclose(result.after, expected, rtol=1e-6)
    drawn = jb.choose(plans, n=1, existing=first, each="run", draws=2)
    assert drawn.names == ("right",) and drawn.value != result.value


def test_what_a_run_tells_is_less_by_its_own_unknowns():
    """Beside a fit whose start was free too, with a prior: the errors of the expected fit of both
    runs, in which the start of the first is free."""
    model = mass_on_spring()
    t, start = jnp.linspace(0.0, 0.3, 31), jb.State(jnp.array([0.01]), jnp.zeros(1))
    run = jb.Experiment(t, sensors={"x": jb.Position("mass", axis="z")}, initial=start, noise=1e-3)
    free, priors = ["spring.stiffness"], {"spring.stiffness": (900.0, 200.0)}
    starts = ["first.initial.q", "first.initial.v"]
    first = jb.expected_fit(model, {"first": run}, free=free + starts, priors=priors)
    result = jb.choose({"second": run}, n=1, existing=first)
    both = jb.expected_fit(model, {"first": run, "second": run}, free=free + starts, priors=priors)
    i = list(both.estimates).index("spring.stiffness")
    np.testing.assert_allclose(result.after[0], both.covariance[i, i] ** 0.5, rtol=1e-8)
    np.testing.assert_allclose(result.before[0], first.covariance[i, i] ** 0.5, rtol=1e-8)


@pytest.mark.long
def test_choices_beside_a_posterior():
    """What is known before is the spread of its draws, over which the criterion is averaged: for
    one frequency f, the mean of -log(1/s^2 + (f/2/noise)^2)."""
    pytest.importorskip("blackjax")
    pytest.importorskip("arviz_stats")
    model = mass_on_spring()
    test = jb.MeasuredModes(frequency=[1.6], noise={"frequency": 0.02})
    fit = jb.fit(model, {"test": test}, free=["spring.stiffness"])
    posterior = jb.posterior(fit, draws=2000)
    s = posterior.y[..., 0].std(ddof=1)
    plan = {"again": jb.MeasuredModes(number=[0], noise={"frequency": 0.01})}
    result = jb.choose(plan, n=1, existing=posterior, draws=5)
    np.testing.assert_allclose(result.before, s, rtol=1e-9)
    k = 900.0 * np.exp(posterior.drawn(5)[:, 0])
    f = np.sqrt(k / 9.0) / (2 * np.pi)
    expected = np.mean(-np.log(1 / s**2 + (f / 2 / 0.01) ** 2))
    np.testing.assert_allclose(result.value, expected, rtol=1e-8)


def test_what_cannot_be_chosen_is_refused(car):
    def refused(code, candidates=car, **given):
        with pytest.raises(jb.JaxbodyError) as error:
            jb.choose(candidates, **({"n": 2} | given))
        assert code in str(error.value)
        return str(error.value)

    rows = {"a": [1.0, 0.0, 0.0], "b": [0.0, 1.0, 0.0], "none": [0.0, 0.0, 0.0]}
    assert "4 of 3" in refused("BAD_NUMBER", rows, n=4)
    assert "2 has no effect" in refused("UNDETERMINED", rows)
    assert "2 has no effect" in refused("UNDETERMINED", rows, criterion="A of 1, 2")
    result = jb.choose(rows, n=2, criterion="largest interval of 0, 1")
    assert result.names == ("a", "b") and result.silent == ("none",)
    assert "none measure nothing" in str(result)
    assert "n = 1 do not determine" in refused("UNDETERMINED", rows, n=1, criterion="D of 0, 1")
    assert "mass" in refused("UNKNOWN_NAME", rows, criterion="largest interval of mass")
    refused("BAD_OPTION", rows, criterion="F")
    refused("BAD_OPTION", each="place")
    refused("BAD_SHAPE", {"a": [1.0, 2.0], "b": [1.0]})
    refused("NON_FINITE", {"a": [1.0, np.nan], "b": [1.0, 2.0]})
    refused("WRONG_KIND", {})
    refused("WRONG_KIND", car.experiments)
    refused("WRONG_KIND", rows, existing=car)


def test_a_parameter_that_no_candidate_determines_is_named_with_what_would():
    """A single frequency does not determine mass and stiffness; a response does."""
    model = mass_on_spring()
    plan = {"tap": jb.MeasuredModes(number=[0], noise={"frequency": 0.01})}
    fit = jb.expected_fit(model, plan, free=["mass.mass", "spring.stiffness"])
    assert int(fit.status) == jb.Status.NOT_IDENTIFIABLE
    with pytest.raises(jb.JaxbodyError, match="UNDETERMINED") as error:
        jb.choose(fit, n=1)
    assert "mass.mass up with spring.stiffness up" in str(error.value)
    assert "position of mass along z by a force on mass along z" in str(error.value)
