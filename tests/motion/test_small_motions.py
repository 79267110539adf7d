"""Models without extent, one body on springs of zero length: motions of 1 m, 1 nm, 1 pm and 1 fm
are equally accurate, by closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

M, K, ZETA = 1e-12, 1e-3, 0.05
W = np.sqrt(K / M)
WD, C = W * np.sqrt(1 - ZETA**2), 2 * ZETA * np.sqrt(K * M)
TIMES = np.linspace(0, 6 * np.pi / W, 61)
DECAY = np.exp(-ZETA * W * TIMES)
FREE = DECAY * (np.cos(WD * TIMES) + ZETA * W / WD * np.sin(WD * TIMES))
PUSH = DECAY * W / WD * np.sin(WD * TIMES)


def shaken():
    """m x'' + c x' + k x = k sin(w t/2) + c w/2 cos(w t/2), from rest."""
    half = W / 2
    X = -1j * (K + 1j * half * C) / (K - M * half**2 + 1j * half * C)
    s = np.roots([M, C, K])
    a = np.linalg.solve(np.stack([np.ones(2), s]), [-X.real, -(1j * half * X).real])
    return (X * np.exp(1j * half * TIMES)).real + (a @ np.exp(s[:, None] * TIMES)).real


CASES = {
    "start": (lambda a: {"initial": jb.State(q=jnp.array([a]), v=jnp.zeros(1))}, FREE),
    "speed": (lambda a: {"initial": jb.State(q=jnp.zeros(1), v=jnp.array([a * W]))}, PUSH),
    "gravity": (lambda a: {"gravity": [a * W**2, 0, 0]}, 1 - FREE),
    "load": (lambda a: {"loads": {"f": jb.Force("m", force=[K * a, 0, 0])}}, 1 - FREE),
    "base": (
        lambda a: {
            "motion": {
                "b": jb.Harmonic(
                    frequency=W / 4 / np.pi, translation=[a, 0, 0], translation_phase=-np.pi / 2
                )
            }
        },
        shaken(),
    ),
}


def run(gravity=(0, 0, 0), **options):
    model = jb.Model(
        bodies={"m": jb.Body(M)},
        supports={"b": jb.Support()},
        joints={"m": jb.Guide("world", axis="x")},
        elements={
            "s": jb.Bushing(("m", [0, 0, 0]), ("b", [0, 0, 0]), stiffness=[K] * 3, damping=[C] * 3)
        },
        gravity=gravity,
    )
    return jb.simulate(model, TIMES, **options)


@pytest.mark.parametrize("case", CASES)
def test_small_motions_are_as_accurate_as_large_ones(case):
    inputs, exact = CASES[case]
    steps = []
    for size in (1.0, 1e-9, 1e-12, 1e-15):
        motion = run(**inputs(size))
        np.testing.assert_allclose(motion.state.q[:, 0] / size, exact, rtol=0, atol=5e-8)
        steps.append(int(motion.statistics["num_accepted_steps"]))
    assert max(steps) - min(steps) <= 1


def test_a_body_at_rest_stays_so_in_few_steps():
    motion = run()
    assert motion.ok and motion.statistics["num_accepted_steps"] < 10 and not np.any(motion.state.q)
