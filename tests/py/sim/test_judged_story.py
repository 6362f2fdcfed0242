"""The story on which newtons from pictures are judged: what it promises, press by press."""

from __future__ import annotations

import numpy as np

from ruffini.boards import find_board
from ruffini.sim.programs import Rest, Touch, sheared_and_turned


def test_presses_are_deep_sheared_and_half_of_them_turned() -> None:
    board = find_board("gelslim")
    story = sheared_and_turned(board, 40, np.random.default_rng(3))
    presses = [step for step in story if isinstance(step, Touch)]
    assert len(presses) == 40
    assert isinstance(story[0], Rest)
    assert story[0].n_frames > board.pipeline.n_rest_frames
    turned = 0
    for press in presses:
        first, last = press.poses[0], press.poses[-1]
        assert [*press.judged] == [False] * (len(press.poses) - 1) + [True]
        assert 0.3e-3 <= last.depth_m <= 1.0e-3
        shift = np.hypot(last.x_m - first.x_m, last.y_m - first.y_m)
        assert 0.1 <= round(shift / last.depth_m, 9) <= 0.5
        assert max(abs(last.x_m), abs(last.y_m)) < 7e-3
        turned += last.turn_rad != 0
    assert 12 <= turned <= 28
    assert {press.indenter.shape for press in presses} == {"sphere", "flat"}
