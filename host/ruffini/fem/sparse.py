"""The iFEM 2.0 paper's sparse variant: an L1 in place of the L2 penalty of eq. (2).

    minimise over U_2   1/2 |K_21 U_1 + K_22 U_2|^2 + w |U_2|_1,   F_1 = K_11 U_1 + K_12 U_2

The paper names it without writing it out; this is the plain reading. Not linear in U_1: a reference
for the benchmark, solved by FISTA (Beck and Teboulle 2009), not an operator for the board.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from ruffini.fem.condense import CondensedSlab
from ruffini.reflection import dense_from_blocks

Array = npt.NDArray[np.float64]

N_STEPS = 150


class SparseEstimator:
    """`weight` is w as a fraction of max |K_22^T K_21 U_1|, above which U_2 is zero."""

    def __init__(self, condensed: CondensedSlab) -> None:
        bases = condensed.bases
        self._k_11 = dense_from_blocks(bases, condensed.k_11)
        self._k_12 = dense_from_blocks(bases, [sp.csr_matrix(k).toarray() for k in condensed.k_12])
        k_22 = dense_from_blocks(bases, condensed.k_22)
        self._normal = k_22.T @ k_22
        self._project = k_22.T @ self._k_12.T
        self._step = 1.0 / max(float(np.linalg.eigvalsh(k)[-1]) for k in condensed.k_22) ** 2

    def force(self, displacement_m: Array, weight: float) -> Array:
        """Surface displacements (3 n, m), metres, one column each -> nodal forces (3 n, m), newtons."""
        right = -self._project @ displacement_m
        threshold = self._step * weight * np.abs(right).max(axis=0)
        u = np.zeros_like(right)
        ahead, momentum = u, 1.0
        for _ in range(N_STEPS):
            moved = ahead - self._step * (self._normal @ ahead - right)
            after = np.sign(moved) * np.maximum(np.abs(moved) - threshold, 0.0)
            next_momentum = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
            ahead = after + (momentum - 1) / next_momentum * (after - u)
            u, momentum = after, next_momentum
        return np.asarray(self._k_11 @ displacement_m + self._k_12 @ u)
