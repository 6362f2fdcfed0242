"""The coverage table's own arithmetic: it fails in both directions, inside and outside, and leaves out what is sure."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.bench.coverage import Coverage, Stated, table
from ruffini.estimators.operator.error_model import NodePlaces

STEP_N, THRESHOLD_N = 1e-5, 3e-3
PLACES = NodePlaces(np.linspace(-5e-3, 5e-3, 21), np.linspace(-4e-3, 4e-3, 17))
SHAPE = (17, 21, 3)
SIGMA_N = 2e-3


def filled(stated_over_true: float) -> dict[str, dict[str, float]]:
    """Two hundred frames with Gaussian errors of SIGMA_N at the pressed nodes; the sigma stated is off by a factor."""
    rng = np.random.default_rng(4)
    coverage = Coverage(PLACES, STEP_N, THRESHOLD_N)
    truth = np.zeros(SHAPE)
    truth[5:11, 6:13] = (0.01, -0.005, -0.04)
    pressed = truth[..., 2:] < 0
    # Error of the sums over 42 independent nodes about the pad's centre.
    x, y = PLACES.x_m[6:13], PLACES.y_m[5:11]
    x2, y2 = 6 * (x**2).sum(), 7 * (y**2).sum()
    variance = SIGMA_N**2 * np.array([42, 42, 42, y2, x2, x2 + y2])
    for _ in range(200):
        error = rng.normal(size=SHAPE) * SIGMA_N * pressed
        sigma = np.full(SHAPE, SIGMA_N * stated_over_true)
        coverage.add(Stated(truth + error, sigma, np.diag(variance) * stated_over_true**2), truth)
    return coverage.summary()


def test_an_honest_sigma_covers_68_and_95_percent() -> None:
    for name, s in filled(1.0).items():
        if "outside" in name:
            assert s["n"] == 0
            continue
        tolerance = 2 if "inside" in name else 8  # one value a frame for the wrench
        assert s["within_1"] == pytest.approx(68.3, abs=tolerance), name
        assert s["within_2"] == pytest.approx(95.4, abs=tolerance), name
    assert filled(1.0)["normal inside"]["mean_sigma"] == pytest.approx(SIGMA_N)


@pytest.mark.parametrize(("factor", "within_1"), [(0.5, 38.3), (2.0, 95.4)])
def test_a_sigma_too_small_or_too_large_shows(factor: float, within_1: float) -> None:
    summary = filled(factor)
    assert summary["shear inside"]["within_1"] == pytest.approx(within_1, abs=2)
    assert summary["fz"]["within_1"] == pytest.approx(within_1, abs=8)


def test_outside_counts_false_and_missed_force_but_not_what_is_sure() -> None:
    truth, force = np.zeros(SHAPE), np.zeros(SHAPE)
    force[3, 3, 2] = -2e-3  # false
    truth[9, 9, 2] = -1e-3  # missed
    truth[9, 12, 2] = -0.1e-3  # below a sixteenth of the threshold: not at stake
    coverage = Coverage(PLACES, STEP_N, THRESHOLD_N)
    coverage.add(Stated(force, np.full(SHAPE, 1.5e-3), np.eye(6)), truth)
    outside = coverage.summary()["normal outside"]
    assert outside["n"] == 2
    assert outside["within_1"] == 50
    assert outside["within_2"] == 100
    assert coverage.summary()["normal inside"]["n"] == 0
    text = table({"states": 3, "columns": coverage.summary()})
    assert "3 independent states" in text
    assert "normal outside" in text
