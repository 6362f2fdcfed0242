"""Rays against OpenCV's projection, Snell's law and mirror images."""

import cv2
import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.sim.optics.camera import View, rotation
from ruffini.sim.optics.settings import LensSettings, MirrorSettings, ViewSettings
from ruffini.sim.optics.wall import TubeWall

RADTAN = LensSettings(model="radtan", coefficients_1e6=[-417_100, 250_100, 900, -1400, 3000])
FISHEYE = LensSettings(model="fisheye", coefficients_1e6=[80_000, -21_000, 4000, -900])


def view(**more):
    settings = ViewSettings(**{k: more.pop(k) for k in ("offset_um", "turn_mrad", "mirror") if k in more})
    return View(find_board("gelslim"), settings, more.pop("lens", None), **more)


def camera_matrix():
    return np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])


def test_radial_tangential_lens_is_opencvs():
    _, direction = view(lens=RADTAN).rays()
    pixels, _ = cv2.projectPoints(
        direction.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera_matrix(), np.array(RADTAN.coefficients_1e6) * 1e-6
    )
    v, u = np.mgrid[:240, :320]
    np.testing.assert_allclose(pixels.reshape(240, 320, 2), np.stack([u, v], axis=-1), atol=1e-6)


def test_fisheye_lens_is_opencvs():
    _, direction = view(lens=FISHEYE).rays()
    pixels, _ = cv2.fisheye.projectPoints(
        direction.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera_matrix(),
        np.array(FISHEYE.coefficients_1e6) * 1e-6,
    )  # fmt: skip
    v, u = np.mgrid[:240, :320]
    np.testing.assert_allclose(pixels.reshape(240, 320, 2), np.stack([u, v], axis=-1), atol=1e-4)


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"lens": RADTAN},
        {"lens": FISHEYE},
        {"offset_um": [3000, -2000, 500], "turn_mrad": [50, -120, 400]},
        {"mirror": MirrorSettings(point_um=[9000, 0, -8000], normal_1e3=[-1000, 0, 0])},
    ],
)
def test_a_point_on_a_ray_is_seen_where_the_ray_starts(more):
    one = view(**more)
    origin, direction = (r[20:220:40, 20:300:40].reshape(-1, 3) for r in one.rays())
    pixels, distance = one.project(origin + 17.0 * direction)
    v, u = np.mgrid[20:220:40, 20:300:40]
    np.testing.assert_allclose(pixels, np.column_stack([u.ravel(), v.ravel()]), atol=1e-4)
    assert (distance > 0).all()


def test_mirror_shows_what_a_camera_behind_it_would_see():
    """A mirror at x = 5 that faces the camera's side: the virtual pinhole stands at x = 10 and looks mirrored."""
    mirrored = view(mirror=MirrorSettings(point_um=[5000, 0, 0], normal_1e3=[-1000, 0, 0]))
    point = np.array([[-1.5, 2.0, 0.0]])
    pixels, _ = mirrored.project(point)
    np.testing.assert_allclose(pixels, [[159.5 + 300 * (10 - -1.5) / 20, 119.5 + 300 * 2 / 20]])


def test_turns_follow_the_axes_in_order():
    quarter = np.pi / 2
    np.testing.assert_allclose(rotation(np.array([quarter, 0, 0])) @ [0, 1, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(rotation(np.array([quarter, 0, quarter])) @ [0, 0, 1], [1, 0, 0], atol=1e-12)


def test_refraction_obeys_snell_and_keeps_the_scale_in_the_middle():
    clear, air = view(refractive_index=1.41), view()
    origin, direction = (r[119, 300] for r in clear.rays())
    # The ray of this pixel in air, and in the pad: sin in = sin out / n, and it starts on the back at z = -4 mm.
    slope = np.array([300 - 159.5, 119 - 119.5]) / 300
    sine_in_air = np.hypot(*slope) / np.sqrt(1 + slope @ slope)
    sine_in_pad = np.hypot(*direction[:2]) / np.linalg.norm(direction)
    assert sine_in_pad == pytest.approx(sine_in_air / 1.41, rel=1e-12)
    assert origin[2] == pytest.approx(-4.0)

    def on_surface(one, u):
        start, way = (r[119, u] for r in one.rays())
        return start[0] - start[2] / way[2] * way[0]

    near_middle = on_surface(clear, 162) / on_surface(air, 162)
    assert near_middle == pytest.approx(1, abs=2e-4)
    assert abs(on_surface(clear, 315) - on_surface(air, 315)) > 0.02  # mm: a pinhole cannot follow it


def test_rays_bend_in_the_wall_of_a_tube_as_snell_has_it():
    """In the plane of the axis: tan of the angle from the normal is height over radius, before the wall and in it."""
    wall = TubeWall(outer_mm=40.0, thickness_mm=2.0, index=1.49)
    z = np.array([-60.0, 0.0, 60.0])  # where the rays enter
    angle = np.array([0.3, 2.0, -2.5])
    pinhole = np.array([0.0, 0.0, -163.0])
    way = np.column_stack([38 * np.cos(angle), 38 * np.sin(angle), z - pinhole[2]])
    entry, direction = wall.refracted(np.broadcast_to(pinhole, way.shape), way)
    np.testing.assert_allclose(entry, pinhole + way, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1, atol=1e-12)
    outward = np.column_stack([np.cos(angle), np.sin(angle)])
    in_air, in_wall = np.arctan((z + 163) / 38), np.arctan2(direction[:, 2], (direction[:, :2] * outward).sum(axis=1))
    np.testing.assert_allclose(np.sin(in_wall), np.sin(in_air) / 1.49, rtol=1e-12)
    # Along the tube they go on by less than 2 mm until the outer face; without a wall it would be 5 to 12 mm.
    along = 2 * np.tan(in_wall)
    assert ((along > 1.5) & (along < 1.8)).all()


def test_rays_beside_the_plane_of_the_axis_keep_their_way_round_and_a_wall_of_air_changes_none():
    origin, way = np.array([[5.0, -3.0, -10.0]]), np.array([[3.0, 4.0, 5.0]])
    entry, direction = TubeWall(40.0, 2.0, 1.0).refracted(origin, way)
    np.testing.assert_allclose(direction, way / np.sqrt(50), atol=1e-12)
    assert np.hypot(*entry[0, :2]) == pytest.approx(38)
    _, bent = TubeWall(40.0, 2.0, 1.49).refracted(origin, way)
    normal = np.array([*entry[0, :2], 0]) / 38
    np.testing.assert_allclose(1.49 * np.cross(normal, bent[0]), np.cross(normal, direction[0]), atol=1e-12)  # Snell
