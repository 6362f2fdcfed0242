"""Wrench of a vector of image features, fitted to a reference sensor: tables of kind `wrench` (proto/CALIBRATION.md).

K by least squares is the paper's (F-TOUCH, eq. 2). Temperature, quadratic terms and what the structure forgets under a
held load are taken in where they lessen the error on recordings (or touches) that were not fitted; the reference's lag
is found first.
firmware/stages/feature_wrench/feature_wrench.h has the equations; `predicted` is the same in float. Units here: N
and N mm.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from ruffini.errors import InputError
from ruffini.estimators.wrench.few_features import FittedFrames, stated
from ruffini.estimators.wrench.kernel import TAIL, Grid
from ruffini.estimators.wrench.kernel_choice import choose_kernel, kernel_fitted
from ruffini.estimators.wrench.log import FeatureRun
from ruffini.estimators.wrench.model import (
    AXES,
    Frames,
    WrenchMap,
    frames_of,
    memories,
    products,
    ranges_of,
    recordings_of,
    wrench_at,
)
from ruffini.estimators.wrench.rest import rest_gate
from ruffini.estimators.wrench.terms import (
    FREE_RIDGE,
    LEAST_GAIN,
    LEAST_PRODUCT,
    LEAST_RIDGE,
    Axes,
    Bend,
    Terms,
    fitted,
    held_out,
    mean_abs,
    rms,
    solve,
)

Array = npt.NDArray[np.float64]

Folds = list[npt.NDArray[np.bool_]]

N_FOLDS = 5
FEW_RECORDINGS = 10  # no more than these, and each is left out alone: two at once of seven leave too little to fit
LEFT_OUT = {"recording": "recordings", "touch": "touches", "block": "blocks of time"}
LAGS_S = np.arange(-0.1, 0.1001, 0.0125)
FEW = 30  # features: thousands of frames determine these without a ridge, and their memories besides
SAME_ROW_S = 0.02  # a log with one row a frame has paired them already: a smaller lag is left as it is
SAME_LAG_S = 0.005  # a sixth of a frame of a usual camera
RIDGES = (
    LEAST_RIDGE,
    1e-6,
    1e-4,
    1e-2,
    1.0,
)  # of the features' mean square: only many features need more
SAME = 1.001  # errors on what was not fitted that are as good as each other
LEAST_R2 = 0.3  # of what the features tell of an axis: one that the log hardly loads is not measured
LEAST_AT_REST = 20  # frames
NEED_REST = ("noise at rest", "agreement of the features at rest")
REST_PART = 0.02  # of full scale: nothing presses
LOADED_PART = 0.1  # likewise: something does
LEAST_ERROR = 5e-3  # of a load: no reference sensor is better
ONE_SIGMA, TWO_SIGMAS = 0.6827, 0.9545
LEAST_KINDS = 5  # kinds of contact: their errors left out tell what another kind differs by
# Of a force, one sigma, where they do not. wedge-load-cell (real), fitted to balls: other objects err by 0.30 to 0.36
# (median), 0.48 to 0.55 (90th percentile); 51 to 63 and 89 to 93 % are then within one and two sigma.
OTHER_KIND = 0.5
TOLERANCE = 3.0  # times the largest disagreement of a feature in the log


@dataclass(frozen=True)
class Fit:
    """A map, what it was made with, and what it errs by on what was not fitted.

    rmse, mae, r2 : of each axis against the reference, held out; `linear_rmse` of K alone there; `by_recording` the
        same errors (2, 6), RMSE and MAE, by the recording's name.
    """

    map: WrenchMap
    lag_s: float
    ridge: dict[str, float]  # by axis
    terms: dict[str, list[str]]  # term: axes that keep it
    rmse: Array
    r2: Array
    linear_rmse: Array
    condition: float
    n_frames: int
    n_runs: int
    holdout: str
    mae: Array = field(default_factory=lambda: np.full(6, np.nan))
    by_recording: dict[str, Array] = field(default_factory=dict)
    checks: list[str] = field(default_factory=list)
    no_warmth: str | None = None  # why temperature was not tried
    leaning: list[str] = field(default_factory=list)  # axes whose K leans on the pad's mechanics
    kernel: str | None = None  # shape of the nonlinear part
    not_stated: list[str] = field(default_factory=list)  # what needs untouched frames, where there are none

    @property
    def left_out(self) -> str:
        """What the errors were judged on."""
        return _left_out(self.holdout)

    def report(self) -> dict[str, object]:
        """For JSON."""
        by_axis = {
            axis: {"rmse": float(e), "mae": float(m), "r2": float(r), "rmse_linear": float(p), "full_scale": float(f)}
            for axis, e, m, r, p, f in zip(
                AXES, self.rmse, self.mae, self.r2, self.linear_rmse, self.map.full, strict=True
            )
        }
        return {
            "axes": by_axis, "unit": "N, N mm", "held_out_by": self.holdout, "lag_ms": 1e3 * self.lag_s,
            "ridge": self.ridge, "terms": self.terms, "condition": self.condition, "n_frames": self.n_frames,
            "prior": self.leaning, "n_recordings": self.n_runs, "checks": self.checks, "temperature": self._warmth(),
            "recordings": {n: {"rmse": v[0].tolist(), "mae": v[1].tolist()} for n, v in self.by_recording.items()},
            "kernel": self.kernel, "not_stated": self.not_stated,
            "not_measured": [a for a, f in zip(AXES, self.map.full, strict=True) if f == 0],
        }  # fmt: skip

    def _warmth(self) -> object:
        warmth = self.map.warmth
        if warmth is None:
            return self.no_warmth or "lessens no error on what was not fitted"
        return {
            "reference_c": warmth.reference, "range_c": [warmth.coldest, warmth.warmest],
            "gain_per_k": dict(zip(AXES, warmth.gain.tolist(), strict=True)),
            "offset_per_k": dict(zip(AXES, warmth.offset.tolist(), strict=True)),
        }  # fmt: skip


def fit_wrench_map(
    runs: list[FeatureRun], *, holdout: str = "recording", bend: Bend | None = None, prior: Array | None = None,
    nonlinear: bool = False, grid: Grid | None = None, is_of_gel: bool = False,
) -> Fit:  # fmt: skip
    """Fit K and what goes beyond it where that pays on held-out data.

    bend : what products of axes add to the features (n, 21), for features that are linear in them by (n, 6), where the
        board's geometry says it (`target_geometry`); else quadratic terms are free.
    prior : K (6, n) by the pad's mechanics (`marker_prior`), for many features: each axis leans on it where that pays.
    holdout : `recording` leaves whole recordings out, `touch` single touches (as the log numbers them, else from one
        touch-free moment to the next), `block` fifths of the time of each recording.
    nonlinear : of many features, try landmark kernels (`wrench_kernel`) too; kept where they err less.
    grid : planes, rows and columns of the features of a picture.
    is_of_gel : the features are those of a gel without markers (a grid always is), which do not tell every kind of
        contact apart.

    Raises
    ------
    InputError
        Too few recordings or frames, or units that cannot be right.
    """
    if holdout not in LEFT_OUT:
        raise InputError(f"--holdout {holdout!r}: {', '.join(LEFT_OUT)}")
    seen = frames_of(runs, 0.0)
    _checks(seen)
    ways = (False, True) if seen.features.shape[1] <= FEW else (False,)
    lags = [_lag(runs, has_memory) for has_memory in ways] if _has_sequences(seen) else [0.0]
    if all(run.is_row_by_row for run in runs):
        is_paired = abs(lags[0]) < SAME_ROW_S or not _is_lag_common(runs)
        lags = [0.0 if is_paired or abs(lag) < SAME_ROW_S else lag for lag in lags]
    if abs(lags[-1] - lags[0]) < SAME_LAG_S:
        lags = lags[:1]
    nonlinear = nonlinear and seen.features.shape[1] > FEW
    fits = [
        _fit_at(runs, lag_s, holdout, bend, prior, nonlinear, grid, is_of_gel or grid is not None) for lag_s in lags
    ]
    return fits[0] if len(fits) == 1 else min(fits, key=lambda fit: _misfit(fit, runs))


def _misfit(fit: Fit, runs: list[FeatureRun]) -> float:
    """Part of the reference that a map of few features does not explain of its own log, summed over the axes.

    Not of recordings left out: of a log that has each kind of load once, a fold has an axis that nothing loaded.
    """
    frames = frames_of(runs, fit.lag_s)
    error = fit.map.predicted(frames) - frames.wrench
    misfit = rms(error) ** 2 / np.maximum(frames.wrench.var(axis=0), 1e-12)
    return float(np.where(fit.map.full > 0, misfit, 1.0).sum())  # of an axis that is not measured: all of it


def _fit_at(
    runs: list[FeatureRun], lag_s: float, holdout: str, bend: Bend | None, prior: Array | None, nonlinear: bool,
    grid: Grid | None, is_of_gel: bool,
) -> Fit:  # fmt: skip
    frames = frames_of(runs, lag_s)
    folds = folds_of(frames, holdout)
    checks = _checks(frames)
    route = _route(frames, folds, bend, prior)
    chosen, linear, errors = route.terms, route.linear, route.errors
    touch = _touches(frames)
    kernel = None
    if nonlinear:
        kernel = choose_kernel(frames, touch, folds, errors, must_extrapolate=holdout == "block", grid=grid)
    if kernel is not None:
        chosen, errors = _plain(None), kernel.errors
    of_map = errors
    # What another kind of contact may hide, too few kinds do not tell.
    n_kinds = len({run.kind for run in runs})
    rest = rest_gate(frames.features, frames.wrench, folds) if grid is not None and n_kinds >= LEAST_KINDS else None
    if rest is not None:
        gated = np.where(rest.is_untouched[:, None], -frames.wrench, errors)
        is_loaded = np.abs(frames.wrench).max(axis=0) > 0
        if (mean_abs(gated) > mean_abs(errors))[is_loaded].any():  # a gate that hides touches
            rest = None
        else:
            errors = gated
    spread = frames.wrench.std(axis=0)
    r2 = 1 - (rms(errors) / np.where(spread > 0, spread, 1)) ** 2
    is_told = (r2 >= LEAST_R2) & (spread > 0)
    if frames.features.shape[1] <= FEW:  # cannot fit what is not there: an axis that only one recording loads counts
        left = fitted(frames, chosen).predicted(frames) - frames.wrench
        is_told |= (rms(left) < np.sqrt(1 - LEAST_R2) * spread) & (spread > 0)
    if not is_told.any():
        raise InputError(
            f"on {_left_out(holdout)} that were not fitted the features tell nothing of the reference: is it this "
            "sensor's, in the pad's axes, one row a frame?"
        )
    full = np.where(is_told, ranges_of(np.abs(frames.wrench).max(axis=0)), 0.0)
    if kernel is None:
        found = _with_forward(fitted(frames, chosen, full), frames, of_map, bend, folds)
    else:
        found = _with_forward(kernel_fitted(frames, touch, full, kernel, grid), frames, of_map, None, folds,
                              is_two_held=rest is not None)  # fmt: skip
    if rest is not None:
        found = replace(found, rest=replace(rest.gate, error=rest.gate.error * (full > 0)))
    if is_of_gel and n_kinds < LEAST_KINDS:
        found = replace(found, error=_for_other_kinds(found.error, full))
        checks.append(
            f"{n_kinds} of {LEAST_KINDS} kinds of contact: the stated uncertainty is at least "
            f"{100 * OTHER_KIND:.0f} % of a force, as another kind may differ; collect a log with each "
            "tip that will touch, named by --tip"
        )
    terms = {"temperature": chosen.warm, "quadratic": chosen.square, "relaxation": chosen.relax}
    scaled = frames.features / np.maximum(frames.features.std(axis=0), 1e-9)
    return Fit(
        found, lag_s, dict(zip(AXES, chosen.ridge.tolist(), strict=True)), {n: _names(m) for n, m in terms.items()},
        rms(errors), r2, rms(linear), _condition(scaled), len(frames.features), len(np.unique(frames.recording)),
        holdout, mean_abs(errors), _by_recording(frames, runs, errors), checks, frames.degrees.why_not,
        _names(chosen.leans), kernel.name if kernel else None, [] if has_rest(frames) else list(NEED_REST),
    )  # fmt: skip


def _names(axes: Axes) -> list[str]:
    return [axis for axis, on in zip(AXES, axes, strict=True) if on]


def _by_recording(frames: Frames, runs: list[FeatureRun], errors: Array) -> dict[str, Array]:
    """RMSE and MAE (2, 6) of each recording."""
    numbers = recordings_of(runs)
    names = {k: run.recording or run.name for k, run in zip(numbers, runs, strict=True)}
    parts = {name: errors[frames.recording == k] for k, name in names.items()}
    return {name: np.stack([rms(part), mean_abs(part)]) for name, part in parts.items() if np.isfinite(part).any()}


def has_rest(frames: Frames) -> bool:
    """Whether the log has untouched frames to measure noise at rest on."""
    loaded = np.abs(frames.wrench) / np.maximum(np.abs(frames.wrench).max(axis=0), 1e-12)
    return int((loaded.max(axis=1) < REST_PART).sum()) >= LEAST_AT_REST


def _left_out(holdout: str) -> str:
    return LEFT_OUT[holdout]


def linear_map(runs: list[FeatureRun], lag_s: float) -> WrenchMap:
    """K alone, as the paper's."""
    return fitted(frames_of(runs, lag_s), _plain(None))


