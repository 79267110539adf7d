"""Shapes and meshes: volumes and normals against closed forms, files, and what is refused."""

import numpy as np
import pytest
import trimesh
from test_views import plate

import jaxbody as jb
from jaxbody.views.scenes import shapes


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


def test_shapes_are_where_they_are_placed():
    box = jb.views.Shape.box(
        [2, 1, 1], center=[1, 0, 0], orientation=jb.EulerAngles("z", [np.pi / 2])
    )
    np.testing.assert_allclose(
        [box.mesh.vertices.min(0), box.mesh.vertices.max(0)],
        [[0.5, -1, -0.5], [1.5, 1, 0.5]],
        atol=1e-12,
    )
    rod = jb.views.Shape.cylinder(0.1, 2.0, axis=[1, 0, 0], center=[0, 0, 3])
    assert np.ptp(rod.mesh.vertices[:, 0]) == pytest.approx(2.0) and rod.mesh.vertices[
        :, 2
    ].mean() == pytest.approx(3.0)
    ball = jb.views.Shape.sphere(0.5, center=[0, 1, 0], color="red")
    assert (
        np.linalg.norm(ball.mesh.vertices - [0, 1, 0], axis=1) == pytest.approx(0.5)
        and ball.color == "#ff0000"
    )
    assert len(jb.views.Shape.hull(np.eye(4, 3)).mesh.faces) == 4


def test_a_mesh_from_a_file_is_drawn_in_meters(tmp_path):
    path = tmp_path / "part.stl"
    trimesh.creation.box(extents=[100.0, 200.0, 300.0]).export(path)
    shape = jb.views.Shape.file(path, scale=1e-3, center=[0, 0, 1])
    np.testing.assert_allclose(np.ptp(shape.mesh.vertices, axis=0), [0.1, 0.2, 0.3], atol=1e-9)
    animation = jb.view(plate(), shapes={"plate": [shape, jb.views.Shape.sphere(0.2)]}).animation
    assert animation.part("bodies", "plate", "shape 1").mesh is shape.mesh
    assert {part.path[2] for part in animation.parts if part.path[:2] == ("bodies", "plate")} == {
        "shape 1",
        "shape 2",
        "ends",
    }


def test_shapes_do_not_enter_the_physics():
    model = plate()
    before = repr(model), repr(jb.equilibrium(model))
    jb.view(model, shapes={"plate": jb.views.Shape.box([1, 1, 1])})
    assert (repr(model), repr(jb.equilibrium(model))) == before


@pytest.mark.parametrize(
    "make, code",
    [
        (lambda: jb.views.Shape.box([1, -1, 1]), "NOT_POSITIVE"),
        (lambda: jb.views.Shape.cylinder(0.1, 1.0, axis=[0, 0, 0]), "ZERO_AXIS"),
        (lambda: jb.views.Shape.sphere(np.nan), "NON_FINITE"),
        (lambda: jb.views.Shape.hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), "BAD_SHAPE"),
        (lambda: jb.views.Shape.hull([[0, 0], [1, 0]]), "BAD_SHAPE"),
        (lambda: jb.views.Shape.box([1, 1, 1], color="no color"), "WRONG_KIND"),
        (lambda: jb.views.Shape.sphere(1.0, opacity=2.0), "NOT_A_FRACTION"),
        (lambda: jb.views.Shape.file("none.stl"), "NO_FILE"),
    ],
)
def test_what_is_no_shape_is_refused(make, code):
    with pytest.raises(jb.JaxbodyError, match=code):
        make()


def test_a_file_without_a_mesh_is_named(tmp_path):
    path = tmp_path / "part.stl"
    path.write_bytes(b"no mesh at all")
    with pytest.raises(jb.JaxbodyError, match=r"part\.stl.*UNREADABLE"):
        jb.views.Shape.file(path)
