"""ruffinid with the live twin as its camera: forces come out, faults are flagged, a controller closes the loop."""

from __future__ import annotations

import contextlib
import signal
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from daemon_time import DaemonTime
from hand_twin import HandTwin, listen, settle, stalling_host
from hang import HANG_S, Patience, finished, until
from test_bad_input import run_host
from tiny_twin import Twin

from ruffini.boards import find_board
from ruffini.daemon import find_daemon, running_daemon
from ruffini.device import Connection, flashing
from ruffini.errors import RefusedError, RuffiniError
from ruffini.record import Recording
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import Resting, Scripted, States, Steered, TwinServer
from ruffini.sim.settings import load_twin

MM = 1e-3


@contextlib.contextmanager
def connected(twin: Twin, folder: Path, *options: str) -> Iterator[Connection]:
    assert twin.board.folder is not None
    with (
        running_daemon(twin.board.folder, f"twin:{folder / 'twin'}", folder / "store", *options) as port,
        Connection(port) as sensor,
    ):
        sensor.flash(twin.calibration)
        sensor.subscribe(wrench=1, status=1)
        yield sensor


def wrenches(sensor: Connection, timeout_s: float = HANG_S) -> Iterator[tuple[bool, object]]:
    """(is_simulated, WRENCH message) as they come, until the twin ends."""
    with contextlib.suppress(RuffiniError):
        for frame, message in sensor.stream(timeout_s=timeout_s):
            if sensor.schema.type_name(frame.type) == "WRENCH":
                yield frame.is_simulated, message


def flags(sensor: Connection, message: object) -> set[str]:
    return set(sensor.schema.enum_names("FlagBit", message.stamp.flags))


class Felt(Steered):
    """Knows what the ball did to the pad in each frame."""

    def __init__(self, twin: Twin) -> None:
        super().__init__(twin.unit, Indenter("sphere", 3 * MM))
        self.forces_n: list[float] = []  # along z, by frame

    def states(self, frame: int) -> States | None:
        found = super().states(frame)
        self.forces_n.append(float(self.wrench[2]))
        return found


def test_a_controller_closes_the_loop(twin: Twin, tmp_path: Path) -> None:
    """Push until the sensor says 1 N; the truth agrees within a quarter, and the ball is not at its limit.

    In lockstep a message has its camera frame's number: of frames that were under way when the ball moved, the
    controller waits for the last.
    """
    ball, depth_mm, moved_at, patience = Felt(twin), 0.0, 0, Patience()
    with (
        TwinServer(twin.unit.renderer(), ball, Scenario(), tmp_path / "twin"),
        connected(twin, tmp_path, "--lockstep") as sensor,
    ):
        for is_simulated, message in wrenches(sensor):
            assert is_simulated
            assert not patience.is_over(), "the force never came"
            # FLAG_REST_UNVERIFIED: of a new store's first start.
            if message.stamp.frame <= moved_at or flags(sensor, message) - {"FLAG_REST_UNVERIFIED"}:
                continue
            if message.force_z_un < -1_000_000:
                break
            assert depth_mm < 1.2
            depth_mm += 0.04
            ball.move_to(Pose(MM, 0.5 * MM, depth_mm * MM))
            moved_at = len(ball.forces_n)
        else:
            pytest.fail("the stream ended before the force came")
    assert message.force_z_un * 1e-6 == pytest.approx(ball.forces_n[message.stamp.frame], rel=0.25)


def test_faults_are_flagged_in_the_frames_that_have_them(twin: Twin, tmp_path: Path) -> None:
    n_rest = twin.board.pipeline.n_rest_frames
    at = {"lens_cap": n_rest + 10, "over_exposure": n_rest + 20, "stall": n_rest + 30}
    scenario = Scenario.model_validate(
        {"schema": 1, "program": "rest", "n": n_rest + 45, "fault": [
            {"kind": "lens_cap", "first_frame": at["lens_cap"], "n_frames": 3},
            {"kind": "over_exposure", "factor_1e3": 5000, "first_frame": at["over_exposure"], "n_frames": 3},
            {"kind": "stall", "first_frame": at["stall"], "n_frames": 5},
        ]}
    )  # fmt: skip
    frames = Scripted(twin.unit, scenario)
    seen = {}
    with (
        TwinServer(twin.unit.renderer(), frames, scenario, tmp_path / "twin"),
        connected(twin, tmp_path, "--lockstep", "--wait-for-host") as sensor,
    ):
        for _, message in wrenches(sensor):
            seen[message.stamp.frame] = flags(sensor, message)
            # In lockstep a frame is of its own time, whenever it comes.
            assert message.stamp.capture_us == message.stamp.frame * 10**9 // twin.board.camera.rate_mhz
    assert set(range(len(frames))) - set(seen) == set(range(at["stall"], at["stall"] + 5))
    dark = {i for i, names in seen.items() if "FLAG_DARK" in names}
    full = {i for i, names in seen.items() if "FLAG_OVEREXPOSED" in names}
    assert dark == set(range(at["lens_cap"], at["lens_cap"] + 3))
    assert full == set(range(at["over_exposure"], at["over_exposure"] + 3))


