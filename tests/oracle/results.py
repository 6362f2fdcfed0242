"""What CalculiX printed (.dat), and the nodal forces that follow from it.

The solver prints displacements of the upper layer's nodes and Cauchy stresses at the 2 x 2 x 2 points of its bricks.
The forces on the surface are the integral of B^T sigma over that layer: they vanish where nothing touches, and their
sum is the indenter's reaction, which checks the whole reading. mm, N, MPa.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mesh import HALF_STEPS, TOP_NODES, PadMesh
from solve import OracleError

Array = npt.NDArray[np.float64]

AGAIN = "remove the file, and solve again"
_CORNER = 1 / np.sqrt(3)
# Integration points of a brick in the solver's order: x fastest, then y, then z.
POINTS = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * _CORNER
_NINE, _WEIGHTS = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True)
class Printed:
    """One increment: displacement (n, 3) by node number, stresses (elements, 8, 6), the two reactions (3,)."""

    nodes: npt.NDArray[np.intp]
    displacement: Array
    stress: Array  # xx, yy, zz, xy, xz, yz
    on_indenter: Array
    on_base: Array


def read_dat(path: Path) -> list[Printed]:
    """All increments of a .dat file, in the order of the steps.

    Raises
    ------
    OracleError
        A table is missing, cut short or not numbers: the solver ended early.
    """
    tables: dict[tuple[str, str], list[Array]] = {}
    try:
        for kind, name, rows in _tables(path.read_text()):
            tables.setdefault((kind, name), []).append(rows)
    except ValueError as error:
        raise OracleError(f"{path} has a table that cannot be read ({error}): {AGAIN}") from error
    wanted = [("displacements", "LAYER"), ("stresses", "UPPER"), ("total force", "RIGID"), ("total force", "BASE")]
    if missing := [" of ".join(key) for key in wanted if key not in tables]:
        raise OracleError(f"{path} has no table {', '.join(missing)}, since the solver ended early: {AGAIN}")
    if len({len(tables[key]) for key in wanted}) != 1:
        raise OracleError(f"{path} ends within a step, since the solver was stopped: {AGAIN}")
    out = []
    for moved, stress, indenter, base in zip(*(tables[key] for key in wanted), strict=True):
        n_points = len(POINTS)
        if len(stress) % n_points or not np.array_equal(stress[:n_points, 1], np.arange(n_points) + 1):
            raise OracleError(f"{path} has stresses that are not at {n_points} points an element: use C3D20R")
        out.append(
            Printed(
                moved[:, 0].astype(int) - 1, moved[:, 1:4], stress[:, 2:8].reshape(-1, n_points, 6),
                indenter[0, -3:], base[0, -3:],
            )
        )  # fmt: skip
    return out


def _tables(text: str) -> Iterator[tuple[str, str, Array]]:
    """Kind, set and rows of each table: a heading '... for set NAME and time T', then lines of numbers."""
    kind = name = ""
    rows: list[list[float]] = []
    for line in text.splitlines():
        if " for set " in line:
            if rows:
                yield kind, name, np.array(rows)
            kind = line.split("(")[0].strip()
            name, rows = line.split(" for set ")[1].split()[0], []
        elif line.strip():
            rows.append([float(word) for word in line.split()])
    if rows:
        yield kind, name, np.array(rows)


def brick_gradients(at: Array) -> Array:
    """Derivatives of the 20 shape functions by the brick's own coordinates at points (p, 3): (p, 20, 3)."""
    own = HALF_STEPS - 1.0
    out = np.zeros((len(at), 20, 3))
    for a, (i, j, k) in enumerate(own):
        corner = 1 + at * own[a]  # 1 + x x_a and so on, (p, 3)
        is_middle = own[a] == 0
        if not is_middle.any():
            total = at @ own[a] - 2
            whole = corner.prod(axis=1) / 8
            for c, s in enumerate((i, j, k)):
                others = np.delete(corner, c, axis=1).prod(axis=1) / 8
                out[:, a, c] = s * (others * total + whole)
        else:
            middle = int(np.flatnonzero(is_middle)[0])
            factors = corner.copy()
            factors[:, middle] = 1 - at[:, middle] ** 2
            for c in range(3):
                slope = -2 * at[:, c] if c == middle else np.full(len(at), own[a][c])
                out[:, a, c] = slope * np.delete(factors, c, axis=1).prod(axis=1) / 4
    return out


def face_shapes(at: Array) -> Array:
    """The eight shape functions of a face at points (p, 2) of it, in the order of TOP_NODES: (p, 8)."""
    own = HALF_STEPS[list(TOP_NODES)][:, :2] - 1.0
    out = np.empty((len(at), 8))
    for a, (i, j) in enumerate(own):
        x, y = at.T
        if i and j:
            out[:, a] = (1 + i * x) * (1 + j * y) * (i * x + j * y - 1) / 4
        else:
            out[:, a] = (1 - x**2) * (1 + j * y) / 2 if j else (1 + i * x) * (1 - y**2) / 2
    return out


