"""Lines that lose bytes and are unplugged: what is flashed arrives whole, who listens goes on and is told of the gap.

RUFFINI_SOAK=1 (`make soak`) runs the sizes that the promises name: 4 MiB, 50 unplugs, 10,000 hang-ups.
"""

from __future__ import annotations

import contextlib
import os
import random
import threading
import time
from itertools import islice
from pathlib import Path

import pytest
from broken_line import BrokenLine, unplugged_host
from hang import HANG_S, guard, until
from mcap.reader import make_reader
from tiny_sensor import Sensor, start

from ruffini.device import Connection, flashing
from ruffini.device.line_gap import LineGap
from ruffini.errors import LineLostError, RefusedError
from ruffini.record import record_stream

IS_SOAK = os.environ.get("RUFFINI_SOAK") == "1"
N_BYTES = (4 << 20) if IS_SOAK else (384 << 10)
N_UNPLUGS = 50 if IS_SOAK else 6
N_HANG_UPS = 10_000 if IS_SOAK else 300


class CountingConnection(Connection):
    """Counts the chunks that it sends, and those of them that go again because no reply came in time."""

    n_chunks = n_late = 0
    _n_retries_before = 0

    def _send(self, type_name: str, payload: bytes = b"") -> None:
        is_chunk = len(payload) > flashing.CHUNK_BYTES // 2
        self.n_chunks += is_chunk
        self.n_late += is_chunk and self.n_retries > self._n_retries_before
        self._n_retries_before = self.n_retries
        super()._send(type_name, payload)


def upload_of(n_bytes: int) -> bytes:
    """No calibration: the device takes all of it, sees that the hash is right, and refuses it for its signature."""
    return random.Random(n_bytes).randbytes(n_bytes)


@pytest.mark.parametrize("loss", [0.01, 0.1])
def test_a_line_that_loses_pieces_brings_the_whole_file(sensor: Sensor, tmp_path: Path, loss: float) -> None:
    n_bytes = N_BYTES if IS_SOAK or loss < 0.1 else N_BYTES // 4  # what is lost costs half a second's waiting each
    data = upload_of(n_bytes)
    with (
        start(sensor, tmp_path / "store", "--wait-for-host") as daemon,
        BrokenLine(daemon.port, tmp_path) as line,
        CountingConnection(line.port) as host,
    ):
        line.loss = loss
        with pytest.raises(RefusedError, match="header length"):
            host.flash(data)
        assert line.n_lost > loss * n_bytes / 512 / 2
        print(f"{n_bytes >> 10} KiB at {100 * loss:.0f} % loss: {line.n_lost} pieces lost, "
              f"{host.n_chunks} chunks sent of {-(-n_bytes // flashing.CHUNK_BYTES)}")  # fmt: skip
        host.flash(sensor.calibration)
        assert host.hello.sensors[0].calibration.present


def test_an_upload_goes_on_where_the_line_was_unplugged(sensor: Sensor, tmp_path: Path) -> None:
    data, chance = upload_of(N_BYTES), random.Random(1)
    n_whole = -(-N_BYTES // flashing.CHUNK_BYTES)
    # Pulled within two milliseconds after each of these chunks was sent: on its way, or with its reply.
    pulled = iter([*sorted(chance.sample(range(1, n_whole - 2), N_UNPLUGS)), n_whole + 1])
    said: list[str] = []
    with (
        start(sensor, tmp_path / "store", "--wait-for-host") as daemon,
        BrokenLine(daemon.port, tmp_path) as line,
        CountingConnection(line.port) as host,
    ):
        pulls: list[threading.Thread] = []

        def pull() -> None:
            time.sleep(chance.uniform(0, 0.002))
            line.unplug()
            time.sleep(chance.uniform(0, 0.05))
            line.plug_in()

        next_pull = next(pulled)

        def watch(done: float) -> None:
            nonlocal next_pull
            if done * n_whole >= next_pull:
                for thread in pulls:
                    thread.join()
                pulls.append(threading.Thread(target=pull))
                pulls[-1].start()
                next_pull = next(pulled)

        with pytest.raises(RefusedError, match="header length"):
            host.flash(data, progress=watch, say=said.append)
        for thread in pulls:
            thread.join()
    # How many replies are late is the machine's doing; what that may cost is judged in py/device/test_pace.py.
    n_again = host.n_chunks - n_whole - host.n_late
    print(f"{N_BYTES >> 10} KiB, {len(pulls)} unplugs, {n_again} chunks sent again, {host.n_late} for late replies")
    assert len(pulls) == N_UNPLUGS
    assert n_again <= N_UNPLUGS
    assert any("waiting for it" in text for text in said)


def test_who_listens_goes_on_after_an_unplug_and_is_told_what_is_missing(sensor: Sensor, tmp_path: Path) -> None:
    gaps: list[LineGap] = []
    with (
        start(sensor, tmp_path / "store", "--loop") as daemon,
        BrokenLine(daemon.port, tmp_path) as line,
        unplugged_host(line, 20, 10)(line.port) as host,
    ):
        counts = record_stream(host, tmp_path / "run.mcap", n_frames=50, resume_s=HANG_S, on_gap=gaps.append)
    assert counts["WRENCH"] >= 50
    (gap,) = gaps
    assert gap.lost_s > 0
    assert gap.n_frames is not None
    assert gap.n_frames >= 10
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file)
        stored = [m for m in reader.iter_metadata() if m.name == "gap"]
        n_wrenches = counts["WRENCH"] + counts.get("REPEATED", 0)
        assert sum(1 for _ in reader.iter_messages(topics=["/ruffini/wrench"])) == n_wrenches
    assert [m.metadata["missing_frames"] for m in stored] == [str(gap.n_frames)]


