"""Newtons from rendered frames: the same forces on another board's nodes keep force and moment."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from ruffini.boards import find_board
from ruffini.estimators.operator.error_model import node_places
from ruffini.estimators.operator.fit import board_slab

sys.path.append(str(Path(__file__).resolve().parents[2] / "bench"))
import accuracy


def test_forces_added_up_on_another_boards_nodes_keep_force_and_moment() -> None:
    fine, coarse = find_board("gelslim-dense"), find_board("gelslim")
    force = np.random.default_rng(1).normal(size=(2, fine.grid.n_y, fine.grid.n_x, 3))
    found = accuracy.added_up(fine, coarse, force)
    assert found.shape == (2, coarse.grid.n_y, coarse.grid.n_x, 3)
    here, there = (node_places(board_slab(board), board.observed) for board in (fine, coarse))
    for one, other in zip(force, found, strict=True):
        np.testing.assert_allclose(there.wrench(other, np.zeros(2)), here.wrench(one, np.zeros(2)), atol=1e-12)
    np.testing.assert_allclose(accuracy.added_up(fine, fine, force), force, atol=1e-15)
