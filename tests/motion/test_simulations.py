"""Simulated motion: energy and work, independence from sample times and shifts of time, and
messages of failed integrations."""

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
import rigs
from rigs import max_difference

import jaxbody as jb
from jaxbody import Status
from jaxbody.mechanics.closed_loops import dynamics_of
from jaxbody.model.joints.kinematics import Coordinates

PANELS, NODES = 50, 8


def lobatto(end):
    """Times and weights of Lobatto quadrature: panels of nine nodes that share their ends, exact
    to degree 15."""
    inner = np.polynomial.legendre.Legendre.basis(NODES).deriv().roots().real
    x = np.concatenate([[-1], inner, [1]])
    w = 2 / (NODES * (NODES + 1) * np.polynomial.legendre.Legendre.basis(NODES)(x) ** 2)
    half = end / PANELS / 2
    times = (np.arange(PANELS)[:, None] * 2 + 1 + x[None, :-1]) * half
    return np.append(times.ravel(), end), w * half


def integral(values, weights):
    """From the start to the end of every panel."""
    panels = np.lib.stride_tricks.sliding_window_view(values, NODES + 1)[::NODES]
    return np.cumsum(panels @ weights)


TIMES, WEIGHTS = lobatto(2.0)  # all simulations of the rig have as many samples
SHAKEN = {"base": jb.Harmonic(**rigs.SHAKING)}


@pytest.fixture(scope="module")
def rig():
    return rigs.rig()


@pytest.fixture(scope="module")
def resting(rig):
    result = jb.equilibrium(rig)
    assert result.ok
    return result


@pytest.fixture(scope="module")
def start(rig, resting):
    q = Coordinates(rig).retract(
        resting.state.q, jnp.array([0.04, -0.03, 0.05, 0.15, -0.1, 0.2, -0.3])
    )
    return jb.State(q, jnp.array([0.3, -0.2, 0.1, 0.5, 0.4, -0.3, 0.8]))


@pytest.fixture(scope="module")
def shaken(rig, start):
    return jb.simulate(rig, TIMES, motion=SHAKEN, initial=start, rtol=1e-10)


# Energy


@pytest.mark.parametrize("rtol", [1e-6, 1e-8, 1e-10, 1e-12])
@pytest.mark.parametrize("name", ["plate", pytest.param("rig", marks=pytest.mark.long)])
def test_energy_stays_within_a_hundred_tolerances_for_ten_seconds(name, rtol, start):
    """Energy above the equilibrium's, relative to its initial value; the base has a motion of
    zero amplitude."""
    if name == "plate":
        model, times = rigs.plate(), np.linspace(0, 10, 401)
        state = jb.State(
            jnp.array([0.05, -0.04, -0.2, 0.98, 0.1, -0.08, 0.15]),
            jnp.array([0.3, -0.2, 0.1, 0.5, 0.4, -0.3]),
        )
        state = jb.State(state.q.at[3:].divide(jnp.linalg.norm(state.q[3:])), state.v)
    else:
        model, times, state = (
            jb.replace(rigs.rig(), {"*.damping": 0.0}),
            np.linspace(0, 10, len(TIMES)),
            start,
        )
    still = {**rigs.SHAKING, "translation": np.zeros(3), "rotation": np.zeros(3)}
    trajectory = jb.simulate(
        model, times, motion={"base": jb.Harmonic(**still)}, initial=state, rtol=rtol
    )
    energy = trajectory.energies["total"] - jb.equilibrium(model).energy
    print(
        "drift",
        name,
        rtol,
        np.abs(energy - energy[0]).max() / energy[0] / rtol,
        "rtol, steps",
        trajectory.statistics["num_accepted_steps"],
    )
    assert np.abs(energy - energy[0]).max() <= 100 * rtol * energy[0]