def test_a_camera_that_stands_still_is_said_at_once(twin: Twin, tmp_path: Path) -> None:
    """After three of its intervals: an event and stale wrenches; none of them is taken for a new frame."""
    time, period_s, n = DaemonTime(tmp_path), 1e3 / twin.board.camera.rate_mhz, 20
    with (
        HandTwin(twin, tmp_path / "twin") as camera,
        running_daemon(
            twin.board.folder, f"twin:{tmp_path / 'twin'}", tmp_path / "store", *time.options  # type: ignore[arg-type]
        ) as port,
        Connection(port) as sensor,
    ):  # fmt: skip
        sensor.subscribe(wrench=1)
        next_wrench, events = listen(sensor)
        for i in range(n):
            time.advance(period_s)
            camera.frame()
            settle(sensor, i + 1)
            message = next_wrench()
            assert message.stamp.frame == i
            assert message.stamp.capture_us == time.now_us
            assert "FLAG_STALE" not in flags(sensor, message)
        last_us = time.now_us

        def is_stalled() -> bool:
            return "HEALTH_CAMERA_STALLED" in sensor.schema.enum_names("HealthBit", settle(sensor, 0).health)

        time.advance(3 * period_s)
        assert not is_stalled()
        time.advance(1e-6)
        assert is_stalled()
        for _ in range(5):
            stale = next_wrench()
            assert "FLAG_STALE" in flags(sensor, stale)
            assert (stale.stamp.frame, stale.stamp.capture_us) == (n - 1, last_us)
            assert 1 not in stale.validity
            time.advance(0.1)
        while settle(sensor, 0).frames_processed == n:
            time.advance(period_s)
            camera.frame()  # one sent when time has just jumped is passed over as old
            until(camera.is_read, "a frame")
        while next_wrench().stamp.frame < n:  # stale ones
            pass
        assert not is_stalled()
        assert [event.what for event in events] == ["camera_stalled", "camera_back"]
        assert "no good frame for 150 ms" in events[0].text


