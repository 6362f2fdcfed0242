"""`import ruffini`: frames from the real daemon, in programs with and without asyncio, of two sensors at once."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import threading
from pathlib import Path

import numpy as np
import pytest
from broken_line import BrokenLine
from hang import HANG_S, guard, until
from tiny_sensor import N_FRAMES, N_REST, Sensor, start
from told_sensor import ToldSensor, info_of, told_field

import ruffini
from ruffini.boards import find_board
from ruffini.device import Connection
from ruffini.errors import NoDeviceError, RefusedError


def flashed(sensor: Sensor, port: str) -> None:
    with Connection(port) as host:
        host.flash(sensor.calibration)


def test_every_frame_of_a_press_is_there_with_all_its_parts(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--lockstep", "--wait-for-host") as daemon:
        flashed(sensor, daemon.port)
        got = []
        with ruffini.connect(daemon.port, image=4, resume_s=0) as host:
            assert (host.serial_number, host.boards) == ("0001", ("tiny",))
            with contextlib.suppress(NoDeviceError):  # it goes with its recording
                for frame in host.frames():
                    got.append(frame)
            nodes = host.nodes()
    assert [f.number for f in got] == list(range(N_FRAMES))
    assert [f.n_missed for f in got] == [None, *[0] * (N_FRAMES - 1)]
    assert all(f.is_simulated and f.is_replay for f in got)
    assert [f.number for f in got if f.image is not None] == list(range(0, N_FRAMES, 4))
    first, last = got[0], got[-1]
    assert first.flags == ("FLAG_NO_REFERENCE",)
    assert first.wrench is not None
    assert not first.is_valid
    assert np.isnan(first.wrench.force).all()
    assert last.is_valid
    assert last.flags == ()
    assert last.wrench is not None
    assert last.field is not None
    assert last.depth is not None
    assert last.contacts is not None
    assert last.wrench.force[2] < -0.1
    np.testing.assert_allclose(last.field.force.sum(axis=(0, 1)), last.wrench.force, atol=1e-9)
    assert nodes.shape[:2] == last.field.force.shape[:2]
    moment_x = (nodes[..., 1] * last.field.force[..., 2]).sum()
    assert last.wrench.torque[0] == pytest.approx(moment_x, abs=1e-7)
    assert np.nanmin(last.depth.depth) < -100e-6
    assert len(last.contacts.contacts) == 1
    assert got[N_REST - 1].contacts is not None
    assert got[N_REST - 1].contacts.contacts == ()


def test_the_newest_wins_and_says_what_it_passed_over(sensor: Sensor, tmp_path: Path) -> None:
    # In lockstep every frame comes, and none twice: what is passed over is the host's doing.
    with (
        start(sensor, tmp_path, "--lockstep", "--loop", "--wait-for-host") as daemon,
        ruffini.connect(daemon.port) as host,
    ):
        frames = host.frames(newest=True)
        before = next(frames)
        for _ in range(3):
            n_replaced = frames.n_replaced
            until(lambda n=n_replaced: frames.n_replaced >= n + 3, "three frames, while the program is busy")
            frame = next(frames)
            assert frame.n_missed == frame.number - before.number - 1
            assert frame.n_missed >= 3, "it is not one of those that came meanwhile"
            before = frame


def test_commands_while_frames_come(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--lockstep", "--loop", "--wait-for-host") as daemon:
        flashed(sensor, daemon.port)
        notes: list[str] = []
        with ruffini.connect(daemon.port, on_note=notes.append) as host:
            frames = host.frames()
            until(lambda: host.call(Connection.status).frames_processed > 0, "a frame")
            while not next(frames).is_valid:
                pass
            host.zero(even_if_touched=True)
            with guard("a frame without a reference"):
                assert any("FLAG_NO_REFERENCE" in f.flags for f in frames)
            with pytest.raises(RefusedError, match="this firmware has"):
                host.call(lambda c: c.checked(get={"key": "humour"}))
            assert host.read().number > 0
            assert host.health
        assert any("development key" in note for note in notes)
        with pytest.raises(NoDeviceError, match="is closed"):
            host.call(Connection.status)
        with pytest.raises(NoDeviceError, match="no frame"):
            host.read()


def test_closing_ends_whoever_iterates(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--loop") as daemon:
        host = ruffini.connect(daemon.port)
        frames = host.frames()
        for _ in range(4):
            next(frames)
        closing = threading.Thread(target=host.close)
        closing.start()
        with guard("the end of the frames"):
            assert sum(1 for _ in frames) >= 0
        closing.join()
        with Connection(daemon.port):
            pass  # the port is free again


def test_an_unplugged_line_is_waited_for_and_the_next_frame_says_so(sensor: Sensor, tmp_path: Path) -> None:
    notes: list[str] = []
    with (
        start(sensor, tmp_path / "store", "--loop") as daemon,
        BrokenLine(daemon.port, tmp_path) as line,
        ruffini.connect(line.port, resume_s=HANG_S, on_note=notes.append) as host,
    ):
        frames = host.frames()
        next(frame for frame in frames if not frame.is_stale)  # a busy daemon repeats one until the first is there
        line.unplug_for(10)
        after = next(f for f in frames if f.gap is not None)
        assert after.gap is not None
        assert after.gap.lost_s > 0
        assert after.n_missed is not None
        assert after.n_missed >= after.gap.n_frames >= 10  # type: ignore[operator]
        assert any("the line was lost for" in note for note in notes)
        assert next(frames).gap is None


def test_a_sensor_that_is_gone_is_an_error_and_not_silence(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path / "store", "--loop") as daemon, ruffini.connect(daemon.port, resume_s=0.3) as host:
        frames = host.frames()
        next(frames)
        daemon.process.kill()
        with pytest.raises(NoDeviceError, match="is not back after"):
            for _ in frames:
                pass
        with pytest.raises(NoDeviceError):
            next(host.frames())
        with pytest.raises(NoDeviceError):
            host.call(Connection.status)


def test_in_asyncio_the_loop_goes_on_while_frames_come(sensor: Sensor, tmp_path: Path) -> None:
    async def run(port: str) -> tuple[list[int], int, int]:
        turns = 0

        async def turn() -> None:
            nonlocal turns
            while True:
                await asyncio.sleep(0.001)
                turns += 1

        ticker = asyncio.create_task(turn())
        numbers = []
        async with ruffini.connect_async(port, depth=0) as host:
            assert host.sensor.boards == ("tiny",)
            async for frame in host.frames():
                if frame.is_stale:  # the last one again: the camera stood still, as it may on a busy computer
                    continue
                numbers.append(frame.number)
                if len(numbers) == 20:
                    break
            await host.zero(even_if_touched=True)
            newest = (await host.read()).number
            with pytest.raises(RefusedError):
                await host.call(lambda c: c.checked(get={"key": "humour"}))
        ticker.cancel()
        return numbers, newest, turns

    with start(sensor, tmp_path, "--loop") as daemon:
        numbers, newest, turns = asyncio.run(run(daemon.port))
    assert numbers == sorted(set(numbers))
    assert newest > numbers[-1]
    assert turns > 20


def test_in_asyncio_a_sensor_that_is_gone_is_an_error(sensor: Sensor, tmp_path: Path) -> None:
    async def run() -> None:
        with start(sensor, tmp_path, "--loop") as daemon:
            async with ruffini.connect_async(daemon.port, resume_s=0) as host:
                frames = host.frames()
                await anext(frames)
                daemon.process.kill()
                async for _ in frames:
                    pass

    with pytest.raises(NoDeviceError):
        asyncio.run(run())
    with pytest.raises(NoDeviceError, match="async with"):
        _ = ruffini.connect_async("nowhere").sensor


def test_two_sensors_on_a_common_clock(sensor: Sensor, tmp_path: Path) -> None:
    with (
        start(sensor, tmp_path / "a", "--loop", serial="left") as one,
        start(sensor, tmp_path / "b", "--loop", serial="right") as two,
        ruffini.connect(one.port) as left,
        ruffini.connect(two.port) as right,
    ):
        groups = list(itertools.islice(ruffini.synchronized([left, right], 0.006), 30))
    for group in groups:
        a, b = group
        assert (a.serial, b.serial) == ("left", "right")
        assert a.host_time_ns is not None
        assert b.host_time_ns is not None
        assert group.spread_s == pytest.approx(abs(a.host_time_ns - b.host_time_ns) * 1e-9)
        assert group.spread_s <= 0.006
        # Both daemons run on this computer's clock: what the groups say of the time is known exactly.
        assert abs(a.capture_s - b.capture_s) <= group.spread_s + group.error_s
    print(f"30 groups, at most {1e3 * max(g.spread_s for g in groups):.1f} ms apart, clocks known to "
          f"{1e6 * max(g.error_s for g in groups):.0f} us, {sum(g.n_alone for g in groups)} frames alone")  # fmt: skip


def test_two_pads_of_one_device(tmp_path: Path) -> None:
    board = find_board("gelslim")
    infos = [info_of(board, sensor, (20, 16)) for sensor in (0, 1)]
    with ToldSensor(infos, told_field(20, 16)) as told, ruffini.connect(told.port) as host:
        only = list(itertools.islice(host.frames(sensor=1), 5))
        assert {f.sensor for f in only} == {1}
        assert only[-1].field is not None
        assert host.nodes(1).shape == (16, 20, 2)
        with pytest.raises(ruffini.errors.InputError, match="has no sensor 2: it has 0, 1"):
            host.nodes(2)