def share_in_disagreement(found: WrenchMap, runs: list[FeatureRun], n: int, rng: np.random.Generator) -> float:
    """Share of n good frames that would be flagged: loads drawn from the log's, noise as at rest there."""
    frames = frames_of(runs, 0.0)
    loads = found.scaled(found.elastic(frames))
    at_rest = np.abs(loads).max(axis=1) < REST_PART
    noise = rng.multivariate_normal(np.zeros(frames.features.shape[1]), np.cov(frames.features[at_rest].T), n)
    u = loads[rng.integers(len(loads), size=n)]
    features = np.concatenate([u, products(u)], axis=1) @ found.forward.T + noise
    y = features @ found.gain.T
    said = found.scaled(y + products(found.scaled(y)) @ found.square.T)
    off = np.abs(features - np.concatenate([said, products(said)], axis=1) @ found.forward.T)
    return float((off > found.tolerance).any(axis=1).mean())


def _condition(scaled: Array) -> float:
    """Of the six strongest directions of the features, each scaled by its spread."""
    values = np.linalg.svd(scaled - scaled.mean(axis=0), compute_uv=False)
    return float(values[0] / values[min(5, len(values) - 1)])


def folds_of(frames: Frames, holdout: str) -> Folds:
    """Frames that each fold leaves out: whole recordings or whole touches, dealt round.

    Raises
    ------
    InputError
        Less than two recordings, or five touches.
    """
    if holdout == "block":
        return _blocks(frames)
    by_touch = holdout == "touch"
    names = np.unique(groups := _touches(frames) if by_touch else frames.recording)
    if len(names) < (least := N_FOLDS if by_touch else 2):
        remedy = "press more often" if by_touch else "give another log, or --holdout touch"
        raise InputError(f"only {len(names)} {_left_out(holdout)}: {least} are needed to judge a fit; {remedy}")
    n = len(names) if len(names) <= FEW_RECORDINGS and not by_touch else N_FOLDS
    return [np.isin(groups, names[i::n]) for i in range(n)]


