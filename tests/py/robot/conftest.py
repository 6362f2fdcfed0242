"""The calibration of the pads of the tests' worlds, and worlds that are closed again."""

import pytest
from kept import kept
from worlds import BOARD

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.estimators.operator.fit import make_operator
from ruffini.fem.operators import Noise

NOISE = Noise((5e-6, 5e-6, 20e-6))


@pytest.fixture(scope="session")
def calibrations():
    board = find_board(BOARD)
    kind = kept(make_operator, board, method="support", noise=NOISE, n_touches=0)
    return {BOARD: container.pack(kind.tensors, {**container.base_metadata(board), **kind.metadata}).data}


@pytest.fixture
def world(calibrations):
    """Makes worlds with pads; `world(xml)` has one called "pad"."""
    pytest.importorskip("mujoco", reason="extra [robot]")
    from ruffini.robot import World

    opened = []

    def make(xml, pads=("pad",), **options):
        opened.append(World(xml, dict.fromkeys(pads, BOARD), calibrations=calibrations, **options))
        return opened[-1]

    yield make
    for one in opened:
        one.close()
