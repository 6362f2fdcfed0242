"""Lights, patterns, wear and faults: each does what its settings say."""

import numpy as np
import pytest
from plain_optics import NO_NOISE, PLAIN_SENSOR
from scipy.optimize import brentq

from ruffini.sim.optics.conditions import Conditions

CLEAN = {"noise": NO_NOISE, "sensor": PLAIN_SENSOR}


def test_pressed_opening_is_brighter_by_its_compression_alone(bench):
    """Column 14, row 6 of the openings: compressed by one attenuation length it is e times brighter."""
    one = bench("eltac", **CLEAN, unit={"lattice_shift_um": [0, 0], "lattice_turn_mrad": 0, "friction_1e3": 700})
    a, b = 5.236 + 14 * 10.472 - 125.6635, 5 + 6 * 10 - 60
    before, after = one.picture(), one.picture(one.dent(a, b, 1.5, 12))
    angle = a / 40

    def lands_at(slope):
        """Height at which the ray of this slope reaches the tube's outer face, through 2 mm of acrylic."""
        sine = np.cos(np.arctan(slope)) / 1.49  # within the wall, from its normal
        return 38 / slope - 163 + 2 * sine / np.sqrt(1 - sine**2)

    slope = brentq(lambda s: lands_at(s) - b, 0.1, 0.5)
    assert slope < 0.97 * 40 / (163 + b)  # without the wall it would be seen at least 7 px further out
    plane = slope * np.array([np.cos(angle), np.sin(angle)])
    r2 = plane @ plane
    u, v = np.round(976.5 * plane * (1 - 0.4171 * r2 + 0.2501 * r2**2) + [647.6, 357.5]).astype(int)
    assert after[v, u, 0] / before[v, u, 0] == pytest.approx(np.e, rel=0.03)
    far = 2 * np.array([647.6, 357.5]) - (u, v)  # the other side of the tube
    assert abs(after - before)[int(far[1]) - 9 : int(far[1]) + 9, int(far[0]) - 9 : int(far[0]) + 9].max() == 0
    assert before[v, u].min() > 20


def test_ring_light_is_even_round_the_axis(bench):
    one = bench("contact-glitter", **CLEAN, glitter=None, gel=None)
    grey = one.picture().mean(axis=2)
    ring = [grey[round(119.5 + 80 * np.sin(t)), round(159.5 + 80 * np.cos(t))] for t in np.arange(12) * np.pi / 6]
    assert max(ring) - min(ring) < 2
    assert grey[100:140, 140:180].mean() > grey[5:15, 5:15].mean() + 5


def test_a_squeezed_translucent_layer_is_darker_by_its_compression_alone(bench):
    """Against the same lamps on an opaque surface, whose light changes with slope and distance alone."""
    clear = bench("ninedtact", noise=NO_NOISE, sensor=PLAIN_SENSOR)
    light = clear.twin.light.model_dump()
    opaque = bench("ninedtact", noise=NO_NOISE, sensor=PLAIN_SENSOR, light={**light, "darkening_um": 0})
    np.testing.assert_array_equal(clear.picture(), opaque.picture())
    middle = np.s_[238:242, 318:322]
    ratio = clear.picture(clear.dent(0, 0, 1.0, 3.0))[middle] / opaque.picture(opaque.dent(0, 0, 1.0, 3.0))[middle]
    np.testing.assert_allclose(ratio, np.exp(-1.0 / (light["darkening_um"] * 1e-3)), atol=0.01)


def test_a_dent_in_a_translucent_layer_is_darkest_in_its_middle_and_a_raised_one_is_brighter(bench):
    """As in recorded pictures: a slope does not shade it, and there is more gel to scatter light where it is raised."""
    clear = bench("ninedtact", noise=NO_NOISE, sensor=PLAIN_SENSOR)
    rest = clear.picture().mean(axis=2)
    dent = clear.picture(clear.dent(0, 0, 1.0, 1.5)).mean(axis=2) / rest - 1
    row = dent[240, 320:420:10]
    assert row[0] < -0.12
    assert (np.diff(row) > -0.01).all()
    assert (clear.picture(clear.dent(0, 0, -0.5, 3.0)).mean(axis=2) / rest - 1)[240, 320] > 0.05


def test_glitter_moves_with_the_surface(bench):
    import cv2

    one = bench("contact-glitter", noise=NO_NOISE, sensor=PLAIN_SENSOR, gel=None)
    moved = one.picture(one.shifted(0.5, -0.25, 0))
    window = (slice(60, 180), slice(80, 240))
    (dx, dy), _ = cv2.phaseCorrelate(
        one.picture()[window][..., 1].astype(np.float32), moved[window][..., 1].astype(np.float32)
    )
    assert (dx, dy) == pytest.approx((4.0, -2.0), abs=0.1)  # 8 px per mm


def test_glitter_has_the_density_that_is_asked_for(bench):
    import cv2

    sparse = {"per_mm2_1e3": 100, "diameter_um": 500, "tilt_mrad": 1, "lobe_mrad": 1500, "matte_1e3": 1000}
    one = bench("contact-glitter", **CLEAN, gel=None, glitter={**sparse, "strength_1e3": 3000})
    colour = one.picture().max(axis=2) - one.picture().min(axis=2)
    n, _ = cv2.connectedComponents((colour > 40).astype(np.uint8))
    assert n - 1 == pytest.approx(0.1 * 36 * 28, rel=0.12)  # a few touch each other


