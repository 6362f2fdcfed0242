"""Pictures that a camera spoils, through the whole core: each fault has its flag, and good frames have none. SIMULATED.

Many more of them, with the forces that they make: `make hostile`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from kept import kept

from ruffini.bench import picture_faults as faults
from ruffini.bench.fitted import colours_of
from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.core import Pipeline
from ruffini.estimators.operator.fit import make_operator
from ruffini.estimators.operator.gauge import USUAL
from ruffini.fem.operators import Noise
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.settings import MeshSettings, TwinSettings, load_twin
from ruffini.sim.unit import TwinUnit

Picture = npt.NDArray[np.uint8]

LIGHT, FEATURES, REPEATED, PICTURE = 1024, 2048, 32768, 65536  # of FlagBit
MM = 1e-3
N_GOOD, N_BAD = 12, 3
MESH = MeshSettings(cells_x=14, cells_y=11)
# Tables of the error model that let the core state its errors; their values matter to no flag.
ERRORS = {
    "support.error_reported": np.full((2, 12), 256, np.int32), "support.error_quiet": np.full((2, 7), 256, np.int32),
    "support.error_local": np.zeros((2, 4), np.int32),
    "support.error_wrench": np.array([[100] * 2, [100] * 2, [0] * 2, [0] * 2], np.int32),
}  # fmt: skip


@pytest.fixture(scope="module")
def board() -> Board:
    return find_board("gelslim")


@pytest.fixture(scope="module")
def calibration(board: Board) -> bytes:
    kind = kept(make_operator, board, method="support", noise=Noise(USUAL.sigma_m), n_touches=0)
    tables = {**kind.tensors, **kept(colours_of, board, twin=coarse_twin(board), n_balls=8), **ERRORS}
    return container.pack(tables, {**container.base_metadata(board), **kind.metadata}).data


def coarse_twin(board: Board) -> TwinSettings:
    """The board's own with fewer elements."""
    return load_twin(board).model_copy(update={"mesh": MESH})


class Scene:
    """Frames of the untouched pad and of a ball pressed into it, each with its own noise."""

    def __init__(self, board: Board) -> None:
        unit = TwinUnit.build(board, twin=coarse_twin(board))
        self._renderer, self._rng = unit.renderer(), np.random.default_rng(20_261_133)
        ball = unit.solver(Indenter("sphere", 4 * MM))
        ball.advance(Pose(2 * MM, -1 * MM, 0.5 * MM))
        face = unit.solver(Indenter("square", 5.5 * MM))
        face.advance(Pose(0.0, 0.0, 0.15 * MM))
        self._displacement = {"untouched": unit.at_rest(), "pressed": ball.displacement, "wide": face.displacement}

    def frame(self, state: str) -> Picture:
        return self._renderer.image(self._displacement[state], self._rng)


@pytest.fixture(scope="module")
def scene(board: Board) -> Scene:
    return Scene(board)


@pytest.mark.parametrize("state", ["untouched", "pressed"])
def test_good_frames_have_no_flag(core: Pipeline, scene: Scene, state: str) -> None:
    assert [core.process(scene.frame(state)).flags for _ in range(N_GOOD)] == [0] * N_GOOD


def test_a_face_on_a_third_of_the_pad_is_flagged(core: Pipeline, scene: Scene) -> None:
    """It leaves too little rest beside it, and a wrong pad is not told: forces are up to 16 % low."""
    assert [core.process(scene.frame("wide")).flags for _ in range(N_BAD)] == [FEATURES] * N_BAD
    assert 5 / 16 < (core.force_n()[..., 2] != 0).mean() < 9 / 16
    assert core.process(scene.frame("untouched")).flags == 0


FAULTS = {
    "shifted by 1.5 px": (faults.moved((1.2, -0.9)), FEATURES),
    "turned by a degree": (faults.moved(turn_deg=1), FEATURES),
    "zoomed by 2 %": (faults.moved(zoom=1.02), FEATURES),
    "rows aside by 2 px": (faults.slipped(0.3, 0.6, 2), PICTURE),
    "three low bits lost": (faults.posterised(3), PICTURE),
    "JPEG of quality 40": (faults.compressed(40), PICTURE),
    "JPEG of quality 95": (faults.compressed(95), PICTURE),
    "gamma 1.06": (faults.toned(gamma=1.06), LIGHT),
    "black level +8": (faults.toned(black=8), LIGHT),
}


@pytest.mark.parametrize("state", ["untouched", "pressed"])
@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_has_its_flag_in_its_first_frame(core: Pipeline, scene: Scene, state: str, name: str) -> None:
    fault, flag = FAULTS[name]
    core.process(scene.frame(state))
    chance = np.random.default_rng(1)
    for _ in range(N_BAD):
        assert core.process(fault(scene.frame(state), chance)).flags & flag
    assert core.process(scene.frame(state)).flags == 0  # and none after it


def test_repeated_pictures_are_flagged_whole_and_in_part(core: Pipeline, scene: Scene) -> None:
    seen = [scene.frame("pressed") for _ in range(5)]
    assert not any(core.process(frame).flags for frame in seen)
    assert core.process(seen[2]).flags & REPEATED
    torn = faults.torn(seen[3], 0.5, 0.75)(scene.frame("pressed"), np.random.default_rng(1))
    assert core.process(torn).flags & REPEATED
    assert core.process(scene.frame("pressed")).flags == 0
