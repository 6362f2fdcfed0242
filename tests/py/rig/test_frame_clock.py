"""Simulated time: a period for each frame, real time where none is made, and no frame before the last was read."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest
from hang import guard, until

from ruffini import host_clock
from ruffini.rig.frame_clock import FIRST_S, POLL_S, FrameClock
from ruffini.wake_event import WakeEvent

PERIOD_S, PATIENCE_S, GRACE_S = 0.05, 0.3, 0.6


class StoppedEvent(WakeEvent):
    """Nobody rings it: who waits in vain has waited to the end, and so much of the real time is over."""

    def __init__(self) -> None:
        super().__init__()
        self.real_s = 100.0

    def wait_for(self, look: Callable, timeout_s: float | None = None):
        assert timeout_s is not None
        if not look():
            self.real_s += timeout_s
        return look()


def a_clock(*, step: int = 1) -> tuple[FrameClock, StoppedEvent]:
    event = StoppedEvent()
    clock = FrameClock(
        PERIOD_S, step=step, patience_s=PATIENCE_S, grace_s=GRACE_S, real=lambda: event.real_s, event=event
    )
    return clock, event


def rung_clock() -> FrameClock:
    """One for several threads, whose patience has no end and which knows no real time."""
    return FrameClock(PERIOD_S, patience_s=1e6, real=lambda: 0.0)


def frames(clock: FrameClock, n: int) -> list[int]:
    """Makes n frames; each is read at once."""
    numbers = []
    for _ in range(n):
        numbers.append(clock.next_frame())
        clock.has_drawn()
        clock.has_seen(numbers[-1])
    return numbers


def test_each_frame_takes_a_period_and_no_real_time():
    clock, event = a_clock()
    assert frames(clock, 200) == list(range(1, 201))
    assert clock.now() == pytest.approx(200 * PERIOD_S)
    assert event.real_s == 100.0


def test_of_a_slow_body_only_some_of_the_cameras_frames_are_made():
    clock, _ = a_clock(step=6)
    assert frames(clock, 50) == list(range(6, 306, 6))
    assert clock.now() == pytest.approx(300 * PERIOD_S)


def test_who_sleeps_wakes_with_the_frame_that_ends_it():
    clock, woken = rung_clock(), list[float]()

    def sleep() -> None:
        clock.sleep(10 * PERIOD_S)
        woken.append(clock.now())

    sleeper = threading.Thread(target=sleep)
    sleeper.start()
    until(lambda: frames(clock, 1) and not sleeper.is_alive(), "the sleeper")
    assert woken[0] >= 10 * PERIOD_S


def test_without_frames_time_goes_on_as_real_time_does_and_numbers_are_left_out():
    clock, event = a_clock()
    frames(clock, 4)
    event.real_s += GRACE_S
    assert clock.now() == pytest.approx(4 * PERIOD_S)
    start_s = event.real_s
    clock.sleep(6 * PERIOD_S)
    assert event.real_s - start_s == pytest.approx(6 * PERIOD_S, abs=POLL_S + 1e-9)
    before_s = clock.now()
    (number,) = frames(clock, 1)
    assert number > 4 + 6
    assert clock.now() >= before_s


@pytest.mark.parametrize("is_given_up", [False, True])
def test_while_a_frame_is_drawn_time_stands_still_unless_it_is_given_up(is_given_up):
    clock, event = a_clock()
    frames(clock, 4)
    clock.next_frame()
    event.real_s += 100 * GRACE_S
    assert clock.now() == pytest.approx(5 * PERIOD_S)
    if is_given_up:
        clock.without_frames()
    else:
        clock.has_drawn()
        event.real_s += GRACE_S
    event.real_s += PERIOD_S
    assert clock.now() == pytest.approx(6 * PERIOD_S)
    clock.has_drawn()
    assert clock.now() == pytest.approx(6 * PERIOD_S), "time never goes back"


def test_who_knows_that_no_frame_comes_lets_time_go_on_at_once_and_once():
    clock, event = a_clock()
    frames(clock, 4)
    clock.without_frames()
    event.real_s += 3 * PERIOD_S
    clock.without_frames()
    assert clock.now() == pytest.approx(7 * PERIOD_S)
    assert frames(clock, 1) == [8]
    event.real_s += GRACE_S
    assert clock.now() == pytest.approx(8 * PERIOD_S)


def test_a_frame_waits_until_the_one_before_was_read_but_not_for_ever():
    clock, event = a_clock()

    def took_s() -> float:
        """Real time until the next frame is wanted."""
        start_s = event.real_s
        clock.next_frame()
        return event.real_s - start_s

    took_s()
    assert took_s() == pytest.approx(FIRST_S)  # nobody has read yet
    clock.has_seen(1)
    assert took_s() == pytest.approx(PATIENCE_S)
    clock.has_seen(3)
    assert took_s() == 0
    clock.has_seen(4)
    clock.has_spoken()
    assert took_s() == pytest.approx(PATIENCE_S), "the reference was not read"
    clock.has_seen(5)
    clock.has_spoken()
    clock.has_heard(clock.now())
    assert took_s() == 0
    clock.has_spoken()
    clock.stop()
    assert took_s() == 0, "it is over"


@pytest.mark.parametrize("what", ["frame", "reference", "end"])
def test_who_waits_for_a_reader_is_woken_by_it(what):
    clock = rung_clock()
    clock.has_seen(clock.next_frame() if what == "frame" else 1)
    if what == "frame":
        clock.next_frame()
    else:
        clock.next_frame()
        clock.has_spoken()
    made = list[int]()
    maker = threading.Thread(target=lambda: made.append(clock.next_frame()))
    maker.start()
    assert maker.is_alive(), "it was not read yet"
    wake = {"frame": lambda: clock.has_seen(2), "reference": lambda: clock.has_heard(clock.now()), "end": clock.stop}
    wake[what]()
    with guard("the next frame"):
        maker.join()
    assert len(made) == 1


def test_a_clock_is_lent_to_every_thread_and_taken_back():
    (clock, event), told = a_clock(), list[float]()
    with host_clock.lent(clock):
        frames(clock, 3)
        thread = threading.Thread(target=lambda: told.append(host_clock.now()))
        thread.start()
        thread.join()
        host_clock.has_seen(7)
        clock.next_frame()
    assert event.real_s == 100.0
    assert told == [pytest.approx(3 * PERIOD_S)]
    before_s = time.monotonic()
    assert before_s <= host_clock.now() <= time.monotonic()
