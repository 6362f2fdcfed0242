"""What the real daemon says of its own health: watchdog, crashes, a stopped process, faults of the picture."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from daemon_time import DaemonTime
from hand_twin import HandTwin, listen, settle
from hang import HANG_S, Patience, until
from test_bad_input import run_host
from test_live_twin import Still
from tiny_twin import Twin

from ruffini.bench import health as bench
from ruffini.daemon import find_daemon
from ruffini.device import Connection
from ruffini.device.zeroing import learn_rest
from ruffini.errors import RefusedError
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import TwinServer

WATCHDOG_US = 600_000


@dataclass
class Running:
    process: subprocess.Popen[str]
    port: str


@contextlib.contextmanager
def daemon(
    twin: Twin, folder: Path, *options: str, board: Path | None = None, notify: Path | None = None
) -> Iterator[Running]:
    """ruffinid on a twin that nothing touches, at its own pace."""
    scenario = Scenario(program="rest", n=1_000_000)
    command = [str(find_daemon()), "--board", str(board or twin.board.folder), "--camera", f"twin:{folder / 'twin'}",
               "--link", "pty", "--store", str(folder / "store"), *options]  # fmt: skip
    with TwinServer(twin.unit.renderer(), Still(twin), scenario, folder / "twin"), started(command, notify) as running:
        yield running


@contextlib.contextmanager
def by_hand(
    twin: Twin, folder: Path, *options: str, notify: Path | None = None
) -> Iterator[tuple[HandTwin, Running]]:  # fmt: skip
    """ruffinid on a twin whose camera the test releases."""
    command = [str(find_daemon()), "--board", str(twin.board.folder), "--camera", f"twin:{folder / 'twin'}",
               "--link", "pty", "--store", str(folder / "store"), *options]  # fmt: skip
    with HandTwin(twin, folder / "twin") as camera, started(command, notify) as running:
        yield camera, running


@contextlib.contextmanager
def started(command: list[str], notify: Path | None) -> Iterator[Running]:
    """A ruffinid, beside a manager's socket where that is given."""
    env = dict(os.environ)
    if notify is not None:
        env |= {"NOTIFY_SOCKET": str(notify), "WATCHDOG_USEC": str(WATCHDOG_US)}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("link: "), process.stderr.read() if process.stderr else line
        yield Running(process, line.removeprefix("link: ").strip())
    finally:
        process.kill()
        process.communicate(timeout=HANG_S)


def crash(running: Running) -> None:
    running.process.send_signal(signal.SIGSEGV)
    assert running.process.wait(HANG_S) == -signal.SIGSEGV


def health(sensor: Connection) -> set[str]:
    return set(sensor.schema.enum_names("HealthBit", sensor.status().health))


@contextlib.contextmanager
def manager(path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(path))
        listener.settimeout(HANG_S)
        yield listener


def test_the_manager_is_told_when_frames_go_through_and_the_watchdog_is_fed(twin: Twin, tmp_path: Path) -> None:
    with (
        manager(tmp_path / "notify") as listener,
        daemon(twin, tmp_path, notify=tmp_path / "notify") as running,
    ):
        said = [listener.recv(64) for _ in range(5)]
        assert said[0] == b"READY=1"
        assert set(said[1:]) == {b"WATCHDOG=1"}
        running.process.send_signal(signal.SIGTERM)
        assert running.process.wait(HANG_S) == 0
        listener.setblocking(False)  # it has ended: all that it said is there
        rest = []
        with contextlib.suppress(BlockingIOError):
            while True:
                rest.append(listener.recv(64))
        assert rest[-1] == b"STOPPING=1"


def test_a_pipeline_that_gives_nothing_is_not_fed(twin: Twin, tmp_path: Path) -> None:
    """Its threads turn, the camera stands still: the manager restarts what it is not told about."""
    time, interval_s = DaemonTime(tmp_path), 1e-6 * WATCHDOG_US / 3
    with (
        manager(tmp_path / "notify") as listener,
        by_hand(twin, tmp_path, *time.options, notify=tmp_path / "notify") as (camera, running),
        Connection(running.port) as sensor,
    ):
        camera.frame()
        assert listener.recv(64) == b"READY=1"
        listener.setblocking(False)

        def n_fed() -> int:
            """Since the last look."""
            n = 0
            with contextlib.suppress(BlockingIOError):
                while True:
                    assert listener.recv(64) == b"WATCHDOG=1"
                    n += 1
            return n

        settle(sensor, 1)
        n_fed()  # that the daemon has started
        for i in range(2, 6):
            camera.frame()
            settle(sensor, i)
            time.advance(interval_s)
            settle(sensor, i)
            assert n_fed() == 1
        for _ in range(10):  # without a frame
            time.advance(interval_s)
            settle(sensor, 5)
        assert n_fed() == 0

        def is_fed() -> bool:
            """One that comes when time has just jumped is taken for an old one."""
            camera.frame()
            settle(sensor, 0)
            return n_fed() > 0

        until(is_fed, "the feeding after the next frame")


