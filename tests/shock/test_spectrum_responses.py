"""Maxima by spectra: the five-storey frame of Chopra, isolated equipment, one mode as its history,
missing mass, several directions."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from accelerograms import el_centro_in_g, noise_record
from scipy.signal import lsim

import jaxbody as jb
from jaxbody.shock.spectrum_responses import correlations

CQC = {0.3: 0.00512768817, 0.5: 0.0184864518, 0.8: 0.165634665, 0.9: 0.473027683, 0.95: 0.791406378}


def frame(n=5, mass=45000.0, stiffness=54.82e5):
    """A shear frame of n storeys, its floors on guides along x."""
    along, names = {"axis": [1, 0, 0]}, [str(i) for i in range(n + 1)]
    return jb.Model(
        bodies={
            name: jb.Body(mass, [1, 1, 1], position=[float(i + 1), 0, 0])
            for i, name in enumerate(names[1:])
        },
        supports={"0": jb.Support()},
        joints={name: jb.Guide("world", **along) for name in names[1:]},
        elements={
            f"storey {b}": jb.Spring(
                (b, [0, 0, 0]), (a, [0, 0, 0]), stiffness=stiffness, free_length=1.0
            )
            for a, b in itertools.pairwise(names)
        },
    )


@pytest.fixture(scope="module")
def five():
    model = frame()
    return jb.linearize(model, model.reference)


@pytest.fixture(scope="module")
def record():
    """El Centro with 9.81 m/s2 in a g, as the references of the frame were computed."""
    a = el_centro_in_g()
    return 0.02 * np.arange(len(a)), 9.81 * a


DAMPED = np.hypot(1, 2 * 0.05)  # absolute over pseudo-acceleration of a harmonic motion
OUTPUTS = {
    "base shear": jb.sensors.LoadCell("storey 1"),
    "roof": jb.Position("5", axis="x"),
    "roof acceleration": jb.Acceleration("5", axis="x"),
}


def test_a_five_storey_frame(five, record):
    """Chopra's example 13.8; D at the samples with the frame's own periods, of structdyn 0.8.0."""
    f = jb.modes(five).frequency
    np.testing.assert_allclose(
        1 / f, [2.00002963, 0.6851796, 0.43464798, 0.33834496, 0.29665032], rtol=2e-8
    )
    spectrum = jb.shock.shock_spectrum(record, f, kind="relative")
    np.testing.assert_allclose(
        spectrum.values[0], [0.13646859, 0.0656516, 0.03800461, 0.02199561, 0.01634553], rtol=3e-7
    )
    by = {
        how: jb.shock.spectrum_response(
            five, {"0": {"x": spectrum}}, OUTPUTS, combine=how, modal_damping=0.05
        )
        for how in ("SRSS", "CQC", "absolute")
    }
    shears = [266534.084, 108288.690, 43271.154, 12816.223, 2586.303]
    np.testing.assert_allclose(np.abs(by["SRSS"].modal[0, 0]), shears, rtol=1e-6)
    np.testing.assert_allclose(
        [by[how]["base shear"] for how in by], [291221.90, 293156.7, 433496.0], rtol=2e-6
    )
    np.testing.assert_allclose(
        [by[how]["roof"] for how in ("SRSS", "CQC")], [0.17257569, 0.1723879], rtol=1e-6
    )
    np.testing.assert_allclose(by["CQC"].total_mass, 5 * 45000.0, rtol=1e-12)
    np.testing.assert_allclose(by["CQC"].shares.sum(1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(
        by["SRSS"].shares[0, :5], np.square(shears) / 291221.90**2, rtol=2e-6
    )
    assert "base shear" in str(by["CQC"]) and "mass, 0 x" in str(by["CQC"])


def test_correlations_are_those_of_white_noise():
    """And the roles of unequal dampings are not exchanged."""
    for r, value in CQC.items():
        rho = correlations(jnp.array([r, 1.0]), jnp.full(2, 0.05), jnp.arange(2))
        np.testing.assert_allclose(rho, [[1, value], [value, 1]], rtol=1e-8)
    zi, zj, wi, wj = 0.02, 0.1, 5.0, 6.0
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1
    A[1, :2], A[3, 2:] = [-(wi**2), -2 * zi * wi], [-(wj**2), -2 * zj * wj]
    b = np.array([0, -1, 0, -1.0])
    P = scipy.linalg.solve_continuous_lyapunov(A, -np.outer(b, b))
    rho = correlations(jnp.array([wi, wj]), jnp.array([zi, zj]), jnp.arange(2))
    np.testing.assert_allclose(rho[0, 1], P[0, 2] / np.sqrt(P[0, 0] * P[2, 2]), rtol=1e-12)


def one_mode():
    """A mass on a spring and damper over a base that moves along x."""
    return jb.Model(
        bodies={"mass": jb.Body(2.0, [1, 1, 1], position=[1, 0, 0])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("world", axis="x")},
        elements={
            "spring": jb.Spring(
                ("mass", [0, 0, 0]),
                ("base", [0, 0, 0]),
                stiffness=600.0,
                free_length=1.0,
                damping=9.0,
            )
        },
    )


ONE = {
    "force": jb.sensors.LoadCell("spring"),
    "stroke": jb.Elongation("spring"),
    "acceleration": jb.Acceleration("mass", axis="x"),
    "reaction": jb.sensors.Reaction("base", component=0),
}


def peak_of(times, y):
    """The largest |y| by a parabola through three samples."""
    k = np.abs(y).argmax()
    a, b, c = np.abs(y[k - 1 : k + 2])
    return b - (a - c) ** 2 / (8 * (a - 2 * b + c))


@pytest.mark.long
def test_one_mode_equals_its_history(rng):
    """Of every output: SciPy's linear simulation, exact for straight lines, at 400 points in each
    of them."""
    model = one_mode()
    lin = jb.linearize(model, model.reference)
    times, a = noise_record(rng, duration=5.0, rate=50.0)
    response = jb.shock.spectrum_response(lin, {"base": {"x": (times, a)}}, ONE)
    system = lin.state_space({"base": jb.BaseMotion("base", "x", kind="acceleration")}, ONE)
    fine = np.linspace(0, times[-1], 400 * (len(times) - 1) + 1)
    y = lsim(
        tuple(map(np.asarray, (system.A, system.B, system.C, system.D))),
        np.interp(fine, times, a),
        fine,
    )[1]
    for name, row in zip(ONE, y.T, strict=True):
        np.testing.assert_allclose(response[name], peak_of(fine, row), rtol=1e-8)


@pytest.mark.long
def test_a_spectrum_gives_what_its_record_gives_for_strokes(rng):
    model = one_mode()
    lin = jb.linearize(model, model.reference)
    times, a = noise_record(rng, duration=5.0, rate=50.0)
    modes = jb.modes(lin)
    spectrum = jb.shock.shock_spectrum(
        (times, a), modes.frequency, damping=modes.damping_ratio, kind="pseudo", peaks="continuous"
    )
    by_record, by_spectrum = (
        jb.shock.spectrum_response(lin, {"base": {"x": given}}, ONE)
        for given in ((times, a), spectrum)
    )
    np.testing.assert_allclose(by_spectrum["stroke"], by_record["stroke"], rtol=1e-12)
    # the force of spring and damper in phase quadrature: what a spectrum alone knows
    zeta = float(modes.damping_ratio[0])
    np.testing.assert_allclose(
        by_spectrum["force"], 600.0 * by_spectrum["stroke"] * np.hypot(1, 2 * zeta), rtol=1e-12
    )
    np.testing.assert_allclose(by_spectrum["force"], 2.0 * by_spectrum["acceleration"], rtol=1e-12)
    np.testing.assert_allclose(by_spectrum["force"], by_record["force"], rtol=0.05)


class Plateau(jb.shock.ResponseSpectrum):
    """A spectrum of one's own that is flat, of 3 m/s2."""

    def __call__(self, frequencies, damping=0.05):
        return 3.0 * jnp.ones(jnp.shape(frequencies))

    def covers(self):
        return 0.1, 50.0


