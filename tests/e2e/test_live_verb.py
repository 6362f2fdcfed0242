"""`ruffini live` on a video that this test draws: the real daemon and page server, from start to Ctrl-C."""

from __future__ import annotations

import itertools
import json
import os
import select
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from hang import HANG_S
from tiny_sensor import Sensor

from ruffini.boards import find_board
from ruffini.cli import main
from ruffini.device import Connection
from ruffini.errors import InputError
from ruffini.frames import read_frames
from ruffini.live.recording_server import RecordingServer

LIVE = [sys.executable, "-c", "import sys; from ruffini.cli import main; sys.exit(main())", "live"]


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of gelsight-mini's dots, untouched."""
    board = find_board("gelsight-mini")
    assert board.markers is not None
    c, m = board.camera, board.markers
    picture = np.full((c.height_px, c.width_px, 3), 150, np.uint8)
    px = c.focal_mpx / 1e3 / c.standoff_um
    for row in range(m.n_y):
        for column in range(m.n_x):
            x = (m.first_x_um + column * m.pitch_x_um - board.pad.size_x_um / 2) * px + c.center_x_mpx / 1e3
            y = (m.first_y_um + row * m.pitch_y_um - board.pad.size_y_um / 2) * px + c.center_y_mpx / 1e3
            cv2.circle(picture, (round(x), round(y)), round(m.diameter_um * px / 2), (50, 50, 50), -1, cv2.LINE_AA)
    path = tmp_path_factory.mktemp("video") / "dots.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (c.width_px, c.height_px))
    for _ in range(50):
        writer.write(picture)
    writer.release()
    return path


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    return {**os.environ, "XDG_STATE_HOME": str(tmp_path / "state")}


def refused(environment: dict[str, str], *words: str) -> tuple[int, str]:
    done = subprocess.run([*LIVE, "--no-browser", *words], env=environment, capture_output=True, text=True,
                          stdin=subprocess.DEVNULL, timeout=HANG_S, check=False)  # fmt: skip
    return done.returncode, done.stderr.strip().splitlines()[-1]


