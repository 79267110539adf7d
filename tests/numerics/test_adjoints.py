"""BlockAdjoint on systems that are not of jaxbody, against diffrax's own loop
with the same steps and in every mode."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

import jaxbody as jb
from jaxbody.numerics import step_blocks
from jaxbody.numerics.adjoints import Driven, Unstarted

pytestmark = pytest.mark.everywhere
CONSTANT = {"stepsize_controller": diffrax.ConstantStepSize()}


def lotka_volterra(t, y, args):
    """Prey and predators."""
    a, b, c, d = args
    return jnp.stack([a * y[0] - b * y[0] * y[1], c * y[0] * y[1] - d * y[1]])


def lorenz(t, y, args):
    """Convection; chaotic, so for a short time."""
    sigma, rho, beta = args
    return jnp.stack([sigma * (y[1] - y[0]), y[0] * (rho - y[2]) - y[1], y[0] * y[1] - beta * y[2]])


def pendulum_chain(t, y, args):
    """Twenty pendulums, each tied to the next by a soft torsion spring: a state of two arrays."""
    gravity, tie = args
    apart = jnp.diff(y["angle"], prepend=0.0, append=0.0)
    apart = apart.at[0].set(0.0).at[-1].set(0.0)
    return {"angle": y["speed"], "speed": -gravity * jnp.sin(y["angle"]) + tie * jnp.diff(apart)}


SYSTEMS = {
    "Lotka-Volterra": (
        lotka_volterra,
        jnp.array([1.5, 1.0, 0.8, 3.0]),
        jnp.array([10.0, 5.0]),
        3.0,
    ),
    "Lorenz": (lorenz, jnp.array([10.0, 28.0, 8 / 3]), jnp.array([1.0, 1.0, 1.0]), 1.0),
    "pendulum chain": (
        pendulum_chain,
        jnp.array([9.81, 2.0]),
        {"angle": jnp.linspace(0.1, 1.5, 20), "speed": jnp.zeros(20)},
        2.0,
    ),
}


def path(field, args, y0, end, *, rtol=1e-10, saved=9, **options):
    steps = diffrax.PIDController(rtol=rtol, atol=rtol, norm=optimistix.max_norm)
    saveat = diffrax.SaveAt(t0=True, t1=True, ts=jnp.linspace(0.1 * end, end, saved))
    options = {
        "solver": diffrax.Dopri8(),
        "t0": 0.0,
        "dt0": None,
        "stepsize_controller": steps,
        "saveat": saveat,
    } | options
    return diffrax.diffeqsolve(diffrax.ODETerm(field), t1=end, y0=y0, args=args, **options)


def flat(tree):
    return np.concatenate([np.ravel(x) for x in jax.tree.leaves(tree)])


@pytest.mark.long
@pytest.mark.parametrize("system", SYSTEMS)
def test_three_systems_as_exactly_as_diffrax_with_gradients_of_every_mode(system):
    """As near to the solution as diffrax at the same tolerance; with constant steps equal to
    rounding, and both modes equal to diffrax's ForwardMode."""
    field, args, y0, end = SYSTEMS[system]
    exact, theirs, ours = (
        path(field, args, y0, end, **options)
        for options in ({"rtol": 1e-13}, {}, {"adjoint": jb.BlockAdjoint()})
    )
    np.testing.assert_array_equal(ours.ts, theirs.ts)
    size = np.abs(flat(exact.ys)).max()
    errors = [np.abs(flat(of.ys) - flat(exact.ys)).max() / size for of in (ours, theirs)]
    print(
        errors,
        [(of.stats["num_accepted_steps"], of.stats["num_rejected_steps"]) for of in (ours, theirs)],
    )
    assert errors[0] < max(3 * errors[1], 1e-11) and bool(ours.result == diffrax.RESULTS.successful)

    def loss(args, y0, adjoint):
        run = path(field, args, y0, end, dt0=end / 60, adjoint=adjoint, **CONSTANT)
        return sum(jnp.sum(x**2) for x in jax.tree.leaves(run.ys)), run.ys

    def along(adjoint):
        return jax.jvp(
            lambda *given: loss(*given, adjoint),
            (args, y0),
            jax.tree.map(jnp.ones_like, (args, y0)),
        )

    def reverse(args, y0):
        return jax.value_and_grad(
            lambda *given: loss(*given, jb.BlockAdjoint()), argnums=(0, 1), has_aux=True
        )(args, y0)

    (_, same), (slope, changes) = jax.jit(lambda: along(diffrax.ForwardMode()))()
    (_, ys), slopes = jax.jit(reverse)(args, y0)
    (_, forward) = jax.jit(lambda: along(jb.BlockAdjoint(forward_only=True)))()
    np.testing.assert_allclose(flat(ys), flat(same), rtol=0, atol=1e-13 * size)
    assert float(flat(slopes).sum()) == pytest.approx(float(slope), rel=1e-9)
    np.testing.assert_allclose(
        flat(forward[1]), flat(changes), rtol=0, atol=1e-9 * np.abs(flat(changes)).max()
    )


