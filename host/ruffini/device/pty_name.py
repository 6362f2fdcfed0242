"""The names of pseudo-terminals are reused: whether a name still leads to the one that it was meant for.

/dev/pts/3 is given to the next program that asks for a pseudo-terminal as soon as the one before has closed it. A host
that opens a remembered name or link again after its line was lost would take a stranger's line, and that stranger would
find its own line busy.
"""

from __future__ import annotations

import contextlib
import os
import stat
import weakref

PTY_FOLDER = "/dev/pts/"


class KnownPort:
    """A port as it is while it is open; other ports than pseudo-terminals keep their names and are never stale."""

    def __init__(self, port: str) -> None:
        self.port = port
        self._link = _link_of(port)
        self._there: int | None = None
        with contextlib.suppress(OSError):
            if os.path.realpath(port).startswith(PTY_FOLDER):
                # O_PATH holds the name's file without opening the line: its hang-up is seen as before.
                self._there = os.open(port, os.O_PATH | os.O_CLOEXEC)
                weakref.finalize(self, os.close, self._there)

    def is_stale(self) -> bool:
        """True if the pseudo-terminal is gone, and the name was not made to lead to a new one since."""
        if self._there is None or os.fstat(self._there).st_nlink > 0:
            return False
        if self._link is None:
            return True
        with contextlib.suppress(OSError):
            # A link that was made again within a tick of the clock may look as it did, but not older than its target.
            target, link = os.stat(self.port), os.lstat(self.port)
            return self._link == _link_of(self.port) and target.st_ctime_ns > link.st_mtime_ns
        return False


def _link_of(port: str) -> tuple[int, int, int] | None:
    """What changes when a link is made again; None if `port` is no link."""
    with contextlib.suppress(OSError):
        found = os.lstat(port)
        if stat.S_ISLNK(found.st_mode):
            return found.st_dev, found.st_ino, found.st_ctime_ns
    return None
