"""Direct solution of a slab's stiffness that knows no symmetry: planes across x are eliminated one after another.

A slab is thin, so planes across its longer side are small: 936 unknowns at the default mesh, where planes
along the surface have 5733. Single precision: it serves as the corrector of residuals in double.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg as la

Array = npt.NDArray[np.float64]
Kept = npt.NDArray[np.float32]
Indices = npt.NDArray[np.intp]


class SliceNodes:
    """Numbering of the planes across x of `n_cells_x` by `n_cells_y` by `n_layers` elements, the bottom left out."""

    def __init__(self, n_cells_x: int, n_cells_y: int, n_layers: int) -> None:
        self.n_cells_x, self.n_cells_y, self.n_layers = n_cells_x, n_cells_y, n_layers
        self.n_x, self.n_y, self.n_z = 2 * n_cells_x + 1, 2 * n_cells_y + 1, 2 * n_layers
        self.size = 3 * self.n_y * self.n_z
        k, j, c, b = np.meshgrid(np.arange(n_layers), np.arange(n_cells_y), np.arange(3), np.arange(3), indexing="ij")
        z = (2 * k + c - 1).reshape(-1, 9)  # -1: bonded
        node = z * self.n_y + (2 * j + b).reshape(-1, 9)
        dofs = (3 * node[:, :, None] + np.arange(3)).reshape(-1, 27)
        self._is_free = np.repeat(z >= 0, 3, axis=1)
        self._flat = dofs[:, :, None] * self.size + dofs[:, None, :]
        self._both_free = self._is_free[:, :, None] & self._is_free[:, None, :]
        self._flat = self._flat[self._both_free]

    def blocks(self, elements: list[Array], i: int) -> list[list[Kept]]:
        """Stiffness of slice i between its three planes, lower half [3][1..3], from element matrices of each layer."""
        shape = (self.n_cells_y, self.n_cells_x, 3, 3, 3, 3, 3, 3, 3, 3)  # y x | z y x axis | z y x axis
        part = np.concatenate([e.reshape(shape)[:, i] for e in elements])
        out = []
        for a in range(3):
            row = []
            for b in range(a + 1):
                values = part[:, :, :, a, :, :, :, b, :].reshape(-1, 27, 27)[self._both_free]
                row.append(np.bincount(self._flat, values, self.size**2).astype(np.float32).reshape(self.size, -1))
            out.append(row)
        return out

    def across(self, field: Array) -> Kept:
        """(planes, n, 3, ...) fields as (n_x, size, ...), the bottom plane left out."""
        by_axis = field[1:].reshape(self.n_z, self.n_y, self.n_x, 3, -1)
        return np.ascontiguousarray(by_axis.transpose(2, 0, 1, 3, 4).reshape(self.n_x, self.size, -1), np.float32)

    def back(self, values: Kept) -> Array:
        """What `across` gave as (planes, n, 3, m) again, zero at the bottom."""
        m = values.shape[-1]
        by_axis = values.reshape(self.n_x, self.n_z, self.n_y, 3, m).transpose(1, 2, 0, 3, 4)
        out = np.zeros((self.n_z + 1, self.n_y * self.n_x, 3, m))
        out[1:] = by_axis.reshape(self.n_z, -1, 3, m)
        return out


@dataclass
class _Slice:
    """Inverses of the left and middle plane, and what couples them to those right of them."""

    left: Kept
    middle: Kept
    left_to_middle: Kept
    left_to_right: Kept
    middle_to_right: Kept


class SliceFactor:
    """Factor of the stiffness of a slab of 27-node elements, from element matrices (n_y n_x, 81, 81) of each layer."""

    def __init__(self, nodes: SliceNodes, elements: list[Array]) -> None:
        self._nodes = nodes
        self._slices: list[_Slice] = []
        before: Kept | float = 0.0
        for i in range(nodes.n_cells_x):
            k = nodes.blocks(elements, i)
            left = _inverse(k[0][0] + before)
            half = left @ k[1][0].T
            middle = _inverse(k[1][1] - k[1][0] @ half)
            coupling = k[2][1] - k[2][0] @ half
            before = k[2][2] - k[2][0] @ (left @ k[2][0].T) - coupling @ (middle @ coupling.T)
            self._slices.append(_Slice(left, middle, k[1][0], k[2][0], coupling))
        self._last = _inverse(np.asarray(before))

    def solve(self, force: Array) -> Array:
        """Displacements (planes, n, 3) of forces (planes, n, 3); the bottom plane stays."""
        return np.asarray(self._nodes.back(self._solved(self._nodes.across(force)))[..., 0])

    def surface_columns(self, dofs: Indices) -> Array:
        """Displacements of the surface (3 n,) for a unit force at each of its `dofs` (3 n), as rows (m, 3 n)."""
        nodes = self._nodes
        node, axis = np.divmod(dofs, 3)
        y, x = np.divmod(node, nodes.n_x)
        r = np.zeros((nodes.n_x, nodes.size, len(dofs)), np.float32)
        r[x, 3 * ((nodes.n_z - 1) * nodes.n_y + y) + axis, np.arange(len(dofs))] = 1.0
        top = self._solved(r).reshape(nodes.n_x, nodes.n_z, nodes.n_y, 3, -1)[:, -1]
        return np.asarray(top.transpose(3, 1, 0, 2).reshape(len(dofs), -1), np.float64)

    def _solved(self, r: Kept) -> Kept:
        for i, s in enumerate(self._slices):
            left, middle, right = 2 * i, 2 * i + 1, 2 * i + 2
            r[left] = s.left @ r[left]
            r[middle] -= s.left_to_middle @ r[left]
            r[right] -= s.left_to_right @ r[left]
            r[middle] = s.middle @ r[middle]
            r[right] -= s.middle_to_right @ r[middle]
        r[-1] = self._last @ r[-1]
        for i, s in reversed(list(enumerate(self._slices))):
            left, middle, right = 2 * i, 2 * i + 1, 2 * i + 2
            r[middle] -= s.middle @ (s.middle_to_right.T @ r[right])
            r[left] -= s.left @ (s.left_to_middle.T @ r[middle] + s.left_to_right.T @ r[right])
        return r


def _inverse(matrix: Kept) -> Kept:
    """Inverse of a symmetric matrix in single precision; a tangent may lose its definiteness under large strain."""
    factor, info = la.lapack.spotrf(matrix, lower=1)
    if info != 0:
        return np.asarray(la.inv(matrix.astype(np.float64)), np.float32)
    lower, _ = la.lapack.spotri(factor, lower=1)
    return np.asarray(np.tril(lower) + np.tril(lower, -1).T)