@pytest.mark.long
def test_the_errors_by_rtol_are_those_of_the_docstring(monkeypatch):
    """Of the plate of the benchmarks against SciPy's DOP853 at 1e-13; the table has one digit,
    right within a factor of two."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "benchmarks")
    from plate import JOB

    rows = [line.split() for line in inspect.getdoc(jb.simulate).splitlines()]
    tolerances, errors = (
        [float(number) for number in row[len(head) :]]
        for head in (["rtol"], ["error,", "plate"])
        for row in rows
        if row[: len(head)] == head
    )
    times = np.linspace(0, 10, 101)
    exact = JOB.solution(JOB.stiffness, times, rtol=1e-13)
    for rtol, stated in list(zip(tolerances, errors, strict=True))[::2]:
        result = JOB.error(
            jb.simulate(JOB.model(), times, motion=JOB.motion(), rtol=rtol).state.q, exact
        )
        assert stated / 10 < result < 2 * stated, (rtol, result)


def base_velocity(times):
    """Velocity and angular velocity of the shaken base by complex steps through
    Rodrigues' formula."""
    a, p = rigs.SHAKING, 2 * np.pi * rigs.SHAKING["frequency"]
    v, w = [], []
    for t in times:
        h = 1e-30
        moved = np.concatenate([a["translation"], a["rotation"]]) * np.cos(
            p * (t + 1j * h) + np.concatenate([a["translation_phase"], a["rotation_phase"]])
        )
        v.append(moved[:3].imag / h)
        R = rigs.rodrigues(moved[3:])
        spin = (R.imag / h) @ R.real.T
        w.append([spin[2, 1], spin[0, 2], spin[1, 0]])
    return np.array(v), np.array(w)


CLOSE = [pytest.param(rtol, True, marks=pytest.mark.long) for rtol in (1e-10, 1e-12)]


@pytest.mark.parametrize(("rtol", "on_samples"), [(1e-6, False), (1e-8, False), *CLOSE])
def test_work_of_the_moving_base_is_the_change_of_energy_plus_dissipation(
    rig, resting, start, rtol, on_samples
):
    """Work by quadrature of reaction times velocity of the base; loss by quadrature of (tension - k
    elongation)^2 / c. For the closest tolerances steps end on the samples: between the ends of its
    steps Dopri8 interpolates to the sixth order only."""
    controller = diffrax.ClipStepSizeController(
        diffrax.PIDController(rtol=jnp.array(rtol), atol=jnp.array(rtol / 100)),
        step_ts=jnp.array(TIMES),
    )
    trajectory = jb.simulate(
        rig,
        TIMES,
        motion=SHAKEN,
        initial=start,
        **({"stepsize_controller": controller} if on_samples else {"rtol": rtol}),
    )
    v, w = base_velocity(TIMES)
    force, moment = trajectory.reactions["base"]
    input_power = -(force * v).sum(1) - (moment * w).sum(1)
    loss = 0.0
    for i, (stiffness, damping) in enumerate(
        zip(rigs.PARAMETERS["stiffness"], rigs.PARAMETERS["damping"], strict=True)
    ):
        own = (
            trajectory.forces[f"s{i}"] - stiffness * trajectory.elongations[f"s{i}"]
        ) ** 2 / damping
        assert max_difference(trajectory.lost_powers[f"s{i}"], own) < 1e-12 * own.max()
        loss += own
    energy = trajectory.energies["total"]
    scale = (energy - resting.energy).max()
    error = (
        energy[NODES::NODES] - energy[0] - integral(input_power, WEIGHTS) + integral(loss, WEIGHTS)
    )
    print(
        "work",
        rtol,
        np.abs(error).max() / scale / rtol,
        np.abs(error[-1]) / scale / rtol,
        "change",
        (energy[-1] - energy[0]) / scale,
    )
    assert np.abs(integral(input_power, WEIGHTS)).max() > 0.01 * scale
    assert np.abs(error).max() <= 10 * rtol * scale
    assert (
        max_difference(trajectory.powers["supports"], input_power)
        < 1e-12 * np.abs(input_power).max()
    )
    assert max_difference(trajectory.powers["damping"], loss) < 1e-12 * loss.max()


# Turning over


@pytest.mark.long
def test_a_body_turning_a_hundred_times_follows_the_exponential():
    """A sphere on a relaxed spring to its center: nothing turns it, R(t) = exp([w] t)."""
    turns, end = 100, 10.0
    axis = np.array([0.48, -0.6, 0.64])
    model = rigs.hung(
        jb.Body(mass=1.0, inertia=[0.3, 0.3, 0.3], com=[0, 0, 0]),
        to=[0, 0, 1],
        stiffness=1.0,
        free_length=1.0,
    )
    times = np.linspace(0, end, 501)
    w = 2 * np.pi * turns / end
    start = jb.State(model.reference.q, jnp.concatenate([jnp.zeros(3), w * axis]))
    trajectory = jb.simulate(model, times, initial=start, rtol=1e-11)
    R = np.array([rigs.rodrigues(axis * w * t) if t else np.eye(3) for t in times])
    print("turns", max_difference(rigs.turned(trajectory.state.q[:, 3:]), R))
    assert max_difference(rigs.turned(trajectory.state.q[:, 3:]), R) < 1e-8  # 628 rad at 1e-11
    assert (
        max_difference(trajectory.poses["body"].R, rigs.turned(trajectory.state.q[:, 3:])) < 1e-14
    )
    assert max_difference(np.linalg.norm(trajectory.state.q[:, 3:], axis=1), np.ones(501)) < 1e-15
    assert (
        max_difference(
            trajectory.poses["body"].quaternion * np.sign(trajectory.state.q[:, 3:4]),
            trajectory.state.q[:, 3:] * np.sign(trajectory.poses["body"].quaternion[:, :1]),
        )
        < 1e-13
    )


