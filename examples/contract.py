"""From a model to its motion, and from a measured motion back to the model: a plate on three springs under a base that moves."""

import jax
import jax.numpy as jnp
import optax
import jaxbody as jb

jax.config.update("jax_enable_x64", True)
l, m, g = 0.7, 3.0, 9.81
k, kt = m * g / l, 120.0
L, s = 2 * 2**0.5 * l, l * 2**0.5 / 2

model = jb.Model(
    bodies={"plate": jb.Body(mass=m, inertia=[0.3, 0.9, 1.2])},      # about the centre of mass, body axes
    supports={"base": jb.Support(position=[0, -4 * l, 0])},          # its motion is imposed
    elements={
        "AB": jb.Spring(("plate", [-3 * l, l, 0]), ("base", [-5 * l, 7 * l, 0]), stiffness=k, free_length=L - s, damping=1.0),
        "CD": jb.Spring(("plate", [3 * l, l, 0]), ("base", [5 * l, 7 * l, 0]), stiffness=k, free_length=L - s, damping=1.0),
        "EF": jb.Spring(("plate", [0, -l, 0]), ("base", [0, l, 0]), stiffness=kt, free_length=2 * l, damping=1.0),
    },
    joints={},                                                        # a body without one is free; {"arm": jb.Hinge("base", axis=...)}
    gravity=[0, -g, 0],
)

eq = jb.equilibrium(model)                        # .state .residual .stable .status, .elongations by name
lin = jb.linearize(model, eq)                     # .M .C .K .M_tilde .C_tilde .K_tilde, .K_bb ...; .K_elastic .K_geometric .K_gravity
xi = jnp.array([0.01, 0, 0, 0, 0, 0.02])
force = lin.K_tilde @ xi                          # the paper's (79); jb.excitation(model, eq, {"base": xi}) is the exact one
modes = jb.modes(lin)                             # .frequency [Hz] .shapes .damping_ratio
print(eq, lin, modes)                             # small tables with names and units
print("force [N, N m]", force, "and exactly", jb.excitation(model, eq, {"base": xi}), sep="\n")

times = jnp.linspace(0.0, 5.0, 501)
motion = {"base": jb.Harmonic(frequency=0.8, translation=[0.01, 0, 0], rotation=[0, 0, 0.02])}
trajectory = jb.simulate(model, times, motion=motion, initial=eq.state)       # .state .poses .elongations .forces .energies, by name

sensors = {"corner": jb.Position("plate", [3 * l, l, 0])}
measured = jb.measure(trajectory, sensors, noise=1e-4, key=jax.random.key(0))
run = jb.Experiment(times, motion=motion, initial=eq.state, sensors=sensors, measured=measured)
guess = jb.replace(model, {"*.stiffness": 1.3 * k})
fit = jb.fit(guess, {"run1": run}, free=["*.stiffness"], method=optax.lbfgs())   # or method="least_squares"
print(fit)                                        # estimates, standard errors, what could not be told

first = lambda mod: jb.modes(jb.linearize(mod, jb.equilibrium(mod))).frequency[0]
slope = jb.jit(jax.grad(first))(model)            # a model of derivatives: slope["AB"].stiffness, slope["plate"].mass
several = jb.jit(jax.vmap(lambda kk: first(jb.replace(model, {"*.stiffness": kk}))))(k * jnp.linspace(0.8, 1.2, 5))
print("slope of the first frequency", slope["AB"].stiffness, "Hz per N/m,", slope["plate"].mass, "Hz per kg")
print("first frequency for five stiffnesses", several, "Hz")