def test_a_process_that_was_stopped_shows_one_gap_and_no_old_frames(twin: Twin, tmp_path: Path) -> None:
    """What the camera sent meanwhile waits in its socket, and nothing in it says that it is old."""
    time, period_s, n_before, n_missed = DaemonTime(tmp_path), 1e3 / twin.board.camera.rate_mhz, 20, 60
    with (
        by_hand(twin, tmp_path, *time.options) as (camera, running),
        Connection(running.port) as sensor,
    ):
        sensor.subscribe(wrench=1)
        next_wrench, events = listen(sensor)
        for i in range(n_before):
            time.advance(period_s)
            camera.frame()
            settle(sensor, i + 1)
            before = next_wrench().stamp
        assert (before.frame, before.capture_us) == (n_before - 1, time.now_us)
        running.process.send_signal(signal.SIGSTOP)
        until(lambda: state_of(running.process.pid) == "T", "the stop")
        camera.frame()
        camera.frame()
        camera.number += n_missed  # as a camera does that nobody reads
        time.advance(n_missed * period_s)
        woken_us = time.now_us
        running.process.send_signal(signal.SIGCONT)
        until(camera.is_read, "the frames of the stop")
        while (status := settle(sensor, 0)).frames_processed == n_before:
            time.advance(period_s)
            camera.frame()  # one that comes while the old ones are being passed over may go with them
            until(camera.is_read, "a new frame")
        stamps = [next_wrench().stamp]
        while stamps[-1].frame == before.frame:  # that result, repeated
            assert stamps[-1].capture_us == before.capture_us
            stamps.append(next_wrench().stamp)
    assert stamps[-1].frame >= n_before + 2 + n_missed
    assert stamps[-1].capture_us > woken_us
    assert status.camera_gaps >= n_missed + 2
    assert [event.what for event in events].count("camera_stalled") <= 1


