"""27-node hexahedra of any shape: gradients at the integration points, and linear stiffness.

Nodes of an element run z slow, y, x fast, on -1, 0, 1; displacements node by node, xyz inside.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def _line(t: Array) -> tuple[Array, Array]:
    """Quadratic shape functions on -1, 0, 1 and their derivatives, (points, 3) each."""
    return (
        np.stack([t * (t - 1) / 2, 1 - t * t, t * (t + 1) / 2], axis=1),
        np.stack([t - 0.5, -2 * t, t + 0.5], axis=1),
    )


def _reference_gradients() -> tuple[Array, Array]:
    """Derivatives by the element's own coordinates at 27 points (27, 27 nodes, 3), and weights (27,)."""
    n, d = _line(_POINTS)
    parts = [np.einsum("zc,yb,xa->zyxcba", *lines) for lines in ((n, n, d), (n, d, n), (d, n, n))]
    weights = np.einsum("z,y,x->zyx", _WEIGHTS, _WEIGHTS, _WEIGHTS).ravel()
    return np.stack([part.reshape(27, 27) for part in parts], axis=-1), weights


REFERENCE_GRADIENTS, REFERENCE_WEIGHTS = _reference_gradients()


def gradients(coords: Array) -> tuple[Array, Array]:
    """Shape gradients (m, 27 points, 27 nodes, 3) and volumes (m, 27) of elements with nodes (m, 27, 3)."""
    jacobian = np.einsum("qni,enj->eqij", REFERENCE_GRADIENTS, coords, optimize=True)
    volume = np.abs(np.linalg.det(jacobian)) * REFERENCE_WEIGHTS
    return np.einsum("qnj,eqij->eqni", REFERENCE_GRADIENTS, np.linalg.inv(jacobian), optimize=True), volume


def stiffness(coords: Array, modulus_pa: Array, poisson: float) -> Array:
    """Linear stiffness (m, 81, 81) of elements with nodes (m, 27, 3), full 3 x 3 x 3 integration."""
    lame = modulus_pa * poisson / ((1 + poisson) * (1 - 2 * poisson))
    shear = modulus_pa / (2 * (1 + poisson))
    g, volume = gradients(coords)
    m = len(coords)
    flat = g.reshape(m, 27, 81)
    t = (flat.transpose(0, 2, 1) @ (volume[..., None] * flat)).reshape(m, 27, 3, 27, 3)
    trace = np.einsum("emknk->emn", t)[:, :, None, :, None] * np.eye(3)[None, None, :, None, :]
    out = lame[:, None, None, None, None] * t
    out += shear[:, None, None, None, None] * (t.transpose(0, 1, 4, 3, 2) + trace)
    return np.asarray(out.reshape(m, 81, 81))


def plane_nodes(n_cells_x: int, n_cells_y: int) -> Indices:
    """Numbers, in a plane of nodes, of the nine nodes of each element, (cells, 9); rows of x."""
    n_x = 2 * n_cells_x + 1
    cell_x, cell_y = np.meshgrid(np.arange(n_cells_x), np.arange(n_cells_y))
    corner = (2 * cell_y * n_x + 2 * cell_x).ravel()
    return np.asarray(corner[:, None] + (np.arange(3)[:, None] * n_x + np.arange(3)).ravel())


def plane_matrices(elements: Array, nodes: Indices, n_nodes: int) -> list[list[sp.csr_matrix]]:
    """Stiffness of a layer of elements (m, 81, 81) between its three planes of nodes, [3][3]."""
    parts = elements.reshape(-1, 3, 27, 3, 27)
    dofs = (3 * nodes[:, :, None] + np.arange(3)).reshape(len(nodes), 27)
    rows, columns = np.repeat(dofs, 27, axis=1).ravel(), np.tile(dofs, (1, 27)).ravel()
    size = 3 * n_nodes
    return [
        [sp.csr_matrix((parts[:, a, :, b].ravel(), (rows, columns)), shape=(size, size)) for b in range(3)]
        for a in range(3)
    ]
