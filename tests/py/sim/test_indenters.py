"""Indenters: their sizes against geometry, meshes against the solids they came from, poses against rigid motion."""

import struct

import numpy as np
import pytest

from ruffini.errors import InputError
from ruffini.sim.indenters import NATURAL_RADIUS_M, SHAPES, HeightMap, Indenter, Material, shore_a_modulus
from ruffini.sim.indenters.outline import OUTLINES
from ruffini.sim.pose import Pose, rigid_step, surface_height

MM = 1e-3
FINE = np.linspace(-1.6, 1.6, 801)
X, Y = np.meshgrid(FINE, FINE)

# Faces over the square of the radius, by hand.
AREAS = {
    "flat": np.pi,
    "triangle": np.sqrt(3),  # side 2
    "square": 4.0,
    "hexagon": 2 * np.sqrt(3),  # 2 across the flats
    "ring": np.pi * (1 - 0.36),
    "h": 2 * 0.4 * 2 + 1.2 * 0.4,
    "t": 2 * 0.4 + 1.6 * 0.4,
    "nut": 2 * np.sqrt(3) - np.pi * 0.36,
    "usb_plug": 2 * 0.75 - 1.9 * 0.65 + 1.8 * 0.325,
}


@pytest.mark.parametrize("shape", OUTLINES)
def test_faces_have_their_area(shape):
    area = (Indenter(shape, 1.0).height(X, Y) <= 0).sum() * (FINE[1] - FINE[0]) ** 2
    assert area == pytest.approx(AREAS[shape], rel=0.02)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_shape_touches_first_at_height_zero_and_ends_within_its_reach(shape):
    indenter = Indenter(shape, 3 * MM)
    height = indenter.height(3 * MM * X, 3 * MM * Y)
    assert height.min() == pytest.approx(0, abs=0.01 * MM)
    assert np.isfinite(height).all()
    if indenter.is_prism:
        assert 3 * MM * np.hypot(X, Y)[height <= 0].max() <= indenter.reach_m * 1.001
        slope = np.hypot(*np.gradient(height, 3 * MM * (FINE[1] - FINE[0])))
        assert np.percentile(slope[height > 0.1 * MM], 90) == pytest.approx(1, abs=0.02)  # 45 degrees


def test_known_objects_have_their_size():
    screw = Indenter("screw_m6", NATURAL_RADIUS_M["screw_m6"])
    assert screw.height(4.7 * MM, 0) == 0  # inside the chamfer of a head 10 mm across its flats
    assert screw.height(0, 5.8 * MM) == pytest.approx(0.8 * MM)  # beside a flat
    pan = Indenter("screw_m8", NATURAL_RADIUS_M["screw_m8"])
    assert pan.height(3 * MM, 0) > 2 * MM  # in the recess
    assert pan.height(2.1 * MM, 2.1 * MM) < 0.4 * MM  # on the head
    two = Indenter.two(Indenter("sphere", 2 * MM), Indenter("sphere", 2 * MM), 6 * MM, lift_m=0.5 * MM)
    assert two.height([-3 * MM, 3 * MM], [0, 0]) == pytest.approx([0, 0.5 * MM])


def test_unknown_indenters_are_refused():
    with pytest.raises(InputError, match="choose one of sphere"):
        Indenter("pyramid", 1 * MM)
    with pytest.raises(InputError, match="positive"):
        Indenter("sphere", 0.0)
    with pytest.raises(InputError, match="lowest point"):
        Indenter.of_map(np.ones((3, 3)), 1 * MM)


def pyramid_triangles():
    """A pyramid 4 mm wide and 1 mm high whose apex looks down (-z), in millimetres."""
    apex, corners = np.array([1.0, 2, -1]), np.array([[-1, 0, 0], [3, 0, 0], [3, 4, 0], [-1, 4, 0]], dtype=float)
    sides = [[apex, corners[i], corners[(i + 1) % 4]] for i in range(4)]
    return np.array([*sides, corners[[0, 1, 2]], corners[[0, 2, 3]]])


def as_binary(triangles):
    data = b"made by a test".ljust(80) + struct.pack("<I", len(triangles))
    for triangle in triangles:
        data += struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0)
    return data


def as_text(triangles):
    lines = ["solid pyramid"]
    for triangle in triangles:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex {:.6e} {:.6e} {:.6e}".format(*corner) for corner in triangle]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid pyramid"]).encode()


