"""The factor that makes stated uncertainties cover what they should of the errors on presses left out of a fit."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

ONE_SIGMA, TWO_SIGMAS = 0.6827, 0.9545  # of a normal distribution


def scale_of(ratio: Array) -> Array:
    """Factor of stated sigmas, of |error| over sigma (t, ...) on what was left out.

    The geometric mean of the factors that 68 % within one sigma and 95 % within two ask for. A root mean square follows
    the few largest errors: where the errors have long tails, it is too wide for all others.
    """
    size = np.abs(ratio)
    one, two = np.quantile(size, ONE_SIGMA, axis=0), np.quantile(size, TWO_SIGMAS, axis=0) / 2
    return np.asarray(np.sqrt(one * two))
