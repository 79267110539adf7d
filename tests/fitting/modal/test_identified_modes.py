"""Modes from responses: given and measured data, the coverage of intervals, another program, and
what cannot be identified."""

import numpy as np
import pytest
from chains import C, K, M, accelerance, free_poles, periodic_test, random_test, record
from data import data
from scipy.linalg import eigh

import jaxbody as jb

TRUE = free_poles(M, C, K)
FREQUENCY, RATIO = np.abs(TRUE) / (2 * np.pi), -TRUE.real / np.abs(TRUE)


def given(**changes):
    """Return the responses of data/modal_given.csv (REFERENCES3 4)."""
    x = np.genfromtxt(data("modal_given.csv"), delimiter=",", skip_header=1).T
    channels = {"f3": (x[0], "N"), "f1": (x[1], "N")}
    channels |= {f"a{i}": (x[1 + i], "m/s2") for i in (1, 2, 3)}
    record = jb.Record(None, channels, rate=128.0)
    return jb.modal.estimate_responses(
        record, **{"inputs": ["f3", "f1"], "outputs": ["a1", "a2", "a3"],
        "segment": 8.0, "window": "boxcar", "band": (0.1, 50)} | changes,
    )  # fmt: skip


def test_the_given_test_holds_its_truth():
    responses = given()
    e = responses.estimate
    at = np.argmin(np.abs(e.frequencies - 8))
    truth = [0.269263569 - 0.00001832j, 0.446934853 + 0.003615791j, 0.356779209 + 0.01596776j]
    error = (e.H[at, :, 0] - truth) / e.spread[at, :, 0]
    assert (np.abs([error.real, error.imag]) < 2.9).all()  # 99 % of six numbers, Bonferroni
    f = e.frequencies
    relative = np.abs(e.H / accelerance(f)[:, :, [2, 0]] - 1)
    printed = {"all": 0.022, "a1": 0.015, "a2": 0.049, "a3": 0.015}  # to the digits given
    for name, median in printed.items():
        own = relative if name == "all" else relative[:, int(name[1]) - 1]
        assert abs(np.median(own) - median) < (5e-4 if name in ("all", "a2") else 2e-3)
    i = jb.modal.identify_modes(responses, driving_point=("a3", "f3")).identification
    printed = [5.65788372, 12.35857981, 18.23214687], [0.00739985, 0.01800507, 0.02405365]
    assert (np.abs(i.frequency - printed[0]) < 2.58 * i.frequency_error).all()
    assert (np.abs(i.damping_ratio - printed[1]) < 2.58 * i.damping_error).all()
    assert i.frequency_error.max() < 2e-4 and i.damping_error.max() < 1e-5
    # mass-normalized shapes of the undamped system; its damping is proportional but for 1 %
    shapes = eigh(K, M)[1]
    shapes = shapes * np.sign(np.take_along_axis(shapes, np.abs(shapes).argmax(0)[None], 0))
    assert np.allclose(i.shapes.real, shapes.T, atol=3e-3)
    assert np.allclose(i.modal_mass, 1 / np.abs(shapes).max(0) ** 2, rtol=1e-2)
    assert (i.complexity < 1e-3).all() and i.fit.converged


def intervals(make, noise, runs, model=(TRUE, ("a0", "a1", "a2")), **options):
    """Return the errors of frequencies and damping ratios over their standard errors."""
    errors = []
    for seed in range(runs):
        made = make(np.random.default_rng(seed), noise)
        responses = jb.modal.estimate_responses(
            made, inputs=["f0"], outputs=model[1], band=(1, 27), **options
        )
        i = jb.modal.identify_modes(responses, order=16).identification
        assert len(i.poles) == len(model[0])
        frequency, ratio = np.abs(model[0]) / (2 * np.pi), -model[0].real / np.abs(model[0])
        errors.append((i.frequency - frequency) / i.frequency_error)
        errors.append((i.damping_ratio - ratio) / i.damping_error)
    return np.array(errors)