def test_the_motion_conserves_the_length_of_quaternions():
    """d|q|^2/dt = 2 q . q' = 0 for any length."""
    model, rng = hung(), np.random.default_rng(3)

    @jax.jit
    def rate(q, v):
        dynamics = dynamics_of(model, ())
        return dynamics.rate(jnp.array(0.0), dynamics.pack(jb.State(q, v)))

    for length in (1.0, 1.1):
        turn = length * np.array([0.5, -0.1, 0.7, 0.5])
        turn_rate = rate(jnp.array([0.1, 0, -1, *turn]), jnp.array(rng.normal(size=6)))[3:7]
        assert abs(turn @ turn_rate) < 1e-15
        assert np.abs(turn_rate).max() > 0.1


def test_the_other_quaternion_of_the_same_attitude_moves_the_same(rig, start, shaken):
    other = jb.State(start.q.at[3:7].multiply(-1), start.v)
    result = jb.simulate(rig, TIMES, motion=SHAKEN, initial=other, rtol=1e-10)
    assert max_difference(result.state.q[:, 3:7], -shaken.state.q[:, 3:7]) == 0
    assert max_difference(result.poses["box"].p, shaken.poses["box"].p) == 0
    assert max_difference(result.state.v, shaken.state.v) == 0


# Time


@pytest.mark.long
@pytest.mark.parametrize(("shift", "limit"), [(1.0, 1e-11), (1e3, 1e-9), (1e6, 1e-6)])
def test_a_shift_of_time_changes_nothing(rig, start, shaken, shift, limit):
    """Except the rounding of time itself: eps times 1e6 s is 1e-10 s."""
    turns = -2 * np.pi * np.remainder(rigs.SHAKING["frequency"] * shift, 1)
    phases = {
        "translation_phase": rigs.SHAKING["translation_phase"] + turns[:3],
        "rotation_phase": rigs.SHAKING["rotation_phase"] + turns[3:],
    }
    motion = {"base": jb.Harmonic(**{**rigs.SHAKING, **phases})}
    result = jb.simulate(rig, TIMES + shift, motion=motion, initial=start, rtol=1e-10)
    print(
        "shift",
        shift,
        max_difference(result.state.q, shaken.state.q),
        max_difference(result.state.v, shaken.state.v),
    )
    assert max_difference(result.state.q, shaken.state.q) < limit
    assert max_difference(result.state.v, shaken.state.v) < 10 * limit


def test_a_sample_does_not_depend_on_the_other_samples(rig, start, shaken):
    """Sixty of the times among others, and up to a later end."""
    kept = np.arange(0, len(TIMES), 7)
    others = np.linspace(0.001, 3.0, len(TIMES) - len(kept))
    times = np.sort(np.concatenate([TIMES[kept], others]))
    result = jb.simulate(rig, times, motion=SHAKEN, initial=start, rtol=1e-10)
    rows = np.searchsorted(times, TIMES[kept])
    print("samples", max_difference(result.state.q[rows], shaken.state.q[kept]))
    assert max_difference(result.state.q[rows], shaken.state.q[kept]) < 1e-9
    assert max_difference(result.state.v[rows], shaken.state.v[kept]) < 1e-8


# Results by name


