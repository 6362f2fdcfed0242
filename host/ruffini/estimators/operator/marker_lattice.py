"""A printed lattice and the nodes: where its markers are, and how the board interpolates between them.

The float twin of the lattice's part of firmware/image/marker_interpolation.cpp, for markers printed where the board
says; the bit-exact tests hold it to the core within its rounding.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board, Markers
from ruffini.errors import InputError

Array = npt.NDArray[np.float64]


def marker_places(board: Board, markers: Markers) -> tuple[Array, Array]:
    """Columns and rows of the lattice from the pad's centre, metres.

    Raises
    ------
    InputError
        The markers are scattered.
    """
    if markers.layout != "lattice":
        raise InputError(f"board {board.name!r} has scattered markers, and this needs a lattice: markers.layout")
    pad = board.pad
    x = markers.first_x_um + markers.pitch_x_um * np.arange(markers.n_x) - pad.size_x_um / 2
    y = markers.first_y_um + markers.pitch_y_um * np.arange(markers.n_y) - pad.size_y_um / 2
    return np.asarray(x * 1e-6, np.float64), np.asarray(y * 1e-6, np.float64)


class NodesOnLattice:
    """Catmull-Rom over the lattice along each axis, linear beyond its border for at most one pitch.

    `x` (nodes, columns) and `y` (nodes, rows): weights of all nodes of the pad.
    """

    def __init__(self, board: Board, markers: Markers) -> None:
        pad, grid = board.pad, board.grid
        node_x, node_y = (np.linspace(0, size, n) for size, n in ((pad.size_x_um, grid.n_x), (pad.size_y_um, grid.n_y)))
        self.x = _weights((node_x - markers.first_x_um) / markers.pitch_x_um, markers.n_x)
        self.y = _weights((node_y - markers.first_y_um) / markers.pitch_y_um, markers.n_y)

    def interpolate(self, u: Array) -> Array:
        """Of markers (rows, columns, k) at all nodes of the pad, (n_y, n_x, k)."""
        return np.asarray(np.einsum("aj,bi,jik->abk", self.y, self.x, u, optimize=True))


def _weights(position: Array, n_lines: int) -> Array:
    """Of each position, in pitches, on each lattice line, (n, n_lines)."""
    at = np.clip(position, -1, n_lines)
    base = np.clip(np.floor(at).astype(int), 0, n_lines - 2)
    t = at - base
    cubic = [
        (-t + 2 * t**2 - t**3) / 2,
        (2 - 5 * t**2 + 3 * t**3) / 2,
        (t + 4 * t**2 - 3 * t**3) / 2,
        (t**3 - t**2) / 2,
    ]
    linear = [0 * t, 1 - t, t, 0 * t]
    padded = np.zeros((len(t), n_lines + 2))  # one line more at either end: u_-1 = 2 u_0 - u_1
    for tap in range(4):
        padded[np.arange(len(t)), base + tap] = np.where((t >= 0) & (t <= 1), cubic[tap], linear[tap])
    padded[:, [1, 2]] += padded[:, :1] * [2, -1]
    padded[:, [-2, -3]] += padded[:, -1:] * [2, -1]
    return padded[:, 1:-1]
