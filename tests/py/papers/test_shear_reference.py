"""Shear where all else is known: no error without noise, all of it under much noise."""

import numpy as np
import pytest
from papers.gelslim.shear_reference import _linear, reference_error

from ruffini.boards import find_board

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
