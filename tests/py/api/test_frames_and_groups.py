"""Frames that wait, and frames of several sensors that belong together."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from ruffini.api import SensorFrame, synchronized, synchronized_async
from ruffini.api.frames import Frames
from ruffini.api.in_asyncio import AsyncFrames
from ruffini.device.line_gap import LineGap
from ruffini.errors import InputError, NoDeviceError


def frame(number: int, *, sensor: int = 0, host_ms: float | None = None, flags: int = 0) -> SensorFrame:
    host_ns = None if host_ms is None else round(host_ms * 1e6)
    return SensorFrame("0001", sensor, number, 0.0, host_ns, 50_000, flags, (), True, False, {})


def test_every_frame_waits_up_to_the_limit_and_what_went_is_counted() -> None:
    frames = Frames(3, None)
    for number in (1, 2, 3, 5, 6):
        frames.put(frame(number))
    frames.end(StopIteration())
    assert [(f.number, f.n_missed) for f in frames] == [(3, None), (5, 1), (6, 0)]
    assert frames.n_replaced == 2


def test_the_newest_wins() -> None:
    frames = Frames(1, None)
    frames.put(frame(1))
    assert next(frames).number == 1
    for number in (2, 3, 4):
        frames.put(frame(number))
    assert [(f.number, f.n_missed) for f in [next(frames)]] == [(4, 2)]
    assert frames.get(0) is None


def test_a_sensor_that_was_started_again_has_missed_nobody_knows_what() -> None:
    frames = Frames(9, None)
    for number in (100, 0, 2):
        frames.put(frame(number))
    assert [next(frames).n_missed for _ in range(3)] == [None, None, 1]


def test_what_is_not_whole_is_counted_and_given_to_who_wants_it() -> None:
    every, whole = Frames(9, None, partial=True), Frames(9, None)
    gap = LineGap(0.5, 3)
    for frames in (every, whole):
        frames.put(frame(1))
        frames.put(replace(frame(5), is_whole=False, gap=gap))
        frames.put(replace(frame(5, flags=256), is_whole=False))
        frames.put(frame(6))
        frames.end(StopIteration())
    assert [(f.number, f.n_missed, f.gap) for f in every] == [(1, None, None), (5, 3, gap), (5, 0, None), (6, 0, None)]
    assert [(f.number, f.n_missed, f.gap) for f in whole] == [(1, None, None), (5, 3, None), (6, 0, gap)]
    assert (every.n_partial, whole.n_partial) == (0, 1)


def test_one_of_several_sensors_and_what_is_repeated_for_all() -> None:
    frames = Frames(9, 1)
    for sensor in (0, 1, 255):
        frames.put(frame(1, sensor=sensor))
    assert [next(frames).sensor for _ in range(2)] == [1, 255]


def test_what_waits_is_given_out_before_the_error() -> None:
    frames = Frames(9, None)
    frames.put(frame(1))
    frames.end(NoDeviceError("unplugged"))
    assert next(frames).number == 1
    for _ in range(2):
        with pytest.raises(NoDeviceError, match="unplugged"):
            next(frames)


def test_in_asyncio() -> None:
    async def run() -> list[int]:
        frames = Frames(9, None)
        loop = asyncio.get_running_loop()
        got = AsyncFrames(frames)
        loop.call_later(0.01, lambda: loop.run_in_executor(None, frames.put, frame(1)))
        first = await anext(got)
        loop.call_later(0.01, lambda: loop.run_in_executor(None, frames.end, StopIteration()))
        return [first.number, *[f.number async for f in got]]

    assert asyncio.run(run()) == [1]


def test_frames_of_one_time_are_together_and_the_others_are_counted() -> None:
    left = iter([frame(n, host_ms=10.0 * n) for n in (0, 1, 2, 3, 5)])
    right = iter([frame(n, host_ms=10.0 * n + 2) for n in (1, 2, 4, 5)])
    groups = list(synchronized([left, right], 0.004))
    assert [tuple(f.number for f in g) for g in groups] == [(1, 1), (2, 2), (5, 5)]
    assert [g.n_alone for g in groups] == [1, 0, 2]
    assert groups[0].spread_s == pytest.approx(0.002)
    assert groups[0].error_s == pytest.approx(100e-6)


def test_a_slower_sensor_gets_the_frame_nearest_to_its_own() -> None:
    fast = iter([frame(n, host_ms=5.0 * n) for n in range(12)])
    slow = iter([frame(n, host_ms=20.0 * n + 1) for n in range(3)])
    assert [tuple(f.number for f in g) for g in synchronized([fast, slow], 0.0025)] == [(0, 0), (4, 1), (8, 2)]


def test_three_sensors_and_one_that_repeats_itself() -> None:
    def source(shift_ms: float) -> Iterator[SensorFrame]:
        for n in range(4):
            yield frame(n, host_ms=10.0 * n + shift_ms)
            yield frame(n, host_ms=10.0 * n + shift_ms, flags=256)

    groups = list(synchronized([source(0), source(1), source(3)], 0.004))
    assert [tuple(f.number for f in g) for g in groups] == [(n,) * 3 for n in range(4)]
    assert [g.n_alone for g in groups] == [0] * 4


def test_a_sensor_that_was_started_again_has_no_time_at_first() -> None:
    left = iter([frame(1, host_ms=10), frame(0), frame(1), frame(2, host_ms=40)])
    right = iter([frame(n, host_ms=10.0 * n) for n in (1, 2, 3, 4)])
    assert [tuple(f.number for f in g) for g in synchronized([left, right], 0.004)] == [(1, 1), (2, 4)]


def test_groups_in_asyncio() -> None:
    async def run() -> list[tuple[int, ...]]:
        sources = [Frames(99, None) for _ in range(2)]
        streams = [AsyncFrames(source) for source in sources]
        for number in range(5):
            sources[0].put(frame(number, host_ms=10.0 * number))
            sources[1].put(frame(number + 7, host_ms=10.0 * number + 11))
        for source in sources:
            source.end(StopIteration())
        return [tuple(f.number for f in group) async for group in synchronized_async(streams, 0.004)]

    assert asyncio.run(run()) == [(1, 7), (2, 8), (3, 9), (4, 10)]


def test_without_a_common_clock_there_are_no_groups() -> None:
    with pytest.raises(InputError, match="update its firmware"):
        next(synchronized([iter([frame(n) for n in range(200)]), iter([frame(1, host_ms=1)])]))
    wrong: Any = -1
    with pytest.raises(InputError, match="above zero"):
        synchronized([], wrong)
    with pytest.raises(InputError, match="at least one"):
        synchronized([])
