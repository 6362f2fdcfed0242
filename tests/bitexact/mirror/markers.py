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
        self.gate2, self.seed2, self.step2, self.tight2, self.search2 = (
            (pitch * p // 100) ** 2 for p in (45, 60, 35, 25, 110)
        )
        self.pitch2 = (pitch >> 8) ** 2
        self.view = np.array([camera["width_px"], camera["height_px"]], np.int64) << 16
        self.edge = length_q16(board, m["diameter_um"])
        self.middle = 0
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
        self.middle = seeds[grown.index(best)] if best else seeds[0]
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
        last = rows[:, [DX, DY]].copy()
        moved, known, at = self._look(place, last, self.gate2)
        cost, missing, widest2 = self._judge(moved, known, at, len(dots))
        limit2 = self.pitch2 * 33**2 // 10_000
        step2 = (((moved - last) >> 8) ** 2).sum(axis=1)[known].max(initial=0)
        left = len(dots) - int(known.sum())
        if missing or widest2 > limit2 or 2 * left >= min(self.n_x, self.n_y) or step2 > limit2:
            from_middle = place - rows[self.middle, [X, Y]]
            near = from_middle[(from_middle**2).sum(axis=1) < self.search2]
            for shift in (np.zeros(2, np.int64), *near):
                again, seen, there = self._look(place, np.broadcast_to(shift, last.shape), self.tight2)
                price = self._judge(again, seen, there, len(dots))[0]
                if seen.any() and (price < cost or not known.any()):
                    moved, known, cost = again, seen, price
        rows[:, [DX, DY]] = np.where(known[:, None], moved, last)
        rows[:, LOST] = ~known
        self._fill(known)
        return int((~known & (rows[:, ABSENT] == 0)).sum())

    def _look(
        self, place: npt.NDArray[np.int64], start: npt.NDArray[np.int64], gate2: int
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
        """Displacements, which are known, and where each marker was last expected."""
        rest = self.rows[:, [X, Y]]
        moved, known = start.copy(), np.zeros(len(rest), bool)
        is_open, taken = self.rows[:, ABSENT] == 0, np.zeros(len(place), bool)
        expected = rest + start
        gate = gate2
        for ring in range(17):
            if ring > 0:
                if not is_open.any() or not known.any():
                    break
                for i in np.flatnonzero(is_open):
                    led = self._led(int(i), known, moved)
                    if led is not None:
                        expected[i] = rest[i] + led
            pairs = self._mutual(place, expected, is_open, taken, gate)
            for marker, j in pairs:
                moved[marker] = place[j] - rest[marker]
                known[marker], is_open[marker], taken[j] = True, False, True
            if not pairs and gate == self.gate2 and ring > 0:
                break
            gate = self.tight2 if pairs else self.gate2
        return moved, known, expected

    def _led(self, at: int, known: npt.NDArray[np.bool_], moved: npt.NDArray[np.int64]) -> npt.NDArray[np.int64] | None:
        """Displacement on the straight line through two neighbours in a row, else the neighbours' mean."""
        y, x = divmod(at, self.n_x)
        lines = []
        for step_x, step_y in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            if 0 <= x + 2 * step_x < self.n_x and 0 <= y + 2 * step_y < self.n_y:
                near, far = (at + n * (step_y * self.n_x + step_x) for n in (1, 2))
                if known[near] and known[far]:
                    lines.append(2 * moved[near] - moved[far])
        return np.sum(lines, axis=0) // len(lines) if lines else self._neighbour_mean(at, known, moved)

    def _judge(
        self,
        moved: npt.NDArray[np.int64],
        known: npt.NDArray[np.bool_],
        expected: npt.NDArray[np.int64],
        n_dots: int,
    ) -> tuple[int, int, int]:
        """Cost, markers missing inside the view, widest squared difference between neighbours."""
        grid = (moved >> 8).reshape(self.n_y, self.n_x, 2)
        exact = moved.reshape(self.n_y, self.n_x, 2)
        seen = known.reshape(self.n_y, self.n_x)
        right = ((exact[:, :-1] - exact[:, 1:]) >> 8) ** 2
        below = ((exact[:-1] - exact[1:]) >> 8) ** 2
        apart = np.concatenate([right.sum(axis=2)[seen[:, :-1] & seen[:, 1:]], below.sum(axis=2)[seen[:-1] & seen[1:]]])
        lost = ~known & (self.rows[:, ABSENT] == 0)
        inside = ((expected >= self.edge) & (expected < self.view - self.edge)).all(axis=1)
        missing = int((lost & inside).sum())
        cost = 16 * int(apart.sum()) + int((grid**2).sum(axis=2)[seen].sum())
        cost += self.pitch2 * (16 * missing + 8 * (n_dots - int(known.sum())))
        return cost, missing, int(apart.max(initial=0))

    def _mutual(
        self,
        place: npt.NDArray[np.int64],
        expected: npt.NDArray[np.int64],
        is_open: npt.NDArray[np.bool_],
        taken: npt.NDArray[np.bool_],
        gate2: int,
    ) -> list[tuple[int, int]]:
        markers, dots = np.flatnonzero(is_open), np.flatnonzero(~taken)
        if len(markers) == 0 or len(dots) == 0:
            return []
        distance2 = ((expected[markers][:, None] - place[dots][None]) ** 2).sum(axis=2)
        of_marker, of_dot = distance2.argmin(axis=1), distance2.argmin(axis=0)
        return [
            (int(markers[a]), int(dots[b]))
            for a, b in enumerate(of_marker)
            if of_dot[b] == a and distance2[a, b] < gate2
        ]

    def _neighbour_mean(
        self, at: int, known: npt.NDArray[np.bool_], moved: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.int64] | None:
        y, x = divmod(at, self.n_x)
        around = [
            v * self.n_x + u
            for v in range(max(y - 1, 0), min(y + 2, self.n_y))
            for u in range(max(x - 1, 0), min(x + 2, self.n_x))
            if known[v * self.n_x + u]
        ]
        if not around:
            return None
        total: npt.NDArray[np.int64] = moved[around].sum(axis=0)
        return np.asarray(total // len(around))

    def _fill(self, known: npt.NDArray[np.bool_]) -> None:
        while known.any() and not known.all():
            reached = known.copy()
            for i in np.flatnonzero(~known):
                mean = self._neighbour_mean(int(i), known, self.rows[:, [DX, DY]])
                if mean is not None:
                    self.rows[i, [DX, DY]] = mean
                    reached[i] = True
            known = reached
