"""Responses from records: exact biases, scipy.signal's spectra, the scatter of simulated tests,
windows, periods, hits, and what cannot be estimated."""

import warnings

import numpy as np
import pytest
from chains import RATE, accelerance, periodic_test, random_test
from scipy.signal import csd, lti
from scipy.stats import t

import jaxbody as jb
from jaxbody.fitting.modal.segments import independent_averages, period_of


def orthogonal_segments(n, o, H, lines=32):
    """Return channels x, y of four segments whose noises, relative to input and output power, are
    orthogonal to each other and to the motion at every line."""
    rng = np.random.default_rng(3)
    base = np.exp(2j * np.pi * rng.uniform(size=lines + 1))
    base[[0, -1]] = 0
    signs = np.array([[1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1]])
    x = base * (signs[0] + np.sqrt(n) * signs[1])[:, None]
    y = H * base * (signs[0] + np.sqrt(o) * signs[2])[:, None]
    return [np.fft.irfft(z, 2 * lines).ravel() for z in (x, y)]


def test_noise_gives_the_exact_biases():
    """REFERENCES3 4: H1 = H/(1 + n), H2 = H(1 + o), coherence 1/((1 + n)(1 + o))."""
    x, y = orthogonal_segments(0.1, 0.05, 2.0)
    record = jb.Record(None, {"x": (x, "N"), "y": (y, "m")}, rate=64.0)
    found = {
        method: jb.modal.estimate_responses(
            record,
            inputs=["x"],
            outputs=["y"],
            method=method,
            segment=1.0,
            window="boxcar",
            band=(1, 31),
        ).estimate
        for method in ("H1", "H2", "Hv")
    }
    assert np.allclose(found["H1"].H / 2, 0.9090909091, atol=1e-10)
    assert np.allclose(found["H2"].H / 2, 1.05, atol=1e-10)
    assert np.allclose(found["H1"].coherence, 0.8658008658, atol=1e-10)
    # of one input, the geometric mean of both
    assert np.allclose(found["Hv"].H ** 2, found["H1"].H * found["H2"].H, rtol=1e-12)
    assert abs(jb.modal.random_error(0.95, 32) - 0.02867696673) < 1e-11


def test_spectra_are_those_of_scipy():
    record = random_test(np.random.default_rng(0), 0.1, seconds=64)
    options = {"fs": RATE, "nperseg": 256, "noverlap": 192, "window": "hamming"}
    found = jb.modal.estimate_responses(
        record, inputs=["f0"], outputs=["a0", "a2"], segment=4.0, window="hamming", overlap=0.75,
        band=(1, 27),
    ).estimate  # fmt: skip
    f, power = csd(record["f0"], record["f0"], **options)
    kept = (f >= 1) & (f <= 27)
    for i, name in enumerate(("a0", "a2")):
        cross = csd(record["f0"], record[name], **options)[1]
        own = csd(record[name], record[name], **options)[1].real
        assert np.allclose(found.H[:, i, 0], (cross / power)[kept], rtol=1e-12)
        coherence = np.abs(cross) ** 2 / power.real / own
        assert np.allclose(found.coherence[:, i], coherence[kept], rtol=0, atol=1e-12)


def test_averages_of_overlapping_segments():
    """Welch: half overlap of Hann windows correlates neighbors by 1/6."""
    hann = np.sin(np.pi * np.arange(512) / 512) ** 2
    n = 40
    exact = n / (1 + 2 * (n - 1) / n / 36)
    assert abs(independent_averages(hann, 256, [n]) - exact) < 1e-9
    assert independent_averages(np.ones(512), 512, [n]) == n


