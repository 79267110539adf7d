"""MJCF and URDF files compiled by MuJoCo itself: a model from the arrays of MuJoCo's compiled
model."""

import importlib.util
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from jaxbody.files.interchange.mjcf_assemblies import STEPS, FramesOfFile, JointOfBody, tendon
from jaxbody.files.interchange.mjcf_documents import MjcfDocument
from jaxbody.files.interchange.mjcf_geometry import ORIGIN, Place
from jaxbody.model.bodies import Body
from jaxbody.model.layouts import WORLD

LONGEST = 300.0  # time limit of a compilation [s]
KINDS = ("free", "ball", "slide", "hinge")  # in the order of MuJoCo's numbers
# kinds of elements whose tag has another name
KIND = {"freejoint": "joint", "spatial": "tendon", "fixed": "tendon", "link": "body"}
SITE = 3  # MuJoCo's number for a site in the path of a tendon


def compiled(path: Path, document: MjcfDocument) -> tuple[dict[str, np.ndarray] | None, str | None]:
    """Return the arrays of MuJoCo's compiled model and None. Return None and a message if the file
    is not compiled, or None twice if MuJoCo is not installed. As MuJoCo reads any file that is
    named in it, a file that names files outside its folder is not compiled."""
    if importlib.util.find_spec("mujoco") is None:
        return None, None
    outside = [
        name
        for name in named_files(document)
        if not (path.parent / name).resolve().is_relative_to(path.parent.resolve())
    ]
    if outside:
        return None, f"it names '{outside[0]}', which is not in its folder"
    with tempfile.TemporaryDirectory() as folder:
        source, target = path.resolve(), Path(folder, "arrays.npz")
        if document.root.tag == "robot":
            source = _without_looks(path, Path(folder, "robot.urdf"))
        program = Path(__file__).with_name("mujoco_process.py")
        try:
            run = subprocess.run(
                [sys.executable, "-P", program, source, target],
                cwd=folder,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=LONGEST,
            )
        except subprocess.TimeoutExpired:
            return None, f"its compilation takes more than {LONGEST:g} s"
        if run.returncode or not target.exists():
            if run.returncode == 1:
                return None, " ".join(run.stderr.split()[-40:]) or "its compilation failed"
            return None, f"its compilation ended with the exit code {run.returncode}"
        with np.load(target) as arrays:
            return dict(arrays), None


def named_files(document: MjcfDocument) -> Iterator[str]:
    """Yield the files and folders that the elements of an MJCF document name. A nested model in
    another file, which may name any file, is yielded as a path outside the folder."""
    for node in document.root.within() if document.root.tag == "mujoco" else ():
        for name, value in node.attributes.items():
            if name.startswith("file") or name.endswith("dir"):
                yield value if node.tag != "model" else f"../{value}"


def _without_looks(path: Path, target: Path) -> Path:
    """Write a copy of a URDF without its shapes and the files that these name; return its path."""
    tree = ElementTree.parse(path)
    for link in tree.iter("link"):
        for child in (*link.findall("visual"), *link.findall("collision")):
            link.remove(child)
    tree.write(target)
    return target


