"""The glitter board's own texture, as its twin renders it, followed by its own pipeline."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import find_board
from ruffini.core import Pipeline
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.settings import load_twin

Array = npt.NDArray[np.float64]
BOARD = find_board(Path(__file__).parents[3] / "boards" / "contact-glitter")


def shear(x_mm: Array, y_mm: Array, peak_mm: float) -> Array:
    """Millimetres, largest in the middle, without depth."""
    share = np.exp(-(x_mm**2 + y_mm**2) / 50)
    return np.stack([peak_mm * share, 0.4 * peak_mm * share, 0 * share], axis=-1)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer.over_chart(BOARD, load_twin(BOARD))


@pytest.mark.parametrize(("peak_mm", "limit_um"), [(0.0, 6.0), (0.1, 10.0), (1.0, 25.0)])
def test_nodes_move_as_the_surface_does(renderer: Renderer, peak_mm: float, limit_um: float) -> None:
    rest = np.mean(
        [renderer.image(renderer.at_rest(), np.random.default_rng(k)).astype(float) for k in range(8)], axis=0
    )
    moved = shear(*np.meshgrid(renderer.node_a_mm, renderer.node_b_mm), peak_mm) * 1e-3
    with Pipeline(BOARD) as pipeline:
        pipeline.set_rest(rest)
        result = pipeline.process(renderer.image(moved, np.random.default_rng(99)))
        u_um = pipeline.displacement_m()[..., :2] * 1e6
    assert result.n_markers_at_rest > 0.95 * 34 * 26
    assert result.n_markers_lost < 9
    pad, grid = BOARD.pad, BOARD.grid
    x, y = (
        np.linspace(-size / 2e3, size / 2e3, n) for size, n in ((pad.size_x_um, grid.n_x), (pad.size_y_um, grid.n_y))
    )
    error = (u_um - shear(*np.meshgrid(x, y), peak_mm)[..., :2] * 1e3)[2:-2, 2:-2]  # nodes with patches around them
    assert 0.1 < np.sqrt((error**2).sum(axis=-1).mean()) < limit_um