@pytest.mark.parametrize(("make", "noise"), [(periodic_test, 0.05), (random_test, 0.1)])
def test_random_errors_are_those_of_simulated_tests(make, noise):
    """Of 200 tests, real and imaginary parts within Student's 95 % limits: the binomial error is
    0.1 %, that of overlapping windows counted as independent averages somewhat more."""
    inside = []
    for seed in range(200):
        options = {} if make is periodic_test else {"seconds": 512}
        record = make(np.random.default_rng(seed), noise, **options)
        e = jb.modal.estimate_responses(
            record, inputs=["f0"], outputs=["a1", "a2"],
            segment=None if make is periodic_test else 32.0, band=(20, 27),
        ).estimate  # fmt: skip
        error = (e.H - accelerance(e.frequencies)[:, 1:, 2:]) / e.spread
        limit = t.ppf(0.975, 2 * e.averages.freedom)
        inside.append(np.abs([error.real, error.imag]) < limit)
    assert 0.94 < np.mean(inside) < 0.96


def test_two_inputs_are_conditioned():
    """Partial coherences are those of the residual spectra (Bendat and Piersol, sec. 7.3): of what
    remains of output and one input without the other."""
    rng = np.random.default_rng(4)
    x = rng.normal(size=(2, 40000))
    x[1] += 0.7 * x[0]
    y = 2 * x[0] - 3 * x[1] + 2 * rng.normal(size=40000)
    record = jb.Record(None, {"p": (x[0], "N"), "q": (x[1], "N"), "y": (y, "m")}, rate=100.0)
    found = jb.modal.estimate_responses(
        record, inputs=["p", "q"], outputs=["y"], segment=1.0
    ).estimate
    assert np.allclose(np.median(found.H.real, 0), [[2, -3]], atol=0.05)
    options = {"fs": 100.0, "nperseg": 100, "noverlap": 50}
    S = {a + b: csd(record[a], record[b], **options)[1][1:] for a in "pqy" for b in "pqy"}
    for own, other, column in (("p", "q", 0), ("q", "p", 1)):
        rest = {
            a + b: S[a + b] - S[a + other] * S[other + b] / S[other + other]
            for a, b in ((own, "y"), (own, own), ("y", "y"))
        }
        partial = np.abs(rest[own + "y"]) ** 2 / (rest[own + own] * rest["yy"]).real
        assert np.allclose(found.partial[:, 0, column], partial, atol=1e-9)


def test_total_least_squares_of_two_inputs_without_noise():
    record = random_test(np.random.default_rng(5), 0.0, driven=(2, 0), seconds=256)
    each = [
        jb.modal.estimate_responses(
            record, inputs=["f0", "f1"], outputs=["a1"], method=method, segment=64.0, band=(20, 27)
        ).estimate.H
        for method in ("H1", "Hv")
    ]
    assert np.allclose(each[0], each[1], rtol=0.02)


def test_a_periodic_input_is_found_and_its_transient_left_out():
    rng = np.random.default_rng(6)
    steady = periodic_test(rng, 0.02, period=8, periods=8)
    assert period_of(steady["f0"]) == 8 * RATE
    assert period_of(random_test(rng, 0.0, seconds=64)["f0"]) is None
    assert period_of(np.ones(512)) is None
    late = {name: (x.copy(), steady.units[name]) for name, x in steady.channels.items()}
    late["a1"][0][:256] += np.exp(-np.arange(256) / 50) * steady["a1"].std() * 3
    found = jb.modal.estimate_responses(
        jb.Record(steady.times, late), inputs=["f0"], outputs=["a1"], band=(1, 27)
    )
    assert "7 periods of 8 s" in repr(found) and "1 at the beginning left out" in repr(found)
    exact = accelerance(found.estimate.frequencies)[:, 1, 2]
    error = np.abs(found.estimate.H[:, 0, 0] - exact) / found.estimate.spread[:, 0, 0]
    assert np.median(error) < 2
    with pytest.raises(jb.JaxbodyError, match="TOO_SHORT"):
        jb.modal.estimate_responses(
            steady.part(0, 15.9), inputs=["f0"], outputs=["a1"], segment=16.0
        )


