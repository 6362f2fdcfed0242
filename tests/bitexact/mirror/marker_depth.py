"""Depth from the markers' motion alone."""

from __future__ import annotations

from mirror.board import Board
from mirror.fixed import I64, Saturations
from mirror.pinhole_nodes import lift
from mirror.program import Program


def with_depth(board: Board, program: Program, seen: I64, saturations: Saturations) -> I64:
    """The displacement (node rows, node columns, 3) of one whose depth is zero, 1/8 um."""
    uz = saturations.int16(program.times(seen[..., :2].ravel())).reshape(seen.shape[:2])
    return lift(board, seen, uz, saturations)
