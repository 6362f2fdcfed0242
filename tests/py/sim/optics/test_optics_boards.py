"""Every board with a twin makes a picture that its sensor could have made."""

import numpy as np
import pytest
from plain_optics import NO_NOISE, PLAIN_SENSOR

from ruffini.boards import board_names, find_board
from ruffini.sim.optics.conditions import TrayPose

WITH_TWIN = [name for name in board_names() if (find_board(name).folder / "twin.toml").is_file()]


def test_the_five_systems_have_twins():
    assert {"gelslim", "ftouch", "eltac", "contact-glitter", "stereo-fingertip"} <= set(WITH_TWIN)


@pytest.mark.parametrize("name", WITH_TWIN)
def test_untouched_picture_is_neither_black_nor_full(bench, name):
    one = bench(name)
    picture = one.picture()
    camera = one.board.camera
    assert picture.shape == (camera.height_px, camera.width_px, 3)
    assert (picture >= 255).mean() < 0.01
    assert (picture > 20).mean() > 0.05


@pytest.mark.parametrize("name", WITH_TWIN)
def test_a_dent_shows_and_the_same_seed_repeats(bench, name):
    one = bench(name)
    middle = 30.0 if one.twin.shape.kind == "tube" else 2.0
    pushed = one.dent(middle, 1.0, 1.0, 4.0)
    assert (one.picture(pushed) == one.picture(pushed)).all()
    change = np.abs(one.picture(pushed) - one.picture())
    assert change.max() > 20


def centroid(picture, at, radius):
    v, u = np.mgrid[: picture.shape[0], : picture.shape[1]]
    weight = np.where(np.hypot(u - at[0], v - at[1]) < radius, np.maximum(picture - 70, 0), 0)
    return np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()


def test_stereo_disparity_is_focal_times_baseline_over_distance(bench):
    one = bench("stereo-fingertip", noise=NO_NOISE, sensor=PLAIN_SENSOR)
    grey = one.picture().mean(axis=2)
    # The top pin's tip is 1.5 mm below the top: 58.5 mm from both pinholes, 5 mm to either side.
    shift = 280 * 5 / 58.5
    left = centroid(grey[:, :320], (159.5 + shift, 119.5), 5)
    right = centroid(grey[:, 320:], (159.5 - shift, 119.5), 5)
    np.testing.assert_allclose(left - right, [2 * shift, 0], atol=0.05)


def test_number_of_pins_in_view(bench):
    import cv2

    grey = bench("stereo-fingertip", noise=NO_NOISE, sensor=PLAIN_SENSOR).picture()[:, :320].mean(axis=2)
    n, _ = cv2.connectedComponents((grey > 100).astype(np.uint8))
    assert n - 1 == 292


def test_targets_follow_the_tray_as_a_pinhole_sees_them(bench):
    one = bench("ftouch", noise=NO_NOISE, sensor=PLAIN_SENSOR)
    tray = TrayPose((0.4e-3, -0.3e-3, -1e-3), (0.02, -0.03, 0.05))
    grey = 255 - one.picture(tray=tray).mean(axis=2)
    for place_um in one.twin.targets.places_um:
        place = tray.matrix() @ np.array(place_um) * 1e-3 + np.array(tray.shift_m) * 1e3
        expected = np.array([319.5, 239.5]) + 460 * place[:2] / (20 + place[2])
        v, u = np.mgrid[:480, :640]
        weight = np.where((np.hypot(u - expected[0], v - expected[1]) < 55) & (grey > 225), 1.0, 0)
        got = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
        np.testing.assert_allclose(got, expected, atol=0.3)
        radius = 460 * one.twin.targets.radius_um * 1e-3 / (20 + place[2])
        assert weight.sum() == pytest.approx(np.pi * radius**2, rel=0.06)


def test_a_lowered_tray_looks_like_a_nearer_pad(bench):
    """With lamps that stand still, a lowered pad is the same scene as one whose surface moved down."""
    one = bench("ftouch", noise=NO_NOISE, sensor=PLAIN_SENSOR, targets=None)
    lowered = one.picture(tray=TrayPose((0.2e-3, 0, -1e-3)))
    moved = one.picture(one.shifted(0.2, 0, -1))
    np.testing.assert_allclose(lowered, moved, atol=1.01)
