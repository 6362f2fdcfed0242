"""Messages that nobody takes: the newest are kept, by number and by bytes, and what went is counted."""

from __future__ import annotations

from typing import Any

from ruffini.device.backlog import Backlog
from ruffini.wire import Frame


def add(backlog: Backlog, number: int, n_bytes: int = 1, type_: int = 4) -> None:
    backlog.append(Frame(type_, 0, number, 0, bytes(n_bytes)), number)


def rest(backlog: Backlog) -> list[Any]:
    return [backlog.popleft()[1] for _ in range(len(backlog))]


def test_of_many_messages_the_newest_are_kept() -> None:
    backlog = Backlog(max_messages=3)
    for number in range(5):
        add(backlog, number)
    assert (backlog.n_added, backlog.n_dropped) == (5, 2)
    assert rest(backlog) == [2, 3, 4]


def test_of_large_messages_no_more_bytes_are_kept_than_may_be() -> None:
    backlog = Backlog(max_bytes=100)
    for number in range(3):
        add(backlog, number, 50)
    assert (len(backlog), backlog.n_dropped) == (2, 1)
    add(backlog, 3, 101)
    assert (len(backlog), backlog.n_dropped) == (1, 3), "larger than all that may wait: it waits alone"
    add(backlog, 4, 100)
    assert (rest(backlog), backlog.n_dropped) == ([4], 4)


def test_what_was_taken_counts_no_more() -> None:
    backlog = Backlog(max_bytes=100)
    add(backlog, 0, 60)
    assert backlog.take(lambda frame, _: frame.type == 4) == 0
    add(backlog, 1, 60)
    backlog.popleft()
    add(backlog, 2, 100)
    assert (rest(backlog), backlog.n_dropped) == ([2], 0)


def test_the_oldest_of_those_that_were_not_seen_is_taken_and_the_others_keep_their_order() -> None:
    backlog = Backlog(max_messages=4)
    for number in range(4):
        add(backlog, number, type_=number % 2)
    assert backlog.take(lambda frame, _: frame.type == 1, seen=2) == 3
    assert backlog.take(lambda frame, _: frame.type == 1, seen=4) is None
    add(backlog, 4, type_=1)
    add(backlog, 5, type_=1)  # for which the oldest goes
    assert backlog.take(lambda frame, _: frame.type == 1, seen=4) == 4
    assert rest(backlog) == [1, 2, 5]
