"""A serial port for one program alone, and who has it where it is taken."""

from __future__ import annotations

import contextlib
import fcntl
import os
import termios
from pathlib import Path
from typing import Any

from ruffini.device.pty_name import PTY_FOLDER


def make_exclusive(serial: Any, port: str) -> None:
    """No other program can open the port from now on; pyserial's lock alone binds those that ask for it.

    A pty is left with the lock: there the mark would outlive a program that is killed.
    """
    if not os.path.realpath(port).startswith(PTY_FOLDER):
        fcntl.ioctl(serial.fileno(), termios.TIOCEXCL)


def holders(port: str) -> list[str]:
    """Programs that have the port open, as far as this user may see: "ruffini (process 123)"."""
    wanted, found = os.path.realpath(port), []
    for process in Path("/proc").glob("[0-9]*"):
        if int(process.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):
            if any(os.path.realpath(fd) == wanted for fd in (process / "fd").iterdir()):
                found.append(f"{(process / 'comm').read_text().strip()} (process {process.name})")
    return sorted(found)
