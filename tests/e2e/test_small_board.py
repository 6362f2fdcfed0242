"""What the smallest board has to hold and to wait for: gelslim at both sizes, before a twin's camera."""

from __future__ import annotations

import re
import socket
from pathlib import Path

import numpy as np
import pytest
from hang import HANG_S, until
from kept import kept
from tiny_sensor import calibration_bytes, draw

from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.daemon import started_daemon
from ruffini.device import Connection, Wrench
from ruffini.device.results import VALID
from ruffini.frame_server import FrameServer

EVERYTHING = {"wrench": 1, "field": 1, "depth": 1, "contacts": 1, "markers": 1, "image": 1}
RESIDENT_MIB = {320: 24, 640: 41}  # of the board's 512
N_READ = 60
N_PICTURES = 12  # more than rest is learned from: no camera sends a picture twice


class Camera(FrameServer):
    """A twin's camera in lockstep, without end."""

    def __init__(self, board: Board, path: Path) -> None:
        super().__init__(board, path, magic=b"RFTC", rate_mhz=board.camera.rate_mhz)
        self.is_pressed = False
        noise, still = np.random.default_rng(1), [draw(board, depth, seed) for seed, depth in enumerate((0.0, 0.25))]
        self._pictures = [
            [(one + noise.integers(0, 2, one.shape, np.uint8)).tobytes() for _ in range(N_PICTURES)] for one in still
        ]

    def _stream(self, camera: socket.socket, *, is_paced: bool) -> None:
        assert not is_paced
        frame = 0
        while not self._stop.is_set():
            self._send_frame(camera, frame, self._pictures[self.is_pressed][frame % N_PICTURES])
            frame += 1


@pytest.fixture
def calibration(tmp_path: Path) -> container.CalibrationFile:
    """Of the larger camera: the smaller one sees the same pad through the same lens."""
    (tmp_path / "larger").mkdir()
    return container.unpack(kept(calibration_bytes, gelslim(max(RESIDENT_MIB), tmp_path / "larger")))


def gelslim(width_px: int, root: Path) -> Board:
    """The board with a camera of another size behind the same lens."""
    text = find_board("gelslim").text
    for key, value in {
        "width_px": width_px,
        "height_px": width_px * 3 // 4,
        "focal_mpx": 300_000 * width_px // 320,
        "center_x_mpx": 500 * (width_px - 1),
        "center_y_mpx": 500 * (width_px * 3 // 4 - 1),
    }.items():
        text, n = re.subn(rf"^{key} = \d+", f"{key} = {value}", text, count=1, flags=re.MULTILINE)
        assert n == 1, key
    folder = root / "gelslim"
    folder.mkdir()
    (folder / "board.toml").write_text(text)
    return find_board(folder)


def wrenches(host: Connection, n: int) -> list[Wrench]:
    out: list[Wrench] = []
    for frame, message in host.stream(timeout_s=HANG_S):
        if host.schema.type_name(frame.type) == "WRENCH":
            out.append(Wrench.from_message(message))
        if len(out) == n:
            break
    return out


@pytest.mark.parametrize("width_px", RESIDENT_MIB)
def test_gelslim_fits_the_smallest_board_and_measures_once_rest_is_learned(
    width_px: int, calibration: container.CalibrationFile, tmp_path: Path
) -> None:
    """Resident memory with everything subscribed; frames before the first force of a pad without a stored rest."""
    board = gelslim(width_px, tmp_path)
    n_rest = board.pipeline.n_rest_frames
    store = tmp_path / "store"
    run = (tmp_path / "gelslim", f"twin:{tmp_path / 'twin'}", store, "--lockstep", "--wait-for-host")
    with Camera(board, tmp_path / "twin") as camera:
        with started_daemon(*run) as daemon, Connection(daemon.port) as host:
            host.flash(container.pack(calibration.tensors, calibration.metadata | container.base_metadata(board)).data)
        with started_daemon(*run) as daemon, Connection(daemon.port) as host:
            host.subscribe(wrench=1)
            got = wrenches(host, n_rest + 1)
            host.checked(zero={})  # its rest image is stored: the next start reads it
            until(lambda: len(wrenches(host, n_rest)) > 0 and (store / "rest").exists(), "a stored rest image")
        with started_daemon(*run) as daemon, Connection(daemon.port) as host:
            host.subscribe(**EVERYTHING)
            wrenches(host, N_READ)
            camera.is_pressed = True
            assert wrenches(host, N_READ)[-1].values[2] < -0.1
            status = Path(f"/proc/{daemon.pid}/status").read_text()
    assert [w.frame for w in got if w.validity[2] == VALID] == [n_rest]
    assert (n_rest + 1) * 1_000 <= board.camera.rate_mhz
    resident_kib = int(re.search(r"VmRSS:\s*(\d+) kB", status)[1])  # type: ignore[index]
    assert resident_kib <= RESIDENT_MIB[width_px] * 1024
