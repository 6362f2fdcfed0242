"""Multi-layer inverse FEM: "iFEM2.0: Dense 3D Contact Force Field Reconstruction and Assessment for Vision-based
Tactile Sensors" (Zhao, Liu, Ma).

The pad is a slab of n_e layers of 8-node hexahedra (2 x 2 x 2 Gauss points), bonded below and free at the sides. With
node layers 1 (surface), 2, ... the layers from 3 on are condensed into 2, and
    eq. (1)  K22 U2 = -K21 U1,  F1 = K11 U1 + K12 U2
    eq. (2)  U2 = (K22^T K22 + w I)^-1 K22^T (-K21 U1 + n0)
The paper says neither how many layers nor what w it uses, and n0, "the noise level", has no value: it is 0 here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg as la

Array = npt.NDArray[np.float64]

_CORNERS = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=float)  # z up


@dataclass(frozen=True)
class Slab:
    """Size (m), material and mesh of the pad."""

    size_m: tuple[float, float, float]
    modulus_pa: float
    poisson: float
    n_x: int  # nodes along x
    n_y: int
    n_layers: int  # of elements


def hexahedron(step_m: Array, modulus_pa: float, poisson: float) -> Array:
    """Stiffness of an 8-node brick, (24, 24)."""
    lame = modulus_pa * poisson / ((1 + poisson) * (1 - 2 * poisson))
    shear = modulus_pa / (2 * (1 + poisson))
    elastic = np.diag([2 * shear] * 3 + [shear] * 3)
    elastic[:3, :3] += lame
    out = np.zeros((24, 24))
    for point in _CORNERS / np.sqrt(3):
        part = 1 + _CORNERS * point
        slope = np.stack(
            [_CORNERS[:, i] * np.prod(np.delete(part, i, axis=1), axis=1) / 8 * 2 / step_m[i] for i in range(3)]
        )
        b = np.zeros((6, 8, 3))
        for i in range(3):
            b[i, :, i] = slope[i]
        for row, (i, j) in enumerate(((0, 1), (1, 2), (2, 0)), 3):
            b[row, :, i], b[row, :, j] = slope[j], slope[i]
        strain = b.reshape(6, 24)
        out += strain.T @ elastic @ strain * np.prod(step_m) / 8
    return out


def _layer(slab: Slab) -> tuple[Array, Array, Array]:
    """Stiffness of one element layer between its lower and its upper nodes: lower-lower, upper-lower, upper-upper."""
    step = np.array(slab.size_m) / (slab.n_x - 1, slab.n_y - 1, slab.n_layers)
    element = hexahedron(step, slab.modulus_pa, slab.poisson).reshape(2, 12, 2, 12)
    n = 3 * slab.n_x * slab.n_y
    blocks = [np.zeros((n, n)) for _ in range(3)]
    for j in range(slab.n_y - 1):
        for i in range(slab.n_x - 1):
            corner = j * slab.n_x + i
            nodes = np.array([corner, corner + 1, corner + slab.n_x, corner + slab.n_x + 1])
            dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
            for block, (a, b) in zip(blocks, ((0, 0), (1, 0), (1, 1)), strict=True):
                block[np.ix_(dofs, dofs)] += element[a, :, b]
    return blocks[0], blocks[1], blocks[2]


@dataclass(frozen=True)
class InverseFem:
    """The condensed slab: K11, K12 and K22 of the paper's equations, each (3 n, 3 n)."""

    k11: Array
    k12: Array
    k22: Array

    @classmethod
    def of(cls, slab: Slab) -> InverseFem:
        """Condense node layer after node layer from the bonded bottom up to the second."""
        lower, coupling, upper = _layer(slab)
        below = upper  # stiffness of the nodes on top of the lowest element layer; its bottom is bonded
        for _ in range(slab.n_layers - 2):
            below = upper - coupling @ la.solve(lower + below, coupling.T, assume_a="pos")
        return cls(upper, coupling, lower + below)

    def raw(self) -> Array:
        """F1 = G U1 by eq. (1), (3 n, 3 n)."""
        return self._forces(la.solve(self.k22, -self.k12.T, assume_a="pos"))

    def ridge(self, weights: tuple[float, ...]) -> list[Array]:
        """F1 = G U1 by eq. (2), for each w = weight times the square of K22's largest eigenvalue."""
        values, vectors = la.eigh(self.k22)
        rhs = vectors.T @ -self.k12.T
        gains = [values / (values**2 + weight * values[-1] ** 2) for weight in weights]
        return [self._forces(vectors @ (gain[:, None] * rhs)) for gain in gains]

    def _forces(self, second: Array) -> Array:
        return np.asarray(self.k11 + self.k12 @ second)
