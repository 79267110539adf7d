"""Plots of modal tests show the numbers of the estimate and of the modes, with texts apart."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure
from pictures import overlaps, units, without_unit

import jaxbody as jb

RATE, COUNT = 64.0, 2**13
OUTPUTS = {f"y{i}": jb.Acceleration(f"m{i}", axis="x") for i in (1, 2, 3)}
INPUTS = {f"f{i}": jb.PointForce(f"m{i}", direction="x") for i in (1, 3)}


def chain(stiffness):
    """Three masses in a row on springs."""
    ends = ["world", "m1", "m2", "m3"]
    return jb.Model(
        bodies={f"m{i}": jb.Body(1.0, [1, 1, 1], position=[i, 0, 0]) for i in (1, 2, 3)},
        joints={f"m{i}": jb.Guide("world", axis="x") for i in (1, 2, 3)},
        elements={
            f"s{i}": jb.Spring(
                ends[i], ends[i - 1], stiffness=stiffness, damping=12.0, free_length=1.0
            )
            for i in (1, 2, 3)
        },
    )


@pytest.fixture(scope="module")
def record():
    """Random forces on two masses, and the accelerations of all with 1 % noise."""
    model, rng = chain(3000.0), np.random.default_rng(0)
    f = np.arange(1, COUNT // 2 + 1) * RATE / COUNT
    H = jb.frequency_response(jb.linearize(model, model.reference), f, INPUTS, OUTPUTS).values
    forces = rng.normal(size=(2, COUNT))
    spectra = np.einsum("yuf,uf->yf", np.asarray(H), np.fft.rfft(forces)[:, 1:])
    y = np.fft.irfft(np.pad(spectra, ((0, 0), (1, 0))), COUNT)
    y += 0.01 * y.std() * rng.normal(size=y.shape)
    columns = dict(zip(INPUTS, [(x, "N") for x in forces], strict=True))
    columns |= dict(zip(OUTPUTS, [(x, "m/s2") for x in y], strict=True))
    return jb.Record(None, columns, rate=RATE)


@pytest.fixture(scope="module")
def responses(record):
    return jb.modal.estimate_responses(
        record, inputs=INPUTS, outputs=OUTPUTS, segment=16.0, band=(2.0, 25.0)
    )


@pytest.fixture(scope="module")
def identified(responses):
    return jb.modal.identify_modes(responses)


def drawn_well(figure):
    found = overlaps(figure), without_unit(figure)
    plt.close(figure)
    assert found == ([], [])


def test_an_estimate_is_drawn_with_bands_phases_and_coherence(responses):
    e = responses.estimate
    ax = responses.plot(pairs=[("y3", "f1")], ax=Figure().subplots())
    phases, coherence = ax.figure.axes[1:]
    H, s = e.H[:, 2, 0], e.spread[:, 2, 0]
    assert units(ax.figure) == ["(m/s2)/N", "degrees", "-"] and ax.get_yscale() == "log"
    (line,) = ax.lines
    assert line.get_label() == "y3 / f1"
    np.testing.assert_array_equal(line.get_xydata().T, [e.frequencies, np.abs(H)])
    np.testing.assert_allclose(phases.lines[0].get_ydata(), np.degrees(np.angle(H)))
    np.testing.assert_array_equal(coherence.lines[0].get_ydata(), e.partial[:, 2, 0])
    band = ax.collections[0].get_paths()[0].vertices[:, 1]
    assert band.max() == pytest.approx((np.abs(H) + 1.96 * s).max())
    with pytest.raises(jb.JaxbodyError, match=r"'\('y3', 'f2'\)' is unknown"):
        responses.plot(pairs=[("y3", "f2")])


def test_four_pairs_are_drawn_and_said_to_be_some(responses):
    ax = responses.plot()
    assert ax.get_title() == "4 of 6 pairs" and len(ax.lines) == 4
    drawn_well(ax.figure)


@pytest.mark.nan
def test_lines_without_excitation_are_left_out_and_each_unit_has_a_panel():
    rng, t = np.random.default_rng(1), np.arange(4096) / RATE
    tones = np.arange(1, 100, 2) / 4.0  # [Hz]: every second line of a period of 4 s
    x = np.cos(2 * np.pi * tones * t[:, None] + rng.uniform(0, 6, tones.size)).sum(1)
    columns = {"f": (x, "N"), "a": (2 * x, "m/s2"), "z": (0.1 * x, "m")}
    record = jb.Record(None, columns, rate=RATE)
    estimated = jb.modal.estimate_responses(record, inputs=["f"], outputs=["a", "z"])
    ax = estimated.plot()
    assert units(ax.figure) == ["(m/s2)/N", "m/N", "degrees", "-"]
    f, size = ax.lines[0].get_xydata().T
    np.testing.assert_allclose(f, tones)
    np.testing.assert_allclose(size, 2.0)
    drawn_well(ax.figure)


@pytest.mark.long
def test_spectra_of_ambient_vibration_have_no_coherence(record):
    spectra = jb.modal.positive_spectra(record, references=["y3"], outputs=["y3"], segment=1.0)
    ax = spectra.plot()
    assert units(ax.figure) == ["(m/s2) (m/s2)/Hz", "degrees"]
    drawn_well(ax.figure)


def test_a_stabilization_diagram_has_the_poles_and_the_modes(identified):
    i = identified.identification
    ax = identified.plot()
    dots = {line.get_label(): line for line in ax.lines}
    np.testing.assert_array_equal(
        dots["stable poles"].get_xydata().T,
        [i.diagram.frequency[i.diagram.stable], i.diagram.order[i.diagram.stable]],
    )
    assert len(dots["other poles"].get_xdata()) == np.sum(~i.diagram.stable)
    at = [line.get_xdata()[0] for line in ax.lines if line.get_label() == "modes"]
    np.testing.assert_array_equal(at, i.frequency)
    assert [text.get_text() for text in ax.texts] == [f"{f:.4g} Hz" for f in i.frequency]
    measured, fitted = ax.figure.axes[1].lines
    np.testing.assert_allclose(measured.get_ydata(), fitted.get_ydata(), rtol=0.1)
    drawn_well(ax.figure)


@pytest.mark.long
def test_names_of_modes_that_are_close_stay_apart():
    f = np.linspace(1.0, 40.0, 1600)
    s, w = 2j * np.pi * f[:, None], 2 * np.pi * np.array([5.0, 12.0, 12.3, 12.9, 39.6])
    p = (-0.004 + 1j) * w
    H = (1j / (s - p.conj()) - 1j / (s - p)).sum(1)
    test = jb.MeasuredResponse(
        f,
        inputs={"f": INPUTS["f1"]},
        outputs={"y": jb.Position("m1", axis="x")},
        measured={("y", "f"): H},
        noise=1e-4,
    )
    ax = jb.modal.identify_modes(test).plot()
    assert len(ax.texts) == 5
    drawn_well(ax.figure)


def test_the_agreement_with_a_model_is_drawn_as_squares_with_numbers(identified):
    model = chain(2500.0)
    ax = identified.plot(model=model)
    mac = np.asarray(identified.mac(model))
    np.testing.assert_array_equal(ax.images[0].get_array(), mac)
    assert {text.get_text() for text in ax.texts} >= {f"{x:.2f}" for x in np.diag(mac)}
    heads = [text.get_text() for text in ax.get_yticklabels()]
    found = jb.modes(jb.linearize(model, model.reference)).frequency
    assert heads == [f"{k}: {f:.4g} Hz" for k, f in enumerate(np.asarray(found), 1)]
    assert np.diag(mac).min() > 0.98
    drawn_well(ax.figure)
