"""A coarse simulated unit, solved once."""

import pytest

from ruffini.boards import find_board
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import TwinUnit


@pytest.fixture(scope="session")
def coarse_unit() -> TwinUnit:
    board = find_board("gelslim")
    pad = board.pad
    model = PadModel(
        pad.size_x_um * 1e-6, pad.size_y_um * 1e-6, pad.thickness_um * 1e-6, pad.modulus_pa,
        pad.poisson_1e4 * 1e-4, n_cells_x=12, n_cells_y=10, layers=(0.3, 0.7),
    )  # fmt: skip
    return TwinUnit(board, load_twin(board), model, surface_compliance(model))
