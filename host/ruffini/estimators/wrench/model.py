"""A wrench of features in float, and the frames of a log: firmware/stages/feature_wrench/feature_wrench.h.

Units here: N and N mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.estimators.viscoelastic import relaxation_states
from ruffini.estimators.wrench.kernel import KernelMap
from ruffini.estimators.wrench.log import FeatureRun
from ruffini.estimators.wrench.rest import RestGate
from ruffini.estimators.wrench.warmth import Degrees, WrenchWarmth

Array = npt.NDArray[np.float64]

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
TO_NMM = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])  # N and N m to N and N mm
PAIRS = np.triu_indices(6)
BARELY, LEVER_MM = 0.02, 5.0  # least range: this part of the largest force, of a moment at this lever
TIMES_S = (0.3, 3.0, 30.0)  # a third of a second to half a minute: rubber forgets over decades of time


@dataclass(frozen=True)
class Frames:
    """Frames of a log, in order.

    features (t, n), reference (t, 6) N and N mm, time, number of the run, temperature, numbers of the recording and
    of the touch; -1: the log does not number its touches.
    """

    features: Array
    wrench: Array
    time_s: Array
    run: npt.NDArray[np.intp]
    degrees: Degrees
    recording: npt.NDArray[np.intp]
    touch: npt.NDArray[np.intp]

    def take(self, which: npt.NDArray[np.bool_]) -> Frames:
        return Frames(
            self.features[which],
            self.wrench[which],
            self.time_s[which],
            self.run[which],
            self.degrees.take(which),
            self.recording[which],
            self.touch[which],
        )


def frames_of(runs: list[FeatureRun], lag_s: float) -> Frames:
    """The good frames of recordings."""
    good = [run.is_good for run in runs]
    seen = [
        run.degrees.take(g) if run.degrees else Degrees.unknown(int(g.sum())) for run, g in zip(runs, good, strict=True)
    ]
    degrees = Degrees(*(np.concatenate([getattr(each, name) for each in seen]) for name in ("now", "rest")))
    return Frames(
        np.concatenate([run.features[g] for run, g in zip(runs, good, strict=True)]),
        np.concatenate([run.at(lag_s)[g] for run, g in zip(runs, good, strict=True)]) * TO_NMM,
        np.concatenate([run.time_s[g] for run, g in zip(runs, good, strict=True)]),
        np.concatenate([np.full(int(g.sum()), i) for i, g in enumerate(good)]),
        degrees,
        np.concatenate([np.full(int(g.sum()), r) for r, g in zip(recordings_of(runs), good, strict=True)]),
        _touch_numbers(runs),
    )


def wrench_at(runs: list[FeatureRun], lags_s: Array) -> Array:
    """Reference of the good frames at each lag, (t, 6 lags): all axes at the first lag, then at the next."""
    parts = [run.at_each(lags_s)[run.is_good] * TO_NMM for run in runs]
    return np.concatenate([part.reshape(len(part), -1) for part in parts])


def recordings_of(runs: list[FeatureRun]) -> list[int]:
    """Number of each run's recording."""
    names = list(dict.fromkeys(run.recording or f"{i}" for i, run in enumerate(runs)))
    return [names.index(run.recording or f"{i}") for i, run in enumerate(runs)]


def _touch_numbers(runs: list[FeatureRun]) -> npt.NDArray[np.intp]:
    """One number for each touch of all logs, of the good frames; -1 for frames whose log does not number them."""
    out, n = [], 0
    for run in runs:
        if run.touch is None:
            out.append(np.full(int(run.is_good.sum()), -1))
            continue
        names, number = np.unique(run.touch, return_inverse=True)
        out.append((number + n)[run.is_good])
        n += len(names)
    return np.concatenate(out)


def ranges_of(largest: Array) -> Array:
    """Full scale (6,) of the axes, N and N mm, from the largest load of each in a log.

    What barely loads an axis is noise, crosstalk and the edge of the pad: as its range that would flag good presses.
    """
    least = BARELY * largest[:3].max() * np.array([1, 1, 1, LEVER_MM, LEVER_MM, LEVER_MM])
    return np.asarray(np.maximum(largest, least))


@dataclass(frozen=True)
class WrenchMap:
    """The tables in float.

    gain (6, n) N and N mm a raw unit; full (6,) what makes u = 1, 0 of an axis that is not measured; square (6, 21);
    relax (terms, 6) parts; forward (n, 27); tolerance (n,); error (2, 6, 6) vectors of the covariance; warmth: None
    where temperature is not corrected for; kernel: None where the map is linear and quadratic; rest: None where no
    frame counts as untouched.
    """

    gain: Array
    full: Array
    square: Array
    relax: Array
    forward: Array
    tolerance: Array
    error: Array
    warmth: WrenchWarmth | None = None
    kernel: KernelMap | None = None
    rest: RestGate | None = None

    def scaled(self, y: Array) -> Array:
        """u (t, 6) of the linear estimate."""
        return np.asarray(np.where(self.full > 0, y / np.where(self.full > 0, self.full, 1), 0).clip(-2, 2))

    def sigma(self, u: Array) -> Array:
        """Stated standard deviations (t, 6) of loads u (t, 6) near the features that the map was fitted to."""
        constant, growing = (self.error**2).sum(axis=1)
        return np.asarray(np.sqrt(constant + (u**2).sum(axis=1)[:, None] * growing))

    def predicted(self, frames: Frames) -> Array:
        """Wrench of frames in time order, (t, 6); each recording starts from rest."""
        elastic = self.corrected(self.elastic(frames), frames.degrees)
        said = elastic if not self.relax.any() else elastic - forgotten(memories(elastic, frames), self.relax)
        if self.rest is not None:
            said = np.where(self.rest.is_untouched(frames.features)[:, None], 0.0, said)
        return said

    def corrected(self, elastic: Array, degrees: Degrees) -> Array:
        """With temperature, without relaxation."""
        return elastic if self.warmth is None else self.warmth.corrected(elastic, degrees)

    def elastic(self, frames: Frames) -> Array:
        """As the features have it: without temperature and relaxation."""
        y = frames.features @ self.gain.T
        out = y + products(self.scaled(y)) @ self.square.T
        return np.asarray(out if self.kernel is None else out + self.kernel.added(frames.features))


def products(u: Array) -> Array:
    """u_j u_k, j <= k by rows, (t, 21)."""
    return np.asarray(u[:, PAIRS[0]] * u[:, PAIRS[1]])


def memories(elastic: Array, frames: Frames) -> Array:
    """h of each term (terms, t, k): tau dh/dt = elastic - h, from zero in every recording."""
    part = np.zeros((len(TIMES_S), len(elastic)))
    part[:, 1:] = 1 - np.exp(-np.diff(frames.time_s) / np.array(TIMES_S)[:, None])
    first = np.flatnonzero(np.diff(frames.run, prepend=-1))
    return relaxation_states(elastic, part, first, np.diff(first, append=len(elastic)))


def forgotten(h: Array, relax: Array) -> Array:
    """What relaxation takes from the elastic wrench of memories h, (t, 6)."""
    return np.asarray(np.einsum("ktj,kj->tj", h, relax))
