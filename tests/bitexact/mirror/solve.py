"""Displacement -> nodal force: program and contact mask."""

from __future__ import annotations

import numpy as np

from mirror.fixed import I64, Saturations
from mirror.program import Program

FULL = 128  # a node of the contact mask that is surely touched


def linear_force(program: Program, u: I64, saturations: Saturations) -> I64:
    """(n_nodes, 3) in force steps, of (n_nodes, 3) displacements."""
    return saturations.int32(program.times(u.ravel())).reshape(-1, 3)


def contact_mask(force: I64, shape: tuple[int, int], threshold_lsb: int, min_nodes: int) -> I64:
    """How surely each node is touched, 0..128: grey opening by 2 x 2 nodes, grey growth by one."""
    beyond = np.clip(-force[:, 2].reshape(shape) - threshold_lsb, 0, threshold_lsb)
    pressed = -(-beyond * FULL // threshold_lsb)
    square = np.minimum(np.minimum(pressed[1:, 1:], pressed[:-1, 1:]), np.minimum(pressed[1:, :-1], pressed[:-1, :-1]))
    opened = np.zeros(shape, np.int64)
    for dy in (0, 1):
        for dx in (0, 1):
            at = np.s_[dy : dy + shape[0] - 1, dx : dx + shape[1] - 1]
            opened[at] = np.maximum(opened[at], square)
    if np.count_nonzero(opened) < min_nodes:
        return np.zeros(shape, np.int64)
    padded = np.pad(opened, 1)
    grown = [padded[dy : dy + shape[0], dx : dx + shape[1]] for dy in range(3) for dx in range(3)]
    return np.asarray(np.max(grown, axis=0))
