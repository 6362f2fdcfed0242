"""A face's area by key points: walls whose shape is known, and a table of a process whose answer is known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from papers.stereo_fingertip.experiment import is_whole

from ruffini.estimators.fingertip import face as tip_face
from ruffini.estimators.fingertip.face import bears_all_round, cells, fit_face, radii, rays, table_error

Array = npt.NDArray[np.float64]
DOME_MM = TIP_MM = 22.0
TOP = np.array([0.0, 0, 1])


def dense_pins() -> Array:
    """Directions 1 mm apart about the top."""
    line = np.arange(-16, 16.5, 1.0)
    at = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    way = np.hypot(*at.T)
    at, way = at[way < 16], way[way < 16]
    sideways = at * (np.sin(way / DOME_MM) / np.maximum(way, 1e-9))[:, None]
    return np.column_stack([sideways, np.cos(way / DOME_MM)])


@pytest.mark.parametrize("radius_mm", [4.0, 6.0, 8.0])
def test_a_wall_that_leaves_a_plane_bends_at_its_rim(radius_mm: float) -> None:
    normal = dense_pins()
    aside = np.hypot(*normal[:, :2].T) * DOME_MM
    flat = np.sqrt(DOME_MM**2 - radius_mm**2)
    steep = flat - 0.6 * (aside - radius_mm)  # a cone beyond the rim
    moved = np.zeros_like(normal)
    moved[:, 2] = np.where(aside < radius_mm, flat, steep) - DOME_MM * normal[:, 2]
    bend, _ = radii(moved, normal, np.eye(3), TOP, DOME_MM, TIP_MM)
    assert bend * tip_face.RING_MM == pytest.approx(radius_mm, abs=0.6)


def test_a_wall_that_buckles_away_is_highest_on_a_ring() -> None:
    normal = dense_pins()
    aside = np.hypot(*normal[:, :2].T) * DOME_MM
    moved = np.zeros_like(normal)
    moved[:, 2] = 20 - 0.05 * (aside - 6) ** 2 - DOME_MM * normal[:, 2]
    _, ridge = radii(moved, normal, np.eye(3), TOP, DOME_MM, TIP_MM)
    assert ridge * tip_face.RING_MM == pytest.approx(6, abs=0.3)


def test_rays_and_cells_cover_the_cap() -> None:
    assert cells().sum() * tip_face.N_RAYS == pytest.approx(np.pi * 10.25**2)
    np.testing.assert_allclose(np.linalg.norm(rays(DOME_MM), axis=-1), 1)
    np.testing.assert_allclose(np.arccos(rays(DOME_MM)[:, -1, 2]) * DOME_MM, 10)


def test_what_bears_all_round_is_what_the_experiment_calls_whole() -> None:
    rng = np.random.default_rng(3)
    told = np.zeros((300, 7))
    told[:, 1], told[:, 2:4] = rng.uniform(0.1, 2, 300), rng.uniform(-5, 5, (300, 2))
    told[:, 6] = np.pi * rng.uniform(3, 6.5, 300) ** 2
    ours = bears_all_round(told, DOME_MM)
    theirs = [is_whole("flat", float(np.sqrt(row[6] / np.pi)), row, DOME_MM) for row in told]
    assert 30 < ours.sum() < 270
    assert (ours == np.array(theirs)).mean() > 0.98  # their outline is of 72 points


def presses(rng: np.random.Generator, n: int) -> tuple[Array, Array, npt.NDArray[np.bool_], npt.NDArray[np.intp]]:
    """Ten frames a press: a face whose edge bears from 0.5 N on shows in the radii; before, nothing of it does."""
    press = np.repeat(np.arange(n), 10)
    area, force = np.repeat(rng.uniform(40, 120, n), 10), np.tile(np.linspace(0.1, 1, 10), n)
    whole = force > 0.5
    bend = np.where(whole, 2 * np.sqrt(area), 8) + rng.normal(0, 0.1, len(press))
    return np.column_stack([force, 2 * force, bend, bend + 1 + rng.normal(0, 0.1, len(press))]), area, whole, press


def test_a_table_tells_faces_whose_edge_bears_and_how_sure_it_is() -> None:
    rng = np.random.default_rng(4)
    table = fit_face(*presses(rng, 60))
    assert table is not None
    report = table.report
    likely, right, whole, error, straight = (
        report[k] or 0.0
        for k in ("n_likely", "n_likely_whole", "n_whole", "error_likely_percent", "tabulation_error_percent")
    )
    assert right > 0.8 * whole
    assert likely < 1.1 * right
    assert 0 < error < 6
    assert 0 < straight < 3
    assert (table.values[:, 1] > 0.01).all()
    assert table.values.shape == (9**4, 3)
    assert (table.values >= 0).all()
    inputs, area, bears, _ = presses(np.random.default_rng(5), 20)
    assert table_error(table, inputs[bears], area[bears]) < 10


def test_too_few_presses_make_no_table() -> None:
    assert fit_face(*presses(np.random.default_rng(6), 11)) is None
