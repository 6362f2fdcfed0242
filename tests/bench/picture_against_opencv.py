"""The whole frame of a gel without markers, and the same features in OpenCV and in numpy, turn by turn in one run.

    python tests/bench/picture_against_opencv.py --recording FOLDER/wedge-load-cell/golf_ball_0.avi --calibration FILE

Peers: change against the mean of the first frames, relative, then the mean over each cell of the gel's grid, by a warp
of the gel to a rectangle and an area average (OpenCV) or by sums over the cell's pixels (numpy). Ours: everything that
the frame path does, through the C interface; with --calibration the wrench, too, which the peers do not make.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from ruffini.boards import Board, find_board
from ruffini.core import Pipeline
from ruffini.frames import read_frames

Picture = npt.NDArray[np.uint8]
Array = npt.NDArray[np.float32]
N_TURNS = 200
CELL_PX = 32  # of the rectangle that the gel is warped to: nearly the picture's own scale
LEAST_CORRELATION = 0.99  # of the peers' features with ours


class Peers:
    """Features (n,) of a picture: all cells of B by rows, then those of G and of R."""

    def __init__(self, board: Board, rest: Array) -> None:
        assert board.picture_features is not None
        grid = board.picture_features
        self._cells = (grid.n_x, grid.n_y)
        self._size = (grid.n_x * CELL_PX, grid.n_y * CELL_PX)
        wanted = np.array([[0, 0], [self._size[0], 0], self._size, [0, self._size[1]]], np.float32)
        self._map = cv2.getPerspectiveTransform(np.array(grid.corners_px, np.float32), wanted)
        self._rest, self._per_level = rest, (1 / np.maximum(rest, 1)).astype(np.float32)
        y, x = np.mgrid[: rest.shape[0], : rest.shape[1]].astype(np.float32)
        on_gel = cv2.perspectiveTransform(np.stack([x, y], axis=-1).reshape(1, -1, 2), self._map)[0] // CELL_PX
        column, row = on_gel.astype(int).T
        is_on = (column >= 0) & (column < grid.n_x) & (row >= 0) & (row < grid.n_y)
        label = (row * grid.n_x + column)[is_on]
        self._order = np.flatnonzero(is_on)[np.argsort(label, kind="stable")]
        self._n = np.bincount(label, minlength=grid.n_x * grid.n_y).astype(np.float32)
        self._first = np.r_[0, np.cumsum(self._n)[:-1]].astype(int)
        self._flat_rest = self._rest.reshape(-1, 3)[self._order]
        self._flat_per_level = self._per_level.reshape(-1, 3)[self._order]

    def opencv(self, picture: Picture) -> Array:
        change = cv2.multiply(cv2.subtract(picture, self._rest, dtype=cv2.CV_32F), self._per_level)
        gel = cv2.warpPerspective(change, self._map, self._size)
        small = cv2.resize(gel, self._cells, interpolation=cv2.INTER_AREA)
        return np.asarray(np.moveaxis(small, 2, 0).ravel(), np.float32)

    def numpy(self, picture: Picture) -> Array:
        change = (picture.reshape(-1, 3)[self._order] - self._flat_rest) * self._flat_per_level
        return np.asarray((np.add.reduceat(change, self._first, axis=0) / self._n[:, None]).T.ravel(), np.float32)


def measure(board: Board, recording: Path, calibration: Path | None) -> dict[str, float]:
    """Median milliseconds of processor time of each, in turns: what else the machine does is not counted."""
    cv2.setNumThreads(1)
    frames, n_rest = read_frames(recording), board.pipeline.n_rest_frames
    pictures = [frame for _, frame in zip(range(n_rest + N_TURNS), frames, strict=False)]
    rest = np.mean(pictures[:n_rest], axis=0, dtype=np.float32)
    peers = Peers(board, rest)
    with Pipeline(board, calibration.read_bytes() if calibration else None) as core:
        for picture in pictures[:n_rest]:
            core.process(picture)
        work: dict[str, Callable[[Picture], object]] = {
            "opencv": peers.opencv,
            "numpy": peers.numpy,
            "whole frame": partial(core.process),
        }
        taken: dict[str, list[float]] = {name: [] for name in work}
        seen, pressed, largest = np.zeros(0), pictures[-1], -1.0
        for picture in pictures[n_rest:]:
            for name, one in work.items():
                start = time.process_time()
                one(picture)
                taken[name].append(1e3 * (time.process_time() - start))
            if (size := float(np.abs(core.features()).max())) > largest:
                seen, pressed, largest = core.features().astype(float), picture, size
    for name, peer in (("opencv", peers.opencv), ("numpy", peers.numpy)):
        alike = float(np.corrcoef(peer(pressed), seen)[0, 1])
        assert alike > LEAST_CORRELATION, f"{name} makes other features: they correlate by {alike:.3f}"
    return {name: float(np.median(t)) for name, t in taken.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", default="gelsight-wedge")
    parser.add_argument("--recording", type=Path, required=True, help="video or folder of frames")
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    board = find_board(given.board)
    ms = measure(board, given.recording, given.calibration)
    if given.json:
        print(json.dumps(ms))
        return
    print(f"{board.name}: {board.resolution}, medians of {N_TURNS}, milliseconds of one core")
    for name, value in ms.items():
        print(f"  {name:12}{value:8.3f}")


if __name__ == "__main__":
    main()
