"""The papers' methods on pictures and numbers whose answer is known without them."""

import cv2
import numpy as np
import pytest
from papers.contact_glitter import method as glitter_flow
from papers.eltac import method as glowing_skin
from papers.ftouch import method as spring_tray
from papers.stereo_fingertip import method as stereo_pins


def expanding(scale, size=200):
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    return np.stack([(scale - 1) * x, (scale - 1) * y], axis=-1)


def test_density_of_an_even_expansion_falls_by_its_area():
    inner = glitter_flow.density(expanding(1.05))[60:-60, 60:-60]
    assert inner.mean() == pytest.approx(1 / 1.05**2, rel=3e-3)
    assert inner == pytest.approx(1 / 1.05**2, rel=2e-2)  # whole pixels and moved ones beat
    assert glitter_flow.density(expanding(1.0)) == pytest.approx(1.0, abs=1e-4)


def test_flow_of_a_moved_picture_is_its_way():
    rng = np.random.default_rng(3)
    before = cv2.GaussianBlur(rng.integers(0, 255, (120, 160, 3)).astype(np.uint8), (0, 0), 2)
    before = cv2.normalize(before, None, 0, 255, cv2.NORM_MINMAX)
    after = np.roll(before, (1, 3), axis=(0, 1))
    flow = glitter_flow.optical_flow(before, after)[30:-30, 30:-30]
    assert flow.mean(axis=(0, 1)) == pytest.approx([3, 1], abs=0.05)


def test_flow_goes_on_from_the_picture_before():
    """24 px in steps of 3: more than one picture's search finds, not more than the steps'."""
    rng = np.random.default_rng(3)
    before = cv2.GaussianBlur(rng.integers(0, 255, (120, 200, 3)).astype(np.uint8), (0, 0), 2)
    before = cv2.normalize(before, None, 0, 255, cv2.NORM_MINMAX)
    flow = None
    for way in range(3, 25, 3):
        flow = glitter_flow.optical_flow(before, np.roll(before, way, axis=1), flow)
    assert flow[30:-30, 50:-50].mean(axis=(0, 1)) == pytest.approx([24, 0], abs=0.1)
    at_once = glitter_flow.optical_flow(before, np.roll(before, 24, axis=1), np.zeros_like(flow))
    assert at_once[30:-30, 50:-50, 0].mean() < 12


def test_tangential_force_is_proportional():
    assert glitter_flow.slope(np.array([1.0, 2.0]), np.array([3.0, 6.0])) == pytest.approx(3.0)
    assert glitter_flow.slope(np.array([1.0, 2.0]), np.array([2.0, 1.0])) == pytest.approx(0.8)


def test_the_area_gain_is_the_line_through_the_slopes():
    presses = []
    for area in (50.0, 100.0, 200.0):
        depth = np.linspace(0.2, 2, 10)
        presses.append((np.full(10, area), depth, (0.01 * area + 0.5) * np.sqrt(area) * depth))
    gain = glitter_flow.area_gain(presses)
    assert gain == pytest.approx([0.01, 0.5])
    area, depth, force = presses[1]
    assert glitter_flow.gained(area, depth, gain) == pytest.approx(force)


def test_hardness_factor_counts_only_valid_depths():
    depth = np.array([0.1, 0.3, 0.5, 1.0, 1.5, 2.0, 2.4])
    force = 80 * (2 * depth + 1)
    force[[0, 1, 5, 6]] = 1e6
    assert glitter_flow.hardness_factor(np.full(7, 80.0), depth, force) == pytest.approx(2.0)
    assert np.isnan(glitter_flow.hardness_factor(np.full(2, 80.0), depth[:2], force[:2]))


def test_the_perceptron_learns_a_product():
    rng = np.random.default_rng(4)
    inputs = rng.uniform(1, 3, (150, 2))
    fitted = glitter_flow.Perceptron.fit(inputs[:100], inputs[:100, 0] * inputs[:100, 1])
    error = fitted(inputs[100:]) - inputs[100:, 0] * inputs[100:, 1]
    assert np.sqrt(np.mean(error**2)) < 0.15  # of values from 1 to 9


def test_three_targets_are_found_to_a_tenth_of_a_pixel():
    picture = np.full((240, 320, 3), 120, dtype=np.uint8)
    places = np.array([[160.0, 60.0], [230.0, 170.0], [90.0, 170.0]])
    for x, y in places:
        cv2.circle(picture, (round(x * 16), round(y * 16)), 20 * 16, (10, 10, 10), -1, cv2.LINE_8, 4)
    picture[:4] = 0  # the dark rim of the tray is no target
    found = spring_tray.targets(picture)
    assert sorted(map(tuple, np.round(found[:, :2]).tolist())) == sorted(map(tuple, places.tolist()))
    assert found[:, 2] == pytest.approx(np.pi * 20**2, rel=0.05)
    cv2.circle(picture, (160, 120), 20, (10, 10, 10), -1)
    with pytest.raises(ValueError, match="4 dark blobs"):
        spring_tray.targets(picture)


