"""Wrench and contacts: exact sums of the nodal forces."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.block_float import limited
from mirror.board import Board, observed_nodes
from mirror.fixed import I64, Saturations


def grid_steps(board: Board, axis: str) -> tuple[I64, int, int]:
    """Twice the steps of each observed line from the pad's centre; pad size and steps over it."""
    steps = board["grid"][f"n_{axis}"] - 1
    lines = np.array(observed_nodes(board, axis), dtype=np.int64)
    return 2 * lines - steps, board["pad"][f"size_{axis}_um"], steps


def to_um(total: int, size: int, steps: int) -> int:
    return int((total * size + steps) // (2 * steps))


def wrench(board: Board, force: I64) -> list[int]:
    """Force (uN) and moment about the pad's centre (uN um) of (n_nodes, 3) forces."""
    x, size_x, steps_x = grid_steps(board, "x")
    y, size_y, steps_y = grid_steps(board, "y")
    lsb = board["field"]["force_lsb_un"]
    f = force.reshape(len(y), len(x), 3)

    def arm_x(component: int) -> int:
        return to_um(int((f[..., component] * x[None, :]).sum()) * lsb, size_x, steps_x)

    def arm_y(component: int) -> int:
        return to_um(int((f[..., component] * y[:, None]).sum()) * lsb, size_y, steps_y)

    total = [int(t) * lsb for t in force.sum(axis=0)]
    return [*total, arm_y(2), -arm_x(2), arm_x(1) - arm_y(0)]


def moved_arms(board: Board, force: I64, u: I64, saturations: Saturations) -> list[int]:
    """Moment (uN um) that forces (n_nodes, 3) gain by the nodes' displacement (n_nodes, 3), as Python's integers."""
    lsb = board["field"]["force_lsb_un"]
    limit = (1 << 61) // lsb
    arms = np.cross(u.reshape(-1, 3).astype(object), force.reshape(-1, 3).astype(object)).sum(axis=0)
    return [limited((int(a) + 4) >> 3, saturations, limit) * lsb for a in arms]


def contact_areas(board: Board, mask: npt.NDArray[np.bool_], force: I64) -> list[int]:
    """Pressing nodes of each 8-connected component of the mask, most first."""
    pressing = (force[:, 2] < 0).reshape(mask.shape)
    seen = np.zeros(mask.shape, bool)
    areas = []
    for start in zip(*np.nonzero(mask), strict=True):
        if seen[start]:
            continue
        component, stack = 0, [start]
        seen[start] = True
        while stack:
            y, x = stack.pop()
            component += int(pressing[y, x])
            for v in range(max(y - 1, 0), min(y + 2, mask.shape[0])):
                for u in range(max(x - 1, 0), min(x + 2, mask.shape[1])):
                    if mask[v, u] and not seen[v, u]:
                        seen[v, u] = True
                        stack.append((v, u))
        areas.append(component)
    return sorted(areas, reverse=True)


def reaches_border(board: Board, force: I64) -> bool:
    """A node of the window's outermost line presses above the threshold, and the pad goes on beyond that line."""
    threshold = max(board["contact"]["threshold_un"] // board["field"]["force_lsb_un"], 1)
    y, x = (observed_nodes(board, axis) for axis in "yx")
    pressing = force[:, 2].reshape(len(y), len(x)) < -threshold
    sides = (
        (y[0] > 0, pressing[0]), (y[-1] < board["grid"]["n_y"] - 1, pressing[-1]),
        (x[0] > 0, pressing[:, 0]), (x[-1] < board["grid"]["n_x"] - 1, pressing[:, -1]),
    )  # fmt: skip
    return any(goes_on and bool(line.any()) for goes_on, line in sides)
