"""Radial profile of a flow about a given middle, in float (firmware/stages/contact_model/contact_profile.h).

What the core says of its own middle is what is fitted; this one is for middles a little beside, which the fit sees too,
since on the board the middle is off by a quarter of a millimetre.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board

Array = npt.NDArray[np.float64]

N_RINGS, N_ANGLES, RINGS_ACROSS = 16, 32, 36


def radial_um(board: Board, flow: Array, middle_um: Array) -> Array:
    """Mean radial flow (t, 16) um of flows (t, n) px about middles (t, 2) um from the pad's centre."""
    m = board.markers
    assert m is not None
    field = flow.reshape(-1, m.n_y, m.n_x, 2) * (1e3 * board.camera.standoff_um / board.camera.focal_mpx)
    angle = 2 * np.pi * np.arange(N_ANGLES) / N_ANGLES
    radius = (1 + np.arange(N_RINGS)) * (min(board.pad.size_x_um, board.pad.size_y_um) // RINGS_ACROSS)
    out = np.cos(angle), np.sin(angle)
    first = m.first_x_um - board.pad.size_x_um / 2, m.first_y_um - board.pad.size_y_um / 2
    at = [(middle_um[:, c, None, None] + radius[:, None] * out[c] - first[c]) / pitch
          for c, pitch in enumerate((m.pitch_x_um, m.pitch_y_um))]  # fmt: skip
    inside = (at[0] >= 0) & (at[0] <= m.n_x - 1) & (at[1] >= 0) & (at[1] <= m.n_y - 1)
    inside &= np.roll(inside, N_ANGLES // 2, axis=2)
    (i, wx), (j, wy) = (_catmull_rom(a, n) for a, n in zip(at, (m.n_x, m.n_y), strict=True))
    t = np.arange(len(field))[:, None, None]
    radial = np.zeros(at[0].shape)
    for q in range(4):
        for p in range(4):
            one = field[t, np.clip(j + q - 1, 0, m.n_y - 1), np.clip(i + p - 1, 0, m.n_x - 1)]
            radial += wy[..., q] * wx[..., p] * (one[..., 0] * out[0] + one[..., 1] * out[1])
    n = inside.sum(axis=2)
    return np.asarray(np.where(n > 0, (radial * inside).sum(axis=2) / np.maximum(n, 1), 0.0))


def _catmull_rom(at: Array, n: int) -> tuple[npt.NDArray[np.intp], Array]:
    """The line before each place, and the weights (..., 4) of the lines about it."""
    i = np.clip(np.floor(at), 0, n - 2).astype(np.intp)
    t = np.clip(at - i, 0, 1)
    return i, np.stack([(2 * t**2 - t - t**3) / 2, 1 + (3 * t**3 - 5 * t**2) / 2,
                        (t + 4 * t**2 - 3 * t**3) / 2, (t**3 - t**2) / 2], axis=-1)  # fmt: skip
