"""Rigs that several test files share to save compilations: a body on a spring, a plate on springs,
an arm and a box, a beam with a tip."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb


def mass_on_spring(mass=9.0, stiffness=900.0, damping=0.0):
    """A mass that moves along z alone, on one spring, without gravity."""
    below = ("world", [0, 0, -1.0])
    return jb.Model(
        bodies={"mass": jb.Body(mass=mass)},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "spring": jb.Spring(
                "mass", below, stiffness=stiffness, damping=damping, free_length=1.0
            )
        },
        gravity=[0, 0, 0],
    )


def hung(body, to=(0, 0, 0), gravity=(0, 0, 0), at=(0, 0, 0), **spring):
    """A body on one spring, from its point `at` to a point of the world."""
    return jb.Model(
        bodies={"body": body},
        elements={"spring": jb.Spring(("body", at), ("world", to), **spring)},
        gravity=gravity,
    )


def on_shaken_base(stiffness):
    """A mass on a guide over a base that moves: m x'' = k (u - x) + c (u' - x') + F."""
    return jb.Model(
        bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1], position=[0, 0, 0.3])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("world", axis="z")},
        elements={
            "spring": jb.Spring(
                ("mass", [0, 0, 0]),
                ("base", [0, 0, 0]),
                stiffness=stiffness,
                free_length=0.3,
                damping=3.0,
            )
        },
    )


def motion(on, point=(0, 0, 0), direction="z"):
    """A sensor of the displacement of a point along x, y, z or a vector, or of the rotation about
    rx, ry or rz."""
    if isinstance(direction, str) and direction[0] == "r":
        return jb.sensors.Rotation(on, axis=direction[1])
    return jb.Position(on, point, axis=direction)


CORNERS = np.array(
    [
        [0.4, 0.3, 0.05],
        [-0.4, 0.3, 0.05],
        [-0.35, -0.3, 0.05],
        [0.45, -0.3, 0.05],
        [0.02, -0.03, -0.05],
    ]
)
ON_BASE = np.array(
    [[0.6, 0.5, 1.0], [-0.6, 0.5, 1.05], [-0.6, -0.4, 0.95], [0.6, -0.5, 1.0], [0.0, 0.05, -1.0]]
)


def plate(
    *, damping=0.0, position=(0, 0, 0), orientation=(1, 0, 0, 0), base=None, gravity=(0, 0, -9.81)
):
    """A free plate, center of mass off O and unequal moments, hung on four springs from a base and
    held by a fifth from below."""
    springs = {
        f"s{i}": jb.Spring(
            ("plate", a),
            ("base", b),
            stiffness=200.0 + 30 * i,
            free_length=0.75 + 0.03 * i,
            damping=damping * (1 + 0.1 * i),
        )
        for i, (a, b) in enumerate(zip(CORNERS, ON_BASE, strict=True))
    }
    body = jb.Body(
        mass=6.0,
        inertia=[0.25, 0.35, 0.55],
        com=[0.05, -0.03, 0.02],
        position=position,
        orientation=orientation,
    )
    return jb.Model(
        bodies={"plate": body},
        supports={"base": base or jb.Support()},
        elements=springs,
        gravity=gravity,
    )


PARAMETERS = {
    "mass": np.array([2.0, 0.8]),
    "com": np.array([[0.05, -0.02, 0.03], [0.2, 0.02, -0.03]]),
    "inertia": np.array(
        [[0.10, 0.16, 0.20, 0.01, -0.02, 0.015], [0.02, 0.05, 0.06, 0.002, 0.003, -0.004]]
    ),
    "a": np.array(
        [
            [0.3, 0.25, 0.1],
            [-0.3, 0.25, 0.12],
            [0.02, -0.3, 0.1],
            [0.25, -0.05, -0.15],
            [0.35, 0.02, 0.03],
        ]
    ),
    "b": np.array(
        [[0.5, 0.4, 1.0], [-0.45, 0.5, 0.9], [0.1, -0.6, 1.1], [0.3, 0.1, 0.02], [0.8, 0.3, 0.6]]
    ),
    "stiffness": np.array([120.0, 150.0, 135.0, 60.0, 90.0]),
    "free_length": np.array([0.75, 0.7, 0.8, 0.2, 0.5]),
    "damping": np.array([1.0, 0.8, 1.2, 0.5, 0.7]),
    "gravity": np.array([0.5, -0.3, -9.7]),
    "axis": np.array([0.2, 1.0, -0.1]),
    "at": np.array([0.1, 0.05, -0.6]),
    "position": np.array([0.2, -0.1, 0.4]),
    "orientation": np.array([0.95, 0.1, -0.2, 0.15]),
}
MOUNT = {
    "stiffness": np.diag([30.0, 40.0, 50.0, 4.0, 5.0, 6.0]) + 0.7,
    "damping": np.diag([0.3, 0.4, 0.5, 0.04, 0.05, 0.06]) + 0.01,
    "orientation": np.array([0.9, 0.3, 0.1, -0.2]),
}
SHAKING = {
    "frequency": np.array([1.1, 0.9, 1.3, 0.7, 1.0, 0.8]),
    "translation": np.array([0.02, -0.015, 0.01]),
    "rotation": np.array([0.03, 0.02, -0.04]),
    "translation_phase": np.array([0.1, 0.9, 2.0]),
    "rotation_phase": np.array([-0.5, 1.5, 0.3]),
}


def unit(x):
    """x / |x|, also while it is traced."""
    return x / (jnp if hasattr(x, "aval") else np).sqrt((x * x).sum())


def rig(parameters=PARAMETERS, mount=None):
    """A free box on springs of a base and an arm on a hinge of the base, tied by a spring (and a
    bushing); nothing symmetric, centers of mass off O."""
    p = parameters
    ends = [("box", "base"), ("box", "base"), ("box", "base"), ("box", "arm"), ("arm", "base")]
    elements = {
        f"s{i}": jb.Spring(
            (one, p["a"][i]),
            (other, p["b"][i]),
            stiffness=p["stiffness"][i],
            free_length=p["free_length"][i],
            damping=p["damping"][i],
        )
        for i, (one, other) in enumerate(ends)
    }
    if mount is not None:
        ends = ("box", [0.1, 0.05, -0.1]), ("arm", [0.3, 0.0, 0.3])
        elements["mount"] = jb.Bushing(
            *ends, **{**mount, "orientation": unit(mount["orientation"])}
        )
    return jb.Model(
        bodies={
            "box": jb.Body(
                mass=p["mass"][0],
                inertia=p["inertia"][0],
                com=p["com"][0],
                position=[0.2, -0.1, 0.4],
            ),
            "arm": jb.Body(
                mass=p["mass"][1],
                inertia=p["inertia"][1],
                com=p["com"][1],
                position=[0.1, -0.1, -0.2],
            ),
        },
        supports={"base": jb.Support(position=p["position"], orientation=unit(p["orientation"]))},
        joints={"arm": jb.Hinge("base", axis=p["axis"], at=p["at"])},
        elements=elements,
        gravity=p["gravity"],
    )


def max_difference(result, expected):
    """The largest absolute difference."""
    assert np.shape(result) == np.shape(expected)
    return np.abs(np.asarray(result) - np.asarray(expected)).max()


def turned(q):
    """Rotation matrices of unit quaternions w, x, y, z, written out."""
    w, x, y, z = np.moveaxis(np.asarray(q), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def rodrigues(phi):
    """exp([phi]) by Rodrigues' formula; analytic, so that complex steps go through it."""
    angle = np.sqrt((phi * phi).sum())
    x, y, z = phi / angle
    n = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * n + (1 - np.cos(angle)) * n @ n


