"""The programs and commands of host/README.md, word for word: on the real daemon, and on a recording of it."""

from __future__ import annotations

import os
import re
import shlex
import sys
from pathlib import Path

import pytest
from hang import finished
from test_bad_input import run_host
from tiny_sensor import ROOT, Sensor, calibrated_pair, start

import ruffini
from ruffini.device import Connection
from ruffini.record import record_stream
from ruffini.wire import Schema

TEXT = (ROOT / "host" / "README.md").read_text()


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```$", TEXT, re.M | re.S)


def test_python(sensor: Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with calibrated_pair(sensor, tmp_path) as (left, right):
        with Connection(left.port) as host:
            record_stream(host, tmp_path / "run.mcap", n_frames=10)
        ports = f"LEFT, RIGHT = {left.port!r}, {right.port!r}\n"
        text = "\n".join(blocks("python"))
        own = f"local_camera({str(sensor.recording)!r}, {str(sensor.board.folder)!r})"
        assert 'local_camera("DIGIT")' in text
        program = [sys.executable, "-c", ports + text.replace('local_camera("DIGIT")', own)]
        environment = {**os.environ, "RUFFINI_PORT": left.port, "XDG_STATE_HOME": str(tmp_path / "state")}
        monkeypatch.setenv("XDG_STATE_HOME", environment["XDG_STATE_HOME"])
        # Without this no frame is valid, and the program waits for one.
        with ruffini.local_camera(sensor.recording, sensor.board.folder) as port, Connection(port) as host:
            host.flash(sensor.calibration)
        done = finished(program, cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr
    assert "left ('tiny',)" in done.stdout
    assert done.stdout.rstrip().splitlines()[-1].startswith("[")


def test_commands(sensor: Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with start(sensor, tmp_path / "store", "--loop") as daemon:
        for line in next(block for block in blocks("console") if "record" in block).splitlines():
            short = [word if word != "600" else "10" for word in shlex.split(line)[1:]]
            assert run_host(*short, port=daemon.port)[0] == 0
    commands = [line for block in blocks("sh") for line in block.splitlines()]
    assert len(commands) == 4
    for line in commands:
        code, _, text = run_host(*shlex.split(line)[1:])
        assert code == 0, text
    assert {p.suffix for p in tmp_path.glob("run.*")} == {".mcap", ".html", ".csv", ".hdf5"}


def test_every_flag_is_among_the_symptoms() -> None:
    names = Schema.own().enum_names("FlagBit", 0xFFFFFFFF)
    assert len(names) > 10
    assert [name for name in names if name not in TEXT] == []
