"""Derivatives with respect to every kind of parameter, forward, reverse and by differences; vmap,
jit and new values change nothing."""

import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
from rigs import max_difference

import jaxbody as jb

RNG = np.random.default_rng(11)
TIMES = np.linspace(0, 0.6, 401)
INITIAL = {
    "q": np.array([0.15, -0.2, 0.45, 0.96, 0.1, -0.15, 0.2, 2.0]),
    "v": np.array([0.3, -0.2, 0.1, 0.5, 0.4, -0.3, 0.8]),
}
jit_once = jb.jit  # compiling is the cost


def still(p):
    """Equilibrium, natural frequencies and damping ratios of the rig: 8 + 7 + 7 numbers."""
    model = rigs.rig(p)
    result = jb.equilibrium(model)
    modes = jb.modes(jb.linearize(model, result))
    return jnp.concatenate([result.state.q, modes.frequency, modes.damping_ratio])


WEIGHTS = np.cos(np.arange(4 * 15.0)).reshape(4, 15)


def moving(p, adjoint=None):
    """Three losses on a trajectory of the rig: places, attitude and angle; speeds; the length of
    a spring."""
    initial = jb.State(jnp.concatenate([p["q"][:3], rigs.unit(p["q"][3:7]), p["q"][7:]]), p["v"])
    motion = {"base": jb.Harmonic(**{name: p[name] for name in rigs.SHAKING})}
    trajectory = jb.simulate(
        rigs.rig(p), TIMES, motion=motion, initial=initial, rtol=1e-11, adjoint=adjoint
    )
    seen = slice(100, None, 100)
    q, v = trajectory.state.q[seen], trajectory.state.v[seen]
    return jnp.stack(
        [
            jnp.sum(WEIGHTS[:, :8] * q**2),
            jnp.sum(WEIGHTS[:, 8:] * v**2),
            jnp.sum(trajectory.elongations["s3"][seen] ** 2),
        ]
    )


def directions(p):
    """For every kind of parameter a random direction, zero elsewhere, of the size of the parameter;
    matrices stay symmetric."""
    result = {}
    for kind, value in p.items():
        tangent = RNG.normal(size=value.shape) * np.abs(value).max()
        if value.ndim == 2 and value.shape == value.T.shape:
            tangent = (tangent + tangent.T) / 2
        result[kind] = {
            other: jnp.array(tangent) if other == kind else jnp.zeros_like(p[other]) for other in p
        }
    return result


def stacked(trees):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def inner(gradient, tangent):
    """Sum of the products, for gradients with one more axis in front."""
    return sum(
        np.tensordot(g, d, np.ndim(d))
        for g, d in zip(jax.tree.leaves(gradient), jax.tree.leaves(tangent), strict=True)
    )


def slopes(function, p, tangents, h):
    """Derivatives along every tangent: by forward mode, and by central differences of the fourth
    order with steps h."""
    forward = jit_once(jax.vmap(lambda p, d: jax.jvp(function, (p,), (d,))))
    steps = h * np.array([0, -2, -1, 1, 2])
    points = stacked(
        [jax.tree.map(lambda x, d, s=s: x + s * d, p, d) for d in tangents for s in steps]
    )
    values, derivatives = forward(points, stacked([d for d in tangents for _ in steps]))
    values = jax.tree.map(lambda x: x.reshape(-1, 5, *x.shape[1:]), values)
    return (
        jax.tree.map(lambda x: x.reshape(-1, 5, *x.shape[1:])[:, 0], derivatives),
        jax.tree.map(lambda x: (8 * (x[:, 3] - x[:, 2]) - (x[:, 4] - x[:, 1])) / (12 * h), values),
        values,
    )


def assert_derivatives_agree(kinds, parts, forward, reverse, differences, silent=()):
    """Forward and reverse mode to 1e-9, both and differences to 1e-6, relative to the largest
    derivative of its kind and part."""
    worst = np.zeros(2)
    for i, kind in enumerate(kinds):
        for name, part in parts.items():
            scale = np.abs(differences[i][part]).max()
            if (kind, name) in silent:
                assert (
                    max(scale, np.abs(forward[i][part]).max(), np.abs(reverse[i][part]).max())
                    < 1e-8
                ), (kind, name)
                continue
            errors = (
                np.array(
                    [
                        max_difference(forward[i][part], differences[i][part]),
                        max_difference(forward[i][part], reverse[i][part]),
                    ]
                )
                / scale
            )
            worst = np.maximum(worst, errors)
            assert errors[0] < 1e-6, (kind, name)
            assert errors[1] < 1e-9, (kind, name)
    print("derivatives: differences, reverse", worst)


STILL = jax.tree.map(jnp.asarray, rigs.PARAMETERS)
MOVING = STILL | jax.tree.map(jnp.asarray, rigs.SHAKING | INITIAL)