def test_a_recording_of_so_many_frames_does_not_count_what_was_repeated(
    twin: Twin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out, text = with_a_stall(twin, tmp_path, monkeypatch, "record", str(tmp_path / "run.mcap"), "--n", "30")
    assert code == 0, text
    frames = list(Recording(tmp_path / "run.mcap").frames(partial=True))
    n_repeated = sum(frame.is_stale for frame in frames)
    assert n_repeated >= 6  # one more where the first frame after the stall is passed over as old
    assert sum(not frame.is_stale for frame in frames) == 30
    assert f"30 frames, {n_repeated} repeated results" in out


def test_monitor_says_what_the_device_says(twin: Twin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, _, text = with_a_stall(twin, tmp_path, monkeypatch, "monitor", "--n", "36")
    assert code == 0, text
    assert text.index("camera_stalled: no good frame for") < text.index("camera_back: frames come again")


def with_a_stall(
    twin: Twin, folder: Path, monkeypatch: pytest.MonkeyPatch, *verb: str
) -> tuple[int, str, str]:  # fmt: skip
    """A verb on a sensor whose camera stands still after 15 frames, for six repeated results."""
    time, period_s = DaemonTime(folder), 1e3 / twin.board.camera.rate_mhz
    assert twin.board.folder is not None
    with (
        HandTwin(twin, folder / "twin") as camera,
        running_daemon(twin.board.folder, f"twin:{folder / 'twin'}", folder / "store", *time.options) as port,
    ):
        host = stalling_host(camera, time, period_s, after=15, n_stale=6)
        monkeypatch.setattr("ruffini.device.choice.Connection", host)
        return run_host(*verb, port=port)


@pytest.mark.realtime
def test_a_stalled_twin_does_not_hold_up_the_end(twin: Twin, tmp_path: Path) -> None:
    """The daemon waits for a frame 50 ms at a time: the margin to a second is twentyfold."""
    with HandTwin(twin, tmp_path / "twin") as camera:
        process = subprocess.Popen(
            [str(find_daemon()), "--board", str(twin.board.folder), "--camera", f"twin:{tmp_path / 'twin'}",
             "--link", "pty", "--store", str(tmp_path / "store")], stdout=subprocess.PIPE,
        )  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline().startswith(b"link: ")
        camera.frame()
        until(camera.is_read, "the first frame")
        start = time.monotonic()
        process.send_signal(signal.SIGTERM)
        assert process.wait(HANG_S) == 0
        assert time.monotonic() - start < 1
        process.stdout.close()


@pytest.mark.parametrize(
    ("board", "words"), [("tiny", "no twin answers"), ("gelslim", 'twin of board "tiny"'), ("", "give the path")]
)
def test_a_twin_that_is_missing_or_another_is_named(twin: Twin, tmp_path: Path, board: str, words: str) -> None:
    assert twin.board.folder is not None
    folder = find_board("gelslim").folder if board == "gelslim" else twin.board.folder
    assert folder is not None
    scenario = Scenario(program="rest", n=1)
    serving = contextlib.nullcontext()
    if board == "gelslim":
        serving = TwinServer(twin.unit.renderer(), Scripted(twin.unit, scenario), scenario, tmp_path / "twin")
    camera = "twin:" if board == "" else f"twin:{tmp_path / 'twin'}"
    with serving, pytest.raises(RuffiniError, match=words), running_daemon(folder, camera, tmp_path / "store"):
        pass


class Still:
    """A pad that nothing touches, for ever."""

    def __init__(self, twin: Twin) -> None:
        self._rest = twin.unit.at_rest()

    def states(self, frame: int) -> tuple[np.ndarray, None]:
        return self._rest, None


def test_a_calibration_that_shows_no_good_frame_is_not_kept(twin: Twin, tmp_path: Path) -> None:
    """Flashed under the lens cap: what was before is in force again, and the host is told why."""
    assert twin.board.folder is not None
    with (
        HandTwin(twin, tmp_path / "twin") as camera,
        running_daemon(twin.board.folder, f"twin:{tmp_path / 'twin'}", tmp_path / "store") as port,
    ):
        noise = np.random.default_rng(1)
        camera.pictures = [noise.integers(0, 4, len(p), np.uint8).tobytes() for p in camera.pictures]
        camera.run()
        with (
            Connection(port) as sensor,
            pytest.raises(RefusedError, match=r"0 of \d+ frames were good \(.*dark.*flash again"),
        ):
            sensor.flash(twin.calibration)
        with Connection(port) as sensor:
            assert not sensor.hello.sensors[0].calibration.present
    assert sorted(p.name for p in (tmp_path / "store").iterdir()) == ["last-run", "serial"]


def test_a_daemon_that_dies_during_the_trial_comes_back_with_what_was_before(
    twin: Twin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flashing, "RESUME_S", 0.2)  # it will not be back
    scenario = Scenario.model_validate(
        {"schema": 1, "program": "rest", "n": 1_000_000,
         "fault": [{"kind": "stall", "first_frame": 3, "n_frames": 999_000}]}
    )  # fmt: skip
    command = [str(find_daemon()), "--board", str(twin.board.folder), "--camera", f"twin:{tmp_path / 'twin'}",
               "--link", "pty", "--store", str(tmp_path / "store")]  # fmt: skip

    def flash(port: str) -> None:
        with contextlib.suppress(RuffiniError), Connection(port) as sensor:
            sensor.flash(twin.calibration)

    with (
        TwinServer(twin.unit.renderer(), Still(twin), scenario, tmp_path / "twin"),
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process,
    ):
        assert process.stdout is not None
        port = process.stdout.readline().removeprefix("link: ").strip()
        upload = threading.Thread(target=flash, args=(port,))
        upload.start()
        until((tmp_path / "store" / "trial.safetensors").exists, "the trial")
        process.kill()
        upload.join(HANG_S)
        assert not upload.is_alive()
    with TwinServer(twin.unit.renderer(), Still(twin), scenario, tmp_path / "twin2"):
        command[command.index(f"twin:{tmp_path / 'twin'}")] = f"twin:{tmp_path / 'twin2'}"
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stderr is not None
            port = process.stdout.readline().removeprefix("link: ").strip()
            with Connection(port) as sensor:
                assert not sensor.hello.sensors[0].calibration.present
            process.terminate()
            assert "on trial when the power went" in process.stderr.read()
    assert sorted(p.name for p in (tmp_path / "store").iterdir()) == ["last-run", "serial"]


class Impostor:
    """Something else on the socket: sends `data` to whoever connects, and waits for it to go."""

    def __init__(self, path: Path, data: bytes) -> None:
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(path))
        self._listener.listen(1)
        self._data = data
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._listener.close()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            camera, _ = self._listener.accept()
            with camera:
                camera.sendall(self._data)
                while camera.recv(64):
                    pass


def greeting(name: bytes = b"tiny", width: int = 160, height: int = 120, version: int = 1, n_name: int = -1) -> bytes:
    n_name = len(name) if n_name < 0 else n_name
    return struct.pack("<4s5I", b"RFTC", version, width, height, 100_000, n_name) + name


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"HTTP/1.1 400 Bad Request and more", "not a twin of this version"),
        (greeting(version=2), "not a twin of this version"),
        (greeting(n_name=0xFFFFFFFF), "not a twin of this version"),
        (greeting(b"ti", n_name=200), "not a twin of this version"),
        (greeting(width=161), "frames are 161x120"),
    ],
)
def test_impostors_are_refused_in_one_sentence(twin: Twin, tmp_path: Path, data: bytes, words: str) -> None:
    assert twin.board.folder is not None
    camera = f"twin:{tmp_path / 'twin'}"
    with (
        Impostor(tmp_path / "twin", data),
        pytest.raises(RuffiniError, match=words),
        running_daemon(twin.board.folder, camera, tmp_path / "store"),
    ):
        pass