def test_results_by_name_agree_with_the_state(rig, shaken):
    state = shaken.state
    assert list(shaken.poses) == ["base", "box", "arm"]
    assert list(shaken.elongations) == list(shaken.forces) == [f"s{i}" for i in range(5)]
    assert max_difference(shaken.poses["box"].p, state.q[:, :3]) == 0
    assert max_difference(shaken.poses["box"].R, rigs.turned(state.q[:, 3:7])) < 1e-14
    a = rigs.SHAKING
    phases = np.concatenate([a["translation_phase"], a["rotation_phase"]])
    xi = np.concatenate([a["translation"], a["rotation"]]) * np.cos(
        2 * np.pi * a["frequency"] * TIMES[:, None] + phases
    )
    R = np.array([rigs.rodrigues(phi) for phi in xi[:, 3:]]) @ rigs.turned(rig["base"].orientation)
    assert max_difference(shaken.poses["base"].p, rigs.PARAMETERS["position"] + xi[:, :3]) < 1e-14
    assert max_difference(shaken.poses["base"].R, R) < 1e-14
    frames = shaken.poses
    ends = {
        f"s{i}": pair
        for i, pair in enumerate([("box", "base")] * 3 + [("box", "arm"), ("arm", "base")])
    }
    for name, (one, other) in ends.items():
        A, B = (
            np.asarray(frames[body].p) + np.asarray(frames[body].R) @ np.asarray(point)
            for body, point in ((one, rig[name].a), (other, rig[name].b))
        )
        length = np.linalg.norm(B - A, axis=1)
        assert max_difference(shaken.elongations[name], length - rig[name].free_length) < 1e-13
    i = 123
    one = jb.State(state.q[i], state.v[i])
    rate = jax.jvp(SHAKEN["base"], (jnp.array(TIMES[i]),), (jnp.ones(()),))[1]
    energies = {
        "kinetic": jb.kinetic_energy(rig, one, xi=xi[i][None], xi_dot=rate[None]),
        "potential": jb.potential_energy(rig, one, xi=xi[i][None]),
    }
    for kind, value in energies.items():
        assert abs(shaken.energies[kind][i] - value) < 1e-12 * abs(value)
    assert (
        max_difference(
            shaken.energies["total"], shaken.energies["kinetic"] + shaken.energies["potential"]
        )
        == 0
    )
    force, moment = shaken.reactions["base"]
    assert force.shape == moment.shape == (len(TIMES), 3)


SHORT = np.linspace(0, 1, 21)


def hung():
    body = jb.Body(mass=1.0, inertia=[0.1, 0.2, 0.25], com=[0.02, 0, 0], position=[0.1, 0, -1])
    return rigs.hung(
        body,
        stiffness=100.0,
        free_length=0.9,
        damping=0.3,
        gravity=[0, 0, -9.81],
        at=[0.01, 0.02, 0.05],
    )


def sampled(stiffness, model, **options):
    return jb.simulate(jb.replace(model, {"spring.stiffness": stiffness}), SHORT, **options)


@pytest.mark.long
def test_a_batch_has_the_same_names_and_the_numbers_of_a_loop():
    """In constant steps, as controlled ones depend on round-off."""
    model, stiffnesses = hung(), jnp.array([50.0, 100.0, 200.0])
    steps = {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 0.02, "max_steps": 64}
    batch = jax.vmap(lambda k: sampled(k, model, **steps))(stiffnesses)
    assert batch.ok.all()
    for i, k in enumerate(stiffnesses):
        single = sampled(k, model, **steps)
        for kind in ("poses", "elongations", "forces", "energies", "powers", "reactions"):
            result, expected = getattr(batch, kind), getattr(single, kind)
            assert list(result) == list(expected)
            for one, other in zip(jax.tree.leaves(result), jax.tree.leaves(expected), strict=True):
                assert max_difference(one[i], other) < 1e-12 * max(np.abs(other).max(), 1), kind
    assert "3 OK" in repr(batch)


@pytest.mark.long
def test_a_sample_of_a_batch_that_fails_does_not_disturb_its_neighbors():
    """Beside a neighbor that succeeds, in the same program, the others have the same digits. (Those
    of a run alone differ: controlled steps depend on the round-off of another program.)"""
    model = hung()
    limit = {"max_steps": 60, "rtol": 1e-7}
    run = jax.vmap(lambda k: sampled(k, model, **limit))
    batch, sound = run(jnp.array([50.0, 1e9, 200.0])), run(jnp.array([50.0, 100.0, 200.0]))
    assert batch.status.tolist() == [Status.OK, Status.MAX_STEPS, Status.OK]
    assert batch.report() == "2 OK, 1 MAX_STEPS"
    with pytest.raises(jb.JaxbodyError, match=r"failed samples \[1\]") as error:
        batch.raise_if_failed()
    assert error.value.code == "MAX_STEPS"
    assert sound.ok.all()
    for i in (0, 2):
        np.testing.assert_array_equal(batch.state.q[i], sound.state.q[i])
        np.testing.assert_array_equal(batch.state.v[i], sound.state.v[i])
    assert np.isnan(batch.state.q[1, -1]).all()
    assert np.isfinite(batch.state.q[1, 0]).all()