@pytest.mark.parametrize("form", [as_binary, as_text])
def test_a_mesh_is_its_lower_side(tmp_path, form):
    path = tmp_path / "pyramid.stl"
    path.write_bytes(form(pyramid_triangles()))
    indenter = Indenter.of_stl(path, step_m=0.05 * MM)
    assert indenter.reach_m == pytest.approx(2 * MM, rel=0.03)
    at = np.array([[0.0, 0.0], [1.0, 0.0], [0.3, -1.2], [-0.5, 0.4]]) * MM
    expected = np.abs(at).max(axis=1) / 2
    np.testing.assert_allclose(indenter.height(at[:, 0], at[:, 1]), expected, atol=1e-6)
    assert indenter.height(3 * MM, 0) == pytest.approx(2 * MM, rel=0.03)  # beside it: 45 degrees up from the rim


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"hello", "no STL"),
        (as_binary(pyramid_triangles())[:-7], "no STL"),
        (b"solid nothing\nendsolid", "no triangles"),
        (as_binary(pyramid_triangles() * 1000), "check the unit"),
    ],
)
def test_spoilt_meshes_are_refused(tmp_path, data, words):
    path = tmp_path / "bad.stl"
    path.write_bytes(data)
    with pytest.raises(InputError, match=words):
        Indenter.of_stl(path)
    with pytest.raises(InputError, match="check the path"):
        Indenter.of_stl(tmp_path / "none.stl")


def test_a_height_map_is_bilinear():
    indenter = HeightMap(np.array([[0.0, 1], [2, 3]]), 2.0)
    assert indenter(np.array([0.0, -1, 0.5]), np.array([0.0, -1, 0])) == pytest.approx([1.5, 0, 1.75])


def test_shore_a_follows_gent():
    """Values of his curve, as they stand in tables of rubber makers: 30 A 1.14, 50 A 2.46, 70 A 5.52 MPa."""
    assert [shore_a_modulus(s) / 1e6 for s in (30, 50, 70)] == pytest.approx([1.14, 2.46, 5.52], rel=0.005)
    for bad in (-1, 100):
        with pytest.raises(InputError, match="0 to 99"):
            shore_a_modulus(bad)
    with pytest.raises(InputError, match="cannot be"):
        Material(0.0)


def place(*points_mm):
    return np.array(points_mm, dtype=float) * MM


def test_turned_and_moved_shapes_are_where_they_should_be():
    square = Indenter("square", 2 * MM)
    at = place((1.0, 2.0), (1.0 + 2.7, 2.0), (1 + 2.1, 2 + 2.1))
    height = surface_height(square, Pose(1 * MM, 2 * MM, 0.5 * MM, np.pi / 4), at)
    # Turned by 45 degrees its corner is 2.83 mm along x, and its side 2 mm along the diagonal.
    assert height / MM == pytest.approx([-0.5, -0.5, np.hypot(2.1, 2.1) - 2 - 0.5])


def test_a_tilted_face_is_a_tilted_plane():
    flat = Indenter("flat", 3 * MM)
    at = place((0.5, 0), (-2, 0), (1, 1.5))
    down = surface_height(flat, Pose(0, 0, 0.4 * MM, pitch_rad=0.2), at)
    np.testing.assert_allclose(down, -0.4 * MM - np.tan(0.2) * at[:, 0], atol=1e-8)
    up = surface_height(flat, Pose(0, 0, 0.4 * MM, roll_rad=0.2), at)
    np.testing.assert_allclose(up, -0.4 * MM + np.tan(0.2) * at[:, 1], atol=1e-8)
    with pytest.raises(InputError, match="hang over"):
        surface_height(flat, Pose(0, 0, 0, pitch_rad=0.5), at)


def test_a_tilted_cone_is_its_own_rotated_surface():
    """Points of the upright cone, rotated, lie on the tilted one."""
    cone, pose = Indenter("cone", 2 * MM), Pose(0.3 * MM, -0.1 * MM, 0.2 * MM, 0.7, 0.2, -0.15)
    own = np.random.default_rng(1).uniform(-1 * MM, 1 * MM, (50, 2))
    points = np.column_stack([own, cone.height(own[:, 0], own[:, 1])])
    moved = points @ pose.rotation().T + pose.pivot(cone)
    np.testing.assert_allclose(surface_height(cone, pose, moved), moved[:, 2], atol=1e-8)


def test_rolling_does_not_move_the_point_that_touches():
    radius, angle = 3 * MM, 0.01
    ball, start = Indenter("sphere", radius), Pose(0, 0, 0.0)
    rolled = Pose(radius * angle, 0, 0.0, pitch_rad=angle)
    assert np.abs(rigid_step(ball, start, rolled, np.zeros((1, 3)))).max() < 0.01 * radius * angle
    slid = rigid_step(ball, start, Pose(radius * angle, 0, 0.0), np.zeros((1, 3)))
    assert slid[0, 0] == pytest.approx(radius * angle)


def test_turning_is_a_rotation_about_the_axis():
    moved = rigid_step(Indenter("flat", 2 * MM), Pose(MM, 0, 0), Pose(MM, 0, 0, 0.1), place((3, 0, 0)))
    np.testing.assert_allclose(moved, [[2 * MM * (np.cos(0.1) - 1), 2 * MM * np.sin(0.1), 0]], atol=1e-12)
