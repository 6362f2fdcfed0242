"""The noise's correlation, told by what is left in means over blocks: of noise that is drawn with a known one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ruffini.estimators.noise.stage import BLOCK, CORRELATION_RANGE, Power, correlation_nodes, power_of

SHAPE = (60, 80, 3)
SIGMA_M = np.array([5e-6, 6e-6, 2e-5])


def drawn(length: float) -> np.ndarray:
    noise = np.random.default_rng(4).normal(size=SHAPE)
    smooth = gaussian_filter(noise, (length, length, 0), mode="wrap") if length else noise
    return (smooth / smooth.std(axis=(0, 1)) * SIGMA_M).reshape(-1, 3)


def plane() -> np.ndarray:
    y, x = np.mgrid[-1 : 1 : SHAPE[0] * 1j, -1 : 1 : SHAPE[1] * 1j]
    return np.stack([np.ones(x.size), x.ravel(), y.ravel()], axis=1)


@pytest.mark.parametrize("length", [0.0, 0.84, 1.5, 3.0])
def test_the_length_of_drawn_noise_is_found(length: float) -> None:
    tilted = drawn(length) + np.outer(plane() @ [1e-4, 2e-5, -3e-5], [0, 0, 1])  # of no concern: a constant and a tilt
    power = power_of(tilted, plane(), SHAPE)
    np.testing.assert_allclose(np.sqrt(power.node), SIGMA_M, rtol=0.08)
    found = correlation_nodes(float(np.mean(power.block / power.node)))
    assert found == pytest.approx(length, rel=0.15, abs=0.35)


def test_blocks_of_white_noise_have_the_power_of_its_nodes_and_a_constant_has_all() -> None:
    white = power_of(drawn(0.0), plane(), SHAPE)
    np.testing.assert_allclose(white.block / white.node, 1, atol=0.2)
    same = power_of(np.tile([1e-6, 0, 0], (SHAPE[0] * SHAPE[1], 1)), plane(), SHAPE)
    assert same.block[0] / same.node[0] == pytest.approx(BLOCK**2)
    assert correlation_nodes(BLOCK**2) == CORRELATION_RANGE[1]
    assert correlation_nodes(0.5) == 0.0


def test_powers_are_averaged_axis_by_axis() -> None:
    mean = Power.mean([Power(np.array([1.0, 2, 3]), np.zeros(3)), Power(np.array([3.0, 2, 1]), np.ones(3))])
    assert mean.node.tolist() == [2, 2, 2]
    assert mean.block.tolist() == [0.5, 0.5, 0.5]
