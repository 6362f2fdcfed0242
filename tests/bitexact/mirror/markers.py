"""Which dot is which marker: growth over the lattice at rest, mutual nearest neighbours afterwards."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.board import Board, center_q16, length_q16

X, Y, DX, DY, LOST, ABSENT = range(6)  # columns of the marker rows
Dots = npt.NDArray[np.int32]


class Lattice:
    """State of all markers; `rows` (n_markers, 6) int64."""

    def __init__(self, board: Board) -> None:
        m, camera = board["markers"], board["camera"]
        self.n_x, self.n_y = m["n_x"], m["n_y"]
        pitch = length_q16(board, min(m["pitch_x_um"], m["pitch_y_um"]))
        self.gate2, self.seed2, self.step2 = ((pitch * p // 100) ** 2 for p in (45, 60, 35))
        scale = camera["focal_mpx"] * 2**32 // (camera["standoff_um"] * 1000)
        self.nominal = np.zeros((self.n_x * self.n_y, 2), np.int64)
        for axis, name in enumerate("xy"):
            corner = center_q16(board, name) - (board["pad"][f"size_{name}_um"] * scale >> 17)
            n = np.arange(len(self.nominal))
            line = n % self.n_x if axis == 0 else n // self.n_x
            um = m[f"first_{name}_um"] + line * m[f"pitch_{name}_um"]
            self.nominal[:, axis] = corner + (um * scale >> 16)
        self.rows = np.zeros((len(self.nominal), 6), np.int64)
        self.rows[:, [LOST, ABSENT]] = 1

    # ---- at rest -----------------------------------------------------------------------------

    def learn(self, dots: Dots) -> int:
        """Rest places from the dots of the rest image; number of markers found."""
        middle = (self.n_y // 2) * self.n_x + self.n_x // 2
        seeds = (middle, middle - 1, middle - self.n_x, middle - self.n_x - 1)
        grown = [self._grow(dots, seed) for seed in seeds]
        best = max(grown, key=len)  # the first of the longest
        place = dots[:, :2].astype(np.int64)
        self.rows[:] = 0
        self.rows[:, [LOST, ABSENT]] = 1
        shift = np.zeros(2, np.int64)
        if best:
            found, dot = np.array(list(best.items())).T
            shift = (place[dot] - self.nominal[found]).sum(axis=0) // len(best)
        self.rows[:, [X, Y]] = self.nominal + shift
        for marker, j in best.items():
            self.rows[marker, [X, Y]] = place[j]
            self.rows[marker, [LOST, ABSENT]] = 0
        return len(best)

    def _grow(self, dots: Dots, seed: int) -> dict[int, int]:
        free = np.ones(len(dots), bool)
        place = dots[:, :2].astype(np.int64)
        found: dict[int, int] = {}
        queue: list[int] = []

        def assign(marker: int, expected: npt.NDArray[np.int64], limit2: int) -> None:
            distance2 = np.where(free, ((place - expected) ** 2).sum(axis=1), limit2)
            if len(dots) == 0 or distance2.min() >= limit2:
                return
            j = int(distance2.argmin())
            free[j] = False
            found[marker] = j
            queue.append(marker)

        assign(seed, self.nominal[seed], self.seed2)
        for at in queue:
            for n in self._edges(at):
                if n not in found:
                    step = self.nominal[n] - self.nominal[at]
                    assign(n, place[found[at]] + step, self.step2)
        return found

    def _edges(self, at: int) -> list[int]:
        y, x = divmod(at, self.n_x)
        out = [at - 1] if x > 0 else []
        out += [at + 1] if x + 1 < self.n_x else []
        out += [at - self.n_x] if y > 0 else []
        return out + ([at + self.n_x] if y + 1 < self.n_y else [])

    # ---- frame by frame ----------------------------------------------------------------------

    def track(self, dots: Dots) -> int:
        """Displacements from the dots of one frame; number of markers lost that rest had."""
        rows = self.rows
        place = dots[:, :2].astype(np.int64)
        is_open = rows[:, ABSENT] == 0
        taken = np.zeros(len(dots), bool)
        known = np.zeros(len(rows), bool)
        expected = rows[:, [X, Y]] + rows[:, [DX, DY]]
        for attempt in range(2):
            if attempt == 1:
                for i in np.flatnonzero(is_open):
                    mean = self._neighbour_mean(int(i), known)
                    if mean is not None:
                        expected[i] = rows[i, [X, Y]] + mean
            for marker, j in self._mutual(place, expected, is_open, taken):
                rows[marker, [DX, DY]] = place[j] - rows[marker, [X, Y]]
                known[marker], is_open[marker], taken[j] = True, False, True
        rows[:, LOST] = ~known
        self._fill(known)
        return int(is_open.sum())

    def _mutual(
        self,
        place: npt.NDArray[np.int64],
        expected: npt.NDArray[np.int64],
        is_open: npt.NDArray[np.bool_],
        taken: npt.NDArray[np.bool_],
    ) -> list[tuple[int, int]]:
        markers, dots = np.flatnonzero(is_open), np.flatnonzero(~taken)
        if len(markers) == 0 or len(dots) == 0:
            return []
        distance2 = ((expected[markers][:, None] - place[dots][None]) ** 2).sum(axis=2)
        of_marker, of_dot = distance2.argmin(axis=1), distance2.argmin(axis=0)
        return [
            (int(markers[a]), int(dots[b]))
            for a, b in enumerate(of_marker)
            if of_dot[b] == a and distance2[a, b] < self.gate2
        ]

    def _neighbour_mean(self, at: int, known: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64] | None:
        y, x = divmod(at, self.n_x)
        around = [
            v * self.n_x + u
            for v in range(max(y - 1, 0), min(y + 2, self.n_y))
            for u in range(max(x - 1, 0), min(x + 2, self.n_x))
            if known[v * self.n_x + u]
        ]
        if not around:
            return None
        total: npt.NDArray[np.int64] = self.rows[around][:, [DX, DY]].sum(axis=0)
        return np.asarray(total // len(around))

    def _fill(self, known: npt.NDArray[np.bool_]) -> None:
        while known.any() and not known.all():
            reached = known.copy()
            for i in np.flatnonzero(~known):
                mean = self._neighbour_mean(int(i), known)
                if mean is not None:
                    self.rows[i, [DX, DY]] = mean
                    reached[i] = True
            known = reached
