"""Seconds to choose among 200 places of accelerometers on a full car on a rig, by each criterion;
and to expect the fit of all of them, with and without compiling.

    python tests/benchmarks/choices.py
"""

from time import perf_counter

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

import jaxbody as jb  # noqa: E402
from jaxbody.fitting.planning.criteria import KINDS  # noqa: E402

FREE = ["spring fl.stiffness", "spring rr.stiffness", "spring fl.damping", "car.mass"]


def seconds(call):
    start = perf_counter()
    result = call()
    return perf_counter() - start, result


def main():
    places = [(x, y) for x in np.linspace(-1.8, 1.8, 20) for y in np.linspace(-0.8, 0.8, 10)]
    rig = jb.MeasuredResponse(
        np.geomspace(0.7, 15.0, 30),
        inputs={"road": jb.BaseMotion("road fl", "z")},
        outputs={
            f"at {100 * x:.0f} {100 * y:.0f}": jb.Acceleration("car", [x, y, 0.0], axis="z")
            for x, y in places
        },
        noise=1.0,
    )
    car = jb.presets.full_car()
    first, fit = seconds(lambda: jb.expected_fit(car, {"rig": rig}, free=FREE))
    again, _ = seconds(lambda: jb.expected_fit(car, {"rig": rig}, free=FREE))
    print(f"expected_fit of 200 sensors: {first:.1f} s with compiling, {again:.2f} s without")
    for kind in KINDS:
        took, choice = seconds(lambda kind=kind: jb.choose(fit, n=6, criterion=kind))
        print(f"choose 6 by {kind}: {took:.1f} s, at least {100 * choice.efficiency:.1f} %")


if __name__ == "__main__":
    main()
