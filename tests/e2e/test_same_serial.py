"""Two real ruffinid with one serial number, as copied cards make them: told, and never taken for each other."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from broken_line import BrokenLine
from hang import HANG_S, until
from test_bad_input import run_host
from test_ros2 import Listener, listener, start_bridge
from tiny_sensor import Daemon, Sensor, start

import ruffini
from ruffini.device import Connection, connect
from ruffini.device.line_gap import LineGap
from ruffini.device.namesakes import REMEDY, Whereabouts
from ruffini.errors import LineLostError, NoDeviceError, SeveralDevicesError

__all__ = ["listener"]
SERIAL = f"{os.getpid():07d}"  # a pty that is free again may be another test's sensor the next moment: not ours
Plug = Callable[..., None]


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Plug:
    """Say which ports are USB's, each with its socket; without one the port is no USB device."""

    def put(**sockets: str) -> None:
        infos = [
            SimpleNamespace(device=port, product="ruffini tiny", manufacturer="ruffini", serial_number=SERIAL,
                            location=socket or None)
            for port, socket in sockets.items()
        ]  # fmt: skip
        monkeypatch.setattr("serial.tools.list_ports.comports", lambda: infos)

    return put


@pytest.fixture
def pair(sensor: Sensor, tmp_path: Path) -> Iterator[tuple[Daemon, Daemon]]:
    with (
        start(sensor, tmp_path / "a", "--loop", serial=SERIAL) as one,
        start(sensor, tmp_path / "b", "--loop", serial=SERIAL) as other,
    ):
        yield one, other


def told(one: str, other: str) -> str:
    return f"{one} and {other} have the same serial number {SERIAL}: choose by --port, and {REMEDY}"


def end(daemon: Daemon) -> None:
    daemon.process.kill()
    daemon.process.wait()


def lose(host: Connection) -> None:
    """Read until the line is lost."""
    with pytest.raises(LineLostError):
        for _ in host.stream():
            pass
    while host.messages:
        host.messages.popleft()


@pytest.mark.parametrize("serial", [None, SERIAL], ids=["none is given", "theirs is given"])
def test_no_serial_number_chooses_among_them(pair: tuple[Daemon, Daemon], serial: str | None) -> None:
    ports = [daemon.port for daemon in pair]
    with pytest.raises(SeveralDevicesError) as said:
        connect(",".join(ports), serial)
    assert str(said.value) == told(*ports)
    assert "SERIAL in /etc/ruffini/ruffinid.env" in REMEDY


def test_beside_a_third_one_both_options_choose(pair: tuple[Daemon, Daemon], sensor: Sensor, tmp_path: Path) -> None:
    ports = [daemon.port for daemon in pair]
    with start(sensor, tmp_path / "c", "--loop", serial="0002") as third:
        with pytest.raises(
            SeveralDevicesError, match=rf"--port or --serial.*; .* have the same serial number {SERIAL}"
        ):
            connect(",".join([*ports, third.port]))
        with connect(",".join([*ports, third.port]), "0002") as host:
            assert host.port == third.port


def test_the_list_of_devices_says_so(pair: tuple[Daemon, Daemon]) -> None:
    ports = [daemon.port for daemon in pair]
    code, out, _ = run_host("devices", port=",".join(ports))
    assert code == 0
    assert out.splitlines()[-1] == told(*ports)
    assert run_host("devices", port=ports[0])[1].splitlines() == [f"{ports[0]}  {SERIAL}  tiny"]


def test_who_opens_one_by_its_port_is_told_of_the_other(pair: tuple[Daemon, Daemon], plug: Plug) -> None:
    one, other = (daemon.port for daemon in pair)
    notes: list[str] = []
    plug(**{one: "1-1:1.0", other: "1-2:1.0"})
    with ruffini.connect(one, on_note=notes.append):
        assert [n for n in notes if "same serial" in n] == [told(one, other)]
    notes.clear()
    plug(**{one: "1-1:1.0", other: "1-1:1.2"})  # two pads of one board: its USB number is the first one's
    with ruffini.connect(one, on_note=notes.append):
        assert not any("same serial" in n for n in notes)


def test_after_a_lost_line_the_other_is_not_taken(pair: tuple[Daemon, Daemon], plug: Plug) -> None:
    one, other = pair
    plug(**{one.port: "", other.port: ""})
    with Connection(other.port) as busy, Connection(one.port) as host:
        busy.subscribe(wrench=1, field=1)  # what it says comes over its line from now on
        heard: list[bytes] = []
        host.raw_sink = heard.append
        host.subscribe(wrench=1)
        end(one)
        lose(host)
        heard.clear()
        busy._serial.close()  # as a program that was killed leaves it
        with pytest.raises(NoDeviceError, match=f"sensor {SERIAL} is not back after 1 s: ") as said:
            host.resume(1)
        why = f"the one on {other.port} was there before, beside it: connect again by --port, and {REMEDY}"
        assert why in str(said.value)
        assert heard == []
        assert not host.messages


