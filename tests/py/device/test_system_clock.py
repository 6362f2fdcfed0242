"""Host times on the system clock."""

from __future__ import annotations

import time

import pytest

from ruffini.device.system_clock import SystemClock


def test_a_host_time_is_put_on_the_system_clock() -> None:
    clock = SystemClock()
    before_ns, asked_ns, after_ns = time.time_ns(), time.monotonic_ns(), time.time_ns()
    assert before_ns - 50_000_000 < clock.from_monotonic(asked_ns) < after_ns + 50_000_000
    assert clock.from_monotonic(asked_ns + 7) - clock.from_monotonic(asked_ns) == 7


def test_a_system_clock_that_was_set_is_followed_within_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monotonic_ns, ahead_ns = 0, 10**18

    def look() -> int:
        nonlocal monotonic_ns
        monotonic_ns += 100  # each look takes so long
        return monotonic_ns

    monkeypatch.setattr(time, "monotonic_ns", look)
    monkeypatch.setattr(time, "time_ns", lambda: monotonic_ns + 50 + ahead_ns)
    clock = SystemClock()
    assert clock.from_monotonic(5) == 10**18 + 5
    ahead_ns += 3_600 * 10**9
    assert clock.from_monotonic(5) == 10**18 + 5
    monotonic_ns += 10**9
    assert clock.from_monotonic(5) == 10**18 + 3_600 * 10**9 + 5
