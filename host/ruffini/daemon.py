"""ruffinid as a child process on a pseudo-terminal."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

from ruffini.core import native_folder
from ruffini.errors import RuffiniError

START_TIMEOUT_S = 20.0


def find_daemon() -> Path:
    """The ruffinid binary: RUFFINI_DAEMON, the build tree, or the PATH."""
    candidates = [
        os.environ.get("RUFFINI_DAEMON"),
        str(native_folder().parent / "ruffinid"),
        shutil.which("ruffinid"),
    ]
    for candidate in candidates:
        if candidate and Path(candidate).is_file():
            return Path(candidate)
    raise RuffiniError("ruffinid was not found: run `make build`, or set RUFFINI_DAEMON")


@contextlib.contextmanager
def running_daemon(board_folder: Path, camera: str, store: Path, *options: str) -> Iterator[str]:
    """Start ruffinid on a camera (replay:PATH, twin:SOCKET).

    Yields the port that a host opens; ends the daemon on exit.

    Raises
    ------
    RuffiniError
        It does not start; the text is its own.
    """
    command = [
        str(find_daemon()), "--board", str(board_folder), "--camera", camera,
        "--link", "pty", "--store", str(store), *options,
    ]  # fmt: skip
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stderr is not None
            ready, _, _ = select.select([process.stdout], [], [], START_TIMEOUT_S)
            line = process.stdout.readline() if ready else ""
            if not line.startswith("link: "):
                process.kill()
                said = process.stderr.read().strip().splitlines()
                raise RuffiniError("; ".join(said) or "ruffinid did not start")
            yield line.removeprefix("link: ").strip()
        finally:
            process.terminate()
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                process.kill()
