"""A bonded neo-Hookean block under a centred patch of dead pressure, solved another way than the twin does.

A quarter of it, 8-node bricks, an assembled sparse tangent and Newton's method to rounding; two meshes and
Richardson's extrapolation. For moderate Poisson's ratios: such bricks lock near 0.5.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from ruffini.errors import RuffiniError

Array = npt.NDArray[np.float64]

GAUSS = 1 / np.sqrt(3)
LOAD_STEPS = 4
MAX_NEWTON = 12


@dataclass(frozen=True)
class Block:
    """Half sides (m, a square), thickness (m), half side of the loaded square (m), modulus (Pa), Poisson's ratio."""

    half_m: float
    thickness_m: float
    patch_m: float
    modulus_pa: float
    poisson: float

    def centre_depth(self, pressure_pa: float, n: int) -> float:
        """How deep (m) the middle of the surface goes, extrapolated from n and 2 n bricks along the half side."""
        coarse, fine = (self._solved(pressure_pa, m) for m in (n, 2 * n))
        return fine + (fine - coarse) / 3

    def _solved(self, pressure_pa: float, n: int) -> float:
        grid, cells, step = self._mesh(n)
        number = len(grid)
        fixed = np.zeros((number, 3), bool)
        fixed[grid[:, 2] == 0] = True
        for c in (0, 1):
            fixed[grid[:, c] == 0, c] = True  # planes of symmetry
        free = np.flatnonzero(~fixed.ravel())
        load = self._load(grid, cells, step, n)
        g, volume = _gradients(step)
        rows = (3 * cells[:, :, None] + np.arange(3)).reshape(len(cells), 24)
        u = np.zeros((number, 3))
        for part in np.arange(1, LOAD_STEPS + 1) / LOAD_STEPS:
            for _ in range(MAX_NEWTON):
                force, tangent = self._element(u[cells], g, volume)
                total = np.bincount(rows.ravel(), force.ravel(), 3 * number)
                lack = (part * pressure_pa * load.ravel() - total)[free]
                if np.abs(lack).max() < 1e-9 * pressure_pa * np.abs(load).max():
                    break
                index = (np.repeat(rows, 24, axis=1).ravel(), np.tile(rows, (1, 24)).ravel())
                k = sp.csc_matrix((tangent.ravel(), index), shape=(3 * number, 3 * number))[free][:, free]
                u.ravel()[free] += sla.spsolve(k, lack, permc_spec="MMD_AT_PLUS_A")
            else:
                raise RuffiniError("the block that the twin is compared with found no equilibrium: press it less")
        middle = np.flatnonzero((grid[:, 0] == 0) & (grid[:, 1] == 0) & (grid[:, 2] == grid[:, 2].max()))[0]
        return -float(u[middle, 2])

    def _mesh(self, n: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], Array]:
        """Nodes by their integer places (number, 3), bricks (m, 8), size of a brick."""
        n_z = max(2, round(n * self.thickness_m / self.half_m))
        sides = np.array([n + 1, n + 1, n_z + 1])
        grid = np.stack(np.meshgrid(*(np.arange(s) for s in sides), indexing="ij"), axis=-1).reshape(-1, 3)
        first = grid[(grid < sides - 1).all(axis=1)]
        corners = first[:, None] + np.array(list(itertools.product((0, 1), repeat=3)))
        cells = np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), tuple(sides))
        return grid, np.asarray(cells), np.array([self.half_m / n, self.half_m / n, self.thickness_m / n_z])

    def _load(self, grid: npt.NDArray[np.intp], cells: npt.NDArray[np.intp], step: Array, n: int) -> Array:
        """Nodal forces of unit pressure on the patch, (number, 3)."""
        loaded = round(n * self.patch_m / self.half_m)
        out, top = np.zeros((len(grid), 3)), grid[:, 2].max()
        for brick in cells:
            face = brick[grid[brick, 2] == top]
            if len(face) and (grid[face, :2].max(axis=0) <= loaded).all():
                out[face, 2] -= step[0] * step[1] / 4
        return out

    def _element(self, u: Array, g: Array, volume: float) -> tuple[Array, Array]:
        """Forces (m, 24) and tangents (m, 24, 24) from S = mu (1 - C^-1) + lambda ln J C^-1 and its derivative."""
        mu = self.modulus_pa / (2 * (1 + self.poisson))
        lame = 2 * mu * self.poisson / (1 - 2 * self.poisson)
        force, tangent = np.zeros((len(u), 8, 3)), np.zeros((len(u), 8, 3, 8, 3))
        for shape in g:
            f = np.eye(3) + np.einsum("eni,nJ->eiJ", u, shape)
            j, c_inverse = np.linalg.det(f), np.linalg.inv(np.einsum("eiJ,eiK->eJK", f, f))
            log_j = np.log(j)[:, None, None]
            s = mu * (np.eye(3) - c_inverse) + lame * log_j * c_inverse
            force += volume * np.einsum("eiJ,eJK,nK->eni", f, s, shape, optimize=True)
            # dS = lambda C^-1 (C^-1 : dE) + 2 (mu - lambda ln J) C^-1 dE C^-1
            b = np.einsum("eiJ,nK->eniJK", f, shape)
            strain = (b + b.swapaxes(-1, -2)) / 2
            trace = np.einsum("eJK,eniJK->eni", c_inverse, strain)
            pushed = np.einsum("eJK,eniKL,eLM->eniJM", c_inverse, strain, c_inverse, optimize=True)
            shear = 2 * (mu - lame * log_j[:, 0, 0])
            tangent += volume * lame * np.einsum("eni,epk->enipk", trace, trace)
            tangent += volume * np.einsum("e,eniJK,epkJK->enipk", shear, strain, pushed, optimize=True)
            geometric = np.einsum("nJ,eJK,pK->enp", shape, s, shape, optimize=True)
            for i in range(3):
                tangent[:, :, i, :, i] += volume * geometric
        return force.reshape(len(u), 24), tangent.reshape(len(u), 24, 24)


def _gradients(step: Array) -> tuple[Array, float]:
    """Shape gradients (8 points, 8 nodes, 3) of a brick and the volume of each point."""
    signs = 2 * np.array(list(itertools.product((0, 1), repeat=3))) - 1
    out = np.zeros((8, 8, 3))
    for q, point in enumerate(signs * GAUSS):
        factors = 1 + signs * point
        for axis in range(3):
            others = [a for a in range(3) if a != axis]
            out[q, :, axis] = signs[:, axis] * factors[:, others].prod(axis=1) / 8 * 2 / step[axis]
    return out, float(np.prod(step) / 8)
