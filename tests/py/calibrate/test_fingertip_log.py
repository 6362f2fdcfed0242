"""Presses on a fingertip out of a log: a picture of each stop, where a press began, what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.estimators.fingertip.log import press_roots, touched_mm
from ruffini.estimators.fingertip.presses import told_of
from ruffini.estimators.fingertip.task import TASK
from ruffini.frames import Frames
from ruffini.rig.log_file import Log, TouchRecord, write_log

BOARD = find_board("stereo-fingertip")
N_REST = BOARD.pipeline.n_rest_frames + 2
STOPS_M = -1e-4 * np.arange(4)


def touch(**more: object) -> TouchRecord:
    """Stops of 1 s, 0.1 mm apart from 10 s on, a picture each 0.4 s, whose level is its number; 0.5 N / mm."""
    image_s = 8.25 + 0.4 * np.arange(14)
    stage_s = np.sort(np.concatenate([10.0 + np.arange(4), 10.9 + np.arange(4)]))
    place = np.column_stack([np.full(8, 2e-3), np.full(8, -1e-3), np.repeat(STOPS_M, 2)])
    stream_s = np.linspace(8, 14, 61)
    wrench = np.zeros((61, 6))
    wrench[:, 2] = -0.1 - 500 * np.interp(stream_s, stage_s, -place[:, 2])
    facts = {
        "tool": {"shape": "square", "radius_m": 4e-3}, "tilt_deg": [30.0, -20.0], "contact_z_m": 0.0,
        "way_down": [[4e-4, 0.001], [2e-4, 0.002], [0.0, 0.1]], "is_pictured": True, "image_step_px": 1,
        "touched_host_s": 9.8, "held_host_s": 9.8, "lifted_host_s": 13.9, **more,
    }  # fmt: skip
    pictures = np.broadcast_to(np.arange(14, dtype=np.uint8)[:, None, None, None], (14, 4, 6, 3))
    return TouchRecord(facts, {
        "stream_s": stream_s, "stream_host_s": stream_s, "stream_frame": np.arange(61),
        "stream_flags": np.zeros(61, np.int64), "stream_validity": np.ones((61, 6), np.int64),
        "stream_wrench": wrench * np.cos(np.deg2rad(30)) * np.cos(np.deg2rad(20)),
        "reference_s": stream_s, "reference_wrench": wrench, "stage_s": stage_s, "stage_place": place,
        "image_s": image_s, "image": pictures,
    })  # fmt: skip


def test_each_stop_gives_one_picture_with_what_the_bench_knew(tmp_path: Path) -> None:
    write_log(tmp_path / "log.h5", Log({"board": BOARD.name}, [touch()]))
    with press_roots([tmp_path / "log.h5", tmp_path], BOARD) as (root, given):
        assert given == tmp_path
        frames = Frames(root / "00000" / "frames")
        levels = [int(picture[0, 0, 0]) for picture in frames]
        _, told = told_of(root / "00000", len(frames))
    assert not root.exists()
    assert levels[:N_REST] == [i % 4 for i in range(N_REST)]  # before 9.8 s, again and again
    assert levels[N_REST:] == [6, 9, 11, 13]  # 10.65, 11.85, 12.65, 13.45 s: the last of each stop
    assert np.isnan(told[:N_REST]).all()
    assert told[N_REST:, 0] == pytest.approx([0.1, 0.15, 0.2, 0.25])  # N
    assert told[N_REST:, 1] == pytest.approx([0.2, 0.3, 0.4, 0.5])  # mm: 0.1 N is 0.2 mm from where it began
    assert told[-1, 2:] == pytest.approx([2, -1, 30, -20, 64])


def test_where_a_press_began() -> None:
    assert touched_mm(np.array([0.4, 0.2, 0.0, -0.1]), np.array([0.001, 0.05, 0.15, 0.2])) == pytest.approx(0.3)
    assert touched_mm(np.array([0.2, 0.0]), np.array([0.001, 0.1])) == 0.0  # no stop after it
    assert touched_mm(np.array([0.2, 0.0]), np.array([0.0, 0.0])) == pytest.approx(0.2)  # never felt


@pytest.mark.parametrize(("board", "more", "said"), [
    ("gelslim", {}, "collected on board 'gelslim'"),
    ("stereo-fingertip", {"is_pictured": False}, "pictures of its way down"),
    ("stereo-fingertip", {"image_step_px": 2}, "too few to follow pins"),
    ("stereo-fingertip", {"touched_host_s": 8.0}, "no picture of the untouched"),
])  # fmt: skip
def test_what_cannot_be_used_is_refused(board: str, more: dict[str, object], said: str, tmp_path: Path) -> None:
    write_log(tmp_path / "log.h5", Log({"board": board}, [touch(**more)]))
    with pytest.raises(InputError, match=said), press_roots([tmp_path / "log.h5"], BOARD):
        pass


def test_the_word_is_the_force_along_the_tool() -> None:
    one = touch()
    word = TASK.word(BOARD, Log({}, [one]), one, one.arrays["reference_wrench"])
    assert word.said[:, 2] == pytest.approx(word.true[:, 2])
    blind = one._replace(arrays={**one.arrays, "stream_wrench": np.full((61, 6), np.nan)})
    louder = one._replace(arrays={**one.arrays, "stream_wrench": 1.1 * one.arrays["stream_wrench"]})
    words = [TASK.word(BOARD, Log({}, [t]), t, t.arrays["reference_wrench"]) for t in (louder, blind)]
    figures = TASK.figures(words)
    assert (figures["touches"], figures["told"] * 2) == (2, figures["frames"])
    assert figures["error"] == pytest.approx(100 * np.abs(words[0].true[:, 2]).mean(), rel=1e-6)  # mN: a tenth
    assert np.isnan(TASK.figures(words[1:])["error"])
