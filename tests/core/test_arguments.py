"""Lists instead of dicts, classes instead of objects, text instead of numbers: one message each,
before anything is computed."""

import warnings

import diffrax
import jax
import numpy as np
import pytest

import jaxbody as jb

BODY, SUPPORT = jb.Body(mass=1.0, inertia=[1, 1, 1], position=[0, 0, 1]), jb.Support()
SPRING = jb.Spring(("mass", [0, 0, 0]), ("base", [0, 0, 0]), stiffness=400.0, free_length=1.0)
GUIDE, PUSH, PLACE = (
    jb.Guide("base", axis=[0, 0, 1]),
    jb.Force("mass", force=[0, 0, 1.0]),
    jb.Position("mass", axis=[0, 0, 1]),
)
CASE, TIMES = jb.LoadCase(acceleration=[0, 0, 1]), [0.0, 0.1, 0.2]


def model(**changed):
    parts = {
        "bodies": {"mass": BODY},
        "supports": {"base": SUPPORT},
        "elements": {"s": SPRING},
        "joints": {"mass": GUIDE},
    }
    return jb.Model(**(parts | changed))


def experiment(**changed):
    return jb.Experiment(
        TIMES, **({"sensors": {"z": PLACE}, "measured": {"z": np.zeros(3)}} | changed)
    )


def simulate(**options):
    return jb.simulate(model(), TIMES, **options)


def heaviness(m):
    return {"weight": 9.81 * m["mass"].mass, "sag": m["mass"].mass / m["s"].stiffness}


def tune(**options):
    return jb.tune(model(), heaviness, free=["s.stiffness"], minimize="sag", **options)


# A call; then where its problem is, the kind of the value, and the dict that is expected
DICTS = {
    "bodies": (lambda: model(bodies=[BODY]), "bodies", "a list {name: jb.Body(...)}"),
    "one body": (lambda: model(bodies=BODY), "bodies", "a Body {name: jb.Body(...)}"),
    "supports": (lambda: model(supports={"base"}), "supports", "a set {name: jb.Support(...)}"),
    "elements": (lambda: model(elements=[SPRING]), "elements", "a list {name: jb.Spring(...)}"),
    "joints": (lambda: model(joints=(GUIDE,)), "joints", "a tuple {name: jb.Hinge(...)}"),
    "loads of simulate": (lambda: simulate(loads=[PUSH]), "loads", "a list {name: jb.Force(...)}"),
    "one motion": (
        lambda: simulate(motion=jb.inputs.AtRest()),
        "motion",
        "an AtRest {support: jb.Harmonic(...)}",
    ),
    "loads of equilibrium": (
        lambda: jb.equilibrium(model(), loads=PUSH),
        "loads",
        "a Force {name: jb.Force(...)}",
    ),
    "cases": (
        lambda: jb.load_cases(model(), [CASE]),
        "load_cases.cases",
        "a list {name: jb.LoadCase(...)}",
    ),
    "loads of a case": (
        lambda: jb.LoadCase(loads=[PUSH]),
        "LoadCase.loads",
        "a list {name: jb.Force(...)}",
    ),
    "sensors": (
        lambda: experiment(sensors=[PLACE]),
        "Experiment.sensors",
        "a list {name: jb.Position(...)}",
    ),
    "measured": (
        lambda: experiment(measured=[np.zeros(3)]),
        "Experiment.measured",
        "a list {name: array}",
    ),
    "motion of an experiment": (
        lambda: experiment(motion=[jb.inputs.AtRest()]),
        "Experiment.motion",
        "a list {support: jb.Harmonic(...)}",
    ),
    "loads of an experiment": (
        lambda: experiment(loads=[PUSH]),
        "Experiment.loads",
        "a list {name: jb.Force(...)}",
    ),
    "replace": (
        lambda: jb.replace(model(), ["s.stiffness"]),
        "replace.values",
        "a list {path: value}",
    ),
    "scatter": (
        lambda: jb.tolerances(model(), heaviness, ["s.stiffness"]),
        "tolerances.scatter",
        "a list {path: standard deviation}",
    ),
    "scatter of robust": (
        lambda: jb.design.robust(heaviness, 0.1)(model()),
        "robust.scatter",
        "a float {path: standard deviation}",
    ),
    "over": (
        lambda: jb.sweep(model(), heaviness, [1.0, 2.0]),
        "sweep.over",
        "a list {path: [values]}",
    ),
    "bounds": (lambda: tune(bounds=[(1.0, 2.0)]), "tune.bounds", "a list {path: (lower, upper)}"),
    "catalogues": (lambda: tune(catalogues=[1.0]), "tune.catalogues", "a list {path: [values]}"),
    "displaced": (
        lambda: jb.excitation(model(), model().reference, [0.1] * 6),
        "excitation.displaced",
        "a list {support: 6 numbers}",
    ),
}


