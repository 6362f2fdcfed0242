"""The offset between two clocks is found within 2 ms, its own uncertainty holds, and bad records are refused."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.errors import InputError
from ruffini.rig.clock import fit_clock, fit_curved


def presses(time_s: np.ndarray, period_s: float = 2.5) -> np.ndarray:
    """Fz of touches: down in 0.4 s, held, up; each another size."""
    phase, n = time_s % period_s, np.floor(time_s / period_s)
    ramp = np.clip(np.minimum(phase - 0.3, 1.9 - phase) / 0.4, 0, 1)
    return -(1 + 0.5 * np.sin(7 * n)) * ramp


def record(seed: int, offset_s: float, drift: float, *, rate_hz: float = 100, reference_hz: float = 100,
           gain: float = 0.6, noise_n: float = 0.01, span_s: float = 30.0):  # fmt: skip
    """One force as two clocks saw it: `reference = stream + offset + drift * (stream - middle)`."""
    rng = np.random.default_rng(seed)
    stream_s = np.arange(0, span_s, 1 / rate_hz) + rng.uniform(0, 0.2 / rate_hz, round(span_s * rate_hz))
    true_s = np.arange(-1, span_s + 1, 1 / reference_hz)
    reference_s = true_s + offset_s + drift * (true_s - stream_s.mean())
    stream_n = gain * presses(stream_s) + 0.05 + gain * noise_n * rng.normal(size=len(stream_s))
    reference_n = presses(true_s) + noise_n * rng.normal(size=len(true_s))
    return stream_s, stream_n, reference_s, reference_n


@pytest.mark.parametrize("offset_s", [0.0, 0.0123, -0.087, 0.31])
@pytest.mark.parametrize("reference_hz", [80.0, 500.0])
def test_offset_within_two_milliseconds(offset_s, reference_hz):
    errors = [
        abs(fit_clock(*record(seed, offset_s, 0.0, reference_hz=reference_hz)).offset_s - offset_s)
        for seed in range(5)
    ]  # fmt: skip
    assert max(errors) < 2e-3


def test_slow_reference_of_ten_hertz():
    errors = [abs(fit_clock(*record(s, 0.05, 0, reference_hz=10, span_s=60)).offset_s - 0.05) for s in range(5)]
    assert max(errors) < 2e-3


def test_drifting_clocks_are_followed():
    fit = fit_clock(*record(3, 0.02, 500e-6, span_s=120))
    assert fit.drift == pytest.approx(500e-6, abs=30e-6)
    assert fit.offset_s == pytest.approx(0.02, abs=1e-3)
    assert fit.to_reference(np.array([0.0]))[0] == pytest.approx(0.02 - 500e-6 * fit.middle_s, abs=2e-3)


def test_stated_uncertainty_holds():
    fits = [fit_clock(*record(seed, 0.04, 1e-4, noise_n=0.05)) for seed in range(30)]
    pull = np.array([(f.offset_s - 0.04) / f.offset_sigma_s for f in fits])
    assert 0.3 < np.sqrt((pull**2).mean()) < 2.0


def test_sign_and_gain_of_the_stream_do_not_matter():
    t, f, rt, rf = record(1, 0.02, 0)
    assert fit_clock(t, -1e3 * f, rt, rf).offset_s == pytest.approx(fit_clock(t, f, rt, rf).offset_s, abs=1e-6)


def test_records_that_cannot_be_matched_are_refused():
    t, f, rt, rf = record(1, 0.02, 0)
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="nothing happens in the reference"):
        fit_clock(t, f, rt, rng.normal(size=len(rt)))
    with pytest.raises(InputError, match="does not show what the stream shows"):
        fit_clock(t, f, rt, presses(rt, 1.37))
    with pytest.raises(InputError, match="does not show what the stream shows"):
        fit_clock(t, f, rt + 3, rf)
    with pytest.raises(InputError, match="stands still or goes back"):
        fit_clock(t[::-1], f, rt, rf)
    with pytest.raises(InputError, match="20 samples"):
        fit_clock(t[:20], f[:20], rt, rf)
    with pytest.raises(InputError, match="overlap"):
        fit_clock(t, f, rt + 100, rf)


def test_a_signal_that_follows_the_force_along_a_curve():
    """Slow presses, fast releases: a line through the curve would be off by more."""
    errors, straight = [], []
    for seed in range(5):
        t, _, rt, _ = record(seed, 0.02, 0)
        slow = np.where((t % 2.5) < 1.5, np.clip((t % 2.5 - 0.3) / 1.2, 0, 1), np.clip((1.9 - t % 2.5) / 0.1, 0, 1))
        truth = (1 + 0.5 * np.sin(7 * np.floor(t / 2.5))) * slow
        way = truth ** (2 / 3) + 0.01 * np.random.default_rng(seed).normal(size=len(t))
        felt = np.interp(rt - 0.02, t, truth)
        errors.append(abs(fit_curved(t, way, rt, felt).offset_s - 0.02))
        straight.append(abs(fit_clock(t, way, rt, felt).offset_s - 0.02))
    assert max(errors) < 2e-3
    assert max(errors) < min(straight)


def test_what_was_not_seen_is_not_compared():
    t, f, rt, rf = record(2, 0.05, 0)
    seen = (t < 8.2) | (t > 13.1)  # two presses are missing
    fit = fit_clock(t[seen], f[seen], rt, rf)
    assert fit.offset_s == pytest.approx(0.05, abs=2e-3)
    assert fit.correlation > 0.99
