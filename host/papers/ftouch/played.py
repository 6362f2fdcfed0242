"""One run of the experiment, as the core and the truth tell it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from papers.recorded import Recorded

Array = npt.NDArray[np.float64]
RANGES = np.array([1.0, 1.0, 8.0, 20.0, 20.0, 20.0])  # of the paper's sensor, N and N mm; Table III divides by them


@dataclass(frozen=True)
class Played:
    """One run, frame by frame from the first touch on: N and N mm.

    Ours is NaN on axes that the board does not call valid, the paper's where it sees no three targets.
    """

    recorded: Recorded
    truth: Array
    reference: Array
    ours: Array
    paper: Array
    sigma: Array
    flags: npt.NDArray[np.int64]
    features: Array  # (t, n, 3) shift and change of area of each target, px and px^2
    places_px: Array  # (n, 3) centre and radius of each target at rest
    depth_um: Array | None  # at the deepest frame

    @property
    def judged(self) -> npt.NDArray[np.bool_]:
        """In the ranges of the paper's sensor, and not flagged."""
        return np.asarray((self.flags == 0) & (np.abs(self.truth) <= RANGES).all(axis=1))
