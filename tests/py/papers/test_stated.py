"""Shares of truths within stated deviations."""

import numpy as np
import pytest
from papers.stated import coverage


def test_a_deviation_of_zero_covers_nothing_and_what_is_not_reported_does_not_count() -> None:
    error = np.array([1e-9, 0.5, 1.5, 3.0, np.nan, 1.0])
    sigma = np.array([0.0, 1.0, 1.0, 1.0, 1.0, np.nan])
    found = coverage(error, sigma)
    assert found["n"] == 4
    assert (found["within_1"], found["within_2"]) == pytest.approx((25, 50))
