"""Simulated time: a period for each frame, real time where none is made, and no frame before the last was read."""

from __future__ import annotations

import threading
import time

import pytest

from ruffini import host_clock
from ruffini.rig.frame_clock import FIRST_S, FrameClock

PERIOD_S, PATIENCE_S, GRACE_S = 0.05, 0.3, 0.6


def a_clock() -> FrameClock:
    return FrameClock(PERIOD_S, patience_s=PATIENCE_S, grace_s=GRACE_S)


def frames(clock: FrameClock, n: int) -> list[int]:
    """Makes n frames; each is read at once."""
    numbers = []
    for _ in range(n):
        numbers.append(clock.next_frame())
        clock.has_seen(numbers[-1])
    return numbers


def test_each_frame_takes_a_period_however_fast_it_was_made():
    clock, start = a_clock(), time.monotonic()
    assert frames(clock, 200) == list(range(1, 201))
    assert clock.now() == pytest.approx(200 * PERIOD_S)
    assert time.monotonic() - start < 200 * PERIOD_S / 4


def test_of_a_slow_body_only_some_of_the_cameras_frames_are_made():
    clock = FrameClock(PERIOD_S, step=6, patience_s=PATIENCE_S, grace_s=GRACE_S)
    assert frames(clock, 50) == list(range(6, 306, 6))
    assert clock.now() == pytest.approx(300 * PERIOD_S)


def test_who_sleeps_wakes_with_the_frame_that_ends_it():
    clock, woken = a_clock(), list[float]()

    def sleep() -> None:
        clock.sleep(10 * PERIOD_S)
        woken.append(clock.now())

    sleeper = threading.Thread(target=sleep)
    sleeper.start()
    while sleeper.is_alive():
        frames(clock, 1)
        time.sleep(1e-3)
    assert woken[0] >= 10 * PERIOD_S


def test_without_frames_time_goes_on_as_real_time_does_and_numbers_are_left_out():
    clock = a_clock()
    frames(clock, 4)
    start = time.monotonic()
    clock.sleep(6 * PERIOD_S)
    took_s = time.monotonic() - start
    assert took_s >= GRACE_S + 6 * PERIOD_S - 1e-3
    before_s = clock.now()
    (number,) = frames(clock, 1)
    assert number > 4 + 6
    assert clock.now() >= before_s


def took_s(clock: FrameClock) -> float:
    """Until the next frame is wanted."""
    start = time.monotonic()
    clock.next_frame()
    return time.monotonic() - start


def test_a_frame_waits_until_the_one_before_was_read_but_not_for_ever():
    clock = a_clock()
    clock.next_frame()
    assert FIRST_S <= took_s(clock) < PATIENCE_S  # nobody has read yet
    clock.has_seen(1)
    assert took_s(clock) >= PATIENCE_S
    threading.Timer(PATIENCE_S / 4, clock.has_seen, [3]).start()
    assert PATIENCE_S / 5 < took_s(clock) < PATIENCE_S


def test_a_frame_waits_until_the_reference_was_read():
    clock = a_clock()
    clock.has_seen(clock.next_frame())
    clock.has_spoken()
    assert took_s(clock) >= PATIENCE_S
    clock.has_seen(2)
    clock.has_spoken()
    clock.has_heard(clock.now())
    assert took_s(clock) < PATIENCE_S


def test_a_clock_is_lent_to_every_thread_and_taken_back():
    clock, told = a_clock(), list[float]()
    with host_clock.lent(clock):
        frames(clock, 3)
        thread = threading.Thread(target=lambda: told.append(host_clock.now()))
        thread.start()
        thread.join()
        host_clock.has_seen(7)
        start = time.monotonic()
        clock.next_frame()
        assert time.monotonic() - start < PATIENCE_S
    assert told == [pytest.approx(3 * PERIOD_S)]
    assert host_clock.now() == pytest.approx(time.monotonic(), abs=0.5)


def test_no_frame_waits_when_it_is_over():
    clock = a_clock()
    clock.has_seen(clock.next_frame())
    clock.has_spoken()
    clock.stop()
    assert took_s(clock) < PATIENCE_S
