"""Cramer-Rao bound of Shore A from one frame's flow profile, size and depth unknown, by kind and band: an estimate.

The profile's inputs of a log (`estimators.contact_model`) are fitted, shape by shape, by a quadratic in log radius, log
gel depth and the object's compliance; its slopes are the Jacobian J, the covariance S of what is left the noise. Size
and depth are nuisances: the bound is of (J^T S^-1 J)^-1 over all three. What the quadratic misses counts as noise, so
the true bound is lower.

Of a whole press: DEPTHS_MM of it, one radius and one hardness, a depth for each frame. What frames of a press have left
in common (a patch errs alike in every press at its place) is measured, `correlation`, and is the noise's part that no
number of frames takes away: C = correlation + (1 - correlation) I over the frames, S within each.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.estimators.contact_model.fit import Model, is_measured, seen_of
from ruffini.estimators.contact_model.log import Press
from ruffini.rubber import shore_a_modulus

Array = npt.NDArray[np.float64]

MIDDLES = {"20-40": 30.0, "40-60": 50.0, "60-80": 70.0}
RADIUS_MM, DEPTH_MM = 7.5, 1.1
DEPTHS_MM = tuple(0.1 * k for k in range(4, 19))
STEP = 1e-3
LEAST_PRESSES = 8
FLOOR = 1e-4  # of the largest variance: what a quadratic leaves of the rest


def bounds(presses: list[Press], model: Model, *, of_press: bool = False) -> dict[str, float]:
    """Shore A at RADIUS_MM and DEPTH_MM, by "planar 20-40" and so on; root mean square over the shapes."""
    out: dict[str, float] = {}
    for kind, is_ball in (("planar", False), ("Hertzian", True)):
        shapes = dict.fromkeys(p.shape for p in presses if p.is_hertzian == is_ball)
        parts = [[p for p in presses if p.shape == shape] for shape in shapes]
        found = [_bounds(part, model, of_press) for part in parts if len(part) >= LEAST_PRESSES]
        for band in MIDDLES:
            out[f"{kind} {band}"] = float(np.sqrt(np.mean([f[band] ** 2 for f in found]))) if found else float("nan")
    return out


def _compliance(shore_a: float) -> float:
    """Per megapascal."""
    return 1e6 / shore_a_modulus(min(max(shore_a, 1.0), 98.0))


def _columns(state: Array) -> Array:
    """Quadratic in (log radius, log depth, compliance), (t, 10)."""
    a, b, c = state.T
    one = np.ones_like(a)
    return np.column_stack([one, a, b, c, a * a, b * b, c * c, a * b, a * c, b * c])


def _correlation(left: Array, press: Array, precision: Array) -> float:
    """Between frames of the same press: of what is left (t, n), whitened by its precision."""
    white = left @ np.linalg.cholesky(precision)
    common = total = 0.0
    for one in np.unique(press):
        rows = white[press == one]
        n = len(rows)
        if n > 1:
            own = float((rows**2).sum())
            common += (float((rows.sum(axis=0) ** 2).sum()) - own) / (n - 1)
            total += own
    return float(np.clip(common / total, 0.0, 0.99))


def _slopes(found: Array, at: Array) -> Array:
    """J (18, 3): of the inputs over log radius, log depth and compliance."""
    steps = np.eye(3) * STEP
    slope = [(_columns((at + s)[None]) - _columns((at - s)[None]))[0] / (2 * STEP) for s in steps]
    return np.asarray((np.array(slope) @ found).T)


def _variance_of_press(found: Array, precision: Array, compliance: float, correlation: float) -> float:
    """Of the compliance: depths are each frame's own, radius and compliance the press'."""
    n = len(DEPTHS_MM)
    between = np.linalg.inv(correlation + (1 - correlation) * np.eye(n))
    jacobian = np.zeros((n, precision.shape[0], n + 2))
    for i, depth in enumerate(DEPTHS_MM):
        own = _slopes(found, np.array([np.log(RADIUS_MM), np.log(depth), compliance]))
        jacobian[i][:, [n, i, n + 1]] = own
    information = np.einsum("iap,ij,ab,jbq->pq", jacobian, between, precision, jacobian, optimize=True)
    return float(np.linalg.inv(information)[-1, -1])


def _bounds(presses: list[Press], model: Model, of_press: bool) -> dict[str, float]:
    x, state = [], []
    press: list[Array] = []
    for p in presses:
        seen = seen_of(p, -model.wrench(p.flow)[:, 2])
        used = is_measured(p, seen.frame)
        x.append(seen.x[used])
        depth = np.log(p.gel_mm[seen.frame][used])
        n = len(depth)
        press.append(np.full(n, float(len(press))))
        state.append(np.column_stack([np.full(n, np.log(p.radius_mm)), depth, np.full(n, _compliance(p.shore_a))]))
    inputs, design = np.concatenate(x), _columns(np.concatenate(state))
    found: Array = np.asarray(np.linalg.lstsq(design, inputs, rcond=None)[0], dtype=np.float64)
    left = inputs - design @ found
    values, axes = np.linalg.eigh(left.T @ left / (len(left) - design.shape[1]))
    precision = (axes / np.maximum(values, FLOOR * values.max())) @ axes.T
    correlation = _correlation(left, np.concatenate(press), precision)
    out = {}
    for band, shore in MIDDLES.items():
        compliance = _compliance(shore)
        if of_press:
            variance = _variance_of_press(found, precision, compliance, correlation)
        else:
            jacobian = _slopes(found, np.array([np.log(RADIUS_MM), np.log(DEPTH_MM), compliance]))
            variance = float(np.linalg.inv(jacobian.T @ precision @ jacobian)[2, 2])
        a_shore = (_compliance(shore + 1) - _compliance(shore - 1)) / 2
        out[band] = float(np.sqrt(variance) / abs(a_shore))
    return out
