"""The tracker on a recorded GelSight Mini video: identity of every dot, noise at rest, return to zero.

The recording is not part of the repository: RUFFINI_RECORDED_DATA names the folder that holds
`marker-shear-video/mini_example.avi`; without it these tests skip, saying so.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import find_board
from ruffini.core import Pipeline

DATA = os.environ.get("RUFFINI_RECORDED_DATA", "")
VIDEO = Path(DATA) / "marker-shear-video" / "mini_example.avi"
BOARD = Path(__file__).parents[3] / "boards" / "gelsight-mini"
LEARNING, UNCALIBRATED, FLAG_MARKERS_LOST = 1, 2 | 4, 8

pytestmark = pytest.mark.skipif(
    not DATA or not VIDEO.is_file(), reason="RUFFINI_RECORDED_DATA does not name the recorded data"
)


def frames() -> Iterator[npt.NDArray[np.uint8]]:
    import cv2

    video = cv2.VideoCapture(str(VIDEO))
    while True:
        is_read, frame = video.read()
        if not is_read:
            return
        yield np.asarray(frame, np.uint8)


def test_every_dot_keeps_its_identity_and_comes_back() -> None:
    pictures = list(frames())
    assert len(pictures) == 219
    board = find_board(BOARD)
    n_rest = board.pipeline.n_rest_frames
    moved, lost, flags = [], [], []
    with Pipeline(board) as pipeline:
        for picture in pictures[:n_rest]:
            pipeline.process(picture)
        for picture in [*pictures, *pictures[::-1]]:
            flags.append(pipeline.process(picture).flags)
            rest, displacement, state = pipeline.markers()
            moved.append(displacement)
            lost.append(state > 0)
    motion, is_lost = np.array(moved), np.array(lost)
    assert not any(f & FLAG_MARKERS_LOST for f in flags)

    length = np.linalg.norm(motion, axis=-1)
    assert length[:n_rest].max() <= 0.15  # at rest
    assert 19 < length.max() < 22  # the largest shear in the recording is 20.9 px
    assert np.array_equal(motion[0], motion[-1])  # forward and back

    # Dots are lost only where they leave the view, and 31 px apart no neighbour may be taken for one.
    place = rest + motion
    is_inside = ((place > 12) & (place < np.array([308, 228]))).all(axis=-1)
    assert not (is_lost & is_inside).any()
    spacing_x = np.linalg.norm(np.diff(place, axis=2), axis=-1)
    spacing_y = np.linalg.norm(np.diff(place, axis=1), axis=-1)
    assert min(spacing_x.min(), spacing_y.min()) > 18
    assert max(spacing_x.max(), spacing_y.max()) < 45
    step = np.linalg.norm(np.diff(motion, axis=0), axis=-1)[~(is_lost[1:] | is_lost[:-1])]
    assert step.max() < 8  # a swap would show as a step of a pitch


def test_a_live_camera_s_own_compression_is_no_fault() -> None:
    with Pipeline(find_board(BOARD)) as pipeline:
        pipeline.set_live()
        flags = [pipeline.process(picture).flags & ~(LEARNING | UNCALIBRATED) for picture in frames()]
    assert not any(flags)
