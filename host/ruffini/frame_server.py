"""Frames for `ruffinid` over a UNIX socket; firmware/capture/twin_camera.h describes the bytes."""

from __future__ import annotations

import socket
import struct
import threading
import time
from pathlib import Path
from types import TracebackType

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.older_python import Self

VERSION = 1
POLL_S = 0.1  # between two looks at whether to stop
PACED = b"P"


class FrameServer:
    """Serves one camera at a time, each from the beginning. `with` runs it in a thread."""

    def __init__(self, board: Board, path: Path, *, magic: bytes, rate_mhz: int) -> None:
        self._board, self._path = board, path
        self._magic, self._rate_mhz = magic, rate_mhz
        self._start_s = 0.0  # of the camera that is served
        self._stop = threading.Event()
        self._listener = _listen(path)
        self._thread = threading.Thread(target=self.run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
        self._thread.join()

    def close(self) -> None:
        """Stop serving and remove the socket. Any thread."""
        self._stop.set()

    def run(self, *, once: bool = False) -> None:
        """Serve until `close`, or until the first camera has gone."""
        try:
            while not self._stop.is_set():
                try:
                    camera, _ = self._listener.accept()
                except TimeoutError:
                    continue
                with camera:
                    camera.settimeout(POLL_S)
                    self._serve(camera)
                if once:
                    return
        finally:
            self._listener.close()
            self._path.unlink(missing_ok=True)

    def _stream(self, camera: socket.socket, *, is_paced: bool) -> None:
        """Send frame after frame, until the end or `close`."""
        raise NotImplementedError

    def _serve(self, camera: socket.socket) -> None:
        settings = self._board.camera
        name = self._board.name.encode()
        sizes = settings.width_px, settings.height_px, self._rate_mhz
        try:
            self._send(camera, struct.pack("<4s5I", self._magic, VERSION, *sizes, len(name)) + name)
            mode = self._receive_mode(camera)
            if mode:
                self._start_s = time.monotonic()
                self._stream(camera, is_paced=mode == PACED)
        except (BrokenPipeError, ConnectionResetError):
            return  # the camera went; the next one may come

    def _receive_mode(self, camera: socket.socket) -> bytes:
        while not self._stop.is_set():
            try:
                return camera.recv(1)
            except TimeoutError:
                continue
        return b""

    def _wait_for(self, frame: int) -> int:
        """Wait for the time of a frame; where that is past by one or more, the number of the frame of now."""
        period_s = 1e3 / self._rate_mhz
        late_s = time.monotonic() - self._start_s - frame * period_s
        if late_s < 0:
            self._stop.wait(-late_s)
        return frame + max(0, int(late_s / period_s))

    def _send_frame(self, camera: socket.socket, number: int, data: bytes) -> None:
        """One frame's pixels, B G R row by row; none is the end."""
        self._send(camera, struct.pack("<4sIQ", b"RFTF", len(data), number) + data)

    def _send(self, camera: socket.socket, data: bytes) -> None:
        """All of it, however slowly the camera reads, unless the server is to stop."""
        view = memoryview(data)
        while view and not self._stop.is_set():
            try:
                view = view[camera.send(view) :]
            except TimeoutError:
                continue


def _listen(path: Path) -> socket.socket:
    if path.is_socket():
        with socket.socket(socket.AF_UNIX) as probe:
            try:
                probe.connect(str(path))
            except OSError:
                path.unlink(missing_ok=True)  # left over by a server that died
            else:
                raise InputError(f"{path}: another twin serves there: stop it, or choose another --socket")
    listener = socket.socket(socket.AF_UNIX)
    try:
        listener.bind(str(path))
    except OSError as error:
        listener.close()
        raise InputError(f"{path}: cannot serve there ({error}): choose another --socket") from error
    listener.listen(1)
    listener.settimeout(POLL_S)
    return listener
