"""The cameras of this computer as ruffinid lists them, and the boards that each may be."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from typing import Any, NamedTuple

from ruffini.boards import Board
from ruffini.daemon import find_daemon
from ruffini.errors import InputError, NoDeviceError, RuffiniError, SeveralDevicesError

LIST_TIMEOUT_S = 10.0


class LocalCamera(NamedTuple):
    """A V4L2 camera: its node, names, identity on USB (0: none), and (width, height) of its pictures."""

    path: str
    name: str
    serial: str
    vendor: int
    product: int
    sizes: frozenset[tuple[int, int]]
    problem: str = ""  # why its sizes are not known

    @classmethod
    def from_json(cls, facts: dict[str, Any]) -> LocalCamera:
        """One of `ruffinid --list-cameras`."""
        sizes = frozenset((mode["width_px"], mode["height_px"]) for mode in facts["modes"])
        return cls(facts["path"], facts["name"], facts["serial"], facts["vendor"], facts["product"], sizes,
                   facts["problem"])  # fmt: skip

    @property
    def text(self) -> str:
        """For a person: how `--camera` names it."""
        return f"{self.path} ({self.name}{f', serial number {self.serial}' if self.serial else ''})"

    @property
    def key(self) -> str:
        """What tells this unit from others: its serial number, else its name."""
        return self.serial or self.name


def local_cameras() -> list[LocalCamera]:
    """Every V4L2 camera of this computer.

    Raises
    ------
    RuffiniError
        ruffinid is missing, or does not list them.
    """
    command = [str(find_daemon()), "--list-cameras"]
    said = subprocess.run(command, capture_output=True, timeout=LIST_TIMEOUT_S, check=False)
    try:
        found = json.loads(said.stdout.decode(errors="replace"))["cameras"]
    except (ValueError, KeyError):
        raise RuffiniError(f"{command[0]} lists no cameras: is it of this version? ruffinid --version") from None
    return [LocalCamera.from_json(facts) for facts in found]


def choose_camera(cameras: Sequence[LocalCamera], name: str | None) -> LocalCamera:
    """The camera that `name` means: its path, a part of its name, or its serial number; None: the only one.

    Raises
    ------
    NoDeviceError
        There is none.
    SeveralDevicesError
        Several fit; the message lists them.
    """
    fitting = [c for c in cameras if not name or name in (c.path, c.serial) or name in c.name]
    listed = ", ".join(c.text for c in (fitting or cameras))
    if not fitting:
        what = f"no camera {name!r}: this computer has {listed or 'none'}" if name else "no camera found"
        raise NoDeviceError(f"{what}: plug one in, or give --camera a video or a folder of pictures")
    if len(fitting) > 1:
        raise SeveralDevicesError(f"several cameras: choose one with --camera PATH of {listed}")
    return fitting[0]


def is_recognised(board: Board, camera: LocalCamera) -> bool:
    """Whether the board's [usb] names this camera; of identity and names, each that is given must fit."""
    usb = board.usb
    if usb is None:
        return False
    has_identity = usb.vendor is None or (usb.vendor, usb.product) == (camera.vendor, camera.product)
    return has_identity and (not usb.names or any(name in camera.name for name in usb.names))


def boards_of_camera(boards: Sequence[Board], camera: LocalCamera) -> list[Board]:
    """The boards that [usb] recognises, else those without [usb]; of the camera's picture sizes where it tells them."""
    known = [board for board in boards if is_recognised(board, camera)]
    fitting = known or [board for board in boards if board.usb is None]
    return [b for b in fitting if not camera.sizes or (b.camera.width_px, b.camera.height_px) in camera.sizes]


def boards_of_size(boards: Sequence[Board], width_px: int, height_px: int) -> list[Board]:
    """The boards whose picture is of that size."""
    return [b for b in boards if (b.camera.width_px, b.camera.height_px) == (width_px, height_px)]


def the_one(boards: Sequence[Board], what: str) -> Board:
    """The only board.

    Raises
    ------
    InputError
        None, or several: the message lists them.
    """
    if not boards:
        raise InputError(
            f"{what} fits no shipped board: give --board with your board's folder (docs/how-to/add-a-board.md)"
        )
    if len(boards) > 1:
        raise InputError(f"{what} fits several boards: choose one with --board of {', '.join(b.name for b in boards)}")
    return boards[0]
