"""Failed results under jax.grad, jvp, vjp and vmap outside of jit: their warnings, the user's line,
and their reports."""

import functools
import re
import subprocess
import sys
import warnings

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.errors import Problem

PUSHED = jb.State(jnp.array([0.1]), jnp.zeros(1))


def slider(stiffness, law=None):
    """A mass on a guide along x, held by a spring of this stiffness or by this law."""
    ends = ("mass", [0, 0, 0]), ("base", [-1, 0, 0])
    spring = (
        jb.Spring(*ends, stiffness=stiffness, free_length=1.0)
        if law is None
        else jb.SpringDamper(*ends, spring=law, free_length=1.0)
    )
    return jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("base", axis=[1, 0, 0])},
        elements={"s": spring},
    )


def stops(t):
    return jnp.where(t < 0.75, 0.0, jnp.nan) * jnp.ones(6)


def moved(k, adjoint=None, *, width=1.0, end=0.6, rtol=1e-4):
    """The last position; all cases share one program: a spring with a table of this half width."""
    x = width * np.array([-2.0, -1.0, 1.0, 2.0])
    model = slider(None, jb.laws.Tabulated(x, k * x))
    return jb.simulate(
        model,
        [0.0, end / 2, end],
        motion={"base": stops},
        initial=PUSHED,
        rtol=rtol,
        adjoint=adjoint,
        max_steps=120,
    ).state.q[-1, 0]


def at_rest(k, adjoint=None, *, max_steps=0):
    return jb.equilibrium(slider(k), start=PUSHED, max_steps=max_steps).state.q[0]


# Functions of a stiffness whose result has this status
FAILURES = {
    "MAX_STEPS": functools.partial(moved, rtol=1e-14),
    "NONFINITE": functools.partial(moved, end=0.9),
    "TABLE_RANGE": functools.partial(moved, width=0.01),
    "NOT_CONVERGED": at_rest,
    "SINGULAR_K": lambda k, *adjoint: at_rest(0.0 * k, *adjoint, max_steps=3),
}
TRANSFORMED = {
    "grad": lambda f: jax.grad(f)(400.0),
    "vjp": lambda f: jax.vjp(f, 400.0)[1](1.0)[0],
    "jvp": lambda f: jax.jvp(lambda k: f(k, diffrax.ForwardMode()), (400.0,), (1.0,))[1],
}


def without_numbers(text):
    return re.sub(r"\d[\d.e-]*", "#", text)


def warned(function):
    """The result of a function, and the warnings that it issued."""
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        return function(), [str(w.message) for w in seen]


@pytest.mark.long
@pytest.mark.parametrize("code", FAILURES)
def test_a_failed_result_issues_the_same_warnings_under_derivatives(code):
    """The derivative of a failed result is NaN; beyond a table the values are valid, and so are the
    derivatives. Steps near a failure depend on rounding, which XLA's options change: words are
    compared, not numbers."""
    number = FAILURES[code]
    _, plain = warned(lambda: number(400.0))
    assert len(plain) == 1 and plain[0].endswith(f"[{code}]")
    for name, transformed in TRANSFORMED.items():
        slope, seen = warned(lambda: transformed(number))  # noqa: B023
        assert [without_numbers(text) for text in seen] == [
            without_numbers(text) for text in plain
        ], name
        assert np.isfinite(slope) == (code == "TABLE_RANGE"), name
    slopes, seen = warned(lambda: jax.vmap(jax.grad(number))(jnp.array([400.0, 500.0])))
    assert seen == [] and (np.isfinite(slopes) == (code == "TABLE_RANGE")).all()


@pytest.mark.long
def test_derivatives_of_samples_before_a_failure_are_right():
    """x = 0.1 cos(w t): the sample at 0.5 s is reached in ten steps, the last is not."""

    def sample(k):
        return jb.simulate(
            slider(k), [0.0, 0.5, 30.0], initial=PUSHED, rtol=1e-10, max_steps=30
        ).state.q[1, 0]

    slope, seen = warned(lambda: jax.grad(sample)(4.0))
    assert len(seen) == 1 and "MAX_STEPS" in seen[0]
    assert abs(slope + 0.1 * np.sin(2.0 * 0.5) * 0.5 / (2 * 2.0)) <= 1e-9