def test_a_spectrum_of_ones_own_states_its_values_and_what_it_covers(five):
    level, other = Plateau(), jb.shock.DesignSpectrum([0.1, 50.0], [3.0, 3.0])
    mine, theirs = (
        jb.shock.spectrum_response(five, {"0": {"x": each}}, OUTPUTS, modal_damping=0.05)
        for each in (level, other)
    )
    np.testing.assert_allclose(mine.values, theirs.values, rtol=1e-12)
    assert [line.split() for line in str(level).splitlines()] == [
        ["Plateau"],
        ["value"],
        ["lowest", "0.1", "Hz"],
        ["highest", "50", "Hz"],
    ]
    assert float(level.rigid()) == 3.0


def test_modes_above_a_frequency_move_with_the_base(five):
    """All modes rigid: each floor has the acceleration of the ground, and the base shear is the
    mass times it."""
    level = jb.shock.DesignSpectrum([0.1, 50.0], [3.0, 2.0])
    rigid = jb.shock.spectrum_response(
        five, {"0": {"x": level}}, OUTPUTS, modal_damping=0.05, highest=0.1
    )
    np.testing.assert_allclose(rigid["base shear"], 5 * 45000 * 2.0, rtol=1e-10)
    np.testing.assert_allclose(rigid["roof acceleration"], 2.0, rtol=1e-10)
    some = jb.shock.spectrum_response(
        five, {"0": {"x": level}}, OUTPUTS, modal_damping=0.05, highest=2.0
    )
    assert np.asarray(some.taken).tolist() == [True, True, False, False, False]
    missing = 1 - float(some.mass[0, :2].sum()) / (5 * 45000)
    np.testing.assert_allclose(np.abs(some.rest[0, 0]), missing * 5 * 45000 * 2.0, rtol=1e-10)


