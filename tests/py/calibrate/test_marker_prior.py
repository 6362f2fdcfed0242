"""What the pad's mechanics says of a wrench from markers alone: simulated touches of the same pad, no log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from ruffini.boards import find_board, parse_board
from ruffini.estimators.operator.error_model import node_places
from ruffini.estimators.operator.fit import board_slab
from ruffini.estimators.wrench.marker_prior import marker_prior
from ruffini.fem.touches import TouchMaker

TEXT = (Path(__file__).parents[2] / "data" / "boards" / "base.toml").read_text()
WHOLE = (slice(0, None), slice(0, None))


def test_shear_and_twist_of_touches_come_from_markers_without_a_log() -> None:
    """Along x, y and about z within a fifth of how far the loads spread; a press is seen, not in newtons."""
    board = parse_board(TEXT.replace("n_x = 31\nn_y = 25\nn_layers = 6", "n_x = 21\nn_y = 17\nn_layers = 4"), "prior")
    assert board.markers is not None
    slab, m = board_slab(board), board.markers
    places, prior = node_places(slab, WHOLE), marker_prior(board)
    assert prior is not None
    assert prior.shape == (6, 2 * m.n_x * m.n_y)
    x = 1e-6 * (m.first_x_um + m.pitch_x_um * np.arange(m.n_x) - board.pad.size_x_um / 2)
    y = 1e-6 * (m.first_y_um + m.pitch_y_um * np.arange(m.n_y) - board.pad.size_y_um / 2)
    at = np.stack(np.meshgrid(y, x, indexing="ij"), axis=-1).reshape(-1, 2)
    px_q16 = 65536 * board.camera.focal_mpx * 1e-3 / (board.camera.standoff_um * 1e-6)
    maker, said, truth = TouchMaker(slab, 4), [], []
    for _ in range(40):
        touch = maker.draw()
        moved = RegularGridInterpolator((places.y_m, places.x_m), touch.displacement[..., :2])(at)
        said.append(prior @ (moved * px_q16).ravel())
        truth.append(places.wrench(touch.force, np.zeros(2)) * [1, 1, 1, 1e3, 1e3, 1e3])
    error = np.sqrt(((np.array(said) - truth) ** 2).mean(axis=0))
    spread = np.std(truth, axis=0)
    assert (error[[0, 1, 5]] < 0.2 * spread[[0, 1, 5]]).all(), error / spread
    assert np.corrcoef(np.array(said)[:, 2], np.array(truth)[:, 2])[0, 1] > 0.9


def test_markers_nobody_knows_the_places_of_have_no_prior() -> None:
    board = parse_board(TEXT.replace("[markers]\n", '[markers]\nlayout = "scattered"\n'), "prior")
    assert marker_prior(board) is None
    assert marker_prior(find_board("ftouch")) is None
