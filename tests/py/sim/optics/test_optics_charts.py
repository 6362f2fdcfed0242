"""Surfaces: rays meet them where they say, and their normals point to the camera."""

import numpy as np
import pytest

from ruffini.sim.optics.charts import Dome, Plane, Tube
from ruffini.sim.optics.surface import Surface

CASES = [
    (Plane(), [0, 0, -20], (10, 8)),
    (Tube(40.0), [1, 2, -160], (125.0, 60.0)),
    (Dome(22.0), [5, 0, -60], (34.0, 34.0)),
]


@pytest.mark.parametrize(("chart", "pinhole", "half"), CASES)
def test_a_ray_to_a_material_point_meets_it(chart, pinhole, half):
    rng = np.random.default_rng(2)
    a, b = (rng.uniform(-0.65 * h, 0.65 * h, 200).astype(np.float32) for h in half)
    direction = (chart.points(a, b) - pinhole).astype(np.float32)
    origin = np.broadcast_to(np.array(pinhole, dtype=np.float32), direction.shape)
    got_a, got_b = chart.intersect(origin, direction)
    np.testing.assert_allclose(got_a, a, atol=2e-3)
    np.testing.assert_allclose(got_b, b, atol=2e-3)


def test_dome_goes_on_as_a_wall_below_its_rim():
    dome = Dome(22.0)
    a = np.float32(22 * np.pi / 2 + 7)
    np.testing.assert_allclose(dome.points(a, np.float32(0)), [22, 0, -29], atol=1e-4)
    hit = dome.intersect(np.array([[0, 0, -60.0]], np.float32), np.array([[22, 0, 31.0]], np.float32))
    np.testing.assert_allclose(np.ravel(hit), [a, 0], atol=1e-3)


@pytest.mark.parametrize(("chart", "pinhole", "half"), CASES)
def test_a_moved_surface_is_hit_where_it_moved_to(chart, pinhole, half):
    a, b = (np.linspace(-h, h, 41) for h in half)
    surface = Surface(chart, a, b, 0.2)
    shift_mm = np.array([0.3, -0.2, 0.25])
    deformed = surface.deform(np.broadcast_to(shift_mm * 1e-3, (41, 41, 3)))
    rng = np.random.default_rng(3)
    at_a, at_b = (rng.uniform(-0.6 * h, 0.6 * h, (10, 10)).astype(np.float32) for h in half)
    target = chart.points(at_a, at_b) + shift_mm
    origin = np.broadcast_to(np.array(pinhole, dtype=np.float32), target.shape)
    hits = deformed.hit(origin, (target - origin).astype(np.float32))
    np.testing.assert_allclose(hits.a, at_a, atol=5e-3)
    np.testing.assert_allclose(hits.b, at_b, atol=5e-3)
    np.testing.assert_allclose(hits.point, target, atol=5e-3)


def test_normals_point_inwards():
    for chart, _, half in CASES:
        a, b = (np.linspace(-0.8 * h, 0.8 * h, 21) for h in half)
        surface = Surface(chart, a, b, 0.3)
        deformed = surface.deform(np.zeros((21, 21, 3)))
        normal = deformed.inward / np.linalg.norm(deformed.inward, axis=-1, keepdims=True)
        place = deformed.place
        expected = {
            "Plane": np.broadcast_to([0.0, 0.0, -1.0], place.shape),
            "Tube": place * [-1, -1, 0] / 40,
            "Dome": (np.array([0, 0, -22]) - place) / 22,
        }[type(chart).__name__]
        above_rim = place[..., 2] > -20 if isinstance(chart, Dome) else np.ones(place.shape[:2], dtype=bool)
        assert above_rim.mean() > 0.6
        np.testing.assert_allclose(normal[above_rim], expected[above_rim], atol=0.01)