@pytest.mark.long
def test_equilibrium_frequencies_and_damping_have_the_derivatives_of_differences():
    tangents = directions(STILL)
    forward, differences, _ = slopes(still, STILL, tangents.values(), 1e-4)
    jacobian = jit_once(jax.jacrev(still))(STILL)
    reverse = [inner(jacobian, tangent) for tangent in tangents.values()]
    parts = {"equilibrium": slice(0, 8), "frequency": slice(8, 15), "damping": slice(15, 22)}
    silent = {("damping", "equilibrium"), ("damping", "frequency"), ("inertia", "equilibrium")}
    assert_derivatives_agree(tangents, parts, forward, reverse, differences, silent)


@pytest.mark.long
def test_trajectories_have_the_derivatives_of_differences():
    """Differences of the fourth order with two steps, extrapolated to the sixth: shorter steps show
    the noise of adaptive steps, longer ones their own error."""
    tangents, function = (
        directions(MOVING),
        functools.partial(moving, adjoint=diffrax.ForwardMode()),
    )
    (forward, short, _), (_, long, _) = (
        slopes(function, MOVING, tangents.values(), h) for h in (2e-3, 4e-3)
    )
    differences = (16 * short - long) / 15
    gradients = jit_once(jax.jacrev(moving))(MOVING)
    reverse = [inner(gradients, tangent) for tangent in tangents.values()]
    assert_derivatives_agree(
        tangents, {"places": 0, "speeds": 1, "spring": 2}, forward, reverse, differences
    )


MOUNT = jax.tree.map(
    jnp.asarray,
    {
        **rigs.MOUNT,
        "orientation_b": np.array([0.95, -0.2, 0.1, 0.15]),
        "at": np.array([0.1, 0.2, -0.1]),
        "spring": np.array(80.0),
        "free_length": np.array(0.6),
        "mass": np.array(1.5),
        "gravity": np.array([0.3, -0.2, -9.8]),
    },
)


def mounted(p):
    """An arm on a hinge of the base, held by a spring and a bushing that is far from relaxed."""
    bushing = jb.Bushing(
        ("arm", [0.3, 0.05, 0.1]),
        ("base", [0.4, 0.2, 0.3]),
        stiffness=p["stiffness"],
        damping=p["damping"],
        orientation=rigs.unit(p["orientation"]),
        orientation_b=rigs.unit(p["orientation_b"]),
    )
    spring = jb.Spring(
        ("arm", [0.5, 0, 0]),
        ("base", [0.6, 0.1, 0.8]),
        stiffness=p["spring"],
        free_length=p["free_length"],
    )
    model = jb.Model(
        bodies={"arm": jb.Body(mass=p["mass"], inertia=[0.02, 0.05, 0.06], com=[0.2, 0.02, -0.03])},
        supports={"base": jb.Support()},
        joints={"arm": jb.Hinge("base", axis=[0.2, 1.0, -0.1], at=p["at"])},
        elements={"mount": bushing, "spring": spring},
        gravity=p["gravity"],
    )
    result = jb.equilibrium(model)
    modes = jb.modes(jb.linearize(model, result))
    return jnp.concatenate([result.state.q, modes.frequency, modes.damping_ratio])


@pytest.mark.long
def test_bushings_have_the_derivatives_of_differences():
    """Forward; the reverse derivatives, whose program takes a minute to compile, are those of the
    next test."""
    forward, differences, _ = slopes(mounted, MOUNT, directions(MOUNT).values(), 1e-4)
    for part in range(3):
        assert (
            max_difference(forward[:, part], differences[:, part])
            < 1e-6 * np.abs(differences[:, part]).max()
        )


@pytest.mark.long
def test_bushings_have_the_second_derivatives_of_differences():
    """The Hessian of the frequency, forward over reverse through the equilibrium, along
    every direction."""
    tangents = directions(MOUNT)
    forward, _, _ = slopes(mounted, MOUNT, tangents.values(), 1e-4)
    along, twice, gradients = slopes(
        jax.grad(lambda p: mounted(p)[1]), MOUNT, tangents.values(), 1e-4
    )
    gradient = jax.tree.map(lambda x: x[0, 0], gradients)
    for i, (kind, tangent) in enumerate(tangents.items()):
        assert (
            max_difference(forward[i, 1], inner(gradient, tangent))
            < 1e-9 * np.abs(forward[:, 1]).max()
        ), kind
        for other in MOUNT:
            result, expected = np.asarray(along[other][i]), np.asarray(twice[other][i])
            scale = np.abs(expected).max()
            assert max_difference(result, expected) < 1e-6 * max(scale, 1e-6), (kind, other)
    second = np.array(
        [
            [inner(jax.tree.map(lambda x, i=i: x[i], along), d) for d in tangents.values()]
            for i in range(len(tangents))
        ]
    )
    assert max_difference(second, second.T) < 1e-9 * np.abs(second).max()


def slider(stiffness):
    return jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
        elements={
            "s": jb.Spring(
                ("mass", [0, 0, 0]), ("world", [-1, 0, 0]), stiffness=stiffness, free_length=1.0
            )
        },
    )


