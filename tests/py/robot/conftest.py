"""The calibration of the pads of the tests' worlds, and worlds that are closed again."""

import pytest
from kept import kept
from worlds import BOARD, WITHOUT_Z

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.estimators.operator.fit import make_operator
from ruffini.estimators.operator.gauge import USUAL
from ruffini.fem.operators import Noise
from ruffini.sim.settings import load_twin


@pytest.fixture(scope="session")
def calibrations():
    files = {}
    for name in (BOARD, WITHOUT_Z):
        board = find_board(name)
        kind = kept(make_operator, board, method="support", noise=Noise(USUAL.sigma_m), n_touches=0)
        files[name] = container.pack(kind.tensors, {**container.base_metadata(board), **kind.metadata}).data
    return files


@pytest.fixture(scope="session", autouse=True)
def solids():
    """Worlds of the same pad share it, as the pads of one world do: it is frozen, and half a second to make."""
    pytest.importorskip("mujoco", reason="extra [robot]")
    from ruffini.robot.mechanics import PadSolid

    make, made = PadSolid.of_board, {}

    def of_board(board, *, stiffness=1.0):
        key = (board.text, load_twin(board).model_dump_json(), stiffness)
        if key not in made:
            made[key] = make(board, stiffness=stiffness)
        return made[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PadSolid, "of_board", staticmethod(of_board))
        yield


@pytest.fixture
def world(calibrations):
    """Makes worlds with pads; `world(xml)` has one called "pad"."""
    pytest.importorskip("mujoco", reason="extra [robot]")
    from ruffini.robot import World

    opened = []

    def make(xml, pads=("pad",), board=BOARD, **options):
        opened.append(World(xml, dict.fromkeys(pads, board), calibrations=calibrations, **options))
        return opened[-1]

    yield make
    for one in opened:
        one.close()
