"""Where things are in the image."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board


def node_places(board: Board) -> npt.NDArray[np.float64]:
    """Where each observed node of the undeformed pad is, (n_y, n_x, 2) mm from the pad's centre."""
    rows, columns = board.observed
    x = np.linspace(-0.5, 0.5, board.grid.n_x)[columns] * board.pad.size_x_um * 1e-3
    y = np.linspace(-0.5, 0.5, board.grid.n_y)[rows] * board.pad.size_y_um * 1e-3
    return np.stack(np.meshgrid(x, y), axis=-1)


def node_pixels(board: Board) -> npt.NDArray[np.float64]:
    """Image position of each observed node of the undeformed pad, (n_y, n_x, 2) pixels."""
    camera = board.camera
    grid = node_places(board) * (camera.focal_mpx / camera.standoff_um)
    return np.asarray(grid + np.array([camera.center_x_mpx, camera.center_y_mpx]) * 1e-3)


def depth_places(board: Board, depth_m: npt.NDArray[np.float64], step_px: int) -> npt.NDArray[np.float64]:
    """Where on the pad each cell of a depth map looks, (n_y, n_x, 2) metres from the pad's centre.

    A cell is step_px x step_px pixels; its ray meets the surface at u_z.
    """
    camera = board.camera
    rows, columns = np.indices(depth_m.shape)
    pixel = np.stack([columns, rows], axis=-1) * step_px + (step_px - 1) / 2
    away = (pixel - np.array([camera.center_x_mpx, camera.center_y_mpx]) * 1e-3) / (camera.focal_mpx * 1e-3)
    return np.asarray(away * (camera.standoff_um * 1e-6 + depth_m)[..., None])