STONE = jb.Model(
    bodies={"stone": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    joints={"stone": jb.Guide("world", axis="z")},
    gravity=[0, 0, -9.81],
)


def fallen(speed, g=9.81, samples=5001, **options):
    """Times, and heights of a stone thrown upwards: long steps, each of which reaches over
    many samples."""
    times = jnp.linspace(0.0, 5.0, samples)
    thrown = jb.State(STONE.reference.q, jnp.array([1.0]) * speed)
    model = jb.replace(STONE, {"gravity": jnp.array([0.0, 0.0, -1.0]) * g})
    return times, jb.simulate(model, times, initial=thrown, **options).state.q[:, 0]


@pytest.mark.long
# around numbers of samples that are computed together, and far above
@pytest.mark.parametrize("samples", [1025, 2049, 5001, 12289])
def test_a_step_may_reach_over_thousands_of_samples(samples):
    """A parabola, which every step reproduces to round-off; the last step covers nearly all of
    the time."""
    times, z = fallen(3.0, samples=samples)
    np.testing.assert_allclose(z, 3 * times - 9.81 / 2 * times**2, rtol=0, atol=1e-11)


@pytest.mark.long
def test_derivatives_and_batches_of_steps_that_reach_over_thousands_of_samples():
    """Of the mean square height by speed and gravity, in both modes and by members of a batch, one
    of which hardly moves."""

    def mean_square(thrown):
        return jnp.mean(fallen(*thrown)[1] ** 2)

    def exact(thrown):
        t = jnp.linspace(0.0, 5.0, 5001)
        return jnp.mean((thrown[0] * t - thrown[1] / 2 * t**2) ** 2)

    thrown = jnp.array([[3.0, 9.81], [1e-9, 0.0], [-20.0, 1.6]])
    np.testing.assert_allclose(
        jax.vmap(mean_square)(thrown), jax.vmap(exact)(thrown), rtol=1e-12, atol=1e-20
    )
    slope = jax.grad(exact)(thrown[0])
    np.testing.assert_allclose(jax.grad(mean_square)(thrown[0]), slope, rtol=1e-11)
    np.testing.assert_allclose(jax.jacfwd(mean_square)(thrown[0]), slope, rtol=1e-11)


@pytest.mark.nan
def test_samples_before_an_early_end_are_kept_though_a_step_reached_over_them():
    """Three steps, of which the last covers some thousand samples of a fall."""
    times = jnp.linspace(0.0, 1.0, 14001)
    with pytest.warns(jb.JaxbodyWarning, match="MAX_STEPS"):
        cut = jb.simulate(STONE, times, max_steps=3)
    z = np.asarray(cut.state.q[:, 0])
    reached = int(np.isfinite(z).sum())
    np.testing.assert_allclose(z[:reached], -9.81 / 2 * times[:reached] ** 2, rtol=0, atol=1e-12)
    assert 2048 < reached < 14001 and np.isnan(z[reached:]).all()


# Messages of failed integrations


def simulated(model, times, *codes, **options):
    """The trajectory, whose status is the last of these codes, and its warnings, one for
    each code."""
    with pytest.warns(jb.JaxbodyWarning) as caught:
        trajectory = jb.simulate(model, times, **options)
    assert [w.message.code for w in caught] == list(codes)
    assert int(trajectory.status) == Status[codes[-1]]
    assert not trajectory.ok
    with pytest.raises(jb.JaxbodyError) as error:
        trajectory.raise_if_failed()
    assert error.value.code == codes[-1]
    return trajectory, "\n".join(str(w.message) for w in caught)


@pytest.mark.long
def test_a_motion_of_too_many_steps_keeps_its_samples_and_reports_the_time_reached():
    whole = sampled(100.0, hung(), rtol=1e-10)
    cut, message = simulated(hung(), SHORT, "MAX_STEPS", max_steps=8, rtol=1e-10)
    end = float(
        re.search(r"at t = ([\d.]+) s of 1 s, \d+ steps accepted, \d+ rejected", message)[1]
    )
    assert "larger max_steps" in message
    assert 0 < end < 1
    before = end >= SHORT
    assert max_difference(cut.state.q[before], whole.state.q[before]) < 1e-12
    assert np.isnan(cut.state.q[~before]).all()
    assert np.isnan(cut.state.v[~before]).all()
    for numbers in (cut.elongations["spring"], cut.energies["total"], cut.poses["body"].p[:, 0]):
        assert (np.isnan(numbers) == ~before).all()


@pytest.mark.long
def test_steps_below_the_smallest_are_reported():
    """The smallest step is too large for the tolerance from the first step on; the initial state
    is returned."""
    controller = diffrax.PIDController(rtol=1e-12, atol=1e-12, dtmin=0.2, force_dtmin=False)
    result, message = simulated(hung(), SHORT, "DT_MIN", stepsize_controller=controller)
    assert "at t = 0 s of 1 s" in message
    assert "Kvaerno5" in message
    assert max_difference(result.state.q[0], hung().reference.q) < 1e-15
    assert np.isnan(result.state.q[1:]).all()


def slider(stiffness=400.0):
    return jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("base", axis=[1, 0, 0])},
        elements={
            "s": jb.Spring(
                ("mass", [0, 0, 0]), ("base", [-1, 0, 0]), stiffness=stiffness, free_length=1.0
            )
        },
    )


