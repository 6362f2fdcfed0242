"""The arrays of results that the core lists for each board, and what it refuses."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
import pytest

from ruffini.boards import Board, find_board
from ruffini.core.pipeline import Pipeline
from ruffini.errors import InputError
from ruffini.native import library, stage_slots

BOARDS = sorted(path.parent for path in (Path(__file__).parents[3] / "boards").glob("*/board.toml"))
# Without a calibration: what needs no tables. Boards that are not listed compute the features of a wrench.
FEATURES = {"change", "features"}
MARKERS = {"change", "markers", "marker_state", "marker_quality", "features"}
WITHOUT_TABLES = {
    "contact-glitter": MARKERS | {"displacement", "radial_flow", "profile"},
    "eltac": {"skin", "touches", "taxels", "glow", "contacts", "wrench", "wrench_validity", "force_validity"},
    "ftouch": {"change", "targets", "features"},
    "gelsight-mini": MARKERS | {"displacement"},
    "gelslim": MARKERS | {"displacement"},
    "gelslim-dense": MARKERS | {"displacement"},
    "stereo-fingertip": MARKERS,
    "stereo-fingertip-thick": MARKERS,
}


def board_of(folder: Path) -> Board:
    return find_board(folder)


@pytest.mark.parametrize("folder", BOARDS, ids=lambda folder: folder.name)
def test_each_board_lists_the_slots_that_its_stages_write(folder: Path) -> None:
    board = board_of(folder)
    with Pipeline(board) as path:
        assert set(path.slots) == WITHOUT_TABLES.get(folder.name, FEATURES)
        camera = board.camera
        frame = np.full((camera.height_px, camera.width_px, 3), 120, np.uint8)
        path.process(frame)
        for name, slot in path.slots.items():
            assert slot.unit, name
            values = path.raw(name)
            assert values.dtype == slot.dtype, name
            assert values.shape[1:] == slot.shape[1:], name
            assert not slot.columns or len(slot.columns) == slot.shape[-1], name


def test_frames_are_timed_by_the_stages_that_the_core_lists() -> None:
    board = board_of(BOARDS[[folder.name for folder in BOARDS].index("gelslim")])
    assert [*board.pipeline.stages] == [name for name in stage_slots() if name in board.pipeline.stages]
    with Pipeline(board) as path:
        frame = np.full((board.camera.height_px, board.camera.width_px, 3), 120, np.uint8)
        for _ in range(board.pipeline.n_rest_frames + 1):
            spent = path.process(frame).stage_ns
    assert [*spent] == [*stage_slots()]
    assert spent["markers"] > 0
    assert spent["skin"] == 0


def test_bad_requests_are_answered_by_one_sentence() -> None:
    core = library()
    with Pipeline(board_of(BOARDS[[folder.name for folder in BOARDS].index("gelslim")])) as path:
        with pytest.raises(
            InputError, match=r'^this board with this calibration has no slot "taxels": it has change, '
        ):
            path.raw("taxels")
        n_rows = ctypes.c_int32(-1)
        small = np.zeros(3, np.uint8)
        pointer = small.ctypes.data_as(ctypes.c_void_p)
        assert core.ruffini_get_slot(path._pointer, b"marker_state", pointer, ctypes.c_size_t(3), ctypes.byref(n_rows))
        assert core.ruffini_error().decode() == (
            'slot "marker_state" takes 285 bytes, the buffer has 3: ask ruffini_slot_describe for its shape'
        )
        assert n_rows.value == -1
        assert not small.any()
        assert core.ruffini_slot_describe(path._pointer, len(path.slots), None)
        assert core.ruffini_error().decode() == f"slot {len(path.slots)} of {len(path.slots)}: count from 0"
        n = len(stage_slots())
        for ask in (core.ruffini_stage_name, core.ruffini_stage_writes):
            assert ask(n) is None
            assert core.ruffini_error().decode() == f"stage {n} of {n}: count from 0"


def test_a_board_writes_the_slots_of_its_stages() -> None:
    written = {folder.name: board_of(folder) for folder in BOARDS}
    assert written["gelslim"].writes("node_forces")
    assert not written["ftouch"].writes("node_forces")
    assert written["ftouch"].writes("targets")
    assert [name for name, board in written.items() if board.writes("tool_touch")] == [
        "stereo-fingertip",
        "stereo-fingertip-thick",
    ]