@pytest.fixture
def live(video: Path, environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    command = [*LIVE, "--camera", str(video), "--board", "gelsight-mini", "--no-browser", "--http-port", "0", "--json"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        yield run
        run.kill()


def test_a_video_plays_as_a_sensor_and_ends_cleanly(live: subprocess.Popen[str], tmp_path: Path) -> None:
    assert live.stdout is not None
    assert live.stderr is not None
    address = json.loads(live.stdout.readline())["address"]
    with urllib.request.urlopen(f"{address.rstrip('/')}/lines.json", timeout=HANG_S) as answer:
        (line,) = json.load(answer)
    held = os.open(line["port"], os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)  # no other line is given its number
    live.send_signal(signal.SIGINT)
    assert live.wait(HANG_S) == 0
    said = live.stderr.read()
    assert "live: looking at" in said.splitlines()[0]
    assert "not calibrated: shows the picture and the motion of its markers" in said
    is_over = select.poll()
    is_over.register(held, 0)
    ends = is_over.poll(1e3 * HANG_S)
    assert [event & select.POLLHUP for _, event in ends] == [select.POLLHUP], "the daemon has ended"
    os.close(held)
    assert (tmp_path / "state/ruffini/live/gelsight-mini/recording-dots").is_dir()


def test_its_markers_move_in_the_stream(video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from ruffini.live.unit import of_recording, running_unit

    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    board = find_board("gelsight-mini")
    with running_unit(of_recording(video), board) as daemon, Connection(daemon.port) as sensor:
        assert sensor.hello.sensors[0].board == "gelsight-mini"
        sensor.subscribe(markers=1)
        name = sensor.schema.type_name
        messages = (m for frame, m in sensor.stream(timeout_s=HANG_S) if name(frame.type) == "MARKERS")
        assert sum(1 for _, m in zip(range(30), messages, strict=False) if m.stamp.frame >= 0) == 30
        assert daemon.problem() == ""


@pytest.mark.parametrize("is_simulated", [False, True])
def test_a_folder_plays_and_its_mark_goes_with_every_packet(
    video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_simulated: bool
) -> None:
    from ruffini.live.unit import of_recording, running_unit

    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    for i, picture in enumerate(itertools.islice(read_frames(video), 5)):
        cv2.imwrite(str(tmp_path / f"{i}.png"), picture)
    (tmp_path / "recording.toml").write_text(
        f'board = "gelsight-mini"\nrate_mhz = 50000\nsimulated = {str(is_simulated).lower()}\n'
    )
    board = find_board("gelsight-mini")
    with running_unit(of_recording(tmp_path), board) as daemon, Connection(daemon.port) as sensor:
        sensor.subscribe(wrench=1)
        frames = [frame for frame, _ in itertools.islice(sensor.stream(timeout_s=HANG_S), 20)]
    assert {(frame.is_replay, frame.is_simulated) for frame in frames} == {(True, is_simulated)}


def test_verbs_use_a_camera_of_this_computer_and_its_calibrations(
    sensor: Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    (tmp_path / "unit.safetensors").write_bytes(sensor.calibration)

    def run(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["ruffini", *words])
        code = main()
        return code, *capsys.readouterr()

    monkeypatch.setenv("RUFFINI_PORT", "/dev/of_another_sensor")  # what is named on the command line decides
    own = ("--camera", str(sensor.recording), "--board", str(sensor.board.folder))
    code, _, said = run(*own, "cal", "flash", str(tmp_path / "unit.safetensors"))
    assert code == 0, said
    code, out, said = run(*own, "info", "--json")
    assert code == 0, said
    (told,) = json.loads(out)["sensors"]
    assert told["calibration"]["present"], "kept from one verb to the next"
    code, _, said = run(*own, "cal", "fit", str(tmp_path / "missing.h5"), "--out", str(tmp_path / "fit.safetensors"))
    assert code in (2, 3)
    assert "missing.h5" in said, "the board is known"
    collect = ("cal", "collect", "--rig", "scale", "--out", str(tmp_path / "log.h5"))
    other = "eltac" if sensor.board.name != "eltac" else "ftouch"
    code, _, said = run(*own, *collect, "--board", other)
    assert code == 2
    assert f"is of board {sensor.board.name}, not {other}: give --board accordingly" in said
    for words, sentence in (
        (("--camera", "x", "--port", "y"), "give it alone"),
        (("--board", "gelslim"), "needs --camera"),
        (("--camera", "Nobody's camera"), "no camera"),
    ):
        code, _, said = run(*words, "info")
        assert code in (2, 3)
        assert sentence in said


def test_a_snapshot_of_a_board_without_a_field_is_the_cameras_frame(
    video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    out = tmp_path / "rest.png"
    monkeypatch.setattr(
        sys, "argv", ["ruffini", "--camera", str(video), "--board", "digit-tactile", "snapshot", "--out", str(out)]
    )
    assert main() == 0
    assert any(np.array_equal(cv2.imread(str(out)), frame) for frame in read_frames(video))


def test_a_recording_of_another_board_or_a_spoilt_mark_is_refused(video: Path, tmp_path: Path) -> None:
    board = find_board("gelsight-mini")
    for text, sentence in (
        ('board = "gelslim"', "recorded with board 'gelslim', this is 'gelsight-mini'"),
        ("simulated = 1", "simulated must be true or false"),
        ("simulated", "not TOML"),
    ):
        (tmp_path / "recording.toml").write_text(text)
        with pytest.raises(InputError, match=sentence):
            RecordingServer(board, tmp_path / "socket", tmp_path)


def test_what_cannot_be_is_one_sentence(video: Path, environment: dict[str, str], tmp_path: Path) -> None:
    code, said = refused(environment, "--camera", str(video))
    assert code == 2
    which = "contact-glitter, digit-tactile, fibre-skin, gelsight-mini, gelslim"
    assert f"(320x240) fits several boards: choose one with --board of {which}" in said
    code, said = refused(environment, "--camera", str(video), "--board", "ftouch")
    assert code == 2
    assert "frames are 320x240" in said
    (tmp_path / "broken.avi").write_bytes(b"RIFF")
    code, said = refused(environment, "--camera", str(tmp_path / "broken.avi"), "--board", "gelslim")
    assert code == 3
    assert "cannot be read as a video" in said
    code, said = refused(environment, "--camera", "Nobody's camera", "--board", "gelslim")
    assert code == 3
    assert "no camera" in said
