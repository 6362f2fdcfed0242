"""When a piece is sent again: on a steady line soon, on an uneven one seldom, in a long silence ever more slowly."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from ruffini.device import flashing
from ruffini.device.flashing import CHUNK_TRIES, LATE_WAIT_S, SHORTEST_WAIT_S, Pace


class SlowLine:
    """In the place of a Connection: the reply to a try that starts at t comes round_trip_s(t) later, None: never."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, round_trip_s: Callable[[float], float | None]) -> None:
        self.now_s, self.n_retries, self._round_trip_s = 0.0, 0, round_trip_s
        monkeypatch.setattr(flashing, "time", SimpleNamespace(monotonic=lambda: self.now_s))

    def command(self, *, waits_s: Sequence[float], **_: Any) -> str:
        replies: list[float] = []  # to an earlier try, which is as good as one to the last
        for i, wait_s in enumerate(waits_s):
            self.n_retries += i > 0
            if (round_trip_s := self._round_trip_s(self.now_s)) is not None:
                replies.append(self.now_s + round_trip_s)
            if replies and min(replies) <= self.now_s + wait_s:
                self.now_s = min(replies)
                return "reply"
            self.now_s += wait_s
        raise TimeoutError


def test_a_steady_line_is_never_asked_twice_and_a_lost_piece_goes_again_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    line, pace = SlowLine(monkeypatch, lambda _: 0.004), Pace()
    for _ in range(200):
        pace.command(line)  # type: ignore[arg-type]
    assert line.n_retries == 0
    assert pace.waits_s()[0] == SHORTEST_WAIT_S


@pytest.mark.parametrize(("shortest_s", "longest_s"), [(0.001, 0.05), (0.02, 0.2), (0.1, 1.0)])
def test_an_uneven_line_is_seldom_asked_twice(
    monkeypatch: pytest.MonkeyPatch, shortest_s: float, longest_s: float
) -> None:
    chance = random.Random(1)
    line, pace = SlowLine(monkeypatch, lambda _: chance.uniform(shortest_s, longest_s)), Pace()
    for _ in range(20):
        pace.command(line)  # type: ignore[arg-type]
    line.n_retries = 0
    for _ in range(1000):
        pace.command(line)  # type: ignore[arg-type]
    assert line.n_retries <= 10


def test_a_line_that_carries_nothing_for_seconds_is_neither_flooded_nor_given_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    line, pace = SlowLine(monkeypatch, lambda t: 0.004 if t < 1 or t > 6 else 6.004 - t), Pace()
    while line.now_s < 7:
        pace.command(line)  # type: ignore[arg-type]
    assert line.n_retries <= 20
    assert pace.waits_s()[0] == SHORTEST_WAIT_S


def test_who_never_answers_is_given_up_after_a_quarter_of_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    line, pace = SlowLine(monkeypatch, lambda t: 0.004 if t < 1 else None), Pace()
    while line.now_s < 1:
        pace.command(line)  # type: ignore[arg-type]
    with pytest.raises(TimeoutError):
        pace.command(line)  # type: ignore[arg-type]
    assert line.n_retries == CHUNK_TRIES - 1
    assert 10 < line.now_s < CHUNK_TRIES * LATE_WAIT_S


def test_one_slow_reply_costs_little_patience_later(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([0.004] * 50 + [0.015] + [0.004] * 50)
    line, pace = SlowLine(monkeypatch, lambda _: next(times)), Pace()
    for _ in range(101):
        pace.command(line)  # type: ignore[arg-type]
    assert line.n_retries == 0
    assert pace.waits_s()[0] == SHORTEST_WAIT_S
