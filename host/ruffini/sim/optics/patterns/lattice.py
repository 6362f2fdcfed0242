"""The printed lattice of board.toml as this unit has it: shifted and turned a little."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.boards import Markers, Pad
from ruffini.sim.optics.charts import Floats

Array = npt.NDArray[np.float64]


class Lattice:
    """Nearest lattice point of material places, millimetres from the pad's centre."""

    def __init__(self, markers: Markers, pad: Pad, shift_um: list[int], turn_mrad: int) -> None:
        self._shift = np.array(shift_um) * 1e-3
        self._cos, self._sin = np.cos(turn_mrad * 1e-3), np.sin(turn_mrad * 1e-3)
        self._first = np.array([markers.first_x_um - pad.size_x_um / 2, markers.first_y_um - pad.size_y_um / 2]) * 1e-3
        self._pitch = np.array([markers.pitch_x_um, markers.pitch_y_um]) * 1e-3
        self._n = (markers.n_x, markers.n_y)

    def nearest(self, a: Floats, b: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Offset (da, db) from the nearest lattice point, and that point's material place."""
        x = self._cos * a + self._sin * b - self._shift[0]
        y = -self._sin * a + self._cos * b - self._shift[1]
        near_x, near_y = self._snap(x, 0), self._snap(y, 1)
        at_x, at_y = near_x + self._shift[0], near_y + self._shift[1]
        place_a = self._cos * at_x - self._sin * at_y
        place_b = self._sin * at_x + self._cos * at_y
        return (x - near_x, y - near_y, place_a.astype(np.float32), place_b.astype(np.float32))

    def _snap(self, place: Array, axis: int) -> Array:
        steps = np.clip(np.round((place - self._first[axis]) / self._pitch[axis]), 0, self._n[axis] - 1)
        return np.asarray(self._first[axis] + steps * self._pitch[axis])
