"""Coverage of stated uncertainties: the share of truths within one and two stated standard deviations. SIMULATED."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from ruffini.bench.coverage import Tally
from ruffini.tables import aligned
from ruffini.wire.covariance import full_covariance

Array = npt.NDArray[np.float64]

Coverage = dict[str, float]


def deviations(covariance: npt.NDArray[np.int64]) -> Array:
    """Of each axis (6,), N and N m, from the covariance as the core has it (`Pipeline.covariance`)."""
    return np.asarray(np.sqrt(np.diag(full_covariance(covariance))))


def coverage(error: Array, sigma: Array) -> Coverage:
    """Percent within one and two sigma, mean sigma in the unit of the error, and the number of values.

    Values that are not reported, or whose sigma is not (NaN), do not count. A sigma of zero covers nothing.
    """
    counts = np.isfinite(error) & np.isfinite(sigma)
    tally = Tally()
    tally.add(error[counts], np.maximum(sigma[counts], np.finfo(float).tiny))
    return tally.summary()


def covered(rows: dict[str, Coverage], names: Iterable[str]) -> dict[str, float]:
    """Figures of wanted.toml, percent: those of `names` that were measured."""
    return {
        f"{name} within {k} sigma": rows[name][f"within_{k}"]
        for name in names
        if name in rows and rows[name]["n"]
        for k in (1, 2)
    }


def lines(title: str, rows: dict[str, Coverage]) -> list[str]:
    """A table for a person."""
    return [title, *aligned(("", "within 1 sigma", "within 2 sigma", "mean sigma", "values"), [
        (name, f"{row['within_1']:.1f} %", f"{row['within_2']:.1f} %", f"{row['mean_sigma']:.3g}", row["n"])
        for name, row in rows.items()
    ], "  ")]  # fmt: skip
