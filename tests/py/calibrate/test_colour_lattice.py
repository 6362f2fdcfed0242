"""The lattice over three colour changes: its lines, its weights, what holds it straight."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.estimators.photometric.lattice import N_LINES, ColourAxis, bending

N_NODES = N_LINES**3


def nodes_of(axis: ColourAxis) -> np.ndarray:
    """Change (nodes, 3) at every node."""
    lines = [(axis.low_q12[c] + np.arange(N_LINES) * (1 << axis.shift[c])) / 4096 for c in range(3)]
    return np.stack([g.ravel() for g in np.meshgrid(*lines, indexing="ij")], axis=1)


def test_lines_hold_the_changes_and_no_change_is_a_node() -> None:
    rng = np.random.default_rng(0)
    change = rng.uniform([-0.5, -0.1, 0.02], [0.3, 0.12, 1.4], (5000, 3))
    axis = ColourAxis.covering(change)
    nodes = nodes_of(axis)
    assert not nodes[axis.zero()].any()
    assert (nodes.min(axis=0) <= np.quantile(change, 0.001, axis=0)).all()
    assert (nodes.max(axis=0) >= np.quantile(change, 0.999, axis=0)).all()
    assert axis.shift.tolist() == [9, 7, 10]  # the finest that hold 0.8, 0.22 and 1.4 on eight steps


def test_weights_are_trilinear_and_hold_beyond_the_border() -> None:
    axis = ColourAxis(np.array([-2048, -1024, -512], np.int32), np.array([9, 8, 7], np.int32))
    nodes = nodes_of(axis)
    value = 0.3 + nodes @ [1.0, -2.0, 0.5] + nodes[:, 0] * nodes[:, 1] * nodes[:, 2]
    inside = np.random.default_rng(1).uniform([-0.5, -0.25, -0.125], [0.5, 0.25, 0.125], (200, 3))
    expected = 0.3 + inside @ [1.0, -2.0, 0.5] + inside.prod(axis=1)
    assert axis.weights(inside) @ value == pytest.approx(expected, abs=1e-12)
    assert axis.weights(np.array([[3.0, 0, 0]])) @ value == pytest.approx(0.3 + 0.5)


def test_planes_cost_nothing_and_a_bend_at_rest_costs_most() -> None:
    axis = ColourAxis(np.array([-2048, -2048, -2048], np.int32), np.array([9, 9, 9], np.int32))
    cost = bending(axis.zero())
    nodes = nodes_of(axis)
    plane = 2 + nodes @ [1.0, 3.0, -2.0]
    assert plane @ cost @ plane == pytest.approx(0, abs=1e-6)

    def kink(at: float) -> float:
        bent = np.abs(nodes[:, 0] - at)
        return float(bent @ cost @ bent)

    assert kink(0.0) > 50 * kink(0.125)


def test_noise_of_an_untouched_picture_makes_no_slope_of_one_sign() -> None:
    """A fit to |d| is held straight through rest: the mean over noise stays a tenth of what a kink would make."""
    axis = ColourAxis(np.array([-2048, -2048, -2048], np.int32), np.array([9, 9, 9], np.int32))
    rng = np.random.default_rng(2)
    change = rng.uniform(-0.45, 0.45, (4000, 3))
    weights = axis.weights(change)
    gram = (weights.T @ weights).toarray() / len(change) + 1e-5 * bending(axis.zero()) + 1e-9 * np.eye(N_NODES)
    node = np.linalg.solve(gram, weights.T @ np.abs(change[:, 0]) / len(change))
    noise = axis.weights(rng.normal(0, 0.01, (20000, 3))) @ node
    at_rest = axis.weights(np.zeros((1, 3))) @ node
    assert abs(noise.mean() - at_rest[0]) < 0.1 * 0.01 * np.sqrt(2 / np.pi)
