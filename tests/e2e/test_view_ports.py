"""Which sensors `ruffini view` shows: chosen as by every other verb, and without those that another program has."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from hang import HANG_S
from test_bad_input import HOST, run_host
from tiny_sensor import Sensor, start

from ruffini.device import Connection

VIEW = ("view", "--no-browser", "--http-port", "0")


@pytest.fixture(scope="module")
def ports(sensor: Sensor, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str]]:
    folder = tmp_path_factory.mktemp("ports")
    with (
        start(sensor, folder / "a", "--loop", serial="left") as left,
        start(sensor, folder / "b", "--loop", serial="right") as right,
    ):
        yield left.port, right.port


@contextlib.contextmanager
def viewing(*options: str, said: list[str], **environment: str) -> Iterator[list[str]]:
    """Ports that the running viewer shows; what it wrote to stderr is in `said` afterwards."""
    clean = {k: v for k, v in os.environ.items() if k not in ("RUFFINI_PORT", "RUFFINI_SERIAL")}
    process = subprocess.Popen(
        [*HOST, *options, *VIEW, "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**clean, **environment},
    )  # fmt: skip
    try:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert first, process.communicate()[1]
        with urllib.request.urlopen(json.loads(first)["address"] + "lines.json") as answer:
            yield [line["port"] for line in json.load(answer)]
    finally:
        process.send_signal(signal.SIGINT)
        said.append(process.communicate(timeout=HANG_S)[1])


def test_without_a_choice_all_are_shown(ports: tuple[str, str]) -> None:
    with viewing("--port", ",".join(ports), said=[]) as shown:
        assert shown == list(ports)


@pytest.mark.parametrize(("serial", "place"), [("left", 0), ("right", 1)])
def test_a_serial_number_chooses_one(ports: tuple[str, str], serial: str, place: int) -> None:
    with viewing("--port", ",".join(ports), "--serial", serial, said=[]) as shown:
        assert shown == [ports[place]]
    with viewing(said=[], RUFFINI_PORT=",".join(ports), RUFFINI_SERIAL=serial) as shown:
        assert shown == [ports[place]]


def test_a_serial_number_that_nobody_has_is_an_error(ports: tuple[str, str]) -> None:
    code, _, said = run_host("--serial", "middle", *VIEW, port=",".join(ports))
    assert code == 3
    assert "no sensor with serial 'middle' among" in said


def test_a_busy_port_is_told_and_the_others_are_shown(ports: tuple[str, str]) -> None:
    said: list[str] = []
    with Connection(ports[0]), viewing("--port", ",".join(ports), said=said) as shown:
        assert shown == [ports[1]]
    assert f"{ports[0]} is busy" in said[0]
    assert "the page shows the others" in said[0]


def test_where_all_are_busy_it_is_an_error_that_names_them(ports: tuple[str, str], tmp_path: Path) -> None:
    missing = str(tmp_path / "tty")
    with Connection(ports[0]):
        code, out, said = run_host(*VIEW, port=f"{ports[0]},{missing}")
    assert (code, out) == (3, "")
    assert f"{ports[0]} is busy" in said
    assert f"{missing} cannot be opened" in said


def test_a_taken_http_port_is_said_and_nothing_starts(ports: tuple[str, str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        number = taken.getsockname()[1]
        code, _, said = run_host("view", "--no-browser", "--http-port", str(number), port=ports[0])
    assert code == 2
    assert f"port {number} of 127.0.0.1 is taken" in said
    assert "--http-port" in said
