"""The covariance of a WRENCH (proto/README.md): 21 integers and the matrix that they are."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

COVARIANCE_SIZE = 21  # upper triangle of 6 x 6


def full_covariance(upper: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Upper triangle by rows (21,), (uN, uN mm)^2 -> symmetric (6, 6), N and N m."""
    out = np.zeros((6, 6))
    out[np.triu_indices(6)] = upper
    scale = np.array([1e-6] * 3 + [1e-9] * 3)
    return np.asarray((out + np.triu(out, 1).T) * np.outer(scale, scale))
