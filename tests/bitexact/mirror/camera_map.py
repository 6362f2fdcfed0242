"""Rays of the pixels from the kind `camera`, and slopes as the ideal pinhole has them."""

from __future__ import annotations

import copy

import numpy as np
import numpy.typing as npt

from mirror.board import Board, center_q16, depth_grid
from mirror.fixed import I64, round_shift


class CameraMap:
    """`ideal` is the board with the map's pinhole as its camera."""

    def __init__(self, tensors: dict[str, npt.NDArray[np.generic]], metadata: dict[str, str], board: Board) -> None:
        self.ideal = copy.deepcopy(board)
        for key in ("focal_mpx", "standoff_um"):
            self.ideal["camera"][key] = int(metadata[f"camera.{key}"])
        self._shift = int(metadata["camera.step_log2"])
        self._rays = tensors["camera.rays"].astype(np.int64)
        self._source = tensors["camera.source"].astype(np.int64)

    def at(self, x_q16: I64, y_q16: I64) -> I64:
        """(n, 4): A in 1/256 um, S in Q20."""
        camera = self.ideal["camera"]
        u = np.clip(x_q16, 0, (camera["width_px"] - 1) << 16) >> self._shift
        v = np.clip(y_q16, 0, (camera["height_px"] - 1) << 16) >> self._shift
        column = np.minimum(u >> 16, self._rays.shape[1] - 2)
        row = np.minimum(v >> 16, self._rays.shape[0] - 2)
        right, below = (u - (column << 16))[:, None], (v - (row << 16))[:, None]
        corner = [[self._rays[row + j, column + i] for i in (0, 1)] for j in (0, 1)]
        top = corner[0][0] * (65536 - right) + corner[0][1] * right
        bottom = corner[1][0] * (65536 - right) + corner[1][1] * right
        return round_shift(top * (65536 - below) + bottom * below, 32)

    def ideal_place(self, rays: I64) -> I64:
        """(n, 2) px Q16 where the ideal pinhole sees A."""
        camera = self.ideal["camera"]
        scale = (camera["focal_mpx"] << 32) // (camera["standoff_um"] * 1000)
        center = np.array([center_q16(self.ideal, "x"), center_q16(self.ideal, "y")])
        return np.asarray(center + (rays[:, :2] * scale >> 24))

    def rectify(self, slope: I64) -> I64:
        """(n_y, n_x, 2) slopes of the image's depth cells -> the ideal pinhole's."""
        n_y, n_x = depth_grid(self.ideal)
        step = self.ideal["depth"]["step_px"]

        def cell(px_q16: I64, n: int) -> tuple[I64, I64]:
            at = np.clip((2 * px_q16 - (step - 1) * 65536) // (512 * step), 0, (n - 1) << 8)
            line = np.minimum(at >> 8, n - 2)
            return line, (at - (line << 8))[..., None]

        column, fx = cell(self._source[..., 0], n_x)
        row, fy = cell(self._source[..., 1], n_y)
        top = slope[row, column] * (256 - fx) + slope[row, column + 1] * fx
        bottom = slope[row + 1, column] * (256 - fx) + slope[row + 1, column + 1] * fx
        return round_shift(top * (256 - fy) + bottom * fy, 16)