def test_two_periodic_inputs_need_two_records():
    rng = np.random.default_rng(7)
    records = [periodic_test(rng, 0.02, driven=(2, 0), period=8) for _ in range(2)]
    with pytest.raises(jb.JaxbodyError, match=r"DEPENDENT_INPUTS|coherence") as error:
        jb.modal.estimate_responses(records[0], inputs=["f0", "f1"], outputs=["a1"], band=(1, 27))
    assert "'f0'" in str(error.value) and "'f1'" in str(error.value)
    found = jb.modal.estimate_responses(
        records, inputs=["f0", "f1"], outputs=["a1"], band=(1, 27)
    ).estimate
    error = found.H - accelerance(found.frequencies)[:, 1:2, [2, 0]]
    assert np.median(np.abs(error) / found.spread) < 2


def hits(decay, rng, noise=0.0):
    """Return a record of hammer blows of 8 ms on an oscillator of 10 Hz and 1 %, two of them too
    close together, and the response of the oscillator."""
    rate, p = 1000.0, 2j * np.pi * 10 * np.sqrt(1 - 1e-4) - 2 * np.pi * 0.1
    times = np.arange(50000) / rate
    force = np.zeros_like(times)
    for at in (2.0, 12.0, 22.0, 22.5, 32.0, 42.0):
        inside = np.abs(times - at) < 0.004
        force[inside] += np.cos((times[inside] - at) * np.pi / 0.008) ** 2
    system = lti([1.0], [1.0, -2 * p.real, abs(p) ** 2])
    x = system.output(force, times)[1]
    x = x + noise * x.std() * rng.normal(size=times.size)
    force = force + 1e-5 * rng.normal(size=times.size)
    return jb.Record(times, {"f": (force, "N"), "x": (x, "m")}), p


def test_hits_with_windows_and_the_damping_they_add():
    record, p = hits(0.5, np.random.default_rng(8), noise=0.01)
    window = jb.modal.ImpactWindow(pulse=0.01, decay=1.0)
    found = jb.modal.estimate_responses(
        record, inputs=["f"], outputs=["x"], segment=4.0, window=window, band=(2, 30)
    )
    assert "4 hits" in repr(found) and "1 double hits left out" in repr(found)
    # the windowed response is that of poles moved by -1/decay, exactly
    s = 2j * np.pi * found.estimate.frequencies
    moved = p - 1.0
    exact = 1 / ((s - moved) * (s - moved.conjugate()))
    error = (found.estimate.H[:, 0, 0] - exact) / found.estimate.spread[:, 0, 0]
    assert np.sqrt(np.mean(np.abs(error) ** 2)) < 3
    i = jb.modal.identify_modes(found, order=12).identification
    assert len(i.poles) == 1 and abs(i.frequency[0] - 10) < 4 * i.frequency_error[0]
    assert abs(i.damping_ratio[0] - 0.01) < 4 * i.damping_error[0] < 1e-3
    model = jb.Model(bodies={"b": jb.Body(mass=1, inertia=[1, 1, 1])})
    with pytest.raises(jb.JaxbodyError, match="exponential window"):
        found.check(model, "test")


