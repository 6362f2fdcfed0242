"""Fits the decision whether a picture's features are those of an untouched gel, for which the wrench is zero.

A map that is fitted to loads turns the light's drift into a force. Untouched frames show how features vary while
nothing presses: a frame whose Mahalanobis distance from zero is no larger than theirs shows no touch.
firmware/stages/feature_wrench/rest_gate.h has the equation. Units here: N and N mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.calibrate.container import Tensors
from ruffini.errors import InputError

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Of the 99th percentile of an axis, which glitches of the reference do not move: nothing presses.
UNLOADED, PERCENTILE = 2.5e-3, 99
LEAST_FRAMES = 100  # of those, to tell how features vary
MAX_FEATURES = 384  # RestGate::kMaxDirections
RIDGE = 0.1  # of the features' mean variance, added to each: fewer frames than features tell too small a variance
SHARE = 0.99  # of the untouched frames that a gate is fitted to: those count as untouched
# Of the loads on frames that count as untouched, which have long tails: their 90th percentile as of a normal
# distribution. Frames without a load do not count: how many there are is the log's choice.
HIDDEN, HIDDEN_SIGMAS = 0.9, 1.6449
PLACE, MICRO = float(1 << 20), 1e6
MAX_ENTRY, MAX_SUM, MAX_SHIFT = 1 << 26, 1 << 36, 40


@dataclass(frozen=True)
class RestGate:
    """project (d, n), of which an untouched frame makes no more than 1; error (6,) on such frames, one sigma."""

    project: Array
    error: Array

    def is_untouched(self, features: Array) -> Mask:
        """Of each frame (t,)."""
        return _inside(self.project, features)


class Found(NamedTuple):
    """A gate, and the frames (t,) that one fitted without them counts as untouched."""

    gate: RestGate
    is_untouched: Mask


def is_unloaded(wrench: Array) -> Mask:
    """Frames (t,) on which the reference reads nothing."""
    return np.asarray((np.abs(wrench) <= _least_load(wrench)).all(axis=1))


def _least_load(wrench: Array) -> Array:
    """Of each axis (6,)."""
    return np.asarray(UNLOADED * np.percentile(np.abs(wrench), PERCENTILE, axis=0))


def rest_gate(features: Array, wrench: Array, folds: list[Mask]) -> Found | None:
    """By the untouched frames of a log; None if they are too few or all alike. folds : frames that each leaves out."""
    unloaded = is_unloaded(wrench)
    if features.shape[1] > MAX_FEATURES or any((unloaded & ~left).sum() < LEAST_FRAMES for left in folds):
        return None
    if any(not features[unloaded & ~left].any() for left in folds):
        return None  # without any noise nothing tells how the features vary
    is_untouched = np.zeros(len(features), np.bool_)
    for left in folds:
        is_untouched[left] = _inside(_projection(features[unloaded & ~left]), features[left])
    if not is_untouched.any():
        return None
    # No less than a load that is too small to count, any of which is as likely.
    error = _least_load(wrench) / np.sqrt(3)
    hidden = np.abs(wrench[is_untouched & ~unloaded])
    if len(hidden):
        error = np.maximum(error, np.quantile(hidden, HIDDEN, axis=0) / HIDDEN_SIGMAS)
    return Found(RestGate(_projection(features[unloaded]), error), is_untouched)


def _projection(untouched: Array) -> Array:
    """Directions (n, n) whose squares sum to no more than 1 on a share of `SHARE` of the untouched features (t, n)."""
    second = untouched.T @ untouched / len(untouched)
    values, axes = np.linalg.eigh(second + RIDGE * np.trace(second) / len(second) * np.eye(len(second)))
    whitening = (axes / np.sqrt(values)).T
    return np.asarray(whitening / np.quantile(np.linalg.norm(untouched @ whitening.T, axis=1), SHARE))


def _inside(project: Array, features: Array) -> Mask:
    return np.asarray(((features @ project.T) ** 2).sum(axis=1) <= 1)


def tables(gate: RestGate) -> Tensors:
    """Tensors wrench.rest_*.

    Raises
    ------
    InputError
        A number does not fit them.
    """
    rows = np.abs(gate.project) * PLACE
    largest = max(float(rows.max()), float(rows.sum(axis=1).max()) * MAX_ENTRY / MAX_SUM, 1e-30)
    shift = min(int(np.floor(np.log2(MAX_ENTRY / largest) - 1e-9)), MAX_SHIFT)
    if shift < 1:
        raise InputError("the features of untouched frames are all but constant: is this a log of the sensor at rest?")
    return {
        "wrench.rest_project": np.round(gate.project * PLACE * 2.0**shift).astype(np.int32),
        "wrench.rest_shift": np.array([shift], np.uint8),
        "wrench.rest_error": np.round(gate.error * MICRO).astype(np.int32),
    }


def gate_in(t: dict[str, Array]) -> RestGate | None:
    """The gate of tables without the prefix `wrench.`, in float."""
    if "rest_project" not in t:
        return None
    return RestGate(t["rest_project"] / (PLACE * 2.0 ** t["rest_shift"][0]), t["rest_error"] / MICRO)
