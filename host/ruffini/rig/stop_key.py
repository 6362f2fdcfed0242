"""A key that stops the stage: any key on the terminal, while it is in use."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Iterator

from ruffini.errors import RefusedError
from ruffini.rig.stage import Guard, no_guard


def stdin() -> int | None:
    """Descriptor of the standard input; None where there is none."""
    try:
        return sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):  # closed, or not a file at all
        return None


@contextlib.contextmanager
def stop_key(descriptor: int | None = None) -> Iterator[Guard]:
    """A guard that raises RefusedError once a key was pressed; lets everything pass where there is no terminal."""
    terminal = stdin() if descriptor is None else descriptor
    if terminal is None or not os.isatty(terminal):
        yield no_guard
        return

    def check() -> None:
        if select.select([terminal], [], [], 0)[0]:
            os.read(terminal, 1024)
            raise RefusedError("stopped by a key: what was collected is kept, the same command goes on from there")

    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)
    try:
        yield check
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
