# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # A spring learned by a network
#
# A mass on an unknown spring is released from several places and filmed. Can a neural network learn
# the spring's force from the motion alone, without ever seeing a force?
#
# The network is the law of a spring in a model, and the gradient of the loss,
# $\sum (x(t) - x_{measured})^2$, goes through the simulation.

# %%
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import optax

import jaxbody as jb

jax.config.update("jax_enable_x64", True)

# %% [markdown]
# A law of one's own is a class with a force. Energies, stiffness and derivatives follow.


# %%
class Network(jb.laws.Law):
    net: eqx.nn.MLP

    def force(self, x):
        return 5.0 * self.net(10.0 * x)  # newtons, of meters


def model_of(law):
    spring = jb.SpringDamper(
        ("mass", [0, 0, 0]), ("world", [9, 0, 0]), spring=law, damper=0.1, free_length=9.0
    )
    return jb.Model(
        bodies={"mass": jb.Body(1.0, [1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
        elements={"s": spring},
    )


# %% [markdown]
# The truth is a spring that snaps between two positions. Its mass is released from 24 places and
# filmed for 0.4 s, with 1 mm of noise.

# %%
true_law = jb.laws.Polynomial([-20.0, 20.0, 500.0])
times, releases = jnp.linspace(0.0, 0.4, 11), jnp.linspace(-0.36, 0.36, 24)
steps = {
    "solver": diffrax.Tsit5(),
    "stepsize_controller": diffrax.ConstantStepSize(),
    "dt0": 0.04,
    "max_steps": 100,
}


def positions(model):  # (release, time) [m]
    return jax.vmap(
        lambda x: jb.simulate(
            model, times, initial=jb.State(x[None], jnp.zeros(1)), **steps
        ).state.q[:, 0]
    )(releases)


measured = positions(model_of(true_law)) + 1e-3 * jax.random.normal(jax.random.key(0), (24, 11))

# %% [markdown]
# The loop is your own, with an optimizer of optax: a law is a pytree, like every part of a model.

# %%
untrained = Network(
    eqx.nn.MLP("scalar", "scalar", 16, 2, activation=jax.nn.tanh, key=jax.random.key(1))
)
optimizer = optax.adam(optax.cosine_decay_schedule(5e-2, 500))


@eqx.filter_jit
def step(law, state):
    loss, slopes = eqx.filter_value_and_grad(
        lambda law: jnp.mean((positions(model_of(law)) - measured) ** 2)
    )(law)
    updates, state = optimizer.update(slopes, state)
    return eqx.apply_updates(law, updates), state, loss


law, state = untrained, optimizer.init(eqx.filter(untrained, eqx.is_inexact_array))
for i in range(500):
    law, state, loss = step(law, state)
    if i % 100 == 0 or i == 499:
        print(f"step {i:3}: rms error {1e3 * float(loss) ** 0.5:6.2f} mm")

# %%
x, longer = jnp.linspace(-0.34, 0.34, 121), jnp.linspace(0.0, 4.0, 201)
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
laws = (
    ("truth", true_law, "0.75", 6),
    ("network, trained", law, "C1", 2),
    ("network, untrained", untrained, "C0", 1),
)
for name, each, color, width in laws:
    left.plot(1e3 * x, jax.vmap(each.force)(x), color, lw=width, label=name)
    motion = jb.simulate(model_of(each), longer, initial=jb.State(jnp.array([-0.28]), jnp.zeros(1)))
    right.plot(longer, 1e3 * motion.state.q[:, 0], color, lw=width)
left.set(xlabel="elongation [mm]", ylabel="force [N]", title="The force, never measured")
left.legend(frameon=False)
right.axvline(0.4, color="0.3", lw=1, ls="--")
right.set(
    xlabel="time [s]",
    ylabel="position [mm]",
    title="A motion ten times longer than those seen",
    xlim=(0, 4),
    ylim=(-400, 400),
)

# %%
true, learned = jax.vmap(true_law.force)(x), jax.vmap(law.force)(x)
error = float(jnp.sqrt(jnp.mean((learned - true) ** 2)) / jnp.max(jnp.abs(true)))
print(f"rms error of the force: {100 * error:.2f} % of the largest")
assert error < 0.02

# %% [markdown]
# Better than two percent, from positions alone. Read on: `magnet_mount.py`, an energy of one's own;
# `pendulum.py`, laws with a formula.
