"""Cramer-Rao bound of Shore A from one frame's flow profile, size and depth unknown, by kind and band: an estimate.

The profile's inputs of a log (`calibrate.contact_model`) are fitted, shape by shape, by a quadratic in log radius, log
gel depth and the object's compliance; its slopes are the Jacobian J, the covariance S of what is left the noise. Size
and depth are nuisances: the bound is of (J^T S^-1 J)^-1 over all three. What the quadratic misses counts as noise, so
the true bound is lower. Frames of one press err alike (correlation 0.6 to 0.9 between frames 0.6 mm apart), so that a
press knows a little more than one frame.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.calibrate.contact_log import Press
from ruffini.calibrate.contact_model import Model, is_measured, seen_of
from ruffini.rubber import shore_a_modulus

Array = npt.NDArray[np.float64]

MIDDLES = {"20-40": 30.0, "40-60": 50.0, "60-80": 70.0}
RADIUS_MM, DEPTH_MM = 7.5, 1.1
STEP = 1e-3
LEAST_PRESSES = 8
FLOOR = 1e-4  # of the largest variance: what a quadratic leaves of the rest


def bounds(presses: list[Press], model: Model) -> dict[str, float]:
    """Shore A at RADIUS_MM and DEPTH_MM, by "planar 20-40" and so on; root mean square over the shapes."""
    out: dict[str, float] = {}
    for kind, is_ball in (("planar", False), ("Hertzian", True)):
        shapes = dict.fromkeys(p.shape for p in presses if p.is_hertzian == is_ball)
        parts = [[p for p in presses if p.shape == shape] for shape in shapes]
        found = [_bounds(part, model) for part in parts if len(part) >= LEAST_PRESSES]
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


def _bounds(presses: list[Press], model: Model) -> dict[str, float]:
    x, state = [], []
    for p in presses:
        seen = seen_of(p, -model.wrench(p.flow)[:, 2])
        used = is_measured(p, seen.frame)
        x.append(seen.x[used])
        depth = np.log(p.gel_mm[seen.frame][used])
        n = len(depth)
        state.append(np.column_stack([np.full(n, np.log(p.radius_mm)), depth, np.full(n, _compliance(p.shore_a))]))
    inputs, design = np.concatenate(x), _columns(np.concatenate(state))
    found, *_ = np.linalg.lstsq(design, inputs, rcond=None)
    left = inputs - design @ found
    values, axes = np.linalg.eigh(left.T @ left / (len(left) - design.shape[1]))
    precision = (axes / np.maximum(values, FLOOR * values.max())) @ axes.T
    out = {}
    for band, shore in MIDDLES.items():
        here = np.array([np.log(RADIUS_MM), np.log(DEPTH_MM), _compliance(shore)])
        steps = np.eye(3) * STEP
        slope = np.array([(_columns((here + s)[None]) - _columns((here - s)[None]))[0] / (2 * STEP) for s in steps])
        jacobian = (slope @ found).T
        a_shore = (_compliance(shore + 1) - _compliance(shore - 1)) / 2
        variance = np.linalg.inv(jacobian.T @ precision @ jacobian)[2, 2]
        out[band] = float(np.sqrt(variance) / abs(a_shore))
    return out