def test_intervals_hold_the_truth():
    """204 intervals at 95 %, three binomial standard errors of 1.5 %."""
    errors = intervals(periodic_test, 0.02, 34)
    assert errors.size == 204 and 0.905 < np.mean(np.abs(errors) < 1.96) < 0.995


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:the inputs explain nothing")  # of the far mass, at many lines
@pytest.mark.parametrize("noise", [0.02, 0.1])
@pytest.mark.parametrize(
    ("make", "options"), [(periodic_test, {}), (random_test, {"segment": 64.0})]
)
def test_two_thousand_intervals_hold_the_truth(make, options, noise):
    errors = intervals(make, noise, 340, **options)
    assert errors.size == 2040
    assert 0.93 < np.mean(np.abs(errors) < 1.96) < 0.97


def plate_test(rng, noise):
    """Return six periods of a multisine on a corner of the plate on four springs, with the
    vertical accelerations of its corners, from its mass and stiffness matrices."""
    lin = plate()
    B, Y = lin[3]
    count, f = 4096, np.fft.rfftfreq(4096, 1 / 64.0)
    s = 2j * np.pi * f[1:, None, None]
    X = np.exp(2j * np.pi * rng.uniform(size=len(f))) * ((f > 0) & (f < 28))
    Z = np.zeros((len(f), 4), complex)
    Z[1:] = (s**2 * (Y @ np.linalg.solve(lin[0] * s**2 + lin[1] * s + lin[2], B)))[..., 0] * X[
        1:, None
    ]
    x, y = (np.fft.irfft(one, count, axis=0) * 64 for one in (X[:, None], Z))
    return record(np.tile(x, (6, 1)), np.tile(y, (6, 1)), noise, rng)


def plate():
    """Return M, C, K of heave, pitch and roll of a plate of 20 kg on four springs at its corners,
    and the matrices of the force at one corner and of the motions of all."""
    corners = np.array([[0.5, 0.3], [0.5, -0.3], [-0.5, 0.3], [-0.5, -0.3]])
    rows = np.column_stack([np.ones(4), corners[:, 1], -corners[:, 0]])
    k, c = np.array([9e3, 8e3, 12e3, 10e3]), np.array([30.0, 25.0, 28.0, 35.0])
    return (
        np.diag([20.0, 0.9, 2.2]),
        rows.T * c @ rows,
        rows.T * k @ rows,
        (rows.T[:, :1], rows),
    )


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_two_thousand_intervals_of_a_plate_hold_the_truth(noise):
    names = ("a0", "a1", "a2", "a3")
    errors = intervals(plate_test, noise, 340, model=(free_poles(*plate()[:3]), names))
    assert 0.93 < np.mean(np.abs(errors) < 1.96) < 0.97


def test_output_only_identifies_the_same_modes():
    """Ambient vibration by white forces on all masses: 99.9 % limits of six numbers."""
    made = random_test(np.random.default_rng(2), 0.05, driven=(0, 1, 2), seconds=2048, highest=31)
    spectra = jb.modal.positive_spectra(
        made, references=["a0", "a2"], outputs=["a0", "a1", "a2"], segment=16.0, band=(3, 24)
    )
    assert "40 parts" in repr(spectra) and "(m/s2) (m/s2)/Hz" in repr(spectra)
    i = jb.modal.identify_modes(spectra).identification
    assert (np.abs(i.frequency - FREQUENCY) < 3.3 * i.frequency_error).all()
    assert (np.abs(i.damping_ratio - RATIO) < 3.3 * i.damping_error).all()
    assert (i.damping_error < 0.06 * RATIO).all()
    with pytest.raises(jb.JaxbodyError, match="WRONG_KIND"):
        spectra.check(None, "test")
    with pytest.raises(jb.JaxbodyError, match="TOO_SHORT"):
        jb.modal.positive_spectra(made.part(0, 60), references=["a0"], outputs=["a1"], segment=16.0)


def stable_poles_of_sdypy(f, H, form):
    """Return the poles (frequency, damping ratio) by order that sdypy-EMA finds."""
    ema = pytest.importorskip("sdypy.EMA")
    model = ema.Model(H.T, f, lower=f[0], upper=f[-1], pol_order_high=40, frf_form=form)
    model.get_poles(method="lscf", show_progress=False)
    return model.pole_freq, model.pole_xi


