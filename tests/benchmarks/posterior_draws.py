"""Draws a minute from the posterior of a car's two stiffnesses, beside NUTS of numpyro with the
same log density: `python tests/benchmarks/posterior_draws.py`.

Both get the density in the coordinates z of `jaxbody.posterior`, so that only the samplers differ,
and 4 chains of 500 draws in one batch. Times include compiling, and are given again without it."""

import time

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from numpyro.infer import MCMC, NUTS

import jaxbody as jb
from jaxbody.fitting import LogNormal, posterior
from jaxbody.fitting.posteriors import diagnosed, prepared

jax.config.update("jax_enable_x64", True)
FREE = ("suspension.stiffness", "tyre.stiffness")
CHAINS, DRAWS, WARMUP = 4, 500, 300


def fitted() -> tuple[jb.fitting.Fit, dict]:
    """Return the fit of a quarter car over a step of the road, read at both masses, and
    priors."""
    car = jb.presets.quarter_car()
    support = car.layout.supports[0]
    times = jnp.linspace(0, 0.8, 41)
    ramp = jnp.clip(times / 0.1, 0, 1)
    rise = ramp**2 * (3 - 2 * ramp)
    road = jb.Sampled(times, translation=jnp.stack([0 * rise, 0 * rise, 0.02 * rise], 1))
    sensors = {body: jb.Position(body, axis=[0, 0, 1]) for body in car.layout.bodies}
    start = jb.equilibrium(car).state
    motion = jb.simulate(car, times, motion={support: road}, initial=start)
    measured = jb.measure(motion, sensors, noise=5e-4, key=jax.random.key(0))
    run = jb.Experiment(
        times, motion={support: road}, sensors=sensors, measured=measured, noise=5e-4
    )
    priors = {"suspension.stiffness": LogNormal(35e3, 0.3), "tyre.stiffness": LogNormal(2e5, 0.3)}
    steps = {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 0.01}
    return jb.fit(car, {"run": run}, free=FREE, solver=diffrax.Tsit5(), **steps), priors


def of_jaxbody(fit, priors):
    return posterior(fit, priors=priors, draws=DRAWS, chains=CHAINS, warmup=WARMUP).y


def of_numpyro(fit, priors):
    density, (center, L) = prepared(fit, priors)
    sampler = MCMC(
        NUTS(potential_fn=lambda z: -density(center + L @ z)),
        num_warmup=WARMUP,
        num_samples=DRAWS,
        num_chains=CHAINS,
        chain_method="vectorized",
        progress_bar=False,
    )
    sampler.run(jax.random.key(1), init_params=jax.random.normal(jax.random.key(2), (CHAINS, 2)))
    return np.asarray(center + sampler.get_samples(group_by_chain=True) @ L.T)


def main() -> None:
    fit, priors = fitted()
    for name, draw in (("jaxbody", of_jaxbody), ("numpyro", of_numpyro)):
        for times in ("with compiling", "again"):
            start = time.perf_counter()
            y = draw(fit, priors)
            minutes = (time.perf_counter() - start) / 60
            _, bulk, _ = diagnosed(y)
            print(
                f"{name}, {times}: {60 * minutes:.0f} s, {CHAINS * DRAWS / minutes:.0f} draws and "
                f"{bulk.min() / minutes:.0f} effective a minute; mean u {y.mean((0, 1))}, "
                f"deviation {y.std((0, 1))}",
                flush=True,
            )


if __name__ == "__main__":
    main()
