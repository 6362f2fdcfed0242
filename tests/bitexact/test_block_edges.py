"""Edges of compression's blocks against the mirror, on drawn pictures, some of them through a JPEG coder."""

from __future__ import annotations

import ctypes

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from ruffini.core import native_folder

ROWS, LEAST_COLUMNS, MOST_BLOCKS = 16, 128, 79
Picture = npt.NDArray[np.uint8]


def roughness(picture: Picture) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """firmware/image/block_edges.h: at the blocks' edges and in their middles."""
    height, width = picture.shape[:2]
    if height < ROWS or width < LEAST_COLUMNS:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    line = picture[[(2 * i + 1) * height // (2 * ROWS) for i in range(ROWS)]].astype(np.int64)
    rough = np.abs(line[:, :-3] - 3 * line[:, 1:-2] + 3 * line[:, 2:-1] - line[:, 3:])
    n_all = (width - 2) // 8
    stride = -(-n_all // MOST_BLOCKS)
    edge, middle = (rough[:, first : 8 * n_all : 8 * stride][:, : n_all // stride] for first in (6, 2))
    return edge, middle


def verdicts(rest: Picture, shown: Picture) -> list[int]:
    """1 for each shown picture with blocks that the rest pictures did not have."""
    first = np.stack(roughness(rest[0])) if len(rest) else np.zeros(0, np.int64)
    most = 2 * int(first.sum()) // first.size if first.size else 0

    def sums(picture: Picture) -> list[int]:
        return [int(np.minimum(part, most).sum()) for part in roughness(picture)]

    at_rest = np.sum([sums(picture) for picture in rest], axis=0).tolist() if len(rest) else [0, 0]
    return [int(100 * at * at_rest[1] > 120 * at_rest[0] * beside) for at, beside in map(sums, shown)]


def test_the_verdicts_are_the_mirrors() -> None:
    door = ctypes.CDLL(str(native_folder() / "libruffini_stages.so")).stages_block_edges
    rng, said = np.random.default_rng(3), []
    for turn in range(40):
        width, height = (int(n) for n in rng.integers((110, 14), (1_500 if turn % 5 == 0 else 260, 90)))
        smooth = gaussian_filter(rng.normal(size=(height, width, 3)), (1.5, 1.5, 0))
        light = 120 + rng.uniform(2, 30) * smooth / smooth.std()

        def picture(light: npt.NDArray[np.float64] = light) -> Picture:
            return np.clip(np.round(light + rng.normal(0, 1, light.shape)), 0, 255).astype(np.uint8)

        def coded(quality: int, draw: object = picture) -> Picture:
            _is_ok, data = cv2.imencode(".jpg", draw(), [cv2.IMWRITE_JPEG_QUALITY, quality])  # type: ignore[operator]
            return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)

        is_coded_at_rest = turn % 5 == 4
        frames = np.array([coded(40) if is_coded_at_rest else picture() for _ in range(turn % 4)])
        shown = np.array([coded(int(rng.integers(15, 99))) if rng.random() < 0.5 else picture() for _ in range(10)])
        out = np.zeros(len(shown), np.int32)
        door(width, height, frames.ctypes.data_as(ctypes.c_void_p), len(frames),
             shown.ctypes.data_as(ctypes.c_void_p), len(shown), out.ctypes.data_as(ctypes.c_void_p))  # fmt: skip
        expected = verdicts(frames, shown)
        assert out.tolist() == expected, turn
        said += expected
    assert 60 < sum(said) < len(said) - 60, sum(said)
