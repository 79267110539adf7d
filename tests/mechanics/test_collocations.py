"""Long and stiff motions: Gauss collocation conserves energy, at its order and with derivatives;
implicit solvers take long steps."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs

import jaxbody as jb
from jaxbody.numerics.gauss_collocations import GAUSS

STEPS = diffrax.ConstantStepSize()
TIMES = np.linspace(0, 2, 5)


def slider(stiffness=400.0):
    """Moves as 0.1 cos(20 t)."""
    return jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
        elements={
            "s": jb.Spring(
                ("mass", [0, 0, 0]), ("world", [-1, 0, 0]), stiffness=stiffness, free_length=1.0
            )
        },
    )


PUSHED = jb.State(jnp.array([0.1]), jnp.zeros(1))


def moved(stages, dt0, stiffness=400.0, **options):
    solver = jb.Gauss(stages=stages)
    model = jb.replace(slider(), {"s.stiffness": stiffness})
    return jb.simulate(
        model, TIMES, initial=PUSHED, solver=solver, stepsize_controller=STEPS, dt0=dt0, **options
    )


@pytest.mark.parametrize("stages", [1, 2, 3])
def test_coefficients_are_integrals_of_polynomials_through_the_points_of_gauss(stages):
    """c and b are NumPy's nodes and weights; sum_j a_ij c_j^k = c_i^(k + 1)/(k + 1), the integral
    to c_i of each power."""
    A, b, c = (np.array(x) for x in GAUSS[stages])
    nodes, weights = np.polynomial.legendre.leggauss(stages)
    np.testing.assert_allclose(c, (1 + nodes) / 2, rtol=1e-14)
    np.testing.assert_allclose(b, weights / 2, rtol=1e-14)
    k = np.arange(stages)
    np.testing.assert_allclose(A @ c[:, None] ** k, c[:, None] ** (k + 1) / (k + 1), rtol=1e-13)


@pytest.mark.long
@pytest.mark.parametrize("stages", [1, 2, 3])
def test_order_and_energy_of_a_linear_system(stages):
    """Order two for each stage; a quadratic energy stays to rounding."""
    errors = []
    for dt0 in (0.025, 0.0125):  # samples lie on steps
        result = moved(stages, dt0)
        errors.append(rigs.max_difference(result.state.q[:, 0], 0.1 * np.cos(20 * TIMES)))
        assert np.abs(result.energies["total"] / 2.0 - 1).max() < 1e-13  # 1/2 400 0.1^2 J
    assert abs(np.log2(errors[0] / errors[1]) - 2 * stages) < 0.25


@pytest.mark.long
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_derivatives_pass_through_the_stages(mode):
    """dq/dk of 0.1 cos(sqrt(k) t) is -0.1 sin(20 t) t/40."""
    expected = -0.1 * np.sin(20 * TIMES) * TIMES / 40
    if mode == "forward":
        slopes = jax.jacfwd(
            lambda k: moved(3, 0.01, k, adjoint=diffrax.ForwardMode()).state.q[:, 0]
        )(400.0)
    else:
        slopes = jax.jacrev(lambda k: moved(3, 0.01, k, max_steps=256).state.q[:, 0])(400.0)
    # of the method at this step; by differences of 0.01 N/m 1e-7
    assert rigs.max_difference(slopes, expected) < 1e-9 * 0.1


@pytest.mark.long
def test_steps_that_do_not_converge_end_in_a_status():
    with pytest.warns(jb.JaxbodyWarning) as caught:
        result = moved(1, 0.2)  # four over the fastest rate, where two is the most
    assert [w.message.code for w in caught] == ["STEP_TOO_LONG", "NOT_CONVERGED"]
    assert np.isnan(result.state.q[1:]).all()


def test_unknown_stages_are_refused():
    with pytest.raises(jb.JaxbodyError, match="1, 2 or 3") as error:
        jb.Gauss(stages=4)
    assert error.value.code == "BAD_VALUE"


def vibrating(periods, samples=201):
    """Relative energy above the equilibrium's of the plate swinging by 3 cm and 0.1 rad, over
    periods of its fastest mode."""
    model = rigs.plate()
    eq = jb.equilibrium(model)
    period = 1 / float(jb.modes(jb.linearize(model, eq)).frequency[-1])
    start = jb.State(
        jb.joints.retract(model, eq.state.q, jnp.array([0.02, -0.015, 0.02, 0.06, -0.05, 0.08])),
        jnp.zeros(6),
    )
    options = dict(
        solver=jb.Gauss(stages=3),
        stepsize_controller=STEPS,
        dt0=period / 10,
        max_steps=11 * periods,
    )
    result = jb.simulate(
        model,
        np.linspace(0, periods * period, samples),
        initial=start,
        adjoint=diffrax.ForwardMode(),
        **options,
    )
    assert result.ok
    assert (
        rigs.max_difference(np.linalg.norm(result.state.q[:, 3:], axis=1), np.ones(samples)) < 1e-12
    )
    energy = np.asarray(result.energies["total"]) - float(eq.energy)
    return energy / energy[0] - 1


def has_no_trend(error):
    """The slope of a line through it, over the record, is less than three of its standard errors or
    a tenth of the scatter."""
    x = np.linspace(-0.5, 0.5, len(error))
    slope = (x @ error) / (x @ x)
    scatter = np.std(error - slope * x)
    print("energy: scatter", scatter, "trend over the record", slope)
    return abs(slope) < max(3 * scatter / np.sqrt(x @ x), 0.1 * scatter)


@pytest.mark.long
def test_energy_has_no_trend_over_a_thousand_periods():
    error = vibrating(1000)
    assert np.abs(error).max() < 1e-6
    assert has_no_trend(error)
    assert not has_no_trend(error + np.linspace(0, 1e-7, len(error)))


@pytest.mark.long
def test_energy_has_no_trend_over_a_hundred_thousand_periods():
    error = vibrating(100_000)
    assert np.abs(error).max() < 1e-6
    assert has_no_trend(error)


CORNERS = np.array([[0.3, 0.2, 0], [-0.3, 0.2, 0], [-0.3, -0.2, 0], [0.3, -0.2, 0]])


def stiff():
    """A box on springs of 100 N/m carries a mass on a spring a million times as stiff,
    critically damped."""
    legs = {
        f"leg {i}": jb.Spring(
            ("box", p), ("world", p - [0, 0, 0.5]), stiffness=100.0, free_length=0.5, damping=0.5
        )
        for i, p in enumerate(CORNERS)
    }
    k, m = 1e8, 0.1
    return jb.Model(
        bodies={
            "box": jb.Body(mass=2.0, inertia=[0.02, 0.03, 0.04]),
            "bob": jb.Body(mass=m, inertia=[1, 1, 1], position=[0, 0, 0.2]),
        },
        joints={"box": jb.joints.HeavePitchRoll("world"), "bob": jb.Guide("box", axis=[0, 0, 1])},
        elements={
            **legs,
            "stiff": jb.Spring(
                ("bob", [0, 0, 0]),
                ("box", [0, 0, 0]),
                stiffness=k,
                free_length=0.2,
                damping=2 * (k * m) ** 0.5,
            ),
        },
        gravity=[0, 0, -9.81],
    )


@pytest.mark.long
def test_an_implicit_solver_steps_over_a_stiff_spring():
    """At the default tolerance, with stiffnesses of ratio 1e6: the result of the explicit solver in
    fewer than a twentieth of its steps."""
    model, times = stiff(), np.linspace(0, 5, 51)
    start = jb.State(model.reference.q + jnp.array([0.05, 0.1, -0.08, 0.0]), model.reference.v)
    explicit = jb.simulate(model, times, initial=start)
    implicit = jb.simulate(model, times, initial=start, solver=diffrax.Kvaerno5())
    taken = [int(run.statistics["num_accepted_steps"]) for run in (explicit, implicit)]
    print("stiff: steps", taken, "apart", rigs.max_difference(implicit.state.q, explicit.state.q))
    assert implicit.ok
    assert taken[1] < taken[0] / 20
    # ten times rtol times 0.1 m, both errors grown over 5 s
    assert rigs.max_difference(implicit.state.q, explicit.state.q) < 1e-7


@pytest.mark.long
def test_reverse_mode_over_a_hundred_thousand_steps_takes_little_memory():
    """Steps of at most 1 ms for 100 s: the default adjoint keeps a number of checkpoints that does
    not depend on the record; the gradient is that of forward mode."""
    model, motion = rigs.rig(), {"base": jb.Harmonic(**rigs.SHAKING)}
    steps = diffrax.PIDController(rtol=1e-3, atol=1e-3, dtmax=1e-3)

    def loss(factor, **options):
        changed = jb.replace(model, {"s0.stiffness": factor * rigs.PARAMETERS["stiffness"][0]})
        options = dict(
            stepsize_controller=steps, solver=diffrax.Tsit5(), max_steps=110_000, **options
        )
        result = jb.simulate(changed, jnp.array([0.0, 100.0]), motion=motion, dt0=1e-3, **options)
        return jnp.sum(result.state.q[-1] ** 2), result.statistics["num_accepted_steps"]

    program = jax.jit(jax.grad(loss, has_aux=True)).lower(1.0).compile()
    memory = program.memory_analysis().temp_size_in_bytes
    reverse, taken = program(1.0)
    forward, _ = jax.jit(
        jax.jacfwd(lambda x: loss(x, adjoint=diffrax.ForwardMode()), has_aux=True)
    )(1.0)
    print(
        "reverse: memory",
        memory,
        "bytes, steps",
        int(taken),
        "gradient",
        float(reverse),
        float(forward),
    )
    assert taken >= 100_000
    assert memory < 5e6
    assert abs(reverse / forward - 1) < 1e-9
