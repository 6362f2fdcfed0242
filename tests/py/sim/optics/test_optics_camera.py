"""Rays against OpenCV's projection, Snell's law and mirror images."""

import cv2
import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.sim.optics.camera import View, rotation
from ruffini.sim.optics.settings import LensSettings, MirrorSettings, ViewSettings

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