class CompiledReader(FramesOfFile):
    """Reader of a model from MuJoCo's arrays."""

    def __init__(self, path: Path, document: MjcfDocument, arrays: dict[str, np.ndarray]):
        super().__init__(document)
        self.file, self.arrays = path.name, arrays
        self.lines = {
            (KIND.get(each.tag, each.tag), each.attributes.get("name")): each.where
            for each in document.root.within()
        }
        # for each body of MuJoCo, the frame of the model and the place of the body on it
        self.places: list[tuple[str, Place]] = [(WORLD, ORIGIN)]

    def __getattr__(self, name: str) -> Any:
        """Return an array by its name in MuJoCo."""
        if name in self.__dict__.get("arrays", {}):
            return self.arrays[name]
        raise AttributeError(name)

    def where(self, kind: str, i: int) -> str:
        """Return the place of a body, joint or tendon in the file; without a name there, the name
        of the file."""
        return self.lines.get((kind, str(self.arrays[f"{kind}_names"][i])), self.file)

    def world(self) -> None:
        """Collect all frames, with their joints and parts."""
        self.leave_out_sections()
        self.leave_out_effects()
        for node in self.document.root.within():
            if node.tag == "collision":  # of URDF
                self.leave_out("contact of geoms", node.where)
        for i in range(1, len(self.body_parentid)):
            where, first = self.where("body", i), self.body_jntadr[i]
            owner, at = self.places[self.body_parentid[i]]
            place = at @ Place(self.body_pos[i], self.body_quat[i])
            joints = [self.joint(j) for j in range(first, first + self.body_jntnum[i])]
            own = self.gather(where, lambda i=i: self.solid(i))
            self.places.append(
                self.carry(where, str(self.body_names[i]), owner, place, joints, own)
            )

    def solid(self, i: int) -> Body | None:
        if not self.body_mass[i]:
            return None
        return Body(
            self.body_mass[i],
            self.body_inertia[i],
            position=self.body_ipos[i],
            orientation=self.body_iquat[i],
        )

    def joint(self, j: int) -> JointOfBody:
        kind, q = KINDS[self.jnt_type[j]], self.jnt_qposadr[j]
        return JointOfBody(
            str(self.joint_names[j]),
            self.where("joint", j),
            kind,
            self.jnt_pos[j],
            self.jnt_axis[j],
            stiffness=float(self.jnt_stiffness[j]),
            damping=float(self.dof_damping[self.jnt_dofadr[j]]),
            relaxed=float(self.qpos_spring[q] - self.qpos0[q]) if kind in STEPS else 0.0,
        )

    def leave_out_effects(self) -> None:
        """List, as left out, properties that have an effect in MuJoCo but none in the model."""
        effects = {
            "contact of geoms": (self.geom_contype != 0) | (self.geom_conaffinity != 0),
            "fluidshape of geoms": self.geom_fluid.any(-1),
            "gravcomp of bodies": self.body_gravcomp,
            "camera": np.ones(self.ncam),
            "light": np.ones(self.nlight),
            "flex": np.ones(self.nflex),
            "armature of joints": self.dof_armature,
            "frictionloss of joints": self.dof_frictionloss,
            "limits of joints": self.jnt_limited,
            "armature of tendons": self.arrays.get("tendon_armature", ()),
            "frictionloss of tendons": self.tendon_frictionloss,
            "limits of tendons": self.tendon_limited,
            "higher powers of stiffness of joints": self.of_rows("jnt_stiffnesspoly"),
            "higher powers of damping of joints": self.of_rows("dof_dampingpoly"),
            "higher powers of stiffness of tendons": self.of_rows("tendon_stiffnesspoly"),
            "higher powers of damping of tendons": self.of_rows("tendon_dampingpoly"),
        }
        for what, numbers in effects.items():
            if times := int(np.count_nonzero(numbers)):
                self.leave_out(what, self.file, times)

    def of_rows(self, name: str) -> np.ndarray:
        """Return whether each row of an array has a nonzero number; older versions of MuJoCo do not
        have all arrays."""
        return self.arrays.get(name, np.zeros((1, 1))).any(-1)

    def made(self) -> dict[str, Any]:
        """Return the arguments of Model."""
        return self.parts(1.0, self.gravity)

    def tendons(self) -> None:
        for i, (first, count) in enumerate(zip(self.tendon_adr, self.tendon_num, strict=True)):
            where, wraps = self.where("tendon", i), slice(first, first + count)
            if count != 2 or (self.wrap_type[wraps] != SITE).any():
                self.leave_out("tendons other than between two sites", where)
                continue
            ends = []
            for site in self.wrap_objid[wraps]:
                owner, place = self.places[self.site_bodyid[site]]
                ends.append((owner, place.point(self.site_pos[site])))
            k, c = float(self.tendon_stiffness[i]), float(self.tendon_damping[i])
            low, high = map(float, self.tendon_lengthspring[i])
            spring = self.gather(where, lambda: tendon(ends, k, c, low, high))  # noqa: B023
            self.add(spring, str(self.tendon_names[i]), "tendon", where)
