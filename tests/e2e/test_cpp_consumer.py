"""The C++ consumer's example on the real daemon's line."""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import tty
from pathlib import Path
from typing import Any

import pytest
from hang import HANG_S
from tiny_sensor import N_FRAMES, Sensor, start

from ruffini.daemon import find_daemon
from ruffini.device import Connection, Wrench
from ruffini.wire import Schema
from ruffini.wire.framing import Decoder, encode_message


def newtons(*arguments: str) -> subprocess.CompletedProcess[str]:
    program = find_daemon().parent / "host" / "cpp" / "ruffini_newtons"
    return subprocess.run([program, *arguments], capture_output=True, text=True, timeout=HANG_S, check=False)


def forces(sensor: Sensor, store: Path) -> list[float]:
    """fz of each frame as ruffini's own host tool has it, in newtons."""
    with start(sensor, store, "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host.subscribe(wrench=1)
        out: list[float] = []
        for frame, message in host.stream(timeout_s=HANG_S):
            if host.schema.type_name(frame.type) == "WRENCH":
                out.append(Wrench.from_message(message).values[2])
            if len(out) == N_FRAMES:
                break
    return out


def test_the_example_prints_the_newtons_that_the_host_tool_has(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--loop") as daemon, Connection(daemon.port) as host:
        host.flash(sensor.calibration)
    want = forces(sensor, tmp_path)
    with start(sensor, tmp_path, "--lockstep", "--wait-for-host") as daemon:
        done = newtons(daemon.port, str(N_FRAMES))
    assert done.returncode == 0, done.stderr
    assert "0001, calibrated" in done.stderr
    assert "0 damaged frames, 0 messages lost" in done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == N_FRAMES
    assert all(line.endswith("SIMULATED") for line in lines)
    n_rest = sensor.board.pipeline.n_rest_frames
    assert all("fz +nan" in line and "flags" in line for line in lines[:n_rest])
    got = [float(re.search(r"fz (\S+) N", line)[1]) for line in lines[n_rest:]]  # type: ignore[index]
    assert got == pytest.approx(want[n_rest:], abs=5.1e-4)  # three digits are printed
    assert got[-1] < -0.1


def test_results_that_arrive_with_the_reply_are_printed() -> None:
    """On a busy computer one read() returns the reply to SUBSCRIBE and the first results."""
    schema = Schema.own()

    def packet(sequence: int, name: str, **fields: Any) -> bytes:
        payload = schema.new(name, **fields).SerializeToString()
        return encode_message(schema.type_numbers[name.upper()], payload, sensor=0, sequence=sequence, flags=0)

    master, slave = pty.openpty()
    tty.setraw(slave)
    program = find_daemon().parent / "host" / "cpp" / "ruffini_newtons"
    with subprocess.Popen([program, os.ttyname(slave), "3"], stdout=subprocess.PIPE, text=True) as example:
        decoder = Decoder(from_host=True)
        while example.poll() is None:
            if not select.select([master], [], [], 0.1)[0]:
                continue
            for frame in decoder.feed(os.read(master, 4096)):
                if schema.type_name(frame.type) == "HELLO":
                    os.write(master, packet(0, "Hello", device_serial="0001"))
                else:
                    asked = schema.decode(frame.type, frame.payload)
                    frames = b"".join(packet(i, "Wrench", stamp={"frame": i}) for i in (2, 3, 4))
                    os.write(master, packet(1, "Reply", request_id=asked.request_id) + frames)  # type: ignore[union-attr]
        assert example.stdout is not None
        assert [line.split()[1] for line in example.stdout] == ["2", "3", "4"]
    os.close(master)
    os.close(slave)


def test_the_example_says_what_is_wrong(tmp_path: Path) -> None:
    assert newtons().returncode == 2
    nowhere = newtons(str(tmp_path / "ttyACM0"))
    assert nowhere.returncode == 3
    assert "No such file" in nowhere.stderr
