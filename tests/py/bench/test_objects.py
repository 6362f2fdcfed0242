"""States beyond balls and discs: what they are made of, and what counts as two contacts."""

from __future__ import annotations

import numpy as np
import pytest
from kept import kept

from ruffini.bench.objects import has_paper, paper_states, textured_states, valley
from ruffini.boards import find_board


def test_valley_of_one_peak_and_of_two() -> None:
    force = np.zeros((5, 11, 3))
    force[2, :, 2] = [0, -1, -4, -2, -1, -1, -1, -3, -6, -2, 0]
    assert valley(force) == pytest.approx(1 / 4)
    force[2, :, 2] = [0, 0, -1, -2, -3, -4, -3, -2, -1, 0, 0]
    assert valley(force) == 1
    force[2, :, 2] = [0, -1, -4, 0, 2, 2, 0, -3, -6, -2, 0]  # pulling is no deeper than nothing
    assert valley(force) == 0


def test_the_papers_states_carry_loads_and_their_displacement() -> None:
    board = find_board("gelslim")
    assert has_paper(board)
    assert not has_paper(find_board("ftouch"))
    states = {s.recipe.name: s for s in kept(paper_states, board, quick=True)}
    assert {"S1", "S5", "S6", "S9", "S10"} <= set(states)
    for state in states.values():
        assert 0.3 < state.resultant_n < 6
        assert -state.displacement[..., 2].min() == pytest.approx(state.depth_mm * 1e-3, rel=0.1)
        assert not state.recipe.is_pure
    along = states["S9"].force[..., 2].sum(axis=0)
    left, right = np.argmin(along[:15]), 15 + np.argmin(along[15:])
    assert along[left : right + 1].max() == 0  # two balls: nothing is pressed between


def test_a_texture_touches_on_its_tops() -> None:
    ridges = kept(textured_states, find_board("gelslim"))[0]
    row = -ridges.force[12, :, 2]
    pressed = row[row > 0.1 * row.max()]
    assert len(pressed) >= 8
    assert pressed.min() < 0.7 * pressed.max()
