"""Offset of a reference's clock from the stream's, at which both show the same touches.

The stream's forces need not be in newtons: a gain and an offset are fitted too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from ruffini.errors import InputError

Array = npt.NDArray[np.float64]

MAX_OFFSET_S = 0.5
COARSE_S, FINE_S = 0.005, 0.001
SMOOTH_S, SMOOTH_PERIODS = 0.02, 1.0  # standard deviation of the low pass, and of the longer sample period
ROBUST = 0.02  # of the peak to peak: what lies further off counts less
MIN_SAMPLES = 50
GAP_S, GAP_PERIODS = 0.3, 4.0  # without a sample, the longer of both
MIN_SIGNAL = 8.0  # peak to peak over the noise from sample to sample
MIN_CORRELATION = 0.9
CURVE_ROUNDS, CURVE_DEGREE = 2, 3
LOST_SHIFT = 0.98  # of MAX_OFFSET_S: the best shift lies outside


class ClockFit(NamedTuple):
    """reference time = stream time + offset_s + drift * (stream time - middle_s)."""

    offset_s: float
    offset_sigma_s: float
    drift: float  # seconds a second
    drift_sigma: float
    middle_s: float
    correlation: float

    def to_reference(self, stream_s: Array) -> Array:
        """Times of the stream on the reference's clock."""
        return np.asarray(stream_s + self.offset_s + self.drift * (stream_s - self.middle_s))


def fit_clock(
    stream_s: Array, stream_n: Array, reference_s: Array, reference_n: Array, *, max_offset_s: float = MAX_OFFSET_S
) -> ClockFit:
    """Shift and drift between two records of one force; a known rough shift is to be removed before.

    Parameters
    ----------
    stream_s, stream_n : (n,)
        Times and force of the sensor, any gain.
    reference_s, reference_n : (m,)
        Times and force of the reference, at any rate.

    Raises
    ------
    InputError
        A record is too short or shows no load, or the two do not correlate.
    """
    for name, t, f in (("stream", stream_s, stream_n), ("reference", reference_s, reference_n)):
        _check(name, t, f)
    period_s = max(float(np.median(np.diff(stream_s))), float(np.median(np.diff(reference_s))))
    smooth_s = max(SMOOTH_S, SMOOTH_PERIODS * period_s)
    stream, reference = _smoothed(stream_s, stream_n, smooth_s), _smoothed(reference_s, reference_n, smooth_s)
    longest_s = max(GAP_S, GAP_PERIODS * float(np.median(np.diff(stream_s))))
    coarse_s, correlation = _coarse(stream, reference, max_offset_s, stream_s, longest_s)
    if abs(correlation) < MIN_CORRELATION or abs(coarse_s) > LOST_SHIFT * max_offset_s:
        raise InputError(
            f"the reference does not show what the stream shows (correlation {abs(correlation):.2f} at best, "
            f"within +-{max_offset_s:g} s): is it the same recording, and was it this sensor?"
        )
    middle_s, half_s = float(stream_s.mean()), float(np.ptp(stream_s)) / 2
    grid = _overlap(stream, reference, margin_s=max_offset_s + smooth_s)
    grid = grid[_is_sampled(grid, stream_s, longest_s)]
    seen = stream.at(grid)

    def residual(p: Array) -> Array:
        # Shift and drift in steps of 5 ms, the drift as the shift at the ends, so that all unknowns are of one size.
        shifted = grid + coarse_s + COARSE_S * (p[0] + p[1] * (grid - middle_s) / half_s)
        return np.asarray(reference.at(shifted) - p[2] * seen - p[3])

    size = float(np.ptp(reference.force_n))
    gain = float(np.sign(correlation)) * size / float(np.ptp(stream.force_n))
    fit = least_squares(residual, [0.0, 0.0, gain, 0.0], loss="soft_l1", f_scale=ROBUST * size,
                        x_scale=[1, 1, abs(gain), size], diff_step=1e-3)  # fmt: skip
    sigma = _sigma(fit.jac, residual(fit.x))
    return ClockFit(
        coarse_s + COARSE_S * fit.x[0], COARSE_S * sigma[0],
        COARSE_S * fit.x[1] / half_s, COARSE_S * sigma[1] / half_s, middle_s, abs(correlation),
    )  # fmt: skip


