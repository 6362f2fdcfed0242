"""Places in clusters: halves of halves along the longer side, as the hierarchy and the dense blocks need them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

ORDER_LEAF = 16  # places within which the order no longer matters


def halves(place_m: Array, index: Index) -> list[Index]:
    """`index` cut in two near the middle across its longest side, never between equal coordinates.

    One part only where all places are equal.
    """
    places = place_m[index]
    axis = int(np.argmax(np.ptp(places, axis=0)))
    order = np.argsort(places[:, axis], kind="stable")
    along = places[order, axis]
    cuts = np.flatnonzero(np.diff(along) > 1e-9 * max(float(np.abs(along).max()), 1e-300)) + 1
    if not len(cuts):
        return [index]
    cut = cuts[np.argmin(np.abs(cuts - len(order) // 2))]
    return [index[order[:cut]], index[order[cut:]]]


def cluster_order(place_m: Array) -> Index:
    """All indices, neighbours close to each other."""
    parts, done = [np.arange(len(place_m))], []
    while parts:
        part = parts.pop()
        split = halves(place_m, part) if len(part) > ORDER_LEAF else [part]
        if len(split) == 1:
            done.append(np.sort(split[0]))
        else:
            parts += reversed(split)
    return np.concatenate(done)


@dataclass(frozen=True)
class Level:
    """Clusters of one size over the rows and columns of a matrix, each a range once both are in tree order.

    `row_start`, `column_start` (n + 1,); `low_m`, `high_m` (n, 3) boxes round both; `parent` (n,) in the next
    coarser level, empty for the coarsest.
    """

    row_start: Index
    column_start: Index
    low_m: Array
    high_m: Array
    parent: Index

    def __len__(self) -> int:
        return len(self.low_m)

    def is_near(self, separation: float) -> npt.NDArray[np.bool_]:
        """Pairs (row cluster, column cluster) that lie closer than `separation` times the larger diagonal."""
        gap = np.maximum(self.low_m[:, None] - self.high_m, self.low_m - self.high_m[:, None])
        distance = np.sqrt(np.square(np.maximum(gap, 0)).sum(axis=-1))
        diagonal = np.sqrt(np.square(self.high_m - self.low_m).sum(axis=-1))
        return np.asarray(distance < separation * np.maximum(diagonal[:, None], diagonal))


def cluster_tree(rows_m: Array, columns_m: Array, leaf: int) -> tuple[list[Level], Index, Index]:
    """Quadtree over both sets of places: levels from coarse (everything) to fine (half of to all of `leaf` rows or

    columns), and the rows and columns in tree order.
    """
    places, n_rows = np.concatenate([rows_m, columns_m]), len(rows_m)
    n_halvings = max(int(np.ceil(np.log2(max(n_rows, len(columns_m)) / leaf))), 0)
    parts, parent = [np.arange(len(places))], np.zeros(0, np.int64)
    members, parents = [parts], [parent]
    while n_halvings > 0:
        parts, parent = _split(places, parts)
        n_halvings -= 1
        if n_halvings % 2 == 1:  # an odd number of halvings begins with one half
            parts, again = _split(places, parts)
            parent = parent[again]
            n_halvings -= 1
        members.append(parts)
        parents.append(parent)
    levels = [_level(places, n_rows, parts, parent) for parts, parent in zip(members, parents, strict=True)]
    order = np.concatenate([np.sort(p) for p in members[-1]])
    return levels, order[order < n_rows], order[order >= n_rows] - n_rows


def _split(places: Array, parts: list[Index]) -> tuple[list[Index], Index]:
    """Every part in halves, and which part each comes from."""
    split = [halves(places, part) for part in parts]
    return [half for s in split for half in s], np.repeat(np.arange(len(parts)), [len(s) for s in split])


def _level(places: Array, n_rows: int, parts: list[Index], parent: Index) -> Level:
    sizes = np.array([[np.count_nonzero(p < n_rows), np.count_nonzero(p >= n_rows)] for p in parts])
    starts = np.concatenate([[[0, 0]], np.cumsum(sizes, axis=0)])
    low, high = (np.array([f(places[p], axis=0) for p in parts]) for f in (np.min, np.max))
    return Level(starts[:, 0], starts[:, 1], low, high, parent)
