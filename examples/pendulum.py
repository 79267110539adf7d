"""A pendulum on a hinge with friction: fit the law of its damper to half of a measured swing and predict the other half.

Data: M. Schmidt and H. Lipson, Science 324 (2009) 81: the angle, tracked every sixth of a time unit, with some samples missing. The
source does not define the time unit; here it is taken as one second. The record determines only the ratios of moments to inertia, so the
inertia about the hinge is set to 1:

    x'' + a sin(x) + M(x') = 0

Two friction laws M are compared: viscous and dry, c w + F w/sqrt(w^2 + w0^2) with w0 = 0.05 fixed, and progressive, c w + d w|w|. The
residuals are correlated. With the correlation included, the intervals of F and of d contain zero: viscous friction explains the record,
and dry friction is at most half a percent of a. (Standard errors for white noise would be nearly four times smaller and would make F
significantly negative, which is physically impossible.)

Independently of any fit, the period T between upward crossings and the amplitude A give a by the complete elliptic integral,
T = 4 K(sin(A/2))/sqrt(a).

To save the figure, give a file name: python examples/pendulum.py pendulum.png
"""

import os
import pathlib
import sys
import warnings

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ellipk

import jaxbody as jb
from jaxbody import laws

if __name__ == "__main__":
    jb.fast_loops()
jax.config.update("jax_enable_x64", True)
shared = pathlib.Path(os.environ.get("JAXBODY_DATA", pathlib.Path(__file__).parents[2] / "shared" / "data"))
record = jb.read_record(
    shared / "gliders" / "real_pend_h_1.txt", time=(1, "s"), channels={"angle": (2, "rad"), "rate": (3, "rad/s")}, irregular=True
)
HALF = 52.0
steps = {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 1 / 6}


shape = ["hinge.spring.moment", "swing.angle.bias", "swing.initial.*"]


class Weight(laws.Law):
    """The moment of the pendulum's weight, a sin(x)."""

    moment: jax.Array = jb.field("force")  # N m about the hinge

    def potential(self, x):
        return self.moment * (1 - jnp.cos(x))


class Dry(laws.Law):
    """F w/sqrt(w^2 + w0^2) as in laws.Friction, but F may have either sign, so that its interval can contain zero."""

    level: jax.Array = jb.field("force")

    def force(self, w):
        return self.level * w / jnp.sqrt(w**2 + 0.05**2)


class Progressive(laws.Law):
    """c w + d w |w|."""

    linear: jax.Array = jb.field("force/argument")
    square: jax.Array = jb.field("force/argument^2")

    def force(self, w):
        return self.linear * w + self.square * w * jnp.abs(w)


def pendulum(damper) -> jb.Model:
    """A body on a hinge."""
    about = {"axis": [0, 0, 1]}
    return jb.Model(
        bodies={"rod": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"rod": jb.Hinge("world", **about)},
        elements={"hinge": jb.Torsion("world", "rod", spring=Weight(jnp.array(1.33)), damper=damper, **about)},
    )


def run_of(part: jb.Record, start: jb.State | None = None, bias=0.0) -> jb.Experiment:
    """One part of the record as an experiment; the bias is the unknown zero of the encoder."""
    start = start or jb.State(q=jnp.asarray(part["angle"][:1]), v=jnp.asarray(part["rate"][:1]))
    return jb.Experiment(initial=start, sensors={"angle": jb.JointAngle("rod", bias=bias)}, measured=part)


def fitted(damper, free) -> jb.Fit:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        return jb.fit(
            pendulum(damper), {"swing": run_of(record.part(0, HALF))}, free=[*shape, *(f"hinge.damper.{path}" for path in free)], **steps
        )


def predict(fit: jb.Fit) -> tuple[np.ndarray, jb.State]:
    """The angle over the whole record, simulated from the fitted initial state, and the state at the start of the second half."""
    trajectory = jb.simulate(fit.model, record.times, initial=fit.experiments["swing"].initial, **steps)
    at = np.argmax(record.times > HALF)
    return np.asarray(trajectory.state.q[:, 0] + fit.estimates["swing.angle.bias"]), jb.State(
        trajectory.state.q[at], trajectory.state.v[at]
    )


def nrmse(error: np.ndarray, signal: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)) / np.std(signal))


def draw(x: np.ndarray, file: str) -> None:
    import matplotlib.pyplot as plt

    figure, (above, below) = plt.subplots(2, sharex=True, figsize=(8, 4.5), layout="constrained")
    above.plot(record.times, record["angle"], ".", ms=3, color="0.4", label="measured")
    above.plot(record.times, x, lw=1, label="fitted, then predicted")
    above.set_ylabel("angle [rad]")
    above.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=2, frameon=False)
    below.plot(record.times, x - record["angle"], lw=1, color="C3")
    below.set(xlabel="time", ylabel="error [rad]")
    for ax in (above, below):
        ax.axvspan(HALF, record.times[-1], color="0.93", zorder=-1)
        ax.grid(alpha=0.3)
    figure.savefig(file, dpi=110)


def a_from_periods() -> float:
    """The mean of a over the swings of the second half, from their periods and amplitudes; a parabola through three samples gives each
    peak."""
    t, x = (v[record.times > HALF] for v in (record.times, record["angle"] - np.median(record["angle"])))
    up = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    crossings = t[up] - x[up] * (t[up + 1] - t[up]) / (x[up + 1] - x[up])
    values = []
    for i, j, T in zip(up[:-1], up[1:], np.diff(crossings), strict=True):
        peaks = [k + i for k in (np.argmax(x[i:j]), np.argmin(x[i:j]))]
        heights = [abs(x[k]) + (x[k + 1] - x[k - 1]) ** 2 / (8 * abs(x[k - 1] - 2 * x[k] + x[k + 1])) for k in peaks]
        values.append((4 * ellipk(np.sin(np.mean(heights) / 2) ** 2) / T) ** 2)
    return float(np.mean(values))


dampers = {
    "viscous and dry": (laws.Linear(0.01) + Dry(jnp.array(0.003)), ["terms.0.coefficient", "terms.1.level"]),
    "progressive": (Progressive(jnp.array(0.01), jnp.array(0.01)), ["linear", "square"]),
}
print(record)
fits, errors, after = {}, {}, record.times > HALF
for name, (damper, free) in dampers.items():
    fits[name] = fitted(damper, free)
    x, state = predict(fits[name])
    errors[name] = x - record["angle"]
    rest = run_of(record.part(record.times[after][0], 100), state, fits[name].estimates["swing.angle.bias"])
    print(f"\n{name}:", fits[name], jb.validate(fits[name], {"rest": rest}), sep="\n")
print(f"\n{'residual [% of the signal]':28} fitted  held out")
shares = {name: [nrmse(error[part], record["angle"][part]) for part in (~after, after)] for name, error in errors.items()}
for name, (before, later) in shares.items():
    print(f"{name:28} {100 * before:6.2f}  {100 * later:8.2f}")
best, period = fits["progressive"], a_from_periods()
a = float(best.estimates["hinge.spring.moment"])
print(f"\na = {a:.4f}; from periods and amplitudes of the second half {period:.4f}")
if len(sys.argv) > 1:
    draw(errors["progressive"] + record["angle"], sys.argv[1])
assert abs(a / period - 1) < 0.01 and shares["progressive"][0] < 0.012 and shares["progressive"][1] < 0.035
