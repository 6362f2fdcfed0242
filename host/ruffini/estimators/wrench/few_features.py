"""The stated error of a map of few features, such as three targets on a sprung tray. Units here: N and N mm.

The reference's noise may be many times the map's error, so that errors against it show that noise alone. The stated
error has three parts without it:

noise of the features in untouched frames, through K: a mixture of two normal distributions separates untouched frames
    from light touches, since a load of a fiftieth of full scale moves an axis by more than noise does;
noise of a target that has moved, whose edges fall elsewhere between pixels: larger by the ratio of the features'
    disagreement, which no wrench explains, under load and at rest;
errors of the map, growing with the load: products of held-out errors at different moments, where white noise has the
    mean zero. At least the standard error that the reference's noise leaves in the fitted terms.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.estimators.wrench.model import Frames

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

QUIET_PART = 0.03  # of full scale: below, a frame may be untouched
MOVED_PART = 0.5  # likewise: above, the disagreement may be what the map's second order leaves
N_PASSES = 200  # of the mixture
FIRST_PART = 0.3  # of those frames, the nearest to zero, that the mixture begins with
APART = 4.0  # variance of light touches over that of noise: below, all are one
FRAMES_PER_AXIS = 5  # of each of the two: fewer do not determine a covariance
LEAST_SHARE = 0.1  # of the features' noise that their disagreement must show, summed over features
LEAST_ERROR = 0.0015  # of full scale, under a full load: loads that are held for other times than the log's
PAIR_S = 0.3  # apart at most: the load, and the map's error with it, is then the same
LEAST_APART = 2  # frames: a reference read between two frames has noise in common with both
JITTER = 1e-9


class Quiet(NamedTuple):
    """Covariance (k, k) of noise, and how likely each row is untouched (t,)."""

    covariance: Array
    weight: Array


def noise_of_untouched(rows: Array) -> Quiet:
    """Noise of rows (t, k) about zero, of which some are untouched and the others lightly touched.

    All are taken as untouched where either has too few, or two normal distributions are no better than one by
    Schwarz's criterion: of noise alone the mixture takes a part for touches, and what is left is too small.
    """
    n, k = rows.shape
    wide = rows.T @ rows / n
    wide += JITTER * np.trace(wide) / k * np.eye(k)
    scale = np.maximum(np.median(np.abs(rows), axis=0), JITTER * np.sqrt(np.diag(wide)))
    size = ((rows / scale) ** 2).sum(axis=1)
    weight, everything = (size <= np.quantile(size, FIRST_PART)).astype(float), wide
    all_untouched = Quiet(everything, np.ones(n))
    for _ in range(N_PASSES):
        if min(weight.sum(), n - weight.sum()) < FRAMES_PER_AXIS * k:
            return all_untouched
        part = float(np.clip(weight.mean(), JITTER, 1 - JITTER))
        narrow = _covariance(rows, weight, everything)
        wide = _covariance(rows, 1 - weight, everything)
        odds = np.log(part / (1 - part)) + _log_density(rows, narrow) - _log_density(rows, wide)
        weight = 1 / (1 + np.exp(-np.clip(odds, -500, 500)))
    one = _log_density(rows, everything).sum()
    both = np.logaddexp(np.log(part) + _log_density(rows, narrow), np.log(1 - part) + _log_density(rows, wide)).sum()
    is_better = both - one > (k * (k + 1) / 2 + 1) / 2 * np.log(n)
    is_apart = np.trace(np.linalg.solve(narrow, wide)) >= APART * k
    return Quiet(narrow, weight) if is_better and is_apart else all_untouched


def _covariance(rows: Array, weight: Array, everything: Array) -> Array:
    total = max(float(weight.sum()), 1.0)
    return np.asarray((rows.T * weight) @ rows / total + JITTER * everything)


def _log_density(rows: Array, covariance: Array) -> Array:
    root = np.linalg.cholesky(covariance)
    return np.asarray(-0.5 * (np.linalg.solve(root, rows.T) ** 2).sum(axis=0) - np.log(np.diag(root)).sum())


class FittedFrames(NamedTuple):
    """The map's wrench without memory (t, 6), and its size over full scale (t,); features less those of that wrench
    (t, n); held-out errors (t, 6); is_loaded (t,).
    """

    at_once: Array
    size: Array
    disagreement: Array
    errors: Array
    is_loaded: Mask


def stated(seen: FittedFrames, frames: Frames, full: Array, n_terms: int) -> tuple[Array, Array]:
    """Covariances (6, 6): of every frame, and of the square of the load over full scale; zero where full is zero.

    n_terms : fitted for each axis.
    """
    axes = np.flatnonzero(full > 0)
    may_rest = seen.size < QUIET_PART
    quiet = noise_of_untouched(seen.at_once[np.ix_(may_rest, axes)])
    noise = np.zeros((6, 6))
    noise[np.ix_(axes, axes)] = quiet.covariance
    constant = noise * _noise_when_moved(seen, frames, may_rest, quiet.weight)
    reference_variance = np.maximum(_mean_square(seen.errors[may_rest], quiet.weight) - np.diag(noise), 0)
    per_load = max(float((seen.size**2).mean()), JITTER)
    standard_error = reference_variance * n_terms / len(seen.size) / per_load
    of_map = np.maximum(_growing(seen, frames, constant, reference_variance), standard_error)
    growing = np.where(full > 0, of_map + (LEAST_ERROR * full) ** 2, 0)
    return constant, np.diag(growing)


def _mean_square(rows: Array, weight: Array) -> Array:
    return np.asarray((rows**2 * weight[:, None]).sum(axis=0) / weight.sum())


def _noise_when_moved(seen: FittedFrames, frames: Frames, may_rest: Mask, weight: Array) -> float:
    """Variance of a moved feature over that of an untouched one, of the part in which features disagree.

    A mean of deviations over the features, not of variances: one that the geometry misfits does not decide.
    """
    at_rest = np.maximum(_mean_square(frames.features[may_rest], weight), JITTER)
    untouched_part = _mean_square(seen.disagreement[may_rest], weight)
    share = untouched_part / at_rest
    if share.sum() <= LEAST_SHARE:
        return 1.0
    is_moved = seen.is_loaded & (seen.size < MOVED_PART)
    if not is_moved.any():
        is_moved = seen.is_loaded  # wide rather than narrow
    moved_part = (seen.disagreement[is_moved] ** 2).mean(axis=0)
    factor = np.sqrt(moved_part / np.maximum(untouched_part, JITTER))
    return max(float(np.average(factor, weights=share)) ** 2, 1.0)


def _growing(seen: FittedFrames, frames: Frames, constant: Array, reference_variance: Array) -> Array:
    """Variance (6,) of the map's error over the square of the load.

    By products of errors in pairs of moments, less what the features' own noise has in common there; of logs without
    such pairs by what errors under load have more than noise.
    """
    first, second = _pairs(frames)
    both = float((seen.size[first] * seen.size[second]).sum())
    if both <= 0:
        loaded = seen.is_loaded
        left = (seen.errors[loaded] ** 2).mean(axis=0) - reference_variance - np.diag(constant)
        return np.asarray(left / (seen.size[loaded] ** 2).mean())
    unit = np.maximum((seen.disagreement[seen.is_loaded] ** 2).mean(axis=0), JITTER)
    alike = (seen.disagreement[first] * seen.disagreement[second] / unit).mean(axis=1)
    share = max(float(alike.mean()), 0.0)
    product = seen.errors[first] * seen.errors[second] - share * np.diag(constant)
    return np.asarray(product.sum(axis=0) / both)


def _pairs(frames: Frames) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Frames of one run, LEAST_APART and more frames but at most PAIR_S apart."""
    n, first, second = len(frames.time_s), [], []
    for apart in range(LEAST_APART, n):
        early = np.arange(n - apart)
        is_pair = frames.run[early] == frames.run[early + apart]
        is_pair &= np.abs(frames.time_s[early + apart] - frames.time_s[early]) <= PAIR_S
        if not is_pair.any():
            break
        first.append(early[is_pair])
        second.append(early[is_pair] + apart)
    none = [np.zeros(0, np.intp)]
    return np.concatenate(none + first), np.concatenate(none + second)
