"""What `ruffini live` refuses of a recording before it starts anything."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.live.recording_server import RecordingServer


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("rate_mhz = 99", "rate_mhz must be from 100 to 1000000, is 99"),
        ("rate_mhz = 1000001", "rate_mhz must be from 100 to 1000000, is 1000001"),
        ("rate_mhz = 0", "rate_mhz must be from 100 to 1000000, is 0"),
        ("rate_mhz = -30000", "rate_mhz must be from 100 to 1000000, is -30000"),
        ("rate_mhz = true", "rate_mhz must be a whole number"),
        ("simulated = 1", "simulated must be true or false"),
    ],
)
def test_a_key_out_of_its_range_is_refused(line: str, reason: str, tmp_path: Path) -> None:
    board = find_board("gelslim")
    (tmp_path / "recording.toml").write_text(f"{line}\n")
    picture = np.zeros((board.camera.height_px, board.camera.width_px, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "0.png"), picture)
    with pytest.raises(InputError, match=f"{tmp_path / 'recording.toml'}: {reason}"):
        RecordingServer(board, tmp_path / "socket", tmp_path)
    assert not (tmp_path / "socket").exists()


@pytest.mark.parametrize("rate_mhz", [100, 1_000_000])
def test_the_ends_of_the_range_are_accepted(rate_mhz: int, tmp_path: Path) -> None:
    board = find_board("gelslim")
    (tmp_path / "recording.toml").write_text(f"rate_mhz = {rate_mhz}\n")
    picture = np.zeros((board.camera.height_px, board.camera.width_px, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "0.png"), picture)
    with RecordingServer(board, tmp_path / "socket", tmp_path):
        assert (tmp_path / "socket").is_socket()