@pytest.mark.long
@pytest.mark.parametrize("offset", [0.0, 0.5])
def test_constant_steps_have_right_gradients_also_where_samples_lie_on_steps(offset):
    """The sum of squares of x = 0.1 cos(20 t) over the samples, by its stiffness 400; the default
    is no checkpointed reverse mode."""
    step = 0.01
    times = np.concatenate([[0.0], step * (np.arange(1, 200) + offset)])

    def loss(stiffness, adjoint=None):
        initial = jb.State(jnp.array([0.1]), jnp.zeros(1))
        options = dict(
            stepsize_controller=diffrax.ConstantStepSize(),
            dt0=step,
            solver=diffrax.Tsit5(),
            max_steps=256,
        )
        return jnp.sum(
            jb.simulate(
                slider(stiffness), times, initial=initial, adjoint=adjoint, **options
            ).state.q
            ** 2
        )

    reverse = jit_once(jax.grad(loss))(400.0)
    forward = jit_once(jax.jacfwd(functools.partial(loss, adjoint=diffrax.ForwardMode())))(400.0)
    exact = np.sum(-0.01 * np.sin(40 * times) * times / 40)
    print("constant steps", reverse / exact - 1, reverse / forward - 1)
    assert abs(reverse / forward - 1) < 1e-9
    assert abs(reverse / exact - 1) < 1e-4


# The same numbers by vmap, jit and loops


def variants(count):
    """Parameters of the rig, a little apart."""
    return [
        jax.tree.map(lambda x: x * (1 + 0.02 * RNG.normal(size=x.shape)), MOVING)
        for _ in range(count)
    ]


def results_of(p, dt0=0.01):
    """Results of all public functions for the rig; in constant steps, as controlled ones depend
    on round-off."""
    model = rigs.rig(p)
    result = jb.equilibrium(model)
    lin = jb.linearize(model, result)
    modes = jb.modes(lin)
    initial = jb.State(jnp.concatenate([p["q"][:3], rigs.unit(p["q"][3:7]), p["q"][7:]]), p["v"])
    motion = {"base": jb.Harmonic(**{name: p[name] for name in rigs.SHAKING})}
    trajectory = jb.simulate(
        model,
        TIMES,
        motion=motion,
        initial=initial,
        stepsize_controller=diffrax.ConstantStepSize(),
        dt0=dt0,
        max_steps=128,
    )
    return {
        "equilibrium": (result.state.q, result.elongations["s3"], result.energy, result.status),
        "linearization": (lin.M, lin.C, lin.K, lin.K_tilde, lin.M_bb),
        "modes": (modes.frequency, modes.damping_ratio, jnp.abs(modes.shapes)),
        "trajectory": (trajectory.state.q, trajectory.state.v, trajectory.status),
    }


@pytest.mark.long
def test_vmap_is_a_loop_and_jit_changes_nothing():
    several = variants(3)
    together = jit_once(jax.vmap(results_of))(stacked(several))
    for i, p in enumerate(several):
        one = results_of({name: np.asarray(value) for name, value in p.items()})  # outside of jit
        assert int(one["equilibrium"][3]) == int(one["trajectory"][2]) == 0
        for kind, numbers in one.items():
            for result, expected in zip(together[kind], numbers, strict=True):
                scale = max(np.abs(expected).max(), 1e-2)
                print("vmap", kind, max_difference(result[i], expected) / scale)
                assert max_difference(result[i], expected) < 1e-12 * scale, kind


@pytest.mark.long
def test_new_values_compile_nothing(caplog):
    """Of the model, of the motion, of the initial state, of the times and of the tolerance; with
    and without names of results."""

    def everything(p, dt0, rtol, end):
        p = {name: np.asarray(value) for name, value in p.items()}
        results_of(p, dt0)
        model = jb.replace(
            rigs.rig(p), {"*.stiffness": float(p["stiffness"][0]), "box.mass": float(p["mass"][0])}
        )
        start = jb.equilibrium(model, start=model.reference)
        excitation = jb.excitation(model, start, {"base": p["translation"].repeat(2)})
        trajectory = jb.simulate(
            model,
            end * TIMES,
            motion={"base": jb.Harmonic(frequency=rtol)},
            initial=start.state,
            rtol=rtol,
        )
        repr(
            (
                start,
                jb.linearize(model, start),
                jb.modes(jb.linearize(model, start)),
                trajectory,
                model,
            )
        )
        return excitation, trajectory.energies, trajectory.poses, start.elongations

    one, other = variants(2)
    everything(one, 0.01, 1e-8, 1.0)
    with jax.log_compiles():
        everything(other, 0.011, 1e-7, 1.1)
        compiled = [
            record.getMessage()
            for record in caplog.records
            if record.getMessage().startswith("Compiling")
        ]
        assert not compiled
        jax.jit(lambda x: x + 1)(1.0)
        assert any(record.getMessage().startswith("Compiling") for record in caplog.records)