def test_a_body_that_its_joint_carries_along_has_the_acceleration_of_its_support():
    """A guide on a base along z, which moves along x too; the coordinates are relative: M~ is
    not zero."""
    model = jb.Model(
        bodies={"mass": jb.Body(2.0, [1, 1, 1], position=[0, 0, 1])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("base", axis="z")},
        elements={
            "spring": jb.Spring(
                ("mass", [0, 0, 0]), ("base", [0, 0, 0]), stiffness=600.0, free_length=1.0
            )
        },
    )
    lin, level = (
        jb.linearize(model, model.reference),
        jb.shock.DesignSpectrum([0.1, 50.0], [3.0, 1.5]),
    )
    outputs = {"a": jb.Acceleration("mass"), "force": jb.sensors.LoadCell("spring")}
    response = jb.shock.spectrum_response(
        lin, {"base": {"x": level, "z": level}}, outputs, modal_damping=0.05
    )
    at_mode = float(level(jb.modes(lin).frequency[0]))
    np.testing.assert_allclose(
        response.by_excitation, [[1.5, 0, 0, 0], [0, 0, DAMPED * at_mode, 2 * at_mode]], atol=1e-12
    )
    np.testing.assert_allclose(response.total_mass, [0, 2.0], atol=1e-12)


@pytest.mark.long
def test_supports_that_move_together_and_apart():
    """Between two bases on equal springs: together the whole base motion, apart half of it each."""
    ends = {"left": [-1.0, 0, 0], "right": [1.0, 0, 0]}
    model = jb.Model(
        bodies={"mass": jb.Body(2.0, [1, 1, 1])},
        supports={name: jb.Support(position=at) for name, at in ends.items()},
        joints={"mass": jb.Guide("world", axis="x")},
        elements={
            f"{name} spring": jb.Spring(
                ("mass", [0, 0, 0]), (name, [0, 0, 0]), stiffness=300.0, free_length=1.0
            )
            for name in ends
        },
    )
    lin, level, out = (
        jb.linearize(model, model.reference),
        jb.shock.DesignSpectrum([0.1, 50.0], [3.0, 3.0]),
        {"a": jb.Acceleration("mass", axis="x")},
    )
    together = jb.shock.spectrum_response(
        lin, {("left", "right"): {"x": level}}, out, modal_damping=0.05
    )
    apart = jb.shock.spectrum_response(
        lin, {"left": {"x": level}, "right": {"x": level}}, out, modal_damping=0.05
    )
    np.testing.assert_allclose(
        [together["a"], apart["a"]], [DAMPED * 3.0, DAMPED * 3.0 / np.sqrt(2)], rtol=1e-12
    )
    assert together.excitations == ("left and right x",) and np.allclose(apart.mass, 0.5)
    bound = jb.shock.spectrum_response(
        lin,
        {"left": {"x": level}, "right": {"x": level}},
        out,
        modal_damping=0.05,
        combine="absolute",
    )
    np.testing.assert_allclose(bound["a"], DAMPED * 3.0, rtol=1e-12)


