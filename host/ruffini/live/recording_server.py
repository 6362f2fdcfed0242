"""A recording, decoded here and handed to ruffinid as the frames of a camera, again and again.

ruffinid needs no library for pictures and videos then: a wheel brings it without one.
"""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path
from typing import Any

from ruffini.boards import Board
from ruffini.errors import InputError, NoDeviceError
from ruffini.files import readable
from ruffini.frame_server import FrameServer
from ruffini.frames import read_frames
from ruffini.older_python import tomllib

MEASURED, SIMULATED = b"RFRC", b"RFRS"
LEAST_MHZ, MOST_MHZ = 100, 1_000_000  # as in a board.toml; a video that states another rate is played at the board's


class RecordingServer(FrameServer):
    """Serves a video or a folder of pictures at its own rate; pictures that the camera is late for are left out.

    Raises
    ------
    InputError
        It is of another board, or of other pictures.
    NoDeviceError
        It cannot be read.
    """

    def __init__(self, board: Board, path: Path, recording: Path) -> None:
        said = _said_of(recording)
        if said.get("board", board.name) != board.name:
            raise InputError(
                f"{recording}: recorded with board {said['board']!r}, this is {board.name!r}: "
                "choose the board that fits"
            )
        try:
            height, width = next(iter(read_frames(recording))).shape[:2]
        except InputError as error:
            raise NoDeviceError(str(error)) from error
        needed = board.camera.width_px, board.camera.height_px
        if (width, height) != needed:
            raise InputError(
                f"{recording}: frames are {width}x{height}, board {board.name!r} needs {needed[0]}x{needed[1]}"
            )
        self._recording = recording
        magic = SIMULATED if said.get("simulated", False) else MEASURED
        super().__init__(board, path, magic=magic, rate_mhz=said.get("rate_mhz") or _rate_mhz(recording, board))

    def _stream(self, camera: socket.socket, *, is_paced: bool) -> None:
        shape = self._board.camera.height_px, self._board.camera.width_px, 3
        frame = due = 0
        while not self._stop.is_set():
            before = frame
            with contextlib.suppress(InputError):  # what is damaged ends where it cannot be read on, and begins again
                for picture in read_frames(self._recording):
                    if self._stop.is_set():
                        return
                    if frame >= due and is_paced:
                        due = self._wait_for(frame)
                    if frame >= due and picture.shape == shape:
                        self._send_frame(camera, frame, picture.tobytes())
                    frame += 1
            if frame == before:
                break
        self._send_frame(camera, frame, b"")


def _said_of(recording: Path) -> dict[str, Any]:
    """What a folder's recording.toml states, if there is one; a mark that cannot be read makes nothing measured."""
    path = recording / "recording.toml"
    if not path.is_file():
        return {}
    try:
        said = tomllib.loads(readable(path).read_text("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: not TOML: {error}") from error
    for key, kind, what in (("simulated", bool, "true or false"), ("rate_mhz", int, "a whole number"),
                            ("board", str, "a text")):  # fmt: skip
        if type(said.get(key, kind())) is not kind:  # True is an int, too
            raise InputError(f"{path}: {key} must be {what} (boards/README.md lists the keys)")
    if not LEAST_MHZ <= said.get("rate_mhz", LEAST_MHZ) <= MOST_MHZ:
        raise InputError(f"{path}: rate_mhz must be from {LEAST_MHZ} to {MOST_MHZ}, is {said['rate_mhz']}")
    return said


def _rate_mhz(recording: Path, board: Board) -> int:
    if recording.is_dir():
        return board.camera.rate_mhz
    import cv2

    video = cv2.VideoCapture(str(recording))
    rate_hz = video.get(cv2.CAP_PROP_FPS)
    video.release()
    return round(1e3 * rate_hz) if LEAST_MHZ <= 1e3 * rate_hz <= MOST_MHZ else board.camera.rate_mhz
