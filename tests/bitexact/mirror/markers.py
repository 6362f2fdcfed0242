"""Which dot is which marker: growth over lattice or list at rest, mutual nearest neighbours afterwards."""

from __future__ import annotations

from math import isqrt

import numpy as np
import numpy.typing as npt

from mirror.board import Board, center_q16, length_q16
from mirror.marker_graph import Graph

X, Y, DX, DY, LOST, ABSENT = range(6)  # columns of the marker rows
Dots = npt.NDArray[np.int32]
Errors = npt.NDArray[np.int64]


class Lattice:
    """State of all markers; `rows` (n_markers, 6) int64."""

    def __init__(self, board: Board) -> None:
        m, camera = board["markers"], board["camera"]
        self.n_x, self.n_y = m["n_x"], m["n_y"]
        pitch = length_q16(board, min(m["pitch_x_um"], m["pitch_y_um"]))
        self.gate2, self.seed2, self.step2, self.tight2, self.search2 = (
            (pitch * p // 100) ** 2 for p in (45, 60, 35, 25, 200 if m.get("layout", "lattice") == "scattered" else 110)
        )
        # Of a view, all counted in one row, the side of a square of as many.
        self.many_left = min(self.n_x, self.n_y) if self.n_y > 1 else isqrt(self.n_x)
        self.pitch_q8 = pitch >> 8
        self.pitch2 = self.pitch_q8**2
        self.view = np.array([camera["width_px"], camera["height_px"]], np.int64) << 16
        self.edge = length_q16(board, m["diameter_um"])
        self.middle = 0
        scale = camera["focal_mpx"] * 2**32 // (camera["standoff_um"] * 1000)
        self.graph = Graph(self.n_x, self.n_y)
        self.is_scattered = m.get("layout", "lattice") == "scattered"
        self.nominal = np.zeros((self.n_x * self.n_y, 2), np.int64)
        for axis, name in enumerate("xy"):
            corner = center_q16(board, name) - (board["pad"][f"size_{name}_um"] * scale >> 17)
            n = np.arange(len(self.nominal))
            line = n % self.n_x if axis == 0 else n // self.n_x
            um = m[f"first_{name}_um"] + line * m[f"pitch_{name}_um"]
            if "places_um" in m:
                um = np.array(m["places_um"], np.int64)[:, axis]
            self.nominal[:, axis] = corner + (um * scale >> 16)
        middle = (self.n_y // 2) * self.n_x + self.n_x // 2
        self.seeds = [middle, middle - 1, middle - self.n_x, middle - self.n_x - 1]
        self.is_listed = not self.is_scattered or "places_um" in m
        if self.is_scattered and self.is_listed:
            free = np.ones(len(self.nominal), bool)
            self.graph.connect(self.nominal, free)
            self.seeds = [self._take_middle(self.nominal, free) for _ in range(4)]
        self.rows = np.zeros((len(self.nominal), 6), np.int64)
        self.quality, self.rest_area = np.zeros(len(self.rows), np.int64), np.ones(len(self.rows), np.int64)
        self.rows[:, [LOST, ABSENT]] = 1

    # ---- at rest -----------------------------------------------------------------------------

    def learn(self, dots: Dots) -> int:
        """Rest places from the dots of the rest image; number of markers found."""
        if not self.is_listed:
            return self._take_all(dots)
        seeds = self.seeds
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
        self.rest_area[:] = 1
        for marker, j in best.items():
            self.rest_area[marker] = dots[j, 2]
            self.rows[marker, [X, Y]] = place[j]
            self.rows[marker, [LOST, ABSENT]] = 0
        return len(best)

    def _take_all(self, dots: Dots) -> int:
        n = min(len(dots), len(self.rows))
        self.rows[:] = 0
        self.rows[:, [X, Y]] = -self.edge
        self.rows[:n, [X, Y]] = dots[:n, :2]
        self.rest_area[:] = 1
        self.rest_area[:n] = dots[:n, 2]
        self.rows[n:, [LOST, ABSENT]] = 1
        is_there = np.arange(len(self.rows)) < n
        self.graph.connect(self.rows[:, [X, Y]], is_there)
        self.middle = self._take_middle(self.rows[:, [X, Y]], is_there)
        return n

    @staticmethod
    def _take_middle(places: npt.NDArray[np.int64], free: npt.NDArray[np.bool_]) -> int:
        """The free place nearest to the mean of the free ones; it is free no longer."""
        if not free.any():
            return 0
        mean = places[free].sum(axis=0) // int(free.sum())
        distance2 = ((places - mean) ** 2).sum(axis=1)
        best = int(np.where(free, distance2, distance2.max() + 1).argmin())
        free[best] = False
        return best

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
            for n in self.graph.beside[at]:
                if n not in found:
                    step = self.nominal[n] - self.nominal[at]
                    assign(n, place[found[at]] + step, self.step2)
        return found

    # ---- frame by frame ----------------------------------------------------------------------

    def track(self, dots: Dots, error2: Errors) -> int:
        """Displacements from the dots of one frame, which may be off; number of markers lost that rest had."""
        self.assign(dots)
        return self.finish(error2)

    def assign(self, dots: Dots) -> None:
        """Displacements from the dots of one frame."""
        rows = self.rows
        place = dots[:, :2].astype(np.int64)
        last = rows[:, [DX, DY]].copy()
        moved, known, at, dot = self._look(place, last, self.tight2 if self.is_scattered else self.gate2)
        cost, missing, widest2 = self._judge(moved, known, at, len(dots))
        limit2 = self.pitch2 * 33**2 // 10_000
        step2 = (((moved - last) >> 8) ** 2).sum(axis=1)[known].max(initial=0)
        left = len(dots) - int(known.sum())
        if missing or widest2 > limit2 or 2 * left >= self.many_left or step2 > limit2:
            n_known = 0

            def attempt(shift: npt.NDArray[np.int64], seed: int | None) -> None:
                nonlocal moved, known, cost, n_known, dot
                again, seen, there, theirs = self._look(place, np.broadcast_to(shift, last.shape), self.tight2, seed)
                price = self._judge(again, seen, there, len(dots))[0]
                if seen.any() and (price < cost or not known.any()):
                    moved, known, cost, n_known, dot = again, seen, price, int(seen.sum()), theirs

            attempt(np.zeros(2, np.int64), None)
            for seed in [self.middle, *(self.graph.beside[self.middle] if self.is_scattered else [])]:
                if seed != self.middle and 2 * n_known >= len(dots):
                    continue
                from_seed = place - rows[seed, [X, Y]]
                for shift in from_seed[(from_seed**2).sum(axis=1) < self.search2]:
                    attempt(shift, seed if self.is_scattered else None)
        self._area = np.where(known, dots[dot, 2] if len(dots) else 0, 0)
        rows[:, [DX, DY]] = np.where(known[:, None], moved, last)
        rows[:, LOST] = ~known

    def finish(self, error2: Errors) -> int:
        """Grade and fill; number of markers lost that rest had."""
        rows = self.rows
        known = self._graded(rows[:, [DX, DY]], rows[:, LOST] == 0, self._area, error2)
        rows[:, LOST] = ~known
        moved = rows[:, [DX, DY]]
        self.graph.fill(known, moved)
        rows[:, [DX, DY]] = moved
        return int((~known & (rows[:, ABSENT] == 0)).sum())

    def _look(
        self, place: npt.NDArray[np.int64], start: npt.NDArray[np.int64], gate2: int, seed: int | None = None
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_], npt.NDArray[np.int64], npt.NDArray[np.intp]]:
        """Displacements, which are known, where each marker was last expected, and its dot."""
        rest = self.rows[:, [X, Y]]
        moved, known = start.copy(), np.zeros(len(rest), bool)
        is_open, taken = self.rows[:, ABSENT] == 0, np.zeros(len(place), bool)
        expected = rest + start
        dot = np.zeros(len(rest), np.intp)
        gate = gate2
        is_led = np.ones(len(rest), bool) if seed is None else np.arange(len(rest)) == seed
        for ring in range(1 + (len(rest) if self.is_scattered else 16)):
            if ring > 0:
                if not is_open.any() or not known.any():
                    break
                for i in np.flatnonzero(is_open):
                    led = self.graph.led(int(i), known, moved)
                    if led is not None:
                        expected[i], is_led[i] = rest[i] + led, True
            pairs = self._mutual(place, expected, is_open & is_led, taken, gate)
            for marker, j in pairs:
                moved[marker] = place[j] - rest[marker]
                known[marker], is_open[marker], taken[j], dot[marker] = True, False, True, j
            if not pairs and ring > 0 and (gate == self.gate2 or self.is_scattered):
                break
            gate = self.tight2 if pairs or self.is_scattered else self.gate2
        return moved, known, expected, dot

    def _graded(
        self, moved: npt.NDArray[np.int64], known: npt.NDArray[np.bool_], area: npt.NDArray[np.int64], error2: Errors
    ) -> npt.NDArray[np.bool_]:
        """Sets the qualities; which markers stay known."""
        self.quality[:] = 0
        for i in np.flatnonzero(known):
            growth = sorted((int(area[j]) << 10) // int(self.rest_area[j]) for j in self.graph.around[i] if known[j])
            middle = max(growth[(len(growth) - 1) // 2], 1024) if len(growth) >= 3 else 1024
            if (int(area[i]) << 10) * 100 > 175 * int(self.rest_area[i]) * middle:
                continue
            lines = [line for line in self.graph.lines[i] if known[line[0]] and known[line[1]]]
            off2 = [int(((moved[i] - 2 * moved[near] + moved[far]) ** 2).sum()) for near, far in lines]
            off = max((isqrt(min(off2, default=0)) >> 8) - self.pitch_q8 // 4, 0)
            self.quality[i] = max(255 * 655 // (655 + int(error2[i]) + off**2), 1)
        self.quality[self.quality <= 9] = 0
        return self.quality > 0

    def _judge(
        self,
        moved: npt.NDArray[np.int64],
        known: npt.NDArray[np.bool_],
        expected: npt.NDArray[np.int64],
        n_dots: int,
    ) -> tuple[int, int, int]:
        """Cost, markers missing inside the view, widest squared difference between neighbours."""
        pairs = [(i, j) for i, near in enumerate(self.graph.beside) for j in near if j > i and known[i] and known[j]]
        one, other = np.array(pairs, np.intp).reshape(-1, 2).T
        apart = (((moved[one] - moved[other]) >> 8) ** 2).sum(axis=1)
        lost = ~known & (self.rows[:, ABSENT] == 0)
        inside = ((expected >= self.edge) & (expected < self.view - self.edge)).all(axis=1)
        missing = int((lost & inside).sum())
        cost = 16 * int(apart.sum()) + int(((moved >> 8) ** 2).sum(axis=1)[known].sum())
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
