"""Compliance of an elastic indenter: a block of 27-node hexahedra behind its face, held by a plate at its back.

Linear, in the indenter's own axes, and on its undeformed shape; it does not follow a tilt. All lengths are over the
radius and all moduli over the shell's, so one solution serves every size and hardness: C = C_unit / (E r).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from ruffini.errors import InputError
from ruffini.reflection import dense_from_blocks, parity_bases
from ruffini.sim.hex27 import plane_matrices, plane_nodes, stiffness
from ruffini.sim.indenters import Indenter
from ruffini.sim.indenters.material import CORE_STIFFNESS
from ruffini.sim.pad import BLAS, eliminate
from ruffini.sim.surface import hat_on_element

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Bools = npt.NDArray[np.bool_]

N_CELLS = 12  # across the indenter
N_CELLS_SYMMETRIC = 16  # where both reflections leave it as it is, which makes it 16 times cheaper
LAYERS = (0.06, 0.12, 0.27, 0.55)  # thickness of the element layers from the face on, of each column
FINEST = 0.25  # of the even step: the middle cells of a ball
PRISM_HEIGHT, ROUND_HEIGHT = 2.0, 1.0  # of the plate over the lowest point
HALF_SIZES = {"cylinder": (1.0, 2.0), "triangle": (1.0, 1.16), "hexagon": (1.16, 1.0), "nut": (1.16, 1.0),
              "shell": (1.0, 1.3), "usb_plug": (1.0, 0.4), "screw_m6": (1.16, 1.0)}  # fmt: skip
ROUND_LIMIT = 0.8  # columns of round shapes reach to where the face is this high


@dataclass(frozen=True)
class IndenterBody:
    """Face of an elastic indenter, in its own axes.

    node_x, node_y : lines of the face's nodes, metres.
    is_used : (n_y, n_x) nodes that belong to the face.
    compliance : (n, 3, n, 3) m/N, mean displacement over a used node's hat per force spread as another's.
    """

    node_x: Array
    node_y: Array
    is_used: Bools
    compliance: Array

    def shares(self, place: Array) -> sp.csr_matrix:
        """How points (m, 2) in the indenter's axes share out between the face's used nodes, (m, n); rows sum to 1."""
        from scipy.spatial import cKDTree

        n_x = len(self.node_x)
        (i, s), (j, t) = (_between(nodes, place[:, c]) for c, nodes in enumerate((self.node_x, self.node_y)))
        corners = np.stack([j * n_x + i, j * n_x + i + 1, (j + 1) * n_x + i, (j + 1) * n_x + i + 1], axis=1)
        weights = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], axis=1)
        weights *= self.is_used.ravel()[corners]
        lost = weights.sum(axis=1) < 1e-6  # beside the face: its nearest node
        x, y = np.meshgrid(self.node_x, self.node_y)
        used = np.flatnonzero(self.is_used)
        if lost.any():
            nearest = cKDTree(np.column_stack([x.flat[used], y.flat[used]])).query(place[lost])[1]
            corners[lost], weights[lost] = used[nearest][:, None], (1.0, 0, 0, 0)
        weights /= weights.sum(axis=1, keepdims=True)
        number = np.maximum(np.cumsum(self.is_used.ravel()) - 1, 0)  # of unused nodes it does not matter
        rows = np.repeat(np.arange(len(place)), 4)
        return sp.csr_matrix((weights.ravel(), (rows, number[corners.ravel()])), shape=(len(place), len(used)))


def _between(nodes: Array, at: Array) -> tuple[Indices, Array]:
    """The line before each coordinate and the part of the way to the next; the border beyond the border."""
    i = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    return i, np.clip((at - nodes[i]) / (nodes[i + 1] - nodes[i]), 0, 1)


def body_of(indenter: Indenter) -> IndenterBody:
    """The body of an elastic indenter, solved once a process for each shape and kind of material.

    Raises
    ------
    InputError
        The indenter is rigid, or has no column of material behind its face.
    """
    if indenter.material is None:
        raise InputError("a rigid indenter has no compliance: give it a material")
    size = indenter.radius_m if indenter.form is None else 1.0
    unit = _solved(
        replace(indenter, radius_m=indenter.radius_m / size, material=replace(indenter.material, modulus_pa=1))
    )
    scale = indenter.material.modulus_pa * size
    return IndenterBody(unit.node_x * size, unit.node_y * size, unit.is_used, unit.compliance / scale)


@lru_cache(maxsize=4)
def _solved(indenter: Indenter) -> IndenterBody:
    half_x, half_y = (indenter.radius_m * part for part in HALF_SIZES.get(indenter.shape, (1.0, 1.0)))
    grid = _Grid.of(indenter, half_x, half_y, N_CELLS_SYMMETRIC)
    bases = parity_bases(len(grid.x), len(grid.y))
    if not grid.is_symmetric:
        grid = _Grid.of(indenter, half_x, half_y, N_CELLS)
        bases = [sp.identity(3 * len(grid.x) * len(grid.y), format="csr")]
    if not grid.cells.any():
        raise InputError(f"indenter {indenter.shape!r} has no column of material behind its face: make it rigid")
    nodes = plane_nodes(grid.cells.shape[1], grid.cells.shape[0])[grid.cells.ravel()]
    n = len(grid.x) * len(grid.y)
    layers = [plane_matrices(grid.elements(k, nodes, indenter), nodes, n) for k in reversed(range(len(LAYERS)))]
    used = np.zeros(n, dtype=bool)
    used[nodes] = True
    touched = [q[:, np.flatnonzero(abs(q).T @ np.repeat(used, 3))] for q in bases]
    with BLAS.limit(limits=1):
        nodal = dense_from_blocks(touched, [eliminate(q, layers) for q in touched])
    dofs = np.flatnonzero(np.repeat(used, 3))
    areas = np.outer(np.diff(grid.y[::2]), np.diff(grid.x[::2]))[grid.cells]
    spread = sp.kron(_face_shares(nodes, n, areas)[:, used], sp.identity(3), format="csr")
    hats = (spread.T @ (spread.T @ nodal).T).reshape(len(dofs) // 3, 3, -1, 3)
    return IndenterBody(grid.x, grid.y, used.reshape(len(grid.y), len(grid.x)), hats)


def _face_shares(nodes: Indices, n: int, cell_areas: Array) -> sp.csr_matrix:
    """Nodal forces (rows) of unit forces spread as the hats (columns) of faces that end where the columns end."""
    line = hat_on_element()
    block = np.kron(line, line)
    rows, columns = np.repeat(nodes, 9, axis=1).ravel(), np.tile(nodes, (1, 9)).ravel()
    raw = sp.csc_matrix((np.outer(cell_areas, block).ravel(), (rows, columns)), shape=(n, n))
    hats = np.asarray(raw.sum(axis=0)).ravel()
    return sp.csr_matrix(raw @ sp.diags(1 / np.where(hats > 0, hats, 1.0)))


def _lines(half: float, n_cells: int, *, is_graded: bool) -> Array:
    """Lines of nodes from -half to half; graded ones are nearer to each other in the middle."""
    edges = np.linspace(-1, 1, n_cells + 1)
    if is_graded:
        edges = edges * (FINEST + (1 - FINEST) * edges**2)
    lines = np.empty(2 * n_cells + 1)
    lines[::2], lines[1::2] = edges, (edges[1:] + edges[:-1]) / 2
    return half * lines


@dataclass(frozen=True)
class _Grid:
    """Lines of the face's nodes, height of the face at them, height of the plate, and which cells have a column."""

    x: Array
    y: Array
    face: Array
    back: float
    cells: Bools

    @classmethod
    def of(cls, indenter: Indenter, half_x: float, half_y: float, n: int) -> _Grid:
        longest = max(half_x, half_y)
        n_x, n_y = (max(4, 2 * round(n * half / longest / 2)) for half in (half_x, half_y))
        is_ball = indenter.shape in ("sphere", "cone", "cylinder")  # these touch in the middle first
        x = _lines(half_x, n_x, is_graded=is_ball)
        y = _lines(half_y, n_y, is_graded=is_ball and indenter.shape != "cylinder")
        height = indenter.height(*np.meshgrid(x, y))
        size = indenter.radius_m
        if indenter.is_prism:
            return cls(x, y, np.zeros_like(height), PRISM_HEIGHT * size, height[1::2, 1::2] <= 0)
        back = ROUND_HEIGHT * size
        limit = ROUND_LIMIT * back
        return cls(x, y, np.minimum(height, limit), back, height[1::2, 1::2] < limit)

    @property
    def is_symmetric(self) -> bool:
        """Whether x -> -x and y -> -y change nothing."""
        return all(
            np.allclose(a, b)
            for a, b in ((self.face, self.face[::-1]), (self.face, self.face[:, ::-1]),
                         (self.cells, self.cells[::-1]), (self.cells, self.cells[:, ::-1]))
        )  # fmt: skip

    def elements(self, layer: int, nodes: Indices, indenter: Indenter) -> Array:
        """Stiffness of layer `layer` from the face, its planes in order from the plate, (m, 81, 81)."""
        assert indenter.material is not None
        far, near = sum(LAYERS[: layer + 1]), sum(LAYERS[:layer])
        x, y = (a.ravel()[nodes] for a in np.meshgrid(self.x, self.y))
        face = self.face.ravel()[nodes]
        planes = [np.stack([x, y, face + part * (self.back - face)], axis=-1) for part in (far, (far + near) / 2, near)]
        coords = np.stack(planes, axis=1).reshape(-1, 27, 3)
        center, size = coords[:, 13], indenter.radius_m
        behind_face = center[:, 2] - self.face.ravel()[nodes[:, 4]]
        in_core = (np.hypot(center[:, 0], center[:, 1]) < indenter.material.core_part * size) & (
            behind_face > indenter.material.skin_part * size
        )
        return stiffness(coords, np.where(in_core, CORE_STIFFNESS, 1.0), indenter.material.poisson)