PUSHED = jb.State(jnp.array([0.1]), jnp.zeros(1))


@pytest.mark.long
def test_a_nonfinite_motion_is_named():
    def stops(t):
        return jnp.where(t < 0.52, jnp.sin(t), jnp.nan) * jnp.array([1.0, 0, 0, 0, 0, 0])

    result, message = simulated(slider(), SHORT, "NONFINITE", motion={"base": stops})
    assert "the motion of 'base' at t = 0.52" in message
    assert np.isfinite(result.state.q[SHORT < 0.5]).all()
    assert np.isnan(result.state.q[SHORT > 0.52]).all()


@pytest.mark.long
def test_constant_steps_too_long_for_the_model_end_in_a_status_at_the_right_time():
    """20 000 rad/s in steps of 50 ms: a thousand times the limit of stability."""
    options = dict(
        stepsize_controller=diffrax.ConstantStepSize(),
        dt0=0.05,
        solver=diffrax.Tsit5(),
        initial=PUSHED,
    )
    times = np.linspace(0, 10, 21)
    result, message = simulated(slider(4e8), times, "STEP_TOO_LONG", "NONFINITE", **options)
    assert re.search(r"2e\+04 rad/s, is 1e\+03 > 2\.8.* below 0\.00014 s", message)
    good = np.isfinite(np.asarray(result.state.q[:, 0]))
    assert 1 <= good.sum() < 10
    assert "element 's'" in message or "'mass'" in message
    end = float(re.search(r"at t = ([\d.]+) s of 10 s", message)[1])
    assert times[good][-1] <= end <= times[~good][0]


@pytest.mark.long
def test_short_constant_steps_have_the_accuracy_of_their_order():
    exact = 0.1 * np.cos(20 * SHORT)
    options = dict(
        stepsize_controller=diffrax.ConstantStepSize(), solver=diffrax.Tsit5(), initial=PUSHED
    )
    errors = [
        max_difference(jb.simulate(slider(), SHORT, dt0=dt, **options).state.q[:, 0], exact)
        for dt in (np.array(0.005), np.array(0.0025))
    ]
    assert errors[1] < 1e-6
    assert 4.5 < np.log2(errors[0] / errors[1]) < 6


@pytest.mark.long
def test_reverse_mode_by_checkpoints_is_refused_with_constant_steps():
    with pytest.raises(jb.JaxbodyError, match="DirectAdjoint") as error:
        jb.simulate(
            slider(),
            SHORT,
            stepsize_controller=diffrax.ConstantStepSize(),
            dt0=0.01,
            adjoint=diffrax.RecursiveCheckpointAdjoint(),
        )
    assert error.value.code == "WRONG_GRADIENT"
    by_checkpoints = dict(solver=diffrax.Tsit5(), adjoint=diffrax.RecursiveCheckpointAdjoint())
    with pytest.raises(jb.JaxbodyError, match="ForwardMode") as error:
        jax.jacfwd(lambda k: jb.simulate(slider(k), SHORT, **by_checkpoints).state.q)(400.0)
    assert error.value.code == "NO_FORWARD_MODE"
    with pytest.raises(jb.JaxbodyError, match="dt0") as error:
        jb.simulate(slider(), SHORT, stepsize_controller=diffrax.ConstantStepSize())
    assert error.value.code == "NO_STEP"
    with pytest.raises(jb.JaxbodyError, match="ConstantStepSize") as error:
        jb.simulate(slider(), SHORT, solver=jb.Gauss())
    assert error.value.code == "NO_ERROR_ESTIMATE"


@pytest.mark.parametrize(
    ("times", "code", "text"),
    [
        ([0, 0.2, 0.1, 0.3], "UNSORTED_TIME", "index 2"),
        ([0, 0.1, 0.1, 0.3], "DUPLICATE_TIME", "index 2"),
        ([0, 0.1, np.nan, 0.3], "NAN_TIME", "index 2"),
        ([0, 0.1, np.inf], "NAN_TIME", "index 2"),
        ([0.0], "NO_DATA", "times"),
        ([[0, 1], [2, 3]], "BAD_SHAPE", "(2, 2)"),
    ],
)
def test_bad_times_are_refused(times, code, text):
    with pytest.raises(jb.JaxbodyError) as error:
        jb.simulate(slider(), times)
    assert error.value.code == code
    assert text in str(error.value)


