"""One warning for a function that is compiled for every call, which names the changing argument,
and one for a long compilation."""

import time
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.compilation import compilations
from jaxbody.core.compilation.compile_options import program
from jaxbody.model.inputs.motions import as_motion


def summed(x, steps, functions):
    return sum((f(x).sum() for f in functions), steps * x.sum())


def doubled():
    def f(x):
        return 2 * x

    return f


once = doubled()
CALLS = {
    "shape": (
        lambda i: (jnp.ones(i + 1), 3, (once,)),
        r"for the shape of x: \(1,\) float64, \(2,\) float64, .*arrays of one shape",
    ),
    "type": (
        lambda i: (np.ones(2, f"{'iuf'[i % 3]}{(8, 4, 2)[i // 3]}"), 3, (once,)),
        r"for the type of x: .* numbers of one type",
    ),
    "value": (
        lambda i: (jnp.ones(2), i, (once,)),
        r"for the value of steps: 0, 1, 2, 3, \.\.\.; one value",
    ),
    "function": (
        lambda i: (jnp.ones(2), 3, (doubled(),)),
        r"for a new Python function in functions\[0\]; make it once",
    ),
}


def warned(function, calls):
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        for args in calls:
            function(*args)
    return [str(w.message) for w in seen]


@pytest.mark.parametrize("reason", CALLS)
def test_what_makes_a_function_compile_again_and_again_is_named_once(reason):
    make, words = CALLS[reason]
    (message,) = warned(program(summed), [make(i) for i in range(8)])
    assert message.startswith(
        "test_recompilations.summed was compiled 6 times in a row"
    ) and message.endswith("[RECOMPILED]")
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(message)


def test_an_argument_left_to_its_default_takes_no_part():
    scaled = program(lambda x, by=2.0: by * x)
    (message,) = warned(scaled, [(jnp.ones(i + 1),) for i in range(8)])
    assert "for the shape of x" in message


def test_programs_of_their_own_are_no_storm():
    """New numbers compile nothing; other functions, and two things at once, are other programs;
    five in a row are not many."""
    others = [np.sum, np.max, np.min, np.mean, np.prod, np.ptp, np.std]
    assert warned(program(summed), [(jnp.full(2, float(i)), 3, (once,)) for i in range(8)]) == []
    assert warned(program(summed), [(jnp.ones(i + 1), i, (once,)) for i in range(8)]) == []
    assert warned(program(summed), [(jnp.ones(i + 1), 3, (once,)) for i in range(5)]) == []
    assert (
        warned(program(lambda x, f: jnp.asarray(f is None) + x), [(jnp.ones(2), f) for f in others])
        == []
    )


@pytest.mark.long
def test_an_equilibrium_with_another_number_of_steps_each_time_is_a_storm():
    model = jb.Model(  # of no other test, which could have begun the row
        bodies={"stormy": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        joints={"stormy": jb.Guide("world", axis="z")},
        elements={
            "spring": jb.Spring(
                ("stormy", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=50.0, free_length=1.0
            )
        },
    )
    with pytest.warns(
        jb.JaxbodyWarning,
        match=r"equilibrium_of was compiled 6 times in a row for the value of max_steps: 51, 52",
    ):
        for steps in range(51, 58):
            jb.equilibrium(model, max_steps=steps)


def test_a_motion_that_is_created_in_each_iteration_of_a_loop_is_named():
    def place(motions, t):
        return motions[0](t)

    def calls():
        return [((as_motion(lambda t: t * jnp.ones(6)),), jnp.array(0.5)) for _ in range(7)]

    (message,) = warned(program(place), calls())
    assert "for a new Python function in the structure of motions; make it once" in message


COMPILING = "/jax/core/compile/"
SECONDS = {
    "in one phase": ([("backend_compile_duration", "jit(doubled_slowly)", 61.0)], ["61 s"]),
    "in three": (
        [
            (f"{phase}_duration", "doubled_slowly", 21.0)
            for phase in ("jaxpr_trace", "jaxpr_to_mlir_module", "backend_compile")
        ],
        ["63 s"],
    ),
    "not long": ([("backend_compile_duration", "jit(doubled_slowly)", 58.0)], []),
    "another function": ([("backend_compile_duration", "jit(another)", 61.0)], []),
    "another event": ([("something_else", "doubled_slowly", 61.0)], []),
}


@pytest.mark.parametrize("case", SECONDS)
def test_a_compilation_of_more_than_a_minute_is_mentioned(case, monkeypatch):
    """JAX says how long it took to whoever listens; here it says so once more, with
    other numbers, each after the one before."""
    events, text = SECONDS[case]
    late, real = [0.0], time.perf_counter
    monkeypatch.setattr(time, "perf_counter", lambda: real() + sum(late))

    def doubled_slowly(x):
        for event, name, seconds in events:
            late.append(seconds)
            jax.monitoring.record_event_duration_secs(COMPILING + event, seconds, fun_name=name)
        return 2 * x

    once = program(doubled_slowly)
    seen = warned(once, [(jnp.ones(3),), (jnp.zeros(3),)])
    assert [
        message.endswith("[SLOW_COMPILATION]")
        and f"doubled_slowly took {time} to compile" in message
        for message, time in zip(seen, text, strict=True)
    ] == [True] * len(text)


def test_the_seconds_of_a_compilation_are_those_that_jax_reports(monkeypatch):
    monkeypatch.setattr(compilations, "LONG", 0.0)

    def tripled(x):
        return 3 * x

    with jb.compile_times() as spent:
        (message,) = warned(program(tripled), [(jnp.ones(3),), (jnp.zeros(3),)])
    assert (
        f"tripled took {sum(spent.programs['tripled'][:3]):.0f} s to compile" in message
        and spent.programs["tripled"][3] == 1
    )


def test_results_have_no_weak_type_for_which_others_would_be_compiled_again():
    """A number of Python becomes one in a result of JAX, and batches lose it."""
    numbers = lambda x: (jnp.where(x > 0, 3, 5), 2.0 * jnp.ones(()), x)  # noqa: E731
    assert jax.jit(numbers)(jnp.ones(()))[0].aval.weak_type
    result = program(numbers)(jnp.ones(()))
    assert [x.aval.weak_type for x in result] == [False, False, False]
    assert [x.dtype for x in result] == [
        jnp.result_type(int),
        jnp.result_type(float),
        jnp.result_type(float),
    ]
