"""Full scale of the axes of a wrench: what a log loads, and where it loads an axis next to nothing."""

from __future__ import annotations

import numpy as np

from ruffini.estimators.wrench.model import ranges_of
from ruffini.rig.log_file import TouchRecord, stated_wrench


def test_noise_of_an_axis_is_no_range() -> None:
    largest = np.array([0.05, 1.0, 10.0, 0.4, 3.0, 0.02])  # N, N mm
    assert ranges_of(largest).tolist() == [0.2, 1.0, 10.0, 1.0, 3.0, 1.0]
    assert ranges_of(np.array([0, 0, 0, 0.4, 3.0, 0.02])).tolist() == [0, 0, 0, 0.4, 3.0, 0.02]


def test_forces_that_the_sensor_calls_invalid_are_not_judged_as_stated() -> None:
    validity = np.array([[1] * 6, [3] * 6, [2, 2, 1, 1, 1, 1]])
    touch = TouchRecord({}, {"stream_wrench": np.ones((3, 6)), "stream_validity": validity})
    assert np.isnan(stated_wrench(touch)).all(axis=1).tolist() == [False, True, False]
    assert np.isfinite(stated_wrench(touch)[[0, 2]]).all()
