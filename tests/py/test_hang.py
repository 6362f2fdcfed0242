"""The guards against a hang: they end one, and take no busy computer for one."""

from __future__ import annotations

import os
import subprocess
import time

import hang
import pytest


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hang, "HANG_S", 0.05)
    monkeypatch.setattr(hang, "LEAST_S", 0.01)
    monkeypatch.setattr(hang, "FIRST_S", 0.0)


def set_lost(monkeypatch: pytest.MonkeyPatch, *seconds: float) -> None:
    """Time without a core at each look; the last value stays."""
    left = list(seconds)
    monkeypatch.setattr(hang, "_without_core_s", lambda: {"1": left.pop(0) if len(left) > 1 else left[0]})


def test_threads_that_wait_one_after_the_other_count_all(monkeypatch: pytest.MonkeyPatch) -> None:
    looks = iter([{"1": 1.0, "2": 5.0}, {"1": 1.1, "2": 5.2, "3": 0.05}])
    monkeypatch.setattr(hang, "_without_core_s", lambda: next(looks))
    patience = hang.Patience()
    first_s = patience.left_s()
    assert patience.left_s() == pytest.approx(first_s + 0.35, abs=0.05)


def test_what_never_comes_ends_the_wait() -> None:
    with pytest.raises(AssertionError, match="for the tide"):
        hang.until(lambda: False, "the tide")
    with pytest.raises(AssertionError, match="for the moon"), hang.guard("the moon"):
        time.sleep(hang.HANG_S * 1e3)


def test_time_without_a_core_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    set_lost(monkeypatch, 7.0, 1e6)
    patience = hang.Patience()
    assert patience.left_s() <= hang.HANG_S  # counts from this look on
    assert 0.5 * hang.MOST * hang.HANG_S < patience.left_s() <= hang.MOST * hang.HANG_S  # and not for ever
    set_lost(monkeypatch, 7.0, 1e6)
    looks = iter([False] * 40)  # of 2 ms: longer than a hang is waited for
    assert hang.until(lambda: next(looks, True), "the fortieth look")
    set_lost(monkeypatch, 7.0, 1e6)
    with hang.guard("a nap"):
        time.sleep(2 * hang.HANG_S)


def test_a_hang_of_a_computer_that_was_busy_only_at_first_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    set_lost(monkeypatch, 0.0, 0.02, 0.03, 0.03)
    with pytest.raises(AssertionError, match="hangs"):
        hang.until(lambda: False, "the tide")


def test_an_inner_guard_leaves_the_outer_one() -> None:
    def both() -> None:
        with hang.guard("the outer"):
            with hang.guard("the inner"):
                pass
            time.sleep(hang.HANG_S * 1e3)

    with pytest.raises(AssertionError, match="for the outer"):
        both()


def test_threads_of_this_process_and_of_what_it_started_are_looked_at() -> None:
    if not os.path.exists("/proc/self/schedstat"):
        pytest.skip("this kernel does not count it")
    with subprocess.Popen(["sleep", "60"]) as child:
        found = hang._without_core_s()
        child.kill()
    assert {str(os.getpid()), str(child.pid)} <= found.keys()
    assert all(lost_s >= 0 for lost_s in found.values())
