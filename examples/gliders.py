"""Two coupled gliders on an air track: stiffnesses, a mass ratio, damping and rest positions from a measured record.

Data: M. Schmidt and H. Lipson, Science 324 (2009) 81. Each glider's position was tracked from its own zero, in tracker units, for 16.5 s.
Such a record does not determine the masses themselves: multiplying all masses and all forces by the same number changes no motion. A
second fit uses the first 11 s only and predicts the rest.

To save the figure, give a file name: python examples/gliders.py gliders.png
"""

import os
import pathlib
import sys
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import optax

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
if __name__ == "__main__":  # the process is this script's
    jb.fast_loops()

shared = pathlib.Path(os.environ.get("JAXBODY_DATA", pathlib.Path(__file__).parents[2] / "shared" / "data"))
record = jb.read_record(
    shared / "gliders" / "real_double_linear_h_1.txt",
    time=(1, "s"),
    channels={"x1": (2, "1"), "x2": (3, "1"), "v1": (4, "1/s"), "v2": (5, "1/s")},  # velocities: the authors' numerical derivatives
)
time, x1, x2, v1, v2 = record.times, *record.channels.values()
FITTED = 11.0  # s


def peak(x):
    """The frequency [Hz] at which a record's spectrum is largest, refined by zero padding."""
    n = 16 * len(x)
    spectrum = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)), n))
    return np.argmax(spectrum) / n * (len(time) - 1) / (time[-1] - time[0])


slow, fast = sorted((peak(x1 + x2), peak(x1 - x2)))
outer = (2 * np.pi * slow) ** 2  # initial guess of the stiffnesses, for two masses of 1 and equal outer springs
inner = ((2 * np.pi * fast) ** 2 - outer) / 2
span = 1000.0  # free length of a spring, in tracker units; any value well above the motion gives the same fit
rest1, rest2 = x1.mean(), span + x2.mean()  # approximate rest positions; glider 2 has its own zero, one span to the right
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

sensors = {"x1": jb.Position("glider1", **along), "x2": jb.Position("glider2", [-span, 0, 0], **along)}


def run_of(part: jb.Record) -> jb.Experiment:
    x, v = (jnp.array([part[name][0] for name in names]) for names in (("x1", "x2"), ("v1", "v2")))
    measured = {name: part[name] for name in sensors}
    return jb.Experiment(part.times, initial=jb.State(q=x, v=v), sensors=sensors, measured=measured)


track = run_of(record)
shape = ["*.stiffness", "left.damping", "right.damping", "glider2.mass", "left.free_length", "right.free_length", "track.initial.*"]


def main() -> tuple[jb.Fit, jb.Fit]:
    fit = jb.fit(model, {"track": track}, free=shape, method=optax.lbfgs())
    print(fit)
    print()
    print("and with the masses free as well:")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)  # the masses are not determined; the report says so
        loose = jb.fit(fit.model, {"track": fit.experiments["track"]}, free=[*shape, "glider1.mass"])
    print(loose.report())
    return fit, loose


def share(error, x) -> float:
    """The rms error in percent of the signal's standard deviation."""
    return 100 * float(np.sqrt(np.mean(np.square(error))) / np.std(x))


def predict() -> tuple[jb.Fit, dict[str, np.ndarray]]:
    """A fit to the first 11 s and its prediction of the whole record."""
    fit = jb.fit(model, {"track": run_of(record.part(0, FITTED))}, free=shape)
    trajectory = jb.simulate(fit.model, time, initial=fit.experiments["track"].initial, rtol=1e-8)
    return fit, {name: np.asarray(x) for name, x in jb.measure(trajectory, sensors).items()}


def draw(x: dict[str, np.ndarray], file: str) -> None:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, sharex=True, figsize=(8, 5.5), layout="constrained")
    for ax, name in zip(axes, x, strict=False):
        ax.plot(time, record[name], ".", ms=3, color="0.4", label="measured")
        ax.plot(time, x[name], lw=1, label="fitted, then predicted")
        ax.set_ylabel(f"{name} [tracker units]")
        axes[2].plot(time, x[name] - record[name], lw=1, label=name)
    axes[2].set(xlabel="time [s]", ylabel="error")
    for ax, where in ((axes[0], {"loc": "lower center", "bbox_to_anchor": (0.5, 1)}), (axes[2], {"loc": "lower left"})):
        ax.legend(ncols=2, frameon=False, **where)
    for ax in axes:
        ax.axvspan(FITTED, time[-1], color="0.93", zorder=-1)
        ax.grid(alpha=0.3)
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    print(record)
    fit, loose = main()
    modes = jb.modes(jb.linearize(fit.model, jb.equilibrium(fit.model)))
    print(modes)
    part, x = predict()
    print(f"\nfitted up to {FITTED:g} s:", part, sep="\n")
    print(f"\n{'residual [% of the signal]':28} whole  fitted  held out")
    later = time > FITTED
    for name in sensors:
        whole = share(fit.predicted["track"][name] - record[name], record[name])
        shares = [share((x[name] - record[name])[rows], record[name][rows]) for rows in (~later, later)]
        print(f"{name:28} {whole:5.2f}  {shares[0]:6.2f}  {shares[1]:8.2f}")
        assert whole < 1.25 and shares[1] < 4
    if len(sys.argv) > 1:
        draw(x, sys.argv[1])
    assert abs(float(fit.model["glider2"].mass) - 2.48) < 0.01  # other fits of this record give this and 0.3346, 1.7137 Hz
    np.testing.assert_allclose(modes.frequency, [0.3346, 1.7137], rtol=2e-3)