@pytest.mark.parametrize(
    ("frames", "code", "words"),
    [
        (b"noise that is no frame" * 9, 3, "sent something that is no frame"),
        (struct.pack("<4sIQ", b"RFTF", 160 * 120 * 3 + 1, 0) + bytes(160 * 120 * 3 + 1), 3, "a frame of another size"),
        (struct.pack("<4sIQ", b"RFTF", 0xFFFFFFFF, 0), 3, "sent a frame of another size"),
        (struct.pack("<4sIQ", b"RFTF", 160 * 120 * 3, 0) + b"half", 3, "went away within a frame"),
        (struct.pack("<4sIQ", b"RFTF", 0, 0), 0, ""),
    ],
)
def test_frames_that_are_none_end_the_daemon_with_a_sentence(
    twin: Twin, tmp_path: Path, frames: bytes, code: int, words: str
) -> None:
    command = [
        str(find_daemon()), "--board", str(twin.board.folder), "--camera", f"twin:{tmp_path / 'twin'}",
        "--link", "pty", "--store", str(tmp_path / "store"),
    ]  # fmt: skip
    with Impostor(tmp_path / "twin", greeting() + frames):
        done = finished(command)
    assert done.returncode == code
    assert words in done.stderr
    assert done.stderr.count("\n") == (1 if code else 0)


@pytest.mark.parametrize("name", ["contact-glitter", "ftouch", "stereo-fingertip", "eltac"])
def test_every_board_with_a_twin_runs_on_the_daemon(tmp_path: Path, name: str) -> None:
    """No force without a calibration, and no crash without markers; the picture comes over the line as it was made."""
    board = find_board(name)
    assert board.folder is not None
    renderer = Renderer.over_chart(board, load_twin(board))
    scenario = Scenario(program="rest", n=board.pipeline.n_rest_frames + 3)
    server = TwinServer(renderer, Resting(renderer, scenario.n), scenario, tmp_path / "twin")
    messages: dict[str, list[object]] = {}
    with (
        server,
        running_daemon(
            board.folder, f"twin:{tmp_path / 'twin'}", tmp_path / "store", "--lockstep", "--wait-for-host"
        ) as port,
        Connection(port) as sensor,
    ):
        sensor.subscribe(wrench=1, image=1, markers=1, contacts=1)
        with contextlib.suppress(RuffiniError):
            for frame, message in sensor.stream(timeout_s=HANG_S):
                messages.setdefault(sensor.schema.type_name(frame.type), []).append(message)
    last = messages["WRENCH"][-1]
    assert last.stamp.frame == scenario.n - 1
    assert set(last.validity) == {0}  # not measured
    image = messages["IMAGE"][-1]
    picture = server.picture(image.stamp.frame)
    assert picture is not None
    sent = np.frombuffer(image.data, np.uint8).reshape(image.height_px, image.width_px, -1)
    step = image.step_px
    reference = picture[::step, ::step] if sent.shape[2] == 3 else picture[::step, ::step].mean(axis=2, keepdims=True)
    assert np.abs(sent.astype(float) - reference).mean() < 3


def test_a_daemon_with_a_live_camera_runs_within_250_mb_of_address_space(
    twin: Twin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What reads recordings and runs networks, with hundreds of libraries, is loaded only where it is asked for."""
    bounded = tmp_path / "bounded"
    bounded.write_text(f'#!/bin/sh\nulimit -v 250000\nexec {find_daemon()} "$@"\n')
    bounded.chmod(0o755)
    monkeypatch.setenv("RUFFINI_DAEMON", str(bounded))
    scenario = Scenario(program="rest", n=twin.board.pipeline.n_rest_frames + 5)
    frames = Scripted(twin.unit, scenario)
    with (
        TwinServer(twin.unit.renderer(), frames, scenario, tmp_path / "twin"),
        connected(twin, tmp_path, "--lockstep", "--wait-for-host") as sensor,
    ):
        assert len(list(wrenches(sensor))) == len(frames)
