"""Depth, three-axis force and hardness from the flow of glitter: "A Contact-Model-Guided Visuotactile Sensor Enabling
Simultaneous Measurement of Hardness and Tactile Information", sections III and IV.

Dense optical flow against the untouched picture; its Gaussian density falls where the gel is pressed, by an amount
that is linear in the gel's depth d (IV-B, fitted on the nominal indenter). Contact area S; then
    eq. (6), (11)  Fn = gamma1(g(A) S_n),  S_n = sqrt(S) d,  g linear in A: the slope over the area is linear (IV-C)
    eq. (7), (11)  Ft = gamma2(S_t),  S_t = |sum of the flow|;  moment = gamma3(S_t)
    eq. (9), (10)  P = Fn / S_ec,  H_m = dP / dd;  hardness linear in H_m for planar contact, a perceptron of ten units
                   of force, area and depth for Hertzian contact; which kind it is, is told beforehand

The paper does not say how flow, density and area are computed. Ours: Farneback's flow, from where it was in the picture
before (without that it is lost under the widest indenters, whose rim moves by 2 mm), a Gaussian of 5.5 px over the
moved pixels, and as contact the region where the density has fallen by 0.024, which is 0.3 mm of depth. gamma_1 is
linear, gamma_2 and gamma_3 are proportional. In eq. (9) and (10) gel depth and S from the flow leave no hardness at
all (eq. (3): the object's modulus drops out), the stage's travel and the known area of the indenter do:
`hardness_factor` takes what it is given, and the bench prints both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

SIGMA_PX = 5.5  # of the density
CONTACT_FALL = 0.024  # of the density: where a contact ends
MARGIN_PX = 20  # of the picture: what leaves it is no contact
LEAST_DEPTH_MM, MOST_DEPTH_MM = 0.4, 1.8  # where hardness is valid (section V-B)
N_HIDDEN = 10


@dataclass(frozen=True)
class Flow:
    """What one picture's flow gives: largest fall of the density, contact area (mm2), sum of the flow (px mm2)."""

    fall: float
    area_mm2: float
    tangential: float


def optical_flow(untouched: npt.NDArray[np.uint8], now: npt.NDArray[np.uint8], last: Array | None = None) -> Array:
    """Flow from the untouched picture to this one, (h, w, 2) px; `last` is that of the picture before."""
    import cv2

    before, after = (cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) for picture in (untouched, now))
    start = np.zeros((*before.shape, 2), dtype=np.float32) if last is None else last.astype(np.float32)
    levels, flags = (4, 0) if last is None else (1, cv2.OPTFLOW_USE_INITIAL_FLOW)
    return np.asarray(
        cv2.calcOpticalFlowFarneback(before, after, start, 0.5, levels, 21, 5, 7, 1.5, flags), dtype=float
    )


def density(flow: Array) -> Array:
    """Gaussian density of the pixels that the flow has moved, over that of the untouched picture, (h, w)."""
    import cv2

    height, width = flow.shape[:2]
    y, x = np.mgrid[:height, :width]
    to_x, to_y = (np.clip(x + flow[..., 0], 0, width - 1.001), np.clip(y + flow[..., 1], 0, height - 1.001))
    left, top = np.floor(to_x).astype(int), np.floor(to_y).astype(int)
    part_x, part_y = to_x - left, to_y - top
    counts = np.zeros(height * width)
    for dy, wy in ((0, 1 - part_y), (1, part_y)):
        for dx, wx in ((0, 1 - part_x), (1, part_x)):
            counts += np.bincount(((top + dy) * width + left + dx).ravel(), (wx * wy).ravel(), height * width)
    blurred = cv2.GaussianBlur(counts.reshape(height, width), (0, 0), SIGMA_PX, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, dtype=np.float64)


def measure(flow: Array, px_per_mm: float) -> Flow:
    """Density, area and sum of one picture's flow."""
    fall = 1 - density(flow)
    inner = fall[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    area = float((inner > CONTACT_FALL).sum()) / px_per_mm**2
    return Flow(float(inner.max()), area, float(np.linalg.norm(flow.sum(axis=(0, 1)))) / px_per_mm**2)


def line(x: Array, y: Array) -> Array:
    """Slope and offset of y over x by least squares, (2,)."""
    solution, *_ = np.linalg.lstsq(np.column_stack([x, np.ones_like(x)]), y, rcond=None)
    return np.asarray(solution)


def slope(x: Array, y: Array) -> float:
    """Slope of y over x by least squares, through the origin as in F_tau = k_tau S_t."""
    return float(x @ y / (x @ x))


def gained(area_mm2: Array, depth_mm: Array, gain: Array) -> Array:
    """g(A) S_n: the area's gain times sqrt(S) d."""
    return np.asarray((gain[0] * area_mm2 + gain[1]) * np.sqrt(area_mm2) * depth_mm)


def area_gain(presses: list[tuple[Array, Array, Array]]) -> Array:
    """g(A), slope and offset (2,), from presses of area (mm2), depth (mm) and normal force (N) each.

    A press gives the slope of its force over S_n (Fig. 5a) and its mean area; g is the line through them (Fig. 5c).
    """
    areas, slopes = [], []
    for area, depth, force in presses:
        s_n = np.sqrt(area) * depth
        areas.append(float(area.mean()))
        slopes.append(float(line(s_n, force)[0]))
    return line(np.array(areas), np.array(slopes))


def hardness_factor(area_mm2: Array, depth_mm: Array, force_n: Array) -> float:
    """H_m of one press, N/mm3: slope of P = Fn / S over the depths where it is valid; NaN where these are too few."""
    valid = (depth_mm > LEAST_DEPTH_MM) & (depth_mm < MOST_DEPTH_MM) & (area_mm2 > 0)
    if valid.sum() < 3:
        return float("nan")
    return float(line(depth_mm[valid], force_n[valid] / area_mm2[valid])[0])


@dataclass
class Perceptron:
    """One hidden layer of ten tanh units, inputs and output scaled to mean 0 and deviation 1."""

    mean: Array
    scale: Array
    weights: Array

    @classmethod
    def fit(cls, inputs: Array, outputs: Array, *, seed: int = 0) -> Perceptron:
        """By Levenberg-Marquardt with weight decay, from small random weights."""
        from scipy.optimize import least_squares

        table = np.column_stack([inputs, outputs])
        mean, scale = table.mean(axis=0), np.maximum(table.std(axis=0), 1e-12)
        scaled = (table - mean) / scale
        size = N_HIDDEN * (inputs.shape[1] + 2) + 1
        start = np.random.default_rng(seed).normal(0, 0.3, size)
        decay = 0.1

        def residual(weights: Array) -> Array:
            return np.append(_forward(weights, scaled[:, :-1]) - scaled[:, -1], decay * weights)

        return cls(mean, scale, least_squares(residual, start, max_nfev=300).x)

    def __call__(self, inputs: Array) -> Array:
        n = inputs.shape[1]
        return np.asarray(
            _forward(self.weights, (inputs - self.mean[:n]) / self.scale[:n]) * self.scale[n] + self.mean[n]
        )


def _forward(weights: Array, inputs: Array) -> Array:
    n = inputs.shape[1]
    hidden, rest = weights[: N_HIDDEN * (n + 1)].reshape(N_HIDDEN, n + 1), weights[N_HIDDEN * (n + 1) :]
    return np.asarray(np.tanh(inputs @ hidden[:, :n].T + hidden[:, n]) @ rest[:N_HIDDEN] + rest[N_HIDDEN])
