"""Posteriors: the exact one of a linear problem (D6), one from a lattice (D8), priors, what is
refused, and what takes draws."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import straight_lines as lines
from data import data
from scipy.stats import norm

import jaxbody as jb
from jaxbody import plots
from jaxbody.fitting import LogNormal, evidence, leave_one_out, posterior
from jaxbody.fitting.parameters.priors import priors_of
from jaxbody.fitting.parameters.spaces import space_of
from jaxbody.fitting.posteriors import prepared

pytest.importorskip("blackjax", reason="needs jaxbody[posterior]")
pytest.importorskip("arviz_stats", reason="needs jaxbody[posterior]")


@pytest.fixture(scope="module")
def fit():
    return lines.fitted()


@pytest.fixture(scope="module")
def drawn(fit):
    return posterior(fit)


def scales(fit):
    return np.diag([float(parameter.form.scale) for parameter in fit.task.space.parameters])


def check_exact(result):
    """Means, deviations and correlation to four Monte Carlo errors."""
    size = result.ess_bulk.min()
    for i, path in enumerate(result.values):
        deviation = np.sqrt(lines.C[i, i])
        assert abs(result.means[path] - lines.MEAN[i]) < 4 * deviation / np.sqrt(size)
        assert abs(result.standard_errors[path] / deviation - 1) < 4 / np.sqrt(2 * size / 2)
    limit = 4 * (1 - lines.CORRELATION**2) / np.sqrt(size / 2)
    assert abs(result.correlations[0, 1] - lines.CORRELATION) < limit


def test_the_normal_approximation_of_a_linear_problem_is_exact(fit):
    """Mode, covariance and Laplace's evidence (D6) at 1e-8."""
    density, (y, L) = prepared(fit, None)
    S = scales(fit)
    np.testing.assert_allclose(density.unknowns.numbers(np.asarray(y))[0], lines.MEAN, atol=1e-8)
    np.testing.assert_allclose(S @ np.asarray(L @ L.T) @ S, lines.C, atol=1e-8)
    laplace = float(density(y)) + np.log(2 * np.pi) + np.linalg.slogdet(np.asarray(L))[1]
    assert abs(laplace - lines.LOG_EVIDENCE) < 1e-8


def test_draws_of_a_linear_problem_have_the_exact_posterior(drawn):
    assert drawn.ok and drawn.divergences == 0 and drawn.r_hat.max() < 1.01
    check_exact(drawn)
    low, high = drawn.intervals(0.5)["run.line.a"]
    half = norm.ppf(0.75) * np.sqrt(lines.C[0, 0])
    np.testing.assert_allclose([low, high], lines.MEAN[0] + [-half, half], atol=0.02)


def test_the_evidence_of_a_linear_problem_is_exact(drawn):
    result = evidence(drawn)
    assert abs(result.log_evidence - lines.LOG_EVIDENCE) < 3 * result.standard_error
    assert result.ok and result.standard_error < 0.01 and "-5.32" in str(result)


def test_leaving_one_out_is_as_refits_without_each_sample(drawn):
    """The density of y_i given the others, in closed form."""
    result, exact = leave_one_out(drawn), []
    for i, (x, y) in enumerate(zip(lines.X, lines.Y, strict=True)):
        X, rest = np.delete(lines.X, i, 0), np.delete(lines.Y, i)
        C = np.linalg.inv(X.T @ X / lines.SIGMA**2 + np.diag(lines.DEVIATIONS**-2))
        mean = C @ X.T @ rest / lines.SIGMA**2
        exact.append(norm.logpdf(y, x @ mean, np.sqrt(lines.SIGMA**2 + x @ C @ x)))
    np.testing.assert_allclose(result.pointwise, exact, atol=0.03)
    assert abs(result.elpd - sum(exact)) < 0.05 and (result.pareto_k < 0.7).all()
    assert abs(result.standard_error - np.sqrt(12) * np.std(exact, ddof=1)) < 0.02
    assert result.samples[10] == "run.y at t = 2.5 s" and result.samples[10] in str(result)


def test_an_unreliable_sample_is_named(fit, drawn):
    y = jnp.asarray(lines.Y).at[11].set(9.0)
    where = lambda p: p.density.task.space.runs["run"].measured["y"]  # noqa: E731
    far = eqx.tree_at(where, drawn, y)
    with pytest.warns(jb.JaxbodyWarning, match=r"Pareto k exceeds 0\.7 for 1 samples"):
        assert "run.y at t = 2.75 s" in str(leave_one_out(far))


