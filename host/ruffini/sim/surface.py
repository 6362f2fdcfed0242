"""Pressure on the pad's surface: piecewise bilinear between nodes, and the nodal forces that it makes.

The quadratic elements share a uniform pressure out as 1 : 4 : 16 between corner, edge and middle
nodes, so nodal forces are no picture of a pressure. Contact is therefore solved for tractions that
are bilinear between the nodes ("hats"); nodal forces on any grid over the pad follow exactly.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from ruffini.sim.pad import PadModel, quadratic_shapes

Array = npt.NDArray[np.float64]

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)  # exact for a quadratic times a hat


def hat_on_element() -> Array:
    """Integral of each quadratic shape function times each of the three hats over an element of length 1, (3, 3)."""
    shares = np.zeros((3, 3))
    for half in (0, 1):
        for point, weight in zip(_POINTS, _WEIGHTS, strict=True):
            t = (point + 1) / 2
            shapes, _ = quadratic_shapes(t - 1 + half)
            shares[:, half : half + 2] += weight / 4 * np.outer(shapes, [1 - t, t])
    return shares


def _hat_on_quadratic(n: int) -> Array:
    """Share of a hat's unit force that each node of quadratic elements gets along one axis, (n, n)."""
    shares, element = np.zeros((n, n)), hat_on_element()
    for first in range(0, n - 1, 2):
        shares[first : first + 3, first : first + 3] += element
    return np.asarray(shares / shares.sum(axis=0))


def _hat_on_hat(n_from: int, n_to: int) -> Array:
    """Share of a hat's unit force that each hat of another grid over the same length gets, (n_to, n_from)."""
    old, new = np.linspace(0, 1, n_from), np.linspace(0, 1, n_to)
    cuts = np.union1d(old, new)
    middle, half = (cuts[1:] + cuts[:-1]) / 2, (cuts[1:] - cuts[:-1]) / 2
    at = (middle[:, None] + half[:, None] * _POINTS).ravel()
    weight = (half[:, None] * _WEIGHTS).ravel()

    def hats(nodes: Array) -> Array:
        return np.array([np.interp(at, nodes, row) for row in np.eye(len(nodes))])

    shares = (hats(new) * weight) @ hats(old).T
    return np.asarray(shares / shares.sum(axis=0))


def hat_shares(model: PadModel) -> sp.csc_matrix:
    """Nodal forces of a unit force spread as each node's hat, (n, n); every column sums to 1."""
    n_y, n_x = model.shape
    return sp.csc_matrix(sp.kron(_hat_on_quadratic(n_y), _hat_on_quadratic(n_x)))


def hat_areas(model: PadModel) -> Array:
    """Integral of each node's hat over the pad, (n,), square metres."""
    n_y, n_x = model.shape

    def lengths(n: int, size_m: float) -> Array:
        out = np.full(n, size_m / (n - 1))
        out[[0, -1]] /= 2
        return out

    return np.outer(lengths(n_y, model.size_y_m), lengths(n_x, model.size_x_m)).ravel()


def on_grid(model: PadModel, hat_force: Array, n_x: int, n_y: int) -> Array:
    """Nodal forces of the same tractions on a bilinear n_x by n_y grid over the pad, (n_y, n_x, 3).

    Exact: each node gets the integral of traction times its hat, so force and moments stay.
    """
    rows, columns = model.shape
    to_y, to_x = _hat_on_hat(rows, n_y), _hat_on_hat(columns, n_x)
    out = np.einsum("ai,bj,ijc->abc", to_y, to_x, hat_force.reshape(rows, columns, 3), optimize=True)
    return np.asarray(out)


def wrench_of(model: PadModel, nodal_force: Array, displacement: Array | None = None) -> Array:
    """Force (N) and moment (N m) about the undeformed pad centre of nodal forces (n, 3): (6,).

    `displacement` (n, 3) of the nodes moves the forces' points; at small strain they stay where they were.
    """
    x, y = np.meshgrid(model.node_x(), model.node_y())
    arm = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    if displacement is not None:
        arm = arm + displacement
    return np.concatenate([nodal_force.sum(axis=0), np.cross(arm, nodal_force).sum(axis=0)])
