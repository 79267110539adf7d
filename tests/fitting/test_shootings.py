"""Multiple shooting where single shooting works and where it fails; its Jacobian from a few columns
against the full one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxbody as jb
from jaxbody.fitting.experiments.experiments import Integration
from jaxbody.fitting.parameters.spaces import space_of
from jaxbody.fitting.residuals import Task, colors_of, first_noise, residual_and_jacobian
from jaxbody.fitting.shootings import Segments, cuts

# A pendulum, pulled by a spring whose foot shakes hard: theta'' = -(g/l) sin(theta) - ..., chaotic
# with little damping.
MASS, LENGTH, G, FOOT = 1.0, 1.0, 9.81, np.array([1.5, -1.0])
TIMES = np.linspace(0, 12, 241)
TRUTH = np.array([12.0, 1.1])  # stiffness of the spring, its free length
SHAKE, RATE = 1.0, 0.7  # m, Hz


def model_of(values):
    k, free = values
    return jb.Model(
        bodies={"bob": jb.Body(mass=MASS, inertia=[1e-9, 1e-9, 1e-9], position=[0, -LENGTH, 0])},
        supports={"foot": jb.Support(position=[*FOOT, 0])},
        joints={"bob": jb.Hinge("world", axis=[0, 0, 1], at=[0, 0, 0])},
        elements={
            "spring": jb.Spring(
                ("bob", [0, 0, 0]), ("foot", [0, 0, 0]), stiffness=k, free_length=free
            )
        },
        gravity=[0, -G, 0],
    )


def motion(values, times=TIMES):
    """By SciPy: m l^2 theta'' = -m g l sin(theta) + moment of the spring about the pivot."""
    k, free = values

    def rate(t, y):
        place = LENGTH * np.array([np.sin(y[0]), -np.cos(y[0])])
        along = LENGTH * np.array([np.cos(y[0]), np.sin(y[0])])
        d = FOOT + np.array([SHAKE * np.sin(2 * np.pi * RATE * t), 0]) - place
        L = np.linalg.norm(d)
        return [
            y[1],
            (-MASS * G * LENGTH * np.sin(y[0]) + k * (L - free) / L * (d @ along))
            / (MASS * LENGTH**2),
        ]

    return solve_ivp(
        rate,
        (times[0], times[-1]),
        [0.5, 0.0],
        t_eval=times,
        rtol=1e-11,
        atol=1e-12,
        method="DOP853",
    ).y[0]


def experiment(times):
    theta = motion(TRUTH, times)
    shake = {
        "foot": jb.Harmonic(frequency=RATE, translation=[SHAKE, 0, 0], translation_phase=-np.pi / 2)
    }
    measured = np.stack(
        [np.sin(theta), -np.cos(theta), 0 * theta], -1
    ) + 1e-3 * np.random.default_rng(0).normal(size=(len(times), 3))
    initial = jb.State(jnp.array([0.5]), jnp.array([0.0]))
    return {
        "run": jb.Experiment(
            times,
            motion=shake,
            initial=initial,
            sensors={"x": jb.Position("bob")},
            measured={"x": measured},
            noise=1e-3,
        )
    }


@pytest.mark.parametrize(("samples", "count"), [(11, 2), (41, 4), (42, 5), (43, 42), (100, 7)])
def test_segments_reach_one_another_and_cover_the_record(samples, count):
    starts, rows = cuts(samples, count)
    assert (
        starts[0] == 0
        and starts[-1] + rows == samples
        and (np.diff(starts) < rows).all()
        and (np.diff(starts) > 0).all()
    )


@pytest.mark.long
def test_where_one_shot_does_several_give_the_same():
    run = experiment(np.linspace(0, 3, 61))
    options = dict(free=["spring.stiffness", "spring.free_length"], rtol=1e-10, max_steps=2000)
    whole = jb.fit(model_of(1.05 * TRUTH), run, **options)
    several = jb.fitting.multiple_shooting(model_of(1.05 * TRUTH), run, segments=4, **options)
    assert (
        several.ok
        and list(several.experiments) == ["run"]
        and type(several.experiments["run"]) is jb.Experiment
    )
    for path, value in whole.estimates.items():
        np.testing.assert_allclose(several.estimates[path], value, rtol=1e-7)


def segments(samples, count):
    """Segments of a record with its own length; the states between them are arbitrary."""
    whole = experiment(np.linspace(0, 0.1 * samples, samples))["run"]
    q = jnp.asarray(np.random.default_rng(1).normal(size=(count - 1, 1)))
    return Segments(
        whole, jb.State(q, q), jb.State(jnp.ones(1), jnp.ones(1)), jnp.asarray(0.1), count
    )  # pyright: ignore[reportCallIssue]


@pytest.mark.long
def test_columns_that_touch_different_residuals_share_a_tangent():
    """Two runs in six segments each: two columns of the model, four of the states between, one of
    each run, in place of 24."""
    runs = {"a": segments(31, 6), "b": segments(31, 6)}
    model = model_of(TRUTH)
    free = [
        "spring.stiffness",
        "spring.free_length",
        "*.nodes.*",
        "a.initial.v",
        "b.foot.frequency",
    ]
    space = space_of(
        model,
        free,
        "fit",
        runs=runs,
        priors={"spring.stiffness": (11.0, 1.0), "b.foot.frequency": (0.7, 0.1)},
    )
    task = Task(space, first_noise(runs, False)[0], Integration(max_steps=500))
    u = jnp.asarray(np.random.default_rng(2).normal(size=space.size)) * 0.01
    r, J, _ = residual_and_jacobian(task, u)
    assert space.size == 24 and len(set(colors_of(space))) == 7
    one_by_one = jax.jacfwd(lambda u: 2 * (task.residual(u),), has_aux=True)
    # with other options of XLA a step is accepted here and not there
    all_columns, same = jb.jit(one_by_one)(u)
    np.testing.assert_allclose(r, same, rtol=1e-13)
    np.testing.assert_allclose(J, all_columns, rtol=1e-12, atol=1e-12 * np.abs(J).max())


@pytest.mark.long
def test_a_chaotic_record_is_fitted_where_one_shot_is_lost():
    """A part in a million of the stiffness is a thousand times as much in the angle before
    the end."""
    other = motion(TRUTH * [1 + 1e-6, 1])
    growth = np.abs(other - motion(TRUTH)).max() / 1e-6
    assert growth > 1e3
    options = dict(free=["spring.stiffness", "spring.free_length"], max_steps=10_000)
    with pytest.warns(jb.JaxbodyWarning):
        lost = jb.fit(model_of(TRUTH * [1.2, 0.9]), experiment(TIMES), **options)
    result = jb.fitting.multiple_shooting(
        model_of(TRUTH * [1.2, 0.9]), experiment(TIMES), segments=48, **options
    )
    assert float(lost.cost) > 100 * float(result.cost)
    assert result.ok
    for value, truth, error in zip(
        result.estimates.values(), TRUTH, result.standard_errors.values(), strict=True
    ):
        assert abs(float(value) - truth) < 4 * float(error) and float(error) < 1e-3 * truth