# Modal kinetic energies [%] of the powertrain on three mounts: rows x y z rx ry rz, a column for
# each mode (REFERENCES.md, section 1).
POWERTRAIN_ENERGIES = np.array(
    [
        [99.4023, 0.0447, 0.0603, 0.1399, 0.3423, 0.0105],
        [0.0322, 98.2133, 0.4394, 1.2595, 0.0141, 0.0415],
        [0.0059, 1.1117, 29.8554, 49.3597, 3.8814, 15.7859],
        [0.0014, 0.5487, 10.8785, 7.6086, 2.1262, 78.8366],
        [0.0661, 0.0001, 21.6356, 7.9213, 65.5363, 4.8406],
        [0.4921, 0.0814, 37.1309, 33.7109, 28.0997, 0.4850],
    ]
)


def decoupled_powertrain():
    """The powertrain of REFERENCES, section 1, and its mounts tuned from 64 starts for modes that
    are each of one kind."""
    engine = jb.presets.engine_on_mounts()
    free, bounds = [], {}
    for name in ("mount 1", "mount 2", "mount 3"):
        mount = engine[name]
        free += [
            f"{name}.a = {name}.b",
            f"{name}.orientation = {name}.orientation_b",
            f"{name}.stiffness",
        ]
        bounds |= {
            f"{name}.a": (mount.a - 0.15, mount.a + 0.15),
            f"{name}.stiffness": (mount.stiffness / 2, mount.stiffness * 2),
        }

    def modal(model):
        lin = jb.linearize(model, model.reference)
        return {
            "coupling": jb.objectives.coupling_of_modes(lin),
            "frequency": jb.modes(lin).frequency,
            "dominant": jb.objectives.dominant_shares(lin),
        }

    with warnings.catch_warnings():
        # forty iterations are enough for 98 %, not for the last digits
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        result = jb.tune(
            engine,
            modal,
            free=free,
            bounds=bounds,
            minimize="coupling",
            limits={"frequency": (6.0, 18.0)},
            starts=64,
            max_iterations=40,
        )
    return engine, result


