"""A tool's face by key points of the wall under it: radii, force and way to its area by a Gaussian process, tabulated.

The key points are those of firmware/stages/fingertip/tip_area.h: on each of 24 rays about the touched place the highest
ring and the one where the wall bends most. Three processes share one kernel: log area of presses whose whole edge
bears, log of what presses left out are off by, and whether the whole edge bears, which says whether the area is told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.estimators.fingertip.field import KERNEL_FLOOR, KERNEL_STEPS, kernel

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

N_RAYS, N_RINGS, RING_MM = 24, 21, 0.5
FIRST_RIDGE, FIRST_BEND, LAST_KEY = 2, 3, 18
COUNT = 9  # places of the table along each input
LENGTH, NOISE = 1.5, 0.3  # of the kernel, in deviations of an input; of a label, as a part of its deviation
N_FOLDS = 6
LEAST_WHOLE = 40  # frames; with fewer no table is made
LEAST_LIKELY = 0.7  # that the whole edge bears, where an area is told
LEAST_SURE = 10  # such frames of presses left out; with fewer no area is surer than MOST_PART
MOST_PART = 1.0
HALF_WIDTHS = (0.01, 0.99)  # quantiles of an input, between which the table reaches


def rays(radius_mm: float) -> Array:
    """Directions (24, 21, 3) about the top."""
    angle, way = np.meshgrid(
        np.arange(N_RAYS) * 2 * np.pi / N_RAYS, np.arange(N_RINGS) * RING_MM / radius_mm, indexing="ij"
    )
    return np.stack([np.sin(way) * np.cos(angle), np.sin(way) * np.sin(angle), np.cos(way)], axis=-1)


def cells() -> Array:
    """mm^2 of the wall that one place of each ring stands for, (21,)."""
    edge = np.concatenate([[0], (np.arange(N_RINGS) + 0.5) * RING_MM])
    return np.asarray(np.pi * np.diff(edge**2) / N_RAYS)


def radii(moved: Array, normal: Array, turn: Array, axis: Array, radius_mm: float, tip_mm: float) -> Array:
    """Radii in rings of bend and ridge, (2,), of one frame: moved, normal (n, 3), turn (3, 3), the tool's axis (3,)."""
    at, u, n = rays(radius_mm).reshape(-1, 3), moved @ turn.T, normal @ turn.T
    step = np.maximum((2 - 2 * at @ n.T) * 2**15, 0).astype(np.int64)
    k = np.where(step < KERNEL_STEPS, kernel(radius_mm)[np.minimum(step, KERNEL_STEPS - 1)], 0.0)
    field = (k @ u) / (k.sum(axis=1, keepdims=True) + KERNEL_FLOOR)
    h = ((tip_mm * at + field) @ (turn @ axis)).reshape(N_RAYS, N_RINGS)
    last = LAST_KEY + 1
    ridge = FIRST_RIDGE + h[:, FIRST_RIDGE:last].argmax(axis=1)
    bent = 2 * h[:, FIRST_BEND:last] - h[:, FIRST_BEND + 2 : last + 2] - h[:, FIRST_BEND - 2 : last - 2]
    bend = FIRST_BEND + bent.argmax(axis=1)
    return np.array([np.sqrt((r * np.roll(r, -1)).mean()) for r in (bend, ridge)])


def bears_all_round(told: Array, dome_mm: float) -> Bools:
    """Whether a disc of the face's area is below the undeformed dome all round; told (t, 7) as of `tip_presses`."""
    way, aside, radius = told[:, 1], np.hypot(told[:, 2], told[:, 3]), np.sqrt(told[:, 6] / np.pi)
    first = np.maximum(aside - radius, 0)  # the part of the face nearest to the dome's axis touches first
    height = np.sqrt(dome_mm**2 - np.minimum(first, dome_mm) ** 2)
    rim = np.sqrt(np.maximum(dome_mm**2 - (aside + radius) ** 2, 0))
    return np.asarray(rim > height - way)


@dataclass(frozen=True)
class FaceTable:
    """axis (4, 3): first place, step, count of force N, way mm, radius of bend and of ridge, rings; values (9^4, 3):
    mm^2, deviation as a part, how likely the whole edge bears. report: of presses left out.
    """

    axis: Array
    values: Array
    report: dict[str, float | None]


