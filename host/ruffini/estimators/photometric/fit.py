"""Fit colour change -> surface slope on ball presses, and tabulate it for the board.

Model, in the steps that the firmware runs per cell (firmware/image/photometric.h):

1. light: what the frame's own light does to all pixels alike is taken off, d' = (d - m) / (1 + m), where the presses
   demand it (light_level.py);
2. normal: the tangential part of the normal, q = n_t = M(x, y) d' + N(d'). For Lambertian lights M alone is exact:
   I_c / I_c,rest is linear in n, and M can be chosen blind to the common mode (n_z, exposure); its six entries are
   polynomials of the pixel's place, because lights are near. N is what matt surfaces do not explain: clipped
   channels, the camera's response, shadows, lamps of mixed colour. It is a lattice of the three changes
   (colour_lattice.py), the same all over the image;
3. slope: s = q / sqrt(1 - |q|^2), a table.

Balance, order and stiffness are chosen by cross-validation over presses: the simplest model that is not worse than the
best one by more than two standard errors of the difference, with N only where it takes off a tenth of the error.
Circles marked by hand are off by 1 to 7 px on recorded presses; each is moved to where a first fit to all of them has
it, and the fit made again.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import linalg

from ruffini.errors import InputError
from ruffini.estimators.photometric.lattice import N_LINES, ColourAxis, bending
from ruffini.estimators.photometric.light_level import light_level
from ruffini.estimators.photometric.pad_view import PadView
from ruffini.estimators.photometric.presses import FITTED_INSIDE, PressSet, ball_slope, relative_change
from ruffini.estimators.photometric.slopes import angle_deg, lambertian_slope, monomials, n_terms
from ruffini.frames import read_image

Array = npt.NDArray[np.float64]

LATTICE = (13, 17)  # lines of the unmixing table over y, x
SLOPE_SIZE = 65  # lines of the slope table over q_y, q_x
MARKER_CHANGE = -0.30  # relative change of all channels that tells a printed dot from shading
UNMIX_ORDERS = (0, 1, 2, 3, 4)
BENT_INSIDE = 0.80  # with the lattice, which follows the walls: peak to edge 0.97, 1.02 on recorded halves; else 0.95
BENT_ORDERS = (0, 1, 2)  # with the lattice; with more of both the recorded presses are worse
STIFFNESS = (1e-4, 1e-5, 1e-6)  # of the lattice: bending over the mean square misfit of q
UNMIX_RIDGE = 1e-4  # over the mean of its normal equations' diagonal
LATTICE_RIDGE = 1e-7  # what M can say, M says
JUDGED_INSIDE = 0.85  # of the contact radius, as `ruffini eval photometric` judges
JUDGED_WITHIN_PX = 2.0  # of the mark
MOVED_AT_MOST = 0.2  # of the ball's radius: how far a mark may be off in the fit
FOLDS = 8
# Part of the error that N must take off: balls are smooth, and what a lattice of their colours gains on them it loses
# at walls that no ball has. Twin: 3 % less angle, depth under flats off by 68 um instead of 37; recorded: 39 % less.
LATTICE_GAIN = 0.1


@dataclass(frozen=True)
class Samples:
    """Labelled pixels of one press: relative change (n, 3), place in [-1, 1] (n, 2), slope (n, 2).

    `offset_px` (n, 2) from the circle's centre; `level` (3,) of the image's light; radii of contact and ball in pixels.
    """

    change: Array
    place: Array
    slope: Array
    offset_px: Array
    level: Array
    radius_px: float
    ball_px: float

    def normal(self) -> Array:
        """q (n, 2)."""
        return np.asarray(self.slope / np.sqrt(1 + (self.slope**2).sum(axis=1, keepdims=True)))

    def inside(self, share: float) -> Samples:
        """Those within a share of the contact radius."""
        near = np.hypot(self.offset_px[:, 0], self.offset_px[:, 1]) < share * self.radius_px
        return replace(self, change=self.change[near], place=self.place[near], slope=self.slope[near],
                       offset_px=self.offset_px[near])  # fmt: skip

    def moved(self, shift_px: Array) -> Samples:
        """The same pixels, with the circle elsewhere."""
        slope = lambertian_slope(self.normal() - shift_px / self.ball_px)
        return replace(self, slope=slope, offset_px=self.offset_px - shift_px)

    def shift_px(self, q: Array, at_most: float) -> Array:
        """Where the centre is by an estimate q (n, 2): the median over the pixels, along x and y, of one's own."""
        return np.clip(np.median(self.normal() - q, axis=0) * self.ball_px, -at_most, at_most)

    def seen(self, is_balanced: bool) -> Array:
        """d' (n, 3)."""
        return np.asarray((self.change - self.level) / (1 + self.level)) if is_balanced else self.change


