"""The core's markers and the mirror's, told the same dots: what one says the other must say."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from core_stages import CoreStages
from mirror.markers import Lattice

Places = npt.NDArray[np.int64]
Dots = npt.NDArray[np.int32]
NOTHING = np.zeros((0, 3), np.int32)


class MarkerTwins:
    """Dots of `place` (n, 2; px Q16) with dust among them, in any order, learnt and followed by both."""

    def __init__(
        self, core: CoreStages, lattice: Lattice, place: Places, n_dust: int, rng: np.random.Generator
    ) -> None:
        self.core, self.lattice, self.place, self.n_dust, self.rng = core, lattice, place, n_dust, rng
        self.n = len(place)
        self.area = rng.integers(20, 60, (self.n, 1))

    def dots(self, moved: Places | int, share: float) -> Dots:
        """Each dot is there with the probability `share`."""
        keep = self.rng.random(self.n) < share
        dust = np.hstack([self.rng.integers(0, 2_000_000, (self.n_dust, 2)), self.area[: self.n_dust]])
        area = self.area + self.rng.integers(-6, 7, (self.n, 1))
        rows = np.concatenate([np.hstack([self.place + moved, area])[keep], dust])
        return self.rng.permutation(rows).astype(np.int32)

    def learn(self, dots: Dots) -> int:
        """How many were found."""
        rows, n_found = self.core.learn_markers(dots, self.n)
        assert n_found == self.lattice.learn(dots)
        assert np.array_equal(rows, self.lattice.rows)
        return n_found

    def follow(self, dots: Dots) -> None:
        error2 = self.rng.integers(0, 20_000, self.n)
        rows, n_lost = self.core.track_markers(dots, error2)
        assert n_lost == self.lattice.track(dots, error2)
        assert np.array_equal(rows, self.lattice.rows)
        assert np.array_equal(self.core.marker_quality(self.n), self.lattice.quality)

    def follow_jumps(self, n_frames: int, pitch: int) -> None:
        """Of up to a pitch and a half, with a field of its own for each marker."""
        for _ in range(n_frames):
            jump = self.rng.integers(-3 * pitch // 2, 3 * pitch // 2, 2)
            self.follow(self.dots(jump + self.rng.integers(-pitch // 4, pitch // 4, (self.n, 2)), 0.9))
