"""Known points on a tube's inner wall, for fitting the lens of the camera in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.files import write_whole
from ruffini.sim.optics.camera import View
from ruffini.sim.optics.settings import ViewSettings
from ruffini.sim.settings import load_twin

Array = npt.NDArray[np.float64]

N_POINTS, POINT_MM, READING_PX, POINT_SEED = 40, 38.0, 0.5, 15  # on the inner wall, read to half a pixel


def known_points(board: Board) -> Array:
    """Points on the tube's inner wall as a person reads them off the picture, (n, 3) px, px, mm."""
    rng, half = np.random.default_rng(POINT_SEED), board.pad.size_y_um * 5e-4
    z, angle = rng.uniform(-0.93 * half, 0.93 * half, N_POINTS), rng.uniform(-np.pi, np.pi, N_POINTS)
    places = np.column_stack([POINT_MM * np.cos(angle), POINT_MM * np.sin(angle), z])
    px, _ = View(board, ViewSettings(), load_twin(board).lens).project(places)
    return np.column_stack([px + rng.normal(size=px.shape) * READING_PX, z])


def write_known_points(board: Board, folder: Path) -> Path:
    """The same as the CSV file that `--points` takes."""
    path, rows = folder / "points.csv", (",".join(f"{v:.3f}" for v in row) for row in known_points(board))
    write_whole(path, "\n".join(["x_px,y_px,z_mm", *rows, ""]).encode())
    return path