@dataclass(frozen=True)
class Choice:
    """Which model: order of M over the image, stiffness of N (none without), whether light is taken off."""

    unmix_order: int = 0
    stiffness: float | None = None
    is_balanced: bool = False

    def complexity(self) -> float:
        """For the rule of the simplest model: numbers that are free; a softer lattice after a stiffer one."""
        lattice = 0.0 if self.stiffness is None else 100 - 10 * float(np.log10(self.stiffness))
        return 6 * n_terms(self.unmix_order) + lattice

    def fitted_inside(self) -> float:
        """Share of the contact radius that the presses are fitted in."""
        return FITTED_INSIDE if self.stiffness is None else BENT_INSIDE

    def __str__(self) -> str:
        bend = "none" if self.stiffness is None else f"{self.stiffness:.0e}"
        return f"unmix {self.unmix_order}, bend {bend}, {'balanced' if self.is_balanced else 'as it is'}"


@dataclass(frozen=True)
class PhotometricModel:
    """`unmix` (n_terms, 3, 2), `bend` (nodes, 2) or empty over `axis`."""

    choice: Choice
    unmix: Array
    bend: Array
    axis: ColourAxis

    def normal(self, samples: Samples) -> Array:
        """q (n, 2)."""
        change = samples.seen(self.choice.is_balanced)
        terms = monomials(samples.place, self.choice.unmix_order)
        q = np.einsum("nt,nc,tcq->nq", terms, change, self.unmix)
        return np.asarray(q + self.axis.value(change, self.bend) if len(self.bend) else q)

    def shift_px(self, samples: Samples, share: float, at_most: float) -> Array:
        """How far the circle's centre is from the mark, by the normals inside a share of the contact."""
        shift = np.zeros(2)
        for _ in range(3):  # the pixels inside change with it
            near = samples.moved(shift).inside(share)
            if len(near.slope) < 50:
                return np.zeros(2)
            shift = np.clip(shift + near.shift_px(self.normal(near), at_most), -at_most, at_most)
        return shift

    def error_deg(self, samples: Samples) -> float:
        """Median error of the normals inside the judged part of the circle, refitted near its mark."""
        shift = self.shift_px(samples, JUDGED_INSIDE, JUDGED_WITHIN_PX)
        judged = samples.moved(shift).inside(JUDGED_INSIDE)
        return float(np.median(angle_deg(lambertian_slope(self.normal(judged)), judged.slope)))


def pixel_place(shape: tuple[int, int]) -> Array:
    """Place of each pixel, x and y from -1 to 1 over the image: (h, w, 2)."""
    y, x = np.meshgrid(np.linspace(-1, 1, shape[0]), np.linspace(-1, 1, shape[1]), indexing="ij")
    return np.stack([x, y], axis=-1)


