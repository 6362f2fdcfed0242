"""What a twin did while a simulated bench collected: the true wrench of every frame, and when its reference spoke."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.rig.log_file import Log, TouchRecord

Array = npt.NDArray[np.float64]

SOON_S = 0.02  # after it was spoken, a word has come


@dataclass
class Truth:
    """A listener of the twin (`TwinBench.twin.listeners`); frames are counted as the stream counts them.

    delay_s : by which the reference's word is held back.
    """

    delay_s: float = 0.0
    spoken_s: dict[int, float] = field(default_factory=dict)  # host time, by frame
    wrench: dict[int, Array] = field(default_factory=dict)  # (6,) N and N m, ON the pad, by frame

    def note(self, frame: int, wrench: Array) -> None:
        """The camera has this frame now, and the reference its wrench."""
        self.spoken_s[frame] = host_clock.now() + self.delay_s
        self.wrench[frame] = wrench.copy()

    def of(self, touch: TouchRecord) -> Array:
        """Of each frame of a touch's stream, (t, 6); NaN where the twin made no such frame."""
        unknown = np.full(6, np.nan)
        rows = [self.wrench.get(int(n), unknown) for n in touch.arrays["stream_frame"]]
        return np.array(rows).reshape(-1, 6)

    def offset_s(self, log: Log) -> float:
        """Time at which the reference's word of a frame came, less the frame's own time: median over a log."""
        later = []
        for touch in log.touches:
            came_s = touch.arrays["reference_s"]
            for number, stream_s in zip(touch.arrays["stream_frame"], touch.arrays["stream_s"], strict=True):
                spoken_s = self.spoken_s.get(int(number), np.inf)
                i = int(np.searchsorted(came_s, spoken_s))
                if i < len(came_s) and came_s[i] - spoken_s < SOON_S:
                    later.append(came_s[i] - stream_s)
        return float(np.median(later)) if later else float("nan")