def test_k_is_found_again():
    rng = np.random.default_rng(5)
    k = rng.normal(size=(6, 9))
    nine = rng.normal(size=(60, 9))
    assert spring_tray.calibrate(nine, nine @ k.T) == pytest.approx(k)
    assert spring_tray.variables(np.ones((3, 3)), np.zeros((3, 3))) == pytest.approx(np.ones(9))


def test_f_and_d_are_found_again_and_places_with_them():
    z = np.linspace(-50, 50, 15)
    f, d, radius = 784.7, 160.0, 40.0
    cylinder = glowing_skin.Cylinder.fit(f * radius / (d + z), z, radius)
    assert (cylinder.f, cylinder.d) == pytest.approx((f, d))
    assert cylinder.place(f * radius / (d + 20), 0.5) == pytest.approx([40 * np.cos(0.5), 40 * np.sin(0.5), 20])


def test_polar_undoes_the_lens():
    camera = glowing_skin.Camera(976.4, 976.6, 647.6, 357.5, -0.4171, 0.2501)
    x, y = 0.2, -0.1  # where a straight ray would be
    bent = 1 - 0.4171 * (x * x + y * y) + 0.2501 * (x * x + y * y) ** 2
    r, theta = camera.polar(647.6 + 976.4 * x * bent, 357.5 + 976.6 * y * bent)
    assert r == pytest.approx(np.hypot(976.4 * x, 976.6 * y), abs=0.05)
    assert theta == pytest.approx(np.arctan2(y, x), abs=1e-4)


def test_the_brightest_place_and_every_large_region():
    initial = np.full((200, 300, 3), 40.0)
    now = np.full((200, 300, 3), 40, dtype=np.uint8)
    cv2.circle(now, (80, 60), 18, (120, 90, 40), -1)
    cv2.circle(now, (80, 60), 3, (180, 90, 40), -1)  # where it is pressed most
    cv2.circle(now, (220, 140), 18, (90, 90, 40), -1)
    cv2.circle(now, (30, 180), 4, (90, 90, 40), -1)  # too small for a contact
    now[..., 2] = 250  # red does not count
    change = glowing_skin.brightness(now, initial)
    u, v, level = glowing_skin.brightest(change)
    assert (u, v) == pytest.approx((80, 60), abs=1)
    assert 130 < level <= 190
    found = glowing_skin.regions(change, 30.0)
    assert found[:, :2] == pytest.approx(np.array([[80, 60], [220, 140]]), abs=1)


def test_the_published_curve_is_found_again():
    intensity = np.linspace(0, 250, 40)
    assert glowing_skin.force_curve(intensity, 0.117 * intensity**2 + 4.171 * intensity + 599.9) == pytest.approx(
        [0.117, 4.171, 599.9]
    )


def test_modes_take_the_papers_region():
    picture = np.zeros((240, 640, 3), dtype=np.uint8)
    picture[24:216, 47:271] = 255  # left view
    picture[24:216, 320 + 47 : 320 + 271] = 51
    both = stereo_pins.inputs(picture, 1)
    assert both.shape == (2 * 12 * 14,)
    assert both[:168] == pytest.approx(1.0)
    assert both[168:] == pytest.approx(51 / 127.5 - 1)
    assert stereo_pins.inputs(picture, 0).shape == (168,)
    assert stereo_pins.inputs(picture, 3)[168:] == pytest.approx(-1.0)  # binarised


def test_the_stand_ins_gradient_and_what_it_learns():
    rng = np.random.default_rng(6)
    x, y = rng.normal(size=(20, 3)), rng.uniform(size=(20, 2))
    weights = rng.normal(0, 0.3, stereo_pins.N_HIDDEN * 4 + 2 * (stereo_pins.N_HIDDEN + 1))
    value, gradient = stereo_pins._loss(weights, x, y)
    way = rng.normal(size=weights.size)
    ahead, _ = stereo_pins._loss(weights + 1e-6 * way, x, y)
    assert (ahead - value) / 1e-6 == pytest.approx(gradient @ way, rel=1e-4)
    rows = rng.normal(size=(120, 5))
    labels = np.column_stack([rows[:, 0] + 0.3 * rows[:, 1] ** 2, rows[:, 2]])
    model = stereo_pins.Regression.fit(rows[:90], labels[:90])
    assert np.mean(np.abs(model(rows[90:]) - labels[90:]), axis=0) == pytest.approx([0, 0], abs=0.25)
