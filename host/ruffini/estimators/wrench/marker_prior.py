"""What the pad's mechanics says of a wrench from the shifts of its markers: a K before any log was taken.

The optimal inverse-FEM operator of the board (`fem.operators`), for shifts along x and y alone, on displacements
interpolated from the markers; forces and moments of its nodal forces are summed about the pad's centre. The log decides
by how much each axis goes with it, and what the markers say besides.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from ruffini.boards import Board
from ruffini.estimators.operator.error_model import node_places
from ruffini.estimators.operator.fit import board_slab, board_window_m
from ruffini.estimators.wrench.model import TO_NMM
from ruffini.fem.operators import Noise, force_operator

Array = npt.NDArray[np.float64]

Q16 = 65536.0
SHIFT_NOISE_M = 5e-6
UNSEEN_M = 1e-2  # along z: nobody measures it
REACH_PITCH = 0.6  # of a marker's say, standard deviation


def marker_prior(board: Board) -> Array | None:
    """K (6, n) of markers' shifts, N and N mm a raw unit; None where the board does not say where they are."""
    markers = board.markers
    is_listed = markers is not None and (markers.layout != "scattered" or markers.places_um is not None)
    if not is_listed or not board.writes("markers"):
        return None
    slab = board_slab(board)
    places = node_places(slab, board.observed)
    with threadpool_limits(limits=1):
        noise = Noise((SHIFT_NOISE_M, SHIFT_NOISE_M, UNSEEN_M))
        operator = force_operator(slab, "optimal", noise=noise, window_m=board_window_m(board))
    n_y, n_x = len(places.y_m), len(places.x_m)
    weight = _weights(board, places.x_m, places.y_m)
    metres = board.camera.standoff_um * 1e-3 / board.camera.focal_mpx / Q16  # a raw unit at the surface
    out = np.zeros((6, 2 * weight.shape[1]))
    summed = _summed(n_x * n_y, places.x_m, places.y_m) @ operator
    for axis in (0, 1):
        out[:, axis::2] = summed[:, axis::3] @ weight * metres
    return np.asarray(out * TO_NMM[:, None])


def _summed(n: int, x_m: Array, y_m: Array) -> Array:
    """Force and moment of nodal forces, (6, 3 n)."""
    x, y = np.tile(x_m, len(y_m)), np.repeat(y_m, len(x_m))
    out = np.zeros((6, 3 * n))
    for axis in range(3):
        out[axis, axis::3] = 1
    out[3, 2::3], out[4, 2::3] = y, -x
    out[5, 1::3], out[5, 0::3] = x, -y
    return out


def _weights(board: Board, x_m: Array, y_m: Array) -> Array:
    """Displacement of nodes from that of markers: normalised bells, (nodes, markers)."""
    m = board.markers
    assert m is not None
    if m.layout == "scattered":
        at = np.array(m.places_um, dtype=float)
    else:
        x, y = np.meshgrid(
            m.first_x_um + m.pitch_x_um * np.arange(m.n_x), m.first_y_um + m.pitch_y_um * np.arange(m.n_y)
        )
        at = np.column_stack([x.ravel(), y.ravel()])
    at = (at - np.array([board.pad.size_x_um, board.pad.size_y_um]) / 2) * 1e-6
    reach = REACH_PITCH * 1e-6 * max(m.pitch_x_um, m.pitch_y_um)
    nodes = np.column_stack([np.tile(x_m, len(y_m)), np.repeat(y_m, len(x_m))])
    away2 = np.square(nodes[:, None, :] - at[None, :, :]).sum(axis=-1) / (2 * reach**2)
    weight = np.exp(away2.min(axis=1, keepdims=True) - away2)  # the nearest one counts even far outside
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))
