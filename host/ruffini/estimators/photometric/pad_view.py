"""Which point of the pad a pixel looks at: what labels of colours are computed with.

A point at height z that is seen at an image place lies at A + S z (millimetres, from the pad's centre): by board.toml's
pinhole, or by the table of `ruffini cal fit --only camera` as the board reads it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from ruffini.boards import Board
from ruffini.calibrate.container import Tensors

Array = npt.NDArray[np.float64]


class PadView(Protocol):
    """Rays of image places."""

    def rays(self, px: Array) -> tuple[Array, Array]:
        """A (n, 2), mm, and S (n, 2) of image places (n, 2)."""


@dataclass(frozen=True)
class Pinhole:
    """The view on the pad: focal length and centre in pixels, distance to the surface in mm."""

    focal_px: float
    center_x_px: float
    center_y_px: float
    standoff_mm: float

    def rays(self, px: Array) -> tuple[Array, Array]:
        """As `PadView`."""
        slope = (px - [self.center_x_px, self.center_y_px]) / self.focal_px
        return slope * self.standoff_mm, slope


@dataclass(frozen=True)
class MappedCamera:
    """The kind `camera` of a calibration: `table` (n_y, n_x, 4) one line each `step_px` pixels."""

    table: Array
    step_px: int

    def rays(self, px: Array) -> tuple[Array, Array]:
        """As `PadView`, bilinear."""
        at = px[:, ::-1].T / self.step_px
        values = np.stack([map_coordinates(self.table[..., i], at, order=1, mode="nearest") for i in range(4)], axis=1)
        return values[:, :2] / (2**8 * 1e3), values[:, 2:] / 2**20


def pad_view(board: Board, tensors: Tensors, metadata: dict[str, str]) -> PadView:
    """The board's camera as measured, where the tensors hold that, else as board.toml has it."""
    if "camera.rays" in tensors:
        return MappedCamera(tensors["camera.rays"].astype(float), 1 << int(metadata["camera.step_log2"]))
    c = board.camera
    return Pinhole(c.focal_mpx / 1e3, c.center_x_mpx / 1e3, c.center_y_mpx / 1e3, c.standoff_um / 1e3)


def mm_per_px(view: PadView, px: Array, z_mm: float) -> float:
    """Side of a pixel's square on the plane z at an image place (2,)."""
    around = px + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]])
    place, slope = view.rays(around)
    seen = place + slope * z_mm
    return float(np.sqrt(abs(np.linalg.det(np.stack([seen[0] - seen[1], seen[2] - seen[3]])))))