def beam_with_tip(elements):
    """A beam in heave and pitch with a hinged tip, on joints whose q are increments,
    under gravity."""
    return jb.Model(
        bodies={
            "beam": jb.Body(mass=30.0, inertia=[1, 2, 2], com=[0.1, 0, 0]),
            "tip": jb.Body(mass=5.0, inertia=[0.1] * 3, position=[0.6, 0, 0]),
        },
        joints={"beam": jb.joints.HeavePitch("world"), "tip": jb.Hinge("beam", axis="y")},
        supports={"base": jb.Support()},
        elements=elements,
        gravity=[0, 0, -9.81],
    )


def slider_crank(elements, line="world", crank=0.2, coupler=0.3):
    """Drawn stretched out along x, links of 1 and 3 kg; the coupler's end slides along x, on the
    world or on a base."""
    return jb.Model(
        bodies={
            "crank": jb.Body(mass=1.0, inertia=[1, 1, 0.01], com=[crank / 2, 0, 0]),
            "coupler": jb.Body(
                mass=3.0, inertia=[1, 1, 0.01], com=[coupler / 2, 0, 0], position=[crank, 0, 0]
            ),
        },
        joints={
            "crank": jb.Hinge("world", axis="z"),
            "coupler": jb.Hinge("crank", axis="z", at=[crank, 0, 0]),
        },
        supports={line: jb.Support()} if line != "world" else {},
        closures={
            "slider": jb.closures.Inline((line, [0, 0, 0]), ("coupler", [coupler, 0, 0]), axis="x")
        },
        elements=elements,
        gravity=[0, -9.81, 0],
    )


def check_derivatives(of, x, modes=1e-9):
    """Those of a number by each of a row: reverse against forward mode, and forward against
    differences of fourth order."""
    forward, reverse = jax.jacfwd(of)(x), jax.grad(of)(x)
    np.testing.assert_allclose(reverse, forward, rtol=modes)
    for i, h in enumerate(2e-3 * x):
        near, far = (
            float(of(x.at[i].add(k * h)) - of(x.at[i].add(-k * h))) / float(2 * k * h)
            for k in (1, 2)
        )
        np.testing.assert_allclose(forward[i], (4 * near - far) / 3, rtol=1e-6)
