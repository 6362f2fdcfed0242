"""Where a ball touches in each picture, without marks by hand: centre and contact radius, pixels.

The slope of a ball at a pixel depends on the ball's centre, not on how far the contact reaches. So centres are found by
agreement over all pictures, and the radius from how the slopes go on:

1. a blob: the hull of the largest region whose colours changed; the changed region is about 1.6 times the contact;
2. in rounds: colour change -> tangential normal q by one linear map for all presses (of order 0, then 1, over the
   image), least squares inside the circles; then each centre is the median of p - R q over its circle, and each radius
   where the mean slope towards the centre is steepest: inside it the ball's rises, outside it the free gel's falls.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError

Array = npt.NDArray[np.float64]

LEAST_CHANGE = 0.04  # of light where it changed most: less is no press (noise of single pixels, averaged: below 0.01)
BLACK_LEVEL, FULL_LEVEL = 8.0, 255.0
FULL_SHARE = 0.4  # of pixels, in any channel; recorded presses reach 0.19, beside the lamps
BLOB_TO_CONTACT = 0.6
FITTED_INSIDE = 0.9  # of a circle: what the map is fitted on
BALL_LIMIT = 0.95  # of the ball's radius: beyond it the surface is too steep to say anything
ROUNDS = 10
WORST_MISFIT = 0.2  # median error of q inside a circle (recorded presses: at most 0.13): no ball makes these colours


@dataclass(frozen=True)
class Circle:
    """A contact in the picture."""

    center_x_px: float
    center_y_px: float
    radius_px: float


def find_balls(images: list[Array], reference: Array, ball_radius_px: float, names: list[Path]) -> list[Circle]:
    """Contact circles of all presses of one ball on one unit.

    images : of (h, w, 3), B G R; reference : the untouched pad, the same shape; names : for messages.

    Raises
    ------
    InputError
        A picture is black, overexposed, of another size, shows no press, or one that is not this ball's.
    """
    changes = [_change(image, reference, name) for image, name in zip(images, names, strict=True)]
    circles = [_blob(change, name) for change, name in zip(changes, names, strict=True)]
    misfit: list[float] = []
    for turn in range(ROUNDS):
        unmix = _Unmix.fit(changes, circles, ball_radius_px, order=min(turn // 2, 1))
        found = [unmix.improve(change, circle, ball_radius_px) for change, circle in zip(changes, circles, strict=True)]
        circles, misfit = [circle for circle, _ in found], [error for _, error in found]
    for name, error in zip(names, misfit, strict=True):
        if error > WORST_MISFIT:
            raise InputError(f"{name}: ball not found: its colours do not fit a ball of this size; "
                             "take the picture out, or mark the circles in presses.csv")  # fmt: skip
    return circles


def _change(image: Array, reference: Array, name: Path) -> Array:
    """Smoothed change of light, without what all pixels have in common."""
    import cv2

    if image.shape != reference.shape:
        raise InputError(f"{name} is {image.shape[1]}x{image.shape[0]}, the reference "
                         f"{reference.shape[1]}x{reference.shape[0]} pixels: one size is needed")  # fmt: skip
    if image.mean() < BLACK_LEVEL:
        raise InputError(f"{name} is black: was the light off, or the lens covered?")
    if (image >= FULL_LEVEL).any(axis=2).mean() > FULL_SHARE:
        raise InputError(f"{name} is overexposed: take it again with less exposure or light")
    change = image / np.maximum(reference, 32.0) - 1
    return np.asarray(cv2.GaussianBlur(change - np.median(change, axis=(0, 1)), (0, 0), 1.5))


def _blob(change: Array, name: Path) -> Circle:
    import cv2

    size = cv2.GaussianBlur(np.linalg.norm(change, axis=2), (0, 0), 4)
    top = float(np.quantile(size, 0.995))
    if top < LEAST_CHANGE:
        raise InputError(f"{name}: ball not found: no more than {100 * top:.1f} % of the light changed against the "
                         "reference; take the picture out, or press deeper")  # fmt: skip
    mask = cv2.morphologyEx((size > top / 2).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((15, 15), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    hull = cv2.convexHull(np.argwhere(labels == largest)[:, ::-1].astype(np.int32))
    moments = cv2.moments(hull)
    area = max(moments["m00"], 1.0)
    radius = BLOB_TO_CONTACT * float(np.sqrt(area / np.pi))
    return Circle(moments["m10"] / area, moments["m01"] / area, radius)


@dataclass(frozen=True)
class _Unmix:
    """q = M(x, y) d; `map` (3 n_terms, 2)."""

    map: Array
    order: int

    @classmethod
    def fit(cls, changes: list[Array], circles: list[Circle], ball_px: float, order: int) -> _Unmix:
        gram: Array = np.zeros(())
        right: Array = np.zeros(())
        for change, circle in zip(changes, circles, strict=True):
            dx, dy, mask = _inside(change.shape, circle, ball_px)
            features = _features(change, mask, order)
            target = np.stack([dx[mask], dy[mask]], axis=1) / ball_px
            gram = gram + features.T @ features / len(features)
            right = right + features.T @ target / len(features)
        gram = gram + 1e-5 * np.trace(gram) / len(gram) * np.eye(len(gram))
        return cls(np.asarray(np.linalg.solve(gram, right), dtype=np.float64), order)

    def improve(self, change: Array, circle: Circle, ball_px: float) -> tuple[Circle, float]:
        """The circle by this map, and the median error of q in it."""
        for _ in range(3):
            dx, dy, mask = _inside(change.shape, circle, ball_px)
            apart = np.stack([dx[mask], dy[mask]], axis=1) / ball_px - _features(change, mask, self.order) @ self.map
            x, y = np.median(apart, axis=0) * ball_px
            circle = Circle(circle.center_x_px + float(x), circle.center_y_px + float(y), circle.radius_px)
        dx, dy, _ = _inside(change.shape, circle, ball_px)
        radius = np.hypot(dx, dy)
        near = radius < 1.3 * ball_px
        q = _features(change, near, self.order) @ self.map
        inward = (q[:, 0] * dx[near] + q[:, 1] * dy[near]) / np.maximum(radius[near], 1)
        ring = radius[near].astype(int)
        profile = np.bincount(ring, inward) / np.maximum(np.bincount(ring), 1)
        profile = np.convolve(profile, np.ones(3) / 3, "same")
        first = 2 + int(ball_px // 8)  # few pixels and no slope in the middle
        steepest = first + 0.5 + int(profile[first:-2].argmax())
        return Circle(circle.center_x_px, circle.center_y_px, steepest), float(np.median(np.hypot(*apart.T)))


def _inside(shape: tuple[int, ...], circle: Circle, ball_px: float) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Distance of every pixel from the centre along x and y, and which ones the map is fitted on."""
    rows, columns = np.indices(shape[:2])
    dx, dy = columns - circle.center_x_px, rows - circle.center_y_px
    mask = np.hypot(dx, dy) < FITTED_INSIDE * min(circle.radius_px, BALL_LIMIT * ball_px)
    if mask.sum() < 50:
        raise InputError("ball not found: a circle left the picture or shrank to a few pixels; "
                         "check --ball-mm and --px-per-mm, or mark the circles in presses.csv")  # fmt: skip
    return dx, dy, mask


def _features(change: Array, mask: npt.NDArray[np.bool_], order: int) -> Array:
    """Change times 1, x, y (order 1) at the pixels of a mask: (n, 3 n_terms)."""
    rows, columns = np.nonzero(mask)
    height, width = mask.shape
    terms = np.stack([np.ones(len(rows)), 2 * columns / width - 1, 2 * rows / height - 1], axis=1)[:, : 1 + 2 * order]
    return np.asarray((terms[:, :, None] * change[mask][:, None, :]).reshape(len(rows), -1))
