"""Who waits is woken, and Ctrl-C at any moment leaves nobody else standing still."""

from __future__ import annotations

import dis
import gc
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from hang import HANG_S

from ruffini.api import SensorFrame
from ruffini.api.frames import Frames
from ruffini.rig.frame_clock import FrameClock
from ruffini.wake_event import WakeEvent

LIMIT_S = HANG_S
LOOKS = ("CALL", "JUMP_BACKWARD", "RESUME")


def interrupted_at(n: int, action: Callable[[], Any]) -> bool:
    """Run it with a KeyboardInterrupt where Python looks for signals the n-th time; False: it does so less often.

    That is behind a call, at a function's beginning and where a loop goes back, and nowhere else: taking a plain lock
    in a `with` cannot be interrupted half way. (A tracer raises an instruction later than Python: what a `with` calls
    last must not be what it returns.)
    """
    left, is_hit = n, False

    def trace(frame: Any, _event: str, _: Any) -> Any:
        frame.f_trace_opcodes, before = True, ""

        def step(frame: Any, event: str, _: Any) -> Any:
            nonlocal left, is_hit, before
            if event == "opcode" and not is_hit:
                looks, before = before.startswith(LOOKS), dis.opname[frame.f_code.co_code[frame.f_lasti]]
                left -= looks
                if left < 0:
                    is_hit = True
                    raise KeyboardInterrupt
            return step

        return step

    outside, collects = sys.gettrace(), gc.isenabled()
    gc.disable()  # an interrupt in a callback of the collector (hypothesis has one) would be lost
    sys.settrace(trace)
    try:
        action()
    except KeyboardInterrupt:
        assert is_hit
    finally:
        sys.settrace(outside)
        if collects:
            gc.enable()
    return is_hit


def is_done_elsewhere(action: Callable[[], Any]) -> bool:
    """Another thread gets it done."""
    thread = threading.Thread(target=action, daemon=True)
    thread.start()
    thread.join(LIMIT_S)
    return not thread.is_alive()


def a_frame(number: int) -> SensorFrame:
    return SensorFrame("0001", 0, number, 0.0, None, 50_000, 0, (), True, False, {})


def take_one(frames: Frames) -> None:
    frames.put(a_frame(1))
    next(frames)


ACTIONS: dict[str, Callable[[Frames], None]] = {
    "a frame is there": lambda frames: take_one(frames),
    "none comes in time": lambda frames: frames.get(1e-4) and None,
}


@pytest.mark.parametrize("case", ACTIONS)
def test_ctrl_c_at_any_moment_leaves_the_reading_thread_free(case: str) -> None:
    n = 0
    while True:
        frames = Frames(3, None)
        is_hit = interrupted_at(n, lambda f=frames: ACTIONS[case](f))  # type: ignore[misc]
        assert is_done_elsewhere(lambda f=frames: f.put(a_frame(9))), n  # type: ignore[misc]
        taken = frames.get(LIMIT_S)
        assert taken is not None
        assert taken.number in (1, 9)
        if not is_hit:
            break
        n += 1
    assert n > 10


def test_ctrl_c_while_a_bench_sleeps_leaves_its_camera_free() -> None:
    n = 0
    while True:
        clock = FrameClock(1e-6, grace_s=0.0)
        is_hit = interrupted_at(n, lambda c=clock: c.sleep(1e-5))  # type: ignore[misc]
        assert is_done_elsewhere(clock.next_frame), n
        if not is_hit:
            break
        n += 1
    assert n > 10


def test_all_who_wait_are_woken() -> None:
    event, said, woken = WakeEvent(), list[str](), list[str]()
    threads = [
        threading.Thread(target=lambda: woken.append(event.wait_for(lambda: said and said[0], LIMIT_S)), daemon=True)
        for _ in range(3)
    ]
    for thread in threads:
        thread.start()
    while len(event._waiting) < 3:
        time.sleep(1e-3)
    said.append("now")
    event.set()
    for thread in threads:
        thread.join(LIMIT_S)
    assert woken == ["now"] * 3
    assert event._waiting == []


def test_who_waits_in_vain_gets_what_it_saw_last() -> None:
    assert WakeEvent().wait_for(lambda: 0, 0.01) == 0
    assert WakeEvent().wait_for(lambda: 7, 0.0) == 7


def test_a_look_that_raises_ends_the_wait() -> None:
    def look() -> int:
        raise StopIteration

    event = WakeEvent()
    with pytest.raises(StopIteration):
        event.wait_for(look)
    assert event._waiting == []
