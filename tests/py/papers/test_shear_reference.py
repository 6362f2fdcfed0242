"""Shear where all else is known: no error without noise, all of it under much noise."""

from types import SimpleNamespace

import numpy as np
import pytest
from papers.gelslim.shear_reference import _linear, compliance_at_nodes, reference_error

from ruffini.boards import find_board
from ruffini.sim.pad import PadModel

COMPLIANCE = 1e-3  # m/N, of each node alone


@pytest.fixture(scope="module")
def pressed():
    """A board, the compliance of nodes that do not know of one another, and forces of 49 of them."""
    board = find_board("gelslim")
    force = np.zeros((board.grid.n_y, board.grid.n_x, 3))
    force[8:15, 9:16, 2] = -0.02
    force[8:15, 9:16, 0] = 0.002 + 1e-3 * np.random.default_rng(3).normal(size=(7, 7))
    return board, COMPLIANCE * np.eye(force.size), force


@pytest.mark.parametrize(("noise_um", "least", "most"), [(0.001, 0, 0.01), (2, 0.2, 0.6), (1000, 0.9, 1.1)])
def test_it_grows_with_the_noise(pressed, noise_um, least, most):
    board, compliance, force = pressed
    noise_m = np.full(3, 1e-6 * noise_um)
    noise = np.random.default_rng(4).normal(size=force.shape) * noise_m
    assert least <= reference_error(board, compliance, noise_m, COMPLIANCE * force + noise, force) <= most


def test_normal_force_is_known(pressed):
    board, compliance, force = pressed
    coupled = compliance.copy()
    coupled[0::3, 2::3] += 0.5 * COMPLIANCE * np.eye(force.size // 3)  # normal force moves nodes along x, too
    seen = (coupled @ force.ravel()).reshape(force.shape)
    assert reference_error(board, coupled, np.full(3, 1e-9), seen, force) < 0.01
    assert reference_error(board, compliance, np.full(3, 1e-9), seen, force) > 1


def test_between_nodes_a_linear_function_is_exact():
    nodes, at = np.array([0.0, 1.0, 1.5, 4.0]), np.array([0.0, 0.3, 1.2, 4.0])
    np.testing.assert_allclose(_linear(nodes, at) @ (2 * nodes - 1), 2 * at - 1)


def test_compliance_goes_from_a_finer_mesh_to_the_boards_nodes(pressed):
    """Of a pad whose nodes at (x, y) move by f(x, y) g(x', y') where a force acts at (x', y'), f and g linear."""
    board, *_ = pressed
    size_x_m, size_y_m = 1e-6 * board.pad.size_x_um, 1e-6 * board.pad.size_y_um
    model = PadModel(size_x_m, size_y_m, 4e-3, 2e5, 0.48, 8, 6)
    axes = np.array([1.0, 2.0, -3.0])

    def plane(x, y, of_x, of_y):
        along_x, along_y = np.meshgrid(x, y)
        return ((1 + of_x * along_x + of_y * along_y).ravel()[:, None] * axes).ravel()

    def both(x, y):
        return np.outer(plane(x, y, 30, -50), plane(x, y, -20, 70))

    unit = SimpleNamespace(board=board, model=model, compliance=both(model.node_x(), model.node_y()))
    x = (np.arange(board.grid.n_x) / (board.grid.n_x - 1) - 0.5) * size_x_m
    y = (np.arange(board.grid.n_y) / (board.grid.n_y - 1) - 0.5) * size_y_m
    np.testing.assert_allclose(compliance_at_nodes(unit), both(x, y), atol=1e-9)
