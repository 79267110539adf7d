"""Printing and inspecting results of any class uses NumPy only and runs no JAX operation."""

import inspect
import pkgutil
import warnings
from importlib import import_module

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from controlled_cars import OUTPUTS, ROAD, SPEED, WHITE, quarter_car

import jaxbody as jb
from jaxbody.core.results import Result
from jaxbody.fitting.coverages import Coverage
from jaxbody.fitting.model_comparisons import Evidence, LeaveOneOut
from jaxbody.fitting.multistarts import Multistart
from jaxbody.fitting.planning.further_measurements import FurtherMeasurements
from jaxbody.fitting.posteriors import Posterior, prepared
from jaxbody.mechanics.load_paths import Path
from jaxbody.mechanics.several_equilibria import Equilibria
from jaxbody.mechanics.static_load_cases import LoadCases
from jaxbody.shock.matched_records import MatchedRecord
from jaxbody.suspension.alignment_curves import SuspensionCurves
from jaxbody.suspension.assemblies import Assembly, Drive
from jaxbody.vibration.backbones import Backbones
from jaxbody.vibration.dynamic_stiffnesses import DynamicStiffness
from jaxbody.vibration.mode_branches import Branches
from jaxbody.vibration.spins import SpinLinearization
from jaxbody.vibration.wheel_compliances import WheelCompliance

TIMES = np.linspace(0, 1, 21)
SWING = np.cos(2 * np.pi * TIMES) + 0.02 * np.cos(300 * TIMES**2)


def two_of(**more):
    """A mass on a guide, its spring and damper to a base; a box that hangs from it on a bushing."""
    return jb.Model(
        bodies={
            "mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0]),
            "box": jb.Body(mass=1.0, inertia=[1, 2, 3]),
        },
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
        elements={
            "spring": jb.Spring(
                ("mass", [0, 0, 0]), ("base", [0, 0, 0]), stiffness=30.0, damping=0.5
            ),
            "mount": jb.Bushing(
                ("box", [0, 0, 0]),
                ("mass", [0, 0, 0]),
                stiffness=np.diag([30.0, 40, 50, 3, 4, 5]),
                damping=np.eye(6),
            ),
        }
        | more,
    )


def one_of(**law):
    return jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
        supports={"base": jb.Support()},
        elements={
            "spring": jb.Spring(
                ("mass", [0, 0, 0]), ("base", [0, 0, 0]), **({"stiffness": 30.0} | law)
            )
        },
    )


def looped():
    rod = jb.closures.Rod(("mass", [0, 0, 0]), ("world", [0, 0, 0]))
    return jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
        closures={"rod": rod},
    )


def quantities(model):
    c = model["spring"].stiffness / 30.0
    return {"shake": c + 1 / c, "travel": 1 / c}


def measured(times):
    sensors = {"x": jb.Position("mass", axis=[1, 0, 0])}
    return jb.Experiment(times, sensors=sensors, measured={"x": np.interp(times, TIMES, SWING)})


