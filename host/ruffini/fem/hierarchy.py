"""Hierarchical plans: near clusters dense, far ones through nested bases, as many levels as asked for.

For each class of the matrix (symmetry.py) and its clusters from fine to coarse:

    x_1 = V^T u      each finest cluster's inputs in its own orthonormal basis
    x_l = T^T x_l-1  each coarser cluster's in a basis of its children's
    y_l = S_l x_l + T y_l+1  what far clusters of this level, and of all coarser ones, send
    out = D u + U y_1        D: pairs of finest clusters that are near each other

A basis spans what a cluster receives from (or sends to) everything that is far from it, cut where its
singular values fall below a threshold; the bases are orthonormal, so the cut parts add up in squares.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.fem.clusters import Level, cluster_tree
from ruffini.fem.program import Panel, Plan
from ruffini.fem.symmetry import ReflectionClass, Sites

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Shape:
    """Clusters of at most `leaf` unknowns, `n_levels` of them, far when apart by `separation` diagonals."""

    leaf: int
    n_levels: int
    separation: float


@dataclass(frozen=True)
class Sorted:
    """One class in tree order, its levels from fine to coarse, and for each level which pairs are near."""

    matrix: Array
    rows: Index  # members in tree order, as ReflectionClass has them
    columns: Index
    levels: list[Level]
    near: list[Mask]

    @property
    def near_share(self) -> float:
        level = self.levels[0]
        n_rows, n_columns = np.diff(level.row_start), np.diff(level.column_start)
        return float(n_rows @ self.near[0] @ n_columns / self.matrix.size)


@dataclass(frozen=True)
class Coupling:
    """What one level adds: its row and column bases by cluster, and its far pairs in these bases."""

    row_basis: list[Array]
    column_basis: list[Array]
    row_start: Index  # of each cluster's values in the level's vectors
    column_start: Index
    matrix: Array  # of all pairs; only the `far` ones count
    far: Mask  # pairs that no coarser level takes


def sort_class(block: ReflectionClass, rows: Sites, columns: Sites, shape: Shape) -> Sorted:
    levels, row_order, column_order = cluster_tree(
        rows.place_m[np.abs(block.rows[:, 0]) - 1], columns.place_m[np.abs(block.columns[:, 0]) - 1], shape.leaf
    )
    near = [levels[0].is_near(shape.separation)]
    for level in levels[1:]:
        near.append(near[-1][np.ix_(level.parent, level.parent)] & level.is_near(shape.separation))
    kept = slice(-shape.n_levels, None)
    return Sorted(
        block.matrix[np.ix_(row_order, column_order)], block.rows[row_order], block.columns[column_order],
        levels[kept][::-1], near[kept][::-1],
    )  # fmt: skip


def couplings(sorted_class: Sorted, threshold: float) -> list[Coupling]:
    """Bases and couplings from fine to coarse; fewer levels where nothing is far."""
    matrix, out = sorted_class.matrix, []
    level = sorted_class.levels[0]
    row_start, column_start = level.row_start, level.column_start
    for i, (level, near) in enumerate(zip(sorted_class.levels, sorted_class.near, strict=True)):
        row_basis = _bases(matrix, row_start, column_start, ~near, threshold)
        column_basis = _bases(matrix.T, column_start, row_start, ~near.T, threshold)
        matrix = _project(_project(matrix, row_basis, row_start).T, column_basis, column_start).T
        row_values, column_values = _starts(row_basis), _starts(column_basis)
        if not matrix.size:
            break
        far = ~near
        if i + 1 < len(sorted_class.levels):
            far &= sorted_class.near[i + 1][np.ix_(level.parent, level.parent)]
        out.append(Coupling(row_basis, column_basis, row_values, column_values, matrix, far))
        if i + 1 < len(sorted_class.levels):
            first = np.searchsorted(level.parent, np.arange(len(sorted_class.levels[i + 1]) + 1))
            row_start, column_start = row_values[first], column_values[first]
    return out


def _bases(matrix: Array, start: Index, other: Index, far: Mask, threshold: float) -> list[Array]:
    """Of each row cluster an orthonormal basis of its far part above the threshold, (n_rows, k)."""
    wide = np.repeat(far, np.diff(other), axis=1)
    out = []
    for i in range(len(far)):
        part = matrix[start[i] : start[i + 1]][:, wide[i]]
        if not part.size:
            out.append(np.zeros((start[i + 1] - start[i], 0)))
            continue
        values, vectors = np.linalg.eigh(part @ part.T)
        out.append(vectors[:, values > threshold**2][:, ::-1])
    return out


def _project(matrix: Array, basis: list[Array], start: Index) -> Array:
    place = _starts(basis)
    out = np.empty((place[-1], matrix.shape[1]))
    for i, b in enumerate(basis):
        out[place[i] : place[i + 1]] = b.T @ matrix[start[i] : start[i + 1]]
    return out


def _starts(basis: list[Array]) -> Index:
    return np.cumsum([0] + [b.shape[1] for b in basis])


def hierarchical_plan(classes: list[Sorted], threshold: float, unfold: npt.NDArray[np.int32]) -> Plan | None:
    """All classes side by side in the same stages; None where some class has nothing far.

    `unfold`: outputs from the classes' rows in tree order, one class after the other.
    """
    parts = [couplings(c, threshold) for c in classes]
    n_levels = min(len(p) for p in parts)
    if n_levels < max(len(p) for p in parts) or n_levels == 0:
        return None
    fold = np.concatenate([c.columns for c in classes]).astype(np.int32)
    # Vectors: 0 the inputs, 1 .. n the x from fine to coarse, n + 1 .. 2 n the y from coarse to fine.
    lengths = [
        [len(c.columns), *(p.column_start[-1] for p in part), *(p.row_start[-1] for p in part[::-1]), len(c.rows)]
        for c, part in zip(classes, parts, strict=True)
    ]
    at = np.concatenate([np.zeros((1, len(lengths[0])), np.int64), np.cumsum(lengths, axis=0)])
    panels = [
        panel for k, (c, part) in enumerate(zip(classes, parts, strict=True)) for panel in _panels(c, part, at[k])
    ]
    panels.sort(key=lambda p: p.stage)
    return Plan(fold, unfold, tuple(int(n) for n in at[-1][1:]), panels)


def _panels(c: Sorted, part: list[Coupling], at: Index) -> Iterator[Panel]:
    """Of one class, whose values begin at `at[v]` in vector v."""
    n = len(part)
    start = c.levels[0].column_start
    for i, p in enumerate(part):  # x_i+1 from x_i
        for k, basis in enumerate(p.column_basis):
            if basis.size:
                first = int(at[i + 1] + p.column_start[k])
                yield Panel(i, first, i, ((int(at[i] + start[k]), len(basis)),), basis.T)
        if i + 1 < n:
            start = p.column_start[_first_child(c, i)]
    for i in range(n - 1, -1, -1):  # y of level i in vector 2 n - i, made by stage 2 n - i - 1
        p, vector = part[i], 2 * n - i
        for k, far in enumerate(p.far):
            rows = slice(int(p.row_start[k]), int(p.row_start[k + 1]))
            segments, columns = _segments(p.column_start, far)
            if len(columns) and rows.stop > rows.start:
                moved = tuple((int(at[i + 1]) + first, count) for first, count in segments)
                yield Panel(vector - 1, int(at[vector]) + rows.start, i + 1, moved, p.matrix[rows][:, columns])
        yield from _send_down(c, part, i, at)
    level = c.levels[0]
    for k, near in enumerate(c.near[0]):
        rows = slice(int(level.row_start[k]), int(level.row_start[k + 1]))
        segments, columns = _segments(level.column_start, near)
        if len(columns) and rows.stop > rows.start:
            moved = tuple((int(at[0]) + first, count) for first, count in segments)
            yield Panel(2 * n, int(at[2 * n + 1]) + rows.start, 0, moved, c.matrix[rows][:, columns])


def _send_down(c: Sorted, part: list[Coupling], i: int, at: Index) -> Iterator[Panel]:
    """From y of level i to the vector after it: the finer level's y, or the outputs."""
    n = len(part)
    p, vector = part[i], 2 * n - i
    start = c.levels[0].row_start if i == 0 else part[i - 1].row_start[_first_child(c, i - 1)]
    for k, basis in enumerate(p.row_basis):
        if basis.size:
            yield Panel(
                vector, int(at[vector + 1] + start[k]), vector,
                ((int(at[vector] + p.row_start[k]), basis.shape[1]),), basis,
            )  # fmt: skip


def _first_child(c: Sorted, i: int) -> Index:
    """Of each cluster of level i + 1, its first child in level i; one more at the end."""
    return np.searchsorted(c.levels[i].parent, np.arange(len(c.levels[i + 1]) + 1))


def _segments(start: Index, chosen: Mask) -> tuple[list[tuple[int, int]], Index]:
    """The chosen clusters' values as (first, count), neighbours joined, and as indices."""
    segments: list[tuple[int, int]] = []
    for k in np.flatnonzero(chosen):
        first, count = int(start[k]), int(start[k + 1] - start[k])
        if not count:
            continue
        if segments and sum(segments[-1]) == first:
            segments[-1] = (segments[-1][0], segments[-1][1] + count)
        else:
            segments.append((first, count))
    columns = [np.arange(first, first + count) for first, count in segments]
    return segments, np.concatenate(columns) if columns else np.zeros(0, np.int64)
