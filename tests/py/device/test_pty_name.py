"""A pseudo-terminal's name that was given to a stranger meanwhile is not opened again."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from ruffini.device.ports import open_port
from ruffini.device.pty_name import KnownPort
from ruffini.errors import NoDeviceError

TICK_S = 0.01  # of the kernel's clock: what is made later than that has a later time


class Pty:
    """One that a test holds; `name` is where the other end is opened."""

    def __init__(self) -> None:
        self.master, slave = os.openpty()
        self.name = os.ttyname(slave)
        os.close(slave)

    def close(self) -> None:
        os.close(self.master)


@contextlib.contextmanager
def stranger_at(name: str) -> Iterator[Pty | None]:
    """Another program's pseudo-terminal under the name of one that was closed; None where it is another process's."""
    time.sleep(TICK_S)
    made = [Pty()]
    while made[-1].name != name and len(made) < 100:
        made.append(Pty())
    try:
        yield made[-1] if made[-1].name == name else None
    finally:
        for each in made:
            each.close()


@pytest.mark.parametrize("by_link", [False, True], ids=["name", "link"])
def test_a_strangers_line_under_the_old_name_is_left_alone(tmp_path: Path, by_link: bool) -> None:
    first, link = Pty(), tmp_path / "tty"
    link.symlink_to(first.name)
    port = str(link) if by_link else first.name
    line = open_port(port)
    known = KnownPort(port)
    assert not known.is_stale()
    line.close()
    open_port(port, known).close()  # it is the same: a line that was only closed is opened again
    number = os.open(first.name, os.O_RDWR | os.O_NOCTTY)  # until this is closed, nobody gets the number
    first.close()
    assert known.is_stale() is not by_link, "a link may be made again; the number may not"
    os.close(number)
    with stranger_at(first.name) as stranger:
        with pytest.raises(NoDeviceError, match=f"{port} is gone, and its name may be another program's"):
            open_port(port, known)
        if stranger is not None:
            open_port(stranger.name).close()


def test_a_link_that_was_made_again_is_followed(tmp_path: Path) -> None:
    first, link = Pty(), tmp_path / "tty"
    link.symlink_to(first.name)
    known = KnownPort(str(link))
    first.close()
    second = Pty()  # most likely of the same number, and at once
    link.unlink()
    link.symlink_to(second.name)
    open_port(str(link), known).close()
    second.close()


def test_what_is_no_pseudo_terminal_is_never_stale(tmp_path: Path) -> None:
    (tmp_path / "ttyACM0").touch()
    known = KnownPort(str(tmp_path / "ttyACM0"))
    (tmp_path / "ttyACM0").unlink()
    assert not known.is_stale()
    assert not KnownPort(str(tmp_path / "none")).is_stale()
