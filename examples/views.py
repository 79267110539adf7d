"""Three views in three dimensions: the paper's plate, a car with its right wheels over a kerb, and
the first modes of an engine on mounts.

`python examples/views.py FOLDER` writes plate.html, plate.gif, car.html, car.png, car.gif and
engine.html there: open the .html files in a browser. It needs `pip install 'jaxbody[view]'`.
"""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import trimesh

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
folder = Path(sys.argv[1]) if len(sys.argv) > 1 else None

# The plate on three springs from a base that moves: up is against gravity, here y
l, m, g = 0.7, 3.0, 9.81
k, slack = m * g / l, 3 * l / 2**0.5
ends = {"AB": ([-3 * l, l, 0], [-5 * l, 7 * l, 0]), "CD": ([3 * l, l, 0], [5 * l, 7 * l, 0])}
springs = {
    name: jb.Spring(("plate", a), ("base", b), stiffness=k, free_length=slack, damping=1.0)
    for name, (a, b) in ends.items()
}
springs["EF"] = jb.Spring(
    ("plate", [0, -l, 0]), ("base", [0, l, 0]), stiffness=120.0, free_length=2 * l, damping=1.0
)
plate = jb.Model(
    bodies={"plate": jb.Body(mass=m, inertia=[0.3, 0.9, 1.2])},
    supports={"base": jb.Support(position=[0, -4 * l, 0])},
    elements=springs,
    gravity=[0, -g, 0],
)
rocked = {"base": jb.Harmonic(frequency=0.8, translation=[0.12, 0, 0], rotation=[0, 0, 0.08])}
motion = jb.simulate(
    plate, jnp.linspace(0.0, 2.5, 126), motion=rocked, initial=jb.equilibrium(plate).state
)
plate_view = jb.view(motion, trails={"corner": ("plate", [3 * l, l, 0])})
print(plate_view)

# A car over a kerb, with shapes for its body; they are beside the model and never enter the physics
mass, wheel, radius, track = 1100.0, 38.0, 0.31, 0.75
# x forward, y to the left
axles = {"fl": (1.25, track), "fr": (1.25, -track), "rl": (-1.35, track), "rr": (-1.35, -track)}
load = {name: mass * g * (1.35 if x > 0 else 1.25) / 2.6 / 2 for name, (x, _) in axles.items()}
car = jb.Model(
    bodies={
        "car": jb.Body(mass=mass, inertia=[450.0, 1500.0, 1700.0], position=[0, 0, 0.6]),
        **{
            name: jb.Body(mass=wheel, inertia=[1, 1, 1], position=[x, y, radius - 0.026])
            for name, (x, y) in axles.items()
        },
    },
    supports={f"road {name}": jb.Support(position=[x, y, 0]) for name, (x, y) in axles.items()},
    joints={
        "car": jb.joints.HeavePitchRoll("world"),
        **{name: jb.Guide("world", axis=[0, 0, 1]) for name in axles},
    },
    elements={
        **{
            f"strut {name}": jb.SpringDamper(
                ("car", [x, 0.78 * y, 0.2]),
                (name, [0, -0.22 * y, 0]),
                spring=23e3,
                damper=1600.0,
                free_length=0.516 + load[name] / 23e3,
            )
            for name, (x, y) in axles.items()
        },
        **{
            f"tyre {name}": jb.Tyre(
                name, f"road {name}", stiffness=2.1e5, damping=60.0, radius=radius
            )
            for name in axles
        },
    },
    gravity=[0, 0, -g],
)
# x, half the width, and heights of its edges
sides = [(2.0, 0.5, -0.2, 0.05), (1.35, 0.56, -0.3, 0.2), (-1.9, 0.56, -0.25, 0.25)]
tub = [[x, y, z] for x, width, *heights in sides for y in (-width, width) for z in heights]
roof = [(0.75, 0.54, 0.2), (0.1, 0.44, 0.68), (-1.0, 0.44, 0.68), (-1.6, 0.54, 0.22)]
cabin = [[x, y, z] for x, width, z in roof for y in (-width, width)]
beams = [
    trimesh.creation.box([0.1, 1.24, 0.06]).apply_translation([x, 0, 0.17]) for x in (1.25, -1.35)
]
glass = trimesh.PointCloud(cabin).convex_hull
for mesh, color in ((glass, [159, 195, 230]), *((beam, [43, 47, 54]) for beam in beams)):
    mesh.visual.face_colors = color
body = [trimesh.PointCloud(tub).convex_hull, glass, *beams]
kerb = dict(height=0.09, at=3.2, ramp=0.06, speed=6.0, footprint=0.15)
roads = {
    f"road {name}": jb.inputs.Road.kerb(position=x, **kerb)
    for name, (x, y) in axles.items()
    if y < 0
}
drive = jb.simulate(
    car, jnp.linspace(0.0, 1.6, 321), motion=roads, initial=jb.equilibrium(car).state
)
car_view = jb.view(drive, shapes={"car": body}, speed=0.4)
print(car_view)

# The first three modes of an engine on its mounts, side by side
engine = jb.presets.engine_on_mounts()
modes = jb.modes(jb.linearize(engine, engine.reference))
engine_view = jb.view(modes, number=[1, 2, 3])
print(engine_view)

if folder is not None:
    folder.mkdir(exist_ok=True)
    plate_view.save(folder / "plate.html")
    plate_view.save(folder / "plate.gif", width=480)
    car_view.save(folder / "car.html")
    car_view.save(folder / "car.png", at=1.15)
    jb.view(drive, shapes={"car": body}, speed=0.4, names=False).save(folder / "car.gif", width=600)
    engine_view.save(folder / "engine.html")
    print("written to", folder)
