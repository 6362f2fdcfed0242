"""What a touch changes in a picture of the pad: relative, per channel, without dark pixels, dots or drifting lamps.

Three things look like a touch and are none. Dark pixels: a grey level of noise in a corner that shows ten is ten per
cent; so the change is divided by no less than a share of what the channel usually shows, and is zero where nothing
changed. Printed dots, which move: they are left out and filled from their surroundings. Lamps that warm or dim between
reference and press, each at its own place: a surface of second order over the picture, fitted to the pixels that most
others agree with, is taken off every channel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

LEAST_REST = 0.2  # of the channel's median rest: darker pixels are divided by that
DARKEST_REST = 8.0  # grey levels, below which no channel tells anything
LONGEST_PX = 320  # side of the picture that is worked on: contacts are known to a fraction of its pixels
DOT_DEPTH = 0.18  # of its surroundings that a printed dot is darker, at least, in every channel
DOT_SHARE = (0.005, 0.35)  # of the reference that dots cover, else it has none
LEAST_DOTS = 12
GRID_PX = 8  # cells that the drift is fitted on
DRIFT_ROUNDS = 15
DRIFT_NEAR = 3.0  # medians of the misfit: cells further off are touched
SMOOTHED_PX = 1.5


@dataclass(frozen=True)
class Change:
    """`light` (h, w, 3): smoothed relative change, B G R, on a picture `px` times as coarse as the one given.

    `is_usable` (h, w): not under a printed dot; `noise` (3,): of a pixel of `light`, one standard deviation.
    """

    light: Array
    is_usable: Mask
    noise: Array
    px: float


def shrunk(image: Array) -> tuple[Array, float]:
    """The picture with its longer side at `LONGEST_PX`, if it is longer, and how many pixels one of its has."""
    height, width = image.shape[:2]
    px = max(max(height, width) / LONGEST_PX, 1.0)
    if px == 1.0:
        return image, px
    size = (round(width / px), round(height / px))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float64), px


class Rest:
    """The untouched pad, prepared once for all presses: `reference` (h, w, 3), grey levels B G R."""

    def __init__(self, reference: Array) -> None:
        self.shape = reference.shape
        self.light, self.px = shrunk(reference)
        least = np.maximum(LEAST_REST * np.median(self.light, axis=(0, 1)), DARKEST_REST)
        self._divisor = np.maximum(self.light, least)
        self._dot_px = max(self.light.shape[1] // 12, 9) | 1
        dots = _dark_spots(self.light, self._dot_px)
        n_dots = cv2.connectedComponents(dots.astype(np.uint8))[0] - 1
        self.has_dots = DOT_SHARE[0] < dots.mean() < DOT_SHARE[1] and n_dots >= LEAST_DOTS
        self._dots = _grown(dots)

    def change(self, image: Array) -> Change:
        """What a touch changed in an image of the reference's size."""
        light, _ = shrunk(image)
        change = (light - self.light) / self._divisor
        fine = change - cv2.GaussianBlur(change, (0, 0), SMOOTHED_PX)
        noise = 1.4826 * np.median(np.abs(fine), axis=(0, 1)) / (2 * np.sqrt(np.pi) * SMOOTHED_PX)
        is_usable = np.ones(change.shape[:2], dtype=bool)
        if self.has_dots:
            is_usable = ~(self._dots | _grown(_dark_spots(light, self._dot_px)))
        change -= _drift(change, is_usable)
        return Change(_smoothed(change, is_usable), is_usable, noise, self.px)


def _dark_spots(light: Array, size_px: int) -> Mask:
    """Spots narrower than `size_px` that are darker than what is around them in every channel."""
    around = cv2.morphologyEx(light, cv2.MORPH_CLOSE, np.ones((size_px, size_px), np.uint8))
    is_lit = around > LEAST_REST * np.median(light, axis=(0, 1))
    is_dark = ((light < (1 - DOT_DEPTH) * around) & is_lit).all(axis=2)
    return np.asarray(
        cv2.morphologyEx(np.asarray(is_dark, dtype=np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), dtype=bool
    )


def _grown(mask: Mask) -> Mask:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)), dtype=bool)


def _smoothed(change: Array, is_usable: Mask) -> Array:
    """The usable pixels' weighted mean around each pixel; wider where those are few."""
    out = np.zeros_like(change)
    known = np.zeros(change.shape[:2])
    for sigma_px in (SMOOTHED_PX, 4 * SMOOTHED_PX):
        weight = cv2.GaussianBlur(is_usable.astype(float), (0, 0), sigma_px)
        mean = cv2.GaussianBlur(change * is_usable[:, :, None], (0, 0), sigma_px) / np.maximum(weight, 1e-6)[..., None]
        part = np.clip(4 * weight, 0, 1) * (1 - known)
        out += part[..., None] * mean
        known += part
    return out


def _drift(change: Array, is_usable: Mask) -> Array:
    """The surface of second order that most cells of the picture follow, (h, w, 3)."""
    height, width = change.shape[:2]
    size = (max(width // GRID_PX, 4), max(height // GRID_PX, 4))
    weight = cv2.resize(is_usable.astype(float), size, interpolation=cv2.INTER_AREA)
    cell = cv2.resize(change * is_usable[..., None], size, interpolation=cv2.INTER_AREA)
    values = (cell / np.maximum(weight, 1e-6)[..., None]).reshape(-1, 3)
    terms = _second_order(size[1], size[0]).reshape(-1, 6)
    known = (weight > 0.25).ravel().astype(float)
    share = known.copy()
    found: Array = np.zeros((6, 3))
    for _ in range(DRIFT_ROUNDS):
        weighted = terms * share[:, None]
        ridge = 1e-6 * max(share.sum(), 1.0) * np.eye(6)
        found = np.asarray(np.linalg.solve(weighted.T @ terms + ridge, weighted.T @ values))
        misfit = np.linalg.norm(values - terms @ found, axis=1)
        near = max(DRIFT_NEAR * float(np.median(misfit[known > 0])) if known.any() else 0.0, 1e-4)
        share = known * np.clip(1 - (misfit / near) ** 2, 0, None) ** 2
    return np.asarray(_second_order(height, width) @ found)


def _second_order(height: int, width: int) -> Array:
    """(h, w, 6)"""
    y, x = np.meshgrid((2 * np.arange(height) + 1) / height - 1, (2 * np.arange(width) + 1) / width - 1, indexing="ij")
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