def made():
    """One small of every class of results, from one model or two; what takes long to compile is put
    together by hand."""
    model, one, free = two_of(), one_of(), ["spring.stiffness"]
    eq, lin = jb.equilibrium(model), jb.linearize(model, model.reference)
    still, small, nv = jb.equilibrium(one), jb.linearize(one, one.reference), lin.K.shape[0]
    shaken, moved, bounds = (
        {"base": jb.BaseMotion("base", "x")},
        {"mass": jb.Position("mass", axis="x")},
        {"*.stiffness": (3.0, 300.0)},
    )
    result, modes = jb.fit(one, {"run": measured(TIMES)}, free=free), jb.modes(lin)
    acceleration = jb.Record(
        np.arange(400) / 20, {"acc": (np.cos(np.arange(400) / 20 * 6), "m/s2")}
    )
    path = Path(jnp.linspace(0, 1, 3), jnp.array([1.0, 0.5, jnp.nan]))
    x, (strokes, forces) = (
        jnp.ones((1, 2, 3)),
        2 * [tuple(jnp.ones((1, *e.shape)) for e in eq.deformations)],
    )
    ok, density = np.asarray(0), prepared(result, None)[0]
    y = np.random.default_rng(0).normal(0, 1e-3, (2, 8, len(density.unknowns.labels)))
    numbers = density.unknowns.values(jnp.zeros(y.shape[2]))
    drawn = {path: np.broadcast_to(x, (2, 8, *np.shape(x))) for path, x in numbers.items()}
    each = np.ones(y.shape[2])
    o, i = jnp.ones(nv), jnp.zeros(nv, int)
    wheel = jb.suspension.Wheel("mass", center=[0, 0, 0], axis="y", radius=0.3)
    return [
        jb.simulate(model, TIMES[:3]),
        eq,
        eqx.tree_at(lambda e: e.path, eq, path, is_leaf=lambda x: x is None),
        Equilibria(0, (still,), np.ones(1), np.ones(1), 4),
        LoadCases(
            jnp.zeros(1, int),
            jnp.ones(1),
            eq.state,
            eq,
            x,
            x,
            strokes,
            forces,
            jnp.array([True]),
            jnp.array([True]),
            ("bump",),
        ),
        jb.preload(one),
        Assembly(looped(), eq.state, jnp.zeros((2, 1)), jnp.ones((1, 6)), jnp.array(0)),
        SuspensionCurves(
            {"x": o[:1]},
            {"toe": o[:1]},
            {"x": {"toe": o[:1]}},
            lin.K[:1],
            i[:1],
            model,
            (Drive("x", 0, "m"),),
            wheel,
        ),
        WheelCompliance(jnp.ones((5, 5)), jnp.array(0)),
        lin,
        lin.state_space(shaken, moved),
        modes,
        jb.complex_modes(lin),
        jb.vibration.mode_energies(lin),
        jb.vibration.elastic_axes(lin, "box"),
        jb.vibration.torque_roll_axis(lin, "box", [1, 0, 0]),
        Backbones(o, lin.K, 0 * i, o, lin.K, lin.K, o, o, o, i, model.layout, model.independent),
        SpinLinearization(
            lin.M, lin.C, lin.K, lin.status, lin.state, model, lin.basis, lin.C, lin.K, lin.K[0]
        ),
        Branches(
            o[:2],
            *(jnp.ones((2, *shape)) for shape in [(nv,), (nv,), (nv, nv)]),
            jnp.array([i, i]),
            jnp.array([o, o]),
            i[:2],
            modes,
        ),
        DynamicStiffness(o, o + 1j, o[0], i[0]),
        jb.frequency_response(small, [1.0, 2.0], shaken, moved),
        jb.random_response(
            small,
            jb.vibration.Band(0.5, 5.0),
            shaken,
            moved,
            {"base": jb.vibration.PowerLaw(1.0, unit="m2/Hz")},
        ),
        *shocked(small, moved),
        *controlled(),
        jb.vibration.weighted_signal(np.arange(400) / 400, np.cos(np.arange(400)), "Wk"),
        jb.inputs.base_motion(acceleration, "acc", axis=[1, 0, 0]),
        result,
        Multistart(result, np.ones(1), np.ones(1, int), result.estimates, 4, 3, result.status),
        Posterior(
            result, density, y[0, 0], y, drawn, y[..., 0], each, each, each, 0, 0, np.ones(2), ok
        ),
        Evidence(-5.3, 0.01, ok),
        LeaveOneOut(
            -5.3, 0.01, np.ones(2), np.ones(2), ("run.x at t = 0 s", "run.x at t = 1 s"), ok
        ),
        jb.choose({"first": [1.0, 0.0], "second": [1.0, 2.0]}, n=2),
        FurtherMeasurements(
            ("position of mass along x in run",), tuple(free), 0.01, np.ones(1), np.ones((1, 1)), ok
        ),
        jb.validate(result, {"later": measured(TIMES)}),
        Coverage(
            ("spring.stiffness",), 0.95, *np.zeros((3, 4, 1)), *np.ones((2, 1)), np.zeros(4, int)
        ),
        jb.fitting.profile_likelihood(result, free[0]),
        jb.confidence_bands(result, lambda model: model["spring"].stiffness),
        jb.diagnose(one, {"run": measured(TIMES)}),
        jb.fitting.plausibility(one),
        jb.tune(one, quantities, free=free, minimize="shake", bounds=bounds, starts=1),
        jb.design.sensitivities(one, quantities, free=free),
        jb.tolerances(one, quantities, {"spring.stiffness": 1.0}, samples=100),
        jb.pareto(
            one, quantities, minimize=["shake", "travel"], free=free, bounds=bounds, points=3
        ),
    ]


