"""Which camera, which board, which store: `ruffini live` before it starts anything."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from ruffini.boards import Board, board_names, find_board, parse_board
from ruffini.errors import InputError, NoDeviceError, SeveralDevicesError
from ruffini.estimators.table import scale_span
from ruffini.live.cameras import LocalCamera, boards_of_camera, boards_of_size, choose_camera, the_one
from ruffini.live.unit import of_camera, of_recording, picture_size, store_folder, what_is_missing

MINI = LocalCamera("/dev/video2", "GelSight Mini R0B 28A1", "28A1-T0FG", 0x1D6B, 0x102, frozenset({(320, 240)}))
OTHER = LocalCamera("/dev/video0", "Built-in Camera", "", 0, 0, frozenset({(640, 480), (320, 240)}))


def board_with(name: str, usb: str, size: tuple[int, int] = (320, 240)) -> Board:
    text = find_board("gelslim").text.replace('"gelslim"', f'"{name}"', 1)
    text = text.replace("width_px = 320", f"width_px = {size[0]}").replace("height_px = 240", f"height_px = {size[1]}")
    return parse_board(text + usb, name)


def test_a_camera_is_chosen_by_path_serial_or_name() -> None:
    for name in ("/dev/video2", "28A1-T0FG", "GelSight"):
        assert choose_camera([OTHER, MINI], name) == MINI
    assert choose_camera([MINI], None) == MINI
    with pytest.raises(
        SeveralDevicesError, match=r"choose one with --camera PATH of /dev/video0 \(Built-in Camera\), /dev/video2"
    ):
        choose_camera([OTHER, MINI], None)
    with pytest.raises(NoDeviceError, match=r"no camera 'X': this computer has /dev/video0"):
        choose_camera([OTHER], "X")
    with pytest.raises(NoDeviceError, match="no camera found: plug one in"):
        choose_camera([], None)


def test_boards_are_recognised_by_usb_and_size() -> None:
    named = board_with("named", '[usb]\nnames = ["GelSight Mini"]\n')
    wide = board_with("wide", '[usb]\nnames = ["GelSight Mini"]\n', (640, 480))
    identified = board_with("identified", "[usb]\nvendor = 0x1d6b\nproduct = 0x102\n")
    both = board_with("both", '[usb]\nvendor = 0x1d6b\nproduct = 0x102\nnames = ["Pad"]\n')
    plain = board_with("plain", "")
    boards = [named, wide, identified, both, plain]
    assert boards_of_camera(boards, MINI) == [named, identified], "both names another camera, wide another picture"
    assert boards_of_camera(boards, OTHER) == [plain], "of those that ask for no camera of their own"
    assert boards_of_camera([named, wide], MINI._replace(sizes=frozenset())) == [named, wide], "it told no sizes"
    assert boards_of_size(boards, 640, 480) == [wide]


def test_the_product_is_recognised() -> None:
    boards = [find_board(name) for name in ("gelslim", "gelsight-mini", "eltac")]
    assert [board.name for board in boards_of_camera(boards, MINI)] == ["gelsight-mini"]


def test_none_and_several_are_said() -> None:
    with pytest.raises(InputError, match="fits no shipped board: give --board with your board"):
        the_one([], "it")
    with pytest.raises(InputError, match="it fits several boards: choose one with --board of a, b"):
        the_one([board_with("a", ""), board_with("b", "")], "it")


def test_each_unit_has_its_store(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    board = find_board("gelsight-mini")
    assert store_folder(board, MINI.key) == tmp_path / "ruffini/live/gelsight-mini/28A1-T0FG"
    assert store_folder(board, "../a b\n") == tmp_path / "ruffini/live/gelsight-mini/a-b"
    assert store_folder(board, "..").name == "unnamed"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert store_folder(board, "x") == tmp_path / ".local/state/ruffini/live/gelsight-mini/x"


def test_the_daemon_is_told_the_cameras_serial() -> None:
    assert of_camera(MINI)[:2] == ("v4l2:/dev/video2", ("--serial", "28A1-T0FG"))
    assert of_camera(OTHER).options == ()
    assert of_camera(MINI._replace(serial="a b")).options == (), "ruffinid makes one up"
    assert of_recording(Path("a/video.avi"))[:2] == (Path("a/video.avi"), ("--loop",))


def test_the_size_of_a_recording(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    cv2.imwrite(str(tmp_path / "frames" / "0.png"), np.zeros((24, 32, 3), np.uint8))
    assert picture_size(tmp_path) == (32, 24)
    assert picture_size(tmp_path / "frames" / ".." / "frames") == (32, 24)
    (tmp_path / "capitals").mkdir()
    cv2.imwrite(str(tmp_path / "capitals" / "0.PNG"), np.zeros((24, 32, 3), np.uint8))
    assert picture_size(tmp_path / "capitals") == (32, 24)
    (tmp_path / "broken.avi").write_bytes(b"RIFF")
    with pytest.raises(InputError, match=r"broken\.avi: cannot be read as a video: is the file whole"):
        picture_size(tmp_path / "broken.avi")


def test_what_is_missing_is_one_sentence() -> None:
    nothing = SimpleNamespace(present=False)
    said = what_is_missing(find_board("gelsight-mini"), nothing)
    assert said.startswith("not calibrated: shows the picture and the motion of its markers in millimetres, no newtons")
    assert "never measures force_z, torque_x" in said
    for board, how in {
        "gelslim": "with Calibrate in the page, or `ruffini cal auto`",
        "digit-tactile": "with Calibrate in the page, or `ruffini cal auto`",
        "ftouch": "by `ruffini cal auto`",
        "eltac": "by `ruffini cal auto`",
        "contact-glitter": "by `ruffini cal auto`",
        "stereo-fingertip": "by `ruffini cal auto`",
    }.items():
        said = what_is_missing(find_board(board), nothing)
        assert f"no newtons until it is calibrated {how}" in said


@pytest.mark.parametrize("name", board_names())
def test_who_is_sent_to_the_page_is_not_refused_there(name: str) -> None:
    said = what_is_missing(find_board(name), SimpleNamespace(present=False))
    if "Calibrate" in said:
        assert scale_span(find_board(name)).half_x_m > 0
    else:
        with pytest.raises(InputError, match="needs more than presses on a kitchen scale"):
            scale_span(find_board(name))


def test_a_board_that_nothing_calibrates_is_shown_all_the_same() -> None:
    wedge = find_board("gelsight-wedge")
    bare = wedge.model_copy(update={"pipeline": wedge.pipeline.model_copy(update={"stages": ["difference"]})})
    said = what_is_missing(bare, SimpleNamespace(present=False))
    assert said.startswith("not calibrated: shows the picture; board 'gelsight-wedge' has no estimator yet")


def test_what_a_calibrated_unit_measures_is_one_sentence() -> None:
    done = SimpleNamespace(present=True, kinds=["operator"], created_utc="2026-01-01T00:00:00Z")
    assert what_is_missing(find_board("gelslim"), done) == "calibrated (operator, 2026-01-01T00:00:00Z)"
