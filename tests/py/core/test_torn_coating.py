"""A hole of 3.3 mm in the coating, wherever it is between the markers: light in it is the room's. SIMULATED."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import Board, find_board
from ruffini.core import Pipeline
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.optics.conditions import Conditions
from ruffini.sim.settings import MeshSettings, load_twin
from ruffini.sim.unit import TwinUnit

MM = 1e-3
HOLE_RADIUS_UM = 1650
MARGIN_UM = 1000  # and a pitch: a hole's middle from the outermost markers
MARKERS_LOST = 8
WAYS = (("flat", 2.2, 1.0), ("sphere", 4.0, 1.0), ("flat", 4.6, 1.2))  # radius and depth, mm
SHEAR_MM = (0.4, -0.3)
MESH = MeshSettings(cells_x=14, cells_y=11)  # presses part and lose as many markers as with the boards' own meshes


def pressed(unit: TwinUnit, n_ways: int) -> list[npt.NDArray[np.float64]]:
    """Displacement of the twin at rest and under the first of WAYS, pressed and sheared."""
    out = [unit.at_rest()]
    for shape, radius, depth in WAYS[:n_ways]:
        solver = unit.solver(Indenter(shape, radius * MM))
        for x, y in ((0.0, 0.0), SHEAR_MM):
            solver.advance(Pose(x * MM, y * MM, depth * MM))
        out.append(solver.displacement)
    return out


def middles(board: Board, n_phases: int) -> list[tuple[float, float]]:
    """Of holes about a marker near the middle, n x n in its cell, and as near to a corner as they are found, um."""
    m = board.markers
    first = (m.first_x_um - board.pad.size_x_um / 2, m.first_y_um - board.pad.size_y_um / 2)
    places = [(m.n_x // 2 + i / n_phases, m.n_y // 2 + j / n_phases) for i in range(n_phases) for j in range(n_phases)]
    inside = [max(MARGIN_UM / pitch, 1) for pitch in (m.pitch_x_um, m.pitch_y_um)]
    places.append((m.n_x - 1 - inside[0], inside[1]))
    return [(first[0] + i * m.pitch_x_um, first[1] + j * m.pitch_y_um) for i, j in places]


# Two or three of the widest lattice's markers are in such a hole, seven to eleven of gelslim's.
@pytest.mark.parametrize(
    ("name", "n_phases", "n_ways"), [("gelslim", 2, 3), ("gelslim-dense", 1, 1), ("gelsight-mini", 4, 3)]
)
def test_a_hole_is_flagged_wherever_it_is_and_a_press_is_not(name: str, n_phases: int, n_ways: int) -> None:
    board, rng = find_board(name), np.random.default_rng(1)
    unit = TwinUnit.build(board, twin=load_twin(board).model_copy(update={"mesh": MESH}))
    states, renderer = pressed(unit, n_ways), unit.renderer()
    with Pipeline(board) as core:
        for _ in range(board.pipeline.n_rest_frames):
            core.process(renderer.image(states[0], rng))
        for k, state in enumerate(states):
            assert not core.process(renderer.image(state, rng)).flags & MARKERS_LOST, k
        for k, (x, y) in enumerate(middles(board, n_phases)):
            state = states[k % len(states)]
            torn = Conditions(tear_um=(round(x), round(y), HOLE_RADIUS_UM))
            assert core.process(renderer.image(state, rng, conditions=torn)).flags & MARKERS_LOST, (k, x, y)
