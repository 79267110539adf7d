"""A linear problem with an exact posterior: numbers y = a + b t with normal noise and normal priors
of a and b (REFERENCES2 D6), as a measurement without mechanics."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb
from jaxbody.fitting.experiments.measurements import Measurement, NumberChannel

TIMES = np.arange(0, 3, 0.25)
Y = np.array([0.12, 0.55, 0.31, 0.98, 1.02, 0.84, 1.61, 1.33, 2.05, 1.79, 2.34, 2.21])
SIGMA, DEVIATIONS = 0.3, np.array([2.0, 1.0])
FREE = ("run.line.a", "run.line.b")
PRIORS = dict(zip(FREE, ((0.0, 2.0), (0.0, 1.0)), strict=True))
X = np.stack([np.ones(12), TIMES], 1)
C = np.linalg.inv(X.T @ X / SIGMA**2 + np.diag(DEVIATIONS**-2))
MEAN = C @ X.T @ Y / SIGMA**2
CORRELATION = C[0, 1] / np.sqrt(C[0, 0] * C[1, 1])
LOG_EVIDENCE = -5.323384578
MODEL = jb.Model(
    bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
    joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
)


class Coefficients(eqx.Module):
    a: jax.Array = jb.field("m")
    b: jax.Array = jb.field("m/s")


class Line(Measurement):
    """y = a + b t at TIMES."""

    line: Coefficients
    measured: dict[str, Any]
    noise: dict[str, Any] | None

    @property
    def channels(self):
        return {"y": NumberChannel(unit="m")}

    def named(self):
        return {"line": self.line}

    def readings(self, model, integration, lin):
        return {"y": self.line.a + self.line.b * jnp.asarray(TIMES)}

    def axis(self, channel):
        return "time", TIMES, "s"

    def place(self, row):
        return f"t = {TIMES[row]:g} s", TIMES[row]


def line(y=Y, noise: float | None = SIGMA):
    noises = None if noise is None else {"y": jnp.asarray(noise)}
    coefficients = Coefficients(jnp.asarray(0.1), jnp.asarray(1.0))
    return {"run": Line(coefficients, {"y": jnp.asarray(y)}, noises)}


def fitted(priors=PRIORS, **options):
    return jb.fit(MODEL, line(**options), free=FREE, priors=priors)
