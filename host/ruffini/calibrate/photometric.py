"""Fit colour change -> surface slope on ball presses, and tabulate it for the board.

Model, in two steps that the firmware runs per pixel:

1. unmixing: the tangential part of the normal, q = n_t, is linear in the relative colour change,
   q = M(x, y) d. For Lambertian lights this is exact: I_c / I_c,rest is linear in n, and M can be
   chosen blind to the common mode (n_z, exposure). M varies over the image because lights are near;
   each of its six entries is a polynomial of the pixel's place.
2. slope table: s = h(q), a table over q that starts from h(q) = q / sqrt(1 - |q|^2) and corrects what
   a Lambertian surface does not explain (shadows, gloss).

The orders of both polynomials are chosen by cross-validation over presses: the simplest model that is not worse than
the best one by more than two standard errors of the difference. A correction that the presses do not demand bends the
slopes beyond theirs, at the walls of flat objects, by up to a fifth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.calibrate.presses import Pinhole, PressSet, ball_slope
from ruffini.errors import InputError
from ruffini.frames import read_image

Array = npt.NDArray[np.float64]

LATTICE = (13, 17)  # lines of the unmixing table over y, x
SLOPE_SIZE = 65  # lines of the slope table over q_y, q_x
Q_LIMIT = 0.97  # |n_t| beyond which the slope is held (76 degrees)
MARKER_CHANGE = -0.30  # relative change of all channels that tells a printed dot from shading
UNMIX_ORDERS = (0, 1, 2, 3, 4)
SLOPE_ORDERS = (0, 3, 5)


@dataclass(frozen=True)
class Samples:
    """Labelled pixels of one press: relative change (n, 3), place in [-1, 1] (n, 2), slope (n, 2)."""

    change: Array
    place: Array
    slope: Array


@dataclass(frozen=True)
class PhotometricModel:
    """Coefficients of the two steps; `unmix` (n_terms, 3, 2), `correction` (n_terms, 2)."""

    unmix: Array
    unmix_order: int
    correction: Array
    slope_order: int

    def normal(self, change: Array, place: Array) -> Array:
        """q of (n, 3) relative changes at (n, 2) places: (n, 2)."""
        terms = _monomials(place, self.unmix_order)
        return np.asarray(np.einsum("nt,nc,tcq->nq", terms, change, self.unmix))

    def slope(self, q: Array) -> Array:
        """Surface slope of (n, 2) tangential normals: (n, 2)."""
        base = _lambertian_slope(q)
        if self.slope_order == 0:
            return base
        limited = q * np.minimum(1.0, Q_LIMIT / np.maximum(np.hypot(q[:, 0], q[:, 1]), 1e-9))[:, None]
        return np.asarray(base + _monomials(limited, self.slope_order)[:, 1:] @ self.correction)


def _monomials(place: Array, order: int) -> Array:
    x, y = place[:, 0], place[:, 1]
    return np.stack([x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)], axis=1)


def _lambertian_slope(q: Array) -> Array:
    length = np.hypot(q[:, 0], q[:, 1])
    limited = np.minimum(length, Q_LIMIT)
    scale = limited / np.maximum(length, 1e-12) / np.sqrt(1 - limited**2)
    return np.asarray(q * scale[:, None])


def relative_change(image: Array, reference: Array) -> Array:
    """d = I / I_rest - 1 per channel, as the firmware's difference stage."""
    return np.asarray(image / np.maximum(reference, 1.0) - 1.0)


def pixel_place(shape: tuple[int, int]) -> Array:
    """Place of each pixel, x and y from -1 to 1 over the image: (h, w, 2)."""
    y, x = np.meshgrid(np.linspace(-1, 1, shape[0]), np.linspace(-1, 1, shape[1]), indexing="ij")
    return np.stack([x, y], axis=-1)


def collect_samples(
    presses: PressSet, camera: Pinhole | None, *, per_press: int = 3000, seed: int = 0
) -> list[Samples]:
    """Labelled pixels of each press, without printed dots, at most `per_press` each."""
    import cv2

    rng = np.random.default_rng(seed)
    shape = presses.reference.shape[:2]
    place = pixel_place(shape)
    smooth_reference = np.asarray(cv2.medianBlur(presses.reference.astype(np.uint8), 31), dtype=np.uint8)
    samples = []
    for press in presses.presses:
        image = read_image(press.path).astype(float)
        if image.shape != presses.reference.shape:
            raise InputError(
                f"{press.path} is {image.shape[1]}x{image.shape[0]}, the reference {shape[1]}x{shape[0]} pixels"
            )
        mask, slope = ball_slope(
            press,
            shape,
            ball_radius_mm=presses.ball_mm / 2,
            px_per_mm=presses.px_per_mm,
            camera=camera,
        )
        dots = _dot_mask(image, smooth_reference) | _dot_mask(presses.reference, smooth_reference)
        usable = ~dots[mask]
        change = relative_change(image, presses.reference)[mask][usable]
        if len(change) < 50:
            raise InputError(
                f"{press.path}: only {len(change)} usable pixels inside the contact: "
                "is the circle in presses.csv right?"
            )
        pick = rng.permutation(len(change))[:per_press]
        samples.append(Samples(change[pick], place[mask][usable][pick], slope[usable][pick]))
    return samples