def test_drift_and_dead_lamps(bench):
    one = bench("gelslim", **CLEAN, wear={"led_drift_1e3": 50, "led_drift_s": 100})
    first, quarter, period = (one.picture(time_s=t).mean(axis=(0, 1)) for t in (0, 25, 100))
    assert np.abs(quarter / first - 1).max() > 0.01
    np.testing.assert_allclose(period, first, atol=0.02)
    dead = bench("gelslim", **CLEAN, wear={"dead_leds": [2]}).picture()
    healthy = bench("gelslim", **CLEAN).picture()
    assert dead[..., 2].mean() < 0.4 * healthy[..., 2].mean()
    assert dead[..., 0].mean() > 0.85 * healthy[..., 0].mean()


def test_a_lamp_that_warms_up_loses_its_own_light_everywhere(bench):
    """A tenth of red's light, within 40 s 1 - 1/e of that: 6.3 % of what a dead red lamp takes away."""
    warm = bench("gelslim", **CLEAN, warming=[{"lamp": 2, "loss_1e3": 100, "time_s": 40}])
    healthy = bench("gelslim", **CLEAN).picture()
    dead = bench("gelslim", **CLEAN, wear={"dead_leds": [2]}).picture()
    assert (warm.picture() == healthy).all()
    lost = 0.1 * (1 - np.exp(-1)) * (healthy - dead)
    np.testing.assert_allclose(warm.picture(time_s=40), healthy - lost, atol=1.01)
    assert np.ptp(lost[..., 2] / healthy[..., 2]) > 0.02  # more where the lamp is nearer


def test_a_warming_part_shines_from_its_own_place(bench):
    """A 200th of green's light comes from 3 mm below the pad's surface."""
    part = {"lamp": 1, "place_um": [-5000, 2000, -3000], "share_1e3": 5, "loss_1e3": 1000, "time_s": 1}
    one = bench("gelslim", **CLEAN, dots=None, warming=[part])
    lost = one.picture() - one.picture(time_s=1e3)
    height, width, _ = lost.shape
    camera = one.board.camera
    px_per_um = camera.focal_mpx * 1e-3 / camera.standoff_um
    at = np.unravel_index(np.argmax(lost[..., 1]), (height, width))
    expected = camera.center_y_mpx * 1e-3 + 2000 * px_per_um, camera.center_x_mpx * 1e-3 - 5000 * px_per_um
    assert at == pytest.approx(expected, abs=8)
    # As a cosine over the distance squared: 3 mm aside, 45 degrees and twice the distance squared.
    aside = lost[round(expected[0] - 3000 * px_per_um), round(expected[1]), 1]
    assert aside / lost[..., 1].max() == pytest.approx(2**-1.5, rel=0.12)
    white = bench("contact-glitter", **CLEAN, gel=None, warming=[{"lamp": 0, "loss_1e3": 1000, "time_s": 1}])
    assert 0 < white.picture().mean() - white.picture(time_s=1e3).mean() < 40


def test_dust_is_dark_and_stays(bench):
    clean = bench("gelslim", **CLEAN).picture()
    dusty = bench("gelslim", **CLEAN, wear={"n_dust": 12, "dust_px": 4, "dust_darkness_1e3": 400})
    loss = 1 - dusty.picture() / clean
    assert 0.3 < loss.max() < 0.7
    assert 0.001 < (loss > 0.15).mean() < 0.05
    assert (dusty.picture() == dusty.picture(seed=9)).all()


def test_motion_blur_is_the_mean_over_the_open_shutter(bench):
    blurred = bench("gelslim", noise=NO_NOISE, sensor={**PLAIN_SENSOR, "shutter_1e3": 1000})
    sharp = bench("gelslim", **CLEAN)
    end = blurred.shifted(0.4, 0, 0)
    got = blurred.picture(end, previous_m=blurred.rest())
    steps = [sharp.picture(part * end) for part in (1 / 8, 3 / 8, 5 / 8, 7 / 8)]
    np.testing.assert_allclose(got, np.mean(steps, axis=0), atol=0.75)
    assert np.abs(got - sharp.picture(end)).max() > 20


def test_bayer_keeps_colours_and_jpeg_comes_near(bench):
    plain = bench("gelslim", **CLEAN).picture()
    for sensor, limit in (({"bayer": "rggb"}, 2.5), ({"jpeg_quality": 90}, 3.0)):
        other = bench("gelslim", noise=NO_NOISE, sensor=sensor).picture()
        assert 0 < np.abs(other - plain).mean() < limit
        np.testing.assert_allclose(other.mean(axis=(0, 1)), plain.mean(axis=(0, 1)), atol=0.6)


@pytest.mark.parametrize(
    ("conditions", "is_so"),
    [
        (Conditions(is_capped=True), lambda p, ref: p.max() < 8),
        (Conditions(exposure=4.0), lambda p, ref: (p >= 255).mean() > 0.3),
        (Conditions(lamps_off=(0, 1, 2)), lambda p, ref: p.mean() < 0.35 * ref.mean()),
        (Conditions(leak=1.0), lambda p, ref: (p - ref)[:, :20].mean() > 3 * (p - ref)[:, -20:].mean() > 0),
        (
            Conditions(tear_um=(2000, -1000, 1000)),
            lambda p, ref: (np.abs(p - ref).max(axis=2) > 40).sum() == pytest.approx(np.pi * 15**2, rel=0.1),
        ),
    ],
)
def test_faults_look_like_faults(bench, conditions, is_so):
    one = bench("gelslim")
    assert is_so(one.picture(conditions=conditions), one.picture())
