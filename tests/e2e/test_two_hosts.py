"""Who may change something: two hosts on one line, owners' keys, and a session that is played again."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
import threading
import tty
from pathlib import Path
from typing import Any

import pytest
from daemon_time import DaemonTime
from hang import HANG_S, guard, until
from test_bad_input import run_host
from tiny_sensor import Sensor, start

from ruffini.device import Connection
from ruffini.errors import NoDeviceError, RefusedError
from ruffini.wire import Decoder, Schema, encode_message

LEASE_S = 2.0


class SharedLine:
    """Two host ends of one line: what each sends goes to the sensor, what that says goes to both."""

    def __init__(self, device_port: str, folder: Path) -> None:
        self._device_port, self.ports = device_port, [str(folder / "one"), str(folder / "two")]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self.sent = bytearray()  # by hosts

    def __enter__(self) -> SharedLine:
        self._device = os.open(self._device_port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._hosts, self._slaves = [], []
        for port in self.ports:
            host, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(host, False)
            os.symlink(os.ttyname(slave), port)
            self._hosts.append(host)
            self._slaves.append(slave)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        for end in (self._device, *self._hosts, *self._slaves):
            os.close(end)

    def send(self, data: bytes) -> None:
        """As a host would."""
        self._give(self._device, data)

    @staticmethod
    def _give(end: int, data: bytes) -> None:
        while data:
            select.select([], [end], [], 1)
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(end, data) :]

    def _carry(self) -> None:
        waiting = {host: b"" for host in self._hosts}
        while not self._stop.is_set():
            for end in select.select([self._device, *self._hosts], [], [], 0.002)[0]:
                with contextlib.suppress(OSError):
                    data = os.read(end, 65536)
                    if end == self._device:
                        for host in self._hosts:
                            with contextlib.suppress(OSError):
                                os.write(host, data)
                        continue
                    self.sent += data
                    waiting[end] += data
                    whole = waiting[end].rfind(b"\0") + 1  # frames of two hosts must not mix
                    self._give(self._device, waiting[end][:whole])
                    waiting[end] = waiting[end][whole:]


def test_the_second_of_two_hosts_is_told_who_changes_the_sensor(sensor: Sensor, tmp_path: Path) -> None:
    sensor_time = DaemonTime(tmp_path)
    with (
        start(sensor, tmp_path / "store", "--loop", *sensor_time.options) as daemon,
        SharedLine(daemon.port, tmp_path) as line,
        Connection(line.ports[0]) as first,
        Connection(line.ports[1]) as second,
    ):
        first.checked(zero={"n_frames": 5, "even_if_touched": True})
        with pytest.raises(RefusedError, match=rf"another host is changing this sensor.*process {os.getpid()}.*wait"):
            second.checked(zero={"n_frames": 5, "even_if_touched": True})
        second.subscribe(wrench=1)
        sensor_time.advance(0.02)  # a frame
        assert next(iter(second.stream(timeout_s=HANG_S)), None) is not None, "reading needs no lease"
        assert f"process {os.getpid()}" in first.status().access.holder
        first._writer.has_lease = False  # killed: it says nothing any more
        sensor_time.advance(LEASE_S - 0.02)  # from the first one's last command
        with pytest.raises(RefusedError, match="another host"):
            second.checked(zero={"n_frames": 5, "even_if_touched": True})
        sensor_time.advance(1e-6)  # the lease ends by itself

        def is_zeroed() -> bool:
            """Two seconds have passed at once: to the device the camera stands still until its next frame."""
            try:
                second.checked(zero={"n_frames": 5, "even_if_touched": True})
            except RefusedError as error:
                if "the camera stands still" not in str(error):
                    raise
                sensor_time.advance(0.01)
                return False
            return True

        until(is_zeroed, "the camera's next frame")
        with pytest.raises(RefusedError, match="another host"):
            first.checked(zero={"n_frames": 5, "even_if_touched": True})


def test_a_port_in_use_says_by_whom(sensor: Sensor, tmp_path: Path) -> None:
    code = (
        "import sys, time; from ruffini.device import Connection; host = Connection(sys.argv[1]); "
        "print(1, flush=True); time.sleep(60)"
    )
    with start(sensor, tmp_path / "store", "--loop") as daemon:
        other = subprocess.Popen([sys.executable, "-c", code, daemon.port], stdout=subprocess.PIPE, text=True)
        try:
            assert other.stdout is not None
            assert other.stdout.readline() == "1\n"
            with pytest.raises(NoDeviceError, match=rf"is busy: .*process {other.pid}\) has it open"):
                Connection(daemon.port)
        finally:
            other.kill()
            other.communicate()


def test_a_sensor_with_owners_is_changed_by_them_only_and_not_by_what_they_sent_before(
    sensor: Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RUFFINI_KEYS", str(tmp_path / "keys"))
    assert run_host("key", "new", "lab")[0] == 0
    assert run_host("key", "enrol", "lab", str(tmp_path / "card"))[0] == 0
    (tmp_path / "calibration").write_bytes(sensor.calibration)
    options = ("--loop", "--keys", str(tmp_path / "card"))
    with start(sensor, tmp_path / "store", *options) as daemon, SharedLine(daemon.port, tmp_path) as line:
        code, _, text = run_host("cal", "flash", str(tmp_path / "calibration"), "--key", "lab", port=line.ports[0])
        assert code == 0, text
        with Connection(line.ports[0]) as host:
            host.checked(zero={"n_frames": 5, "even_if_touched": True})
            assert not host.status().access.is_open
        recorded = bytes(line.sent)
        monkeypatch.setenv("RUFFINI_KEYS", str(tmp_path / "none"))
        with Connection(line.ports[1]) as stranger:
            stranger.subscribe(wrench=1)
            assert next(iter(stranger.stream(timeout_s=HANG_S)), None) is not None
            with pytest.raises(RefusedError, match="changed by its owners only"):
                stranger.checked(zero={"n_frames": 5, "even_if_touched": True})
            before = stranger.hello.sensors[0].calibration.sha256
            n_refused = stranger.status().access.n_refused
            line.send(recorded)  # all of it, the challenges, too
            until(lambda: stranger.status().access.n_refused > n_refused, "a refusal")
            stranger.refresh_hello()  # an answer to what came after all of it
            status = stranger.status()
            assert stranger.hello.sensors[0].calibration.sha256 == before
            assert status.drops.rx_malformed == 0
        code, _, text = run_host("cal", "undo", port=line.ports[1])
        assert (code, "changed by its owners only" in text) == (4, True), text
    with start(sensor, tmp_path / "store", *options, "--no-challenge") as daemon, Connection(daemon.port) as host:
        host.checked(zero={"n_frames": 5, "even_if_touched": True})
        assert host.status().access.is_open


def test_what_a_modem_manager_and_an_echoing_terminal_send_is_counted_and_harmless(
    sensor: Sensor, tmp_path: Path
) -> None:
    with start(sensor, tmp_path / "store", "--loop") as daemon:
        end = os.open(daemon.port, os.O_RDWR | os.O_NOCTTY)
        for probe in (b"AT\r", b"AT+GCAP\r", b"\xff" * 64, b"~\x00x\xf0~", b"+++", b"\x03\x04\x11\x13\r\n" * 10):
            os.write(end, probe)
        with Connection(daemon.port) as host:
            assert host.serial_number == "0001"
            host.subscribe(wrench=1)
            assert next(iter(host.stream(timeout_s=HANG_S)), None) is not None
            status = host.status()
            assert status.drops.rx_malformed + status.drops.rx_bad_crc + status.drops.rx_oversize > 0
        os.close(end)


def test_on_a_line_with_a_hostile_terminal_every_byte_goes_through(sensor: Sensor, tmp_path: Path) -> None:
    """A daemon on a tty in cooked mode, with echo, flow control and newline translation, as a getty leaves it."""
    import termios

    master, slave = os.openpty()
    mode = termios.tcgetattr(slave)
    mode[0] |= termios.IXON | termios.IXOFF | termios.ICRNL | termios.INLCR | termios.ISTRIP | termios.IGNCR
    mode[1] |= termios.OPOST | termios.ONLCR
    mode[3] |= termios.ECHO | termios.ICANON | termios.ISIG | termios.IEXTEN
    termios.tcsetattr(slave, termios.TCSANOW, mode)
    path = tmp_path / "tty"
    path.symlink_to(os.ttyname(slave))
    with start(sensor, tmp_path / "store", "--loop", link=str(path)):
        assert not termios.tcgetattr(slave)[3] & (termios.ECHO | termios.ICANON | termios.ISIG)
        assert not termios.tcgetattr(slave)[0] & (termios.IXON | termios.IXOFF | termios.ICRNL | termios.ISTRIP)
        # The other end's own frames, and every byte, come back from an echoing host: only HELLO is answered.
        os.write(master, bytes(range(256)) + b"\0" + encode_message(1, b"", sensor=255, sequence=0))
        decoder, frames = Decoder(), []
        with guard("HELLO"):
            while not frames:
                frames += list(decoder.feed(os.read(master, 65536)))
        assert [frame.type for frame in frames] == [1]
        os.write(master, encode_message(1, b"", sensor=255, sequence=0, flags=2))  # an echo of the sensor's own
        os.write(master, encode_message(3, b"", sensor=255, sequence=0))
        frames.clear()
        with guard("STATUS"):
            while not frames:
                frames += list(decoder.feed(os.read(master, 65536)))
        status: Any = Schema.own().decode(frames[0].type, frames[0].payload)
        assert status.drops.rx_echo == 1
    os.close(master)
    os.close(slave)
