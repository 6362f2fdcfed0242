"""board.toml as a mapping, and the few lengths that several stages derive from it."""

from __future__ import annotations

from typing import Any

import tomllib

Board = dict[str, Any]


def read_board(text: str) -> Board:
    return tomllib.loads(text)


def length_q16(board: Board, um: int) -> int:
    """Image length, Q16 px, of a length in the undeformed surface."""
    camera = board["camera"]
    return int(um * camera["focal_mpx"] * 65536 // (camera["standoff_um"] * 1000))


def center_q16(board: Board, axis: str) -> int:
    return int((board["camera"][f"center_{axis}_mpx"] * 65536 + 500) // 1000)


def observed_nodes(board: Board, axis: str) -> range:
    """Indices, over the whole pad's grid, of the node lines inside the window."""
    steps = board["grid"][f"n_{axis}"] - 1
    size = board["pad"][f"size_{axis}_um"]
    window = board["window"]
    inside = [
        i for i in range(steps + 1) if window[f"min_{axis}_um"] * steps <= i * size <= window[f"max_{axis}_um"] * steps
    ]
    return range(inside[0], inside[-1] + 1)


def depth_grid(board: Board) -> tuple[int, int]:
    """Rows and columns of the depth grid."""
    step = board["depth"]["step_px"]
    return board["camera"]["height_px"] // step, board["camera"]["width_px"] // step
