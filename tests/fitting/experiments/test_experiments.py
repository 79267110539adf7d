"""Experiments from records as files hold them, plans without data, and what several measurements of
one model share."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.fitting import residuals
from jaxbody.fitting.experiments.experiments import Integration
from jaxbody.fitting.parameters.spaces import Space

UP = {"axis": [0, 0, 1]}
SENSORS = {"height": jb.Position("box", **UP), "acc": jb.Accelerometer("box", **UP)}


def box():
    return jb.Model(
        bodies={"box": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        supports={"floor": jb.Support()},
        joints={"box": jb.Guide("world", **UP)},
        elements={
            "s": jb.Spring(
                ("box", [0, 0, 0]),
                ("floor", [0, 0, -1]),
                stiffness=80.0,
                free_length=1.0,
                damping=1.0,
            )
        },
    )


@pytest.fixture
def record(tmp_path):
    """Milliseconds, millimeters and g, with a gap and a channel that no sensor reads."""
    rows = [[10 * i, "" if i == 3 else 7.5 * i, 0.1 * (-1) ** i, 20 + i] for i in range(8)]
    (tmp_path / "run.csv").write_text(
        "\n".join(["t,height,acc,T", *(",".join(map(str, row)) for row in rows)])
    )
    channels = {"height": ("height", "mm"), "acc": ("acc", "g"), "temperature": ("T", "1")}
    return jb.read_record(tmp_path / "run.csv", time=("t", "ms"), channels=channels, irregular=True)


def codes(**options):
    with pytest.raises(jb.JaxbodyError) as caught:
        jb.Experiment(**options)
    return [(problem.code, problem.where) for problem in caught.value.problems], str(caught.value)


def test_a_record_is_taken_as_it_comes_from_its_file(record):
    run = jb.Experiment(sensors=SENSORS, measured=record, leave_out=0.005)
    np.testing.assert_allclose(run.times, np.arange(8) / 100, atol=1e-15)
    height = 7.5e-3 * np.arange(8)
    height[[0, 3]] = np.nan
    np.testing.assert_allclose(run.measured["height"], height, rtol=1e-15)
    np.testing.assert_allclose(
        run.measured["acc"][1:], 0.980665 * (-1.0) ** np.arange(1, 8), rtol=1e-15
    )
    assert set(run.measured) == {"height", "acc"}


def test_what_does_not_fit_a_record_is_said_at_once(record):
    sensors = {
        "acc": SENSORS["height"],
        "heigth": SENSORS["height"],
        "height": jb.sensors.BodyPose("box"),
    }
    found, message = codes(sensors=sensors, measured=record)
    place = "Experiment.measured['{}']".format
    wrong = [
        ("WRONG_DIMENSION", place("acc")),
        ("UNKNOWN_CHANNEL", place("heigth")),
        ("WRONG_DIMENSION", place("height")),
    ]
    assert (
        found[:3] == wrong
        and "is in 'm/s2' (allowed: 'm')" in message
        and "height, acc, temperature" in message
    )
    assert codes(times=record.times, sensors=SENSORS, measured=record)[0] == [
        ("BAD_OPTION", "Experiment.times")
    ]
    assert codes(sensors=SENSORS)[0] == [("NO_TIME", "Experiment.times")]
    volts = {"temperature": jb.Position("box", gain=25.0, **UP)}  # a gain converts into any unit
    assert jb.Experiment(sensors=volts, measured=record).measured["temperature"].shape == (8,)


@pytest.mark.long
def test_a_torsion_spring_reads_an_angle_and_a_moment():
    """Records in rad and N m fit its sensors; its outputs have these units; the moment is the
    stiffness times the angle."""
    arm = jb.Body(mass=1.0, inertia=[1, 1, 1])
    bar = jb.Torsion("arm", "world", axis=[0, 0, 1], spring=30.0)
    model = jb.Model(
        bodies={"arm": arm},
        joints={"arm": jb.Hinge("world", axis=[0, 0, 1])},
        elements={"bar": bar},
    )
    sensors = {"angle": jb.Elongation("bar"), "moment": jb.sensors.LoadCell("bar")}
    times = np.linspace(0, 0.5, 11)
    turned = 0.1 * np.cos(30**0.5 * times)
    start = jb.State(np.array([0.1]), np.zeros(1))
    angle = np.asarray(
        jb.measure(jb.simulate(model, times, initial=start, rtol=1e-11), sensors)["angle"]
    )
    np.testing.assert_allclose(np.abs(angle), np.abs(turned), rtol=0, atol=1e-9)
    record = jb.Record(times, {"angle": (np.rad2deg(angle), "deg"), "moment": (30 * angle, "N m")})
    run = jb.Experiment(sensors=sensors, measured=record, initial=start)
    np.testing.assert_allclose(run.measured["angle"], angle, rtol=1e-12)
    lin = jb.linearize(model, model.reference)
    H = jb.frequency_response(lin, [0.5], {"push": jb.PointForce("arm", direction="rz")}, sensors)
    assert H.output_units == ("rad", "N m")
    np.testing.assert_allclose(H.values[1], 30 * H.values[0], rtol=1e-12)


def test_a_motion_that_ends_before_the_record_is_refused_before_a_model_is_there(record):
    times = np.linspace(0, 0.05, 6)
    shaken = {"floor": jb.Sampled(times, translation=np.zeros((6, 3)))}
    found, message = codes(sensors=SENSORS, measured=record, motion=shaken)
    assert (
        found == [("T_RANGE", "Experiment.motion['floor']")]
        and "covers 0 to 0.05 s, requested 0 to 0.07 s" in message
    )
    jb.Experiment(sensors=SENSORS, measured=record.part(0, 0.05), motion=shaken)


@pytest.mark.parametrize(
    "use",
    [
        lambda plan: jb.fit(box(), {"plan": plan}, free="s.stiffness"),
        lambda plan: jb.fitting.multiple_shooting(
            box(), {"plan": plan}, free="s.stiffness", segments=2
        ),
        lambda plan: jb.diagnose(box(), {"plan": plan}),
    ],
    ids=["fit", "multiple_shooting", "diagnose"],
)
def test_a_plan_has_no_data_to_fit(use):
    plan = jb.Experiment(np.linspace(0, 1, 21), sensors=SENSORS, noise={"height": 1e-3})
    assert not plan.measured and float(plan.noise["height"]) == 1e-3
    with pytest.raises(jb.JaxbodyError, match=r"is a plan, without measured data.*NO_DATA"):
        use(plan)


@pytest.mark.long
def test_measurements_of_one_model_share_its_linearization(monkeypatch):
    """Two responses and two modal tests of other structure; nothing is compiled here."""
    inputs, outputs = (
        {"f": jb.PointForce("box", direction="z")},
        {"z": jb.Position("box", axis="z")},
    )

    def hammer(count):
        return jb.MeasuredResponse(
            np.linspace(0.5, 2, count),
            inputs=inputs,
            outputs=outputs,
            measured={("z", "f"): np.ones(count) + 0j},
        )

    test = jb.MeasuredModes(frequency=[1.0], noise={"frequency": 1e-2})
    both = jb.MeasuredModes(
        frequency=[1.0], damping_ratio=[0.1], noise={"frequency": 1e-2, "damping_ratio": 1e-2}
    )
    measured = {"hammer": hammer(5), "again": hammer(7), "test": test, "both": both}
    noise = {
        run: {name: jnp.array(1.0) for name in each.channels} for run, each in measured.items()
    }
    asked, small_motions = [], residuals.small_motions
    monkeypatch.setattr(
        residuals, "small_motions", lambda model: asked.append(model) or small_motions(model)
    )
    task = residuals.Task(Space(box(), (), measured), noise, Integration())
    shapes = jax.eval_shape(task.runs, jnp.zeros(0))
    assert len(asked) == 1 and shapes["again"][0]["z/f"].shape == (7,)
    jax.eval_shape(residuals.Task(Space(box(), ()), {}, Integration()).runs, jnp.zeros(0))
    assert len(asked) == 1
