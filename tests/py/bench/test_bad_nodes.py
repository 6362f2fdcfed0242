"""Wrong and missing nodes of the benchmark: as many and as far off as asked for, and what the peers make of them."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.bench.bad_nodes import BadNodes, median_tested, without_holes

STEP_MM = (0.7, 0.6)
QUIET = (0.0, 0.0, 0.0)


def dent() -> np.ndarray:
    y, x = np.mgrid[:25, :31]
    deep = np.exp(-((x - 14) ** 2 + (y - 11) ** 2) / 60)
    return np.stack([2e-5 * (x - 14) * deep, 2e-5 * (y - 11) * deep, -4e-4 * deep], axis=-1)


def test_a_share_of_the_nodes_is_off_along_the_surface() -> None:
    truth = dent()
    u = BadNodes(QUIET, share=0.03).observe(truth, STEP_MM, np.random.default_rng(1))
    off = np.linalg.norm(u - truth, axis=-1)
    assert (off > 1e-9).sum() == round(0.03 * 31 * 25)
    np.testing.assert_allclose(off[off > 1e-9], 200e-6)
    np.testing.assert_array_equal(u[..., 2], truth[..., 2])


def test_the_hole_is_round_and_where_the_pad_is_pressed_in() -> None:
    truth = dent()
    for seed in range(5):
        u = BadNodes(QUIET, hole_mm=3.0).observe(truth, STEP_MM, np.random.default_rng(seed))
        rows, columns = np.nonzero(np.isnan(u).all(axis=-1))
        assert len(rows) * STEP_MM[0] * STEP_MM[1] == pytest.approx(np.pi * 1.5**2, rel=0.3)
        assert truth[round(rows.mean()), round(columns.mean()), 2] < -2e-4
        np.testing.assert_array_equal(np.isnan(u).any(axis=-1), np.isnan(u).all(axis=-1))


def test_the_peers_fill_holes_and_the_median_test_takes_single_nodes_out() -> None:
    truth = dent()
    u = BadNodes(QUIET, hole_mm=2.0).observe(truth, STEP_MM, np.random.default_rng(2))
    assert np.abs(without_holes(u) - truth).max() < 80e-6
    u = truth.copy()
    u[11, 15, 0] += 200e-6
    assert np.abs(without_holes(u) - truth).max() == pytest.approx(200e-6)
    assert np.abs(median_tested(u) - truth).max() < 40e-6
