"""How far a board's depth gauge is off: what [depth] takes as zero sinks when something presses.

The images leave depth a free constant; the board makes the mean over the window's rim (or over all of it) zero. The rim
of an elastic pad moves a little with every touch, so each frame is off by minus that mean. How much follows from the
pad's own numbers: touches are simulated, and the root mean square of what the rim does is the uncertainty of the
constant. A gauge of the kinds `ruffini.estimators.operator.depth_gauge` says itself how far it is off.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from ruffini.boards import Board
from ruffini.estimators.operator.depth_gauge import fit_depth_gauge
from ruffini.estimators.operator.fit import Material, board_slab
from ruffini.fem.operators import Noise
from ruffini.fem.slab import Slab
from ruffini.fem.touches import TouchMaker

N_TOUCHES, SEED = 60, 1
USUAL = Noise((5e-6, 5e-6, 20e-6), tilt_m=30e-6)  # the defaults of cal operator
LEAST_M = 1e-6  # more than what the depth's own step and the picture's noise leave of a mean over the rim


def gauge_nodes(board: Board) -> npt.NDArray[np.bool_]:
    """Nodes of the pad that the gauge averages, (n_y, n_x)."""
    pad, grid, window = board.pad, board.grid, board.window
    x = np.linspace(0, pad.size_x_um, grid.n_x)
    y = np.linspace(0, pad.size_y_um, grid.n_y)[:, None]
    inside = np.minimum(
        np.minimum(x - window.min_x_um, window.max_x_um - x), np.minimum(y - window.min_y_um, window.max_y_um - y)
    )
    seen = inside >= 0
    rim = seen & (inside < board.depth.margin_um)
    return rim if board.depth.gauge == "margin" and rim.any() else seen


def gauge_uncertainty_m(board: Board, material: Material | None = None) -> float:
    """Root mean square over simulated touches of what the gauge leaves of the mean u_z, metres."""
    nodes, slab = gauge_nodes(board), board_slab(board, material)
    with threadpool_limits(limits=1):
        if board.depth.has_gauge_table:
            return fit_depth_gauge(board, slab, USUAL).gauge_m
        return max(_sunk_m(slab, nodes.tobytes()), LEAST_M)


@lru_cache(maxsize=4)  # a fit and its report ask for the same pad
def _sunk_m(slab: Slab, averaged: bytes) -> float:
    """Root mean square over simulated touches of the mean u_z of the nodes that are `averaged`, metres."""
    nodes = np.frombuffer(averaged, dtype=bool).reshape(slab.n_y, slab.n_x)
    touches = TouchMaker(slab, SEED)
    sunk = [float(touches.draw().displacement[nodes, 2].mean()) for _ in range(N_TOUCHES)]
    return float(np.sqrt(np.mean(np.square(sunk))))