@pytest.mark.long
@pytest.mark.parametrize("adaptive", [False, True])
def test_reverse_mode_is_forward_mode_of_the_same_blocks(adaptive):
    """Also by what the field closes over, in a batch, and for the end of the time."""
    field, args, y0, end = SYSTEMS["Lotka-Volterra"]
    options = {} if adaptive else CONSTANT | {"dt0": 0.02}

    def last(scale, end):
        return path(
            lambda t, y, args: scale * field(t, y, args),
            args,
            y0,
            end,
            adjoint=jb.BlockAdjoint(),
            **options,
        ).ys[-1, 0]

    def all_modes(scale):
        return jax.grad(last, (0, 1))(scale, end), jax.jacfwd(last, (0, 1))(scale, end)

    reverse, forward = jb.jit(jax.vmap(all_modes))(jnp.array([0.9, 1.0, 1.1]))
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    alone = jb.jit(all_modes)(1.0)
    np.testing.assert_allclose(np.asarray(alone), np.stack([reverse, forward])[..., 1], rtol=1e-8)


@pytest.mark.long
@pytest.mark.parametrize(
    "solver",
    [diffrax.Tsit5(), diffrax.Dopri5(), diffrax.Bosh3(), diffrax.Heun()],
    ids=lambda x: type(x).__name__,
)
def test_tableaus_and_polynomials_are_those_of_the_solver(solver):
    field, args, y0, end = SYSTEMS["Lotka-Volterra"]
    options = {"solver": solver, "dt0": 0.02} | CONSTANT
    theirs, ours = (
        path(field, args, y0, end, **options, **given)
        for given in ({}, {"adjoint": jb.BlockAdjoint()})
    )
    np.testing.assert_allclose(ours.ys, theirs.ys, rtol=1e-12)
    assert int(ours.stats["num_steps"]) == 150


@pytest.mark.long
def test_backward_in_time_with_a_first_step_and_times_to_stop_at():
    """From the end of a path back to its start, and in steps that end where they are asked to."""
    field, args, y0, end = SYSTEMS["Lotka-Volterra"]
    there = path(field, args, y0, end, adjoint=jb.BlockAdjoint()).ys[-1]
    back = path(
        field,
        args,
        there,
        0.0,
        t0=end,
        dt0=-0.01,
        saveat=diffrax.SaveAt(ts=jnp.array([2.0, 1.0, 0.0])),
        adjoint=jb.BlockAdjoint(),
    )
    np.testing.assert_allclose(back.ys[-1], y0, rtol=1e-8)
    between = path(field, args, y0, 2.0, saveat=diffrax.SaveAt(ts=jnp.array([1.0, 2.0]))).ys[::-1]
    np.testing.assert_allclose(back.ys[:2], between, rtol=0, atol=1e-8)
    steps = diffrax.ClipStepSizeController(
        diffrax.PIDController(rtol=1e-3, atol=1e-3), step_ts=jnp.linspace(0.0, end, 301)
    )
    assert (
        int(
            path(field, args, y0, end, stepsize_controller=steps, adjoint=jb.BlockAdjoint()).stats[
                "num_accepted_steps"
            ]
        )
        == 300
    )


@pytest.mark.long
def test_samples_are_functions_of_the_state_and_statuses_those_of_diffrax():
    field, args, y0, end = SYSTEMS["Lotka-Volterra"]
    sums = diffrax.SaveAt(ts=jnp.array([0.5, 1.0]), fn=lambda t, y, args: t + jnp.sum(y))
    theirs, ours = (
        path(field, args, y0, end, saveat=sums, **given)
        for given in ({}, {"adjoint": jb.BlockAdjoint()})
    )
    np.testing.assert_allclose(ours.ys, theirs.ys, rtol=1e-9)
    short = path(field, args, y0, end, adjoint=jb.BlockAdjoint(), max_steps=3, throw=False)
    assert (
        bool(short.result == diffrax.RESULTS.max_steps_reached)
        and int(short.stats["num_steps"]) == 3
    )
    assert (
        np.isnan(short.ys[-2]).all()
        and np.isfinite(short.ys[-1]).all()
        and float(short.ts[-1]) < end
    )
    stuck = path(field, args * jnp.nan, y0, end, adjoint=jb.BlockAdjoint(), throw=False)
    assert (
        bool(stuck.result == diffrax.RESULTS.dt_min_reached)
        and jb.Status(int(stuck.stats["status"])).name == "NONFINITE"
    )


