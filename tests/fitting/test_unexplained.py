"""A fit that explains nothing is not ok, and says what is wrong with its record; honest records in
much noise are fitted as ever."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

TIMES = np.linspace(0.0, 3.0, 301)
STIFFNESS, DAMPING, MASS, START = 300.0, 1.0, 2.0, 0.1
FREE = ["s.stiffness", "s.damping"]
INITIAL = jb.State(q=jnp.array([START]), v=jnp.zeros(1))


def slider(stiffness=280.0, damping=1.2):
    """A body that slides along x, 1 m from the wall at rest."""
    spring = jb.Spring(
        ("a", [0, 0, 0]),
        ("world", [0, 0, 0]),
        stiffness=stiffness,
        damping=damping,
        free_length=1.0,
    )
    body = jb.Body(MASS, [1, 1, 1], position=[1, 0, 0])
    return jb.Model(
        bodies={"a": body}, joints={"a": jb.Guide("world", axis=[1, 0, 0])}, elements={"s": spring}
    )


def swing():
    """m x'' + c x' + k x = 0 from x = 0.1 m at rest."""
    rate = DAMPING / (2 * MASS)
    w = np.sqrt(STIFFNESS / MASS - rate**2)
    return START * np.exp(-rate * TIMES) * (np.cos(w * TIMES) + rate / w * np.sin(w * TIMES))


def noise(level=1e-3, seed=0):
    return level * np.random.default_rng(seed).normal(size=TIMES.size)


def run(x, sensor=None):
    sensor = (
        jb.sensors.Displacement("a", ("world", [1, 0, 0]), axis=[1, 0, 0])
        if sensor is None
        else sensor
    )
    return {"run": jb.Experiment(TIMES, initial=INITIAL, sensors={"x": sensor}, measured={"x": x})}


def fitted(experiments, model=None, free=FREE):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", jb.JaxbodyWarning)
        result = jb.fit(
            slider() if model is None else model, experiments, free=free, progress=False
        )
    return result, [w.message.code for w in caught]


BLUNDERS = {  # change, words of the report
    "sign": (lambda x: -x, "run.x is -1", "sign or its axis reversed"),
    "millimeters": (lambda x: 1e3 * x, "thousandths of the sensor's unit"),
    "inches": (lambda x: x / 0.0254, "is it in inches"),
    "unrelated": (lambda x: np.cumsum(noise(0.01, seed=3)), "hardly follows the prediction"),
    "a place": (
        lambda x: 1.0 + x,
        "m above the prediction throughout: is it a place? Use Position",
    ),
}


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=() if case == "sign" else pytest.mark.long) for case in BLUNDERS],
)
def test_a_fit_that_explains_nothing_is_far_off_and_says_why(case):
    change, *words = BLUNDERS[case]
    result, codes = fitted(run(change(swing()) + noise()))
    assert (
        int(result.status) == jb.Status.FAR_OFF
        and "FAR_OFF" in codes
        and "CORRELATED_RESIDUALS" not in codes
    )
    assert "the residuals of run.x have a rms of" in result.report()
    assert [word for word in words if word not in result.report()] == [], result.report()


@pytest.mark.parametrize("level", [0.0, 0.3, 3.0])
def test_an_honest_record_in_noise_is_not_far_off(level):
    """Noise of 0, 30 and 300 % of the motion: what is left is white, and the truth is inside four
    standard errors."""
    x = swing()
    result, codes = fitted(run(x + noise(level * x.std() + 1e-9, seed=1)))
    assert "FAR_OFF" not in codes, result.report()
    if level < 1:
        assert result.ok
        for path, true in zip(FREE, (STIFFNESS, DAMPING), strict=True):
            assert (
                abs(float(result.estimates[path]) - true)
                < 4 * float(result.standard_errors[path]) + 1e-6 * true
            )


def test_a_position_that_was_a_displacement_is_named_by_diagnose_and_fit():
    experiments = run(swing() + noise(), jb.Position("a", axis=[1, 0, 0]))
    words = "run.x is 1 m below the prediction throughout: is it a displacement? Use Displacement"
    with pytest.warns(jb.JaxbodyWarning, match="OFFSET"):
        assert jb.diagnose(slider(STIFFNESS, DAMPING), experiments, progress=False).words == (
            words,
        )
    result, _ = fitted(experiments)
    assert int(result.status) == jb.Status.FAR_OFF and words.split(": ")[1] in result.report()


def test_a_tiny_start_is_refused_with_a_size_that_has_an_effect():
    """From the size that the message names the damping is found; below it, integration errors hide
    what it does."""
    experiments = run(swing() + noise())
    for damping in (1e-8, 1e-10):
        with pytest.raises(jb.JaxbodyError) as caught:
            fitted(experiments, slider(damping=damping))
        assert (
            caught.value.code == "TINY_START"
            and caught.value.where == "s.damping"
            and "no effect" not in str(caught.value)
        )
    result, _ = fitted(experiments, slider(damping=float(caught.value.limit.split()[0])))
    assert result.ok and abs(float(result.estimates["s.damping"]) - DAMPING) < 4 * float(
        result.standard_errors["s.damping"]
    )


def test_ties_of_objects_and_of_names_with_an_equals_sign():
    def two(first, second):
        names = (first, second)
        springs = {
            f"{name} spring": jb.Spring(
                (name, [0, 0, 0]), ("world", [0, 0, 0]), stiffness=300.0, free_length=1.0 + i
            )
            for i, name in enumerate(names)
        }
        bodies = {
            name: jb.Body(2.0, [1, 1, 1], position=[i + 1.0, 0, 0]) for i, name in enumerate(names)
        }
        return jb.Model(
            bodies=bodies,
            joints=dict.fromkeys(names, jb.Guide("world", axis=[1, 0, 0])),
            elements=springs,
        )

    def space(free, *names):
        from jaxbody.fitting.parameters.spaces import space_of

        return space_of(two(*names), free, "fit")

    for free in (["left = right"], ["left spring = right spring"]):
        with pytest.raises(jb.JaxbodyError, match=r"matches nothing. Did you mean") as caught:
            space(free, "left", "right")
        assert {problem.code for problem in caught.value.problems} == {"UNKNOWN_PATH"}
    with pytest.raises(
        jb.JaxbodyError, match=r"lists 'left.mass' twice. List each parameter once."
    ) as caught:
        space(["left.mass", "left.mass"], "left", "right")
    assert [problem.code for problem in caught.value.problems] == ["LISTED_TWICE"]
    with pytest.raises(
        jb.JaxbodyError,
        match=r"ties left.mass to itself with another factor.*Name the other one. \[BAD_TIE\]",
    ):
        space(["left.mass = left.mass * 2"], "left", "right")
    assert space(["a=b.mass"], "a=b", "c").size == 1 and space(["a=b.*"], "a=b", "c").size > 1
    tied = space(["a=b.mass = c.mass"], "a=b", "c")
    assert tied.size == 1 and len(tied.parameters[0].places) == 2
    assert space(["left.mass=right.mass"], "left", "right").size == 1
