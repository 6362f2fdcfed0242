"""Every program of host/examples runs as it is; those for a sensor on the real daemon."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from hang import finished
from test_bad_input import run_host
from tiny_sensor import ROOT, Sensor, calibrated_pair, start

from ruffini.device import Connection

EXAMPLES = ROOT / "host" / "examples"


def run(name: str, *arguments: str, port: str = "nowhere") -> str:
    done = finished([sys.executable, EXAMPLES / name, *arguments], env={**os.environ, "RUFFINI_PORT": port})
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def port(sensor: Sensor, tmp_path: Path):  # type: ignore[no-untyped-def]
    with start(sensor, tmp_path, "--loop") as daemon:
        with Connection(daemon.port) as host:
            host.flash(sensor.calibration)
        yield daemon.port


def test_print_forces(port: str) -> None:
    said = run("print_forces.py", "60", port=port)
    assert "0001: tiny" in said
    assert "N, sigma" in said
    assert "SIMULATED" in said


def test_hold_without_slip(port: str) -> None:
    assert "done" in run("hold_without_slip.py", "1", port=port).splitlines()  # notes of a busy computer may follow it


def test_two_fingers(sensor: Sensor, tmp_path: Path) -> None:
    with calibrated_pair(sensor, tmp_path) as (left, right):
        said = run("two_fingers.py", left.port, right.port, "5").splitlines()
    assert len(said) == 5
    assert all("squeezed by" in line and "ms apart" in line for line in said)


def test_tray_stiffness(tmp_path: Path) -> None:
    log, columns = tmp_path / "tray.h5", EXAMPLES / "tray.toml"
    code, _, text = run_host("cal", "convert", str(EXAMPLES / "tray.csv"), "--columns", str(columns), "--out", str(log))
    assert code == 0, text
    rows = [[float(word) for word in line.split()[1:]] for line in run("tray_stiffness.py", str(log)).splitlines()[1:]]
    assert np.allclose(rows, [[900, 20, 0], [-15, 850, 30], [10, 5, 2600]], atol=5)


def test_each_example_is_run() -> None:
    tested = Path(__file__).read_text()
    assert [p.name for p in EXAMPLES.glob("*.py") if f'"{p.name}"' not in tested] == []
