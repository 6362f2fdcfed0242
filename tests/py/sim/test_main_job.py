"""What `make run` judges of its own stream."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ruffini.demo.main_job import CheckFailed, Run, check_sums
from ruffini.device.results import NOT_MEASURED, VALID, Field

NEWTONS = np.array([0.3, -0.1, -2.0])


def run_of(*frames: tuple[np.ndarray, tuple[int, ...]], off_un: int = 0) -> Run:
    """Frames with a wrench and a field of four nodes of that validity."""
    run = Run()
    for i, (force, validity) in enumerate(frames):
        steps = np.zeros((2, 2, 3), np.int32)
        steps[0, 0] = np.round(NEWTONS * 1e6).astype(int) - 5
        steps[1, 1] = [5, 5, 5 + off_un]
        field: Any = Field(0.0, i, 0, steps * 1e-6, steps, 1e-6, None, validity)
        run.results["WRENCH"][i] = SimpleNamespace(values=np.concatenate([force, np.full(3, np.nan)]))
        run.results["FIELD"][i] = field
    return run


ALL, NONE = (VALID,) * 3, (NOT_MEASURED,) * 3
NAN = np.full(3, np.nan)


def test_the_largest_difference_is_named() -> None:
    assert check_sums(run_of((NEWTONS, ALL), (NAN, NONE))) == 0
    assert check_sums(run_of((NEWTONS, ALL), off_un=3)) == 3


def test_axes_that_the_wrench_does_not_measure_are_left_out() -> None:
    shear = np.array([0.3, -0.1, np.nan])
    assert check_sums(run_of((shear, (VALID, VALID, NOT_MEASURED)), off_un=3)) == 0


@pytest.mark.parametrize("validity", [NONE, (VALID, VALID, NOT_MEASURED)])
def test_a_field_that_is_not_measured_fails(validity: tuple[int, ...]) -> None:
    with pytest.raises(CheckFailed, match="frame 1: the wrench is measured along an axis along which its field is not"):
        check_sums(run_of((NEWTONS, ALL), (NEWTONS, validity)))


def test_nothing_to_compare_fails() -> None:
    with pytest.raises(CheckFailed, match="cannot be compared"):
        check_sums(run_of((NAN, NONE)))
