"""The example contract.py for bodies in general position: a tilted block, its center of mass off
its origin, and an arm on a hinge of the base."""

import jax
import jax.numpy as jnp
import optax

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
lean = jnp.array([0.966, 0.069, 0.138, 0.207])  # a rotation by 30 degrees about (1, 2, 3)
eyes = {
    "rope1": [0.30, 0.20, 0.10],
    "rope2": [-0.30, 0.22, 0.12],
    "rope3": [-0.28, -0.20, 0.10],
    "rope4": [0.32, -0.22, 0.08],
}
hooks = {
    "rope1": [0.35, 0.45, 1.1],
    "rope2": [-0.50, 0.25, 1.1],
    "rope3": [-0.25, -0.50, 1.1],
    "rope4": [0.60, -0.20, 1.1],
}
k = {"rope1": 500.0, "rope2": 560.0, "rope3": 520.0, "rope4": 600.0}

model = jb.Model(
    bodies={
        "block": jb.Body(
            mass=12.0,
            # Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the center of mass, body axes
            inertia=[0.50, 0.80, 1.10, 0.05, -0.02, 0.03],
            com=[0.05, 0.02, -0.03],
            position=[0.0, 0.0, 0.5],
            orientation=lean / jnp.linalg.norm(lean),
        ),
        "arm": jb.Body(
            mass=2.0, inertia=[0.02, 0.15, 0.16], com=[0.45, 0.0, 0.0], position=[0.8, 0.0, 0.5]
        ),
    },
    supports={"base": jb.Support()},
    elements={
        **{
            name: jb.Spring(
                ("block", eyes[name]),
                ("base", hooks[name]),
                stiffness=k[name],
                free_length=0.5,
                damping=8.0,
            )
            for name in k
        },
        "yoke": jb.Bushing(
            ("block", [0, 0, 0]),
            ("base", [0, 0, 0.5]),
            stiffness=[90.0, 70.0, 0.0],
            damping=[5.0, 5.0, 0.0],
        ),
        "link": jb.Spring(
            ("block", [0.3, 0.0, -0.1]),
            ("arm", [0.5, 0.0, 0.0]),
            stiffness=300.0,
            free_length=0.9,
            damping=2.0,
        ),
        "stay": jb.Spring(
            ("arm", [0.8, 0.0, 0.0]),
            ("base", [1.6, 0.2, 1.1]),
            stiffness=400.0,
            free_length=0.5,
            damping=2.0,
        ),
    },
    # through the arm's origin; the axis moves with the base
    joints={"arm": jb.Hinge("base", axis=[0, 1, 0])},
    gravity=[0, 0, -9.81],
)

eq = jb.equilibrium(model)
lin = jb.linearize(model, eq)
modes = jb.modes(lin)
xi = jnp.array([0.002, -0.001, 0.003, 0.002, 0.001, -0.002])
print(model, eq, modes, sep="\n\n")
print(
    "force to first order:",
    lin.K_tilde @ xi,
    "exact",
    jb.excitation(model, eq, {"base": xi}),
    sep="\n",
)

times = jnp.linspace(0.0, 3.0, 301)
shaking = jb.Harmonic(
    frequency=3.0,
    translation=[0.004, 0.003, 0.005],
    rotation=[0.004, 0.006, 0.003],
    translation_phase=[0.0, 1.0, 2.0],
)
motion = {"base": shaking + jb.Harmonic(frequency=5.0, translation=[0.002, 0.0, 0.003])}
trajectory = jb.simulate(model, times, motion=motion, initial=eq.state)
print(trajectory)

sensors = {
    "corner": jb.Position("block", [0.3, 0.2, 0.1]),
    "pose": jb.sensors.BodyPose("block"),
    "stay": jb.Elongation("stay"),
}
measured = jb.measure(
    trajectory, sensors, noise={"corner": 2e-4, "pose": 2e-4, "stay": 1e-4}, key=jax.random.key(1)
)
run = jb.Experiment(
    times,
    motion=motion,
    initial=eq.state,
    sensors={f"{n} sensor": s for n, s in sensors.items()},
    measured={f"{n} sensor": m for n, m in measured.items()},
)
free = ["rope?.stiffness", "link.stiffness", "stay.stiffness"]
guess = jb.replace(
    model,
    {
        path: 1.1 * value
        for pattern in free
        for path, value in jb.parameter_paths(model, pattern).items()
    },
)
fit = jb.fit(guess, {"run1": run}, free=free, method=optax.lbfgs())
print(fit)


def first(model):
    return jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]


slope = jb.jit(jax.grad(first))(model)
print(
    "slope of the first frequency",
    slope["rope1"].stiffness,
    "Hz per N/m",
    slope["arm"].mass,
    "Hz per kg",
    slope["block"].com,
    "Hz/m",
)
several = jb.jit(jax.vmap(lambda mass: first(jb.replace(model, {"arm.mass": mass}))))(
    jnp.linspace(1.0, 3.0, 5)
)
print("first frequency for five masses of the arm", several, "Hz")