def test_a_shaking_table_drives_its_model():
    """The acceleration of the table as the input of the model, that of the mass as its output."""
    guide = jb.Guide("world", axis=[0, 0, 1])
    model = jb.Model(
        bodies={"m": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        joints={"m": guide},
        supports={"table": jb.Support()},
        elements={
            "s": jb.Spring(
                ("m", [0, 0, 0]), ("table", [0, 0, -1]), stiffness=5e3, damping=8.0, free_length=1.0
            )
        },
    )
    inputs = {"t": jb.BaseMotion("table", "z", kind="acceleration")}
    outputs = {"a": jb.Acceleration("m", axis="z")}
    rng, count = np.random.default_rng(9), 16 * 256
    f = np.fft.rfftfreq(count, 1 / 256.0)
    lin = jb.linearize(model, jb.equilibrium(model))
    H = np.zeros(len(f), complex)
    H[1:] = np.asarray(jb.frequency_response(lin, f[1:], inputs, outputs)["a", "t"])
    X = np.exp(2j * np.pi * rng.uniform(size=len(f))) * ((f > 0) & (f < 40))
    x, y = (np.tile(np.fft.irfft(Z, count) * 64, 6) for Z in (X, H * X))
    y = y + 0.02 * y.std() * rng.normal(size=y.size)
    record = jb.Record(None, {"t": (x, "m/s2"), "a": (y, "m/s2")}, rate=256.0)
    found = jb.modal.estimate_responses(record, inputs=inputs, outputs=outputs, band=(1, 39))
    fit = jb.fit(
        jb.replace(model, {"s.stiffness": 4e3, "s.damping": 5.0}),
        {"shaking": found},
        free=["s.stiffness", "s.damping"],
    )
    for name, true in (("s.stiffness", 5e3), ("s.damping", 8.0)):
        low, high = fit.intervals(0.99)[name]
        assert low < true < high < 1.05 * true
    with pytest.raises(jb.JaxbodyError, match="WRONG_DIMENSION"):
        jb.modal.estimate_responses(
            record, inputs={"t": jb.BaseMotion("table", "z")}, outputs=outputs
        )


def test_what_cannot_be_estimated_is_named():
    record = random_test(np.random.default_rng(10), 0.1, seconds=16)

    def refused(code, text="", **changes):
        given = {"inputs": ["f0"], "outputs": ["a0"], "segment": 2.0} | changes
        with pytest.raises(jb.JaxbodyError, match=code) as error:
            jb.modal.estimate_responses(changes.pop("record", record), **given)
        assert text in str(error.value)

    refused("TOO_SHORT", "16", segment=30.0)
    refused("TOO_SHORT", "independent averages", segment=16.0)
    refused("UNKNOWN_CHANNEL", "a0", outputs=["b0"])
    refused("BAD_METHOD", method="H3")
    refused("BAD_METHOD", inputs=["f0", "a2"], method="H2")
    refused("BAD_OPTION", window="triangular hat")
    refused("BAD_OPTION", "segment=", window=jb.modal.ImpactWindow(), segment=None)
    refused("BAD_NUMBER", overlap=1.0)
    refused("BAD_NUMBER", segment=0.0)
    refused("BAD_BAND", "lines", band=(20, 10))
    refused("NO_DATA", inputs=[])
    with pytest.raises(jb.JaxbodyError, match="BAD_NUMBER"):
        jb.modal.ImpactWindow(decay=-1.0)
    gaps = record["a0"].copy()
    gaps[3] = np.nan
    holed = jb.Record(record.times, {"f0": (record["f0"], "N"), "a0": (gaps, "m/s2")})
    with pytest.raises(jb.JaxbodyError, match="MISSING"):
        jb.modal.estimate_responses(holed, inputs=["f0"], outputs=["a0"], segment=2.0)


def test_outputs_without_coherence_are_named_with_their_lines():
    rng = np.random.default_rng(11)
    record = random_test(rng, 0.0, seconds=256, highest=10.0)
    noisy = {name: (x + 1e-3 * rng.normal(size=x.size), record.units[name])
             for name, x in record.channels.items()}  # fmt: skip
    with pytest.warns(jb.JaxbodyWarning, match="LOW_COHERENCE") as caught:
        jb.modal.estimate_responses(
            jb.Record(record.times, noisy), inputs=["f0"], outputs=["a0"], segment=8.0
        )
    assert "'a0'" in str(caught[0].message) and "Hz" in str(caught[0].message)


def test_leakage_is_named():
    record = random_test(np.random.default_rng(12), 0.0, seconds=256)
    given = {"inputs": ["f0"], "outputs": ["a0"], "segment": 8.0, "band": (1, 27)}
    with pytest.warns(jb.JaxbodyWarning, match="LEAKAGE"):
        found = jb.modal.estimate_responses(record, window="boxcar", **given)
    assert found.estimate.leaks
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        steady = periodic_test(np.random.default_rng(12), 0.02, period=8)
        blocks = jb.modal.estimate_responses(steady, window="boxcar", **given)
    assert not blocks.estimate.leaks
