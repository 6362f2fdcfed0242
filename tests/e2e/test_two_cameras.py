"""Two cameras that see half a picture each: as one camera that sees it all."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
from hang import HANG_S
from test_bad_input import is_one_sentence, run_daemon
from tiny_sensor import N_FRAMES, Sensor, start, write_board

from ruffini.boards import find_board
from ruffini.device import Connection


@pytest.fixture(scope="module")
def halves(sensor: Sensor, tmp_path_factory: pytest.TempPathFactory) -> tuple[Sensor, Path, Path]:
    """A stereo board, and the sensor's recording cut in two."""
    root = tmp_path_factory.mktemp("halves")
    folder = write_board(root / "tiny", {})
    with (folder / "board.toml").open("a") as file:
        file.write("\n[stereo]\ntolerance_us = 2000\n")
    board = find_board(folder)
    half = board.camera.width_px // 2
    sides = root / "left", root / "right"
    for side, columns in zip(sides, (slice(0, half), slice(half, None)), strict=True):
        (side / "frames").mkdir(parents=True)
        (side / "recording.toml").write_text((sensor.recording / "recording.toml").read_text())
        for path in sorted((sensor.recording / "frames").iterdir()):
            picture = cv2.imread(str(path))
            assert picture is not None
            cv2.imwrite(str(side / "frames" / path.name), picture[:, columns])
    return Sensor(board, folder, sides[0], sensor.calibration), *sides


def wrenches(sensor: Sensor, store: Path, *options: str) -> list[tuple[int, int, int]]:
    """Frame, force along z and flags of the whole recording."""
    said = []
    with start(sensor, store, "--lockstep", "--wait-for-host", *options) as daemon, Connection(daemon.port) as host:
        host.flash(sensor.calibration)
        host.subscribe(wrench=1)
        for frame, message in host.stream(timeout_s=HANG_S):
            if host.schema.type_name(frame.type) == "WRENCH":
                said.append((message.stamp.frame, message.force_z_un, message.stamp.flags))
                if message.stamp.frame == N_FRAMES - 1:
                    break
    return said


def test_two_halves_are_the_whole_bit_for_bit(
    sensor: Sensor, halves: tuple[Sensor, Path, Path], tmp_path: Path
) -> None:
    stereo, _, right = halves
    whole = wrenches(sensor, tmp_path / "one")
    assert len(whole) == N_FRAMES
    assert min(force for _, force, _ in whole) < -100_000
    assert wrenches(stereo, tmp_path / "two", "--camera", f"replay:{right}") == whole


def test_a_camera_too_many_is_refused(sensor: Sensor, halves: tuple[Sensor, Path, Path], tmp_path: Path) -> None:
    stereo, left, right = halves
    more = "--camera", f"replay:{right}"
    code, said = run_daemon(sensor.folder, f"replay:{left}", tmp_path / "store", *more)
    assert code == 2
    assert is_one_sentence(said)
    assert "board.toml has no [stereo]" in said
    code, said = run_daemon(stereo.folder, f"replay:{left}", tmp_path / "store", *more, *more)
    assert code == 2
    # A picture of the whole size is none of a half.
    code, said = run_daemon(
        stereo.folder, f"replay:{left}", tmp_path / "store", "--camera", f"replay:{sensor.recording}"
    )
    assert code == 2
    assert "frames are 160x120" in said
    assert "needs 80x120" in said