def _dot_mask(image: Array, background: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Pixels darker than their surroundings in every channel, grown by two pixels."""
    import cv2

    dark = (relative_change(image, background.astype(float)) < MARKER_CHANGE).all(axis=2)
    grown = cv2.dilate(np.asarray(dark, dtype=np.uint8), np.ones((5, 5), np.uint8))
    return np.asarray(grown, dtype=bool)


def fit_model(samples: list[Samples], unmix_order: int, slope_order: int) -> PhotometricModel:
    """Least squares of both steps; each press weighs the same."""
    change = np.concatenate([s.change for s in samples])
    place = np.concatenate([s.place for s in samples])
    slope = np.concatenate([s.slope for s in samples])
    weight = np.concatenate([np.full(len(s.slope), len(s.slope) ** -0.5) for s in samples])
    target = slope / np.sqrt(1 + (slope**2).sum(axis=1, keepdims=True))
    terms = _monomials(place, unmix_order)
    features = (terms[:, :, None] * change[:, None, :]).reshape(len(change), -1)
    unmix = _ridge(features, target, weight).reshape(terms.shape[1], 3, 2)
    model = PhotometricModel(unmix, unmix_order, np.zeros((0, 2)), 0)
    if slope_order == 0:
        return model
    q = model.normal(change, place)
    keep = np.hypot(q[:, 0], q[:, 1]) < Q_LIMIT
    correction = _ridge(_monomials(q[keep], slope_order)[:, 1:], (slope - _lambertian_slope(q))[keep], weight[keep])
    return PhotometricModel(unmix, unmix_order, correction, slope_order)


def _ridge(features: Array, target: Array, weight: Array, relative: float = 1e-5) -> Array:
    weighted = features * weight[:, None]
    gram = weighted.T @ weighted
    gram += relative * np.trace(gram) / len(gram) * np.eye(len(gram))
    return np.asarray(np.linalg.solve(gram, weighted.T @ (target * weight[:, None])))


def angle_deg(slope: Array, truth: Array) -> Array:
    """Angle between the normals of two sets of slopes, degrees."""

    def normal(s: Array) -> Array:
        n = np.column_stack([-s, np.ones(len(s))])
        return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))

    cosine = (normal(slope) * normal(truth)).sum(axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


@dataclass(frozen=True)
class PhotometricFit:
    """The chosen model and how it does on presses that it was not fitted on."""

    model: PhotometricModel
    held_out_deg: Array  # median normal error of each press, left out of the fit
    table: dict[str, float]  # cross-validated median error of each order that was tried

    def report(self) -> dict[str, Any]:
        """Residuals for the manifest and the screen."""
        return {
            "unmix_order": self.model.unmix_order,
            "slope_order": self.model.slope_order,
            "held_out_normal_median_deg": round(float(np.median(self.held_out_deg)), 3),
            "held_out_normal_worst_deg": round(float(self.held_out_deg.max()), 3),
            "n_presses": len(self.held_out_deg),
            "tried": self.table,
        }


def fit_photometric(samples: list[Samples], *, progress: Callable[[float], None] = lambda _: None) -> PhotometricFit:
    """Choose the orders by cross-validation over presses, then fit on all of them."""
    folds = min(len(samples), 8)
    orders = [(u, s) for u in UNMIX_ORDERS for s in SLOPE_ORDERS]
    errors = np.zeros((len(orders), len(samples)))
    for row, (unmix_order, slope_order) in enumerate(orders):
        for fold in range(folds):
            model = fit_model([s for i, s in enumerate(samples) if i % folds != fold], unmix_order, slope_order)
            for i in range(fold, len(samples), folds):
                s = samples[i]
                estimate = model.slope(model.normal(s.change, s.place))
                errors[row, i] = np.median(angle_deg(estimate, s.slope))
        progress((row + 1) / len(orders))
    chosen = simplest_good(errors, [n_coefficients(*o) for o in orders])
    tried = {f"unmix {u}, slope {s}": round(float(e.mean()), 3) for (u, s), e in zip(orders, errors, strict=True)}
    return PhotometricFit(fit_model(samples, *orders[chosen]), errors[chosen], tried)


def n_coefficients(unmix_order: int, slope_order: int) -> int:
    """How many numbers a model of these orders has."""

    def n_terms(order: int) -> int:
        return (order + 1) * (order + 2) // 2

    return 6 * n_terms(unmix_order) + 2 * (n_terms(slope_order) - 1)


def simplest_good(errors: Array, n_free: list[int]) -> int:
    """Row of errors (models, presses) with the fewest free numbers of those within two standard errors of the best."""
    loss = errors - errors[errors.mean(axis=1).argmin()]
    allowed = 2 * loss.std(axis=1, ddof=1) / np.sqrt(errors.shape[1])
    good = np.flatnonzero(loss.mean(axis=1) <= allowed)
    return int(min(good, key=lambda row: n_free[row]))


def tabulate(model: PhotometricModel) -> dict[str, npt.NDArray[np.int16]]:
    """The two integer tables of proto/CALIBRATION.md."""
    lattice = pixel_place(LATTICE).reshape(-1, 2)
    unmix = np.einsum("nt,tcq->nqc", _monomials(lattice, model.unmix_order), model.unmix)
    axis = np.linspace(-1, 1, SLOPE_SIZE)
    qy, qx = np.meshgrid(axis, axis, indexing="ij")
    slope = model.slope(np.stack([qx.ravel(), qy.ravel()], axis=1))

    def q12(values: Array) -> npt.NDArray[np.int16]:
        return np.clip(np.floor(values * 4096 + 0.5), -32767, 32767).astype(np.int16)

    return {
        "photometric.unmix": q12(unmix).reshape(*LATTICE, 2, 3),
        "photometric.slope": q12(slope).reshape(SLOPE_SIZE, SLOPE_SIZE, 2),
    }
