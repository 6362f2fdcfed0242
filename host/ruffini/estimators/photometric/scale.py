"""A few ball presses adapt a colour table: one factor on the normals that it makes, with a prior.

A new gel of the same recipe has the same lights before it; its coating is a little more or less reflective towards the
side, which scales how strongly colours answer to slope. The factor is sought with a prior of 1 +- PRIOR.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize_scalar

from ruffini.calibrate.container import Tensors
from ruffini.estimators.photometric.fit import Samples
from ruffini.estimators.photometric.presses import FITTED_INSIDE
from ruffini.estimators.photometric.slopes import angle_deg

Array = npt.NDArray[np.float64]

PRIOR = 0.1
SPREAD = 0.05  # of the factor from press to press: pixels of one press err together
WIDEST = 3.0  # standard deviations of the prior that are searched
Q12, Q14 = 4096.0, 16384.0


def fit_scale(tables: Tensors, samples: list[Samples]) -> tuple[float, float, float, float]:
    """Factor, its standard deviation, median normal error (degrees) before and after."""
    samples = [s.inside(FITTED_INSIDE) for s in samples]
    truth = [s.normal() for s in samples]
    q = [_normal(tables, s) for s in samples]

    def cost(scale: float) -> float:
        misfit = sum(
            float(((_limited(scale * a) - b) ** 2).sum() / (b**2).sum()) for a, b in zip(q, truth, strict=True)
        )
        return misfit / SPREAD**2 + ((scale - 1) / PRIOR) ** 2

    bounds = (1 - WIDEST * PRIOR, 1 + WIDEST * PRIOR)
    scale = float(minimize_scalar(cost, bounds=bounds, method="bounded").x)
    step = 0.02
    curvature = (cost(scale + step) - 2 * cost(scale) + cost(scale - step)) / step**2 / 2
    before, after = (_error_deg(tables, samples, q, factor) for factor in (1.0, scale))
    return scale, float(1 / np.sqrt(max(curvature, 1 / PRIOR**2))), before, after


def scaled(tables: Tensors, scale: float) -> Tensors:
    """The tables with the normals that they make times `scale`."""
    out = dict(tables)
    for name in ("photometric.unmix", "photometric.bend"):
        if name in tables:
            values = np.round(tables[name].astype(float) * scale)
            out[name] = np.clip(values, -32767, 32767).astype(np.int16)
    return out


def _limited(q: Array) -> Array:
    return np.asarray(q / np.maximum(np.hypot(q[:, 0], q[:, 1]), 1.0)[:, None])


def _normal(tables: Tensors, samples: Samples) -> Array:
    """q (n, 2) by the tables, as firmware/image/photometric.h has it."""
    balance = tables.get("photometric.balance")
    change = samples.seen(balance is not None and bool(balance[0]))
    unmix = tables["photometric.unmix"].astype(float)
    rows, columns = unmix.shape[:2]
    at = np.stack([(samples.place[:, 1] + 1) / 2 * (rows - 1), (samples.place[:, 0] + 1) / 2 * (columns - 1)])
    matrix = np.stack([
        map_coordinates(unmix[:, :, i, j], at, order=1, mode="nearest") for i in range(2) for j in range(3)
    ], axis=1).reshape(-1, 2, 3)  # fmt: skip
    q = np.asarray(np.einsum("nqc,nc->nq", matrix, change) / Q12)
    if "photometric.bend" in tables:
        bend, (first, step_log2) = tables["photometric.bend"].astype(float), tables["photometric.bend_axis"].astype(int)
        place = ((change * Q12 - first) / 2**step_log2).T
        q += np.stack([map_coordinates(bend[..., k], place, order=1, mode="nearest") for k in range(2)], axis=1) / Q14
    return q


def _error_deg(tables: Tensors, samples: list[Samples], q: list[Array], scale: float) -> float:
    slope = tables["photometric.slope"].astype(float) / Q12
    n = slope.shape[0]
    errors = []
    for s, normal in zip(samples, q, strict=True):
        limited = _limited(scale * normal)
        at = (limited[:, ::-1].T + 1) / 2 * (n - 1)
        found = np.stack([map_coordinates(slope[:, :, k], at, order=1, mode="nearest") for k in range(2)], axis=1)
        errors.append(float(np.median(angle_deg(found, s.slope))))
    return float(np.median(errors))
