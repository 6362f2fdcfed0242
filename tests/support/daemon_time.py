"""The time of a ruffinid that was started with `--clock`: it stands still until a test lets it go on."""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

FIRST_US = 1_000_000_000  # as after a quarter of an hour: nothing is due that a start makes due


class DaemonTime:
    """`options` are those of the daemon; several daemons may share one time."""

    def __init__(self, folder: Path) -> None:
        path = folder / "clock"
        path.write_bytes(struct.pack("<Q", FIRST_US))
        with path.open("r+b") as file:
            self._word = memoryview(mmap.mmap(file.fileno(), 8)).cast("Q")
        self.options = ("--clock", str(path))

    @property
    def now_us(self) -> int:
        return self._word[0]

    def advance(self, seconds: float) -> None:
        """Let time go on; written in one piece."""
        self._word[0] += round(1e6 * seconds)
