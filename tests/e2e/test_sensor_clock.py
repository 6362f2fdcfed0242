"""The sensor's clock on the host's: over a line that delays one way more than the other, on clocks that drift apart."""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import select
import threading
import time
import tty
from pathlib import Path

import pytest
from hang import HANG_S
from mcap.reader import make_reader
from tiny_sensor import Sensor, start

from ruffini.device import Connection
from ruffini.record import record_stream


class SlowLine:
    """A pty before the sensor's that holds bytes back: `there_s` on their way there, `back_s` on their way back."""

    def __init__(self, device_port: str, there_s: float, back_s: float) -> None:
        self._device = os.open(device_port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._host, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._host, False)
        self.port = os.ttyname(self._slave)
        self._delay = {self._host: there_s, self._device: back_s}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._carry, daemon=True)

    def __enter__(self) -> SlowLine:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        for end in (self._device, self._host, self._slave):
            os.close(end)

    def _carry(self) -> None:
        chance = random.Random(1)
        other = {self._host: self._device, self._device: self._host}
        held: dict[int, list[tuple[float, bytes]]] = {self._host: [], self._device: []}
        while not self._stop.is_set():
            for end in select.select(list(other), [], [], 0.0005)[0]:
                with contextlib.suppress(OSError):
                    due = time.monotonic() + self._delay[end] * chance.uniform(1, 2)
                    before = held[end][-1][0] if held[end] else 0.0
                    held[end].append((max(due, before), os.read(end, 4096)))
            for end, waiting in held.items():
                while waiting and waiting[0][0] <= time.monotonic():
                    with contextlib.suppress(BlockingIOError):
                        waiting[0] = (waiting[0][0], waiting[0][1][os.write(other[end], waiting[0][1]) :])
                    if waiting[0][1]:
                        break
                    waiting.pop(0)


# Sensor and host of these tests have one clock: what the stamps should be is known exactly, whatever the line does.
@pytest.mark.parametrize(("there_s", "back_s", "drift"), [(0, 0, 0), (0.006, 0, 0), (0, 0.006, 0), (0.001, 0, 200e-6)])
def test_stamps_are_right_within_their_error_and_never_go_back(
    sensor: Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there_s: float, back_s: float, drift: float
) -> None:
    start_ns, real_ns = time.monotonic_ns(), time.monotonic_ns
    offset_ns = 123_456_789_000

    def shown_ns(true_ns: int) -> int:
        return offset_ns + true_ns + round(drift * (true_ns - start_ns))

    monkeypatch.setattr(time, "monotonic_ns", lambda: shown_ns(real_ns()))
    seen = []
    with (
        start(sensor, tmp_path / "store", "--loop") as daemon,
        SlowLine(daemon.port, there_s, back_s) as line,
        Connection(line.port) as host,
    ):
        clock = host.read_clock(HANG_S)
        assert clock.n_exchanges >= 3
        host.subscribe(wrench=1)
        for frame, message in host.stream(timeout_s=HANG_S):
            if frame.type == host.schema.type_numbers["WRENCH"]:
                assert frame.host_time_ns is not None
                assert frame.host_time_error_ns is not None
                seen.append((message.stamp.capture_us, frame.host_time_ns, frame.host_time_error_ns))
            if len(seen) >= 200:
                break
    wrong_ns = [abs(host_ns - shown_ns(1000 * device_us)) for device_us, host_ns, _ in seen]
    assert all(wrong <= error_ns for wrong, (_, _, error_ns) in zip(wrong_ns, seen, strict=True))
    # A camera that stands still for a moment has its last stamp said again.
    assert all((a[0] < b[0]) == (a[1] < b[1]) and a[1] <= b[1] for a, b in itertools.pairwise(seen))
    shortest_s = there_s + back_s
    assert min(error_ns for *_, error_ns in seen) >= 0.45e9 * shortest_s, "no exchange can say more than half of it"
    print(f"delays {there_s} and {back_s} s, drift {1e6 * drift:.0f} ppm: off by {max(wrong_ns) / 1e3:.0f} us at most, "
          f"stated {min(e for *_, e in seen) / 1e3:.0f} to {max(e for *_, e in seen) / 1e3:.0f} us")  # fmt: skip


def test_a_recording_says_what_its_times_are_on_the_hosts_clocks(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path / "store", "--loop") as daemon, Connection(daemon.port) as host:
        record_stream(host, tmp_path / "run.mcap", n_frames=60)
    with (tmp_path / "run.mcap").open("rb") as file:
        said = [m.metadata for m in make_reader(file).iter_metadata() if m.name == "clock"]
    assert said
    wrong_ns = abs(int(said[0]["host_monotonic_ns"]) - 1000 * int(said[0]["sensor_us"]))
    assert wrong_ns <= int(said[0]["error_ns"])
    assert abs(int(said[0]["host_utc_ns"]) - time.time_ns()) < 600e9
