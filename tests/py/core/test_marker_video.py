"""The tracker on a recorded GelSight Mini video: identity of every dot, noise at rest, return to zero, painted holes.

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
from numpy.lib.stride_tricks import sliding_window_view

from ruffini.boards import find_board
from ruffini.core import Pipeline

DATA = os.environ.get("RUFFINI_RECORDED_DATA", "")
VIDEO = Path(DATA) / "marker-shear-video" / "mini_example.avi"
BOARD = Path(__file__).parents[3] / "boards" / "gelsight-mini"
LEARNING, UNCALIBRATED, FLAG_MARKERS_LOST = 1, 2 | 4, 8
HOLE_RADIUS_UM = 1650
LOW_CONFIDENCE, FEWEST_BAD = 40, 4  # the peer: so many bad dots within 3 x 3

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


@pytest.mark.parametrize(("level", "least_share"), [(20, 1.0), (200, 1.0), (120, 0.7)])
def test_a_hole_painted_into_the_video_is_flagged(level: int, least_share: float) -> None:
    """On every frame, at a place by chance, moved as the dots beside it; the gel's own grey is about 120.

    A hole of that grey hides a single dot where it is centred on one, which is no hole to the board.
    """
    board, rng = find_board(BOARD), np.random.default_rng(2)
    m, c = board.markers, board.camera
    px_per_um = c.focal_mpx / 1e3 / c.standoff_um
    radius = HOLE_RADIUS_UM * px_per_um
    y, x = np.mgrid[: c.height_px, : c.width_px]
    flagged, by_peer = [], []
    with Pipeline(board) as pipeline:
        for k, picture in enumerate(frames()):
            pipeline.process(picture)
            if k < board.pipeline.n_rest_frames:
                continue
            rest, displacement, _ = pipeline.markers()
            row, column = rng.uniform(1, m.n_y - 2), rng.uniform(1, m.n_x - 2)
            corner = rest[int(row), int(column)] + displacement[int(row), int(column)]
            at_x, at_y = corner + np.array([column % 1 * m.pitch_x_um, row % 1 * m.pitch_y_um]) * px_per_um
            if not (radius < at_x < c.width_px - radius and radius < at_y < c.height_px - radius):
                continue  # it left the view
            torn = picture.copy()
            torn[np.hypot(x - at_x, y - at_y) < radius] = level
            flagged.append(bool(pipeline.process(torn).flags & FLAG_MARKERS_LOST))
            bad = ((pipeline.markers()[2] == 1) | (pipeline.marker_quality() < LOW_CONFIDENCE))[1:-1, 1:-1]
            by_peer.append(sliding_window_view(bad, (3, 3)).sum(axis=(2, 3)).max() >= FEWEST_BAD)
    print(f"grey {level}, real, painted: flagged {sum(flagged)} of {len(flagged)}, four of 3 x 3 {sum(by_peer)}")
    assert len(flagged) > 150
    assert np.mean(flagged) >= least_share
    assert np.mean(flagged) > np.mean(by_peer)