def test_times_outside_a_sampled_motion_are_refused():
    known = np.linspace(0, 4.999, 50)
    motion = {
        "base": jb.Sampled(known, translation=np.sin(known)[:, None] * [1, 0, 0])
        + jb.Harmonic(frequency=1.0)
    }
    with pytest.raises(
        jb.JaxbodyError, match=r"'base'.*covers 0 to 4\.999 s, requested 0 to 5 s"
    ) as error:
        jb.simulate(slider(), np.linspace(0, 5, 11), motion=motion)
    assert error.value.code == "T_RANGE"
    with pytest.raises(jb.JaxbodyError, match="Did you mean 'base'") as error:
        jb.simulate(slider(), SHORT, motion={"bose": jb.inputs.AtRest()})
    assert error.value.code == "UNKNOWN_NAME"


@pytest.mark.parametrize(
    ("state", "code", "text"),
    [
        (
            lambda m: jb.State(jnp.zeros((6, 3)), jnp.zeros(7)),
            "BAD_SHAPE",
            "Expected (8,): box 7, arm 1",
        ),
        (
            lambda m: jb.State(m.reference.q, jnp.zeros(8)),
            "BAD_SHAPE",
            "Expected (7,): box 6, arm 1",
        ),
        (
            lambda m: jb.State(m.reference.q.at[1].set(jnp.nan), jnp.zeros(7)),
            "NON_FINITE",
            "index 1",
        ),
        (
            lambda m: jb.State(m.reference.q.at[3:7].multiply(1.1), jnp.zeros(7)),
            "BAD_QUATERNION",
            "'box'",
        ),
        (lambda m: m.reference.q, "WRONG_KIND", "model.reference"),
    ],
)
@pytest.mark.nan
def test_initial_states_that_do_not_fit_are_refused(rig, state, code, text):
    with pytest.raises(jb.JaxbodyError) as error:
        jb.simulate(rig, SHORT, initial=state(rig))
    assert error.value.code == code
    assert text in str(error.value)


@pytest.mark.long
def test_an_unattached_body_moves_with_a_warning():
    model = jb.Model(bodies={"stone": jb.Body(mass=1.0, inertia=[1, 1, 1])}, gravity=[0, 0, -9.81])
    start = jb.State(model.reference.q, jnp.array([1.0, 0, 2, 0, 0, 0]))
    with pytest.warns(jb.JaxbodyWarning, match="nothing connects stone") as caught:
        result = jb.simulate(model, SHORT, initial=start, rtol=1e-10)
    assert [w.message.code for w in caught] == ["UNATTACHED"]
    assert (
        max_difference(
            result.state.q[:, :3], np.stack([SHORT, 0 * SHORT, 2 * SHORT - 9.81 / 2 * SHORT**2], -1)
        )
        < 1e-12
    )


FLOAT32 = """
import inspect
import warnings
import jax
import jaxbody as jb
def model():
    return jb.Model(bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])}, joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
                    elements={"s": jb.Spring(("mass", [0, 0, 0]), ("world", [-1, 0, 0]), stiffness=400.0, free_length=1.0)})
def refused(function, *args, **options):
    try:
        function(*args, **options)
    except jb.JaxbodyError as error:
        return error.code
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    slider = model()
    print("built", len(caught))
    lin = jb.linearize(slider, slider.reference)
    lin = jb.linearize(slider, slider.reference)
    print("used", [w.message.code for w in caught], lin.K.dtype)
print("modes", refused(jb.modes, lin))
print("allowed", abs(jb.modes(lin, allow_float32=True).frequency[0] / 3.1830989 - 1) < 1e-6)
for function, of in (jb.modes, (lin,)), (jb.tune, (slider, lambda m: m["s"].stiffness)):
    try:
        function(*of, **({} if function is jb.modes else {"free": "s.stiffness"}))
    except jb.JaxbodyError as error:
        hint = error.problems[0].hint
        print("advised", "jax_enable_x64" in hint, ("allow_float32" in hint) == ("allow_float32" in inspect.signature(function).parameters))
jax.config.update("jax_enable_x64", True)
print("switched", refused(jb.linearize, slider, slider.reference), refused(jb.simulate, slider, [0.0, 1.0]))
"""  # noqa: E501


