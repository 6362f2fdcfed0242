"""A pad of a MuJoCo world through the twin's camera, the real daemon and the public client; then the cable is loose."""

import csv
import os
import signal
import sys
import threading
import time
from pathlib import Path

import pytest
from hang import HANG_S, until
from test_bad_input import run_host
from test_lerobot import camera, plugin  # noqa: F401
from tiny_sensor import ROOT
from tiny_twin import Twin

pytest.importorskip("mujoco", reason="extra [robot]")

import ruffini
from ruffini.device import Connection
from ruffini.errors import RuffiniError
from ruffini.robot import World
from ruffini.robot.live import HeldSensor, Live
from ruffini.robot.pad_camera import PadCamera

sys.path.insert(0, str(ROOT / "tests" / "py" / "robot"))
from worlds import scale

PRESS_N = 0.5


@pytest.fixture
def live(twin: Twin):
    xml = scale('type="sphere" size=".015"')
    with World(xml, {"pad": twin.board}, is_feeling=False) as world, Live(world) as live:
        with Connection(live.ports["pad"]) as host:
            host.flash(twin.calibration)
        yield live


def test_the_daemon_feels_the_world_and_its_end_holds_the_grip(live: Live) -> None:
    with ruffini.connect(live.ports["pad"], resume_s=0.2) as sensor:
        held = HeldSensor(sensor)
        frames = []

        def felt() -> bool:
            live.step()
            if (frame := held.newest()) is not None:
                frames.append(frame)
            return bool(frames)

        until(felt, "a valid frame")
        assert abs(frames[-1].wrench.force[2]) < 0.05
        live.world.data.ctrl[2] = -PRESS_N
        for _ in range(30):
            live.step()
        frames.clear()
        until(felt, "a valid frame")
        frames.clear()
        until(felt, "a valid frame")
        frame, true_n = frames[-1], live.world.pads["pad"].wrench[2]
        assert frame.is_simulated
        assert true_n == pytest.approx(-PRESS_N, abs=0.01)
        assert frame.wrench.force[2] == pytest.approx(true_n, abs=0.05 + 0.15 * PRESS_N)
        os.kill(live.daemons["pad"].pid, signal.SIGKILL)
        end = time.monotonic() + 20
        while not held.problem and time.monotonic() < end:
            live.step()
            held.newest()
        assert "the grip is held" in held.problem
        assert live.ports["pad"] in held.problem
        assert held.newest() is None
        before = live.world.data.qpos.copy()
        for _ in range(20):  # the world goes on under the last command
            live.step()
        assert abs(live.world.data.qpos - before).max() < 1e-4


def test_a_camera_that_dies_is_silence_and_the_world_goes_on(live: Live) -> None:
    with ruffini.connect(live.ports["pad"]) as sensor:
        held = HeldSensor(sensor)

        def is_heard() -> bool:
            live.step()
            return held.newest() is not None

        until(is_heard, "a valid frame")
        os.kill(live.cameras["pad"].pid, signal.SIGSTOP)
        for _ in range(1000):  # more than a socket holds: the physics never waits for a camera
            live.cameras["pad"].show(live.world.pads["pad"].contact.surface_displacement())
        os.kill(live.cameras["pad"].pid, signal.SIGKILL)

        def is_silent() -> bool:
            live.step()
            held.newest()
            return bool(held.problem)

        until(is_silent, "silence")
        assert "the grip is held" in held.problem


def test_a_camera_that_cannot_start_is_said(twin: Twin, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "twin.socket").mkdir()
    camera = PadCamera(twin.unit.renderer(), tmp_path / "twin.socket", seed=1)
    with camera, pytest.raises(RuffiniError, match="did not start"):
        camera.wait()
    assert "cannot serve there" in capfd.readouterr().err


@pytest.fixture
def pressed(live: Live):
    """A ball rests on the pad, and another thread steps the world."""
    live.world.data.ctrl[2] = -PRESS_N
    is_over = threading.Event()

    def go_on() -> None:
        while not is_over.is_set():
            live.step()

    thread = threading.Thread(target=go_on)
    thread.start()
    yield live
    is_over.set()
    thread.join()


def test_what_reads_hardware_reads_a_pad_of_a_world(pressed: Live, plugin, tmp_path: Path) -> None:  # noqa: F811
    """LeRobot's camera, `ruffini record` with ROS 2 messages, and `ruffini export`."""
    port = pressed.ports["pad"]
    with camera(plugin, port) as cam:
        cam.connect()

        def is_felt() -> bool:
            cam.async_read(1e3 * HANG_S)
            return cam.touch.wrench[2] < -0.8 * PRESS_N

        until(is_felt, "the press")
        assert cam.touch.is_simulated
    mcap, table = tmp_path / "episode.mcap", tmp_path / "episode.csv"
    code, _, error = run_host("--port", port, "record", str(mcap), "--n", "8", "--json")
    assert code == 0, error
    code, _, error = run_host("export", str(mcap), "--out", str(table), "--json")
    assert code == 0, error
    with table.open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["is_stale"] == "0" and row["force_z_n"]]
    assert len(rows) > 2  # of eight: a busy computer repeats results, and drops messages of a frame
    assert {row["is_simulated"] for row in rows} == {"1"}
    assert float(rows[-1]["force_z_n"]) == pytest.approx(-PRESS_N, abs=0.05 + 0.15 * PRESS_N)
    assert b"geometry_msgs" in mcap.read_bytes()
