"""How far a reference's clock is from the stream's, touch by touch, where the stream's signals are not a force.

In each touch the reference's strongest axis is explained by the stream's signals at every shift (least squares; their
gains may differ from place to place). Rubber forgets, so that its motion lags a load, and a wrench made of that motion
lags, too: the signals' memory of MEMORY_S is let in, where frames are close enough to tell it from a shift. The shift
that explains most is the touch's; the median over touches is the log's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.rig.clock import MAX_OFFSET_S, ClockFit

Array = npt.NDArray[np.float64]

PERIODS = 2.0  # of the stream's frames: a slow camera may be later than MAX_OFFSET_S
STEP_S, NEAR_S = 0.0025, 0.1  # of the shifts that are tried; of a touch's shift about that of all
MAX_SIGMA_S = 0.02  # a frame's time of arrival is known as well
ENDS = 0.25  # of the largest shift: so near to the reference's first and last readings nothing is compared
MEMORY_S = 0.3
RIDGE = 1e-7  # of the signals' largest square
MIN_TOUCHES, MIN_FRAMES = 3, 20
MIN_EXPLAINED = 0.9  # of the reference's variance, in a touch that counts
WEAK = 0.1  # of the log's largest force: a touch below it is told by its moments
MAD_TO_SIGMA, OF_MEDIAN = 1.4826, 1.2533  # of normal errors: standard deviation, and that of a median
MIN_FOR_DRIFT = 6  # touches


class Pressed(NamedTuple):
    """One touch: host times and signals (t, k) of the stream, times and wrench (m, 6) of the reference (NaN: none)."""

    stream_s: Array
    signals: Array
    reference_s: Array
    wrench: Array


def fit_touches(touches: list[Pressed]) -> ClockFit:
    """Shift and drift over touches, after whatever rough shift is known was taken off.

    Raises
    ------
    InputError
        Too few touches in which the signals explain the reference, or they disagree.
    """
    largest_n = max((float(np.nanmax(np.abs(t.wrench[:, :3]), initial=0.0)) for t in touches), default=0.0)
    period_s = max((float(np.median(np.diff(t.stream_s))) for t in touches if len(t.stream_s) > 1), default=0.0)
    reach_s = max(MAX_OFFSET_S, PERIODS * period_s)
    shifts = np.arange(-reach_s, reach_s + STEP_S / 2, STEP_S)
    each = [(float(t.stream_s.mean()), _unexplained(t, shifts, largest_n)) for t in touches]
    rows = [(when_s, row) for when_s, row in each if row is not None]
    if len(rows) < MIN_TOUCHES:
        raise InputError(
            f"{len(rows)} touches show enough of the reference to find its clock: {MIN_TOUCHES} are needed"
        )
    middle_s, left = (np.array(column) for column in zip(*rows, strict=True))
    best = int(np.median(left, axis=0).argmin())
    counts = left[:, best] < 1 - MIN_EXPLAINED
    if counts.sum() < MIN_TOUCHES or best in (0, len(shifts) - 1):
        raise InputError(
            f"the reference does not show what the stream shows ({counts.sum()} of {len(left)} touches, within "
            f"+-{reach_s:.1f} s): is it the same recording, and was it this sensor?"
        )
    shift = np.array([_lowest(row, shifts, best) for row in left[counts]])
    fit = _line(middle_s[counts], shift, float(np.sqrt(1 - np.median(left[counts, best]))))
    if fit.offset_sigma_s > MAX_SIGMA_S:
        raise InputError(
            f"the clocks are told to +-{1e3 * fit.offset_sigma_s:.0f} ms only (a frame each {1e3 * period_s:.0f} ms): "
            "times of arrival are used instead; collect more touches, with a faster camera"
        )
    return fit


def _unexplained(touch: Pressed, shifts: Array, largest_n: float) -> Array | None:
    """Part of the reference's variance that is left at each shift; None where the touch is too short."""
    time_s = touch.stream_s
    margin_s = ENDS * float(shifts[-1])
    inner = (time_s > touch.reference_s[0] + margin_s) & (time_s < touch.reference_s[-1] - margin_s)
    axis = _axis(touch.wrench, largest_n)
    if inner.sum() < MIN_FRAMES or axis is None:
        return None
    signals = touch.signals / max(float(np.abs(touch.signals).max()), 1e-12)
    is_fast = float(np.median(np.diff(time_s))) <= MEMORY_S / 3
    memory = [_memory(signals, time_s)] if is_fast else []
    columns = np.column_stack([signals, *memory, np.ones(len(time_s))])[inner]
    normal = columns.T @ columns + RIDGE * len(columns) * np.eye(columns.shape[1])
    project = columns @ np.linalg.solve(normal, columns.T)
    felt = np.stack([np.interp(time_s[inner] + s, touch.reference_s, touch.wrench[:, axis]) for s in shifts], axis=1)
    error = ((felt - project @ felt) ** 2).sum(axis=0)
    return np.asarray(error / np.maximum(((felt - felt.mean(axis=0)) ** 2).sum(axis=0), 1e-15))


def _axis(wrench: Array, largest_n: float) -> int | None:
    """The strongest force, or moment where there is hardly a force."""
    peak = np.abs(np.nan_to_num(wrench)).max(axis=0)
    if peak[:3].max() >= WEAK * largest_n > 0:
        return int(peak[:3].argmax())
    return 3 + int(peak[3:].argmax()) if peak[3:].max() > 0 else None


def _memory(signals: Array, time_s: Array) -> Array:
    """h of each signal: MEMORY_S dh/dt = signal - h, from where it began."""
    out = np.empty_like(signals)
    h = out[0] = signals[0]
    for k in range(1, len(signals)):
        step = 1 - np.exp(-(time_s[k] - time_s[k - 1]) / MEMORY_S)
        h = out[k] = h + step * ((signals[k] + signals[k - 1]) / 2 - h)
    return out


def _lowest(left: Array, shifts: Array, near: int) -> float:
    """Of a touch, near the shift of all: the parabola through the lowest point and its neighbours."""
    reach = round(NEAR_S / STEP_S)
    low, high = max(near - reach, 1), min(near + reach, len(shifts) - 1)
    i = low + int(left[low:high].argmin())
    before, at, after = left[i - 1 : i + 2]
    bend = before - 2 * at + after
    return float(shifts[i] + (0.5 * STEP_S * (before - after) / bend if bend > 0 else 0.0))


def _line(when_s: Array, shift_s: Array, correlation: float) -> ClockFit:
    """Median and, over enough touches, the median slope."""
    middle_s, drift, drift_sigma = float(when_s.mean()), 0.0, 0.0
    if len(when_s) >= MIN_FOR_DRIFT:
        i, j = np.triu_indices(len(when_s), 1)
        slopes = (shift_s[j] - shift_s[i]) / (when_s[j] - when_s[i])
        drift = float(np.median(slopes))
    left = shift_s - drift * (when_s - middle_s)
    offset_s = float(np.median(left))
    sigma = MAD_TO_SIGMA * float(np.median(np.abs(left - offset_s)))
    spread_s = float(np.sqrt(((when_s - middle_s) ** 2).sum()))
    drift_sigma = OF_MEDIAN * sigma / spread_s if spread_s > 0 else 0.0
    return ClockFit(offset_s, OF_MEDIAN * sigma / np.sqrt(len(left)), drift, drift_sigma, middle_s, correlation)
