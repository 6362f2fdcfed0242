"""Small dense problems of contact: non-negative pressures, and friction inside Coulomb's discs."""

from __future__ import annotations

import functools
import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

MAX_GRADIENT_STEPS = 600


def largest_eigenvalue(matrix: Array) -> float:
    """An upper estimate of a positive definite matrix's largest eigenvalue, by power iteration."""
    v = np.ones(len(matrix))
    for _ in range(30):
        v = matrix @ v
        v /= np.linalg.norm(v)
    return float(np.linalg.norm(matrix @ v)) * 1.05


def nonnegative(matrix: Array, right: Array, active: npt.NDArray[np.bool_]) -> Array:
    """p >= 0 with matrix p - right >= 0 and complementary, for a positive definite matrix.

    Primal-dual active set; when that cycles, the non-negative least squares of the Cholesky factor.
    """
    scale = float(np.abs(right).max())
    active = active if active.any() else right > 0
    for _ in range(40):
        p = np.zeros(len(right))
        if active.any():
            p[active] = np.linalg.solve(matrix[np.ix_(active, active)], right[active])
        lack = right - matrix @ p  # > 0: the surface would go through
        wanted = (active & (p > 0)) | (~active & (lack > 1e-9 * scale))
        if (wanted == active).all():
            return p
        active = wanted
    from scipy.optimize import nnls

    upper = np.linalg.cholesky(matrix).T
    p, _ = nnls(upper, np.linalg.solve(upper.T, right))
    return np.asarray(p)


def in_discs(matrix: Array, wanted: Array, radius: Array, start: Array, step: float, tolerance: float) -> Array:
    """Minimise t.A t / 2 - wanted.t with |t_i| <= radius_i: accelerated projected gradient.

    Ends when no component changes by more than `tolerance` in a step.
    """
    loaded = np.flatnonzero(radius > 0)
    out = np.zeros_like(start)
    if loaded.size < len(radius):
        both = (2 * loaded[:, None] + np.arange(2)).ravel()
        part = matrix[np.ix_(both, both)]
        if loaded.size:
            out[loaded] = in_discs(part, wanted[both], radius[loaded], start[loaded], step, tolerance)
        return out

    def project(t: Array) -> Array:
        length = np.hypot(t[:, 0], t[:, 1])
        return np.asarray(t * np.minimum(1.0, radius / np.maximum(length, 1e-300))[:, None])

    largest, total = functools.partial(np.maximum.reduce, axis=None), functools.partial(np.add.reduce, axis=None)
    t = project(start)
    lead, momentum = t, 1.0
    for _ in range(MAX_GRADIENT_STEPS):
        gradient = (matrix @ lead.ravel() - wanted).reshape(-1, 2)
        following = project(lead - step * gradient)
        change, t = following - t, following
        if total((lead - following) * change) > 0:
            momentum = 1.0  # restart (O'Donoghue and Candes)
        if largest(np.abs(change)) <= tolerance:
            return t
        grown = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
        lead, momentum = t + (momentum - 1) / grown * change, grown
    return t
