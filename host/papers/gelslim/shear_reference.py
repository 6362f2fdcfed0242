"""Shear by a reference estimator that knows the twin's mechanics, the normal forces and the contact nodes.

It is Bayesian, with a Gaussian prior of the shear whose correlation length, deviation and relation to the pressure are
chosen by the truth. No bound: a prior that knows more of the shear, such as one of similar touches, may err by less.
"""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from ruffini.boards import Board
from ruffini.sim.unit import TwinUnit

Array = npt.NDArray[np.float64]

TOUCHED = 1e-3  # of the largest pressure
LENGTHS_MM = (0.0, 0.5, 1.0, 2.0, 4.0)  # over which shear is alike
DEVIATIONS = np.logspace(-4, 0, 17) * 10  # of the prior, over the true root mean square
LEAST_SHEAR = 0.05  # of the force: what errors are divided by at least, as in `bench.errors`


def compliance_at_nodes(unit: TwinUnit) -> Array:
    """m/N at the nodes of the board's grid, (3n, 3n), of the twin's finer mesh."""
    board, model = unit.board, unit.model
    x = (np.arange(board.grid.n_x) / (board.grid.n_x - 1) - 0.5) * board.pad.size_x_um * 1e-6
    y = (np.arange(board.grid.n_y) / (board.grid.n_y - 1) - 0.5) * board.pad.size_y_um * 1e-6
    at_grid = sp.kron(sp.kron(_linear(model.node_y(), y), _linear(model.node_x(), x)), sp.eye(3)).tocsr()
    return np.asarray(at_grid @ (at_grid @ unit.compliance.T).T)


def _linear(nodes: Array, at: Array) -> sp.csr_matrix:
    """Values at `at` of a function that is linear between the nodes, (len(at), len(nodes))."""
    return sp.csr_matrix(np.stack([np.interp(at, nodes, row) for row in np.eye(len(nodes))], axis=1))


def reference_error(board: Board, compliance: Array, noise_m: Array, displacement: Array, force: Array) -> float:
    """Relative error of the tangential field with the best prior; displacement in m, force in N, (n_y, n_x, 3)."""
    true = force.reshape(-1, 3)
    touched = np.flatnonzero(-true[:, 2] > TOUCHED * -true[:, 2].min())
    pressure = -true[touched, 2]
    grid = np.meshgrid(
        np.linspace(0, board.pad.size_x_um * 1e-3, board.grid.n_x),
        np.linspace(0, board.pad.size_y_um * 1e-3, board.grid.n_y),
    )
    place = np.column_stack([axis.ravel()[touched] for axis in grid])
    apart = np.linalg.norm(place[:, None] - place, axis=-1)
    weight = np.tile(1 / noise_m, len(true))
    normal = np.zeros_like(true)
    normal[:, 2] = true[:, 2]
    shear = np.r_[true[touched, 0], true[touched, 1]]
    seen = (displacement.ravel() - compliance @ normal.ravel()) * weight
    slope = compliance[:, np.r_[3 * touched, 3 * touched + 1]] * weight[:, None]
    information, score = slope.T @ slope, slope.T @ seen
    missed = float((true[:, :2] ** 2).sum() - (shear**2).sum())  # of nodes that hardly touch
    size = max(float(np.linalg.norm(true[:, :2])), LEAST_SHEAR * float(np.linalg.norm(true)))
    least = np.inf
    for length, follows_pressure in itertools.product(LENGTHS_MM, (False, True)):
        alike = np.exp(-apart / length) if length else np.eye(len(apart))
        if follows_pressure:
            alike = alike * np.outer(pressure, pressure)
        alike = np.kron(np.eye(2), alike / np.diag(alike).mean()) * (shear**2).mean()
        precision = np.linalg.inv(alike)
        for deviation in DEVIATIONS:
            found = np.linalg.solve(information + precision / deviation**2, score)
            least = min(least, np.sqrt(((found - shear) ** 2).sum() + missed) / size)
    return float(least)