def test_noise_is_drawn_with_its_jacobian(fit):
    """Flat priors: the noise level has n s^2/sigma^2 as chi-square with n - p degrees of freedom,
    and the estimates Student's t."""
    result = posterior(lines.fitted(priors=None, noise=None))
    assert list(result.values) == ["run.line.a", "run.line.b", "noise.y"]
    X = lines.X
    rest = lines.Y - X @ np.linalg.lstsq(X, lines.Y, rcond=None)[0]
    squares, freedom, size = rest @ rest, len(X) - 2, result.ess_bulk.min()
    chi = squares / result.values["noise.y"] ** 2
    assert abs(chi.mean() / freedom - 1) < 4 * np.sqrt(2 / freedom / size)
    variance = squares / freedom * np.linalg.inv(X.T @ X)[1, 1] * freedom / (freedom - 2)
    assert abs(result.standard_errors["run.line.b"] ** 2 / variance - 1) < 0.15


@pytest.mark.parametrize(
    ("prior", "bounds"),
    [
        (LogNormal(20.0, 0.5), None),
        ((10.0, 10.0), None),
        ((10.0, 10.0), (5.0, 40.0)),
        (LogNormal(20.0, 0.5), (5.0, 31.0)),
        (None, (5.0, 40.0)),
    ],
)
def test_priors_of_a_positive_number_integrate_to_one(prior, bounds):
    """Densities of u, the logarithm, with the Jacobian and within the bounds."""
    space = space_of(
        jb.presets.quarter_car(stiffness=30.0),
        "suspension.stiffness",
        "test",
        bounds=None if bounds is None else {"suspension.stiffness": bounds},
    )
    given = None if prior is None else {"suspension.*": prior}
    (density,) = priors_of(space.parameters, given, "test")
    u = jnp.linspace(-30.0, 8.0, 76001)
    p = jnp.exp(jax.vmap(density.log_density)(u[:, None]))
    assert density.proper and abs(float(jnp.sum(p) * (u[1] - u[0])) - 1) < 1e-3
    if prior is not None:
        x = np.asarray(30.0 * jnp.exp(u))
        inside = np.asarray(p) > 0
        np.testing.assert_allclose(density.density(x, 0)[inside] * x[inside], p[inside], rtol=1e-9)


@pytest.mark.long
def test_log_normal_priors_are_densities_of_the_number():
    """Where the data say nothing, draws of a frequency are those of its prior; a normal prior of a
    positive number is cut at zero."""
    spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    model = jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
        elements={"spring": spring},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    )
    tests = {"test": jb.MeasuredModes(frequency=[1.0], noise={"frequency": 1e3})}
    result = jb.fit(model, tests, free=["spring.stiffness"], priors={"spring.stiffness": (30, 1)})
    for prior, mean in (
        (LogNormal(30.0, 0.3), 30 * np.exp(0.045)),
        ((20.0, 10.0), 20 + 10 * norm.pdf(2) / norm.cdf(2)),
    ):
        drawn = posterior(result, priors={"spring.*": prior})
        x = drawn.values["spring.stiffness"]
        assert abs(x.mean() - mean) < 4 * x.std() / np.sqrt(drawn.ess_bulk[0]), prior
        assert abs(evidence(drawn).log_evidence - norm.logpdf(0, 0, 1e3)) < 0.01


@pytest.mark.long
def test_a_sensor_with_gain_and_bias_has_the_exact_posterior():
    """The line as the reading of a support that moves along a ramp."""
    t = lines.TIMES
    ramp = jb.Sampled(t, translation=np.stack([t, 0 * t, 0 * t], 1))
    model = jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    )
    sensors = {"x": jb.Position("base", axis=[1, 0, 0], gain=1.0, bias=0.0)}
    run = jb.Experiment(
        t, motion={"base": ramp}, sensors=sensors, measured={"x": lines.Y}, noise=lines.SIGMA
    )
    priors = {"run.x.bias": (0, 2), "run.x.gain": (0, 1)}
    result = jb.fit(model, {"run": run}, free=list(priors), priors=priors)
    drawn = posterior(result)
    check_exact(drawn)
    assert abs(evidence(drawn).log_evidence - lines.LOG_EVIDENCE) < 0.005


class Oscillator(jb.Element):
    """A spring and damper stated by natural frequency and damping ratio, of a mass of 1 kg."""

    wn: jax.Array = jb.field("rad/s", "positive")
    zeta: jax.Array = jb.field("", "positive")

    def deformation(self, A, B):
        return (B.point(self.b) - A.point(self.a))[0]

    def energy(self, e):
        return 0.5 * self.wn**2 * e**2

    def dissipation(self, e, e_dot):
        return self.zeta * self.wn * e_dot**2


