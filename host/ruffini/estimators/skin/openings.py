"""Which pixels see which opening of a glowing skin: from a lens fitted to known points, and the untouched picture.

A camera on the axis of a tube sees a point at height Z on radius R under r / f = R / (d + Z) (eq. 3 of the paper); the
lens moves it by 1 + k1 rho^2 + k2 rho^4, rho = R / (d + Z). f, d, k1 and k2 are fitted together: the paper takes k1, k2
from a chessboard. It only has to be good to half an opening: each opening's pixels are found in the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from ruffini.boards import Board
from ruffini.errors import InputError

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int32]

LEVEL = 0.5  # of an opening's own brightness: its edge
LEAST_PX = 4  # of an opening
PATCHES = (8, 5)  # of the black surroundings, along x and y
BLACK_LEVEL = 2.0  # of the untouched picture, weighted: nothing shines there
LEAST_PATCH_PX = 4000
CLEAR_PX = 41  # twice what a patch keeps away from openings: they light up the mask about them, and JPEG spreads it
LEAST_FOUND = 0.9  # of the openings


@dataclass(frozen=True)
class TubeView:
    """A camera on the axis of a tube: f (px), d (mm), k1, k2, principal point (px), radius (mm); `rmse_px` of the fit.

    Round the image's middle a tube shows nothing: places there are held at a large height.
    """

    f: float
    d: float
    k1: float
    k2: float
    cx: float
    cy: float
    radius: float
    rmse_px: float

    def project(self, place_mm: Array) -> Array:
        """Image places (n, 2) of places (n, 2) of the unrolled tube."""
        rho = self.radius / (self.d + place_mm[:, 1])
        r = self.f * rho * (1 + self.k1 * rho**2 + self.k2 * rho**4)
        angle = place_mm[:, 0] / self.radius
        return np.column_stack([self.cx + r * np.cos(angle), self.cy + r * np.sin(angle)])

    def unproject(self, px: Array) -> Array:
        """Places (n, 2) of the unrolled tube that image places (n, 2) see, by Newton's method."""
        x, y = px[:, 0] - self.cx, px[:, 1] - self.cy
        seen = np.hypot(x, y) / self.f
        rho = seen.copy()
        for _ in range(12):
            value = rho * (1 + self.k1 * rho**2 + self.k2 * rho**4) - seen
            slope = 1 + 3 * self.k1 * rho**2 + 5 * self.k2 * rho**4
            rho = rho - value / np.where(np.abs(slope) < 0.1, 0.1, slope)
        rho = np.maximum(rho, 1e-3)
        return np.column_stack([self.radius * np.arctan2(y, x), self.radius / rho - self.d])


def fit_view(board: Board, points: Array) -> TubeView:
    """Fit a view to known points (n, 3): image x, y (px) and the height along the tube (mm).

    Raises
    ------
    InputError
        No tube, or too few points for four numbers.
    """
    skin = board.skin
    if skin is None or skin.shape != "tube":
        shape = "without a glowing skin" if skin is None else f"a {skin.shape}"
        raise InputError(
            f"board {board.name!r} is {shape}, but known points say heights along a tube: "
            "`ruffini cal fit --only skin` fits tubes alone"
        )
    if len(points) < 8 or not np.isfinite(points).all():
        raise InputError(f"{len(points)} known points: give eight at least, x, y in pixels and the height in mm")
    cx, cy = board.camera.center_x_mpx * 1e-3, board.camera.center_y_mpx * 1e-3
    radius = skin.radius_um * 1e-3
    seen = np.hypot(points[:, 0] - cx, points[:, 1] - cy)

    def wrong(v: Array) -> Array:
        rho = radius / np.maximum(v[1] * 100 + points[:, 2], 1e-3)
        return np.asarray(v[0] * 1000 * rho * (1 + v[2] * rho**2 + v[3] * rho**4) - seen)

    start = np.array([board.camera.focal_mpx * 1e-6, board.camera.standoff_um * 1e-5, 0.0, 0.0])
    # The lens is known to a fifth of a percent of the picture at first: points alone hardly part f, k1 and d.
    fit = least_squares(lambda v: np.append(wrong(v), (v[2:]) * 1e-2), start, x_scale=[0.1, 0.1, 0.1, 0.1])
    f, d, k1, k2 = fit.x * np.array([1000, 100, 1, 1])
    rmse = float(np.sqrt(np.mean(wrong(fit.x) ** 2)))
    return TubeView(float(f), float(d), float(k1), float(k2), cx, cy, radius, rmse)