def judged(f, H, i, form="accelerance", within=0.01):
    """Check identified modes against sdypy-EMA: its poles near each mode, over the orders of the
    upper half, scatter about a mean that differs by no more than this scatter allows."""
    frequencies, ratios = stable_poles_of_sdypy(f, H, form)
    for frequency, ratio in zip(i.frequency, i.damping_ratio, strict=True):
        near = []
        for fs, xs in zip(frequencies[20:], ratios[20:], strict=True):
            close = np.flatnonzero(
                (np.abs(fs / frequency - 1) < within) & (np.abs(xs / ratio - 1) < 0.5)
            )
            near += [(fs[k], xs[k]) for k in close[:1]]
        assert len(near) > 10
        mean, scatter = np.mean(near, 0), np.std(near, 0)
        assert abs(mean[0] - frequency) < 4 * scatter[0] + 1e-3 * frequency
        assert abs(mean[1] - ratio) < 4 * scatter[1] + 0.03 * ratio


@pytest.mark.parametrize("case", ["given", "periodic", "random"])
def test_another_program_finds_the_same_poles(case):
    if case == "given":
        responses = given(inputs=["f3", "f1"])
    else:
        make, segment = (periodic_test, None) if case == "periodic" else (random_test, 64.0)
        responses = jb.modal.estimate_responses(
            make(np.random.default_rng(1), 0.02), inputs=["f0"], outputs=["a0", "a1", "a2"],
            segment=segment, band=(1, 27),
        )  # fmt: skip
    i = jb.modal.identify_modes(responses).identification
    judged(responses.estimate.frequencies, responses.estimate.H[:, :, 0], i)


def test_two_levels_of_the_silverbox():
    """The electrical oscillator with a hardening spring: its linear mode at a low and at a high
    level of the arrow-head test, whose amplitude grows."""
    import gzip

    with gzip.open(data("silverbox", "SNLS80mV.csv.gz"), "rt") as file:
        V = np.genfromtxt(file, delimiter=",", skip_header=1)
    rate = 1e7 / 2**14
    modes = []
    for part in (slice(2000, 14000), slice(28000, 40000)):
        x, y = V[part, 0] - V[part, 0].mean(), V[part, 1] - V[part, 1].mean()
        responses = jb.modal.estimate_responses(
            jb.Record(None, {"u": (x, "V"), "x": (y, "V")}, rate=rate),
            inputs=["u"], outputs=["x"], segment=0.8, band=(30, 130),
        )  # fmt: skip
        i = jb.modal.identify_modes(responses).identification
        modes.append((i, np.median(responses.estimate.coherence)))
        assert len(i.poles) == 1
        e = responses.estimate
        judged(
            e.frequencies, e.H[:, :, 0], i, "receptance", within=0.03
        )  # where its poles scatter by 1 %
    (low, calm), (high, strong) = modes
    # it hardens: the frequency rises by far more than its errors, the coherence falls
    assert high.frequency[0] - low.frequency[0] > 10 * high.frequency_error[0]
    assert 65 < low.frequency[0] < high.frequency[0] < 75 and calm > strong


def test_modes_of_responses_of_another_source():
    """Exact responses without stated noise: poles and mass-normalized shapes to rounding."""
    f = np.linspace(2, 25, 400)
    H = accelerance(f)
    inputs = {f"f{i}": jb.PointForce("m", direction="x") for i in range(2)}
    outputs = {f"a{i}": jb.Acceleration("m", axis="x") for i in range(3)}
    pairs = {(f"a{i}", f"f{j}"): H[:, i, j] for i in range(3) for j in range(2)}
    test = jb.MeasuredResponse(f, inputs=inputs, outputs=outputs, measured=pairs)
    made = jb.modal.identify_modes(test, driving_point=("a1", "f1"))
    i = made.identification
    assert np.allclose(i.poles, TRUE, rtol=1e-8) and list(made.channels) == [
        "frequency", "damping_ratio", "shapes",
    ]  # fmt: skip
    above = jb.modal.identify_modes(test, band=(10, 25)).identification
    assert np.allclose(above.poles, TRUE[1:], rtol=1e-4)  # the first mode is a residual term
    del pairs["a2", "f1"]
    lacking = jb.MeasuredResponse(f, inputs=inputs, outputs=outputs, measured=pairs)
    with pytest.raises(jb.JaxbodyError, match="lacks the pair"):
        jb.modal.identify_modes(lacking)


