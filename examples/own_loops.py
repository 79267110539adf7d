# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # An optimizer and a sampler of one's own
#
# A model is a pytree, and a motion is a function of it with derivatives, so any loop that takes
# JAX's gradients takes jaxbody: here one of optax that finds two parameters of a suspension, and
# NUTS of blackjax that draws from their posterior. Are the error bars of the curvature at the
# optimum, which `jb.fit` states too, those of the draws?

# %%
import blackjax
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import optax

import jaxbody as jb

jax.config.update("jax_enable_x64", True)

# A quarter of a car on a wavy road for a second; the heave of its body is recorded with a noise
# of 0.3 mm.
PATHS, NOISE = ("suspension.stiffness", "suspension.damping"), 3e-4
car = jb.presets.quarter_car(stiffness=35e3, damping=1500.0)
times, road, rest = (
    jnp.linspace(0, 1, 51),
    {"road": jb.Harmonic(frequency=1.5, translation=[0, 0, 0.01])},
    jb.equilibrium(car).state,
)


def heave(logarithms):
    model = jb.replace(car, dict(zip(PATHS, jnp.exp(logarithms), strict=True)))
    return jb.simulate(model, times, motion=road, initial=rest).state.q[:, 0]


true = jnp.log(jnp.array([35e3, 1500.0]))
measured = heave(true) + NOISE * np.random.default_rng(4).normal(size=times.shape)


def residuals(logarithms):
    return (heave(logarithms) - measured) / NOISE


def loss(logarithms):
    return jnp.sum(residuals(logarithms) ** 2) / 2


# %% [markdown]
# Positive numbers are free as their logarithms, as in `jb.fit`. One `jb.jit` around the whole loop
# compiles motion and gradient once.

# %%
optimizer = optax.lbfgs()


@jb.jit
def optimized(start):
    def step(carry, _):
        x, memory = carry
        value, slope = optax.value_and_grad_from_state(loss)(x, state=memory)
        change, memory = optimizer.update(slope, memory, x, value=value, grad=slope, value_fn=loss)
        return (optax.apply_updates(x, change), memory), value

    (x, _), values = jax.lax.scan(step, (start, optimizer.init(start)), length=20)
    return x, values, jnp.linalg.inv((J := jax.jacfwd(residuals)(x)).T @ J)


best, values, covariance = optimized(jnp.log(jnp.array([20e3, 2500.0])))
print(
    dict(zip(PATHS, np.exp(best).round(1).tolist(), strict=True)),
    f"loss {values[-1]:.1f} of {len(times)} samples",
)

# %% [markdown]
# NUTS starts where the optimizer ended, with the covariance there as its inverse mass matrix, so it
# needs no warm-up. A sampler's own default start, such as 1 N/m, would spend it far from any motion
# that resembles the record.

# %%
nuts = blackjax.nuts(lambda x: -loss(x), step_size=0.5, inverse_mass_matrix=covariance)


def draw(state, key):
    state, info = nuts.step(key, state)
    return state, (state.position, info.is_divergent)


draws, divergent = jb.jit(lambda keys: jax.lax.scan(draw, nuts.init(best), keys)[1])(
    jax.random.split(jax.random.key(0), 400)
)
spread, by_curvature = draws.std(0), jnp.sqrt(jnp.diag(covariance))
print(f"standard deviations: {spread} drawn, {by_curvature} by curvature")
assert (
    np.all(np.abs(spread / by_curvature - 1) < 0.15)
    and np.all(np.abs(best - true) < 4 * by_curvature)
    and not divergent.any()
)
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
left.semilogy(values)
left.set(xlabel="step of L-BFGS", ylabel="loss", title="An optax loop")
circle = np.linalg.cholesky(covariance) @ np.array(
    [np.cos(t := np.linspace(0, 2 * np.pi, 100)), np.sin(t)]
)
right.plot(*np.exp(draws).T, ".", ms=3, color="0.6", label="400 draws of NUTS")
right.plot(*np.exp(best[:, None] + 2 * circle), lw=1.2, label="2 standard errors by curvature")
right.plot(*np.exp(true), "k+", ms=10, label="true")
right.set(xlabel="stiffness [N/m]", ylabel="damping [N s/m]", title="What the record says of both")
right.legend(frameon=False)

# %% [markdown]
# The loss ends at half the number of samples, as noise alone would have it, and the draws fill the
# ellipse of the curvature: here the intervals of `jb.fit` are those of the posterior. Read on: *For
# users of JAX* in the manual; `pendulum.py`, a record of a real machine.