@pytest.mark.parametrize("case", DICTS)
def test_named_things_are_given_as_a_dict(case):
    build, where, words = DICTS[case]
    with pytest.raises(jb.JaxbodyError) as refused:
        build()
    (problem,) = refused.value.problems
    kind, _, form = words.partition(" {")
    assert (problem.code, problem.where, problem.limit) == ("WRONG_KIND", where, "a dict {" + form)
    assert problem.message == f"is {kind}" and problem.value is not None
    assert problem.hint == f'Write {where.split(".")[-1]}={{"...": {form.split(": ")[1][:-1]}}}.'


NUMBERS = {
    "rtol": (lambda: simulate(rtol="x"), "NOT_A_NUMBER", "simulate.rtol", "'x' numbers"),
    "two rtol": (
        lambda: simulate(rtol=[1e-6, 1e-6]),
        "BAD_SHAPE",
        "simulate.rtol",
        "(2,) one number",
    ),
    "negative rtol": (lambda: simulate(rtol=-1e-6), "BAD_NUMBER", "simulate.rtol", "-1e-06 > 0"),
    "dt0": (lambda: simulate(dt0="x"), "NOT_A_NUMBER", "simulate.dt0", "'x' numbers"),
    "max_steps": (
        lambda: simulate(max_steps=3.5),
        "BAD_NUMBER",
        "simulate.max_steps",
        "3.5 whole number >= 1",
    ),
    "max_steps in text": (
        lambda: simulate(max_steps="3"),
        "BAD_NUMBER",
        "simulate.max_steps",
        "'3' whole number >= 1",
    ),
    "steps of equilibrium": (
        lambda: jb.equilibrium(model(), max_steps=3.5),
        "BAD_NUMBER",
        "equilibrium.max_steps",
        "3.5 whole >= 0",
    ),
    "solver": (
        lambda: simulate(solver=diffrax.Tsit5),
        "WRONG_KIND",
        "simulate.solver",
        "the class Tsit5 Write Tsit5(...).",
    ),
    "solver in text": (
        lambda: simulate(solver="rk4"),
        "WRONG_KIND",
        "simulate.solver",
        "a str diffrax.Tsit5()",
    ),
    "controller": (
        lambda: simulate(stepsize_controller=diffrax.PIDController),
        "WRONG_KIND",
        "simulate.stepsize_controller",
        "class PIDController",
    ),
    "adjoint": (
        lambda: simulate(adjoint=diffrax.ForwardMode),
        "WRONG_KIND",
        "simulate.adjoint",
        "the class ForwardMode",
    ),
    "motion": (
        lambda: simulate(motion={"base": jb.Harmonic}),
        "WRONG_KIND",
        "motion['base']",
        "the class Harmonic",
    ),
    "element": (
        lambda: model(elements={"s": jb.Spring}),
        "WRONG_KIND",
        "elements['s']",
        "the class Spring Write Spring(...).",
    ),
    "trajectory": (
        lambda: jb.measure("x", {"z": PLACE}),
        "WRONG_KIND",
        "measure.trajectory",
        "a str jb.simulate(...)",
    ),  # pyright: ignore
    "points": (
        lambda: jb.pareto(
            model(), heaviness, minimize=["weight", "sag"], free=["*.mass"], points=3.5
        ),
        "BAD_FRONT",
        "pareto.points",
        "3.5",
    ),
    "starts": (lambda: tune(starts=2.5), "BAD_STARTS", "tune.starts", "2.5 whole number"),
    "max_iterations": (
        lambda: tune(max_iterations="x"),
        "BAD_NUMBER",
        "tune.max_iterations",
        "'x' whole number",
    ),
    "text of a catalogue": (
        lambda: tune(catalogues={"s.stiffness": "x"}),
        "NOT_A_NUMBER",
        "tune.catalogues['s.stiffness']",
        "['x'] numbers",
    ),
    "number of a catalogue": (
        lambda: tune(catalogues={"s.stiffness": 3.0}),
        "BAD_CATALOGUE",
        "tune.catalogues['s.stiffness']",
        "3.0 positive",
    ),
    "samples": (
        lambda: jb.tolerances(model(), heaviness, {"*.mass": 0.1}, samples=2.5),
        "BAD_SCATTER",
        "tolerances.samples",
        "2.5 whole",
    ),
    "scatter in text": (
        lambda: jb.tolerances(model(), heaviness, {"*.mass": "5 %"}),
        "NOT_A_NUMBER",
        "tolerances.scatter['*.mass']",
        "'5 %'",
    ),
    "samples of a sweep": (
        lambda: jb.sweep(model(), heaviness, {"*.mass": (1.0, 2.0)}, samples=2.5),
        "BAD_NUMBER",
        "sweep.samples",
        "2.5",
    ),
    "chunk": (
        lambda: jb.sweep(model(), heaviness, {"*.mass": [1.0]}, chunk=1.5),
        "BAD_CHUNK",
        "sweep.chunk",
        "1.5 whole number",
    ),
    "starts of a search": (
        lambda: jb.find_equilibria(model(), starts=3.5),
        "BAD_NUMBER",
        "find_equilibria.starts",
        "3.5 whole number",
    ),
    "spread": (
        lambda: jb.find_equilibria(model(), spread="x"),
        "NOT_A_NUMBER",
        "find_equilibria.spread",
        "'x' numbers",
    ),
    "sigmas": (
        lambda: jb.design.robust(heaviness, {"*.mass": 0.1}, sigmas="x"),
        "NOT_A_NUMBER",
        "robust.sigmas",
        "'x' numbers",
    ),
    "seed": (
        lambda: jb.fitting.multistart(model(), {}, free=[], seed="x"),
        "BAD_NUMBER",
        "multistart.seed",
        "'x' whole number >= 0",
    ),
    "free": (lambda: jb.preload(model(), free=3), "WRONG_KIND", "preload.free", "an int paths"),
}


