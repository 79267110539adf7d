"""The package's integration steps against diffrax's steps of the same method, gradients in every
mode, batches against loops."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import jaxbody as jb
from jaxbody.mechanics.closed_loops import dynamics_of
from jaxbody.motion.simulations import motions_of
from jaxbody.numerics import step_blocks

pytestmark = pytest.mark.everywhere

TIMES = jnp.linspace(0.0, 0.8, 33)
MOTION = {"base": jb.Harmonic(frequency=0.8, translation=[0.01, 0, 0], rotation=[0, 0, 0.02])}


@pytest.fixture(scope="module")
def model():
    """A free body on three springs: little to compile."""
    ends = {"a": [0.3, 0.1, 0], "b": [-0.3, 0.1, 0], "c": [0, -0.1, 0.2]}
    springs = {
        n: jb.Spring(
            ("body", x),
            ("base", [2 * x[0], 0.6, 2 * x[2]]),
            stiffness=40.0,
            free_length=0.4,
            damping=0.5,
        )
        for n, x in ends.items()
    }
    return jb.Model(
        bodies={"body": jb.Body(mass=1.0, inertia=[0.03, 0.09, 0.1])},
        supports={"base": jb.Support()},
        elements=springs,
    )


def path(model, factor=1.0, times=TIMES, **options):
    stiffer = jb.replace(model, {"*.stiffness": factor * 40.0})
    return jb.simulate(stiffer, times, motion=MOTION, **options).state.q


@pytest.mark.long
def test_one_step_is_that_of_diffrax(model):
    """Tolerances so wide that the first step is the only one: its end and the polynomial between
    are the same, to rounding."""
    times = jnp.linspace(0.0, 0.05, 7)
    ours = path(model, times=times, rtol=1e6, dt0=0.05)
    theirs = path(
        model,
        times=times,
        stepsize_controller=diffrax.ConstantStepSize(),
        solver=diffrax.Dopri8(),
        dt0=0.05,
    )
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-13)


STEPS = {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 0.03}


@pytest.mark.long
def test_constant_steps_are_those_of_the_tableau(model):
    """Two steps and a shorter one, samples on them, and the derivative in reverse mode, against the
    method step by step."""
    tableau, ends = diffrax.Dopri8.tableau, jnp.array([0.0, 0.03, 0.06, 0.075])
    rate = jax.jit(lambda factor, t, y: dynamics(factor).rate(t, y))

    def dynamics(factor):
        stiffer = jb.replace(model, {"*.stiffness": factor * 40.0})
        return dynamics_of(stiffer, motions_of(stiffer, MOTION))

    def by_hand(factor):
        y = dynamics(factor).pack(model.reference)
        for t, h in zip(ends[:-1], jnp.diff(ends), strict=True):
            k = [rate(factor, t, y)]
            for c, a in zip(tableau.c, tableau.a_lower, strict=True):
                k.append(
                    rate(
                        factor,
                        t + c * h,
                        y + h * sum(float(x) * f for x, f in zip(a, k, strict=True)),
                    )
                )
            y = y + h * sum(float(b) * f for b, f in zip(tableau.b_sol, k, strict=True))
        return dynamics(factor).unpack(y).q

    q, q_slope = jax.jvp(by_hand, (1.1,), (1.0,))
    ours, pull = jax.vjp(jax.jit(lambda f: path(model, f, times=ends, **STEPS)), 1.1)
    np.testing.assert_allclose(ours[-1], q, rtol=0, atol=1e-14)
    for i in range(3):
        (slope,) = pull(jnp.zeros_like(ours).at[-1, i].set(1.0))
        assert float(slope) == pytest.approx(float(q_slope[i]), rel=1e-10)


@pytest.mark.long
@pytest.mark.usefixtures("batches")
def test_a_batch_of_constant_steps_is_a_loop(model):
    """More than a chunk, and with fewer steps than it takes."""
    factors = jnp.linspace(0.5, 2.0, step_blocks.LANES + 1)
    alone = jax.jit(lambda f: path(model, f, **STEPS))
    batch = jax.jit(jax.vmap(alone))(factors)
    for i in (0, 7, -1):
        np.testing.assert_allclose(batch[i], alone(factors[i]), rtol=0, atol=1e-12)
    with pytest.warns(jb.JaxbodyWarning, match="MAX_STEPS"):
        short = jb.simulate(model, TIMES, motion=MOTION, **STEPS, max_steps=10)
    assert (
        int(short.statistics["num_accepted_steps"]) == 10
        and np.isfinite(short.state.q).all(1).sum() == 13
    )


@pytest.mark.long
def test_a_batch_of_step_lengths_is_a_loop(model):
    """Constant steps with a different length for each member."""
    alone = jax.jit(lambda dt0: path(model, 1.2, **STEPS | {"dt0": dt0}))
    lengths = jnp.array([0.03, 0.05, 0.02])
    for q, dt0 in zip(jax.jit(jax.vmap(alone))(lengths), lengths, strict=True):
        np.testing.assert_allclose(q, alone(dt0), rtol=0, atol=1e-12)


@pytest.mark.long
def test_both_control_the_error(model):
    """At rtol 1e-10 they agree to it, with about as many steps."""
    runs = [
        jb.simulate(model, TIMES, motion=MOTION, rtol=1e-10, solver=solver)
        for solver in (None, diffrax.Dopri8())
    ]
    np.testing.assert_allclose(runs[0].state.q, runs[1].state.q, rtol=0, atol=1e-10)
    taken, theirs = (int(run.statistics["num_accepted_steps"]) for run in runs)
    assert abs(taken - theirs) <= 0.2 * theirs


def loss(model, factor, **options):
    return jnp.sum(path(model, factor, rtol=1e-10, **options)[:, :3] ** 2)


@pytest.mark.parametrize(
    "small",
    [
        pytest.param(False, marks=pytest.mark.long, id="one block"),
        pytest.param(True, marks=pytest.mark.long, id="small blocks"),
    ],
)
def test_reverse_is_forward(model, small, monkeypatch):
    """Both differentiate the same steps, but for the rounding that the control of steps feels; also
    where the last window is not full and blocks of 4 steps end within windows of 8 samples."""
    times = TIMES[:30] if small else TIMES
    whole = loss(model, 1.0, times=times)
    if small:
        monkeypatch.setattr(step_blocks, "BLOCK", 4)
        monkeypatch.setattr(step_blocks, "WINDOW", 8)
        jax.clear_caches()
    reverse = jax.jit(jax.grad(lambda f: loss(model, f, times=times)))(1.0)
    value, forward = jax.jit(
        lambda f: jax.jvp(
            lambda f: loss(model, f, times=times, adjoint=diffrax.ForwardMode()), (f,), (1.0,)
        )
    )(1.0)
    assert float(value) == pytest.approx(float(whole), rel=1e-11)
    assert float(reverse) == pytest.approx(float(forward), rel=1e-9)
    if small:
        jax.clear_caches()


@pytest.mark.long
def test_gradients_are_those_of_diffrax(model):
    """Whose steps are others: to the tolerance."""
    forward = jax.jit(jax.jacfwd(lambda f: loss(model, f, adjoint=diffrax.ForwardMode())))(1.0)
    theirs = jax.jit(
        jax.jacfwd(lambda f: loss(model, f, adjoint=diffrax.ForwardMode(), solver=diffrax.Dopri8()))
    )(1.0)
    assert float(forward) == pytest.approx(float(theirs), rel=1e-9)


@pytest.mark.long
def test_gradients_to_initial_states_and_times(model):
    """The state at the end by the initial speeds, and by the time that is asked for: its rate."""
    start = model.reference

    def end(speed, t):
        times = jnp.stack([jnp.zeros(()), 0.3 + t, jnp.asarray(0.8)])
        moved = jb.State(start.q, start.v.at[0].set(speed))
        return jb.simulate(model, times, motion=MOTION, initial=moved, rtol=1e-10).state.q[1, 0]

    by_speed, by_time = jax.jit(jax.grad(end, argnums=(0, 1)))(0.1, 0.0)
    h = 1e-4
    value = jax.jit(end)
    assert float(by_speed) == pytest.approx(
        float(value(0.1 + h, 0.0) - value(0.1 - h, 0.0)) / (2 * h), rel=1e-6
    )
    assert float(by_time) == pytest.approx(
        float(value(0.1, h) - value(0.1, -h)) / (2 * h), rel=1e-6
    )


@pytest.mark.long
@pytest.mark.usefixtures("batches")
def test_a_batch_is_a_loop_and_members_do_not_disturb_one_another(model):
    """Forty members, more than a chunk of lanes, with steps of their own; one of them is NaN from
    the start and only it ends so."""
    factors = jnp.linspace(0.5, 2.0, 40).at[7].set(jnp.nan)
    batch = jax.jit(jax.vmap(lambda f: path(model, f)))(factors)
    alone = jax.jit(lambda f: path(model, f))
    for i in (0, 6, 8, 39):
        np.testing.assert_allclose(batch[i], alone(factors[i]), rtol=0, atol=1e-11)
    assert np.isnan(batch[7, 1:]).all() and np.isfinite(np.delete(batch, 7, 0)).all()


@pytest.mark.usefixtures("batches")
@pytest.mark.long
def test_gradients_of_a_batch(model):
    slopes = jax.jit(jax.vmap(jax.grad(lambda f: jnp.sum(path(model, f)[:, 0] ** 2))))(
        jnp.array([0.9, 1.1])
    )
    alone = jax.jit(jax.grad(lambda f: jnp.sum(path(model, f)[:, 0] ** 2)))
    np.testing.assert_allclose(slopes, [alone(0.9), alone(1.1)], rtol=1e-9)


@pytest.mark.long
def test_more_samples_than_a_window_and_more_steps_than_a_block(model):
    """2500 samples, over 128 steps: each sample as if it alone were asked for."""
    times = jnp.linspace(0.0, 60.0, 2500)
    run = jb.simulate(model, times, motion=MOTION)
    assert int(run.statistics["num_accepted_steps"]) > 256
    some = jnp.array([0, 700, 1500, 2499])
    np.testing.assert_allclose(
        run.state.q[some], jb.simulate(model, times[some], motion=MOTION).state.q, rtol=0, atol=1e-9
    )


@pytest.mark.long
def test_too_few_steps_keep_what_there_is(model):
    with pytest.warns(jb.JaxbodyWarning, match="MAX_STEPS"):
        run = jb.simulate(model, TIMES, motion=MOTION, max_steps=3)
    good = np.isfinite(np.asarray(run.state.q)).all(1)
    assert 0 < good.sum() < len(TIMES) and good[: good.sum()].all()
    np.testing.assert_allclose(
        run.state.q[good], jb.simulate(model, TIMES, motion=MOTION).state.q[good], rtol=0, atol=1e-9
    )


@pytest.mark.long
def test_steps_end_where_measured_accelerations_and_forces_have_their_samples(rng):
    """White noise, held by straight lines, against the exact solution of each piece: x'' + c x' + k
    x = F - a, by exponentials of matrices."""
    k, c, times = 400.0, 3.0, np.linspace(0, 2, 101)
    ground, force = rng.normal(size=len(times)), rng.normal(size=57)
    knots = np.sort(rng.uniform(0, 2, 55))
    knots = np.concatenate([[0.0], knots, [2.0]])
    model = jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
        supports={"ground": jb.Support()},
        joints={"mass": jb.Guide("ground", axis=[1, 0, 0])},
        elements={
            "spring": jb.Spring(
                ("mass", [0, 0, 0]), ("ground", [0, 0, 0]), stiffness=k, damping=c, free_length=1.0
            )
        },
    )
    along = np.array([1.0, 0, 0])
    push = jb.Force("mass", force=jb.signals.Samples(knots, force[:, None] * along, kind="linear"))
    shaken = jb.Sampled.from_accelerations(times, translation=ground[:, None] * along)
    result = jb.simulate(model, times, motion={"ground": shaken}, loads={"push": push})
    every = np.union1d(times, knots)
    u = np.interp(every, knots, force) - np.interp(every, times, ground)
    z, exact = np.zeros(2), {0.0: 0.0}
    for i, h in enumerate(np.diff(every)):
        A = np.zeros((4, 4))
        A[0, 1], A[1], A[2, 3] = 1.0, [-k, -c, 1.0, 0.0], 1.0
        z = (scipy.linalg.expm(A * h) @ [*z, u[i], (u[i + 1] - u[i]) / h])[:2]
        exact[every[i + 1]] = z[0]
    exact = np.array([exact[t] for t in times])
    np.testing.assert_allclose(result.state.q[:, 0], exact, atol=1e-10 * np.abs(exact).max())
    assert (
        int(result.statistics["num_accepted_steps"]) <= len(every) + 10
        and int(result.statistics["num_rejected_steps"]) < 10
    )


class Interpolated(jb.laws.Law):
    """A law of the user's own by an operation of JAX that newer versions replace before
    they compile."""

    forces: jax.Array

    def force(self, x):
        return jnp.interp(x, jnp.linspace(-1.0, 1.0, 5), self.forces)


def oscillation(law, times, **options):
    """A mass of 1 kg released 0.3 m from the relaxed position of its spring."""
    model = jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
        elements={
            "spring": jb.SpringDamper(
                ("mass", [0, 0, 0]), ("world", [-2.0, 0, 0]), spring=law, free_length=2.0
            )
        },
    )
    return jb.simulate(
        model, times, initial=jb.State(jnp.array([0.3]), jnp.zeros(1)), rtol=1e-10, **options
    ).state.q[:, 0]


@pytest.mark.long
@pytest.mark.usefixtures("batches")
def test_simulate_works_on_every_jax_also_with_laws_that_interpolate():
    """A mass on a spring by a table that is a straight line, k = 40 N/m: x = cos wt, alone and in a
    batch, and dx/dk = -t sin(wt)/(2 w)."""
    times, ks = jnp.linspace(0.0, 1.0, 4), jnp.array([40.0, 30.0])

    def path(k):
        return oscillation(Interpolated(k * jnp.linspace(-1.0, 1.0, 5)), times)

    q, slopes = jax.jit(jax.vmap(lambda k: (path(k), jax.grad(lambda k: path(k)[-1])(k))))(ks)
    w = np.sqrt(np.asarray(ks))
    np.testing.assert_allclose(q, 0.3 * np.cos(w[:, None] * times), rtol=0, atol=1e-9)
    np.testing.assert_allclose(slopes, -0.15 * np.sin(w) / w, rtol=1e-7)
    np.testing.assert_allclose(path(40.0), q[0], rtol=0, atol=1e-11)


jit_once = jb.jit  # compiling is the cost


def end(k):
    """x = 0.3 cos wt after t = 1 s, w = sqrt k."""
    return oscillation(jb.laws.Linear(k), jnp.array([0.0, 0.4, 1.0]))[-1]


@pytest.mark.long
def test_both_modes_by_default():
    """dx/dk = -0.15 t sin(wt)/w."""
    w = np.sqrt(40.0)
    reverse, forward = jit_once(lambda k: (jax.grad(end)(k), jax.jacfwd(end)(k)))(40.0)
    assert float(forward) == pytest.approx(-0.15 * np.sin(w) / w, rel=1e-7)
    assert float(reverse) == pytest.approx(float(forward), rel=1e-10)


@pytest.mark.long
def test_both_modes_in_batches_and_second_derivatives():
    """d2x/dk2 = -0.075 t (t cos(wt)/w2 - sin(wt)/w3)."""
    ks = jnp.array([40.0, 30.0])
    w = np.sqrt(np.asarray(ks))
    reverse, forward, second = jit_once(
        jax.vmap(lambda k: (jax.grad(end)(k), jax.jacfwd(end)(k), jax.hessian(end)(k)))
    )(ks)
    over_batch = jit_once(jax.grad(lambda ks: jnp.sum(jax.vmap(end)(ks))))(ks)
    np.testing.assert_allclose(forward, -0.15 * np.sin(w) / w, rtol=1e-7)
    np.testing.assert_allclose(reverse, forward, rtol=1e-10)
    np.testing.assert_allclose(over_batch, forward, rtol=1e-10)
    np.testing.assert_allclose(second, -0.075 * (np.cos(w) / w**2 - np.sin(w) / w**3), rtol=1e-6)
    value, slope = jax.jvp(end, (40.0,), (2.0,))
    np.testing.assert_allclose([value, slope], [0.3 * np.cos(w[0]), 2 * forward[0]], rtol=1e-8)


@pytest.mark.long
def test_forward_mode_through_another_solver_says_which_argument_allows_it():
    with pytest.raises(jb.JaxbodyError, match=r"adjoint=diffrax.ForwardMode\(\)"):
        jax.jacfwd(
            lambda k: oscillation(jb.laws.Linear(k), jnp.array([0.0, 0.1]), solver=diffrax.Tsit5())
        )(40.0)


# Memory, as compiled programs state it


def bytes_of(function, *shapes):
    """Of temporary arrays and of results."""
    memory = (
        jax.jit(function)
        .lower(*(jax.ShapeDtypeStruct(shape, float) for shape in shapes))
        .compile()
        .memory_analysis()
    )
    return memory.temp_size_in_bytes, memory.output_size_in_bytes


def decaying(y0, most=1000):
    """Samples of y' = -y, many numbers side by side."""
    options = {
        "saveat": diffrax.SaveAt(t1=True),
        "stepsize_controller": diffrax.PIDController(rtol=1e-9, atol=1e-12),
        "throw": False,
    }
    term, blocks = (
        diffrax.ODETerm(lambda t, y, args: -y),
        jb.BlockAdjoint(jnp.linspace(0.0, 1.0, 5)),
    )
    return diffrax.diffeqsolve(
        term, diffrax.Dopri8(), 0.0, 1.0, None, y0, adjoint=blocks, max_steps=most, **options
    ).ys[:-1]


