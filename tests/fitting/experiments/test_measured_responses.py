"""Fits to frequency responses and modes, alone and combined with a record in time, against explicit
matrices of two masses."""

import itertools
import re

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from matplotlib.figure import Figure

import jaxbody as jb
from jaxbody import plots
from jaxbody.fitting.experiments.measurements import small_motions

# Two masses in a row on a base: base - k1, c1 - m1 - k2, c2 - m2.
TRUTH = {
    "lower.stiffness": 4000.0,
    "upper.stiffness": 900.0,
    "lower.damping": 12.0,
    "upper.damping": 5.0,
    "m2.mass": 1.5,
}
START = {
    path: value * factor
    for (path, value), factor in zip(TRUTH.items(), (1.3, 0.8, 1.4, 0.7, 1.2), strict=True)
}
M1 = 4.0
F = np.linspace(1.0, 9.0, 60)
PAIRS = (("x1", "force"), ("x2", "force"), ("x2", "base"))
SIGMA = {("x1", "force"): 2e-6, ("x2", "force"): 4e-6, ("x2", "base"): 0.02}
ALONG = dict(axis=[1, 0, 0])


def model_of(values, **options):
    k1, k2, c1, c2, m2 = values.values()
    return jb.Model(
        bodies={
            "m1": jb.Body(mass=M1, inertia=[1, 1, 1]),
            "m2": jb.Body(mass=m2, inertia=[1, 1, 1], position=[1, 0, 0]),
        },
        supports={"base": jb.Support(position=[-1, 0, 0])},
        joints={"m1": jb.Guide("world", **ALONG), "m2": jb.Guide("world", **ALONG)},
        elements={
            "lower": jb.Spring(
                ("base", [0, 0, 0]), ("m1", [0, 0, 0]), stiffness=k1, free_length=1.0, damping=c1
            ),
            "upper": jb.Spring(
                ("m1", [0, 0, 0]),
                ("m2", [0, 0, 0]),
                stiffness=k2,
                free_length=1.0,
                damping=c2,
                **options,
            ),
        },
    )


def matrices(p):
    k1, k2, c1, c2, m2 = p
    return (
        np.diag([M1, m2]),
        np.array([[c1 + c2, -c2], [-c2, c2]]),
        np.array([[k1 + k2, -k2], [-k2, k2]]),
        k1,
        c1,
    )


def responses(p):
    """{pair: H}, by NumPy: (K + i w C - w^2 M) x = (k1 + i w c1, 0) xi + (1, 0) f."""
    M, C, K, k1, c1 = matrices(p)
    s = 2j * np.pi * F
    D = K + s[:, None, None] * C + s[:, None, None] ** 2 * M
    right = np.stack(
        [np.stack([np.ones_like(s), 0 * s], -1), np.stack([k1 + c1 * s, 0 * s], -1)], -1
    )  # by force and by base
    x = np.linalg.solve(D, right)
    return {
        (f"x{i + 1}", name): x[:, i, j]
        for i in range(2)
        for j, name in enumerate(("force", "base"))
    }


def modal(p):
    """Frequencies, damping ratios to first order, shapes as rows."""
    M, C, K, *_ = matrices(p)
    w2, shapes = scipy.linalg.eigh(K, M)
    return np.sqrt(w2) / 2 / np.pi, np.diag(shapes.T @ C @ shapes) / 2 / np.sqrt(w2), shapes.T


def port(name, **options):
    return jb.Position(name, axis="x", **options)


def hammer(measured, noise=None, **options):
    inputs = {"force": jb.PointForce("m1", direction="x"), "base": jb.BaseMotion("base", "x")}
    return jb.MeasuredResponse(
        F,
        inputs=inputs,
        outputs={"x1": port("m1"), "x2": port("m2")},
        measured=measured,
        noise=noise,
        **options,
    )


def noisy(p, seed=0):
    rng = np.random.default_rng(seed)
    H = responses(p)
    return {
        pair: H[pair] + SIGMA[pair] * (rng.normal(size=len(F)) + 1j * rng.normal(size=len(F)))
        for pair in PAIRS
    }


def fit(measurements, **options):
    return jb.fit(model_of(START), measurements, free=list(TRUTH), **options)


def values(result):
    return np.array([float(result.estimates[path]) for path in TRUTH])


