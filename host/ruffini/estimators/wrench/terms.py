"""Least squares of one wrench map by given terms, and its errors on what it was not fitted on; see `wrench_map`.

Each axis has a ridge of its own, and either leans on the pad's mechanics or does not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

from ruffini.estimators.wrench.model import (
    PAIRS,
    TIMES_S,
    Frames,
    WrenchMap,
    forgotten,
    memories,
    products,
)
from ruffini.estimators.wrench.warmth import no_warmth

Array = npt.NDArray[np.float64]
Axes = npt.NDArray[np.bool_]  # (6,)

Bend = Callable[[Array], Array]
LEAST_GAIN = 0.01  # a term stays where it lessens the error of an axis on what was not fitted by this part
LEAST_RIDGE = 1e-8  # of the features' mean square
LEAST_PRODUCT = 0.03  # of u_j u_k, root mean square: a pair that the log hardly loads together gets no term
FREE_RIDGE = 1e-5  # of quadratic terms that no geometry gives
N_PASSES = 3  # K, temperature and relaxation by turns


@dataclass(frozen=True)
class Terms:
    """Of each axis: its ridge (6,), which of the terms it has, and whether it leans on `prior` (6, n)."""

    ridge: Array
    square: Axes
    relax: Axes
    warm: Axes
    leans: Axes
    bend: Bend | None = None
    prior: Array | None = None

    def taking(self, axes: Axes, other: Terms) -> Terms:
        """These terms, but those of `other` on some axes."""
        names = ("ridge", "square", "relax", "warm", "leans")
        return replace(other, **{n: np.where(axes, getattr(other, n), getattr(self, n)) for n in names})


def rms(errors: Array) -> Array:
    """Of each axis, (6,)."""
    return np.asarray(np.sqrt(np.nanmean(errors**2, axis=0)))


def mean_abs(errors: Array) -> Array:
    """Of each axis, (6,)."""
    return np.asarray(np.nanmean(np.abs(errors), axis=0))


def solve(features: Array, wrench: Array, ridge: float | Array) -> Array:
    """K (6, n), each feature scaled by its own spread."""
    scale = np.maximum(np.sqrt((features**2).mean(axis=0)), 1e-9)
    a = features / scale
    normal = a.T @ a + np.diag(np.broadcast_to(ridge * np.float64(len(a)), a.shape[1]))
    return np.asarray(np.linalg.solve(normal, a.T @ wrench).T / scale)


def fitted(frames: Frames, terms: Terms, full: Array | None = None) -> WrenchMap:
    """Gain, products, relaxation and warmth; no `forward`, no covariance. full : of u, the log's where None."""
    n = frames.features.shape[1]
    if full is None:
        full = np.abs(frames.wrench).max(axis=0)
    relax, target = np.zeros((len(TIMES_S), 6)), frames.wrench
    warmth = no_warmth(frames.degrees) if terms.warm.any() else None
    for _ in range(N_PASSES if terms.relax.any() or warmth else 1):
        aim = target if warmth is None else warmth.inverse(target, frames.degrees)
        gain, _ = _gain(frames.features, np.zeros((len(aim), 0)), aim, terms)
        square = np.zeros((6, len(PAIRS[0])))
        made = WrenchMap(gain, full, square, relax, np.zeros((n, 27)), np.ones(n), np.zeros((2, 6, 6)), warmth)
        for _ in range(2 if terms.square.any() else 0):  # u is of the gain, which the products change a little
            made = _with_square(made, frames, aim, terms)
        elastic = made.corrected(made.elastic(frames), frames.degrees)
        if terms.relax.any():
            h = memories(elastic, frames)
            relax = _relaxation(elastic, h, frames, terms.relax)
            target = frames.wrench + forgotten(h, relax)
        if warmth is not None:
            warmth = warmth.refined(made.elastic(frames), target, frames.degrees, terms.warm)
    return replace(made, relax=relax, warmth=warmth)


def _relaxation(elastic: Array, h: Array, frames: Frames, axes: npt.NDArray[np.bool_]) -> Array:
    """Parts of each term that leave the reference's wrench of the elastic one, on those axes; h : its memories."""
    relax = np.zeros((len(TIMES_S), 6))
    for axis in np.flatnonzero(axes):
        columns = np.stack([elastic[:, axis], *(-h[k, :, axis] for k in range(len(TIMES_S)))], axis=1)
        weights = nnls(columns, frames.wrench[:, axis])[0]
        relax[:, axis] = (weights[1:] / max(weights[0], 1e-9)).clip(0, 0.9)
    return relax


def _gain(features: Array, others: Array, target: Array, terms: Terms) -> tuple[Array, Array]:
    """K (6, n), and what `others` add: axes that are solved alike at once."""
    n = features.shape[1]
    both = np.zeros((6, n + others.shape[1]))
    for ridge, leans in sorted(set(zip(terms.ridge.tolist(), terms.leans.tolist(), strict=True))):
        axes = (terms.ridge == ridge) & (terms.leans == leans)
        columns = np.concatenate([features, others], axis=1)
        if leans:
            assert terms.prior is not None
            both[axes] = _leaning(columns, features @ terms.prior.T, target[:, axes], ridge, terms.prior)
        else:
            both[axes] = solve(columns, target[:, axes], ridge)
    return both[:, :n], both[:, n:]


def _leaning(columns: Array, said: Array, target: Array, ridge: float, prior: Array) -> Array:
    """The ridge holds K, the first columns, to what the prior has said (t, 6), times what each axis needs."""
    k = columns.shape[1]
    weight = np.concatenate([np.full(k, ridge), np.full(6, LEAST_RIDGE)])
    all_ = solve(np.concatenate([columns, said], axis=1), target, weight)
    all_[:, : prior.shape[1]] += all_[:, k:] @ prior
    return np.asarray(all_[:, :k])


def _with_square(made: WrenchMap, frames: Frames, target: Array, terms: Terms) -> WrenchMap:
    """Gain and quadratic terms together, on the axes that have them."""
    keep = terms.square[:, None]
    u = made.scaled(frames.features @ made.gain.T)
    basis = products(u)
    if terms.bend is not None:  # what the geometry says that the features do; then the rest is linear
        beyond = terms.bend(solve(u, frames.features, LEAST_RIDGE))
        gain, _ = _gain(frames.features - basis @ beyond.T, basis[:, :0], target, terms)
        square = -gain @ beyond
    else:
        is_excited = np.sqrt((basis**2).mean(axis=0)) > LEAST_PRODUCT
        square = np.zeros((6, len(PAIRS[0])))
        terms = replace(terms, ridge=np.maximum(terms.ridge, FREE_RIDGE))
        gain, square[:, is_excited] = _gain(frames.features, basis[:, is_excited], target, terms)
    return replace(made, gain=np.where(keep, gain, made.gain), square=np.where(keep, square, 0.0))


def held_out(frames: Frames, folds: list[npt.NDArray[np.bool_]], terms: Terms) -> Array:
    """Error of every frame by a map that was not fitted on it, (t, 6)."""
    out = np.full_like(frames.wrench, np.nan)
    for left in folds:
        out[left] = fitted(frames.take(~left), terms).predicted(frames.take(left)) - frames.wrench[left]
    return out