@pytest.mark.long
def test_coinciding_modes_are_one_whatever_their_basis():
    """A mass on equal springs along x and y, shaken along a diagonal; SRSS of one of its bases
    would differ."""
    model = jb.Model(
        bodies={"mass": jb.Body(2.0, [1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Translation("world")},
        elements={
            "mount": jb.Bushing(
                ("mass", [0, 0, 0]),
                ("base", [0, 0, 0]),
                stiffness=np.diag([600.0, 600, 900, 1, 1, 1]),
            )
        },
    )
    lin, level = (
        jb.linearize(model, model.reference),
        jb.shock.DesignSpectrum([0.1, 50.0], [3.0, 3.0]),
    )
    out = {
        "along": jb.Acceleration("mass", axis=[1, 0, 0]),
        "diagonal": jb.Acceleration("mass", axis=[1, 1, 0]),
    }
    for combine in ("SRSS", "CQC", "absolute"):
        response = jb.shock.spectrum_response(
            lin, {"base": {"x": level}}, out, modal_damping=0.05, combine=combine
        )
        np.testing.assert_allclose(
            response.values, [DAMPED * 3.0, DAMPED * 3.0 / np.sqrt(2)], rtol=1e-10
        )


@pytest.mark.long
def test_isolated_equipment_in_el_centro():
    """Concentric isolators, stiff vertically: the reference is the peak stretch and acceleration at
    eight steps a sample."""
    level, upright = np.diag([1e4, 1e4, 1e8, 0, 0, 0]), np.diag([800.0, 800, 0, 0, 0, 0])
    isolators = {
        f"isolator {i}": jb.Bushing(
            ("cabinet", [x, y, 0]), ("floor", [x, y, 0]), stiffness=level, damping=upright
        )
        for i, (x, y) in enumerate([(0.6, 0.4), (-0.6, 0.4), (0.6, -0.4), (-0.6, -0.4)])
    }
    model = jb.Model(
        bodies={"cabinet": jb.Body(1000.0, [80, 80, 120])},
        supports={"floor": jb.Support()},
        elements=isolators,
    )
    lin, a = jb.linearize(model, model.reference), 9.81 * el_centro_in_g()
    outputs = {
        "stretch": jb.Position("cabinet", axis="x", relative_to="floor"),
        "acceleration": jb.Acceleration("cabinet", axis="x"),
        "force": jb.sensors.LoadCell("isolator 1", component=0),
    }
    response = jb.shock.spectrum_response(
        lin, {"floor": {"x": (0.02 * np.arange(len(a)), a)}}, outputs
    )
    np.testing.assert_allclose(
        response.frequency[:3], [1.00658424, 1.00658424, 2.09537219], rtol=2e-8
    )
    np.testing.assert_allclose(
        response.damping_ratio[:3], [0.25298221, 0.25298221, 0.52662447], rtol=2e-8
    )
    np.testing.assert_allclose(
        [response["stretch"], response["acceleration"] / 9.81], [0.04192605, 0.20508677], rtol=1e-4
    )
    # a quarter of the mass on each
    np.testing.assert_allclose(response["force"], 250.0 * response["acceleration"], rtol=1e-9)


@pytest.mark.long
def test_derivatives_by_the_model_agree_with_differences(five):
    level = jb.shock.Eurocode8(2.0, "B")

    def shear(k):
        model = jb.replace(frame(3), {"storey 1.stiffness": k})
        lin = jb.linearize(model, model.reference)
        return jb.shock.spectrum_response(
            lin, {"0": {"x": level}}, {"shear": jb.sensors.LoadCell("storey 1")}, modal_damping=0.05
        )["shear"]

    k, h = 54.82e5, 50.0
    np.testing.assert_allclose(
        jax.grad(shear)(k), (shear(k + h) - shear(k - h)) / (2 * h), rtol=1e-6
    )


@pytest.mark.long
def test_bad_input_is_refused_all_at_once(five):
    level = jb.shock.DesignSpectrum([1.0, 2.0], [3.0, 3.0], damping=0.02)
    with pytest.raises(
        jb.JaxbodyError,
        match=(
            r"'0 x': does not cover modes 1 .0\.499993 Hz.*damping ratios 0\.02 "
            r"to 0\.02.*NOT_COVERED"
        ),
    ):
        jb.shock.spectrum_response(five, {"0": {"x": level}}, OUTPUTS, modal_damping=0.05)
    with pytest.raises(jb.JaxbodyError) as raised:
        jb.shock.spectrum_response(
            five,
            {"roof": {"x": 3.0}, "0": {"u": level}},
            {"a": jb.Acceleration("six")},
            combine="sum",
            modal_damping=5.0,
            highest=-1,
        )
    codes = {
        "UNKNOWN_NAME",
        "WRONG_KIND",
        "BAD_DIRECTION",
        "BAD_OPTION",
        "NOT_A_FRACTION",
        "BAD_FREQUENCY",
    }
    assert {p.code for p in raised.value.problems} == codes
    absolute = jb.shock.shock_spectrum((np.arange(100) / 20, np.ones(100)), [1.0, 2.0])
    with pytest.raises(jb.JaxbodyError, match="BAD_KIND"):
        jb.shock.spectrum_response(five, {"0": {"x": absolute}}, OUTPUTS)
    with pytest.raises(jb.JaxbodyError, match="BAD_CHAIN"):
        jb.shock.spectrum_response(
            five, {"0": {"x": level}}, {"a": jb.Acceleration("5", axis="x", lag=0.1)}
        )


@pytest.mark.long
def test_two_masses_that_a_rod_joins_respond_as_one():
    """Along the rod: the force is the sum of the masses times the pseudo-acceleration."""
    body = lambda m, x: jb.Body(m, [1, 1, 1], position=[x, 0, 1])  # noqa: E731
    model = jb.Model(
        bodies={"frame": body(3.0, 0.0), "box": body(2.0, 0.5)},
        supports={"base": jb.Support()},
        joints=dict.fromkeys(("frame", "box"), jb.Guide("world", axis="x")),
        elements={
            "s": jb.Spring(
                ("frame", [0, 0, 0]),
                ("base", [1, 0, 1]),
                stiffness=800.0,
                free_length=1.0,
                damping=4.0,
            )
        },
        closures={"rod": jb.closures.Rod(("frame", [0, 0, 0]), ("box", [0, 0, 0]))},
    )
    lin, level = jb.linearize(model, jb.equilibrium(model)), jb.shock.Eurocode8(2.0)
    w, zeta = np.sqrt(800.0 / 5), 4.0 / (2 * np.sqrt(800.0 * 5))
    peaks = jb.shock.spectrum_response(
        lin, {"base": {"x": level}}, {"force": jb.Elongation("s", gain=800.0)}
    )
    np.testing.assert_allclose(peaks["force"], 5 * float(level(w / (2 * np.pi), zeta)), rtol=1e-10)
    np.testing.assert_allclose(peaks.total_mass, [5.0], rtol=1e-12)
    floor = jb.shock.floor_spectrum(
        lin, [1e4], {"base": {"x": level}}, jb.Acceleration("box", axis="x")
    )
    # stiff equipment moves with the box
    np.testing.assert_allclose(floor.values, [[peaks["force"] / 5]], rtol=1e-5)
