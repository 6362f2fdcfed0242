"""Percentiles and misses of ages that are known."""

from __future__ import annotations

import pytest

from ruffini.device.latency import FrameAge, summarize
from ruffini.errors import NoDeviceError

MS = 1_000_000


def ages(took_ms: dict[int, float]) -> list[FrameAge]:
    return [FrameAge(n, n * 10 * MS, 20_000, round(n * 10 * MS + ms * MS)) for n, ms in took_ms.items()]


def test_percentiles_misses_and_late_frames() -> None:
    took = {n: 2.0 for n in range(100, 1100)}
    took |= {200: 30.0, 300: 11.0, 301: 9.0}
    for lost in (400, 401, 500):
        del took[lost]
    seen = summarize(ages(took), interval_ms=10.0)
    assert (seen.n_frames, seen.n_missing, seen.n_late) == (997, 3, 2)
    assert seen.p50_ms == 2.0
    assert seen.p99_ms == 2.0
    assert seen.p999_ms is None, "of 997 frames it would be the largest"
    assert seen.largest_ms == 30.0
    # Mean of squares about the mean of 994 x 2, 30, 11 and 9.
    mean = (994 * 2 + 50) / 997
    assert seen.jitter_ms == pytest.approx(((994 * 4 + 900 + 121 + 81) / 997 - mean**2) ** 0.5)
    assert seen.clock_error_ms == 0.02


def test_the_tail_is_said_of_a_thousand_frames() -> None:
    took = {n: 1.0 for n in range(2000)} | {n: 5.0 for n in range(4)}
    assert summarize(ages(took), 10.0).p999_ms == 5.0


def test_no_whole_frame_is_said() -> None:
    with pytest.raises(NoDeviceError, match="no frame arrived complete"):
        summarize([], 10.0)
