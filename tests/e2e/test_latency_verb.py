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
    command = [
        sys.executable,
        "-c",
        "from ruffini.cli import main; raise SystemExit(main())",
        "--port",
        port,
        "latency",
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
