"""Which landmark kernel, if any, is used beside K: the one that errs least on what was not fitted (`wrench_kernel`)."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.estimators.wrench import kernel as wrench_kernel
from ruffini.estimators.wrench.model import PAIRS, TIMES_S, Frames, WrenchMap
from ruffini.estimators.wrench.terms import LEAST_GAIN, mean_abs, rms

Array = npt.NDArray[np.float64]
Folds = list[npt.NDArray[np.bool_]]
Numbers = npt.NDArray[np.intp]

ENOUGH = 3e-3  # of the variance that the size leaves unexplained: nothing else is tried, which takes minutes
HEAVY = 0.5  # of the largest force: touches beyond it stand for those of a recording that presses harder


class Kernel(NamedTuple):
    """A shape by name, its errors (t, 6) on what was not fitted, and the distances (t,) there, lengths."""

    name: str
    errors: Array
    nearest: Array


def choose_kernel(
    frames: Frames,
    touch: Numbers,
    folds: Folds,
    errors: Array,
    *,
    must_extrapolate: bool,
    grid: wrench_kernel.Grid | None = None,
) -> Kernel | None:
    """The kernel that errs less than `errors` on what was not fitted, if any; each fold learns its own directions.

    must_extrapolate : the map is for other recordings, which may press harder, and no fold does: then the kernel is the
        one that errs least on the heaviest touches, by a fit without them.
    """
    names = wrench_kernel.shape_names(touch, grid)
    if not names:
        return None
    spread = frames.wrench.std(axis=0)
    sizes = [name for name in names if name in wrench_kernel.SIZES]
    if sizes and not must_extrapolate:
        found, nearest = _left_out(frames, touch, folds, sizes, grid)
        best = int(np.argmin([_unexplained(rms(each), spread) for each in found]))
        if _unexplained(rms(found[best]), spread) < ENOUGH:
            return Kernel(sizes[best], found[best], nearest[best])
    found, nearest = _left_out(frames, touch, folds, names, grid)
    judged = _left_out(frames, touch, [heavy(frames, touch)], names, grid)[0] if must_extrapolate else found
    # Of few touches one glitch of the reference would outweigh all else in squares.
    size = rms if "narrow" in names else mean_abs
    best = int(np.argmin([_unexplained(size(each), spread) for each in judged]))
    if _unexplained(size(found[best]), spread) > (1 - LEAST_GAIN) ** 2 * _unexplained(size(errors), spread):
        return None
    return Kernel(names[best], found[best], nearest[best])


def heavy(frames: Frames, touch: Numbers) -> npt.NDArray[np.bool_]:
    """Frames of the touches that get beyond `HEAVY`."""
    force = np.linalg.norm(frames.wrench[:, :3], axis=1)
    return np.isin(touch, touch[force > HEAVY * force.max()])


def _unexplained(error: Array, spread: Array) -> float:
    """Sum of (error / spread)^2 over the axes that are loaded: of RMS errors (6,) their 1 - R2."""
    is_loaded = spread > 1e-9
    return float(((error[is_loaded] / spread[is_loaded]) ** 2).sum())


def _left_out(
    frames: Frames, touch: Numbers, folds: Folds, names: list[str], grid: wrench_kernel.Grid | None
) -> tuple[list[Array], list[Array]]:
    """Of each shape the errors (t, 6) and the distances to the nearest landmark (t,); NaN where no fold left it out."""
    found = [np.full_like(frames.wrench, np.nan) for _ in names]
    nearest = [np.full(len(frames.wrench), np.nan) for _ in found]
    for left in folds:
        inside, outside = frames.take(~left), frames.take(left)
        shapes = wrench_kernel.candidates(inside.features, inside.wrench, touch[~left], names, grid)
        for i, shape in enumerate(shapes):
            gain, kernel = wrench_kernel.solve(inside.features, inside.wrench, shape)
            found[i][left] = outside.features @ gain.T + kernel.added(outside.features) - outside.wrench
            nearest[i][left] = kernel.nearest(outside.features)
    return found, nearest


def kernel_fitted(
    frames: Frames, touch: Numbers, full: Array, chosen: Kernel, grid: wrench_kernel.Grid | None = None
) -> WrenchMap:
    """K and kernel of all frames; what is further from a landmark than frames left out were is outside."""
    (shape,) = wrench_kernel.candidates(frames.features, frames.wrench, touch, [chosen.name], grid)
    gain, kernel = wrench_kernel.solve(frames.features, frames.wrench, shape)
    # A size that some touch had is known, whichever touches were left out.
    share = 1.0 if shape.is_of_size else wrench_kernel.REACH_SHARE
    reach = float(np.quantile(chosen.nearest, share))
    kernel = replace(kernel, weight=kernel.weight * (full > 0)[:, None], offset=kernel.offset * (full > 0), reach=reach,
                     spread=1 / max(reach, 1e-6))  # fmt: skip
    n = frames.features.shape[1]
    none = np.zeros((6, len(PAIRS[0])))
    return WrenchMap(gain, full, none, np.zeros((len(TIMES_S), 6)), np.zeros((n, 27)), np.ones(n), np.zeros((2, 6, 6)),
                     None, kernel)  # fmt: skip