def optimum(residual):
    options = dict(jac="3-point", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    result = scipy.optimize.least_squares(
        lambda u: residual(np.exp(u)), np.log(list(TRUTH.values())), **options
    )
    return np.exp(result.x), result.jac


def parts(measured, p):
    H = responses(p)
    differences = [(H[pair] - measured[pair]) / SIGMA[pair] for pair in PAIRS]
    return np.concatenate(
        [np.stack([d.real, d.imag], -1)[~np.isnan(d)].ravel() for d in differences]
    )


@pytest.fixture(scope="module")
def measured():
    H = noisy(TRUTH.values(), seed=2)  # noise that looks white, as most seeds do
    H["x1", "force"][7:9] = np.nan
    return H


@pytest.fixture(scope="module")
def result(measured):
    return fit({"hammer": hammer(measured, SIGMA)})


@pytest.mark.nan
def test_a_fit_to_responses_is_scipys_with_its_standard_errors(result, measured):
    expected, J = optimum(lambda p: parts(measured, p))
    np.testing.assert_allclose(values(result), expected, rtol=1e-7)
    r = parts(measured, expected)
    Q, R = np.linalg.qr(J)  # each channel has its own variance: (J'J)^-1 J' diag(s2) J (J'J)^-1
    ends = np.cumsum([0] + [2 * (~np.isnan(measured[pair])).sum() for pair in PAIRS])
    M = sum(
        Q[i:j].T @ Q[i:j] * (r[i:j] @ r[i:j]) / (j - i - np.sum(Q[i:j] ** 2))
        for i, j in itertools.pairwise(ends)
    )
    made = result.to_xarray()
    np.testing.assert_array_equal(
        made["hammer_x1/force_measured"].sel(hammer_frequency=F), measured["x1", "force"]
    )
    errors = np.sqrt(np.diag(np.linalg.solve(R, np.linalg.solve(R, M).T))) * expected
    mine = np.array([float(result.standard_errors[path]) for path in TRUTH])
    print(mine / errors)
    np.testing.assert_allclose(mine, errors, rtol=1e-5)
    np.testing.assert_allclose(result.cost, 0.5 * r @ r, rtol=1e-8)
    assert result.uncertainty.samples == len(r) == 2 * (3 * len(F) - 2)
    np.testing.assert_allclose(
        [result.noise["hammer"][f"{y}/{u}"] / SIGMA[y, u] for y, u in PAIRS], 1, atol=0.15
    )
    assert re.search(r"\n  hammer.x1/force +\S+ +m/N\n", str(result))
    drawn = plots.plot_autocorrelation(result, sensor="x1/force", ax=Figure().subplots())
    assert (
        drawn.get_xlabel() == "lag [lines]"
        and drawn.get_legend().get_texts()[1].get_text() == "hammer.x1/force imaginary"
    )


@pytest.mark.long
def test_a_noise_for_every_frequency_weighs_every_frequency(measured):
    every = {pair: np.full(len(F), sigma) for pair, sigma in SIGMA.items()}
    every["x2", "base"][30:] *= 3
    weight = np.where(np.arange(len(F)) < 30, 1, 3)

    def residual(p):
        H = responses(p)
        differences = [(H[pair] - measured[pair]) / every[pair] for pair in PAIRS]
        return np.concatenate(
            [np.stack([d.real, d.imag], -1)[~np.isnan(d)].ravel() for d in differences]
        )

    expected, _ = optimum(residual)
    result = fit({"hammer": hammer(measured, every)})
    np.testing.assert_allclose(values(result), expected, rtol=1e-7)
    assert weight[-1] == 3 and "hammer.x2/base" in str(result)


@pytest.mark.long
def test_modes_alone_and_all_together_are_scipys(measured):
    rng = np.random.default_rng(5)
    frequency, damping, shapes = modal(TRUTH.values())
    scale = np.linalg.norm(shapes, axis=1, keepdims=True)
    test = dict(
        frequency=frequency * (1 + 1e-3 * rng.normal(size=2)),
        damping_ratio=damping * (1 + 0.05 * rng.normal(size=2)),
    )
    observed = -7 * (shapes / scale + 0.01 * rng.normal(size=(2, 2)))  # of any scale and sign
    noise = {"frequency": 1e-3, "damping_ratio": 1e-3, "shapes": 0.01}
    given = dict(**test, shapes=observed, sensors={"x1": port("m1"), "x2": port("m2")})
    modal_test = jb.MeasuredModes(**given, noise=noise)
    unit = observed / np.linalg.norm(observed, axis=1, keepdims=True)

    def modal_residual(p):
        f, z, x = modal(p)
        x = x * (np.sum(x * unit, 1) / np.sum(x * x, 1))[:, None]
        return np.concatenate(
            [
                (f - test["frequency"]) / 1e-3,
                (z - test["damping_ratio"]) / 1e-3,
                ((x - unit) / 0.01).ravel(),
            ]
        )

    alone = fit({"test": modal_test})
    expected, J = optimum(modal_residual)
    np.testing.assert_allclose(values(alone), expected, rtol=1e-6)
    # of the noise as stated: eight numbers tell no other
    errors = np.sqrt(np.diag(np.linalg.inv(J.T @ J))) * expected
    np.testing.assert_allclose(
        [float(x) for x in alone.standard_errors.values()], errors, rtol=1e-4
    )
    ends = [alone.intervals()[path] for path in alone.paths]
    np.testing.assert_allclose(
        ends,
        np.stack([expected * np.exp(s * 1.959964 * errors / expected) for s in (-1, 1)], 1),
        rtol=1e-4,
    )
    assert "noise as stated" in str(alone)
    careless = fit(
        {
            "test": jb.MeasuredModes(
                **given, noise={name: level / 30 for name, level in noise.items()}
            )
        }
    )
    assert "exceed the stated noise" in str(careless) and "exceed" not in str(alone)

    # of no model: it only has to be weighed
    record = np.cos(2 * np.pi * 1.2 * np.linspace(0, 1, 21))
    from scipy.integrate import solve_ivp

    def motion(p):
        M, C, K, *_ = matrices(p)
        A = np.block(
            [[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]]
        )
        times = np.linspace(0, 1, 21)
        return solve_ivp(
            lambda t, y: A @ y,
            (0, 1),
            [0.1, 0, 0, 0],
            t_eval=times,
            rtol=1e-12,
            atol=1e-14,
            method="DOP853",
        ).y[0]

    release = jb.Experiment(
        np.linspace(0, 1, 21),
        initial=jb.State(jnp.array([0.1, 0.0]), jnp.zeros(2)),
        sensors={"x": jb.Position("m1", **ALONG)},
        measured={"x": motion(TRUTH.values()) + 1e-3 * record},
        noise=1e-3,
    )
    together = fit(
        {"hammer": hammer(measured, SIGMA), "test": modal_test, "release": release}, rtol=1e-11
    )
    expected, _ = optimum(
        lambda p: np.concatenate(
            [
                parts(measured, p),
                modal_residual(p),
                (motion(p) - motion(TRUTH.values()) - 1e-3 * record) / 1e-3,
            ]
        )
    )
    print(values(together) / expected - 1)
    np.testing.assert_allclose(values(together), expected, rtol=1e-6)
    assert together.ok and {"hammer.x1/force", "test.frequency", "release.x"} <= set(
        str(together).split()
    )


@pytest.mark.nan
def test_a_measured_shape_is_compared_with_the_nearest_multiple_of_a_shape(rng):
    """By least squares over what was measured, of the shape of length one that is meant by any
    measured one."""
    model = model_of(TRUTH)
    sensors = {"x1": port("m1"), "x2": port("m2"), "twice": port("m2", gain=2.0)}
    observed = rng.normal(size=(2, 3))
    observed[1, 0] = np.nan
    test = jb.MeasuredModes(frequency=[1.0, 2.0], shapes=observed, sensors=sensors)
    found = test.readings(model, None, small_motions(model))["shapes"]
    for shape, mine, row in zip(modal(TRUTH.values())[2], found, observed, strict=True):
        shape, there = np.array([*shape, 2 * shape[1]]), ~np.isnan(row)
        row = row[there] / np.linalg.norm(row[there])
        scale = np.linalg.lstsq(shape[there][:, None], row)[0]
        np.testing.assert_allclose(mine, scale * shape, rtol=1e-9)


@pytest.mark.long
def test_pairing_by_shape_survives_another_order():
    """Measured in descending order, with sensors whose names are not in alphabetical order."""
    frequency, _, shapes = modal(TRUTH.values())
    shapes = shapes[::-1] / np.abs(shapes[::-1]).max(1, keepdims=True)
    sensors = {"low": port("m1"), "high": port("m2")}
    common = dict(
        frequency=frequency[::-1], noise={"frequency": 1e-3, "shapes": 0.01}, sensors=sensors
    )
    free = ["lower.stiffness", "upper.stiffness"]
    start = jb.replace(model_of(TRUTH), {"lower.stiffness": 4800.0, "upper.stiffness": 800.0})
    for options in (dict(pairing="mac"), dict(number=[1, 0])):
        result = jb.fit(
            start, {"test": jb.MeasuredModes(shapes=shapes, **common, **options)}, free=free
        )
        np.testing.assert_allclose(
            [float(x) for x in result.estimates.values()], [4000.0, 900.0], rtol=1e-8
        )


@pytest.mark.long
def test_a_loss_factor_and_the_place_of_a_sensor_can_be_free():
    eta = {"lower": 0.08}
    model = model_of(TRUTH)
    lin = jb.linearize(model, jb.equilibrium(model))
    inputs, outputs = {"force": jb.PointForce("m1", direction="x")}, {"x1": port("m1")}
    H = jb.frequency_response(lin, F, inputs, outputs, loss_factor=eta)["x1", "force"]
    given = jb.MeasuredResponse(
        F,
        inputs=inputs,
        outputs=outputs,
        measured={("x1", "force"): H},
        noise=1e-6,
        loss_factor={"lower": 0.03},
    )
    result = jb.fit(model, {"hammer": given}, free=["hammer.loss_factor.lower", "lower.stiffness"])
    np.testing.assert_allclose(
        [float(x) for x in result.estimates.values()], [0.08, 4000.0], rtol=1e-7
    )


def codes_of(function):
    with pytest.raises(jb.JaxbodyError) as error:
        function()
    return [(p.code, p.where) for p in error.value.problems]


@pytest.mark.long
def test_what_is_wrong_with_them_is_reported_at_once(measured):
    bad = {
        ("x1", "force"): measured["x1", "force"][:5],
        ("x3", "force"): measured["x1", "force"],
        ("x2", "base"): np.full(len(F), np.nan),
    }
    assert codes_of(lambda: hammer(bad, {("x1", "force"): 0.0, ("x1", "base"): 1.0})) == [
        ("BAD_SHAPE", "MeasuredResponse.measured[('x1', 'force')]"),
        ("UNKNOWN_NAME", "MeasuredResponse.measured[('x3', 'force')]"),
        ("ALL_NAN", "MeasuredResponse.measured[('x2', 'base')]"),
        ("BAD_NOISE", "MeasuredResponse.noise[('x1', 'force')]"),
        ("UNKNOWN_NAME", "MeasuredResponse.noise[('x1', 'base')]"),
    ]
    result = codes_of(
        lambda: jb.MeasuredModes(
            frequency=[1.0, 2.0], damping_ratio=[0.1], pairing="mac", noise={"shapes": 1.0}
        )
    )
    assert [code for code, _ in result] == ["BAD_SHAPE", "BAD_PAIRING", "UNKNOWN_NAME"]
    assert codes_of(lambda: jb.MeasuredModes(frequency=[-1.0, 2.0])) == [
        ("BAD_FREQUENCY", "MeasuredModes.frequency")
    ]
    ports = {"inputs": hammer(measured).inputs, "outputs": hammer(measured).outputs}
    assert codes_of(
        lambda: jb.MeasuredResponse([3, 2, -1], measured={("x1", "g"): [1j, 2]}, **ports)
    ) == [
        ("BAD_FREQUENCY", "MeasuredResponse.frequencies"),
        ("UNKNOWN_NAME", "MeasuredResponse.measured[('x1', 'g')]"),
        ("BAD_SHAPE", "MeasuredResponse.measured[('x1', 'g')]"),
    ]
    wrong = hammer(measured).outputs | {"x2": port("m3")}
    response = jb.MeasuredResponse(
        F, inputs=hammer(measured).inputs, outputs=wrong, measured=measured
    )
    assert codes_of(lambda: fit({"hammer": response})) == [("UNKNOWN_NAME", "hammer.outputs['x2']")]
    assert codes_of(lambda: fit({"test": jb.MeasuredModes(frequency=[1.0, 2.0, 3.0])})) == [
        ("BAD_SHAPE", "test.frequency")
    ]


@pytest.mark.long
def test_a_start_that_is_unstable_is_reported_by_its_frequency(measured):
    with pytest.warns(jb.JaxbodyWarning, match="NEGATIVE_DAMPING"):
        falling = model_of(START | {"upper.damping": -60.0}, allow_negative=True)
    with pytest.raises(jb.JaxbodyError) as error:
        jb.fit(falling, {"hammer": hammer(measured)}, free=["lower.stiffness"])
    assert error.value.problems[0].code == "NONFINITE_START" and "from 1 Hz on" in str(error.value)
