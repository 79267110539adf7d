"""A sensor of your own: the distance between two bodies, with the gain, bias, delay and lag that
every sensor has."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)


class Distance(jb.sensors.Sensor):
    """The distance between the reference points of the body that it is `on` and of another."""

    on: str = eqx.field(static=True)
    other: str = eqx.field(static=True)
    shape, unit = (), "m"

    def __init__(self, on, other, **chain):
        self.other = other
        super().__init__(on, **chain)

    def reading(self, model, frames):
        here, there = (frames.p[model.layout.frame(name)] for name in (self.on, self.other))
        return jnp.linalg.norm(here - there)


k, m = 200.0, 1.0
model = jb.Model(
    bodies={
        "left": jb.Body(mass=m, inertia=[1, 1, 1]),
        "right": jb.Body(mass=m, inertia=[1, 1, 1], position=[1, 0, 0]),
    },
    joints={name: jb.Guide("world", axis=[1, 0, 0]) for name in ("left", "right")},
    elements={
        "spring": jb.Spring(("left", [0, 0, 0]), ("right", [0, 0, 0]), stiffness=k, free_length=1.0)
    },
)
pushed = jb.State(q=jnp.array([-0.05, 0.05]), v=jnp.zeros(2))
times = np.linspace(0.0, 1.0, 101)
trajectory = jb.simulate(model, times, initial=pushed)

# Two equal masses: distance 1 + 0.1 cos(w t), w^2 = 2 k/m
reading = jb.measure(trajectory, {"gap": Distance("left", "right")})["gap"]
closed = 1 + 0.1 * np.cos(np.sqrt(2 * k / m) * times)
print(f"distance {reading.min():.4f} to {reading.max():.4f} m")
assert np.abs(reading - closed).max() < 1e-6

# Its gain and bias can be fitted together with the model
measured = jb.measure(
    trajectory, {"gap": Distance("left", "right", gain=1.02)}, noise=1e-4, key=jax.random.key(0)
)
run = jb.Experiment(
    times, initial=pushed, sensors={"gap": Distance("left", "right", gain=1.0)}, measured=measured
)
fit = jb.fit(
    jb.replace(model, {"spring.stiffness": 180.0}),
    {"run": run},
    free=["spring.stiffness", "run.gap.gain"],
)
print(fit)
assert abs(float(fit.estimates["run.gap.gain"]) - 1.02) < 4 * float(
    fit.standard_errors["run.gap.gain"]
)
