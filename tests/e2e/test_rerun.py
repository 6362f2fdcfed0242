"""`ruffini rerun` on the real daemon, where rerun-sdk is installed; and what it says where it is not."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest
from hang import finished
from tiny_sensor import Sensor, start

from ruffini.device import Connection

RUFFINI = str(Path(sys.executable).parent / "ruffini")


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return finished([RUFFINI, *arguments])


def test_a_press_becomes_a_file(sensor: Sensor, tmp_path: Path) -> None:
    if importlib.util.find_spec("rerun") is None:
        missing = run("rerun", "--save", str(tmp_path / "a.rrd"))
        assert missing.returncode == 2
        assert "pip install 'rerun-sdk>=0.24'" in missing.stderr
        pytest.skip("extra [rerun] is not installed: 500 MB")
    with start(sensor, tmp_path / "store", "--loop") as daemon:
        with Connection(daemon.port) as host:
            host.flash(sensor.calibration)
        done = run("--port", daemon.port, "rerun", "--save", str(tmp_path / "a.rrd"), "--n-frames", "60", "--json")
    assert done.returncode == 0, done.stderr
    assert '"frames": 60' in done.stdout
    assert b"/simulated_ruffini_0001/pad0/force" in (tmp_path / "a.rrd").read_bytes()


def test_two_places_at_once_are_refused() -> None:
    both = run("rerun", "--save", "a.rrd", "--connect", "rerun+http://127.0.0.1:9876/proxy")
    assert both.returncode == 2
    assert "choose one" in both.stderr