def test_a_line_that_spoils_frames_is_said_to_be_bad_once(sensor: Sensor, tmp_path: Path) -> None:
    said: list[str] = []
    with (
        start(sensor, tmp_path / "store", "--loop") as daemon,
        BrokenLine(daemon.port, tmp_path) as line,
        Connection(line.port) as host,
    ):
        host.on_damage = said.append
        host.subscribe(wrench=1, field=1)
        stream = host.stream(timeout_s=HANG_S)
        for _ in range(20):
            assert next(stream, None) is not None
        assert said == []
        line.loss = 0.2
        with guard("20 damaged frames"):
            while host.decoder.counters.damaged < 20:
                next(stream, None)
    assert len(said) == 1
    assert "do not use these forces for control" in said[0]


def test_a_sensor_that_was_started_again_says_so_and_another_one_is_not_taken_for_it(
    sensor: Sensor, tmp_path: Path
) -> None:
    gaps: list[LineGap] = []
    port = str(tmp_path / "tty")
    with contextlib.ExitStack() as stack:
        first = stack.enter_context(start(sensor, tmp_path / "store", "--loop", link=f"pty:{port}"))
        host = stack.enter_context(Connection(port))
        host.subscribe(wrench=1)
        next(iter(host.stream(timeout_s=HANG_S)))
        first.process.kill()
        first.process.wait()
        stack.enter_context(start(sensor, tmp_path / "store", "--loop", link=f"pty:{port}"))
        while host.messages:
            host.messages.popleft()
        stream = host.stream(timeout_s=HANG_S, resume_s=HANG_S, on_gap=gaps.append)
        assert next((heard for heard in islice(stream, 1000) if gaps), None)  # what the first still sent comes before
        assert [gap.n_frames for gap in gaps] == [None]
        assert "started again" in str(gaps[0])
    with contextlib.ExitStack() as stack:
        first = stack.enter_context(start(sensor, tmp_path / "store", "--loop", link=f"pty:{port}"))
        host = stack.enter_context(Connection(port))
        first.process.kill()
        first.process.wait()
        stack.enter_context(start(sensor, tmp_path / "store", "--loop", link=f"pty:{port}", serial="0002"))
        with pytest.raises(Exception, match="sensor 0001 is not back"):
            list(host.stream(timeout_s=HANG_S, resume_s=1))


def test_hang_ups_cost_the_daemon_nothing_and_it_answers_at_once(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path / "store", "--loop") as daemon:
        status = Path(f"/proc/{daemon.process.pid}")

        def open_files() -> int:
            """Those that stay open: the daemon opens the other end of its pty for a moment, to see what waits there."""
            counts = []
            for _ in range(20):
                counts.append(len(list((status / "fd").iterdir())))
                time.sleep(0.003)
            return min(counts)

        def resident_kb() -> int:
            line = next(x for x in (status / "status").read_text().splitlines() if x.startswith("VmRSS"))
            return int(line.split()[1])

        def hang_up(n: int) -> None:
            for _ in range(n):
                end = os.open(daemon.port, os.O_RDWR | os.O_NOCTTY)
                os.write(end, b"\0half a frame")
                os.close(end)

        hang_up(100)
        with Connection(daemon.port) as host:
            host.subscribe(wrench=1)
            next(iter(host.stream(timeout_s=HANG_S)))
        files, before_kb = open_files(), resident_kb()
        hang_up(N_HANG_UPS)
        for _ in range(20):
            with Connection(daemon.port) as host:
                host.subscribe(wrench=1)
                assert next(iter(host.stream(timeout_s=HANG_S)), None) is not None
        until(lambda: open_files() == files, "no more open files than before")
        assert resident_kb() - before_kb < 512
        print(f"{N_HANG_UPS} hang-ups: {resident_kb() - before_kb} KiB more")
        assert daemon.process.poll() is None


def test_a_line_that_is_lost_for_good_is_said(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path / "store", "--loop") as daemon, Connection(daemon.port) as host:
        host.subscribe(wrench=1)
        next(iter(host.stream(timeout_s=HANG_S)))
        daemon.process.kill()
        daemon.process.wait()
        with pytest.raises(LineLostError, match="the line was lost"):
            list(host.stream(timeout_s=HANG_S))
