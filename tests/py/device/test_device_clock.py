"""The clock's bound against clocks and delays that are known."""

from __future__ import annotations

import random

import pytest

from ruffini.device.device_clock import MAX_DRIFT, DeviceClock

MS = 1_000_000


@pytest.mark.parametrize("drift", [0.0, 40e-6, -40e-6, 250e-6, -250e-6])
@pytest.mark.parametrize("lean", [0.0, 0.5, 1.0])
def test_the_truth_is_within_the_bound_whatever_way_takes_longer(drift: float, lean: float) -> None:
    """`lean`: part of the delay that is on the way there; true host time is offset + (1 + drift) sensor time."""
    chance, offset_ns = random.Random(7), 10**15
    clock, bounds, last_ns = DeviceClock(), [], -1

    def host_ns(device_ns: float) -> int:
        return offset_ns + round((1 + drift) * device_ns)

    for i in range(3_000):  # frames at 50 Hz for a minute, an exchange each second
        device_ns = 20 * MS * (i + 1)
        if i % 50 == 0:
            delay_ns = 0.2 * MS + chance.expovariate(1 / (2 * MS))
            there_ns, held_ns, back_ns = lean * delay_ns, 0.03 * MS, (1 - lean) * delay_ns
            received_us, sent_us = round(device_ns / 1000), round((device_ns + held_ns) / 1000)
            clock.add(host_ns(device_ns - there_ns), received_us, sent_us, host_ns(device_ns + held_ns + back_ns))
        found = clock.stamp(device_ns // 1000)
        assert found is not None
        assert abs(found.ns - host_ns(device_ns)) <= found.error_ns
        assert found.ns > last_ns
        last_ns = found.ns
        bounds.append(found.error_ns)
    late = sorted(bounds[1_500:])
    assert late[len(late) // 2] < 0.5 * MS, "the shortest exchanges count, and the drift is known"


def test_before_an_exchange_nothing_is_known_and_what_cannot_be_is_passed_over() -> None:
    clock = DeviceClock()
    assert clock.stamp(1000) is None
    clock.add(asked_ns=10 * MS, received_us=5, sent_us=5, answered_ns=9 * MS)
    clock.add(asked_ns=10 * MS, received_us=9, sent_us=5, answered_ns=11 * MS)
    clock.add(asked_ns=10 * MS, received_us=0, sent_us=50_000, answered_ns=11 * MS)
    assert clock.n_exchanges == 0
    clock.add(asked_ns=10 * MS, received_us=500, sent_us=600, answered_ns=12 * MS)
    found = clock.to_host(550)
    assert found is not None
    assert found.ns == 11 * MS
    assert 0.95 * MS < found.error_ns < 0.96 * MS


def test_between_exchanges_the_bound_grows_with_the_drift_that_may_be() -> None:
    clock = DeviceClock()
    clock.add(asked_ns=0, received_us=500, sent_us=500, answered_ns=1 * MS)
    near, far = clock.to_host(500), clock.to_host(10_000_500)
    assert near is not None
    assert far is not None
    assert far.error_ns - near.error_ns == pytest.approx(MAX_DRIFT * 10e9, abs=2)


def test_a_stamp_of_the_same_frame_is_the_same_and_a_better_exchange_sets_no_clock_back() -> None:
    clock = DeviceClock()
    clock.add(asked_ns=0, received_us=100, sent_us=100, answered_ns=20 * MS)  # taken for 10 ms, +- 10 ms
    first = clock.stamp(1_000)
    clock.add(asked_ns=0, received_us=1_500, sent_us=1_500, answered_ns=3 * MS)  # sensor and host are as one
    assert clock.stamp(1_000) == first
    second = clock.stamp(2_000)
    assert first is not None
    assert second is not None
    assert second.ns == first.ns + 1
    assert abs(second.ns - 2 * MS) <= second.error_ns
    late = clock.stamp(900)  # of an older frame that comes late: as it is
    assert late is not None
    assert late.ns == pytest.approx(0.9 * MS, abs=1_000)


def test_an_exchange_of_two_minutes_ago_is_forgotten() -> None:
    clock = DeviceClock()
    for device_us, n in ((0, 1), (119_000_000, 2), (121_000_000, 2), (400_000_000, 1)):
        at_ns = device_us * 1_000 + 10**12
        clock.add(asked_ns=at_ns, received_us=device_us, sent_us=device_us, answered_ns=at_ns + MS)
        assert clock.n_exchanges == n


def test_the_error_of_the_drift_is_that_of_both_exchanges() -> None:
    """3 ms and 1 ms there and back, 60 s apart: (1.5 ms + 0.5 ms) / 60 s, and what the drift may wander."""
    clock = DeviceClock()
    clock.add(asked_ns=0, received_us=1_500, sent_us=1_500, answered_ns=3 * MS)
    clock.add(asked_ns=60_000 * MS, received_us=60_000_500, sent_us=60_000_500, answered_ns=60_001 * MS)
    assert clock.drift_error == pytest.approx(2e-3 / 60 + 2e-6, rel=0.01)
