"""Shapes and meshes: volumes and normals against closed forms, meshes of users, and what is
refused."""

import numpy as np
import pytest
import trimesh
from test_views import plate

import jaxbody as jb
from jaxbody.views.scenes import shapes
from jaxbody.views.scenes.colors import COLORS


def as_trimesh(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=True, merge_norm=True, merge_tex=True)


@pytest.mark.parametrize(
    "mesh, volume, tolerance",
    [
        (shapes.box([1.0, 2.0, 3.0]), 6.0, 1e-12),
        (
            shapes.hull(np.random.default_rng(3).permutation(shapes.box([1.0, 2.0, 3.0]).vertices)),
            6.0,
            1e-6,
        ),
        (shapes.cylinder(0.5, -1.0, 1.0, sides=200), np.pi / 2, 1e-3),
        (shapes.sphere(0.5, sides=100), np.pi / 6, 3e-3),
        (shapes.ring(0.3, 0.5, 0.0, 2.0), 2 * np.pi * (0.25 - 0.09), 0.02),
        (shapes.wire(np.linspace([0, 0, 0], [0, 0, 2], 5), 0.1, sides=100), 0.02 * np.pi, 1e-3),
    ],
    ids=["box", "hull", "cylinder", "sphere", "ring", "wire"],
)
def test_solids_have_their_volume_and_faces_that_look_outwards(mesh, volume, tolerance):
    """By the divergence theorem, whose sign is that of the orientation."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert np.sum(a * np.cross(b, c)) / 6 == pytest.approx(volume, rel=tolerance)


def test_a_coil_reaches_from_0_to_1_and_its_wire_is_as_long_as_a_helix():
    coil = shapes.coil(radius=0.1, thickness=0.01, length=0.8, turns=6)
    assert (coil.vertices[:, 2].min(), coil.vertices[:, 2].max()) == (0.0, 1.0)
    stretched = shapes.Mesh(coil.vertices * [1, 1, 0.8], coil.faces)
    a, b, c = np.moveaxis(stretched.vertices[stretched.faces], 1, 0)
    length = np.sum(a * np.cross(b, c)) / 6 / (np.pi * 0.01**2)
    # five full turns; half a turn at each end goes to the axis
    helix = 5.0 * np.hypot(2 * np.pi * 0.1, 0.84 * 0.8 / 6) + 0.3
    assert length == pytest.approx(helix, rel=0.25)


@pytest.mark.parametrize(
    "mesh, count",
    [
        (shapes.box([1, 1, 1]), 12),
        (shapes.cylinder(1.0, sides=24), 48),
        (shapes.sphere(1.0, 24), 0),
    ],
)
def test_only_sharp_edges_are_drawn(mesh, count):
    edges, owners = mesh.edges()
    assert len(edges) == count and owners.shape == (count, 2)


def test_meshes_of_trimesh_are_drawn_with_their_colors(tmp_path):
    path = tmp_path / "part.stl"
    trimesh.creation.box(extents=[100.0, 200.0, 300.0]).export(path)
    part = trimesh.load_mesh(path).apply_scale(1e-3).apply_translation([0, 0, 1])
    ball = trimesh.creation.icosphere(radius=0.2)
    ball.visual.face_colors = [255, 0, 0, 51]
    animation = jb.view(plate(), shapes={"plate": [part, ball]}).animation
    one, other = (animation.part("bodies", "plate", f"shape {k}") for k in (1, 2))
    np.testing.assert_allclose(np.ptp(one.mesh.vertices, axis=0), [0.1, 0.2, 0.3], atol=1e-9)
    assert (one.color, one.opacity) == (COLORS[0], 1.0)
    assert (other.color, other.opacity) == ("#ff0000", 0.2)
    assert {part.path[2] for part in animation.parts if part.path[:2] == ("bodies", "plate")} == {
        "shape 1",
        "shape 2",
        "ends",
    }


def test_shapes_do_not_enter_the_physics():
    model = plate()
    before = repr(model), repr(jb.equilibrium(model))
    jb.view(model, shapes={"plate": trimesh.creation.box([1, 1, 1])})
    assert (repr(model), repr(jb.equilibrium(model))) == before


@pytest.mark.parametrize("shape", [3.0, trimesh.Trimesh(), trimesh.Scene(), [[0, 0, 0]]])
def test_what_is_no_mesh_is_refused(shape):
    with pytest.raises(jb.JaxbodyError, match="WRONG_KIND"):
        jb.view(plate(), shapes={"plate": shape})
