"""Operations of the programs that first.py runs: `python tests/benchmarks/operations.py`.

What a program costs to trace and to compile grows with them. Inner programs are opened and their
calls not counted; a loop's body counts once, each branch too. A function that is called twice
counts twice, as XLA compiles it twice.
"""

import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)

CAR = jb.presets.quarter_car(damping=1500.0)
TIMES = np.linspace(0.0, 2.0, 101)
MOTION = {"road": jb.Harmonic(frequency=1.3, translation=[0, 0, 0.01])}


def frequency(model):
    return jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]


def motion(model):
    return jb.simulate(model, TIMES, motion=MOTION).state.q[-1, 0]


def comfort(model):
    lin = jb.linearize(model, jb.equilibrium(model))
    roads, body = {"road": jb.BaseMotion("road", "z")}, {"body": jb.Acceleration("body", axis="z")}
    uneven = {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)}
    return jb.random_response(lin, jb.vibration.Band(0.2, 40.0, points=201), roads, body, uneven)[
        "body"
    ]


def of_stiffness(function):
    return lambda k: function(jb.replace(CAR, {"suspension.stiffness": k}))


PROGRAMS = {
    "equilibrium": of_stiffness(lambda model: jb.equilibrium(model).state.q),
    "matrices about the reference": of_stiffness(
        lambda model: jb.linearize(model, model.reference).K
    ),
    "a frequency": of_stiffness(frequency),
    "its gradient": jax.grad(of_stiffness(frequency)),
    "a motion": of_stiffness(motion),
    "its gradient, forward": jax.jacfwd(of_stiffness(motion)),
    "a comfort value": of_stiffness(comfort),
    "gradient of a comfort value": jax.grad(of_stiffness(comfort)),
    "frequency of an engine on bushings": lambda k: frequency(
        jb.replace(jb.presets.engine_on_mounts(), {"*.mass": k})
    ),
}


def operations(jaxpr) -> int:
    """The number of operations of a program and of those inside it."""
    count = 0
    for equation in getattr(jaxpr, "jaxpr", jaxpr).eqns:
        inside = [
            x
            for x in jax.tree.leaves(list(equation.params.values()), is_leaf=is_program)
            if is_program(x)
        ]
        count += sum(map(operations, inside)) if inside else 1
    return count


def is_program(x) -> bool:
    return hasattr(getattr(x, "jaxpr", x), "eqns")


if __name__ == "__main__":
    print(f"jax {jax.__version__}")
    for name, function in PROGRAMS.items():
        print(f"{name:36s} {operations(jax.make_jaxpr(function)(jnp.asarray(2e4))):6d}")
