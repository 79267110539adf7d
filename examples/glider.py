"""One glider on an air track between two springs: fit stiffness and friction to half of a free
decay and predict the other half.

Data: M. Schmidt and H. Lipson, Science 324 (2009) 81; positions in tracker units, rounded to
integers, every 33 or 34 ms. The record determines only the ratios of forces to mass, so the mass is
set to 1. With the stiffness k of both springs together and the rest position x0,

    x'' + c x' + k (x - x0) = 0

A free decay has the closed form x0 + A exp(-c t/2) cos(w t + p), w^2 = k - c^2/4. SciPy's fit of
this formula to the same samples is the reference.

To save the figure, give a file name: python examples/glider.py glider.png
"""

import os
import pathlib
import sys

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import curve_fit

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
shared = pathlib.Path(
    os.environ.get("JAXBODY_DATA", pathlib.Path(__file__).parents[2] / "shared" / "data")
)
record = jb.read_record(
    shared / "gliders" / "real_linear_h_1.txt",
    time=(1, "s"),
    channels={"x": (2, "1"), "v": (3, "1/s")},
)  # the velocities are numerical derivatives by the authors, used as initial guesses
HALF, span = 14.5, 1000.0
steps = {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 0.1}
along = {"axis": [1, 0, 0]}


def track() -> jb.Model:
    """The glider on its guide; one spring replaces both springs."""
    start = {"stiffness": 10.0, "free_length": span, "damping": 0.1}
    return jb.Model(
        bodies={"glider": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"glider": jb.Guide("world", **along)},
        elements={"spring": jb.Spring(("world", [-span, 0, 0]), ("glider", [0, 0, 0]), **start)},
    )


def run_of(part: jb.Record, start: jb.State | None = None) -> jb.Experiment:
    start = start or jb.State(q=jnp.asarray(part["x"][:1]), v=jnp.asarray(part["v"][:1]))
    return jb.Experiment(
        part.times,
        initial=start,
        sensors={"x": jb.Position("glider", **along)},
        measured={"x": part["x"]},
    )


def decay(t, x0, A, c, w, p):
    return x0 + A * np.exp(-c * t / 2) * np.cos(w * t + p)


def closed_form(part: jb.Record) -> dict[str, np.ndarray]:
    """Estimates and standard errors of the closed form by SciPy; the spectrum gives the initial
    guess of w."""
    t, x = part.times - part.times[0], part["x"]
    spectrum = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)), 16 * len(x)))
    w = 2 * np.pi * np.argmax(spectrum) / (16 * len(x)) * part.sampling.rate
    p, C = curve_fit(decay, t, x, [x.mean(), np.ptp(x) / 2, 0.1, w, np.pi], xtol=1e-14, ftol=1e-14)
    k = p[3] ** 2 + p[2] ** 2 / 4
    return {
        "stiffness": [k, 2 * p[3] * np.sqrt(C[3, 3])],
        "damping": [p[2], np.sqrt(C[2, 2])],
        "rest": [p[0], np.sqrt(C[0, 0])],
    }


def share(error: np.ndarray, x: np.ndarray) -> float:
    """The rms error in percent of the signal's standard deviation."""
    return 100 * float(np.sqrt(np.mean(error**2)) / np.std(x))


def draw(x: np.ndarray, file: str) -> None:
    import matplotlib.pyplot as plt

    figure, (above, below) = plt.subplots(2, sharex=True, figsize=(8, 4.5), layout="constrained")
    above.plot(record.times, record["x"], ".", ms=3, color="0.4", label="measured")
    above.plot(record.times, x, lw=1, label="fitted, then predicted")
    above.set_ylabel("position [tracker units]")
    above.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=2, frameon=False)
    below.plot(record.times, x - record["x"], lw=1, color="C3")
    below.set(xlabel="time [s]", ylabel="error [tracker units]")
    for ax in (above, below):
        ax.axvspan(HALF, record.times[-1], color="0.93", zorder=-1)
        ax.grid(alpha=0.3)
    figure.savefig(file, dpi=110)


print(record)
half = record.part(0, HALF)
fit = jb.fit(
    track(),
    {"run": run_of(half)},
    free=["spring.stiffness", "spring.damping", "spring.free_length", "run.initial.*"],
    **steps,
)
print(fit)
trajectory = jb.simulate(fit.model, record.times, initial=fit.experiments["run"].initial, **steps)
x, after = np.asarray(trajectory.state.q[:, 0]), record.times > HALF
error = x - record["x"]
shares = share(error[~after], record["x"][~after]), share(error[after], record["x"][after])
# the second half starts from the simulated state at the end of the first half
rest = np.argmax(after)
print(
    jb.validate(
        fit,
        {
            "rest": run_of(
                record.part(record.times[rest], 100),
                jb.State(trajectory.state.q[rest], trajectory.state.v[rest]),
            )
        },
    )
)
print(
    f"\nresidual {shares[0]:.2f} % of the signal in the fitted half, {shares[1]:.2f} % "
    "in the half held out"
)
paths = {"stiffness": "spring.stiffness", "damping": "spring.damping", "rest": "spring.free_length"}
assert share(error, record["x"]) < 0.68  # a free decay fitted to the whole record leaves 0.62 %
print("\nclosed form fitted to the same samples by SciPy:")
for name, (value, spread) in closed_form(half).items():
    estimate = float(fit.estimates[paths[name]]) - (span if name == "rest" else 0)
    print(f"  {name:10} {value:.6g} +- {spread:.2g}; jaxbody {estimate:.6g}")
    assert abs(estimate - value) < 0.05 * spread
if len(sys.argv) > 1:
    draw(x, sys.argv[1])
