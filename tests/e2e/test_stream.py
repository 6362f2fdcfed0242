"""From frames to newtons over a real serial line."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from hang import HANG_S, until
from tiny_sensor import MILLI_CELSIUS, N_FRAMES, N_REST, Sensor, start

from ruffini.daemon import find_daemon
from ruffini.device import Connection, Field, Wrench
from ruffini.device.results import NOT_MEASURED, VALID
from ruffini.errors import LineLostError, NoDeviceError, RefusedError
from ruffini.wire import Decoder, Schema, encode_message

EVERYTHING = {"wrench": 1, "field": 1, "depth": 1, "contacts": 1, "markers": 1, "image": 1}
NO_REFERENCE = 1


def read_all(sensor: Connection, *, timeout_s: float = 20.0) -> list[tuple[str, object, object]]:
    """(type, frame, message) until the recording ends and the daemon with it."""
    out = []
    try:
        for frame, message in sensor.stream(timeout_s=timeout_s):
            out.append((sensor.schema.type_name(frame.type), frame, message))
    except NoDeviceError:
        pass  # the daemon went with its recording
    return out


def test_every_frame_arrives_with_everything_and_the_press_is_in_it(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        assert host.hello.device_serial == "0001"
        assert not host.hello.sensors[0].calibration.present
        host.flash(sensor.calibration)
        assert host.hello.sensors[0].calibration.development_key
        host.subscribe(**EVERYTHING)
        got = read_all(host)
    for name in EVERYTHING:
        frames = [m.stamp.frame for t, _, m in got if t == name.upper()]
        assert frames == list(range(N_FRAMES)), name
    assert all(f.is_simulated and f.is_replay for _, f, _ in got)
    wrench = [Wrench.from_message(m) for t, _, m in got if t == "WRENCH"]
    n_rest = sensor.board.pipeline.n_rest_frames
    assert all(w.flags & NO_REFERENCE and w.validity[2] != VALID for w in wrench[:n_rest])
    assert all(w.validity[2] == VALID for w in wrench[n_rest:])
    untouched = np.array([w.values[:3] for w in wrench[n_rest:N_REST]])
    pressed = wrench[-1].values
    assert np.abs(untouched).max() < 0.02
    assert pressed[2] < -0.1
    assert np.hypot(*pressed[:2]) < 0.2 * -pressed[2]
    contacts = [m for t, _, m in got if t == "CONTACTS"]
    assert [len(c.contacts) for c in contacts[:N_REST]] == [0] * N_REST
    assert len(contacts[-1].contacts) == 1
    assert contacts[-1].contacts[0].force_z_un == pytest.approx(pressed[2] * 1e6, rel=0.05)
    # Three nodes press: too few to tell a state, but each has its own in the field.
    assert not contacts[-1].contacts[0].HasField("slip")
    slip = [Field.from_message(m).slip for t, _, m in got if t == "FIELD"]
    assert slip[0] is None  # no force yet, and no slip
    assert slip[-1] is not None
    assert slip[-1].any()


def test_without_a_calibration_there_is_no_force(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host.subscribe(wrench=1)
        wrench = [Wrench.from_message(m) for t, _, m in read_all(host) if t == "WRENCH"]
    assert len(wrench) == N_FRAMES
    assert {v for w in wrench for v in w.validity} == {NOT_MEASURED}
    assert np.isnan([w.values for w in wrench]).all()


def test_a_calibration_survives_a_restart(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host.flash(sensor.calibration)
        first = host.hello.sensors[0].calibration.sha256
    with start(sensor, tmp_path, "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        assert host.hello.sensors[0].calibration.sha256 == first


def test_a_calibrated_daemon_that_replays_pictures_takes_little_memory(
    sensor: Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Within 250 MB of address space; its memory is its tables, its pictures and 16 MB, without OpenCV's readers."""
    bounded = tmp_path / "bounded"
    bounded.write_text(f'#!/bin/sh\nulimit -v 250000\nexec {find_daemon()} "$@"\n')
    bounded.chmod(0o755)
    monkeypatch.setenv("RUFFINI_DAEMON", str(bounded))
    store = tmp_path / "store"
    with start(sensor, store, "--loop") as daemon, Connection(daemon.port) as host:
        host.flash(sensor.calibration)
    with start(sensor, store, "--loop") as daemon, Connection(daemon.port) as host:
        host.subscribe(**EVERYTHING)
        n_wrenches = 0
        for frame, _ in host.stream(timeout_s=HANG_S):
            n_wrenches += host.schema.type_name(frame.type) == "WRENCH"
            if n_wrenches == 2 * N_FRAMES:
                break
        status = Path(f"/proc/{daemon.process.pid}/status").read_text()
    peak_kib = int(re.search(r"VmHWM:\s*(\d+) kB", status)[1])  # type: ignore[index]
    frame_bytes = 3 * sensor.board.camera.width_px * sensor.board.camera.height_px
    assert 1024 * peak_kib < len(sensor.calibration) + 30 * frame_bytes + 16e6


