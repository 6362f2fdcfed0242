"""One run of the experiment, as the core and the truth tell it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from papers.recorded import Recorded

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Played:
    """One run, frame by frame from the first touch on.

    load (t,) N into the skin as it is and cell (t,) as the load cell says; ours (t,) the sum over the touches;
    sigma (t,); touches, place_sigma: places (k, 2) mm of each frame, and their sigmas (k,); level (t,) and peak_px
    (t, 2) of the brightest pixel.
    """

    recorded: Recorded
    load: Array
    cell: Array
    ours: Array
    sigma: Array
    flags: npt.NDArray[np.int64]
    touches: list[Array]
    place_sigma: list[Array]
    level: Array
    peak_px: Array

    @property
    def name(self) -> str:
        return self.recorded.set_name

    @property
    def way(self) -> Array:
        return np.asarray(self.recorded.truth["pose"][self.recorded.touched, 2])

    @property
    def place(self) -> Array:
        """Where the tool's axis is, (2,) mm."""
        return np.asarray(self.recorded.truth["pose"][self.recorded.touched[0], :2] * 1e3)

    @property
    def is_down(self) -> npt.NDArray[np.bool_]:
        return np.asarray(np.arange(len(self.load)) <= int(np.argmax(self.way)))