@pytest.mark.long
def test_an_oscillator_has_the_posterior_of_the_lattice():
    """D8: natural frequency, damping ratio and noise of a free decay."""
    t, x = np.loadtxt(data("oscillator_decay.csv"), delimiter=",", unpack=True)
    ends = (("world", "mass"), jnp.zeros(3), jnp.zeros(3))
    model = jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[0, 0, 0])},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
        elements={"o": Oscillator(*ends, jnp.array(6.2), jnp.array(0.05))},
    )
    run = jb.Experiment(
        t,
        initial=jb.State(jnp.array([1.0]), jnp.array([0.0])),
        sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
        measured={"x": x},
    )
    fit = jb.fit(model, {"run": run}, free=["o.wn", "o.zeta"])
    priors = {
        "o.wn": LogNormal(6, 0.5),
        "o.zeta": LogNormal(0.05, 0.5),
        "noise.x": LogNormal(0.05, 1),
    }
    drawn = posterior(fit, priors=priors)
    assert drawn.ok
    mode = drawn.density.unknowns.numbers(drawn.most_probable)[0]
    np.testing.assert_allclose(mode, [5.99572903, 0.04113159, 0.05112073], atol=1e-8)
    means = (1.7910472, -3.1910379, -2.9660398)
    deviations = (0.00074547, 0.0183897, 0.0503106)
    for i, (values, mean, deviation) in enumerate(
        zip(drawn.values.values(), means, deviations, strict=True)
    ):
        logs, size = np.log(values), min(drawn.ess_bulk[i], drawn.ess_tail[i])
        assert abs(logs.mean() - mean) < 4 * deviation / np.sqrt(size)
        assert abs(logs.std() / deviation - 1) < 4 / np.sqrt(size)


def two_springs():
    """The fit of two parallel springs by one frequency, which determines their sum."""
    springs = {
        name: jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=20.0)
        for name in ("one", "other")
    }
    model = jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
        elements=springs,
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    )
    tests = {"test": jb.MeasuredModes(frequency=[1.0], noise={"frequency": 0.01})}
    with pytest.warns(jb.JaxbodyWarning, match="NOT_IDENTIFIABLE"):
        return jb.fit(model, tests, free=["*.stiffness"])


def test_what_is_not_determined_is_refused_by_name():
    with pytest.raises(jb.JaxbodyError, match=r"one.stiffness up with other.stiffness down") as e:
        posterior(two_springs())
    assert e.value.code == "UNDETERMINED"


@pytest.mark.long
def test_a_prior_determines_what_the_data_do_not():
    """With a prior of one spring the other follows."""
    drawn = posterior(two_springs(), priors={"one.stiffness": LogNormal(15.0, 0.05)})
    assert abs(sum(drawn.means.values()) - (2 * np.pi) ** 2) < 0.5
    assert abs(drawn.means["one.stiffness"] - 15) < 0.2


def test_bad_input_is_refused(fit, drawn):
    robust = dataclasses.replace(fit, task=dataclasses.replace(fit.task, loss="cauchy"))
    with pytest.raises(jb.JaxbodyError, match="has the loss 'cauchy'"):
        posterior(robust)
    far = eqx.tree_at(lambda f: f.status, fit, jnp.asarray(jb.Status.FAR_OFF.value))
    with pytest.raises(jb.JaxbodyError, match="has the status FAR_OFF"):
        posterior(far)
    for priors, code in (
        ({"run.line.a": LogNormal(1.0, 1.0)}, "BAD_PRIOR"),
        ({"run.line.a": (1.0, -1.0)}, "BAD_PRIOR"),
        ({"run.line.c": (1.0, 1.0)}, "UNKNOWN_PATH"),
    ):
        with pytest.raises(jb.JaxbodyError) as error:
            posterior(fit, priors=priors)
        assert error.value.code == code
    with pytest.raises(jb.JaxbodyError, match=r"LogNormal.*above 0"):
        LogNormal(-1.0, 0.1)
    with pytest.raises(jb.JaxbodyError, match="NO_NOISE"):
        posterior(lines.fitted(priors=None, noise=None, y=0.5 + 2 * lines.TIMES))
    flat = posterior(lines.fitted(priors={"run.line.a": (0.0, 2.0)}))
    with pytest.raises(jb.JaxbodyError, match=r"no normalized prior of run\.line\.b") as error:
        evidence(flat)
    assert error.value.code == "FLAT_PRIOR"


def test_few_draws_are_not_converged_and_an_interrupt_keeps_them(fit, monkeypatch):
    with pytest.warns(jb.JaxbodyWarning, match="NOT_CONVERGED.*effective size"):
        few = posterior(fit, draws=50)
    assert few.y.shape == (4, 50, 2)
    further, calls = jb.fitting.posteriors.drawn_further, []

    def interrupted(*args):
        calls.append(args)
        if len(calls) > 3:
            raise KeyboardInterrupt
        return further(*args)

    monkeypatch.setattr("jaxbody.fitting.posteriors.drawn_further", interrupted)
    with pytest.warns(jb.JaxbodyWarning, match="INTERRUPTED"):
        assert posterior(fit).y.shape == (4, 150, 2)


