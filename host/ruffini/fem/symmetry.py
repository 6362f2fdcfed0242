"""Split a matrix by the reflections x -> -x, y -> -y that its sites and its entries allow.

Where rows and columns sit on places that a reflection maps onto themselves, and the matrix does not
change under it, sums and differences over mirror images turn the matrix into independent classes:
two or four blocks that hold a half or a quarter of the entries, without any loss. `reflection` does it for
node grids before a matrix exists; this does it for any rectangular matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

PLACE_TOLERANCE = 1e-6  # of the sites' extent: what counts as the mirror place
GRID_OFFSET = 0.3711  # keeps places off the grid's rounding edges
MATRIX_TOLERANCE = 1e-7  # relative, on random vectors: what counts as no change


@dataclass(frozen=True)
class Sites:
    """Where each row or column of a matrix sits: `place_m` (n, 3) metres and `axis` (n,) 0, 1, 2 for x, y, z,

    the direction of a vector component; of a scalar quantity -1.
    """

    place_m: Array
    axis: Index

    def __len__(self) -> int:
        return len(self.axis)


@dataclass(frozen=True)
class ReflectionClass:
    """One block: `matrix` (n_rows, n_cols) acts on sums over `columns` and spreads to `rows`.

    `rows`, `columns` (n, k): +-(index + 1), 0 for none; the first is the place in the kept quarter.
    """

    matrix: Array
    rows: Index
    columns: Index


def node_sites(place_m: Array) -> Sites:
    """Sites of vectors at the nodes `place_m` (n, 3), xyz interleaved."""
    return Sites(np.repeat(place_m, 3, axis=0), np.tile(np.arange(3), len(place_m)))


def reflection_classes(matrix: Array, rows: Sites, columns: Sites, *, use: bool = True) -> list[ReflectionClass]:
    """One class with the matrix itself where no reflection leaves it alone (or `use` is off), otherwise two or four."""
    middle = (columns.place_m.min(axis=0) + columns.place_m.max(axis=0)) / 2
    images: list[tuple[int, Index, Index]] = []  # axis, image of each row, image of each column
    for axis in (0, 1) if use else ():
        row_image, column_image = _image(rows, axis, middle), _image(columns, axis, middle)
        if row_image is None or column_image is None or len(matrix) < 2:
            continue
        if _is_unchanged(matrix, _signed(rows, axis, row_image), _signed(columns, axis, column_image)):
            images.append((axis, row_image, column_image))
    if not images:
        return [ReflectionClass(matrix, np.arange(len(rows))[:, None] + 1, np.arange(len(columns))[:, None] + 1)]
    classes = []
    for parity in product((1, -1), repeat=len(images)):
        row_sums = _orbits(rows, [(a, r) for a, r, _ in images], parity)
        column_sums = _orbits(columns, [(a, c) for a, _, c in images], parity)
        if len(row_sums) and len(column_sums):
            classes.append(ReflectionClass(_block(matrix, row_sums, column_sums), row_sums, column_sums))
    return classes


def _image(sites: Sites, axis: int, middle: Array) -> Index | None:
    """Index of each site's mirror image, None where one has none."""
    extent = max(float(np.ptp(sites.place_m)), 1e-12)
    mirrored = sites.place_m.copy()
    mirrored[:, axis] = 2 * middle[axis] - mirrored[:, axis]
    grid = PLACE_TOLERANCE * extent
    keys = [
        np.column_stack([np.round((p - middle) / grid + GRID_OFFSET), sites.axis]).astype(np.int64)
        for p in (sites.place_m, mirrored)
    ]
    order = [np.lexsort(k.T) for k in keys]
    here, there = (k[o] for k, o in zip(keys, order, strict=True))
    if np.abs(here - there).max(initial=0) > 1 or (len(here) > 1 and (np.diff(here, axis=0) == 0).all(axis=1).any()):
        return None
    image = np.empty(len(sites), np.int64)
    image[order[1]] = order[0]
    return image if (image[image] == np.arange(len(sites))).all() else None


def _signed(sites: Sites, axis: int, image: Index) -> tuple[Index, Array]:
    return image, np.where(sites.axis == axis, -1.0, 1.0)


def _is_unchanged(matrix: Array, rows: tuple[Index, Array], columns: tuple[Index, Array]) -> bool:
    """Whether reflecting the input reflects the output, on random vectors."""
    x = np.random.default_rng(0).standard_normal((matrix.shape[1], 4))
    straight = matrix @ x
    image, sign = columns
    reflected = np.empty_like(x)
    reflected[image] = sign[:, None] * x
    out = matrix @ reflected
    image, sign = rows
    back = sign[:, None] * out[image]
    return bool(np.linalg.norm(back - straight) <= MATRIX_TOLERANCE * np.linalg.norm(straight))


def _orbits(sites: Sites, images: list[tuple[int, Index]], parity: tuple[int, ...]) -> Index:
    """Signed members of each orbit that has a part of this parity, (n_orbits, 2^reflections)."""
    n = len(sites)
    members, signs = [np.arange(n)], [np.ones(n, np.int64)]
    for (axis, image), p in zip(images, parity, strict=True):
        sign = np.where(sites.axis == axis, -p, p)
        members += [image[m] for m in members]
        signs += [s * sign for s in signs]
    member, sign = np.stack(members, axis=1), np.stack(signs, axis=1)
    # The kept place is the one of the lowest coordinates: x and y of no image are below its own.
    low = np.ones(n, bool)
    for axis, image in images:
        low &= sites.place_m[:, axis] <= sites.place_m[image, axis] + PLACE_TOLERANCE * np.ptp(sites.place_m)
    is_repeat = np.zeros(member.shape, bool)
    cancels = np.zeros(n, bool)
    for k in range(1, member.shape[1]):
        for j in range(k):
            same = member[:, k] == member[:, j]
            is_repeat[:, k] |= same
            cancels |= same & (sign[:, k] != sign[:, j])
    keep = low & ~cancels
    return np.where(is_repeat, 0, sign * (member + 1))[keep]


def _block(matrix: Array, rows: Index, columns: Index) -> Array:
    """D_r^-1 E_r^T G E_c D_c^-1 = (G E_c)[kept rows] D_c^-1, E the signed sums, D the sizes of the orbits."""
    kept = matrix[np.abs(rows[:, 0]) - 1]
    out = np.zeros((len(rows), len(columns)))
    for k in range(columns.shape[1]):
        used = columns[:, k] != 0
        out[:, used] += kept[:, np.abs(columns[used, k]) - 1] * np.sign(columns[used, k])
    out /= np.count_nonzero(columns, axis=1)
    return out
