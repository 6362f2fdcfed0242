"""The C++ consumer's example on the real daemon's line."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from hang import HANG_S
from tiny_sensor import N_FRAMES, Sensor, start

from ruffini.demo.daemon import find_daemon
from ruffini.device import Connection, Wrench


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


def test_the_example_says_what_is_wrong(tmp_path: Path) -> None:
    assert newtons().returncode == 2
    nowhere = newtons(str(tmp_path / "ttyACM0"))
    assert nowhere.returncode == 3
    assert "No such file" in nowhere.stderr
