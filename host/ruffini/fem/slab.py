"""A flat elastic pad on a regular grid of 8-node hexahedra, assembled one element layer at a time.

All layers are equal, so the whole stiffness matrix of the slab is told by three sparse matrices of
one layer. Node planes are numbered from the surface (1) down, as in the iFEM papers.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from ruffini.errors import InputError

Array = npt.NDArray[np.float64]

HIGHEST_POISSON = 0.4999  # up to where the elements are tested; a bulk modulus of 5,000 times the shear modulus


@dataclass(frozen=True)
class Slab:
    """A rectangular pad: bottom bonded, sides free, surface observed.

    Parameters
    ----------
    size_x_m, size_y_m, thickness_m : float
        Outer dimensions.
    n_x, n_y : int
        Surface nodes along x and y, at least 2 each; the node numbering is row by row, x fastest.
    n_layers : int
        Element layers through the thickness, at least 2.
    modulus_pa : float
        Young's modulus E.
    poisson : float
        Poisson's ratio nu, 0 <= nu <= 0.4999.

    Raises
    ------
    InputError
        Where a dimension, a count or a material constant makes no elastic slab.
    """

    size_x_m: float
    size_y_m: float
    thickness_m: float
    n_x: int
    n_y: int
    n_layers: int
    modulus_pa: float
    poisson: float

    def __post_init__(self) -> None:
        sizes = (self.size_x_m, self.size_y_m, self.thickness_m, self.modulus_pa)
        if not all(np.isfinite(v) and v > 0 for v in sizes):
            raise InputError(f"pad sizes and modulus must be positive and finite, got {sizes}")
        if not 0.0 <= self.poisson <= HIGHEST_POISSON:
            raise InputError(
                f"Poisson's ratio must be in [0, {HIGHEST_POISSON}], got {self.poisson}: "
                f"use {HIGHEST_POISSON} for a nearly incompressible gel"
            )
        if self.n_x < 2 or self.n_y < 2 or self.n_layers < 2:
            raise InputError(
                "the node grid needs at least 2 x 2 nodes and 2 element layers, "
                f"got {self.n_x} x {self.n_y} nodes and {self.n_layers} layers"
            )

    @property
    def step_m(self) -> tuple[float, float, float]:
        """Element edges h_x, h_y, h_z, metres."""
        return (
            self.size_x_m / (self.n_x - 1),
            self.size_y_m / (self.n_y - 1),
            self.thickness_m / self.n_layers,
        )

    @property
    def n_nodes(self) -> int:
        """Nodes of one plane."""
        return self.n_x * self.n_y


# Corners of the reference cube [-1, 1]^3: four of the upper plane, then four of the lower one;
# within a plane row by row, x fastest. z points out of the pad.
CORNERS: Array = np.array([(x, y, z) for z, y, x in product((1.0, -1.0), (-1.0, 1.0), (-1.0, 1.0))])


def elasticity(modulus_pa: float, poisson: float) -> Array:
    """Isotropic stiffness in Voigt order xx yy zz yz xz xy (engineering shear): (6, 6), pascal."""
    lame = modulus_pa * poisson / ((1 + poisson) * (1 - 2 * poisson))
    shear = modulus_pa / (2 * (1 + poisson))
    stiffness = np.zeros((6, 6))
    stiffness[:3, :3] = lame
    stiffness[np.arange(6), np.arange(6)] += [2 * shear] * 3 + [shear] * 3
    return stiffness


def strain_matrix(gradient: Array) -> Array:
    """Strain of 8 nodes from the shape functions' gradients (8, 3): B, (6, 24)."""
    b = np.zeros((6, 24))
    x, y, z = (slice(c, None, 3) for c in range(3))
    gx, gy, gz = gradient.T
    b[0, x], b[1, y], b[2, z] = gx, gy, gz
    b[3, y], b[3, z] = gz, gy
    b[4, x], b[4, z] = gz, gx
    b[5, x], b[5, y] = gy, gx
    return b


def hexahedron_stiffness(
    step_m: tuple[float, float, float], modulus_pa: float, poisson: float, *, b_bar: bool = True
) -> Array:
    """Stiffness of one 8-node brick, (24, 24), newton per metre, nodes as in `CORNERS`.

    With `b_bar` the volumetric strain is averaged over the element (Hughes 1980): plain
    hexahedra lock near nu = 0.5 and then overestimate forces several times.
    """
    step = np.asarray(step_m)
    volume = float(np.prod(step))
    points = CORNERS / np.sqrt(3.0)  # 2 x 2 x 2 Gauss points, all of weight volume / 8

    def gradient(point: Array) -> Array:
        terms = 1 + CORNERS * point
        out = np.empty((8, 3))
        for c in range(3):
            others = [k for k in range(3) if k != c]
            out[:, c] = CORNERS[:, c] * terms[:, others].prod(axis=1) / 8 * 2 / step[c]
        return out

    strains = [strain_matrix(gradient(p)) for p in points]
    if b_bar:
        mean_volumetric = np.mean([b[:3].sum(axis=0) for b in strains], axis=0)
        for b in strains:
            b[:3] += (mean_volumetric - b[:3].sum(axis=0)) / 3
    stiffness = elasticity(modulus_pa, poisson)
    return sum((b.T @ stiffness @ b * (volume / 8) for b in strains), np.zeros((24, 24)))


@dataclass(frozen=True)
class LayerStiffness:
    """One element layer between an upper and a lower node plane, sparse, (3 n, 3 n) each."""

    upper: sp.csr_matrix
    lower: sp.csr_matrix
    coupling: sp.csr_matrix  # rows upper, columns lower


def assemble_layer(slab: Slab, *, b_bar: bool = True) -> LayerStiffness:
    """Assemble one element layer of the slab; unknowns are node by node, xyz interleaved."""
    element = hexahedron_stiffness(slab.step_m, slab.modulus_pa, slab.poisson, b_bar=b_bar)
    cells_x, cells_y = np.meshgrid(np.arange(slab.n_x - 1), np.arange(slab.n_y - 1))
    corner = (cells_y * slab.n_x + cells_x).ravel()
    nodes = corner[:, None] + np.array([0, 1, slab.n_x, slab.n_x + 1])
    dofs = (3 * nodes[:, :, None] + np.arange(3)).reshape(len(corner), 12)
    rows = np.repeat(dofs, 12, axis=1).ravel()
    columns = np.tile(dofs, (1, 12)).ravel()
    n = 3 * slab.n_nodes

    def scatter(block: Array) -> sp.csr_matrix:
        values = np.tile(block.ravel(), len(corner))
        return sp.csr_matrix((values, (rows, columns)), shape=(n, n))

    return LayerStiffness(
        upper=scatter(element[:12, :12]),
        lower=scatter(element[12:, 12:]),
        coupling=scatter(element[:12, 12:]),
    )
