"""False alarms of the picture's checks on recorded videos of real sensors, shown as if a camera delivered them.

The recordings are not part of the repository: RUFFINI_RECORDED_DATA names the folder that holds
wedge-load-cell/*.avi and marker-shear-video/mini_example.avi. They are good frames, compressed by the camera (MJPEG).
"""

from __future__ import annotations

import os
from collections import Counter
from itertools import count
from pathlib import Path

import cv2
import pytest

from ruffini.boards import find_board
from ruffini.core import Pipeline

DATA = os.environ.get("RUFFINI_RECORDED_DATA", "")
VIDEOS = [("gelsight-wedge", "wedge-load-cell/*.avi"), ("gelsight-mini", "marker-shear-video/*.avi")]
PICTURE_FLAGS = {"LIGHT": 1024, "REPEATED": 32768, "PICTURE": 65536}
MOST_FALSE = 1e-3  # share of frames


@pytest.mark.skipif(not DATA, reason="RUFFINI_RECORDED_DATA does not name the recorded data")
@pytest.mark.parametrize(("board", "pattern"), VIDEOS)
def test_good_frames_of_a_compressing_camera_are_seldom_flagged(board: str, pattern: str) -> None:
    flagged, n_frames = Counter[str](), 0
    for path in sorted(Path(DATA).glob(pattern)):
        video = cv2.VideoCapture(str(path))
        with Pipeline(find_board(board)) as core:
            core.set_live()
            for i in count():
                is_frame, picture = video.read()
                if not is_frame:
                    break
                flags = core.process(picture).flags
                flagged.update(name for name, bit in PICTURE_FLAGS.items() if flags & bit)
                n_frames += i >= core.board.pipeline.n_rest_frames
    print(f"{board}, real: {n_frames} frames, flagged {dict(flagged)}")
    assert n_frames > 100
    assert sum(flagged.values()) <= MOST_FALSE * n_frames
