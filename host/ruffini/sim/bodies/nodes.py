"""What happens at the samples of a body, told at the nodes of the board's grid."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board

Array = npt.NDArray[np.float64]
States = npt.NDArray[np.uint8]


class BoardNodes:
    """Samples at places (n, 2) on the board's pad, metres from its middle."""

    def __init__(self, board: Board, places: Array) -> None:
        self._n = np.array([board.grid.n_x, board.grid.n_y])
        sizes = np.array([board.pad.size_x_um, board.pad.size_y_um]) * 1e-6
        self._at = np.clip((places / sizes + 0.5) * (self._n - 1), 0, self._n - 1)

    def shared_out(self, force: Array) -> Array:
        """Forces (n, 3) of the samples, each on the four nodes about it, (n_y, n_x, 3): the sum stays."""
        out = np.zeros((self._n[1], self._n[0], 3))
        loaded = np.flatnonzero(force.any(axis=1))
        low = np.clip(np.floor(self._at[loaded]).astype(int), 0, self._n - 2)
        part = self._at[loaded] - low
        for dx in (0, 1):
            for dy in (0, 1):
                share = np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1])
                np.add.at(out, (low[:, 1] + dy, low[:, 0] + dx), share[:, None] * force[loaded])
        return out

    def states(self, force: Array, slips: npt.NDArray[np.bool_]) -> States:
        """Of the nearest node to each touched sample: 2 if any of its samples slips, 1 if they stick, (n_y, n_x)."""
        out = np.zeros((self._n[1], self._n[0]), np.uint8)
        touched = np.flatnonzero(force.any(axis=1))
        column, row = np.rint(self._at[touched]).astype(int).T
        np.maximum.at(out, (row, column), np.where(slips[touched], 2, 1).astype(np.uint8))
        return out
