"""Quarter cars with an actuator or a controlled damper between body and wheel, and masses on an
actuator alone, for tests of control."""

import numpy as np

import jaxbody as jb

WHITE = 2.526618726679e-4  # W of the road's velocity, E[w'(t) w'(t + s)] = W delta(s) [m2/s]
ROAD = {"road": jb.BaseMotion("road", "z", kind="velocity")}
OUTPUTS = {
    "acceleration": jb.Acceleration("body", axis="z"),
    "travel": jb.Elongation("spring"),
    "tyre": jb.Elongation("tyre"),
}
SPEED = {"speed": jb.Velocity("body", axis="z")}


def quarter_car(
    drive=None, law=None, reads=SPEED, *, mb=300.0, mw=60.0, ks=16e3, bs=1e3, kt=190e3, **sampling
):
    """The car of REFERENCES2 3.2 with a drive between wheel and body, perhaps controlled."""
    up = jb.Guide("world", axis=[0, 0, 1])
    return jb.Model(
        bodies={
            "body": jb.Body(mass=mb, position=[0, 0, 1.0]),
            "wheel": jb.Body(mass=mw, position=[0, 0, 0.4]),
        },
        supports={"road": jb.Support()},
        joints={"body": up, "wheel": up},
        elements={
            "spring": jb.SpringDamper("wheel", "body", spring=ks, damper=bs, free_length=0.6),
            "tyre": jb.Spring("road", "wheel", stiffness=kt, free_length=0.4),
            "drive": jb.Actuator("wheel", "body") if drive is None else drive,
        },
        controllers={"ride": jb.Controller(reads, "drive", law, **sampling)} if law else {},
    )


def mass_on_drive(law=None, reads=None, drive=None, *, mass=1.0, stiffness=0.0, **sampling):
    """A mass on a vertical guide, an actuator between it and the world."""
    below = ("world", [0, 0, -1.0])
    reads = reads or {"x": jb.Position("m", axis="z"), "v": jb.Velocity("m", axis="z")}
    return jb.Model(
        bodies={"m": jb.Body(mass=mass)},
        joints={"m": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "drive": jb.Actuator(below, "m") if drive is None else drive,
            "spring": jb.Spring(below, "m", stiffness=stiffness, free_length=1.0),
        },
        controllers={"law": jb.Controller(reads, "drive", law, **sampling)} if law else {},
    )


def white_rms(lin, inputs, outputs, level):
    """The rms of outputs under white noise in the one input."""
    s = lin.state_space(inputs, outputs)
    return rms_of(*(np.asarray(x) for x in (s.A, s.B, s.C)), np.array([[level]]))


def rms_of(A, B, C, levels):
    """The rms of y = C x, x' = A x + B w, under white noise of these intensities, by residues: sums
    over pairs of the poles that the outputs see."""
    s, V = np.linalg.eig(A)
    b, c = np.linalg.solve(V, B), C @ V
    seen = np.abs(s) > 1e-7 * np.abs(s).max()  # without the road's integrator
    assert np.abs(c[:, ~seen]).max(initial=0.0) < 1e-6 * np.abs(c).max()
    s, b, c = s[seen], b[seen], c[:, seen]
    P = -b @ levels @ b.conj().T / (s[:, None] + s[None].conj())
    return np.sqrt(np.diag(c @ P @ c.conj().T).real)