def test_zero_learns_anew_and_says_so(sensor: Sensor, tmp_path: Path) -> None:
    def learning(host: Connection, n: int) -> list[bool]:
        out: list[bool] = []
        for frame, message in host.stream(timeout_s=HANG_S):
            if host.schema.type_name(frame.type) == "WRENCH":
                out.append(bool(message.stamp.flags & NO_REFERENCE))
            if len(out) == n:
                break
        return out

    with start(sensor, tmp_path, "--lockstep", "--loop", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host.subscribe(wrench=1)
        while learning(host, 1) == [True]:
            pass
        host.checked(zero={"n_frames": 20})
        flags: list[bool] = []

        def is_learned() -> bool:
            """Frames of before the command's reply come first, on a busy computer hundreds of them."""
            flags.extend(learning(host, 10))
            return any(flags) and not any(flags[-10:])

        until(is_learned, "frames after those of which it learns")
    assert sum(flags) == 20


def test_a_host_that_does_not_read_costs_telemetry_and_no_reply(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--loop") as daemon, Connection(daemon.port) as host:
        host.subscribe(image=1, depth=1, wrench=1)

        def costs_telemetry() -> bool:
            """Nobody reads while the line fills and a few frames more come; then all that waits is read."""
            until(lambda: host._serial.in_waiting >= 4_095, "a line that is full")
            time.sleep(0.05)
            return host.status().drops.link_backpressure > 0

        until(costs_telemetry, "telemetry that was replaced")
        assert daemon.process.poll() is None
        host.subscribe(wrench=1)
        status = host.status()
    assert [(t.place, t.milli_celsius) for t in status.temperatures] == [("gel", MILLI_CELSIUS)]


def test_a_new_host_on_the_same_line_is_answered(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--loop") as daemon:
        for _ in range(3):
            with Connection(daemon.port) as host:
                host.subscribe(image=1, wrench=1)
                next(iter(host.stream(timeout_s=HANG_S)))
        assert daemon.process.poll() is None


def test_a_host_that_goes_takes_its_subscriptions_with_it(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--loop") as daemon:
        with Connection(daemon.port) as host:
            host.subscribe(**EVERYTHING)
            next(iter(host.stream(timeout_s=HANG_S)))

        def is_quiet() -> bool:
            """What is not asked for does not come: frames were processed, and only the answers about them are here."""
            with Connection(daemon.port) as host:
                n_before = host.status().frames_processed
                until(lambda: host.status().frames_processed >= n_before + 5, "five frames more")
                heard = {host.schema.type_name(host.messages.popleft()[0].type) for _ in range(len(host.messages))}
                return heard <= {"EVENT"}  # a busy machine's stall is said to whoever is there

        until(is_quiet, "silence")  # the device sees a host that goes in its own time
        with Connection(daemon.port) as host:
            host.subscribe(wrench=1)
            assert next(iter(host.stream(timeout_s=HANG_S)))


def test_a_host_that_goes_does_not_hold_up_lockstep(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--lockstep", "--wait-for-host") as daemon:
        with Connection(daemon.port) as host:
            host.subscribe(**EVERYTHING)
            next(iter(host.stream(timeout_s=HANG_S)))
        assert daemon.process.wait(HANG_S) == 0


def test_a_line_that_is_unplugged_is_opened_again(sensor: Sensor, tmp_path: Path) -> None:
    schema = Schema.own()

    def plug_in() -> int:
        far, near = os.openpty()
        (tmp_path / "new").symlink_to(os.ttyname(near))
        (tmp_path / "new").rename(tmp_path / "tty")
        os.close(near)
        os.set_blocking(far, False)
        return far

    def says_hello(far: int) -> bool:
        decoder = Decoder()

        def is_answered() -> bool:
            with contextlib.suppress(OSError):  # the device may not have it open yet
                os.write(far, b"\0" + encode_message(schema.type_numbers["HELLO"], b"", sensor=255, sequence=0))
            with contextlib.suppress(OSError):
                return any(schema.type_name(f.type) == "HELLO" for f in decoder.feed(os.read(far, 65536)))
            return False

        return until(is_answered, "HELLO")

    line = plug_in()
    with start(sensor, tmp_path / "store", "--loop", link=str(tmp_path / "tty")) as daemon:
        assert says_hello(line)
        os.close(line)
        line = plug_in()
        assert says_hello(line)
        assert daemon.process.poll() is None
        os.close(line)


def test_get_and_set(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--loop") as daemon, Connection(daemon.port) as host:
        first = host.checked(get={"key": "frames_processed"}).value
        until(lambda: host.checked(get={"key": "frames_processed"}).value > first, "a frame")
        for action in ({"get": {"key": "humour"}}, {"set": {"key": "frames_processed", "value": 0}}):
            with pytest.raises(RefusedError, match="this firmware has frames_processed"):
                host.checked(**action)


def test_noise_on_the_line_is_counted_and_hello_answers(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--loop") as daemon:
        line = os.open(daemon.port, os.O_RDWR | os.O_NOCTTY)
        rng = np.random.default_rng(5)
        for _ in range(256):
            os.write(line, rng.bytes(4096))
        os.close(line)
        with Connection(daemon.port) as host:
            host._send("STATUS")
            status = host._wait_for("STATUS", HANG_S, lambda m: True)
    assert status.drops.rx_malformed + status.drops.rx_bad_crc + status.drops.rx_oversize > 1000


@pytest.mark.realtime
def test_sigterm_ends_it_cleanly_within_a_second(sensor: Sensor, tmp_path: Path) -> None:
    """Its threads look for the end every 10 ms or so: the margin is a hundredfold."""
    with start(sensor, tmp_path, "--loop") as daemon, Connection(daemon.port) as host:
        host.subscribe(**EVERYTHING)
        next(iter(host.stream(timeout_s=HANG_S)))
        began = time.monotonic()
        daemon.process.send_signal(signal.SIGTERM)
        assert daemon.process.wait(HANG_S) == 0
        assert time.monotonic() - began < 1


@pytest.mark.realtime
def test_a_reader_that_stands_still_loses_nothing_of_a_recording(sensor: Sensor, tmp_path: Path) -> None:
    """The daemon waits 20 s for it: the margin is fivefold."""
    with start(sensor, tmp_path, "--lockstep", "--wait-for-host") as daemon, Connection(daemon.port) as host:
        host.subscribe(**EVERYTHING)
        got = []
        with contextlib.suppress(LineLostError):  # it has ended
            for frame, message in host.stream(timeout_s=HANG_S):
                if host.schema.type_name(frame.type) == "WRENCH":
                    got.append(message.stamp.frame)
                    if len(got) == 10:
                        time.sleep(4)
    assert got == list(range(N_FRAMES))


def test_a_calibration_swapped_while_streaming_never_shows_a_force_of_another_table(
    sensor: Sensor, tmp_path: Path
) -> None:
    with start(sensor, tmp_path, "--loop") as daemon, Connection(daemon.port) as host:
        host.subscribe(wrench=1)
        host.flash(sensor.calibration)
        active = int.from_bytes(host.hello.sensors[0].calibration.sha256[:4], "big")
        got = []
        for frame, message in host.stream(timeout_s=HANG_S):  # what came meanwhile comes first
            if host.schema.type_name(frame.type) == "WRENCH":
                got.append(message)
            if len(got) > 30 and got[-1].stamp.calibration_id == active:
                break
    ids = {m.stamp.calibration_id for m in got}
    assert ids <= {0, active}
    for m in got:
        assert (m.stamp.calibration_id == active) or VALID not in list(m.validity)