def test_bounds_of_the_fit_hold():
    """A parameter at its bound: the posterior is that of the line cut there."""
    with pytest.warns(jb.JaxbodyWarning, match="AT_BOUND"):
        fit = jb.fit(
            lines.MODEL,
            lines.line(),
            free=lines.FREE,
            priors=lines.PRIORS,
            bounds={"run.line.b": (0.85, 5.0)},
        )
    drawn = posterior(fit, draws=4000)
    b, deviation = drawn.values["run.line.b"], np.sqrt(lines.C[1, 1])
    z = (0.85 - lines.MEAN[1]) / deviation
    mean = lines.MEAN[1] + deviation * norm.pdf(z) / norm.sf(z)
    assert b.min() >= 0.85 and drawn.rejected > 0 and drawn.divergences == 0
    assert abs(b.mean() - mean) < 4 * b.std() / np.sqrt(drawn.ess_bulk[1])


def test_bands_plots_and_tables_take_draws(fit, drawn):
    bands = jb.confidence_bands(drawn, lambda model: model["mass"].mass * jnp.ones(2))
    assert bands.value.shape == (2,) and (bands.standard_error < 1e-12).all()
    axes = drawn.plot()
    assert len(axes.child_axes) == 3
    profile = jb.fitting.profile_likelihood(fit, "run.line.a")
    assert len(plots.plot_profile_likelihood(profile, draws=drawn).figure.axes) == 2
    assert "run.line.b" in str(drawn) and "4 chains of 1000 draws, 0 divergences" in str(drawn)


def test_draws_are_xarrays_that_arviz_reads(drawn):
    pytest.importorskip("xarray", reason="needs jaxbody[xarray]")
    data = drawn.to_xarray()
    assert data["run.line.a"].dims == ("chain", "draw") and data["run.line.a"].units == "m"
    assert data.sizes == {"chain": 4, "draw": 1000}
    frame = drawn.to_pandas()
    assert len(frame) == 1000 and frame.attrs["units"]["run.line.b[3]"] == "m/s"


def test_gradients_are_those_of_differences():
    """Parameters and noise level, and the value in reverse mode."""
    density, (y, L) = prepared(lines.fitted(noise=None), {"noise.y": LogNormal(0.2, 0.5)})
    y = y + 0.3 * L.sum(1)
    value, gradient, _ = density.local(y)
    step = 1e-5 * np.eye(3)
    differences = [float(density.local(y + d)[0] - density.local(y - d)[0]) / 2e-5 for d in step]
    np.testing.assert_allclose(gradient, differences, rtol=1e-6, atol=1e-6)
    both = jax.value_and_grad(density)(y)
    np.testing.assert_allclose(both[0], value)
    np.testing.assert_allclose(both[1], gradient)
    prior = sum(prior.log_density(part) for prior, part in density._parts(y))
    np.testing.assert_allclose(density.pointwise(y).sum() + prior, value)


@pytest.mark.long
def test_numpyro_draws_from_the_same_posterior():
    """The judge: the line with unknown noise in numpyro's own words; means and standard deviations
    to four Monte Carlo errors."""
    numpyro = pytest.importorskip("numpyro")
    of, infer = numpyro.distributions, pytest.importorskip("numpyro.infer")

    def model():
        a = numpyro.sample("run.line.a", of.Normal(0.0, 2.0))
        b = numpyro.sample("run.line.b", of.Normal(0.0, 1.0))
        noise = numpyro.sample("noise.y", of.LogNormal(jnp.log(0.3), 0.5))
        numpyro.sample("y", of.Normal(a + b * lines.TIMES, noise), obs=jnp.asarray(lines.Y))

    judge = infer.MCMC(
        infer.NUTS(model), num_warmup=500, num_samples=4000, num_chains=1, progress_bar=False
    )
    judge.run(jax.random.key(5))
    theirs = {path: np.asarray(x) for path, x in judge.get_samples().items()}
    ours = posterior(lines.fitted(noise=None), priors={"noise.y": LogNormal(0.3, 0.5)}, draws=2000)
    for i, (path, x) in enumerate(ours.values.items()):
        error = x.std() * np.sqrt(1 / ours.ess_bulk[i] + 1 / 1500)
        assert abs(x.mean() - theirs[path].mean()) < 4 * error, path
        assert abs(x.std() / theirs[path].std() - 1) < 4 * np.sqrt(1 / ours.ess_tail[i] + 1 / 1500)
