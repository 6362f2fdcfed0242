"""How much of a fingertip's wall lies in the tool's plane: caps and planes whose areas are known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.estimators.fingertip.area import FLAT_MM, N_TOP, STEP_MM, area_of_nodes, area_of_pins, flat_area, lattice

Array = npt.NDArray[np.float64]
RADIUS_MM = 22.0
UP = np.array([0.0, 0.0, 1.0])


def pins(step_mm: float = 2.4) -> Array:
    """Directions (n, 3) of pins within 25 mm of the top."""
    line = np.arange(-24, 24.1, step_mm)
    at = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    way = np.linalg.norm(at, axis=1)
    at, way = at[way < 25], way[way < 25]
    sideways = at * (np.sin(way / RADIUS_MM) / np.maximum(way, 1e-9))[:, None]
    return np.column_stack([sideways, np.cos(way / RADIUS_MM)])


def flattened(points: Array, axis: Array, depth_mm: float) -> Array:
    """Displacements that lay what is above a plane into it."""
    return -np.maximum(points @ axis - (RADIUS_MM - depth_mm), 0)[:, None] * axis


def cap_mm2(depth_mm: float) -> float:
    return 2 * np.pi * RADIUS_MM * depth_mm


def test_an_untouched_cap_is_as_wide_as_the_tolerance_makes_it() -> None:
    points = RADIUS_MM * lattice(RADIUS_MM)
    top = np.sort(points[:, 2])[-N_TOP:].mean()
    assert flat_area(points, UP) == pytest.approx(cap_mm2(FLAT_MM + RADIUS_MM - top), abs=4 * STEP_MM**2)


@pytest.mark.parametrize("axis", [UP, np.array([0.3, -0.2, 0.93])])
@pytest.mark.parametrize("depth_mm", [0.5, 1.5])
def test_a_flattened_dome_is_flat_as_far_as_the_plane_goes(axis: Array, depth_mm: float) -> None:
    axis = axis / np.linalg.norm(axis)
    normal = pins()
    place = RADIUS_MM * normal
    found = area_of_pins(flattened(place, axis, depth_mm), place, normal, axis, RADIUS_MM)
    assert found == pytest.approx(cap_mm2(depth_mm + FLAT_MM), rel=0.08)


def test_nodes_of_the_wall_say_the_same() -> None:
    line = np.linspace(-22, 22, 45)
    x, y = np.meshgrid(line, line)
    z = np.sqrt(np.maximum(RADIUS_MM**2 - x**2 - y**2, 0))
    points = np.stack([x, y, z], axis=-1)
    moved = flattened(points.reshape(-1, 3), UP, 1.0).reshape(45, 45, 3)
    assert area_of_nodes(moved, 44.0, UP, UP, RADIUS_MM) == pytest.approx(cap_mm2(1.0 + FLAT_MM), rel=0.08)
    assert area_of_nodes(0 * moved, 44.0, UP, UP, RADIUS_MM) < 0.5 * cap_mm2(1.0)
