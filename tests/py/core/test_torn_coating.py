"""A hole of 3.3 mm in the coating, wherever it is under a press: light in it is the room's. SIMULATED."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from kept import kept

from ruffini.boards import Board, find_board
from ruffini.core import Pipeline
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.optics.conditions import Conditions
from ruffini.sim.unit import TwinUnit

MM = 1e-3
HOLE_RADIUS_UM = 1650
MARKERS_LOST = 8
WAYS = (("sphere", 4.0, 1.0), ("flat", 3.0, 0.8), ("square", 2.4, 0.5))  # radius and depth, mm
SHEAR_MM = (0.4, -0.3)


def pressed(board: Board) -> list[npt.NDArray[np.float64]]:
    """Displacement of the twin under each of WAYS, pressed and sheared."""
    unit, out = TwinUnit.build(board), []
    for shape, radius, depth in WAYS:
        solver = unit.solver(Indenter(shape, radius * MM))
        for x, y in ((0.0, 0.0), SHEAR_MM):
            solver.advance(Pose(x * MM, y * MM, depth * MM))
        out.append(solver.displacement)
    return out


# Two or three of the widest lattice's markers are in such a hole, seven to eleven of gelslim's.
@pytest.mark.parametrize(("name", "n_holes"), [("gelslim", 6), ("gelslim-dense", 3), ("gelsight-mini", 18)])
def test_a_hole_is_flagged_wherever_it_is_and_a_press_is_not(name: str, n_holes: int) -> None:
    board, rng = find_board(name), np.random.default_rng(1)
    states, unit = kept(pressed, board), TwinUnit.build(board)
    renderer = unit.renderer()
    with Pipeline(board) as core:
        for _ in range(board.pipeline.n_rest_frames):
            core.process(renderer.image(unit.at_rest(), rng))
        for k, state in enumerate(states):
            assert not core.process(renderer.image(state, rng)).flags & MARKERS_LOST, k
        for k in range(n_holes):
            state = states[k % len(states)]
            x, y = rng.uniform(-1500, 1500, 2)
            torn = Conditions(tear_um=(round(x), round(y), HOLE_RADIUS_UM))
            assert core.process(renderer.image(state, rng, conditions=torn)).flags & MARKERS_LOST, (k, x, y)