def collect_samples(
    presses: PressSet, camera: PadView | None, *, per_press: int = 3000, seed: int = 0
) -> list[Samples]:
    """Labelled pixels of each press, inside the contact and without printed dots, at most `per_press` each."""
    import cv2

    rng = np.random.default_rng(seed)
    shape = presses.reference.shape[:2]
    place = pixel_place(shape)
    smooth_reference = np.asarray(cv2.medianBlur(presses.reference.astype(np.uint8), 31), dtype=np.uint8)
    rest_dots = _dot_mask(presses.reference, smooth_reference)
    ball_px = presses.ball_mm / 2 * presses.px_per_mm
    samples = []
    for press in presses.presses:
        image = read_image(press.path).astype(float)
        if image.shape != presses.reference.shape:
            raise InputError(
                f"{press.path} is {image.shape[1]}x{image.shape[0]}, the reference {shape[1]}x{shape[0]} pixels"
            )
        mask, slope = ball_slope(
            press, shape, ball_radius_mm=presses.ball_mm / 2, px_per_mm=presses.px_per_mm, camera=camera, inside=1.0
        )
        usable = ~(_dot_mask(image, smooth_reference) | rest_dots)[mask]
        change = relative_change(image, presses.reference, presses.dark)
        offset = np.argwhere(mask)[:, ::-1] - [press.center_x_px, press.center_y_px]
        level = light_level(change, presses.reference)
        found = Samples(change[mask][usable], place[mask][usable], slope[usable], offset[usable], level,
                        press.radius_px, ball_px)  # fmt: skip
        if len(found.inside(FITTED_INSIDE).change) < 50:
            raise InputError(
                f"{press.path}: only {len(found.inside(FITTED_INSIDE).change)} usable pixels inside the contact: "
                "is the circle in presses.csv right?"
            )
        pick = rng.permutation(len(found.change))[:per_press]
        samples.append(replace(found, change=found.change[pick], place=found.place[pick], slope=found.slope[pick],
                               offset_px=found.offset_px[pick]))  # fmt: skip
    return samples