def lattice_mm(board: Board) -> Array:
    """Places (n, 2) of the openings on the unrolled skin from its middle, as board.toml has them, x fastest."""
    markers, pad = board.markers, board.pad
    assert markers is not None
    middle = np.array([pad.size_x_um, pad.size_y_um]) / 2
    if markers.places_um is not None:
        return np.asarray((np.array(markers.places_um, dtype=float) - middle) * 1e-3)
    x = markers.first_x_um + np.arange(markers.n_x) * markers.pitch_x_um
    y = markers.first_y_um + np.arange(markers.n_y) * markers.pitch_y_um
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.asarray((grid - middle) * 1e-3)


@dataclass(frozen=True)
class Openings:
    """Runs (k, 3) int32 of pixels: first, length, number; numbers below `n_taxels` are openings, others patches."""

    runs: Numbers
    n_taxels: int
    n_patches: int
    places_mm: Array

    def light(self, weighted: Array) -> Array:
        """Sum of a weighted picture (h, w) over each opening, (n_taxels,)."""
        sums = np.append(0.0, np.cumsum(weighted.ravel()))
        each = sums[self.runs[:, 0] + self.runs[:, 1]] - sums[self.runs[:, 0]]
        totals = np.bincount(self.runs[:, 2], each, minlength=self.n_taxels + self.n_patches)
        return np.asarray(totals[: self.n_taxels], dtype=float)

    def base_q2(self, weighted: Array) -> Numbers:
        """Light at rest in quarter levels, as the firmware's base."""
        return np.maximum(np.round(4 * self.light(weighted)), 1).astype(np.int32)


def find_openings(board: Board, rest: Array, guess_px: Array) -> Openings:
    """Pixels of the openings in an untouched weighted picture (h, w) near where they are expected, (n, 2).

    Raises
    ------
    InputError
        Too many are not where they should be.
    """
    import cv2

    places = lattice_mm(board)
    near = cv2.dilate(cv2.GaussianBlur(rest, (0, 0), 1.0), np.ones((9, 9)))
    bright = (rest > LEVEL * near) & (rest > 4 * BLACK_LEVEL)
    _, labels, stats, centres = cv2.connectedComponentsWithStats(bright.astype(np.uint8), connectivity=4)
    kept = [i for i in range(1, len(stats)) if stats[i, cv2.CC_STAT_AREA] >= LEAST_PX]
    numbers = np.full(len(stats), -1)
    step = np.sort(np.linalg.norm(guess_px[:, None] - guess_px[None], axis=2), axis=1)[:, 1]
    for i in kept:
        away = np.linalg.norm(guess_px - centres[i], axis=1)
        taxel = int(np.argmin(away))
        if away[taxel] < 0.6 * step[taxel]:
            numbers[i] = taxel
    taxel_of = numbers[labels]
    found = np.unique(taxel_of[taxel_of >= 0])
    if len(found) < LEAST_FOUND * len(places):
        raise InputError(
            f"{len(found)} of {len(places)} openings are where the lens says: check --points, the lattice in [markers] "
            "and that the picture is untouched"
        )
    order = np.full(len(places) + 1, -1)  # the last one is of pixels of no opening, -1
    order[found] = np.arange(len(found))
    height, width = rest.shape
    patch = _patches(cv2.dilate(near, np.ones((CLEAR_PX, CLEAR_PX))) < BLACK_LEVEL, (height, width))
    rows = [
        *_runs(order[taxel_of]),
        *((first, length, number + len(found)) for first, length, number in _runs(patch)),
    ]
    n_patches = int(patch.max()) + 1
    return Openings(np.array(rows, dtype=np.int32), len(found), n_patches, places[found])


def _patches(black: npt.NDArray[np.bool_], shape: tuple[int, int]) -> npt.NDArray[np.int64]:
    """Number of each black pixel's patch, -1 elsewhere; patches too small for a mean are left out."""
    height, width = shape
    v, u = np.mgrid[:height, :width]
    patch = np.where(black, v * PATCHES[1] // height * PATCHES[0] + u * PATCHES[0] // width, -1)
    counts = np.bincount(patch[patch >= 0], minlength=PATCHES[0] * PATCHES[1])
    order = np.cumsum(counts >= LEAST_PATCH_PX) - 1
    order[counts < LEAST_PATCH_PX] = -1
    return np.asarray(np.where(patch >= 0, order[np.maximum(patch, 0)], -1))


def _runs(number: npt.NDArray[np.int64]) -> list[tuple[int, int, int]]:
    """(first, length, number) of pixels beside each other with the same number, of an image with -1 elsewhere."""
    width = number.shape[1]
    flat = number.ravel()
    starts = np.flatnonzero(np.append(True, (flat[1:] != flat[:-1]) | (np.arange(1, flat.size) % width == 0)))
    lengths = np.diff(np.append(starts, flat.size))
    return [(int(s), int(n), int(flat[s])) for s, n in zip(starts, lengths, strict=True) if flat[s] >= 0]