def _blocks(frames: Frames) -> Folds:
    """Fifths of the time of each recording, cut between touches: a drift or another program of presses is left out."""
    touch, block = _touches(frames), np.zeros(len(frames.touch), int)
    for recording in np.unique(frames.recording):
        rows = np.flatnonzero(frames.recording == recording)
        names, first = np.unique(touch[rows], return_index=True)
        order = np.empty(len(names), int)
        order[np.argsort(first)] = np.arange(len(names))
        block[rows] = (N_FOLDS * order // len(names))[np.searchsorted(names, touch[rows])]
    if len(np.unique(touch)) < N_FOLDS:
        raise InputError(f"only {len(np.unique(touch))} touches: {N_FOLDS} are needed to judge a fit; press more often")
    return [block == k for k in range(N_FOLDS)]


def _touches(frames: Frames) -> npt.NDArray[np.intp]:
    """Number of the touch that a frame belongs to: the log's, else by the load."""
    if (frames.touch >= 0).all():
        return frames.touch
    size = (np.abs(frames.wrench) / np.maximum(np.abs(frames.wrench).max(axis=0), 1e-12)).max(axis=1)
    starts = np.diff((size > 0.1).astype(int), prepend=0) == 1
    starts |= np.diff(frames.run, prepend=frames.run[0]) != 0
    return np.asarray(np.cumsum(starts))


class _Route(NamedTuple):
    """Terms, and the errors (t, 6) on what was not fitted: of K alone, and of all."""

    terms: Terms
    linear: Array
    errors: Array


def _plain(bend: Bend | None) -> Terms:
    """K alone, hardly any ridge."""
    off = np.zeros(6, bool)
    return Terms(np.full(6, LEAST_RIDGE), square=off, relax=off, warm=off, leans=off, bend=bend)


def _route(frames: Frames, folds: Folds, bend: Bend | None, prior: Array | None) -> _Route:
    """The terms that err least on what was not fitted, by axis: its ridge, and whether it leans on the prior.

    Of those that err as little as any the least ridge, without the prior if it can be.
    """
    plain = _plain(bend)
    if frames.features.shape[1] <= FEW:
        return _with_terms(frames, folds, plain)
    ways = [replace(plain, ridge=np.full(6, r)) for r in RIDGES]
    if prior is not None:
        ways += [replace(way, leans=np.ones(6, bool), prior=prior) for way in ways]
    routes = [_with_terms(frames, folds, way) for way in ways]
    errors = np.array([rms(route.errors) for route in routes])
    best = np.argmax(errors <= SAME * errors.min(axis=0), axis=0)
    terms, linear = routes[0].terms, routes[0].linear
    for way, route in enumerate(routes[1:], 1):
        terms = terms.taking(best == way, route.terms)
        linear = np.where(best == way, route.linear, linear)
    return _Route(terms, linear, held_out(frames, folds, terms))  # products are of all axes: not the routes' own errors


def _with_terms(frames: Frames, folds: Folds, plain: Terms) -> _Route:
    """Temperature, products and relaxation on the axes on which they pay."""
    chosen = plain
    linear = errors = held_out(frames, folds, plain)
    is_loaded = np.abs(frames.wrench).max(axis=0) > 1e-9
    for name in ("square", "relax") if frames.degrees.why_not else ("warm", "square", "relax"):
        trial = replace(chosen, **{name: is_loaded})
        # A geometry that is known stays unless it does harm: the log may not load the pairs that it is for.
        least = -LEAST_GAIN if name == "square" and plain.bend is not None else LEAST_GAIN
        gains = is_loaded & (rms(held_out(frames, folds, trial)) < (1 - least) * rms(errors))
        chosen = replace(chosen, **{name: gains})
        errors = held_out(frames, folds, chosen) if gains.any() else errors
    return _Route(chosen, linear, errors)


def _has_sequences(frames: Frames) -> bool:
    """Whether touches have several frames, so that a lag shows."""
    if (frames.touch < 0).any():
        return True
    return len(frames.touch) >= 3 * len(np.unique(frames.touch))


def _lag(runs: list[FeatureRun], has_memory: bool) -> float:
    """By how much the reference is behind the pictures: where features explain it best, between grid points a parabola.

    What the structure forgets looks like a lag too; with memories of the features let in it does not, but products do.
    """
    seen = frames_of(runs, 0.0)
    scaled = seen.features / np.maximum(np.sqrt((seen.features**2).mean(axis=0)), 1e-9)
    features = np.concatenate([scaled, *memories(scaled, seen)], axis=1) if has_memory else scaled
    wrench = wrench_at(runs, LAGS_S)
    error = features @ solve(features, wrench, LEAST_RIDGE).T - wrench
    misfit = (rms(error) ** 2 / np.maximum(wrench.var(axis=0), 1e-12)).reshape(len(LAGS_S), 6).sum(axis=1)
    best = int(np.argmin(misfit))
    if best in (0, len(LAGS_S) - 1) and not has_memory:
        raise InputError(
            f"the reference is {1e3 * abs(LAGS_S[best]):.0f} ms or more off the pictures: "
            "give both one clock, one row a frame"
        )
    best = min(max(best, 1), len(LAGS_S) - 2)
    before, at, after = misfit[best - 1 : best + 2]
    return float(LAGS_S[best] + (LAGS_S[1] - LAGS_S[0]) * 0.5 * (before - after) / (before - 2 * at + after))


def _is_lag_common(runs: list[FeatureRun]) -> bool:
    """True if the lag stays the same whichever recording is left out, of three or more.

    A lag of the reference is common to all recordings; one that a single recording decides is that recording's glitch.
    """
    numbers = recordings_of(runs)
    names = np.unique(numbers)
    if len(names) < 3:
        return True
    try:
        lags = [_lag([r for r, k in zip(runs, numbers, strict=True) if k != name], False) for name in names]
    except InputError:  # at the end of the range
        return False
    return max(lags) - min(lags) < SAME_ROW_S


def _checks(frames: Frames) -> list[str]:
    """What looks wrong with units and axes. Raises InputError where it cannot be a sensor of this size."""
    force, torque = (np.sqrt((frames.wrench[:, part] ** 2).mean()) for part in (slice(0, 3), slice(3, 6)))
    arm_mm = torque / max(force, 1e-12)
    if torque > 0 and not 0.01 < arm_mm < 1000:  # a load cell has no torques
        raise InputError(
            f"torques are {arm_mm:.3g} mm times the forces: give them in N mm, forces in N (axes fx fy fz tx ty tz)"
        )
    said = []
    if frames.wrench[:, 2].mean() > 0:
        said.append("Fz is positive on average: pressing must be negative (forces act on the pad, +z out of it)")
    return said


def _with_forward(
    found: WrenchMap, frames: Frames, errors: Array, bend: Bend | None, folds: Folds, *, is_two_held: bool = False
) -> WrenchMap:
    """Adds what features a wrench makes, how far they may be off, and the covariance."""
    u = found.scaled(found.elastic(frames))
    pairs = products(u)
    if bend is not None:
        beyond = bend(solve(u, frames.features, LEAST_RIDGE))
        first = solve(u, frames.features - pairs @ beyond.T, LEAST_RIDGE)
    else:
        is_excited = np.sqrt((pairs**2).mean(axis=0)) > LEAST_PRODUCT
        both = solve(np.concatenate([u, pairs * is_excited], axis=1), frames.features, FREE_RIDGE)
        first, beyond = both[:, :6], both[:, 6:] * is_excited
    off = frames.features - u @ first.T - pairs @ beyond.T
    forward = np.concatenate([first, beyond], axis=1)
    error = _error(found, frames, errors, folds, off, is_two_held=is_two_held)
    return replace(found, forward=forward, tolerance=TOLERANCE * np.abs(off).max(axis=0), error=error)


def _error(
    found: WrenchMap, frames: Frames, errors: Array, folds: Folds, off: Array, *, is_two_held: bool
) -> Array:  # fmt: skip
    """Vectors of the covariance: at rest the features' noise through K; of a load what is left of the held-out errors.

    The reference's own noise is in both and goes: it is what the reference says of rest frames, where nothing presses.
    With at most FEW features, few_features.stated() computes it.
    off : (t, n), features less those of the wrench.
    is_two_held : of a kernel, 95 % of all held-out errors are within two sigma, too. Untouched frames, whose errors are
        small, have a sigma of their own then (`rest`), and the others exceed two of theirs more often.
    """
    linear = found.elastic(frames) if found.kernel else frames.features @ found.gain.T
    at_once = found.corrected(linear, frames.degrees)
    u = found.scaled(at_once)
    size2 = (u**2).sum(axis=1)
    at_rest = size2 < REST_PART**2
    if at_rest.sum() < LEAST_AT_REST:
        return _error_of_loads(errors, size2, found.full, folds)
    quiet = np.cov(at_once[at_rest].T)
    loaded = size2 > LOADED_PART**2
    _check_loaded(loaded)
    if frames.features.shape[1] <= FEW:
        seen = FittedFrames(at_once, np.sqrt(size2), off, errors, loaded)
        n_terms = found.gain.shape[1] + int(found.square.any(axis=0).sum() + found.relax.any(axis=1).sum())
        return np.stack([_vectors(part) for part in stated(seen, frames, found.full, n_terms)])
    left = np.cov(errors[loaded].T) - np.cov(errors[at_rest].T)
    growing = left / size2[loaded].mean()
    is_measured = np.outer(found.full > 0, found.full > 0)  # nothing is said of the others
    out = np.stack([_vectors(quiet * is_measured), _vectors(growing * is_measured, least=LEAST_ERROR * found.full)])
    if not found.kernel:
        return out
    return _as_left_out(out, errors, size2, folds, is_two_held=is_two_held)


def _error_of_loads(errors: Array, size2: Array, full: Array, folds: Folds) -> Array:
    """As `_error`, for a log without rest frames: held-out errors of the lightest quarter stand for those at rest."""
    light = size2 <= np.quantile(size2, 0.25)
    _check_loaded(~light)
    quiet = np.cov(errors[light].T)
    growing = (np.cov(errors[~light].T) - quiet) / max(size2[~light].mean(), 1e-12)
    is_measured = np.outer(full > 0, full > 0)
    return _widened(np.stack([_vectors(quiet * is_measured), _vectors(growing * is_measured)]), errors, size2, folds)


def _as_left_out(out: Array, errors: Array, size2: Array, folds: Folds, *, is_two_held: bool = False) -> Array:
    """Each axis' constant and growing part scaled to the largest likelihood of the held-out errors, then widened.

    The likelihood is Student's: moments would follow the few largest errors.
    """
    variances, scaled = (out**2).sum(axis=1), out.copy()
    for axis in np.flatnonzero(variances.min(axis=0) > 0):
        error2, (quiet, growing) = errors[:, axis] ** 2, variances[:, axis]

        def unlikely(logs: Array, error2: Array = error2, quiet: float = quiet, growing: float = growing) -> float:
            variance = quiet * np.exp(logs[0]) + growing * np.exp(logs[1]) * size2
            return float((np.log(variance) + (TAIL + 1) * np.log1p(error2 / variance / TAIL)).sum())

        scaled[:, :, axis] *= np.exp(0.5 * minimize(unlikely, np.zeros(2), method="Nelder-Mead").x)[:, None]
    return _widened(scaled, errors, size2, folds, is_two_held=is_two_held)


def _widened(out: Array, errors: Array, size2: Array, folds: Folds, *, is_two_held: bool = False) -> Array:
    """Each axis scaled so that one sigma covers 68 % of the held-out errors in the worst fold.

    Errors have longer tails than a normal distribution, and what a new recording brings is no less than the worst.
    """
    sigma = np.sqrt((out[0] ** 2).sum(axis=0) + size2[:, None] * (out[1] ** 2).sum(axis=0))
    parts = np.abs(errors) / np.maximum(sigma, 1e-12)
    wide = np.max([np.quantile(parts[left], ONE_SIGMA, axis=0) for left in folds], axis=0)
    if is_two_held:
        wide = np.maximum(wide, np.quantile(parts, TWO_SIGMAS, axis=0) / 2)
    return np.asarray(out * wide)


def _for_other_kinds(error: Array, full: Array) -> Array:
    """The growing part is at least OTHER_KIND of a force: a gel does not tell which kind of contact it feels."""
    growing = np.sqrt((error[1] ** 2).sum(axis=0))
    more = np.maximum(1, OTHER_KIND * full / np.maximum(growing, 1e-12))
    return np.stack([error[0], error[1] * np.where(full > 0, more, 1)])


def _check_loaded(loaded: npt.NDArray[np.bool_]) -> None:
    """Raises InputError if the features show a load in fewer than two frames: no covariance follows from those."""
    if loaded.sum() < 2:
        raise InputError(
            f"the features show a load in {loaded.sum()} frames of this log, too few to estimate an error under load: "
            "press more often or hold longer"
        )


def _vectors(covariance: Array, least: Array | None = None) -> Array:
    """Rows whose outer products sum to the nearest covariance that is one; `least` standard deviations are added."""
    values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    rows = (axes * np.sqrt(values.clip(0))).T
    if least is not None:
        values, axes = np.linalg.eigh(rows.T @ rows + np.diag(least**2))
        rows = (axes * np.sqrt(values.clip(0))).T
    return np.asarray(rows)
