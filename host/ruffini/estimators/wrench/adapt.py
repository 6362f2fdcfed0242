"""A new unit's wrench from few presses: the map of other units of the same sensor, times this unit's stiffness.

Pads of one mould differ most in how stiff they are: every axis i of the prior map, a calibration that was fitted to
logs of other units, is multiplied by g_i = sum(p y) / sum(p^2), p its wrench and y the reference of the new unit at the
time of the frame.
Units here: N and N mm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.estimators.wrench.fit import ONE_SIGMA, Fit
from ruffini.estimators.wrench.log import FeatureRun
from ruffini.estimators.wrench.model import AXES, Frames, WrenchMap, frames_of, recordings_of
from ruffini.estimators.wrench.terms import mean_abs, rms

Array = npt.NDArray[np.float64]

LEAST_TOUCHES = 3  # two tell a gain, and a third whether it holds
LEAST_GAIN, MOST_GAIN = 0.5, 2.0  # pads of one mould differ by a tenth or two
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
    is_told = (prior.full > 0) & (np.abs(frames.wrench).max(axis=0) > 0) & (np.abs(said).max(axis=0) > 0)
    if not is_told.any():
        raise InputError("--prior: the log loads none of the axes that this calibration measures")
    errors = np.zeros_like(said)
    for touch in touches:
        left = frames.touch == touch
        gain = np.where(is_told, _gain(said[~left], frames.wrench[~left]), 1.0)
        errors[left] = (gain * said[left] - frames.wrench[left]) * is_told
    gain = np.where(is_told, _gain(said, frames.wrench), 0.0)
    spread = np.maximum(frames.wrench.std(axis=0), 1e-12)
    r2 = np.where(is_told, 1 - (rms(errors) / spread) ** 2, 0.0)
    for i in np.flatnonzero(is_told):
        if not LEAST_GAIN <= gain[i] <= MOST_GAIN or r2[i] < LEAST_R2:
            raise InputError(
                f"--prior: {AXES[i]} of this unit is {gain[i]:.2f} times what the calibration says, which explains "
                f"{100 * r2[i]:.0f} % of it: this unit is not like those, or units or axes are mixed up; fit without "
                "--prior"
            )
    found = _widened(_times(prior, gain), frames, errors, touches)
    return Fit(
        found, 0.0, {}, {}, rms(errors), r2, rms(gain * said - frames.wrench), float("nan"), len(frames.features),
        len(set(recordings_of(runs))), "touch", mean_abs(errors),
        checks=["forces are those of the units of --prior, times " + ", ".join(
            f"{gain[i]:.3f} ({AXES[i]})" for i in np.flatnonzero(is_told))],
    )  # fmt: skip


def _gain(said: Array, wrench: Array) -> Array:
    return np.asarray((said * wrench).sum(axis=0) / np.maximum((said**2).sum(axis=0), 1e-12))


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
    size2 = (found.scaled(found.elastic(frames)) ** 2).sum(axis=1)
    sigma = np.sqrt((found.error[0] ** 2).sum(axis=0) + size2[:, None] * (found.error[1] ** 2).sum(axis=0))
    parts = np.abs(errors) / np.maximum(sigma, 1e-12)
    worst = np.array([parts[frames.touch == touch].mean(axis=0) for touch in touches])
    return replace(found, error=found.error * np.maximum(np.quantile(worst, ONE_SIGMA, axis=0), 1.0))
