"""One run of the experiment, as the core and the truth tell it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from papers.recorded import Recorded
from ruffini.core.pipeline import ModelledRow

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Played:
    """One run from the first touch on, as the core tells it with the calibration in force.

    wrench, truth, reference (t, 6) N and N m; rows of the contact model.
    """

    recorded: Recorded
    wrench: Array
    truth: Array
    reference: Array
    rows: list[ModelledRow]
    is_valid: npt.NDArray[np.bool_]  # (t, 6)
    sigma: Array  # (t, 6) that it states
    fall: Array

    @property
    def shape(self) -> str:
        return str(self.recorded.run.chosen["indenter"])

    @property
    def radius_mm(self) -> float:
        return float(str(self.recorded.run.chosen["radius_um"])) * 1e-3

    @property
    def shore_a(self) -> float:
        return float(str(self.recorded.run.chosen["shore_a"]))

    @property
    def told(self) -> ModelledRow:
        """The last frame: what it says of hardness is the mean over the press."""
        return self.rows[-1]

    @property
    def gel_mm(self) -> Array:
        return np.asarray(self.recorded.rig["gel_depth_m"][self.recorded.touched] * 1e3)

    def of(self, name: str) -> Array:
        """A column of the rows."""
        return np.array([getattr(row, name) for row in self.rows], dtype=np.float64)
