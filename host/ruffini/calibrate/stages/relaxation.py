"""What the pad loses under a held strain, from touches that were held for seconds."""

from __future__ import annotations

import numpy as np

from ruffini.calibrate.relaxation import RelaxationFit, RelaxationLog, fit_relaxation
from ruffini.calibrate.stages.job import HELD_S, Job, Outcome, Progress, Stage, left_after
from ruffini.calibrate.touch_log import Series
from ruffini.errors import InputError

LEAST_HOLD_S = 2.0  # of one touch: shorter holds show the fast terms only, and put what is slow into E
LEAST_LOSS = 0.03  # part of the force: less is the reference's drift
LEAST_GAIN = 0.2  # by which it must explain more than a mere factor does: part of the RMS error


def run(job: Job, progress: Progress) -> Outcome:
    """Fit where touches were held long enough and the device said forces all the while."""
    if job.previous is not None and "relaxation" in job.previous.kinds:
        return keep(job)  # what the device said is compensated already
    series = [s for s in job.log().series if np.isfinite(s.device).all() and np.isfinite(s.reference).all()]
    longest_s = max((held_s(s) for s in series), default=0.0)
    if longest_s < LEAST_HOLD_S:
        return _without(job, f"no touch is held for {LEAST_HOLD_S:g} s: hold some for longer (--hold-s)")
    order = sorted(series, key=lambda s: float(s.time_s[0]))
    log = RelaxationLog(*(np.concatenate([getattr(s, n) for s in order]) for n in ("time_s", "device", "reference")))
    try:
        fit = fit_relaxation(log)
    except InputError as error:
        return _without(job, str(error))
    progress(1.0)
    if fit.loss < LEAST_LOSS or fit.rmse_after_n > (1 - LEAST_GAIN) * _rmse_of_factor(log):
        return _without(job, f"a loss of {100 * fit.loss:.1f} % of a held force explains too little to be believed")
    _use(job, fit)
    terms = ", ".join(f"{100 * g:.1f} % in {tau:g} s" for g, tau in fit.terms)
    return Outcome("fitted", f"of the force at once goes {terms}; RMS {1e3 * fit.rmse_before_n:.1f} -> "
                   f"{1e3 * fit.rmse_after_n:.1f} mN", fit.report())  # fmt: skip


def held_s(series: Series) -> float:
    """How long a touch has more than half of its largest force, s."""
    force = np.linalg.norm(series.reference[:, :3], axis=1)
    pressed = series.time_s[force > force.max() / 2]
    return float(np.ptp(pressed)) if len(pressed) else 0.0


def _rmse_of_factor(log: RelaxationLog) -> float:
    """Root mean square error of the force, N, with the best constant factor."""
    said, true = log.elastic[:, :3], log.reference[:, :3]
    factor = (said * true).sum() / (said**2).sum()
    return float(np.sqrt(np.mean(np.sum((factor * said - true) ** 2, axis=1))))


def _use(job: Job, fit: RelaxationFit) -> None:
    tensors, metadata = fit.tensors()
    log = job.log()
    # The device's E is not the fitted one: what the hold's end says of the one takes the gain to the other.
    seen = np.isfinite(log.device).all(axis=1) & np.isfinite(log.wrench).all(axis=1)
    device, reference = log.device[seen, :3], log.wrench[seen, :3]
    job.instant_gain = fit.gain * float((device**2).sum() / (device * reference).sum())
    job.tensors |= tensors
    job.metadata |= metadata


def _without(job: Job, why: str) -> Outcome:
    kept = job.take("relaxation")
    if kept is None:
        return Outcome("open", why)
    job.instant_gain = 1 / left_after(job.tensors, HELD_S)
    return Outcome("kept", f"{why}; {kept.text}")


def keep(job: Job) -> Outcome:
    """The previous calibration's, or none."""
    kept = job.take("relaxation")
    if kept is None:
        return Outcome("board", "none")
    job.instant_gain = 1 / left_after(job.tensors, HELD_S)
    return kept


def is_needed(job: Job) -> bool:
    """Whether the board has the second pass that compensates it."""
    return "support" in job.board.pipeline.stages


STAGE = Stage("relaxation", is_needed, run, keep)
