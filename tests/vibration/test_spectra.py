"""Power spectral densities: all spellings of units, sides, delays and errors, against one density
computed by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

G = 9.80665
F = np.array([0.4, 1.0, 7.0])

ACCELERATION = [
    "(m/s2)2/Hz",
    "(m/s^2)^2/Hz",
    "(m/s**2)**2/Hz",
    "m2/s4/Hz",
    "m^2/s^4/Hz",
    "m²/s⁴/Hz",
    "m2 s-4/Hz",
    "m^2/s^3",
    "(m s-2)2/hertz",
]
IN_SI = {  # unit -> how many of (m/s2)2/Hz, or of the quantity squared per hertz, is one of it
    **dict.fromkeys(ACCELERATION, 1.0),
    **dict.fromkeys(["g2/Hz", "g^2/Hz", "g²/Hz", "(g)2/Hz", "g**2 / Hz"], G**2),
    "(mm/s2)^2/Hz": 1e-6,
    "Gal2/Hz": 1e-4,
    "(m/s2)2/(rad/s)": 2 * np.pi,
    "m2/s4/(rad/s)": 2 * np.pi,
    "g2/(rad/s)": 2 * np.pi * G**2,
    "m2/Hz": 1.0,
    "m^2 s": 1.0,
    "mm2/Hz": 1e-6,
    "in2/Hz": 0.0254**2,
    "(m/s)2/Hz": 1.0,
    "m2/s2/Hz": 1.0,
    "m2/s": 1.0,
    "rad2/Hz": 1.0,
    "deg^2/Hz": (np.pi / 180) ** 2,
    "(deg/s)^2/Hz": (np.pi / 180) ** 2,
    "rad2/(rad/s)": 2 * np.pi,
    "N2/Hz": 1.0,
    "kN2/Hz": 1e6,
    "(N m)2/Hz": 1.0,
}


@pytest.mark.parametrize("unit", IN_SI)
def test_a_density_is_the_same_in_every_spelling_of_its_unit(unit):
    """g counts squared, and so do millimeters and degrees."""
    density = jb.vibration.PowerLaw(3.0, unit=unit)
    np.testing.assert_allclose(density(F), 3.0 * IN_SI[unit], rtol=1e-13)
    np.testing.assert_allclose(
        jb.vibration.PSD([0.1, 100.0], [3.0, 3.0], unit=unit)(F), 3.0 * IN_SI[unit], rtol=1e-12
    )


@pytest.mark.parametrize(
    ("unit", "waves", "quantity"),
    [
        ("m3", 1, "m"),
        ("m^3", 1, "m"),
        ("m2/(cycle/m)", 1, "m"),
        ("m^2/(cycles/m)", 1, "m"),
        ("m3/cycle", 1, "m"),
        ("mm2/(cycle/m)", 1e-6, "m"),
        ("m3/rad", 2 * np.pi, "m"),
        ("m2/(rad/m)", 2 * np.pi, "m"),
    ],
)
def test_a_density_over_distance_is_read_in_every_spelling(unit, waves, quantity):
    """A road of level (n/n0)^-2 at a speed U: level/U (f/U/n0)^-2 per hertz; per rad/m at the same
    wave 2 pi times as much, n0 in rad/m."""
    around = 2 * np.pi if "rad" in unit else 1.0
    road = jb.vibration.PowerLaw(64e-6, exponent=2.0, reference=0.1 * around, unit=unit, speed=20.0)
    np.testing.assert_allclose(road(F), waves * 64e-6 / 20.0 * (F / 20.0 / 0.1) ** -2, rtol=1e-13)
    assert road.quantity == quantity


@pytest.mark.parametrize(
    "unit",
    [
        "m/Hz",
        "m/s2/sqrt(Hz)",
        "g2/kHz",
        "m2/(rev/m)",
        "m2/s5/Hz",
        "V2/Hz",
        "",
        None,
        "N m2/Hz",
        "mm3",
        "G2/Hz",
    ],
)
def test_a_unit_of_no_density_is_refused(unit):
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.vibration.PowerLaw(1.0, unit=unit)
    assert (
        refused.value.code == "BAD_UNIT"
        and refused.value.where == "PowerLaw.unit"
        and repr(unit) in str(refused.value)
    )


def test_a_two_sided_density_counts_twice():
    law, twice = (
        jb.vibration.PowerLaw(3.0, exponent=2.0, unit="m2/Hz", sides=sides) for sides in (1, 2)
    )
    table, table_twice = (
        jb.vibration.PSD([0.1, 100.0], [300.0, 3e-4], unit="m2/Hz", sides=sides) for sides in (1, 2)
    )  # the same: 3/f^2
    for spectrum, sides in ((law, 1), (twice, 2), (table, 1), (table_twice, 2)):
        np.testing.assert_allclose(spectrum(F), sides * 3.0 / F**2, rtol=1e-12)


@pytest.mark.parametrize("reference", [0.0, -0.1])
def test_a_reference_of_zero_or_less_is_refused(reference):
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.vibration.PowerLaw(1.0, exponent=2.0, reference=reference, unit="m2/Hz")
    assert (
        refused.value.code == "BAD_FREQUENCY"
        and refused.value.where == "PowerLaw.reference"
        and "> 0" in str(refused.value)
    )


@pytest.mark.parametrize(
    "pairs", [{("front", "front"): 0.5}, {("front", "rear"): 0.5, ("rear", "front"): 0.9}]
)
def test_coherence_of_an_input_with_itself_and_of_a_pair_given_twice_is_refused(pairs):
    road = jb.vibration.PowerLaw(1.0, unit="m2/Hz")
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.vibration.CrossPSD({"front": road, "rear": road}, coherence=pairs)
    assert refused.value.code == "BAD_PAIR" and str(list(pairs)[-1]) in str(refused.value)


def test_a_delayed_input_lags():
    """A mass on a spring and a damper to a, a spring to b, where b does what a did d earlier:
    |H_a + H_b exp(-i w d)|^2."""
    m, ka, kb, c, d = 2.0, 300.0, 500.0, 9.0, 0.03
    model = jb.Model(
        bodies={"mass": jb.Body(mass=m, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        supports={"a": jb.Support(), "b": jb.Support()},
        elements={
            "a spring": jb.Spring(
                ("mass", [0, 0, 0]), ("a", [0, 0, -1]), stiffness=ka, free_length=1.0, damping=c
            ),
            "b spring": jb.Spring(
                ("mass", [0, 0, 0]), ("b", [0, 0, 1]), stiffness=kb, free_length=1.0
            ),
        },
    )
    white = jb.vibration.PowerLaw(1.0, unit="m2/Hz")
    spectra = jb.vibration.CrossPSD(
        {"a": white, "b": white}, delays={"b": d}, coherence={("a", "b"): 1.0}
    )
    inputs, f = {name: jb.BaseMotion(name, "z") for name in ("a", "b")}, np.linspace(1.0, 6.0, 201)
    result = jb.random_response(
        jb.linearize(model, model.reference),
        f,
        inputs,
        {"mass": jb.Position("mass", axis="z")},
        spectra,
    )
    w = 2 * np.pi * f
    H = (ka + 1j * w * c + kb * np.exp(-1j * w * d)) / (ka + kb + 1j * w * c - m * w**2)
    np.testing.assert_allclose(result.psd[0], np.abs(H) ** 2, rtol=1e-11)
    np.testing.assert_allclose(
        spectra.correlation(jnp.asarray(f))[0, 1], np.exp(1j * w * d), rtol=1e-12
    )
