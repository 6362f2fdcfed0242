"""A function of three colour changes on a lattice, fitted as the table that the board reads.

Trilinear between the nodes; where presses say little the fit is held straight by the lattice's second differences
(thin plate), so that it runs on linearly beyond their colours. What is fitted is the table: tabulating loses nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse

Array = npt.NDArray[np.float64]

N_LINES = 9  # firmware: PhotometricTable::kBendSize
ONE_Q12 = 4096
SHIFTS = range(6, 12)  # step between two lines, 2^shift of Q12
STRAIGHT_AT_REST = 1e5
COVERED = 0.001  # share of the pixels that may lie beyond either end


@dataclass(frozen=True)
class ColourAxis:
    """Per channel the change at the first line and the shift to the next, Q12; no change is a node."""

    low_q12: npt.NDArray[np.int32]
    shift: npt.NDArray[np.int32]

    @classmethod
    def covering(cls, change: Array) -> ColourAxis:
        """The finest lines that hold (n, 3) changes and zero."""
        low, high = np.quantile(change, [COVERED, 1 - COVERED], axis=0) * ONE_Q12
        chosen = [_lines(min(a, 0.0), max(b, 0.0)) for a, b in zip(low, high, strict=True)]
        return cls(np.array([c[0] for c in chosen], np.int32), np.array([c[1] for c in chosen], np.int32))

    def tensor(self) -> npt.NDArray[np.int32]:
        """`photometric.bend_axis`."""
        return np.stack([self.low_q12, self.shift])

    def zero(self) -> int:
        """The node of no change."""
        line = -self.low_q12 // (1 << self.shift)
        return int((line[0] * N_LINES + line[1]) * N_LINES + line[2])

    def weights(self, change: Array) -> sparse.csr_matrix:
        """(n, nodes): the trilinear weights of (n, 3) changes; beyond the lattice its border's."""
        nodes, values = self._corners(change)
        first = np.arange(0, nodes.size + 1, 8)
        shape = (len(change), N_LINES**3)
        return sparse.csr_matrix((values.T.ravel(), nodes.T.ravel().astype(np.int32), first), shape=shape)

    def value(self, change: Array, at_nodes: Array) -> Array:
        """`weights(change) @ at_nodes`, of (nodes, k)."""
        out = np.zeros((len(change), at_nodes.shape[1]))
        for node, value in zip(*self._corners(change), strict=True):
            out += value[:, None] * at_nodes[node]
        return out

    def _corners(self, change: Array) -> tuple[npt.NDArray[np.int64], Array]:
        """The eight nodes around each change, rising, and their weights, (8, n)."""
        at = np.clip((change * ONE_Q12 - self.low_q12) / (1 << self.shift), 0, N_LINES - 1).T
        line = np.minimum(at.astype(np.int64), N_LINES - 2)
        sides = np.stack([1 - (at - line), at - line])
        nodes, values = [], []
        for i, j, k in np.ndindex(2, 2, 2):
            nodes.append(((line[0] + i) * N_LINES + line[1] + j) * N_LINES + line[2] + k)
            values.append(sides[i, 0] * sides[j, 1] * sides[k, 2])
        return np.stack(nodes), np.stack(values)


def _lines(low: float, high: float) -> tuple[int, int]:
    for shift in SHIFTS:
        below, above = int(np.ceil(-low / (1 << shift))), int(np.ceil(high / (1 << shift)))
        if below + above <= N_LINES - 1:
            below += (N_LINES - 1 - below - above) // 2
            return -below << shift, shift
    return -(N_LINES // 2) << SHIFTS[-1], SHIFTS[-1]


def bending(zero: int) -> Array:
    """(nodes, nodes): the sum of squares of all second differences, straight and mixed.

    Those across the node `zero` weigh STRAIGHT_AT_REST times as much: a bend there would make slopes of the noise of
    untouched pictures, all of one sign, and their sum a tilt.
    """
    line = sparse.identity(N_LINES)
    second = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(N_LINES - 2, N_LINES))
    first = sparse.diags([-1.0, 1.0], [0, 1], shape=(N_LINES - 1, N_LINES))
    total = np.zeros((N_LINES**3, N_LINES**3))
    for along in range(3):
        straight, mixed = [line] * 3, [first] * 3
        straight[along], mixed[along] = second, line
        for parts, times in ((straight, 1.0), (mixed, 2.0)):
            operator = sparse.kron(sparse.kron(parts[0], parts[1]), parts[2])
            total += times * (operator.T @ operator).toarray()
        step = N_LINES ** (2 - along)
        if 0 < zero // step % N_LINES < N_LINES - 1:
            across = np.zeros(N_LINES**3)
            across[[zero - step, zero, zero + step]] = 1.0, -2.0, 1.0
            total += STRAIGHT_AT_REST * np.outer(across, across)
    return total