def surface_forces(mesh: PadMesh, printed: Printed) -> Array:
    """Force on each node (nodes, 3) of the uppermost layer that holds the printed stresses; N."""
    place = mesh.nodes.copy()
    place[printed.nodes] += printed.displacement
    elements = mesh.elements[mesh.top_elements]
    gradients = brick_gradients(POINTS)
    jacobian = np.einsum("pni,enj->epij", gradients, place[elements])
    spatial = np.einsum("epji,pni->epnj", np.linalg.inv(jacobian), gradients)
    s = printed.stress
    sigma = np.stack([s[..., [0, 3, 4]], s[..., [3, 1, 5]], s[..., [4, 5, 2]]], axis=-1)
    force = np.einsum("epnj,epjc,ep->enc", spatial, sigma, np.linalg.det(jacobian))
    total = np.zeros_like(mesh.nodes)
    np.add.at(total, elements, force)
    return total


class Surface:
    """The free surface: its displacement anywhere, and nodal forces as those of a grid of bilinear hats."""

    def __init__(self, mesh: PadMesh) -> None:
        self._mesh = mesh
        self.nodes, self._faces = np.unique(mesh.faces, return_inverse=True)
        self._faces = self._faces.reshape(-1, 8)

    def sample(self, values: Array, x: Array, y: Array) -> Array:
        """`values` (surface nodes, k) where columns x and rows y (mm, undeformed) cross: (len(y), len(x), k)."""
        mesh = self._mesh
        at_x, at_y = _located(mesh.x, x), _located(mesh.y, y)
        face = at_y[0][:, None] * (len(mesh.x) - 1) + at_x[0]
        own = np.stack(np.broadcast_arrays(at_x[1], at_y[1][:, None]), axis=-1)
        shapes = face_shapes(own.reshape(-1, 2)).reshape(*face.shape, 8)
        return np.asarray(np.einsum("abn,abnk->abk", shapes, values[self._faces[face]]))

    def on_grid(self, force: Array, grid_x: Array, grid_y: Array) -> Array:
        """Integral of the traction times each hat of a grid over the undeformed surface, (n_y, n_x, 3), N.

        The traction is the one of the faces' own shape functions that has these nodal forces (surface nodes, 3): sum
        and moments stay, because constants and planes are within both.
        """
        import scipy.sparse as sp
        import scipy.sparse.linalg as spla

        mesh = self._mesh
        n_x, n_y = len(mesh.x) - 1, len(mesh.y) - 1
        x, y = np.meshgrid(_NINE, _NINE)
        points, weights = np.column_stack([x.ravel(), y.ravel()]), np.outer(_WEIGHTS, _WEIGHTS).ravel()
        shapes = face_shapes(points)
        areas = np.outer(np.diff(mesh.y), np.diff(mesh.x)).ravel() / 4
        mass = areas[:, None, None] * np.einsum("p,pa,pb->ab", weights, shapes, shapes)
        rows, columns = np.repeat(self._faces, 8, axis=1).ravel(), np.tile(self._faces, (1, 8)).ravel()
        system = sp.csc_matrix((mass.ravel(), (rows, columns)), shape=(len(self.nodes),) * 2)
        traction = spla.splu(system).solve(force)
        # Hats have kinks within faces: integrate over the pieces between the lines of both grids.
        cuts_x, cuts_y = (_cuts(line, grid) for line, grid in ((mesh.x, grid_x), (mesh.y, grid_y)))
        at_x, at_y = _gauss(cuts_x), _gauss(cuts_y)
        value = self.sample(traction, at_x[0], at_y[0])
        hats_x, hats_y = (_hats(grid, at[0]) * at[1] for grid, at in ((grid_x, at_x), (grid_y, at_y)))
        assert n_x * n_y == len(self._faces)
        return np.asarray(np.einsum("ai,bj,ijk->abk", hats_y, hats_x, value, optimize=True))


def _located(borders: Array, at: Array) -> tuple[npt.NDArray[np.intp], Array]:
    """Element of each place, and where it is in it (-1 to 1)."""
    element = np.clip(np.searchsorted(borders, at, side="right") - 1, 0, len(borders) - 2)
    low, high = borders[element], borders[element + 1]
    return element, (2 * at - low - high) / (high - low)


def _cuts(line: Array, grid: Array) -> Array:
    """Borders of the pieces on which faces and hats are smooth, within the mesh."""
    cuts = np.union1d(line, grid)
    return cuts[(cuts >= line[0]) & (cuts <= line[-1])]


def _gauss(cuts: Array) -> tuple[Array, Array]:
    middle, half = (cuts[1:] + cuts[:-1]) / 2, (cuts[1:] - cuts[:-1]) / 2
    return (middle[:, None] + half[:, None] * _NINE).ravel(), (half[:, None] * _WEIGHTS).ravel()


def _hats(nodes: Array, at: Array) -> Array:
    return np.array([np.interp(at, nodes, row) for row in np.eye(len(nodes))])
