"""ruffinid as a child process on a pseudo-terminal."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from ruffini.core import native_folder
from ruffini.errors import InputError, NoDeviceError, RefusedError, RuffiniError, VerifyError

START_TIMEOUT_S = 20.0
END_TIMEOUT_S = 5.0
# By its exit code.
ERRORS = {error.exit_code: error for error in (InputError, NoDeviceError, RefusedError, VerifyError)}


def find_daemon() -> Path:
    """The ruffinid binary: RUFFINI_DAEMON, the wheel's, the build tree's, or the PATH."""
    candidates = [
        os.environ.get("RUFFINI_DAEMON"),
        str(native_folder() / "ruffinid"),  # of a wheel
        str(native_folder().parent / "ruffinid"),
        shutil.which("ruffinid"),
    ]
    for candidate in candidates:
        if candidate and Path(candidate).is_file():
            return Path(candidate)
    raise RuffiniError("ruffinid was not found: run `make build`, or set RUFFINI_DAEMON")


class Daemon:
    """ruffinid as a child process; `port` is what a host opens."""

    def __init__(self, process: subprocess.Popen[str], log: IO[str], port: str) -> None:
        self.port = port
        self._process, self._log = process, log

    @property
    def pid(self) -> int:
        """Of its process."""
        return self._process.pid

    def has_ended(self) -> bool:
        """Whether it runs no more."""
        return self._process.poll() is not None

    def problem(self) -> str:
        """Its last words, if it has ended on its own and not well; empty otherwise."""
        return _words(self._log)[-1] if self._process.poll() and _words(self._log) else ""


def _words(log: IO[str]) -> list[str]:
    log.seek(0)
    return [line.removeprefix("ruffinid: ") for line in log.read().strip().splitlines()]


@contextlib.contextmanager
def started_daemon(board_folder: Path, camera: str, store: Path, *options: str) -> Iterator[Daemon]:
    """Start ruffinid on a camera (v4l2:NAME, replay:PATH, twin:SOCKET); end it on exit.

    Raises
    ------
    RuffiniError
        It does not start; the class is that of its exit code, the text is its own.
    """
    command = [
        str(find_daemon()), "--board", str(board_folder), "--camera", camera,
        "--link", "pty", "--store", str(store), *options,
    ]  # fmt: skip
    # A file for what it logs: nobody reads a pipe while it runs, and a full one would stop it.
    with (
        tempfile.TemporaryFile("w+", errors="replace") as log,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True) as process,
    ):
        try:
            assert process.stdout is not None
            ready, _, _ = select.select([process.stdout], [], [], START_TIMEOUT_S)
            line = process.stdout.readline() if ready else ""
            if not line.startswith("link: "):
                if ready:  # it has closed its output, so it ends
                    process.wait(END_TIMEOUT_S)
                process.kill()
                kind = ERRORS.get(process.wait(), RuffiniError)
                raise kind("; ".join(_words(log)) or "ruffinid did not start")
            yield Daemon(process, log, line.removeprefix("link: ").strip())
        finally:
            process.terminate()
            try:
                process.wait(END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()


@contextlib.contextmanager
def running_daemon(board_folder: Path, camera: str, store: Path, *options: str) -> Iterator[str]:
    """`started_daemon` for those who need its port alone."""
    with started_daemon(board_folder, camera, store, *options) as daemon:
        yield daemon.port
