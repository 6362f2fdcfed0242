"""The factor of stated sigmas: coverage of normal errors, and of errors with long tails."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.calibrate.held_out import scale_of


def test_sigmas_of_normal_errors_are_scaled_to_theirs() -> None:
    ratio = np.random.default_rng(1).normal(size=(4000, 2)) * [0.5, 3.0]
    assert scale_of(ratio) == pytest.approx([0.5, 3.0], rel=0.05)


def test_few_large_errors_do_not_widen_all() -> None:
    ratio = np.random.default_rng(2).normal(size=4000)
    ratio[:40] *= 30
    scale = float(scale_of(ratio))
    assert 1.0 < scale < 1.1
    assert np.sqrt(np.mean(ratio**2)) > 2.5
    assert 60 < 100 * np.mean(np.abs(ratio) < scale) < 76
    assert 92 < 100 * np.mean(np.abs(ratio) < 2 * scale) < 98
