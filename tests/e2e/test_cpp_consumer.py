"""The C++ consumer's example on the real daemon's line."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import subprocess
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import pytest
from broken_line import BrokenLine
from hang import HANG_S, guard, until
from tiny_sensor import N_FRAMES, ROOT, Sensor, start
from told_sensor import SCHEMA, Messages, ToldSensor, info_of

import ruffini
from ruffini.boards import find_board
from ruffini.daemon import find_daemon
from ruffini.device import Connection, Wrench
from ruffini.device.results import VALID
from ruffini.wire import Schema
from ruffini.wire.framing import Decoder, encode_message


def program() -> Path:
    return find_daemon().parent / "host" / "cpp" / "ruffini_newtons"


def newtons(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([program(), *arguments], capture_output=True, text=True, timeout=HANG_S, check=False)


TIOCGEXCL = 0x80045440  # whether a terminal is exclusive


def wrenches(sensor: Sensor, store: Path) -> list[Wrench]:
    """Of each frame as ruffini's own host tool has it."""
    with start(sensor, store, "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host.subscribe(wrench=1)
        out: list[Wrench] = []
        for frame, message in host.stream(timeout_s=HANG_S):
            if host.schema.type_name(frame.type) == "WRENCH":
                out.append(Wrench.from_message(message))
            if len(out) == N_FRAMES:
                break
    return out


def test_the_example_prints_the_newtons_that_the_host_tool_has(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--loop") as daemon, Connection(daemon.port) as host:
        host.flash(sensor.calibration)
    want = wrenches(sensor, tmp_path)
    with start(sensor, tmp_path, "--lockstep", "--wait-for-host") as daemon:
        done = newtons(daemon.port, str(N_FRAMES))
    assert done.returncode == 0, done.stderr
    assert "0001, calibrated" in done.stderr
    assert "0 damaged frames, 0 messages lost" in done.stderr
    assert all(line.endswith("SIMULATED") for line in done.stdout.splitlines())
    lines = [line for line in done.stdout.splitlines() if " contact " not in line]
    contacts = [line for line in done.stdout.splitlines() if " contact " in line]
    assert len(lines) == N_FRAMES
    n_rest = sensor.board.pipeline.n_rest_frames
    assert all("fz +nan" in line and "flags" in line and "not for control" in line for line in lines[:n_rest])
    is_stated = [w.covariance_validity == VALID for w in want]
    assert ["sigma of fz" in line for line in lines] == is_stated
    assert contacts
    assert {line.split()[1] for line in contacts} <= {line.split()[1] for line in lines[n_rest:]}
    got = [float(re.search(r"fz (\S+) N", line)[1]) for line in lines[n_rest:]]  # type: ignore[index]
    assert got == pytest.approx([w.values[2] for w in want[n_rest:]], abs=5.1e-4)  # three digits are printed
    assert got[-1] < -0.1


def test_results_that_arrive_with_the_reply_are_printed() -> None:
    """On a busy computer one read() returns the reply to SUBSCRIBE and the first results."""
    schema = Schema.own()

    def packet(sequence: int, name: str, **fields: Any) -> bytes:
        payload = schema.new(name, **fields).SerializeToString()
        return encode_message(schema.type_numbers[name.upper()], payload, sensor=0, sequence=sequence, flags=0)

    master, slave = pty.openpty()
    tty.setraw(slave)
    with subprocess.Popen([program(), os.ttyname(slave), "3"], stdout=subprocess.PIPE, text=True) as example:
        decoder = Decoder(from_host=True)
        while example.poll() is None:
            if not select.select([master], [], [], 0.1)[0]:
                continue
            for frame in decoder.feed(os.read(master, 4096)):
                if schema.type_name(frame.type) == "HELLO":
                    os.write(master, packet(0, "Hello", device_serial="0001"))
                elif schema.type_name(frame.type) == "COMMAND":
                    asked = schema.decode(frame.type, frame.payload)
                    frames = b"".join(packet(i, "Wrench", stamp={"frame": i}) for i in (2, 3, 4))
                    os.write(master, packet(1, "Reply", request_id=asked.request_id) + frames)  # type: ignore[union-attr]
        assert example.stdout is not None
        assert [line.split()[1] for line in example.stdout] == ["2", "3", "4"]
    os.close(master)
    os.close(slave)


class Device(ToldSensor):
    """A made-up sensor of this computer's clock; its frames wait until it has answered TIME."""

    def __init__(self, tell: Any, serial: str = "told", rate_hz: float | None = None) -> None:
        super().__init__([info_of(find_board("gelslim"))], tell, rate_hz=rate_hz, serial=serial)
        self.is_timed = threading.Event()

    def _answer(self, frame: Any) -> None:
        super()._answer(frame)
        if SCHEMA.type_name(frame.type) == "TIME":
            now_us = time.monotonic_ns() // 1000
            token = SCHEMA.decode(frame.type, frame.payload).token  # type: ignore[union-attr]
            self._send("TIME", SCHEMA.new("Time", token=token, received_us=now_us, sent_us=now_us), 255)
            self.is_timed.set()


def wrench(stamp: Any, *, flags: int = 0, validity: int = 1, variance_un2: int = 100, late_s: float = -5.0) -> Any:
    """Captured `late_s` ago; before 0, so that a busy computer does not make it old."""
    stamp.flags, stamp.capture_us = flags, stamp.capture_us - int(late_s * 1e6)
    return SCHEMA.new("Wrench", stamp=stamp, force_z_un=-500_000, validity=[1, 1, validity, 1, 1, 1],
                      covariance=[variance_un2] * 21, covariance_validity=1)  # fmt: skip


def test_a_force_is_usable_for_control_or_not() -> None:
    cases: list[tuple[bool, int, dict[str, Any]]] = [  # usable, health, wrench
        (True, 0, {}), (True, 2 | 8 | 256 | 512 | 1024 | 4096, {}), (True, 0, {"flags": 2}),
        (False, 1 << 14, {}), (False, 1 << 17, {}), (False, 0, {"flags": 512}), (False, 0, {"flags": 131_072}),
        (False, 0, {"flags": 1 << 19}), (False, 0, {"validity": 2}), (False, 0, {"variance_un2": 60_000**2}),
        (False, 0, {"late_s": 1.0}), (True, 0, {}),
    ]  # fmt: skip

    def tell(number: int, stamp: Any) -> Messages:
        _, health, made = cases[number] if number < len(cases) else cases[0]
        event = {"EVENT": SCHEMA.new("Event", what="told_event", text="one sentence")} if number == 0 else {}
        return {**event, "STATUS": SCHEMA.new("Status", health=health), "WRENCH": wrench(stamp, **made)}

    with Device(tell) as device, running(device.port, str(len(cases) + 1)) as example:
        assert device.is_timed.wait(HANG_S)
        assert example.stdout is not None
        device.send(len(cases))
        said = [example.stdout.readline() for _ in cases]
        for _ in range(2):
            os.write(device.master, b"\x02\x07\x00")
        device.send()
        after, notes = example.communicate(timeout=HANG_S)
    assert [line.endswith("  usable  SIMULATED\n") for line in said] == [case[0] for case in cases]
    assert all("fz -0.500 N  sigma of fz 0.000 N" in line for line in (said[0], said[-1], after))
    assert after.endswith("  not for control  SIMULATED\n"), "two damaged frames"
    assert "two damaged frames within six minutes" in notes
    assert "told_event: one sentence" in notes
    assert "2 damaged frames" in notes


@contextlib.contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [program(), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as example:
        try:
            yield example
        finally:
            example.kill()


def test_a_stalled_camera_is_reported_and_its_repeated_results_are_no_frames() -> None:
    def tell(n: int, stamp: Any) -> Messages:
        return {"STATUS": SCHEMA.new("Status"), "WRENCH": wrench(stamp, flags=256 if 1 < n < 80 else 0)}

    with Device(tell, rate_hz=10) as device:
        done = newtons(device.port, "3")
    assert done.returncode == 0
    assert done.stderr.count("no new frame for five seconds") == 1
    assert done.stdout.count("flags 256") == 78
    assert "frame 80 " in done.stdout.splitlines()[-1]


def test_a_force_that_ages_is_reported_while_no_other_comes() -> None:
    def tell(n: int, stamp: Any) -> Messages:
        return {"STATUS": SCHEMA.new("Status"), **({"WRENCH": wrench(stamp, late_s=-2.0)} if n < 10 else {})}

    with Device(tell, rate_hz=10) as device, running(device.port) as example, guard("the note"):
        assert example.stderr is not None
        notes = list(lines_until(example.stderr, "hold still"))
    assert not any("the line was lost" in note for note in notes)


def lines_until(stream: IO[str], end: str) -> Iterator[str]:
    """Lines up to the one with `end`, which must come."""
    for line in stream:
        yield line
        if end in line:
            return
    raise AssertionError(f"the program ended without {end!r}")


def test_a_subscription_that_another_program_took_is_noticed_and_renewed() -> None:
    """TIME is answered all the same; STATUS comes to subscribers only. The force of before is not used any more."""

    def tell(n: int, stamp: Any) -> Messages:
        return {"STATUS": SCHEMA.new("Status"), "WRENCH": wrench(stamp, late_s=-100.0)} if n < 1 else {}

    with Device(tell) as device, running(device.port) as example:
        assert device.is_timed.wait(HANG_S)
        assert example.stdout is not None
        assert example.stderr is not None
        device.send()
        assert example.stdout.readline().endswith("  usable  SIMULATED\n")
        with guard("the notes"):
            notes = list(lines_until(example.stderr, "the line was lost"))
        until(lambda: sum(c.WhichOneof("action") == "subscribe" for c in device.commands) == 2, "another subscription")
        assert not fcntl.ioctl(device.slave, TIOCGEXCL, b"\0" * 4).strip(b"\0"), "another program can open the pty"
    assert "hold still" in notes[-2]


def test_it_goes_on_where_the_line_was_lost(sensor: Sensor, tmp_path: Path) -> None:
    with (
        start(sensor, tmp_path / "store", "--loop") as daemon,
        BrokenLine(daemon.port, tmp_path) as line,
        running(line.port, "300") as example,
    ):
        assert example.stdout is not None
        assert "frame" in example.stdout.readline()
        line.unplug()
        time.sleep(0.5)  # it looks for the line five times a second
        line.plug_in()
        assert example.stderr is not None
        with guard("the end"):
            said, notes = example.stdout.read(), example.stderr.read()
        assert example.wait(HANG_S) == 0, notes
    n_lost = notes.count("the line was lost")  # once more on a computer that has no time for it: 3 s without STATUS
    assert 1 <= n_lost == notes.count("0001, no calibration") - 1
    assert len(said.splitlines()) >= 299


def test_it_does_not_go_on_with_another_sensor(tmp_path: Path) -> None:
    port = tmp_path / "line"
    with Device(lambda _, stamp: {"WRENCH": wrench(stamp)}, serial="one", rate_hz=30) as one:
        port.symlink_to(one.port)
        example = subprocess.Popen(
            [str(program()), str(port)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert example.stdout is not None
        with guard("a frame"):  # it has read the answer to its subscription
            assert "frame" in example.stdout.readline()
    port.unlink()
    with Device(lambda _, stamp: {"WRENCH": wrench(stamp)}, serial="other") as other:
        port.symlink_to(other.port)
        _, notes = example.communicate(timeout=HANG_S)
    assert example.returncode == 3
    assert "another sensor: other" in notes


def test_python_has_what_the_rule_for_control_asks(sensor: Sensor, tmp_path: Path) -> None:
    text = (ROOT / "docs" / "how-to" / "use-forces-for-control.md").read_text()
    call = re.search(r"`(sensor\.call\(.*\))` returns", text)
    assert call is not None
    with start(sensor, tmp_path, "--loop") as daemon, ruffini.connect(daemon.port) as device:
        is_unfit, health = eval(call[1], {"sensor": device, "time": time})
    assert not is_unfit
    assert health & 1, "HEALTH_UNCALIBRATED"


def test_the_example_says_what_is_wrong(tmp_path: Path) -> None:
    assert newtons().returncode == 2
    nowhere = newtons(str(tmp_path / "ttyACM0"))
    assert nowhere.returncode == 3
    assert "No such file" in nowhere.stderr
