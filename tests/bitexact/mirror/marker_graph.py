"""Neighbours of markers: on the lattice, or of scattered ones by where they rest."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.fixed import I64

Bools = npt.NDArray[np.bool_]
MAX_NEAR = 8


class Graph:
    """`beside`, `around` and `lines` (near, far) of each marker."""

    def __init__(self, n_x: int, n_y: int) -> None:
        def cells(x: int, y: int, steps: list[tuple[int, int]]) -> list[int]:
            return [(y + v) * n_x + x + u for u, v in steps if 0 <= x + u < n_x and 0 <= y + v < n_y]

        cross = [(-1, 0), (1, 0), (0, -1), (0, 1)]
        square = [(u, v) for v in (-1, 0, 1) for u in (-1, 0, 1) if u or v]
        places = [(i % n_x, i // n_x) for i in range(n_x * n_y)]
        self.beside = [cells(x, y, cross) for x, y in places]
        self.around = [cells(x, y, square) for x, y in places]
        self.lines: list[list[tuple[int, int]]] = []
        for x, y in places:
            far = [(u, v, cells(x, y, [(2 * u, 2 * v)])) for u, v in cross]
            self.lines.append([((y + v) * n_x + x + u, f[0]) for u, v, f in far if f])

    def connect(self, rest: I64, is_there: Bools) -> None:
        """Gabriel's neighbours of scattered markers, at most eight, where each is the other's."""
        n = len(rest)
        apart2 = ((rest[:, None] - rest[None]) ** 2).sum(axis=2)
        near: list[list[int]] = []
        for i in range(n):
            found = []
            for j in np.flatnonzero(is_there) if is_there[i] else []:
                third = is_there & (np.arange(n) != i) & (np.arange(n) != j)
                if j != i and not (apart2[i] + apart2[j] < apart2[i, j])[third].any():
                    found.append(int(j))
            near.append(sorted(found, key=lambda j: (int(apart2[i, j]), j))[:MAX_NEAR])
        self.beside = [[j for j in near[i] if i in near[j]] for i in range(n)]
        self.around = self.beside
        self.lines = [self._lines(rest, i) for i in range(n)]

    def _lines(self, rest: I64, i: int) -> list[tuple[int, int]]:
        lines = []
        for j in self.beside[i]:
            wanted = 2 * rest[j] - rest[i]
            off2 = [(int(((rest[k] - wanted) ** 2).sum()), at, k) for at, k in enumerate(self.beside[j]) if k != i]
            nearest = min(off2, default=None)
            if nearest is not None and nearest[0] < int(((rest[i] - rest[j]) ** 2).sum()) // 4:
                lines.append((j, nearest[2]))
        return lines

    def mean_around(self, at: int, known: Bools, moved: I64) -> I64 | None:
        """Mean of the known ones around a marker."""
        some = [j for j in self.around[at] if known[j]]
        return np.asarray(moved[some].sum(axis=0) // len(some)) if some else None

    def led(self, at: int, known: Bools, moved: I64) -> I64 | None:
        """On the straight lines through two known markers, else the mean of those around."""
        said = [2 * moved[near] - moved[far] for near, far in self.lines[at] if known[near] and known[far]]
        return np.asarray(np.sum(said, axis=0) // len(said)) if said else self.mean_around(at, known, moved)

    def fill(self, known: Bools, moved: I64) -> None:
        """Ring by ring; `moved` is changed in place."""
        while True:
            means = {int(i): self.mean_around(int(i), known, moved) for i in np.flatnonzero(~known)}
            reached = {i: mean for i, mean in means.items() if mean is not None}
            if not reached:
                return
            known = known.copy()
            for i, mean in reached.items():
                moved[i], known[i] = mean, True
