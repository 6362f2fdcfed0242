"""What the board sees in a flow, in float: firmware/stages/contact_model/contact_profile.h has the equations."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board

Array = npt.NDArray[np.float64]

MIDDLE_PART = 0.3  # of the largest fall: the contact's middle is that of what lies above


def flow_um(board: Board, flow_px: Array) -> Array:
    """(n_y, n_x, 2)."""
    assert board.markers is not None
    scale = 1e3 * board.camera.standoff_um / board.camera.focal_mpx
    return np.asarray(flow_px.reshape(board.markers.n_y, board.markers.n_x, 2) * scale)


def fall_of(board: Board, flow: Array) -> Array:
    """Smoothed fall of the density at each patch; flow (n_y, n_x, 2) um."""
    assert board.markers is not None
    raw = np.zeros(flow.shape[:2])
    raw[1:-1, 1:-1] = (flow[1:-1, 2:, 0] - flow[1:-1, :-2, 0]) / (2 * board.markers.pitch_x_um)
    raw[1:-1, 1:-1] += (flow[2:, 1:-1, 1] - flow[:-2, 1:-1, 1]) / (2 * board.markers.pitch_y_um)
    return smoothed(raw, 1)


def smoothed(plane: Array, times: int) -> Array:
    """By (1 2 1) both ways, borders repeated."""
    for _ in range(times):
        edged = np.pad(plane, 1, mode="edge")
        along = edged[:, :-2] + 2 * edged[:, 1:-1] + edged[:, 2:]
        plane = (along[:-2] + 2 * along[1:-1] + along[2:]) / 16
    return plane


def center_of(board: Board, fall: Array) -> Array:
    """The contact's middle (2,) um from the pad's centre."""
    weight = np.maximum(fall - MIDDLE_PART * max(float(fall.max()), 0.0), 0.0)
    total = float(weight.sum())
    if total <= 0:
        return np.zeros(2)
    x, y = patch_places(board)
    return np.array([float((weight * x[None, :]).sum()), float((weight * y[:, None]).sum())]) / total


def patch_places(board: Board) -> tuple[Array, Array]:
    """x of the lattice's columns and y of its rows, um from the pad's centre."""
    m = board.markers
    assert m is not None
    x, y = (
        np.asarray(first + pitch * np.arange(n) - size / 2, dtype=np.float64)
        for first, pitch, n, size in (
            (m.first_x_um, m.pitch_x_um, m.n_x, board.pad.size_x_um),
            (m.first_y_um, m.pitch_y_um, m.n_y, board.pad.size_y_um),
        )
    )
    return x, y