class _Process:
    """A Gaussian process of unit deviation about the mean of its labels; inputs in deviations over LENGTH."""

    def __init__(self, x: Array, y: Array) -> None:
        self._x, self._mean = x, float(y.mean())
        self._weights = np.linalg.solve(_covariance(x, x) + NOISE * np.eye(len(x)), y - self._mean)

    def __call__(self, x: Array) -> Array:
        return np.asarray(self._mean + _covariance(x, self._x) @ self._weights)


def _covariance(a: Array, b: Array) -> Array:
    apart2 = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return np.asarray(np.exp(-0.5 * np.maximum(apart2, 0)))


def fit_face(inputs: Array, area_mm2: Array, is_whole: Bools, press: npt.NDArray[np.intp]) -> FaceTable | None:
    """From inputs (t, 4) of frames and their presses' numbers; None where too few presses bear all round."""
    if is_whole.sum() < LEAST_WHOLE or len(np.unique(press[is_whole])) < 2 * N_FOLDS:
        return None
    middle, spread = inputs.mean(axis=0), inputs.std(axis=0) * LENGTH
    x, log = (inputs - middle) / spread, np.log(area_mm2)
    part = np.random.default_rng(0).permutation(int(press.max()) + 1)[press] % N_FOLDS
    off, whole = np.full(len(x), np.nan), np.zeros(len(x))
    for fold in range(N_FOLDS):
        kept, left = part != fold, part == fold
        off[left] = _Process(x[kept & is_whole], log[kept & is_whole])(x[left]) - log[left]
        whole[left] = _Process(x[kept], is_whole[kept].astype(float))(x[left])
    # What it is off by, of frames like those that are told: log |off| of a normal error is 0.635 below its deviation.
    told = whole > 0.5
    some = told if told.sum() >= LEAST_WHOLE else is_whole
    rough = _Process(x[some], np.log(np.maximum(np.abs(off[some]), 1e-3)) + 0.635)
    sure = whole >= LEAST_LIKELY
    least = float(np.sqrt(np.mean(off[sure] ** 2))) if sure.sum() >= LEAST_SURE else MOST_PART
    low, high = np.quantile(inputs, HALF_WIDTHS, axis=0)
    axis = np.stack([low, (high - low) / (COUNT - 1), np.full(4, COUNT)], axis=1)
    lines = [a[0] + a[1] * np.arange(COUNT) for a in axis]
    at = (np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 4) - middle) / spread
    area, likely = _Process(x[is_whole], log[is_whole]), _Process(x, is_whole.astype(float))
    values = np.stack(
        [np.exp(np.clip(area(at), log.min(), log.max())), np.clip(np.exp(rough(at)), min(least, MOST_PART), MOST_PART),
         np.clip(likely(at), 0, 1)], axis=1,
    )  # fmt: skip
    table = FaceTable(axis, values, {})
    straight = table_error(table, inputs[sure], np.exp(area(x[sure]))) if sure.any() else None
    error = 100 * np.abs(np.expm1(off))
    return FaceTable(axis, values, {
        "n_likely": int(sure.sum()), "n_likely_whole": int((sure & is_whole).sum()), "n_whole": int(is_whole.sum()),
        "error_likely_percent": float(error[sure].mean()) if sure.any() else None,
        "error_whole_percent": float(error[is_whole].mean()), "tabulation_error_percent": straight,
    })  # fmt: skip


def table_error(table: FaceTable, inputs: Array, area_mm2: Array) -> float:
    """Mean difference between the table, straight between its places, and the process itself, percent."""
    from scipy.interpolate import RegularGridInterpolator

    lines = tuple(a[0] + a[1] * np.arange(COUNT) for a in table.axis)
    inside = np.clip(inputs, [line[0] for line in lines], [line[-1] for line in lines])
    read = RegularGridInterpolator(lines, table.values[:, 0].reshape(4 * (COUNT,)))(inside)
    return float(100 * np.abs(read / area_mm2 - 1).mean())