def _dot_mask(image: Array, background: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Pixels darker than their surroundings in every channel, grown by two pixels."""
    import cv2

    dark = (relative_change(image, background.astype(float)) < MARKER_CHANGE).all(axis=2)
    grown = cv2.dilate(np.asarray(dark, dtype=np.uint8), np.ones((5, 5), np.uint8))
    return np.asarray(grown, dtype=bool)


@dataclass(frozen=True)
class Sums:
    """Normal equations of some presses, added up: (k, k) and (k, 2), unmixing of all orders first, then the nodes."""

    gram: Array
    right: Array
    count: int = 1

    def __add__(self, other: Sums) -> Sums:
        return Sums(self.gram + other.gram, self.right + other.right, self.count + other.count)

    def __sub__(self, other: Sums) -> Sums:
        return Sums(self.gram - other.gram, self.right - other.right, self.count - other.count)


def _total(presses: Iterable[Sums]) -> Sums:
    return functools.reduce(operator.add, presses)


class Equations:
    """Normal equations of presses, each of the same weight, for all orders and with the lattice."""

    def __init__(self, samples: list[Samples], is_balanced: bool) -> None:
        self.is_balanced = is_balanced
        self.axis = ColourAxis.covering(np.concatenate([s.inside(JUDGED_INSIDE).seen(is_balanced) for s in samples]))
        self._zero = self.axis.zero()
        self._bending = bending(self._zero)

    def of(self, samples: Samples, inside: float = FITTED_INSIDE) -> Sums:
        """Of one press, within a share of its contact radius."""
        near = samples.inside(inside)
        change, q = near.seen(self.is_balanced), near.normal()
        terms = monomials(near.place, max(UNMIX_ORDERS))
        features = (terms[:, :, None] * change[:, None, :]).reshape(len(q), -1)
        weights = self.axis.weights(change)
        both = np.asarray(weights.T @ features)
        gram = np.block([[features.T @ features, both.T], [both, (weights.T @ weights).toarray()]])
        right = np.concatenate([features.T @ q, np.asarray(weights.T @ q)])
        return Sums(gram / len(q), right / len(q))

    def solve(self, sums: Sums, choice: Choice) -> PhotometricModel:
        """The model of least squares."""
        n_all, n = 3 * n_terms(max(UNMIX_ORDERS)), 3 * n_terms(choice.unmix_order)
        n_nodes = 0 if choice.stiffness is None else N_LINES**3
        used = ((slice(0, n), slice(0, n)), (slice(n, n + n_nodes), slice(n_all, n_all + n_nodes)))
        gram, right = np.empty((n + n_nodes, n + n_nodes)), np.empty((n + n_nodes, 2))
        for row, from_row in used:
            right[row] = sums.right[from_row] / sums.count
            for column, from_column in used:
                np.divide(sums.gram[from_row, from_column], sums.count, out=gram[row, column])
        unmix = np.arange(n)
        gram[unmix, unmix] += UNMIX_RIDGE * np.trace(gram[:n, :n]) / n
        if choice.stiffness is not None:
            gram[n:, n:] += choice.stiffness * self._bending + LATTICE_RIDGE * np.eye(n_nodes)
            gram[n + self._zero, n + self._zero] += 1e6  # no change is flat
        found: Array = np.asarray(linalg.solve(gram, right, assume_a="pos"), dtype=np.float64)
        return PhotometricModel(choice, found[:n].reshape(-1, 3, 2), found[n:], self.axis)

    def solve_moved(self, samples: list[Samples], marked: Sums, choice: Choice) -> PhotometricModel:
        """By the circles as marked, then by the circles where that model has them."""
        first = self.solve(marked, choice)
        shifts = [first.shift_px(s, FITTED_INSIDE, MOVED_AT_MOST * s.ball_px) for s in samples]
        moved = (s.moved(shift) for s, shift in zip(samples, shifts, strict=True))
        return self.solve(_total(self.of(s, choice.fitted_inside()) for s in moved), choice)


def fit_model(samples: list[Samples], choice: Choice) -> PhotometricModel:
    """Least squares on the circles as marked, then on the circles where that fit has them."""
    equations = Equations(samples, choice.is_balanced)
    return equations.solve_moved(samples, _total(equations.of(s) for s in samples), choice)


def models_without(samples: list[Samples], choice: Choice) -> Iterator[PhotometricModel]:
    """For each press the model of all others."""
    equations = Equations(samples, choice.is_balanced)
    marked = [equations.of(s) for s in samples]
    everything = _total(marked)
    for i, without in enumerate(marked):
        yield equations.solve_moved(samples[:i] + samples[i + 1 :], everything - without, choice)


@dataclass(frozen=True)
class PhotometricFit:
    """The chosen model and how it does on presses that it was not fitted on."""

    model: PhotometricModel
    held_out_deg: Array  # median normal error of each press, left out of the fit, on its circle refitted within 2 px
    table: dict[str, float]  # cross-validated median error of each model that was tried

    def report(self) -> dict[str, Any]:
        """Residuals for the manifest and the screen."""
        choice = self.model.choice
        return {
            "unmix_order": choice.unmix_order,
            "bend_stiffness": choice.stiffness,
            "is_balanced": choice.is_balanced,
            "held_out_normal_median_deg": round(float(np.median(self.held_out_deg)), 3),
            "held_out_normal_worst_deg": round(float(self.held_out_deg.max()), 3),
            "n_presses": len(self.held_out_deg),
            "tried": self.table,
        }


def fit_photometric(samples: list[Samples], *, progress: Callable[[float], None] = lambda _: None) -> PhotometricFit:
    """Choose the model by cross-validation over presses, then fit it on all of them."""
    tried: dict[Choice, Array] = {}
    known = {}
    for is_balanced in (False, True):
        equations = Equations(samples, is_balanced)
        marked = [equations.of(s) for s in samples]
        known[is_balanced] = equations, marked, _without_each_fold(marked)
        for stiffness in (None, STIFFNESS[1]):
            choice = Choice(1, stiffness, is_balanced)
            tried[choice] = _left_out(samples, equations, known[is_balanced][2], choice)
        progress(0.1 + 0.1 * is_balanced)
    is_balanced = best_choice(tried).is_balanced
    equations, _, others = known[is_balanced]
    rest = [Choice(order, None, is_balanced) for order in UNMIX_ORDERS]
    rest += [Choice(order, stiffness, is_balanced) for order in BENT_ORDERS for stiffness in STIFFNESS]
    for i, choice in enumerate(rest):
        if choice not in tried:
            tried[choice] = _left_out(samples, equations, others, choice)
        progress(0.2 + 0.7 * (i + 1) / len(rest))
    choice = best_choice(tried)
    equations, marked, others = known[choice.is_balanced]
    errors = _left_out(samples, equations, others, choice, is_moved=True)
    progress(1.0)
    names = {str(c): round(float(e.mean()), 3) for c, e in tried.items()}
    return PhotometricFit(equations.solve_moved(samples, _total(marked), choice), errors, names)


def best_choice(tried: dict[Choice, Array]) -> Choice:
    """Of the models tried, each with its error on every press."""
    plain = [choice for choice in tried if choice.stiffness is None]
    least = min(float(errors.mean()) for errors in tried.values())
    needs_lattice = min(float(tried[choice].mean()) for choice in plain) > (1 + LATTICE_GAIN) * least
    choices = list(tried) if needs_lattice else plain
    return choices[
        simplest_good(np.stack([tried[c] for c in choices]), [c.complexity() + c.is_balanced for c in choices])
    ]


def _without_each_fold(marked: list[Sums]) -> list[Sums]:
    """Of all presses but those of one fold, of each."""
    folds, everything = min(len(marked), FOLDS), _total(marked)
    return [everything - _total(marked[fold::folds]) for fold in range(folds)]


def _left_out(
    samples: list[Samples], equations: Equations, others: list[Sums], choice: Choice, *, is_moved: bool = False
) -> Array:
    """Error of each press by a model that was fitted without it. others : as `_without_each_fold`."""
    folds, errors = len(others), np.zeros(len(samples))
    for fold in range(folds):
        kept = [s for i, s in enumerate(samples) if i % folds != fold]
        model = equations.solve_moved(kept, others[fold], choice) if is_moved else equations.solve(others[fold], choice)
        for i in range(fold, len(samples), folds):
            errors[i] = model.error_deg(samples[i])
    return errors


def simplest_good(errors: Array, n_free: list[float]) -> int:
    """Row of errors (models, presses) with the fewest free numbers of those within two standard errors of the best."""
    loss = errors - errors[errors.mean(axis=1).argmin()]
    allowed = 2 * loss.std(axis=1, ddof=1) / np.sqrt(errors.shape[1])
    good = np.flatnonzero(loss.mean(axis=1) <= allowed)
    return int(min(good, key=lambda row: n_free[row]))


def tabulate(model: PhotometricModel) -> dict[str, npt.NDArray[Any]]:
    """The integer tables of proto/CALIBRATION.md."""
    lattice = pixel_place(LATTICE).reshape(-1, 2)
    unmix = np.einsum("nt,tcq->nqc", monomials(lattice, model.choice.unmix_order), model.unmix)
    axis = np.linspace(-1, 1, SLOPE_SIZE)
    qy, qx = np.meshgrid(axis, axis, indexing="ij")
    slope = lambertian_slope(np.stack([qx.ravel(), qy.ravel()], axis=1))

    def fixed(values: Array, bits: int) -> npt.NDArray[np.int16]:
        return np.asarray(np.clip(np.floor(values * 2**bits + 0.5), -32767, 32767), dtype=np.int16)

    tables: dict[str, npt.NDArray[Any]] = {
        "photometric.unmix": fixed(unmix, 12).reshape(*LATTICE, 2, 3),
        "photometric.slope": fixed(slope, 12).reshape(SLOPE_SIZE, SLOPE_SIZE, 2),
        "photometric.balance": np.array([int(model.choice.is_balanced)], np.int32),
    }
    if len(model.bend):
        tables["photometric.bend"] = fixed(model.bend, 14).reshape(N_LINES, N_LINES, N_LINES, 2)
        tables["photometric.bend_axis"] = model.axis.tensor()
    return tables