def test_a_link_that_leads_to_the_other_then_is_not_followed(
    pair: tuple[Daemon, Daemon], plug: Plug, tmp_path: Path
) -> None:
    """As udev's /dev/ruffini/SERIAL does."""
    one, other = pair
    link = tmp_path / SERIAL
    link.symlink_to(one.port)
    plug(**{one.port: "1-1", other.port: "1-2"})
    with Connection(str(link)) as host:
        host.subscribe(wrench=1)
        end(one)
        lose(host)
        plug(**{other.port: "1-2"})
        link.unlink()
        link.symlink_to(other.port)
        with pytest.raises(NoDeviceError, match="was there before, beside it"):
            host.resume(1)


def test_the_same_one_is_taken_beside_the_other_wherever_it_comes_back(
    pair: tuple[Daemon, Daemon], plug: Plug, tmp_path: Path
) -> None:
    """It was not started again: its session says that it is the same."""
    one, other = pair
    with BrokenLine(one.port, tmp_path) as line:
        plug(**{line.port: "", other.port: ""})
        with Connection(line.port) as host:
            host.subscribe(wrench=1)
            line.unplug()
            lose(host)
            line.port = str(tmp_path / "elsewhere")
            line.plug_in()
            plug(**{other.port: "", line.port: ""})
            host.resume(20)
            assert host.port == line.port
            assert next(iter(host.stream(timeout_s=HANG_S)), None) is not None


def test_started_again_it_is_known_by_its_socket(sensor: Sensor, plug: Plug, tmp_path: Path) -> None:
    gaps: list[LineGap] = []
    with contextlib.ExitStack() as stack:
        one, other = (
            stack.enter_context(start(sensor, tmp_path / name, "--loop", serial=SERIAL)) for name in ("a", "b")
        )
        plug(**{one.port: "1-1", other.port: "1-2"})
        host = stack.enter_context(Connection(one.port))
        host.subscribe(wrench=1)
        end(one)
        link = str(tmp_path / "tty")
        stack.enter_context(start(sensor, tmp_path / "a", "--loop", serial=SERIAL, link=f"pty:{link}"))
        again = os.path.realpath(link)
        plug(**{again: "1-1", other.port: "1-2"})
        for _ in host.stream(timeout_s=HANG_S, resume_s=HANG_S, on_gap=gaps.append):
            if gaps:
                break
        assert host.port == again
        assert [gap.n_frames for gap in gaps] == [None]


def hello(session: int, board: str = "tiny", sha256: bytes = b"1") -> SimpleNamespace:
    pad = SimpleNamespace(board=board, calibration=SimpleNamespace(sha256=sha256))
    return SimpleNamespace(session_id=session, sensors=[pad])


@pytest.mark.parametrize(
    ("others", "port", "now", "doubt"),
    [
        ({}, "same", hello(2), ""),
        ({}, "new", hello(2), ""),
        ({}, "new", hello(1, sha256=b"2"), ""),
        ({}, "same", hello(2, sha256=b"2"), ""),  # another gel, or a trial that was not ended
        ({}, "new", hello(2, sha256=b"2"), "has another place and another calibration"),
        ({}, "same", hello(2, board="gelslim"), "is another board"),
        ({"/dev/other": "1-2"}, "same", hello(2), ""),
        ({"/dev/other": "1-2"}, "new", hello(1), ""),
        ({"/dev/other": "1-2"}, "new", hello(2), "was started again in another place, and there are other sensors"),
        ({"/dev/other": "1-2"}, "other", hello(2), "was there before, beside it"),
    ],
)
def test_what_a_sensor_may_change_while_its_line_is_lost(
    plug: Plug, others: dict[str, str], port: str, now: SimpleNamespace, doubt: str
) -> None:
    plug(**{"/dev/first": "1-1"}, **others)
    known = Whereabouts("/dev/first")
    plug(**{"/dev/same": "1-1", "/dev/new": "1-3"}, **others)
    assert known.doubt(f"/dev/{port}", hello(1), now) == doubt


def test_two_bridges_of_one_name_say_so(pair: tuple[Daemon, Daemon], listener: Listener) -> None:
    one, other = (start_bridge(daemon.port, listener.endpoint) for daemon in pair)
    try:

        def words() -> set[str]:
            said = [s.message for m in listener.messages("diagnostics") for s in m.status]
            return {w for w in said if f"another node is named ruffini_{SERIAL}" in w}

        until(words, "the diagnostics of two nodes with one name")
        assert all(REMEDY in text for text in words())
    finally:
        for bridge in (one, other):
            bridge.terminate()
    said = [bridge.communicate(timeout=HANG_S)[1] for bridge in (one, other)]
    assert any(f"another node is named ruffini_{SERIAL}, too" in text for text in said)