def state_of(pid: int) -> str:
    """Of a process, as the kernel says: T is stopped."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


def test_a_crash_is_told_after_the_restart(twin: Twin, tmp_path: Path) -> None:
    with daemon(twin, tmp_path) as running:
        with Connection(running.port) as sensor:
            assert not sensor.status().HasField("last_run")
        crash(running)
    with daemon(twin, tmp_path) as running:
        with Connection(running.port) as sensor:
            last = sensor.status().last_run
            assert (last.end, last.signal, last.crashes) == (1, signal.SIGSEGV, 1)
            assert "HEALTH_CRASHED" in health(sensor)
        code, text, _ = run_host("info", port=running.port)
        assert code == 0
        assert "the last run crashed with SIGSEGV in thread" in text
        running.process.send_signal(signal.SIGTERM)
        assert running.process.wait(HANG_S) == 0
    with daemon(twin, tmp_path) as running, Connection(running.port) as sensor:
        assert sensor.status().last_run.end == 0
        assert "HEALTH_CRASHED" not in health(sensor)


def test_three_crashes_in_a_row_lead_to_safe_mode_and_a_good_end_out_of_it(twin: Twin, tmp_path: Path) -> None:
    with daemon(twin, tmp_path) as running, Connection(running.port) as sensor:
        sensor.flash(twin.calibration)
        sensor.close()
        crash(running)
    for n in (1, 2):
        with daemon(twin, tmp_path) as running:
            with Connection(running.port) as sensor:
                assert sensor.hello.sensors[0].calibration.present
                assert sensor.status().last_run.crashes == n
            crash(running)
    with daemon(twin, tmp_path) as running:
        with Connection(running.port) as sensor:
            assert not sensor.hello.sensors[0].calibration.present
            assert {"HEALTH_SAFE_MODE", "HEALTH_UNCALIBRATED"} <= health(sensor)
        running.process.send_signal(signal.SIGTERM)
        assert running.process.wait(HANG_S) == 0
        assert running.process.stderr is not None
        assert "no calibration is used" in running.process.stderr.read()
    with daemon(twin, tmp_path) as running, Connection(running.port) as sensor:
        assert sensor.hello.sensors[0].calibration.present


def test_a_reflex_line_that_is_not_there_is_said_and_the_sensor_measures(twin: Twin, tmp_path: Path) -> None:
    assert twin.board.folder is not None
    board = tmp_path / "tiny"
    board.mkdir()
    text = (twin.board.folder / "board.toml").read_text()
    (board / "board.toml").write_text(
        f'{text}\n[reflex]\nchip = "gpiochip99"\nline = "GRIP"\nforce_un = 1\nslip = "none"\nwhen_invalid = "on"\n'
    )
    throttled = tmp_path / "get_throttled"
    throttled.write_text("50005\n")
    with daemon(twin, tmp_path, "--throttled", str(throttled), board=board) as running:
        with Connection(running.port) as sensor:
            assert {"HEALTH_REFLEX", "HEALTH_THROTTLED"} <= health(sensor)
            status = sensor.status()
            assert status.throttled == 0x50005
            assert status.reflex == 3
            sensor.subscribe(wrench=1)
            assert next(m for _, m in sensor.stream(timeout_s=HANG_S) if hasattr(m, "force_z_un")) is not None
        running.process.send_signal(signal.SIGTERM)
        running.process.wait(HANG_S)
        assert running.process.stderr is not None
        said = running.process.stderr.read()
        assert "[reflex]" in said
        assert "gpiochip99" in said


def test_no_fault_lets_a_wrong_force_pass_as_valid(twin: Twin) -> None:
    """Single faults of camera, light and pad: each is flagged within three frames, or leaves every force right."""
    result = bench.run(twin.unit, twin.calibration, full_scale_n=4.0)
    rows = {(row["fault"], row["state"]): row for row in result["rows"]}
    assert result["truth_n"][2] < -0.3
    assert result["n_silent"] == 0, bench.table(result)
    assert all(not row["flags"] for (fault, _), row in rows.items() if fault == "none")
    for fault in ("frozen", "lens cap", "one row black", "lower half black", "noise", "noise in a tenth",
                  "exposure x 5", "exposure x 0.3", "one colour to an eighth", "ten rows white", "one column white",
                  "torn gel, radius 2 mm", "daylight, 0.1 of the level", "spots on 50 %"):  # fmt: skip
        for state in ("untouched", "pressed"):
            assert rows[fault, state]["is_flagged"], f"{fault}, {state}\n{bench.table(result)}"


def test_zero_is_refused_while_something_presses(twin: Twin, tmp_path: Path) -> None:
    """The same twin, pressed by a ball: see test_live_twin for how it is steered."""
    from ruffini.sim.indenters import Indenter
    from ruffini.sim.pose import Pose
    from ruffini.sim.serve import Steered

    steered = Steered(twin.unit, Indenter("sphere", 3e-3))
    command = [str(find_daemon()), "--board", str(twin.board.folder), "--camera", f"twin:{tmp_path / 'twin'}",
               "--link", "pty", "--store", str(tmp_path / "store")]  # fmt: skip
    with (
        TwinServer(twin.unit.renderer(), steered, Scenario(), tmp_path / "twin"),
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process,
    ):
        assert process.stdout is not None
        port = process.stdout.readline().removeprefix("link: ").strip()
        try:
            with Connection(port) as sensor:
                sensor.flash(twin.calibration)
                sensor.subscribe(contacts=1)
                steered.move_to(Pose(0.0, 0.0, 0.6e-3))
                n_pressed, patience = 0, Patience()
                for frame, message in sensor.stream(timeout_s=HANG_S):
                    if sensor.schema.type_name(frame.type) == "CONTACTS":
                        n_pressed = n_pressed + 1 if message.n_found else 0
                    if n_pressed > 10:
                        break
                    assert not patience.is_over(), "the ball never pressed"
                with pytest.raises(RefusedError, match="something presses on the pad"):
                    sensor.checked(zero={"n_frames": 0})
                learn_rest(sensor, even_if_touched=True)
                sensor.subscribe(contacts=1)
                n_found = (m.n_found for f, m in sensor.stream() if sensor.schema.type_name(f.type) == "CONTACTS")
                assert next(n_found) == 0
        finally:
            process.kill()
