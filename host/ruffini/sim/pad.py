"""Linear elastic pad of 27-node triquadratic hexahedra: compliance of its surface.

The bottom is bonded, the sides are free. Element layers get thinner towards the surface. Planes are
eliminated from the bottom in the four reflection classes of `ruffini.reflection`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg as la
import scipy.sparse as sp
from threadpoolctl import ThreadpoolController

from ruffini.reflection import dense_from_blocks, parity_bases, spd_inverse

Array = npt.NDArray[np.float64]

# On a busy machine several BLAS threads wait for each other and cost up to ten times more than they bring.
BLAS = ThreadpoolController()

# Thickness of the quadratic element layers, from the surface down, as fractions of the pad.
LAYERS = (0.14, 0.19, 0.29, 0.38)


@dataclass(frozen=True)
class PadModel:
    """A pad and its discretisation: `n_cells_x` by `n_cells_y` quadratic elements a layer; SI units."""

    size_x_m: float
    size_y_m: float
    thickness_m: float
    modulus_pa: float
    poisson: float
    n_cells_x: int = 24
    n_cells_y: int = 19
    layers: tuple[float, ...] = LAYERS

    @property
    def shape(self) -> tuple[int, int]:
        """Surface nodes (n_y, n_x)."""
        return 2 * self.n_cells_y + 1, 2 * self.n_cells_x + 1

    def node_x(self) -> Array:
        """Node columns from the pad's centre, metres, (n_x,)."""
        return np.linspace(-self.size_x_m / 2, self.size_x_m / 2, self.shape[1])

    def node_y(self) -> Array:
        """Node rows from the pad's centre, metres, (n_y,)."""
        return np.linspace(-self.size_y_m / 2, self.size_y_m / 2, self.shape[0])


def quadratic_shapes(point: float) -> tuple[Array, Array]:
    """Quadratic shape functions on nodes -1, 0, 1 and their derivatives at `point`."""
    t = point
    return (
        np.array([t * (t - 1) / 2, 1 - t * t, t * (t + 1) / 2]),
        np.array([t - 0.5, -2 * t, t + 0.5]),
    )


def element_stiffness(step_m: tuple[float, float, float], modulus_pa: float, poisson: float) -> Array:
    """Stiffness of one 27-node brick with edges `step_m`, (81, 81); nodes z slow, y, x fast, xyz inside."""
    lame = modulus_pa * poisson / ((1 + poisson) * (1 - 2 * poisson))
    shear = modulus_pa / (2 * (1 + poisson))
    points, weights = np.polynomial.legendre.leggauss(3)
    volume = np.prod(step_m) / 8
    out = np.zeros((27, 3, 27, 3))
    eye = np.eye(3)
    for k, wz in zip(points, weights, strict=True):
        for j, wy in zip(points, weights, strict=True):
            for i, wx in zip(points, weights, strict=True):
                (x, dx), (y, dy), (z, dz) = quadratic_shapes(i), quadratic_shapes(j), quadratic_shapes(k)
                g = np.stack(
                    [
                        np.einsum("c,b,a->cba", z, y, dx).ravel() * 2 / step_m[0],
                        np.einsum("c,b,a->cba", z, dy, x).ravel() * 2 / step_m[1],
                        np.einsum("c,b,a->cba", dz, y, x).ravel() * 2 / step_m[2],
                    ],
                    axis=1,
                )
                # lame div div + shear (grad : grad + grad : grad^T)
                part = lame * np.einsum("mi,nj->minj", g, g) + shear * (
                    np.einsum("mk,nk,ij->minj", g, g, eye) + np.einsum("mj,ni->minj", g, g)
                )
                out += wx * wy * wz * volume * part
    return out.reshape(81, 81)


def _plane_matrices(model: PadModel, thickness_m: float) -> list[list[sp.csr_matrix]]:
    """Stiffness of one element layer between its three node planes (bottom, middle, top): [3][3]."""
    n_y, n_x = model.shape
    step = (model.size_x_m / model.n_cells_x, model.size_y_m / model.n_cells_y, thickness_m)
    element = element_stiffness(step, model.modulus_pa, model.poisson).reshape(3, 27, 3, 27)
    cell_x, cell_y = np.meshgrid(np.arange(model.n_cells_x), np.arange(model.n_cells_y))
    corner = (2 * cell_y * n_x + 2 * cell_x).ravel()
    local = (np.arange(3)[:, None] * n_x + np.arange(3)).ravel()
    dofs = (3 * (corner[:, None] + local)[:, :, None] + np.arange(3)).reshape(len(corner), 27)
    rows, columns = np.repeat(dofs, 27, axis=1).ravel(), np.tile(dofs, (1, 27)).ravel()
    size = 3 * n_x * n_y
    return [
        [
            sp.csr_matrix((np.tile(element[a, :, b].ravel(), len(corner)), (rows, columns)), shape=(size, size))
            for b in range(3)
        ]
        for a in range(3)
    ]


def eliminate(q: sp.csr_matrix, layers: list[list[list[sp.csr_matrix]]]) -> Array:
    """Compliance of the last plane of nodes for displacements with basis `q`; the first plane is bonded.

    `layers` from the bonded side on, each with its stiffness between its three planes, [3][3].
    """
    below: Array | None = None
    for planes in layers:

        def between(a: int, b: int, planes: list[list[sp.csr_matrix]] = planes) -> sp.csr_matrix:
            return (q.T @ planes[a][b] @ q).tocsr()

        middle, top, coupling = between(1, 1).toarray(), between(2, 2).toarray(), between(2, 1).toarray()
        if below is not None:  # eliminate the bottom plane; in the first layer it is bonded
            inverse = spd_inverse(between(0, 0).toarray() + below).T  # symmetric: as rows, which products read
            to_middle, to_top = between(1, 0), between(2, 0)
            half = (to_middle @ inverse).T  # inverse @ K_bm
            middle -= to_middle @ half
            coupling -= to_top @ half
            top -= to_top @ (to_top @ inverse).T
        root = la.solve_triangular(la.cholesky(middle, lower=True), coupling.T, lower=True)
        below = top - root.T @ root
    assert below is not None
    return spd_inverse(below)


def surface_compliance(model: PadModel, *, progress: Callable[[float], None] = lambda _: None) -> Array:
    """Surface displacement per unit nodal force, (3 n, 3 n), metre per newton; node by node, xyz inside."""
    n_y, n_x = model.shape
    bases = parity_bases(n_x, n_y)
    layers = [_plane_matrices(model, f * model.thickness_m) for f in reversed(model.layers)]
    blocks = []
    with BLAS.limit(limits=1), ThreadPoolExecutor(min(len(bases), os.cpu_count() or 1)) as pool:
        for block in pool.map(eliminate, bases, [layers] * len(bases)):
            blocks.append(block)
            progress(len(blocks) / len(bases))
        return dense_from_blocks(bases, blocks)
