"""Two coupled gliders on an air track: a measured record back to stiffnesses, a mass ratio, damping and rest positions.

Data: M. Schmidt and H. Lipson, Science 324 (2009) 81. Each glider's position was tracked from its own zero, in tracker units, for
16.5 s. What such a record cannot tell is the masses themselves: all of them and all forces may be multiplied by one number.
"""

import os
import pathlib
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import optax

import jaxbody as jb

jax.config.update("jax_enable_x64", True)

shared = pathlib.Path(os.environ.get("JAXBODY_DATA", pathlib.Path(__file__).parents[2] / "shared" / "data"))
_, time, x1, x2, v1, v2 = np.loadtxt(shared / "gliders" / "real_double_linear_h_1.txt", comments="%").T


def peak(x):
    """The frequency [Hz] at which a record's spectrum is largest, to a fraction of its resolution."""
    n = 16 * len(x)
    spectrum = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)), n))
    return np.argmax(spectrum) / n * (len(time) - 1) / (time[-1] - time[0])


slow, fast = sorted((peak(x1 + x2), peak(x1 - x2)))
outer = (2 * np.pi * slow) ** 2  # were both masses 1 and the outer springs alike, these would be the stiffnesses
inner = ((2 * np.pi * fast) ** 2 - outer) / 2
span = 1000.0  # length of a relaxed spring, in tracker units; any number well above the motion does
rest1, rest2 = x1.mean(), span + x2.mean()  # where the gliders rest, about: glider 2 has its own zero, one span to the right
along = {"axis": [1, 0, 0]}
model = jb.Model(
    bodies={
        "glider1": jb.Body(mass=1.0, inertia=[1, 1, 1]),
        "glider2": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[span, 0, 0]),
    },
    joints={"glider1": jb.Guide("world", **along), "glider2": jb.Guide("world", **along)},
    elements={
        "left": jb.Spring(("world", [rest1 - span, 0, 0]), ("glider1", [0, 0, 0]), stiffness=outer, free_length=span, damping=0.1),
        "middle": jb.Spring(("glider1", [0, 0, 0]), ("glider2", [0, 0, 0]), stiffness=inner, free_length=rest2 - rest1),
        "right": jb.Spring(("glider2", [0, 0, 0]), ("world", [rest2 + span, 0, 0]), stiffness=outer, free_length=span, damping=0.1),
    },
)

track = jb.Experiment(
    time,
    initial=jb.State(q=jnp.array([x1[0], x2[0]]), v=jnp.array([v1[0], v2[0]])),
    sensors={"x1": jb.Position("glider1", **along), "x2": jb.Position("glider2", [-span, 0, 0], **along)},
    measured={"x1": x1, "x2": x2},
)
shape = ["*.stiffness", "left.damping", "right.damping", "glider2.mass", "left.free_length", "right.free_length", "track.initial.*"]


def main() -> tuple[jb.Fit, jb.Fit]:
    fit = jb.fit(model, {"track": track}, free=shape, method=optax.lbfgs())
    print(fit)
    print()
    print("and with the masses free as well:")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)  # it says what it cannot tell; here we read it from the result
        loose = jb.fit(fit.model, {"track": fit.experiments["track"]}, free=[*shape, "glider1.mass"])
    print(loose.report())
    return fit, loose


if __name__ == "__main__":
    fit, loose = main()
    print(jb.modes(jb.linearize(fit.model, jb.equilibrium(fit.model))))
    for name, x in (("x1", x1), ("x2", x2)):
        share = np.sqrt(np.mean((np.asarray(fit.predicted["track"][name]) - x) ** 2)) / np.std(x)
        print(f"{name}: residual {100 * share:.2f} % of the signal")