def test_what_cannot_be_identified_is_named():
    responses = given()
    with pytest.raises(jb.JaxbodyError, match="UNDETERMINED"):
        jb.modal.identify_modes(responses, band=(5, 10), order=30)
    with pytest.raises(jb.JaxbodyError, match="BAD_BAND"):
        jb.modal.identify_modes(responses, band=(90, 95))
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_NAME"):
        jb.modal.identify_modes(responses, driving_point=("a9", "f3"))
    with pytest.raises(jb.JaxbodyError, match="stable"):
        jb.modal.identify_modes(responses, band=(35, 40), order=8)
    with pytest.raises(jb.JaxbodyError, match="8 or more"):
        jb.modal.identify_modes(responses, band=(5, 5.5))
    with pytest.raises(jb.JaxbodyError, match="NO_DATA"):
        jb.modal.identify_modes(responses).mac(None)
    made = random_test(np.random.default_rng(3), 0.02, seconds=128)
    coarse = jb.modal.estimate_responses(
        made, inputs=["f0"], outputs=["a1", "a2"], segment=8.0, band=(1, 27)
    )
    with pytest.warns(jb.JaxbodyWarning, match="LEAKAGE"):
        jb.modal.identify_modes(coarse)


def chain_model(springs):
    """Return the chain as a model: masses of 4, 3 and 2 kg on guides, with three springs."""
    names = ("p", "q", "r")
    ends = [("world", [0, 0, 0]), *((name, [i + 1.0, 0, 0]) for i, name in enumerate(names))]
    masses = dict(zip(names, (4, 3, 2), strict=True))
    return jb.Model(
        bodies={name: jb.Body(mass=m, inertia=[1, 1, 1]) for name, m in masses.items()},
        joints={name: jb.Guide("world", axis=[1, 0, 0]) for name in names},
        elements={
            f"s{i}": jb.Spring(ends[i + 1], ends[i], stiffness=k, damping=c, free_length=1.0)
            for i, (k, c) in enumerate(zip(springs, (8.0, 6.0, 4.0), strict=True))
        },
    )


def test_modes_fit_a_model():
    """The whole way from records to springs, whose true values lie inside the 99 % intervals."""
    outputs = {f"a{i}": jb.Acceleration(name, axis="x") for i, name in enumerate("pqr")}
    responses = jb.modal.estimate_responses(
        periodic_test(np.random.default_rng(4), 0.02), inputs=["f0"], outputs=outputs, band=(1, 27)
    )
    found = jb.modal.identify_modes(responses)
    true = chain_model([2e4, 1.5e4, 8e3])
    assert np.diag(found.mac(true)).min() > 0.999
    fit = jb.fit(
        chain_model([1.5e4, 1.5e4, 1e4]),
        {"test": found},
        free=["s0.stiffness", "s1.stiffness", "s2.stiffness"],
    )
    for i, k in enumerate([2e4, 1.5e4, 8e3]):
        low, high = fit.intervals(0.99)[f"s{i}.stiffness"]
        assert low < k < high < 1.02 * k
    assert "complexity" in repr(found)


def test_a_band_that_ends_in_a_resonance_is_a_misfit():
    responses = jb.modal.estimate_responses(
        periodic_test(np.random.default_rng(5), 0.001),
        inputs=["f0"],
        outputs=["a1", "a2"],
        band=(1, 27),
    )
    with pytest.warns(jb.JaxbodyWarning, match="MISFIT"):
        jb.modal.identify_modes(responses, band=(4, 18))
