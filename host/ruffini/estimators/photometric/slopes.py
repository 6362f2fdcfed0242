"""Slopes, normals and polynomials of the place: what the fit of colours counts with."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

Q_LIMIT = 0.97  # |n_t| beyond which the slope is held (76 degrees)


def n_terms(order: int) -> int:
    return (order + 1) * (order + 2) // 2


def monomials(place: Array, order: int) -> Array:
    """By rising order, so that a lower order is the first columns of a higher one."""
    x, y = place[:, 0], place[:, 1]
    return np.stack([x ** (k - j) * y**j for k in range(order + 1) for j in range(k + 1)], axis=1)


def lambertian_slope(q: Array) -> Array:
    length = np.hypot(q[:, 0], q[:, 1])
    limited = np.minimum(length, Q_LIMIT)
    scale = limited / np.maximum(length, 1e-12) / np.sqrt(1 - limited**2)
    return np.asarray(q * scale[:, None])


def angle_deg(slope: Array, truth: Array) -> Array:
    """Angle between the normals of two sets of slopes, degrees."""

    def normal(s: Array) -> Array:
        n = np.column_stack([-s, np.ones(len(s))])
        return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))

    cosine = (normal(slope) * normal(truth)).sum(axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