@pytest.mark.long
def test_float32_warns_once_is_refused_for_modes_and_never_mixed():
    environment = {**os.environ, "JAX_ENABLE_X64": "0"}
    run = subprocess.run(
        [sys.executable, "-c", FLOAT32],
        capture_output=True,
        text=True,
        env=environment,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines() == [
        "built 0",
        "used ['FLOAT32'] float32",
        "modes FLOAT32",
        "allowed True",
        "advised True True",
        "advised True True",
        "switched X64_CHANGED X64_CHANGED",
    ]


@pytest.mark.long
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 0.01},
        {"adjoint": diffrax.ForwardMode()},
    ],
    ids=["adaptive", "constant", "forward"],
)
def test_the_program_of_a_simulation_calls_no_host(rig, options):
    """JAX keeps no program in its persistent cache that does, and exports none. diffrax's own loop
    with the same samples does."""
    times = jnp.linspace(0.0, 0.1, 5)

    def lowered(**options):
        return (
            jax.jit(
                lambda k: (
                    jb.simulate(
                        jb.replace(rig, {"s1.stiffness": k}), times, motion=SHAKEN, **options
                    ).state.q
                )
            )
            .lower(40.0)
            .as_text()
        )

    assert "callback" not in lowered(**options)
    assert options or "callback" in lowered(solver=diffrax.Tsit5())


@pytest.mark.long
def test_a_solver_in_blocks_is_that_solver(rig):
    """Another method with the same tolerances: near the default's path, and differentiable in
    forward mode."""
    times = jnp.linspace(0.0, 0.1, 5)
    paths = [
        jb.simulate(rig, times, motion=SHAKEN, **options)
        for options in ({}, {"solver": diffrax.Tsit5(), "adjoint": jb.BlockAdjoint()})
    ]
    np.testing.assert_allclose(paths[1].state.q, paths[0].state.q, rtol=0, atol=1e-8)
    assert int(paths[1].statistics["num_accepted_steps"]) > int(
        paths[0].statistics["num_accepted_steps"]
    )


@pytest.mark.long
def test_newtons_method_takes_the_steps_of_a_stiff_part_that_turns():
    """As the guide says where diffrax's frozen Jacobian refuses every other step: an arm on a rod
    of 8e5 N/m and 4e4 N s/m, against the explicit default."""
    top, a = np.array([0.25, 0, -0.25 * 3**0.5]), np.pi / 6  # where the rod meets the arm
    model = jb.Model(
        bodies={
            "arm": jb.Body(
                6.0, [0.5, 0.5, 0.01], com=[0, 0, -0.9], orientation=jb.EulerAngles("Y", [-a])
            ),
            "collar": jb.Body(3.0, position=[0, 0, 2 * top[2]]),
        },
        joints={"arm": jb.Hinge("world", axis="y"), "collar": jb.Guide("world", axis="z")},
        elements={
            "rod": jb.Spring(
                ("arm", [0, 0, -0.5]),
                ("collar", [0, 0, 0]),
                stiffness=8e5,
                damping=4e4,
                free_length=0.5,
            ),
            "spring": jb.Spring(
                ("collar", [0, 0, 0]),
                ("world", [0, 0, -3.0]),
                stiffness=1e3,
                damping=10.0,
                free_length=2.0,
            ),
        },
        gravity=[0, 0, -9.81],
    )
    times = np.linspace(0, 1, 11)
    solver = diffrax.Kvaerno5(root_finder=optimistix.Newton(rtol=1e-8, atol=1e-10))
    stiff, explicit = jb.simulate(model, times, solver=solver), jb.simulate(model, times)
    accepted, rejected = (
        int(stiff.statistics[f"num_{kind}_steps"]) for kind in ("accepted", "rejected")
    )
    assert stiff.ok and accepted < 1000 and rejected < 0.1 * accepted
    assert max_difference(stiff.state.q, explicit.state.q) < 1e-8


def test_reverse_mode_over_another_derivative_is_refused_as_the_manual_says():
    """guide/jax.md quotes JAX; `jax.hessian`, which is forward over reverse, works."""
    car = jb.presets.quarter_car(damping=1500.0)

    def heave(x):
        return jb.simulate(
            jb.replace(car, {"suspension.stiffness": 35e3 * x}), [0.0, 0.01], max_steps=4
        ).state.q[-1, 0]

    for derivative in (jax.grad(jax.grad(heave)), jax.grad(jax.jacfwd(heave))):
        with pytest.raises(
            ValueError, match="failed to produce known values for all output primals"
        ):
            jb.jit(derivative)(1.0)