def shocked(small, moved):
    """Of spectra, peaks and fatigue."""
    record = np.arange(40) / 10, np.cos(np.arange(40.0))
    ride = jb.random_response(
        small,
        jb.vibration.Band(0.5, 5.0),
        {"base": jb.BaseMotion("base", "x")},
        moved,
        {"base": jb.vibration.PowerLaw(1.0, unit="m2/Hz")},
    )
    o = jnp.ones(3)
    return [
        jb.shock.shock_spectrum(record, [1.0, 2.0], damping=[0.02, 0.05]),
        jb.shock.spectrum_response(small, {"base": {"x": record}}, moved),
        MatchedRecord(o, o, o, o, o, o, o, jnp.array(0.05), jnp.array(0)),
        jb.shock.peak_factor(ride, 30.0),
        jb.shock.fatigue_damage(
            ride, {"mass": jb.shock.SNCurve(3.0, cycles=1e6, level=1.0, unit="m")}, duration=60.0
        ),
    ]


def controlled():
    """Of a regulator, its estimator and a loop."""
    car = quarter_car()
    lin, inputs = jb.linearize(car, car.reference), {"u": jb.Command("drive")} | ROAD
    white = {"road": WHITE}
    weights = {"acceleration": 1.0}, {"u": 1e-6}
    return [
        jb.control.lqr(lin, *weights, inputs=inputs, outputs=OUTPUTS, noise=white),
        jb.control.kalman(lin, SPEED, inputs=inputs, noise=white, sensor_noise={"speed": 1e-6}),
        jb.control.loop_margins(-jnp.eye(1), jnp.ones(1), jnp.ones(1)),
    ]


@pytest.fixture(scope="module")
def results():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return made()


def looked_at(thing):
    return str(thing), repr(thing), thing._repr_html_(), dir(thing)


def classes(of=Result):
    every = {c for each in of.__subclasses__() for c in ({each} | classes(each))}
    return {c for c in every if c.__module__.startswith("jaxbody.") and not inspect.isabstract(c)}


@pytest.mark.long
def test_every_result_is_text_arrays_and_a_picture(results):
    for result in results:
        name = type(result).__name__
        assert name == "Trajectory" or f"{result.summary()}\n" == str(result), name
        assert result.to_pandas().attrs["units"].keys() >= set(result.to_pandas().columns), name
        assert len(result.to_xarray().data_vars) > 0, name
        drawn = name not in {
            *("Estimator", "Evidence", "FurtherMeasurements", "LeaveOneOut", "Margins"),
            *("Plausibility", "Regulator", "WheelCompliance"),
        }
        assert hasattr(result, "plot") == drawn, name


@pytest.mark.long
def test_no_result_computes_when_it_is_looked_at(results):
    """Neither what is compiled nor what is compiled already: inside make_jaxpr all that JAX is
    asked for becomes part of a program, which stays empty. So for results that are good, and as if
    they had ended in any other way."""
    for module in pkgutil.walk_packages(jb.__path__, "jaxbody."):
        import_module(module.name)
    assert {type(result) for result in results} == classes()
    for result in results:
        with jb.compile_times() as times:
            looked_at(result)
        assert times.count == 0, times
        for status in jb.Status:
            ended = eqx.tree_at(
                lambda r: r.status, result, np.full(np.shape(result.status), status.value)
            )
            program = jax.make_jaxpr(lambda ended=ended: looked_at(ended) and ())()
            assert not program.eqns, (type(result).__name__, status.name)
