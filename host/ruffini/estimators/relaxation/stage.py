"""What the pad loses under a held strain, from touches that were held for seconds."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.fit.job import HELD_S, Job, Outcome, Progress
from ruffini.calibrate.gates import Gate, at_most, near
from ruffini.calibrate.log.touches import Series
from ruffini.errors import InputError
from ruffini.estimators.base import Estimator
from ruffini.estimators.relaxation.command import COMMAND, RelaxationOptions
from ruffini.estimators.relaxation.fit import (
    RelaxationFit,
    RelaxationLog,
    fit_relaxation,
    left_after,
    log_from_recording,
    lost_of,
)

Array = npt.NDArray[np.float64]

LEAST_HOLD_S = 2.0  # of one touch: shorter holds show the fast terms only, and put what is slow into E
LEAST_LOSS = 0.03  # part of the force: less is the reference's drift
LEAST_GAIN = 0.2  # by which it must explain more than mere factors do: part of the RMS error
ROUNDS = 3  # the touches' factors depend on what is fitted
LEAST_FACTOR = 0.1
STILL = 0.02  # of the largest force, from frame to frame

MAX_GAIN = 2.0  # of the force at once over that of the calibration


def held_s(series: Series) -> float:
    """How long a touch has more than half of its largest force, s."""
    pressed = series.time_s[_is_pressed(series)]
    return float(np.ptp(pressed)) if len(pressed) else 0.0


def _is_pressed(series: Series) -> npt.NDArray[np.bool_]:
    force = np.linalg.norm(series.reference[:, :3], axis=1)
    return np.asarray(force > force.max() / 2)


def _by_touch(series: list[Series]) -> tuple[RelaxationFit, list[Array]]:
    """The fit, and the wrenches of each touch with it.

    Each touch has a factor of its own: how far a sensor is off from place to place says nothing of time.
    """
    gone = [np.zeros_like(s.device) for s in series]
    for _ in range(ROUNDS):
        factors = [_factor(s, s.device - lost) for s, lost in zip(series, gone, strict=True)]
        log = RelaxationLog(
            np.concatenate([s.time_s for s in series]),
            np.concatenate([f * s.device for s, f in zip(series, factors, strict=True)]),
            np.concatenate([s.reference for s in series]),
        )
        fit = fit_relaxation(log)
        ends = np.cumsum([len(s.time_s) for s in series])[:-1]
        gone = [lost / f for lost, f in zip(np.split(lost_of(log, fit), ends), factors, strict=True)]
    said = [fit.gain * f * (s.device - lost) for s, f, lost in zip(series, factors, gone, strict=True)]
    return fit, said


def _factor(series: Series, said: Array) -> float:
    """Of a touch's force over what is said of it, while it is held."""
    held = _is_pressed(series)
    said, true = said[held, :3], series.reference[held, :3]
    return max(float((said * true).sum() / max(float((said**2).sum()), 1e-12)), LEAST_FACTOR)


def _rmse_still(series: list[Series], said: list[Array]) -> float:
    """Root mean square error of the force, N, in frames in which it does not change: moving ones err by the clocks."""
    errors = []
    for one, wrench in zip(series, said, strict=True):
        force = np.linalg.norm(one.device[:, :3], axis=1)
        still = _is_pressed(one) & (np.abs(np.gradient(force)) < STILL * force.max())
        errors.append((wrench - one.reference)[still, :3])
    return float(np.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1))))


def _without(job: Job, why: str) -> Outcome:
    kept = job.take("relaxation")
    if kept is None:
        return Outcome("open", why)
    job.instant_gain = 1 / left_after(job.tensors, HELD_S)
    return Outcome("kept", f"{why}; {kept.text}")


class Relaxation(Estimator):
    """What the second pass compensates."""

    name = COMMAND.name
    command = COMMAND
    makes_numbers = True  # the operator that they belong to is solved for them
    kinds = ("relaxation",)

    def applies(self, board: Board) -> bool:
        return "support" in board.pipeline.stages

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Fit where touches were held long enough and the device said forces all the while."""
        if job.previous is not None and "relaxation" in job.previous.kinds:
            return self.keep(job)  # what the device said is compensated already
        series = [s for s in job.log().series if np.isfinite(s.device).all() and np.isfinite(s.reference).all()]
        longest_s = max((held_s(s) for s in series), default=0.0)
        if longest_s < LEAST_HOLD_S:
            return _without(job, f"no touch is held for {LEAST_HOLD_S:g} s: hold some for longer (--hold-s)")
        order = sorted(series, key=lambda s: float(s.time_s[0]))
        try:
            fit, said = _by_touch(order)
        except InputError as error:
            return _without(job, str(error))
        progress(1.0)
        before_n, after_n = (_rmse_still(order, w) for w in ([_factor(s, s.device) * s.device for s in order], said))
        if not (fit.loss >= LEAST_LOSS and after_n <= (1 - LEAST_GAIN) * before_n):
            return _without(job, f"a loss of {100 * fit.loss:.1f} % of a held force explains too little to be believed")
        tensors, metadata = fit.tensors()
        job.tensors |= tensors
        job.metadata |= metadata
        job.instant_gain = 1 / left_after(job.tensors, HELD_S)
        return Outcome("fitted", f"{fit.text()}; touches that are held still err by "
                       f"{1e3 * before_n:.1f} -> {1e3 * after_n:.1f} mN RMS", fit.report())  # fmt: skip

    def fit_alone(self, job: Job, options: RelaxationOptions, progress: Progress) -> Outcome:
        """Fit to a recording that the previous calibration measures."""
        log = log_from_recording(job.board, job.seen_with(), job.path(), options.reference, progress=progress)
        fit = fit_relaxation(log)
        return Outcome("fitted", f"{fit.text()}; at once it is {fit.gain:.3f} times the calibration's; "
                       f"force RMSE {1e3 * fit.rmse_before_n:.1f} -> {1e3 * fit.rmse_after_n:.1f} mN",
                       fit.report())  # fmt: skip

    def keep(self, job: Job) -> Outcome:
        """The previous calibration's, or none."""
        kept = job.take("relaxation")
        if kept is None:
            return Outcome("board", "none")
        job.instant_gain = 1 / left_after(job.tensors, HELD_S)
        return kept

    def gates(self, report: dict[str, Any], board: Board | None) -> list[Gate]:
        if "rmse_after_n" not in report:
            return []
        left = report["rmse_after_n"] / max(report["rmse_before_n"], 1e-9)
        return [
            at_most("relaxation", left, 1.0, "times the force error without it"),
            near("relaxation gain", report["gain"], MAX_GAIN, "of the calibration's force"),
        ]


RELAXATION = Relaxation()
