"""The printed markers of board.toml as this unit has them, on a lattice or listed: shifted and turned a little."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from ruffini.boards import Markers, Pad
from ruffini.errors import InputError
from ruffini.sim.optics.charts import Floats

Array = npt.NDArray[np.float64]


class Lattice:
    """Nearest lattice point of material places, millimetres from the pad's centre."""

    def __init__(self, markers: Markers, pad: Pad, shift_um: list[int], turn_mrad: int) -> None:
        self._listed: Array | None = None
        if markers.layout == "scattered":
            if markers.places_um is None:
                raise InputError(
                    "the twin prints scattered markers where board.toml lists them: give markers.places_um"
                )
            self._listed = (np.array(markers.places_um) - np.array([pad.size_x_um, pad.size_y_um]) / 2) * 1e-3
            self._tree = cKDTree(self._listed)
        self._shift = np.array(shift_um) * 1e-3
        self._cos, self._sin = np.cos(turn_mrad * 1e-3), np.sin(turn_mrad * 1e-3)
        self._first = np.array([markers.first_x_um - pad.size_x_um / 2, markers.first_y_um - pad.size_y_um / 2]) * 1e-3
        self._pitch = np.array([markers.pitch_x_um, markers.pitch_y_um]) * 1e-3
        self._n = (markers.n_x, markers.n_y)

    def nearest(self, a: Floats, b: Floats) -> tuple[Array, Array, npt.NDArray[np.intp]]:
        """Offset (da, db) from the nearest lattice point, and that point's number, x fastest."""
        x = self._cos * a + self._sin * b - self._shift[0]
        y = -self._sin * a + self._cos * b - self._shift[1]
        if self._listed is not None:
            number = self._tree.query(np.stack([x, y], axis=-1))[1]
            return x - self._listed[number, 0], y - self._listed[number, 1], np.asarray(number, np.intp)
        column, row = self._line(x, 0), self._line(y, 1)
        dx = x - self._first[0] - column * self._pitch[0]
        dy = y - self._first[1] - row * self._pitch[1]
        return dx, dy, (row * self._n[0] + column).astype(np.intp)

    def places(self) -> tuple[Floats, Floats]:
        """Material places of all lattice points, x fastest."""
        if self._listed is not None:
            x, y = (self._listed + self._shift).T
        else:
            x = self._first[0] + self._pitch[0] * np.arange(self._n[0]) + self._shift[0]
            y = self._first[1] + self._pitch[1] * np.arange(self._n[1]) + self._shift[1]
            x, y = (grid.ravel() for grid in np.meshgrid(x, y))
        return (
            (self._cos * x - self._sin * y).astype(np.float32),
            (self._sin * x + self._cos * y).astype(np.float32),
        )

    def _line(self, place: Array, axis: int) -> Array:
        return np.asarray(np.clip(np.round((place - self._first[axis]) / self._pitch[axis]), 0, self._n[axis] - 1))