def fit_curved(stream_s: Array, stream_signal: Array, reference_s: Array, reference_n: Array) -> ClockFit:
    """As `fit_clock`, for a signal that is a nonlinear function of the force, such as the motion of markers.

    A curve treated as a line would bias the shift if pressing is slow and releasing fast. The curve is therefore fitted
    at the shift found first, and then the shift again.
    """
    fit = fit_clock(stream_s, stream_signal, reference_s, reference_n)
    for _ in range(CURVE_ROUNDS):
        felt = np.interp(fit.to_reference(stream_s), reference_s, reference_n)
        scaled = stream_signal / np.ptp(stream_signal)
        straight: Array = np.polyval(np.polyfit(scaled, felt, CURVE_DEGREE), scaled).astype(np.float64)
        fit = fit_clock(stream_s, straight, reference_s, reference_n)
    return fit


class _Smoothed(NamedTuple):
    """A force resampled on a fine uniform grid."""

    time_s: Array
    force_n: Array

    def at(self, when_s: Array) -> Array:
        """Linear interpolation."""
        return np.interp(when_s, self.time_s, self.force_n)


def _smoothed(time_s: Array, force_n: Array, width_s: float) -> _Smoothed:
    """The same low pass for both records: samples interpolated midway have less noise, which biases the shift."""
    grid = np.arange(time_s[0], time_s[-1], FINE_S)
    return _Smoothed(grid, gaussian_filter1d(np.interp(grid, time_s, force_n), width_s / FINE_S, mode="nearest"))


def _check(name: str, time_s: Array, force_n: Array) -> None:
    if len(time_s) != len(force_n) or len(time_s) < MIN_SAMPLES:
        raise InputError(f"the {name} has {len(time_s)} samples: {MIN_SAMPLES} at least are needed to find its clock")
    if (np.diff(time_s) <= 0).any():
        raise InputError(f"the time of the {name} stands still or goes back: its stamps cannot be used")
    noise = float(np.median(abs(np.diff(force_n, 2)))) / 1.65  # of white noise: 0.674 * sqrt(6)
    if np.ptp(force_n) <= MIN_SIGNAL * noise or np.ptp(force_n) == 0:
        raise InputError(f"nothing happens in the {name}: press and let go a few times while both record")


def _overlap(stream: _Smoothed, reference: _Smoothed, margin_s: float) -> Array:
    """Times, every 5 ms, that both have whatever the shift."""
    start = max(stream.time_s[0], reference.time_s[0]) + margin_s
    end = min(stream.time_s[-1], reference.time_s[-1]) - margin_s
    if end - start < MIN_SAMPLES * COARSE_S:
        raise InputError("stream and reference overlap for less than a moment: record both at once, and longer")
    return np.arange(start, end, COARSE_S)


def _is_sampled(grid: Array, time_s: Array, longest_s: float) -> npt.NDArray[np.bool_]:
    """Which times do not lie in a gap: what was not seen is not compared."""
    after = np.clip(np.searchsorted(time_s, grid), 1, len(time_s) - 1)
    return np.asarray(time_s[after] - time_s[after - 1] <= longest_s)


def _coarse(
    stream: _Smoothed, reference: _Smoothed, max_offset_s: float, stream_s: Array, longest_s: float
) -> tuple[float, float]:
    """Best shift on a grid of 5 ms, and the correlation there, with its sign."""
    grid = _overlap(stream, reference, max_offset_s)
    grid = grid[_is_sampled(grid, stream_s, longest_s)]
    seen = stream.at(grid)
    n = round(max_offset_s / COARSE_S)
    shifts = COARSE_S * np.arange(-n, n + 1)
    values = np.array([_correlation(seen, reference.at(grid + shift)) for shift in shifts])
    best = int(abs(values).argmax())
    return float(shifts[best]), float(values[best])


def _correlation(a: Array, b: Array) -> float:
    return float(np.corrcoef(a, b)[0, 1]) if np.ptp(a) > 0 and np.ptp(b) > 0 else 0.0


def _sigma(jacobian: Array, residual: Array) -> Array:
    """Standard deviations, from residuals that hang together over time: as many are independent as cross zero."""
    n_independent = max(8, int((np.diff(np.sign(residual)) != 0).sum()))
    variance = float((residual**2).mean()) * len(residual) / n_independent
    return np.asarray(np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)) * variance))
