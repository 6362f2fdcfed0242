"""A new unit's wrench from few presses: the map of other units of the same sensor, times this unit's stiffness.

Pads of one mould differ most in how stiff they are: each axis of the prior map, a calibration that was fitted to logs
of other units, is multiplied by a gain g. A touch tells g_k = sum(p y) / sum(p^2), p the prior's wrench and y the
reference at the time of each of its frames; n touches of variance s^2 tell, with gains of units that spread by t
about 1,

    g = (mean(g_k) n / s^2 + 1 / t^2) / (n / s^2 + 1 / t^2).

Units here: N and N mm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.estimators.material.prior import OF_NEXT_GEL
from ruffini.estimators.wrench.fit import LOADED_PART, ONE_SIGMA, Fit
from ruffini.estimators.wrench.log import FeatureRun
from ruffini.estimators.wrench.model import AXES, Frames, WrenchMap, frames_of, recordings_of
from ruffini.estimators.wrench.terms import mean_abs, rms

Array = npt.NDArray[np.float64]

LEAST_TOUCHES = 3  # two tell a gain, and a third whether it holds
SPREAD = OF_NEXT_GEL[0]  # t: of the modulus of gels from one mould
LEAST_SPREAD = 0.05  # s: few touches that agree by chance tell no more than that
LEAST_GAIN, MOST_GAIN = 0.5, 2.0
LEAST_R2 = 0.3  # of the wrench's variance, on touches left out


def adapt(runs: list[FeatureRun], prior: WrenchMap) -> Fit:
    """The prior map with the gains (6,) of this unit; errors are of touches left out.

    Raises
    ------
    InputError
        Too few touches, none of the prior's axes loaded, or a unit that is not like those of the prior.
    """
    if any(run.features.shape[1] != prior.gain.shape[1] for run in runs):
        raise InputError(f"--prior: its wrench is of {prior.gain.shape[1]} features, the log has "
                         f"{runs[0].features.shape[1]}: give a calibration of the same board")  # fmt: skip
    frames = frames_of(runs, 0.0)
    touches = np.unique(frames.touch[frames.touch >= 0])
    if len(touches) < LEAST_TOUCHES or (frames.touch < 0).any():
        raise InputError(f"--prior: the log numbers {len(touches)} touches, and {LEAST_TOUCHES} are needed: press more "
                         "often")  # fmt: skip
    said = prior.predicted(frames)
    by_touch = np.array([_of_touch(said[of], frames.wrench[of], prior.full) for of in frames.touch == touches[:, None]])
    is_told = np.isfinite(by_touch).sum(axis=0) >= LEAST_TOUCHES
    if missing := [AXES[i] for i in np.flatnonzero((prior.full > 0) & ~is_told)]:
        raise InputError(
            f"--prior: fewer than {LEAST_TOUCHES} touches load {', '.join(missing)}, which this calibration measures: "
            "press along each of its axes, with a reference that measures them"
        )
    errors = np.zeros_like(said)
    for left_out, touch in enumerate(touches):
        left = frames.touch == touch
        gain = _gain(np.delete(by_touch, left_out, axis=0), is_told)
        errors[left] = (gain * said[left] - frames.wrench[left]) * is_told
    gain = _gain(by_touch, is_told)
    spread = np.maximum(frames.wrench.std(axis=0), 1e-12)
    r2 = np.where(is_told, 1 - (rms(errors) / spread) ** 2, 0.0)
    for i in np.flatnonzero(is_told):
        if not LEAST_GAIN <= gain[i] <= MOST_GAIN or r2[i] < LEAST_R2:
            raise InputError(
                f"--prior: {AXES[i]} of this unit is {gain[i]:.2f} times what the calibration says, which explains "
                f"{100 * r2[i]:.0f} % of it: this unit is not like those, or units or axes are mixed up, or this axis "
                "was loaded too little; load it more, or fit without --prior"
            )
    found = _widened(_times(prior, gain), frames, errors, touches)
    return Fit(
        found, 0.0, {}, {}, rms(errors), r2, rms(gain * said - frames.wrench), float("nan"), len(frames.features),
        len(set(recordings_of(runs))), "touch", mean_abs(errors),
        checks=["forces are those of the units of --prior, times " + ", ".join(
            f"{gain[i]:.3f} ({AXES[i]})" for i in np.flatnonzero(is_told))],
    )  # fmt: skip


def _of_touch(said: Array, wrench: Array, full: Array) -> Array:
    """The gain (6,) that one touch tells; NaN of an axis that it hardly loads."""
    is_loaded = (full > 0) & (np.abs(said).max(axis=0) > LOADED_PART * full) & (wrench != 0).any(axis=0)
    return np.where(is_loaded, (said * wrench).sum(axis=0) / np.maximum((said**2).sum(axis=0), 1e-12), np.nan)


def _gain(by_touch: Array, is_told: npt.NDArray[np.bool_]) -> Array:
    """The gain (6,) of touches' gains (n, 6); 0 of an axis that is not told."""
    out = np.zeros(6)
    for i in np.flatnonzero(is_told):
        told = by_touch[np.isfinite(by_touch[:, i]), i]
        precision = len(told) / max(float(told.var(ddof=1)), LEAST_SPREAD**2)
        out[i] = (told.mean() * precision + SPREAD**-2) / (precision + SPREAD**-2)
    return out


def _times(prior: WrenchMap, gain: Array) -> WrenchMap:
    """The map whose every axis is `gain` (6,) times as large; 0: not measured."""
    kernel, rest, warmth = prior.kernel, prior.rest, prior.warmth
    return replace(
        prior, gain=prior.gain * gain[:, None], full=prior.full * gain, square=prior.square * gain[:, None],
        error=prior.error * gain, relax=prior.relax * (gain > 0),
        kernel=kernel and replace(kernel, weight=kernel.weight * gain[:, None], offset=kernel.offset * gain),
        rest=rest and replace(rest, error=rest.error * gain),
        warmth=warmth and replace(warmth, offset=warmth.offset * gain),
    )  # fmt: skip


def _widened(found: WrenchMap, frames: Frames, errors: Array, touches: npt.NDArray[np.intp]) -> WrenchMap:
    """Its stated errors, larger where this unit's touches err by more: one sigma covers 68 % of the touches."""
    sigma = found.sigma(found.scaled(found.elastic(frames)))
    parts = np.abs(errors) / np.maximum(sigma, 1e-12)
    worst = np.array([parts[frames.touch == touch].mean(axis=0) for touch in touches])
    return replace(found, error=found.error * np.maximum(np.quantile(worst, ONE_SIGMA, axis=0), 1.0))