def test_times_and_first_step_of_the_adjoint_replace_those_that_diffrax_checks_at_run_time():
    """The same numbers; the program then calls no host."""
    field, args, y0, end = SYSTEMS["Lotka-Volterra"]
    times = jnp.linspace(0.0, end, 5)

    def by_diffrax(y0):
        return path(
            field,
            args,
            y0,
            end,
            saveat=diffrax.SaveAt(ts=times, t1=True),
            dt0=0.05,
            adjoint=jb.BlockAdjoint(),
            throw=False,
            **CONSTANT,
        ).ys

    def by_blocks(y0):
        blocks = jb.BlockAdjoint(times, jnp.array(0.05))
        return path(
            field,
            args,
            y0,
            end,
            saveat=diffrax.SaveAt(t1=True),
            adjoint=blocks,
            throw=False,
            stepsize_controller=Unstarted(diffrax.ConstantStepSize()),
        ).ys

    np.testing.assert_allclose(by_blocks(y0), by_diffrax(y0), rtol=1e-13)
    lowered = [jax.jit(of).lower(y0).as_text() for of in (by_diffrax, by_blocks)]
    assert ["callback" in text for text in lowered] == [True, False]


def test_parts_of_a_driven_term_are_found_within_what_diffrax_makes_of_it():
    """Its whole field is only looked at: here it would end in NaN. diffeqsolve wraps the term,
    which no document states."""
    times = jnp.linspace(0.0, 1.0, 3)
    term = Driven(lambda t, args: jnp.cos(args * t), lambda u, y, args: u * jnp.ones_like(y))
    object.__setattr__(term, "vector_field", lambda t, y, args: y * jnp.nan)
    steps = diffrax.PIDController(rtol=1e-9, atol=1e-9)
    run = diffrax.diffeqsolve(
        term,
        diffrax.Dopri8(),
        0.0,
        1.0,
        None,
        jnp.zeros(1),
        2.0,
        saveat=diffrax.SaveAt(t1=True),
        stepsize_controller=steps,
        adjoint=jb.BlockAdjoint(times),
        throw=False,
    )
    np.testing.assert_allclose(run.ys[:3, 0], np.sin(2 * times) / 2, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(
    "given",
    [
        {"solver": diffrax.Kvaerno5()},
        {"solver": diffrax.Euler(), "dt0": 0.1} | CONSTANT,
        {"stepsize_controller": diffrax.PIDController(rtol=1e-3, atol=1e-3, pcoeff=0.4)},
        {"stepsize_controller": diffrax.PIDController(rtol=1e-3, atol=1e-3, dtmin=1e-3)},
        {"stepsize_controller": diffrax.StepTo(jnp.array([0.0, 1.0, 3.0]))},
        {"saveat": diffrax.SaveAt(steps=True)},
        {"saveat": diffrax.SaveAt(dense=True)},
        {"event": diffrax.Event(lambda t, y, args, **_: y[0] - 1.0)},
        {"max_steps": None},
        {"progress_meter": diffrax.TextProgressMeter()},
    ],
    ids=lambda given: next(iter(given)),
)
def test_what_blocks_do_not_know_is_refused_by_name(given):
    field, args, y0, end = SYSTEMS["Lotka-Volterra"]
    with pytest.raises(jb.JaxbodyError, match=rf"BlockAdjoint\.{next(iter(given))}.*WRONG_KIND"):
        path(field, args, y0, end, adjoint=jb.BlockAdjoint(), **given)


def test_a_linear_function_has_the_transpose_that_it_is_given():
    """y = k x by a loop of unknown length, which JAX cannot transpose: forward, reverse, in batches
    of either argument, second derivatives."""

    def times(k, x):
        return jax.lax.while_loop(
            lambda c: c[0] < 3, lambda c: (c[0] + 1, c[1] + k * x / 3), (0, jnp.zeros_like(k * x))
        )[1]

    def scaled(k, x):
        return step_blocks.linear_with_transpose(
            lambda k, x: times(k, x[0]), lambda k, y: [times(k, y)], k, [x], x
        )

    k, x = jnp.array([2.0, 3.0]), jnp.array([5.0, 7.0])
    both = lambda k, x: (  # noqa: E731
        scaled(k, x),
        jax.jacfwd(scaled, 1)(k, x),
        jax.grad(scaled, 1)(k, x),
        jax.jacfwd(scaled)(k, x),
    )
    for result in (
        jax.jit(jax.vmap(both))(k, x),
        jax.tree.map(lambda *p: jnp.stack(p), *(both(*p) for p in zip(k, x, strict=True))),
    ):
        assert jnp.allclose(jnp.stack(result), jnp.stack([k * x, k, k, x]), rtol=1e-15)
    assert jnp.allclose(
        jax.grad(lambda x: jnp.sum(jax.vmap(scaled, (0, None))(k, x)))(5.0), 5.0, rtol=1e-15
    )  # 2 + 3
    mixed = jax.jacfwd(jax.grad(lambda x, k: scaled(k, x) * x), 1)  # d/dk of d(k x2)/dx = 2 x
    assert jnp.allclose(mixed(5.0, 2.0), 10.0, rtol=1e-15)
