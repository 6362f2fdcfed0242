"""The board's wrench of features in its integers, without a board (firmware/stages/feature_wrench/feature_wrench.h)."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.core.pipeline import N_COVARIANCE
from ruffini.errors import InputError
from ruffini.native import library

Array = npt.NDArray[np.float64]
UPPER = np.triu_indices(6)


class Stated(NamedTuple):
    """Of frames: wrench (t, 6) and standard deviation (t, 6), N and N mm; whether features agree, are in range."""

    wrench: Array
    sigma: Array
    agrees: npt.NDArray[np.bool_]
    is_in_range: npt.NDArray[np.bool_]


def wrench_on_board(calibration: bytes, features: str, raw: Array, time_s: Array) -> Stated:
    """Run frames one after the other, from rest.

    Parameters
    ----------
    features : str
        Sort of features that the file is for: targets, markers or columns.
    raw : (t, n)
        Features in the core's integers.
    time_s : (t,)
        When each was captured, rising.

    Raises
    ------
    InputError
        The core refuses the file.
    """
    core = library()
    rows = np.ascontiguousarray(np.clip(np.round(raw), -(2**31), 2**31 - 1), np.int32)
    handle = core.ruffini_wrench_open(
        calibration, ctypes.c_size_t(len(calibration)), features.encode(), ctypes.c_int32(rows.shape[1])
    )
    if not handle:
        raise InputError(core.ruffini_error().decode())
    capture_us = np.round(1e6 * (time_s - time_s[0])).astype(np.uint64) + 1
    wrench = np.zeros((len(rows), 6), np.int64)
    covariance = np.zeros((len(rows), N_COVARIANCE), np.int64)
    state = np.zeros(len(rows), np.uint8)

    def pointer(array: npt.NDArray[Any]) -> ctypes.c_void_p:
        return array.ctypes.data_as(ctypes.c_void_p)

    try:
        core.ruffini_wrench_run(
            ctypes.c_void_p(handle), pointer(rows), pointer(capture_us), ctypes.c_int32(len(rows)), pointer(wrench),
            pointer(covariance), pointer(state),
        )  # fmt: skip
    finally:
        core.ruffini_wrench_close(ctypes.c_void_p(handle))
    diagonal = covariance[:, UPPER[0] == UPPER[1]]
    return Stated(wrench * np.array([1e-6] * 3 + [1e-9] * 3), 1e-6 * np.sqrt(diagonal), (state & 1) == 0,
                  (state & 2) == 0)  # fmt: skip
