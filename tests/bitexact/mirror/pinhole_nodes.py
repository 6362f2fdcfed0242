"""What nearness does to where the pinhole sees the nodes."""

from __future__ import annotations

import numpy as np

from mirror.board import Board, observed_nodes
from mirror.fixed import I64, Saturations


def _places_q3(board: Board, axis: str) -> I64:
    """Observed node lines from the pad's centre, 1/8 um."""
    steps = board["grid"][f"n_{axis}"] - 1
    return np.array(
        [4 * (2 * i - steps) * board["pad"][f"size_{axis}_um"] // steps for i in observed_nodes(board, axis)]
    )


def lift(board: Board, u: I64, c: I64, saturations: Saturations) -> I64:
    """Displacement (node rows, node columns, 3), 1/8 um, of nodes whose depth was taken for `c` too little."""
    standoff = 8 * board["camera"]["standoff_um"]
    place = np.stack(np.meshgrid(_places_q3(board, "x"), _places_q3(board, "y")), axis=-1)
    hidden = (2 * (place + u[..., :2]) * c[..., None] + standoff) // (2 * standoff)
    return np.concatenate(
        [saturations.int16(u[..., :2] + hidden), saturations.int16(u[..., 2] + c)[..., None]], axis=-1
    )
