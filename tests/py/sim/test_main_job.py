"""What `make run` judges of its own stream."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ruffini.demo.main_job import CheckFailed, Run, check_sums
from ruffini.device.results import NOT_MEASURED, VALID, Field

NEWTONS = np.array([0.3, -0.1, -2.0])


def run_of(*frames: tuple[tuple[int, ...], tuple[int, ...]], off_un: int = 0) -> Run:
    """Frames with a wrench and a field of four nodes, of these validities."""
    run = Run()
    for i, (of_wrench, of_field) in enumerate(frames):
        steps = np.zeros((2, 2, 3), np.int32)
        steps[0, 0] = np.round(NEWTONS * 1e6).astype(int) - 5
        steps[1, 1] = [5, 5, 5 + off_un]
        field: Any = Field(0.0, i, 0, steps * 1e-6, steps, 1e-6, None, of_field)
        run.results["WRENCH"][i] = SimpleNamespace(values=np.concatenate([NEWTONS, np.zeros(3)]), validity=of_wrench)
        run.results["FIELD"][i] = field
    return run


ALL, NONE = (VALID,) * 3, (NOT_MEASURED,) * 3
SHEAR = (VALID, VALID, NOT_MEASURED)


def test_the_largest_difference_is_named() -> None:
    assert check_sums(run_of((ALL, ALL), (NONE, NONE))) == 0
    assert check_sums(run_of((ALL, ALL), off_un=3)) == 3


def test_axes_along_which_the_wrench_is_not_valid_are_left_out() -> None:
    assert check_sums(run_of((SHEAR, SHEAR), (SHEAR, ALL), off_un=3)) == 0


@pytest.mark.parametrize("validity", [NONE, SHEAR])
def test_a_field_that_is_not_measured_fails(validity: tuple[int, ...]) -> None:
    with pytest.raises(CheckFailed, match="frame 1: the wrench is valid along an axis along which its field is not"):
        check_sums(run_of((ALL, ALL), (ALL, validity)))


def test_nothing_to_compare_fails() -> None:
    with pytest.raises(CheckFailed, match="cannot be compared"):
        check_sums(run_of((NONE, NONE)))