@pytest.mark.long
def test_reverse_mode_keeps_a_state_for_128_steps():
    """What each 128 more steps cost: their lengths, and about one state with its rate, not
    128 states."""
    ny, blocks = 50, 40

    def slope(most):
        return bytes_of(jax.grad(lambda y: jnp.sum(decaying(y, most) ** 2)), (ny,))[0]

    more = (slope(128 * 3 * blocks) - slope(128 * 2 * blocks)) / blocks
    print(more, "bytes for 128 steps; 128 states are", 128 * 8 * ny)
    assert 8 * 128 <= more < 8 * 128 + 4 * 8 * ny


@pytest.mark.long
def test_the_memory_of_a_batch_is_that_of_its_results_and_of_one_chunk():
    """Per member no more than three times its samples: a chunk's members need a hundred
    times that."""
    ny, few, many = 3, 2 * step_blocks.LANES, 20 * step_blocks.LANES
    (one, _), (two, _) = (bytes_of(jax.vmap(decaying), (n, ny)) for n in (few, many))
    samples = 8 * 5 * ny
    print(
        (two - one) / (many - few),
        "bytes a member;",
        samples,
        "of samples;",
        one / step_blocks.LANES,
        "in a chunk",
    )
    assert two - one < 3 * samples * (many - few) and one / step_blocks.LANES > 20 * samples