@pytest.mark.long
def test_a_report_inside_a_transformation_has_the_values_that_are_not_traced():
    def reported(k):
        eq = jb.equilibrium(slider(k), start=PUSHED, max_steps=0)
        reports.append(eq.report())
        with pytest.raises(jb.JaxbodyError) as error:
            eq.raise_if_failed()
        reports.append(error.value.code)
        return eq.state.q[0]

    reports: list[str] = []
    for transformed in (jax.grad(reported), jax.jit(reported)):
        warned(lambda: transformed(400.0))  # noqa: B023
    assert "largest residual is 40 N" in reports[0]
    assert reports[1:] == ["NOT_CONVERGED", "traced", "TRACED"]


LINES = """
import jax
import jaxbody as jb
jax.config.update("jax_enable_x64", True)
bodies = {"engine": jb.Body(mass=1, inertia=[1, 1, 1]), "bolt": jb.Body(mass=1e-15, inertia=[1, 1, 1])}
model = jb.Model(bodies=bodies)
free = jb.Model(bodies={"mass": bodies["engine"]}, joints={"mass": jb.Guide("world", axis=[1, 0, 0])})
def place(g):
    return jb.equilibrium(jb.replace(free, {"gravity": [g, 0, 0]})).state.q[0]
jax.grad(place)(1.0)
jb.equilibrium(free)
"""  # noqa: E501


@pytest.mark.long
def test_warnings_point_at_the_line_of_the_user():
    done = subprocess.run(
        [sys.executable, "-W", "always", "-c", LINES],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    codes = re.findall(r"^<string>:(\d+): JaxbodyWarning: .*\[(\w+)\]$", done.stderr, re.MULTILINE)
    assert codes == [("6", "TINY_MASS"), ("9", "NO_EQUILIBRIUM"), ("11", "SINGULAR_K")]


def test_an_error_states_the_allowed_values():
    problem = Problem("BAD_MASS", "Body.mass", "is -3 kg", -3.0, "> 0", "Give a mass.")
    assert (
        str(problem) == "Body.mass: is -3 kg (allowed: > 0). Give a mass. [BAD_MASS]"
        and problem.limit == "> 0"
    )


# round-off decides whether steps get past the jump; those of more than a thousand samples, which
# are optimized, do not
@pytest.mark.long
def test_a_spring_that_shrinks_to_a_point_is_named():
    """At 0.0743 s: x'' = 50 (1 - x) from 0.5 m at -8 m/s, so 1 - x = 0.5 cos wt + (8/w) sin wt = 1
    with w = sqrt(50)/s."""
    trajectory, seen = warned(
        lambda: jb.simulate(
            slider(50.0),
            np.linspace(0, 1, 1001),
            rtol=1e-12,
            initial=jb.State(jnp.array([-0.5]), jnp.array([-8.0])),
        )
    )
    assert (
        "'s' has shrunk to a point; its direction jumps there" in seen[0]
        and "larger max_steps" not in seen[0]
    )
    w, t = np.sqrt(50), float(trajectory.end[0])
    assert abs(0.5 * np.cos(w * t) + 8 / w * np.sin(w * t) - 1) <= 1e-9


@pytest.mark.long
def test_a_derivative_that_would_reserve_too_much_memory_is_refused_before():
    """For every 128th of 1e9 steps: a state of two numbers, its rate, a polynomial of seven, and
    128 lengths, 8 bytes each: over 9 GB."""

    def number(k):
        return jb.simulate(slider(k), [0.0, 0.1], max_steps=10**9).state.q[-1, 0]

    for transformed in (jax.grad(number), jax.jit(jax.grad(number)), jax.jacfwd(number)):
        with pytest.raises(
            jb.JaxbodyError, match=r"max_steps=1000000000.*Give fewer max_steps, .*ForwardMode\(\)"
        ) as refused:
            jax.eval_shape(transformed, 400.0)
        assert refused.value.code == "TOO_LARGE"
        assert (
            128 + 2 * (1 + 1 + 7)
            <= float(re.search(r"(\d+) bytes for every 128", str(refused.value))[1]) / 8
            <= 2 * (128 + 2 * (1 + 1 + 7))
        )
    assert jax.eval_shape(number, 400.0).shape == ()
