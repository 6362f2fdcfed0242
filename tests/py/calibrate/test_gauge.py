"""How far the depth gauge is off: stated from the pad's numbers, held against what the rim of the twin's pad does."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.bench.states import TUNED, make_states
from ruffini.boards import find_board, parse_board
from ruffini.calibrate.gauge import gauge_nodes, gauge_uncertainty_m
from ruffini.calibrate.operator import Material


@pytest.fixture(scope="module")
def board():
    return find_board("gelslim")


def test_the_twins_rim_sinks_as_much_as_stated(board) -> None:
    rim = gauge_nodes(board)
    sunk = [float(s.displacement[rim, 2].mean()) for s in make_states(board, TUNED, (0.6, 1.0))]
    stated = gauge_uncertainty_m(board)
    assert 0.4 < np.sqrt(np.mean(np.square(sunk))) / stated < 2.0


def test_rim_is_the_margin_of_the_window(board) -> None:
    rim = gauge_nodes(board)
    assert rim[:2].all()  # 1.2 mm of 0.67 mm steps
    assert rim[:, :2].all()
    assert not rim[2:-2, 2:-2].any()


def test_all_of_the_pad_sinks_more_than_its_rim(board) -> None:
    whole = parse_board(board.text.replace('gauge = "margin"', 'gauge = "mean"'), "test")
    assert gauge_nodes(whole).all()
    assert gauge_uncertainty_m(whole) > 2 * gauge_uncertainty_m(board)


def test_softness_does_not_matter_thickness_does(board) -> None:
    stated = gauge_uncertainty_m(board, Material(2e5, 0.48, 4e-3))
    assert gauge_uncertainty_m(board, Material(4e5, 0.48, 4e-3)) == pytest.approx(stated, rel=0.05)
    assert gauge_uncertainty_m(board, Material(2e5, 0.48, 6e-3)) != pytest.approx(stated, rel=0.2)
