"""Depth from the markers' motion alone."""

from __future__ import annotations

import numpy as np

from mirror.board import Board, observed_nodes
from mirror.fixed import I64, Saturations
from mirror.program import Program


def _places_q3(board: Board, axis: str) -> I64:
    """Observed node lines from the pad's centre, 1/8 um."""
    steps = board["grid"][f"n_{axis}"] - 1
    return np.array(
        [4 * (2 * i - steps) * board["pad"][f"size_{axis}_um"] // steps for i in observed_nodes(board, axis)]
    )


def with_depth(board: Board, program: Program, seen: I64, saturations: Saturations) -> I64:
    """The displacement (node rows, node columns, 3) of one whose depth is zero, 1/8 um."""
    standoff = 8 * board["camera"]["standoff_um"]
    uz = saturations.int16(program.times(seen[..., :2].ravel())).reshape(seen.shape[:2])
    place = np.stack(np.meshgrid(_places_q3(board, "x"), _places_q3(board, "y")), axis=-1)
    hidden = (2 * (place + seen[..., :2]) * uz[..., None] + standoff) // (2 * standoff)
    return np.concatenate([saturations.int16(seen[..., :2] + hidden), uz[..., None]], axis=-1)