@pytest.mark.parametrize("case", NUMBERS)
def test_options_of_the_wrong_kind_are_refused_by_name(case):
    build, code, where, words = NUMBERS[case]
    with pytest.raises(jb.JaxbodyError) as refused:
        build()
    (problem,) = refused.value.problems
    assert (problem.code, problem.where) == (code, where) and problem.limit
    assert all(word in str(problem) for word in words.split())


@pytest.fixture(scope="module")
def fitted():
    several = experiment(
        measured={"z": 1 + (1 - np.cos(20 * np.array(TIMES))) / 400},
        noise=1e-4,
        initial=model().reference,
        loads={"p": PUSH},
    )
    return jb.fit(model(), {"several": several}, free=["s.stiffness"])


KEYED = {
    "measure": lambda fitted, key: jb.measure(simulate(), {"z": PLACE}, noise=1e-3, key=key),
    "confidence_bands": lambda fitted, key: jb.confidence_bands(
        fitted, lambda m: m["s"].stiffness, samples=4, key=key
    ),
    "interval_coverage": lambda fitted, key: jb.fitting.interval_coverage(
        fitted, replicates=2, key=key
    ),
    "tune": lambda fitted, key: tune(key=key, bounds={"s.stiffness": (200.0, 800.0)}, starts=2),
    "sweep": lambda fitted, key: jb.sweep(
        model(), heaviness, {"*.mass": (1.0, 2.0)}, samples=2, key=key
    ),
    "tolerances": lambda fitted, key: jb.tolerances(
        model(), heaviness, {"*.mass": 0.1}, samples=4, key=key
    ),
    "find_equilibria": lambda fitted, key: jb.find_equilibria(model(), starts=2, key=key),
    "road_profile": lambda fitted, key: jb.vibration.road_profile(
        jb.vibration.RoadRoughness.iso("C"), length=10.0, spacing=1.0, key=key
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("where", KEYED)
def test_a_number_in_place_of_a_key_is_refused_with_the_key_to_write(where, fitted):
    """So is anything else but a random key of JAX; keys of the old kind are accepted."""
    for key, seed in (
        (3, 3),
        (np.int64(5), 5),
        ("3", 0),
        (np.random.default_rng(1), 0),
        (jax.random.split(jax.random.key(0), 2), 0),
    ):
        with pytest.raises(jb.JaxbodyError) as refused:
            KEYED[where](fitted, key)
        (problem,) = refused.value.problems
        assert (problem.code, problem.where) == ("WRONG_KIND", f"{where}.key")
        assert f"key=jax.random.key({seed})" in problem.hint
    KEYED[where](fitted, jax.random.PRNGKey(3))


def test_noise_from_a_traced_key():
    run = simulate()
    measure = lambda key: jb.measure(run, {"z": PLACE}, noise=1e-3, key=key)["z"]  # noqa: E731
    np.testing.assert_array_equal(jax.jit(measure)(jax.random.key(3)), measure(jax.random.key(3)))


def test_all_problems_of_a_call_are_in_one_error():
    with pytest.raises(jb.JaxbodyError) as refused:
        simulate(
            loads=[PUSH],
            motion={"bse": jb.inputs.AtRest()},
            rtol="x",
            max_steps=2.5,
            solver=diffrax.Tsit5,
        )
    assert [problem.where for problem in refused.value.problems] == [
        "motion",
        "loads",
        "simulate.solver",
        "simulate.rtol",
        "simulate.max_steps",
    ]


def test_whole_numbers_may_be_written_as_floats():
    assert simulate(max_steps=1e3).ok


@pytest.mark.long
def test_names_of_numpy_are_names():
    """Strings of NumPy, as pandas and np.array return them, become Python's: the model is
    the same."""
    mass, base, s = np.array(["mass", "base", "s"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        spring = jb.Spring((mass, [0, 0, 0]), (base, [0, 0, 0]), stiffness=400.0, free_length=1.0)
        built = model(
            bodies={mass: BODY},
            supports={base: SUPPORT},
            elements={s: spring},
            joints={mass: jb.Guide(base, axis=[0, 0, 1])},
        )
        jb.equilibrium(built, loads={s: jb.Force(mass, force=[0, 0, 1.0])})
        ends = [
            jb.Position(mass).on,
            jb.sensors.ForcePlate(base).on,
            jb.sensors.Reaction(mass).on,
            jb.Position(mass, axis="z").on,
            jb.BaseMotion(base, np.str_("z"), kind=np.str_("velocity")).kind,
        ]
    assert (
        built.layout == model().layout
        and built.elements[0].names == ("s",)
        and built.elements[0].links == (("mass", "base"),)
    )
    names = [*ends, *built.names, *built.layout.parents, *built.elements[0].links[0]]
    assert {type(name) for name in names} == {str}
