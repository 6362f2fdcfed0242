"""Faults of a camera that looks at a texture: flagged in the first frame, and good pictures are not."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from ruffini.bench import picture_faults as faults
from ruffini.boards import Board, find_board, parse_board
from ruffini.calibrate import container
from ruffini.core import Pipeline

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]
FEATURES, PICTURE = 2048, 65536
N_GOOD = 30
PER_ZOOM_N = 400.0  # force that this calibration makes of a zoom by 1, as the glitter board's


def board_of(name: str) -> Board:
    board = find_board(name)
    stages = '["difference", "markers", "feature_wrench"]'
    return parse_board(board.text[: board.text.index("stages = ")] + f"stages = {stages}\n", name)


def outward_wrench(board: Board) -> bytes:
    """Force along z of how far the patches go outwards."""
    assert board.markers is not None
    n_x, n_y = board.markers.n_x, board.markers.n_y
    x, y = np.meshgrid(8.0 * (np.arange(n_x) - (n_x - 1) / 2), 8.0 * (np.arange(n_y) - (n_y - 1) / 2))
    away = np.stack([x, y], axis=-1)
    gain = np.zeros((6, n_y, n_x, 2))
    gain[2] = -PER_ZOOM_N * 16e6 * 2**14 / 2**16 * away / (away**2).sum()
    tables = {
        "wrench.gain": np.round(gain).reshape(6, -1).astype(np.int32), "wrench.shift": np.full(6, 14, np.uint8),
        "wrench.full_scale": np.full(6, 10**9, np.int32), "wrench.square": np.zeros((6, 21), np.int32),
        "wrench.error": np.zeros((2, 6, 6), np.int32),
    }  # fmt: skip
    return container.pack(tables, {**container.base_metadata(board), "wrench.features": "markers"}).data


class Scene:
    """A speckled pad, untouched or pressed, each frame with noise of its own."""

    def __init__(self, board: Board) -> None:
        self._rng = np.random.default_rng(2)
        shape = board.camera.height_px, board.camera.width_px
        noise = gaussian_filter(self._rng.normal(size=(*shape, 3)), (1.3, 1.3, 0))
        rest = 100 + 30 * noise / noise.std()
        y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
        dx, dy = x - 150, y - 110
        out = 2.0 / 16 * np.exp(0.5 - (dx**2 + dy**2) / 512)  # 2 px at 16 px from its middle
        there = [y - out * dy, x - out * dx]
        pressed = [map_coordinates(rest[..., c], there, order=3, mode="nearest") for c in range(3)]
        self._light = {"untouched": rest, "pressed": np.stack(pressed, axis=-1)}

    def frame(self, state: str) -> Picture:
        light = self._light[state]
        return np.clip(np.round(light + self._rng.normal(0, 1, light.shape)), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def board() -> Board:
    return board_of("contact-glitter")


@pytest.fixture(scope="module")
def scene(board: Board) -> Scene:
    return Scene(board)


@pytest.fixture(scope="module")
def calibration(board: Board) -> bytes:
    return outward_wrench(board)


@pytest.mark.parametrize("state", ["untouched", "pressed"])
def test_good_frames_have_no_flag(core: Pipeline, scene: Scene, state: str) -> None:
    assert [core.process(scene.frame(state)).flags for _ in range(N_GOOD)] == [0] * N_GOOD


FAULTS = {
    "zoomed by 0.5 %": (faults.moved(zoom=1.005), FEATURES),
    "turned by 3 degrees": (faults.moved(turn_deg=3), FEATURES),
    "rows aside by 2 px": (faults.slipped(0.3, 0.6, 2), PICTURE),
    "rows below by 1 px": (faults.slipped(0.3, 0.6, 0, 1), PICTURE),
    "JPEG of quality 70": (faults.compressed(70), PICTURE),
    "JPEG of quality 95": (faults.compressed(95), PICTURE),
    "three low bits lost": (faults.posterised(3), PICTURE),
}


@pytest.mark.parametrize("state", ["untouched", "pressed"])
@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_has_its_flag_in_its_first_frame(core: Pipeline, scene: Scene, state: str, name: str) -> None:
    fault, flag = FAULTS[name]
    core.process(scene.frame(state))
    assert core.process(fault(scene.frame(state), np.random.default_rng(1))).flags & flag
    assert core.process(scene.frame(state)).flags == 0  # and none after it
