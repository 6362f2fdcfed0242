"""Wrench from three targets on a tray: "F-TOUCH Sensor: Concurrent Geometry Perception and Multi-axis Force
Measurement", sections III and IV.

Grey, Gaussian, threshold, inverted; the three blobs' centroids (x, y) and areas a against the unloaded picture give
nine variables, and wrench = K (6 x 9) times them (eq. 2), K by least squares against a reference sensor. The paper
prints neither the filter's width nor the threshold: 5 px and 45 of 255 are ours.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

BLUR_PX = 5  # side of the Gaussian's window
THRESHOLD = 45
LEAST_AREA_PX = 200.0


def targets(picture: npt.NDArray[np.uint8]) -> Array:
    """Centroid x, y and area (pixels) of the three targets, (3, 3), in the order of their angle about their middle.

    Raises
    ------
    ValueError
        There are not three dark blobs.
    """
    import cv2

    grey = cv2.GaussianBlur(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), (BLUR_PX, BLUR_PX), 0)
    _, binary = cv2.threshold(grey, THRESHOLD, 255, cv2.THRESH_BINARY_INV)
    _, _, stats, centres = cv2.connectedComponentsWithStats(binary)
    height, width = grey.shape
    blobs = []
    for (left, top, wide, high, area), centre in zip(stats[1:], centres[1:], strict=True):
        touches_edge = left == 0 or top == 0 or left + wide == width or top + high == height
        if area >= LEAST_AREA_PX and not touches_edge:
            blobs.append((*centre, float(area)))
    if len(blobs) != 3:
        raise ValueError(f"{len(blobs)} dark blobs instead of three targets")
    found = np.array(blobs)
    middle = found[:, :2].mean(axis=0)
    return np.asarray(found[np.argsort(np.arctan2(found[:, 1] - middle[1], found[:, 0] - middle[0]))])


def variables(now: Array, unloaded: Array) -> Array:
    """The nine variables dx1 dy1 da1 ... da3 of `targets` now and unloaded, (9,)."""
    return (now - unloaded).ravel()


def calibrate(variables: Array, wrenches: Array) -> Array:
    """K (6, 9) by least squares of wrenches (n, 6) on variables (n, 9)."""
    solution, *_ = np.linalg.lstsq(variables, wrenches, rcond=None)
    return np.asarray(solution.T)
