"""Bad input: one clear sentence and the documented exit code, from the daemon and from the host tool.

Exit codes: 0 ok, 1 failed check, 2 usage or bad input, 3 no device, 4 refused, 5 verify failed.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import shutil
import subprocess
import sys
import termios
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import serial
from command_line import run_ruffini
from hang import HANG_S, finished, until
from mcap.reader import make_reader
from tiny_sensor import Sensor, start, write_board, write_recording

from ruffini.api import sensor as api_sensor
from ruffini.calibrate import container
from ruffini.daemon import find_daemon
from ruffini.device import connection, ports
from ruffini.record import mcap_file

SHORT_S, PATIENCE_S = 0.05, 3.0
HOST = [sys.executable, "-c", "import sys; from ruffini.cli import main; sys.exit(main())"]


def run_daemon(
    board: Path, camera: str, store: Path, *options: str, link: str = "pty", limit: int | None = None
) -> tuple[int, str]:
    """Exit code and stderr of a daemon that should not start."""
    command = [
        str(find_daemon()), "--board", str(board), "--camera", camera, "--link", link, "--store", str(store),
        "--lockstep", *options,
    ]  # fmt: skip
    done = finished(command)
    return done.returncode, done.stderr


run_host = run_ruffini


def is_one_sentence(text: str) -> bool:
    """One line for a person, after lines of progress; no traceback."""
    *progress, last = text.strip().splitlines() or [""]
    faults = ("ruffini: ", "ruffinid: ", "Traceback")
    return last.startswith(faults[:2]) and not any(line.startswith(faults) for line in progress)


# ---- the daemon -----------------------------------------------------------------------------------


def other_size(sensor: Sensor, folder: Path) -> str:
    (folder / "frames").mkdir()
    cv2.imwrite(str(folder / "frames" / "0.png"), np.zeros((50, 60, 3), np.uint8))
    return f"replay:{folder}"


def other_board(sensor: Sensor, folder: Path) -> str:
    shutil.copytree(sensor.recording, folder, dirs_exist_ok=True)
    (folder / "recording.toml").write_text('simulated = true\nboard = "another"\n')
    return f"replay:{folder}"


def unreadable(sensor: Sensor, folder: Path) -> str:
    (folder / "video.mp4").write_bytes(b"this is no video" * 100)
    return f"replay:{folder / 'video.mp4'}"


def unreadable_image(sensor: Sensor, folder: Path) -> str:
    (folder / "0.png").write_bytes(b"this is no picture")
    return f"replay:{folder}"


CAMERAS: dict[str, tuple[Callable[[Sensor, Path], str], int, str]] = {
    "missing recording": (lambda s, f: f"replay:{f}/nothing", 3, "no such recording"),
    "unreadable video": (unreadable, 3, "cannot be read as a video"),
    "unreadable image": (unreadable_image, 3, "first frame cannot be read"),
    "folder without images": (lambda s, f: f"replay:{f}", 3, "holds no PNG or JPEG"),
    "wrong frame size": (other_size, 2, "frames are 60x50"),
    "recording of another board": (other_board, 2, 'recorded with board "another"'),
    "camera that is not there": (lambda s, f: "libcamera:NoSuchCamera", 3, "NoSuchCamera"),
    "unknown camera": (lambda s, f: "webcam:0", 2, "give v4l2:NAME, libcamera:NAME"),
}


@pytest.mark.parametrize("case", CAMERAS, ids=str)
def test_camera(case: str, sensor: Sensor, tmp_path: Path) -> None:
    make, code, words = CAMERAS[case]
    folder = tmp_path / "frames_here"
    folder.mkdir()
    got, text = run_daemon(sensor.folder, make(sensor, folder), tmp_path / "store")
    assert words in text
    assert is_one_sentence(text)
    assert got == code


@pytest.mark.parametrize("serial_number", ["pad\udcff", "pad\n1", "Gr\u00f6\u00dfe", "x" * 64], ids=ascii)
def test_a_serial_number_that_no_host_could_read(serial_number: str, sensor: Sensor, tmp_path: Path) -> None:
    code, text = run_daemon(sensor.folder, f"replay:{sensor.recording}", tmp_path / "store", "--serial", serial_number)
    assert (code, is_one_sentence(text)) == (2, True), text
    assert text.startswith("ruffinid: --serial ")
    assert "give" in text


def test_unknown_key_in_the_board(sensor: Sensor, tmp_path: Path) -> None:
    folder = write_board(tmp_path / "tiny", {"poisson_1e4": "hardness = 5\npoisson_1e4"})
    code, text = run_daemon(folder, f"replay:{sensor.recording}", tmp_path / "store")
    assert (code, is_one_sentence(text)) == (2, True)
    assert "unknown key pad.hardness" in text
    code, _, text = run_host("board", "check", str(folder))
    assert (code, is_one_sentence(text)) == (2, True)
    assert "hardness" in text


def test_missing_board(sensor: Sensor, tmp_path: Path) -> None:
    code, text = run_daemon(tmp_path / "nothing", f"replay:{sensor.recording}", tmp_path / "store")
    assert (code, is_one_sentence(text)) == (3, True)
    assert "is this a board folder?" in text


def test_store_that_is_a_file(sensor: Sensor, tmp_path: Path) -> None:
    (tmp_path / "store").write_text("")
    code, text = run_daemon(sensor.folder, f"replay:{sensor.recording}", tmp_path / "store")
    assert (code, is_one_sentence(text)) == (5, True)
    assert str(tmp_path / "store") in text


def test_line_that_is_not_there(sensor: Sensor, tmp_path: Path) -> None:
    code, text = run_daemon(sensor.folder, f"replay:{sensor.recording}", tmp_path / "s", link=str(tmp_path / "tty"))
    assert (code, is_one_sentence(text)) == (3, True)


def test_a_spoilt_stored_calibration_is_named_and_not_used(sensor: Sensor, tmp_path: Path) -> None:
    (tmp_path / "calibration-1.safetensors").write_bytes(sensor.calibration[:-100])
    with start(sensor, tmp_path, "--wait-for-host") as daemon:
        code, out, _ = run_host("info", "--json", port=daemon.port)
        daemon.process.terminate()
        _, text = daemon.process.communicate(timeout=HANG_S)
    assert code == 0
    assert not json.loads(out)["sensors"][0]["calibration"]["present"]
    assert "stored calibration not used" in text


# ---- flashing ---------------------------------------------------------------------------------------


def truncated(sensor: Sensor) -> bytes:
    return sensor.calibration[:-1000]


def flipped(sensor: Sensor) -> bytes:
    data = bytearray(sensor.calibration)
    data[len(data) // 2] ^= 1
    return bytes(data)


def no_calibration(sensor: Sensor) -> bytes:
    return b"PK\x03\x04 this is something else" * 50


def for_another_board(sensor: Sensor) -> bytes:
    file = container.unpack(sensor.calibration)
    return container.pack(file.tensors, {**file.metadata, "board": "gelslim"}).data


FILES: dict[str, tuple[Callable[[Sensor], bytes], tuple[int, ...], str]] = {
    "truncated": (truncated, (2,), "copy the file again"),
    "one bit flipped": (flipped, (5,), "signature"),
    "something else": (no_calibration, (2,), "copy the file again"),
    "for another board": (for_another_board, (4,), "gelslim"),
}


@pytest.mark.parametrize("case", FILES, ids=str)
def test_flash(case: str, sensor: Sensor, tmp_path: Path) -> None:
    make, codes, words = FILES[case]
    path = tmp_path / "bad.safetensors"
    path.write_bytes(make(sensor))
    with start(sensor, tmp_path / "store", "--wait-for-host") as daemon:
        code, _, text = run_host("cal", "flash", str(path), port=daemon.port)
        assert code in codes, text
        assert words in text.lower()
        assert is_one_sentence(text)
        code, out, _ = run_host("info", "--json", port=daemon.port)
        assert not json.loads(out)["sensors"][0]["calibration"]["present"]
    assert not (tmp_path / "store" / "calibration-1.safetensors").exists()


def test_flash_onto_a_full_disk(sensor: Sensor, tmp_path: Path) -> None:
    path = tmp_path / "good.safetensors"
    path.write_bytes(sensor.calibration)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with start(sensor, tmp_path / "store", "--wait-for-host") as daemon:
        resource.prlimit(daemon.process.pid, resource.RLIMIT_FSIZE, (100_000, before[1]))
        code, _, text = run_host("cal", "flash", str(path), port=daemon.port)
        assert daemon.process.poll() is None, "the daemon must survive"
        assert code == 5
        assert "incoming.tmp: cannot reserve" in text.splitlines()[-1]
        assert "File too large" in text.splitlines()[-1]
        code, _, text = run_host("info", port=daemon.port)
        assert code == 0
    assert not (tmp_path / "store" / "calibration-1.safetensors").exists()


# ---- finding a sensor ---------------------------------------------------------------------------------


def test_no_device() -> None:
    code, _, text = run_host("info")
    assert (code, is_one_sentence(text)) == (3, True)
    assert "--port" in text


def test_port_that_is_missing(tmp_path: Path) -> None:
    code, _, text = run_host("info", port=str(tmp_path / "ttyACM9"))
    assert (code, is_one_sentence(text)) == (3, True)
    assert "ttyACM9" in text


def test_port_that_is_busy(sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--wait-for-host") as daemon, serial.Serial(daemon.port, exclusive=True):
        code, _, text = run_host("info", port=daemon.port)
    assert (code, is_one_sentence(text)) == (3, True)
    assert "busy" in text


def test_a_port_where_nothing_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection.Connection.__init__, "__kwdefaults__", {"hello_timeout_s": SHORT_S})
    master, slave = os.openpty()
    try:
        code, _, text = run_host("info", port=os.ttyname(slave))
    finally:
        os.close(master)
        os.close(slave)
    assert (code, is_one_sentence(text)) == (3, True)
    assert "nothing answers HELLO" in text


def test_a_port_that_takes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ports, "WRITE_TIMEOUT_S", SHORT_S)
    master, slave = os.openpty()
    try:
        termios.tcflow(slave, termios.TCOOFF)
        code, _, text = run_host("info", port=os.ttyname(slave))
    finally:
        os.close(master)
        os.close(slave)
    assert (code, is_one_sentence(text)) == (3, True)
    assert "the device does not read what is sent" in text


def test_of_two_ports_the_one_that_answers_is_taken(sensor: Sensor, tmp_path: Path) -> None:
    nobody = str(tmp_path / "ttyACM9")
    with start(sensor, tmp_path / "a", "--wait-for-host", serial="A1") as one:
        code, out, _ = run_host("info", "--json", RUFFINI_PORT=f"{nobody},{one.port}")
        assert (code, json.loads(out)["serial"]) == (0, "A1")
    code, _, text = run_host("info", RUFFINI_PORT=f"{nobody},{nobody}8")
    assert (code, is_one_sentence(text)) == (3, True)
    assert "no sensor answers" in text


def test_two_devices_are_listed_and_a_serial_number_chooses(sensor: Sensor, tmp_path: Path) -> None:
    with (
        start(sensor, tmp_path / "a", "--wait-for-host", serial="A1") as one,
        start(sensor, tmp_path / "b", "--wait-for-host", serial="B2") as two,
    ):
        both = f"{one.port},{two.port}"
        code, _, text = run_host("info", RUFFINI_PORT=both)
        assert (code, is_one_sentence(text)) == (2, True)
        assert "A1" in text
        assert "B2" in text
        assert "--serial" in text
        code, out, _ = run_host("--serial", "B2", "info", "--json", RUFFINI_PORT=both)
        assert (code, json.loads(out)["serial"]) == (0, "B2")
        code, _, text = run_host("--serial", "C3", "info", RUFFINI_PORT=both)
        assert (code, is_one_sentence(text)) == (3, True)


# ---- verbs that stream ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "verb",
    [["monitor", "--n", "100000", "--resume", "0.3"], ["record", "OUT", "--n", "100000", "--resume", "0"]],
    ids=["monitor", "record"],
)
def test_a_daemon_that_dies_ends_the_verb_with_a_sentence(verb: list[str], sensor: Sensor, tmp_path: Path) -> None:
    out = tmp_path / "run.mcap"
    arguments = [str(out) if a == "OUT" else a for a in verb]
    with start(sensor, tmp_path / "store", "--loop") as daemon:
        process = subprocess.Popen(
            [*HOST, "--port", daemon.port, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        if verb[0] == "monitor":
            assert process.stdout is not None
            process.stdout.readline()
        else:
            until(lambda: out.exists() and out.stat().st_size > 0, "the recording's first chunk")
        daemon.process.kill()
        _, text = process.communicate(timeout=HANG_S)
    assert process.returncode == 3, text
    last = text.strip().splitlines()[-1]
    assert daemon.port in last
    assert "Traceback" not in text
    if verb[0] == "record":
        with out.open("rb") as file:
            assert sum(1 for _ in make_reader(file).iter_messages()) > 0, "what was recorded is whole"


def test_a_daemon_that_dies_under_snapshot_ends_it_with_a_sentence(sensor: Sensor, tmp_path: Path) -> None:
    out = tmp_path / "snapshot.png"
    never_a_frame = write_recording(sensor.board, tmp_path / "one", 1)  # it ends, the line stays
    with start(Sensor(sensor.board, sensor.folder, never_a_frame, b""), tmp_path / "store", "--linger") as daemon:
        process = subprocess.Popen(
            [*HOST, "--port", daemon.port, "snapshot", "--out", str(out)], stderr=subprocess.PIPE, text=True
        )
        until(lambda: is_open_by(process.pid, daemon.port), "the open port")
        daemon.process.kill()
        _, text = process.communicate(timeout=HANG_S)
    assert (process.returncode, is_one_sentence(text)) == (3, True)
    assert daemon.port in text
    assert not out.exists()


def is_open_by(pid: int, path: str) -> bool:
    """Whether a process has a file open."""
    found = []
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):  # it may close it meanwhile
            found.append(str(entry.readlink()))
    return path in found


@pytest.mark.parametrize(
    "verb",
    [["monitor", "--n", "9999", "--resume", "0"], ["record", "OUT", "--n", "9999", "--resume", "0.3"]],
    ids=["monitor", "record"],
)
def test_a_camera_that_stands_still_ends_the_verb_with_a_sentence(
    verb: list[str], sensor: Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Longer than from one STATUS to the next, which comes each second whatever the camera does.
    for module in (api_sensor, mcap_file):
        monkeypatch.setattr(module, "SILENCE_S", PATIENCE_S)
    short = Sensor(sensor.board, sensor.folder, write_recording(sensor.board, tmp_path / "short", 3), b"")
    out = tmp_path / "run.mcap"
    with start(short, tmp_path / "store", "--wait-for-host", "--linger") as daemon:
        code, _, text = run_host(*[str(out) if a == "OUT" else a for a in verb], port=daemon.port)
    assert (code, "Traceback" in text) == (3, False)
    assert f"no frame for {PATIENCE_S:.0f} s" in text.strip().splitlines()[-1]


def test_record_does_not_overwrite(sensor: Sensor, tmp_path: Path) -> None:
    out = tmp_path / "run.mcap"
    out.write_text("precious")
    with start(sensor, tmp_path / "store", "--loop") as daemon:
        code, _, text = run_host("record", str(out), "--n", "3", port=daemon.port)
    assert (code, is_one_sentence(text)) == (2, True)
    assert out.read_text() == "precious"


def test_a_recording_shorter_than_rest_still_answers(sensor: Sensor, tmp_path: Path) -> None:
    short = Sensor(sensor.board, sensor.folder, write_recording(sensor.board, tmp_path / "short", 3), b"")
    with start(short, tmp_path / "store", "--lockstep", "--linger") as daemon:
        code, _, _ = run_host("info", port=daemon.port)
        assert code == 0
