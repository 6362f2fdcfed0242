"""ruffini latency on the real daemon: a line that holds bytes back shows in it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from hang import finished
from test_sensor_clock import SlowLine
from tiny_sensor import Sensor, start

BACK_S = 0.03


def latency(port: str, *words: str, code: int = 0) -> str:
    return run(port, "latency", *words, code=code)


def run(port: str, *words: str, code: int = 0) -> str:
    command = [
        sys.executable,
        "-c",
        "from ruffini.cli import main; raise SystemExit(main())",
        "--port",
        port,
    ]
    done = finished([*command, *words])
    assert done.returncode == code, done.stderr
    return done.stdout if code == 0 else done.stderr


def test_what_the_line_holds_back_shows(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path / "store", "--loop") as daemon:
        straight = json.loads(latency(daemon.port, "--n", "40", "--json"))
        with SlowLine(daemon.port, 0, BACK_S) as line:
            slow = json.loads(latency(line.port, "--n", "40", "--json"))
        assert "REPLAY" in latency(daemon.port, "--n", "2")
        latency(daemon.port, "--n", "40")
        seen = json.loads(run(daemon.port, "info", "--json"))
        shown = run(daemon.port, "info")
        assert "depth, markers" in latency(daemon.port, "--types", "wrench,heat", code=2)
    assert straight["board"] == "tiny"
    assert straight["line"] == "pseudo-terminal"
    assert straight["from"] == "middle"
    assert straight["source"] == ["SIMULATED", "REPLAY"]
    assert straight["n_frames"] + straight["n_missing"] >= 40
    assert straight["p50_ms"] <= straight["p99_ms"] <= straight["largest_ms"]
    # An exchange of clocks over a line that is slow one way cannot say which: its bound does.
    assert slow["clock_error_ms"] >= 450 * BACK_S
    assert slow["p50_ms"] + slow["clock_error_ms"] >= 1000 * BACK_S
    assert slow["n_late"] > 0
    # What the device measured of the last subscription, up to the line.
    own = seen["line_latency"]
    assert own["n_frames"] >= 40
    assert 0 < own["p50_us"] <= own["p99_us"] <= own["p999_us"] <= own["max_us"]
    assert f"latency up to the line: p50 {own['p50_us'] / 1e3:.2f}" in shown
    assert seen["scheduling"]["priority"] == 0
    assert "frame thread: ordinary priority, " in shown
    assert "memory not locked" in shown
