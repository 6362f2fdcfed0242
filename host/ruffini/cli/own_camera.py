"""A camera at this computer, or a recording, as the sensor of a verb: the firmware runs here."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ruffini.cli.common import note

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from ruffini.boards import Board
    from ruffini.live.unit import Source


@contextlib.contextmanager
def own_camera(camera: str, board_name: str | None) -> Iterator[str]:
    """The port of the firmware that runs on a camera at this computer; what ended it early is said."""
    from ruffini.live.unit import running_unit

    source, board = chosen_unit(camera, board_name)
    note(f"starting ruffinid on {source.text} as {board.name}")
    with running_unit(source, board) as daemon:
        try:
            yield daemon.port
        finally:
            if daemon.has_ended() and (said := daemon.problem()):
                note(said)


def chosen_unit(camera: str | None, board_name: str | None) -> tuple[Source, Board]:
    """Source of frames and board of a sensor at this computer; a person at a terminal chooses where several fit.

    Parameters
    ----------
    camera : a camera's path, serial number or a part of its name, a video, or a folder of pictures; None: the only
        camera.
    board_name : name of a board, or a folder with a board.toml; None: by USB identity or picture size.
    """
    from ruffini.boards import board_names, find_board
    from ruffini.live import cameras, unit

    def all_boards() -> list[Board]:
        return [find_board(name) for name in board_names()]

    board = find_board(board_name) if board_name else None
    if camera and (Path(camera).is_file() or Path(camera).is_dir()):  # a device is neither
        source = unit.of_recording(Path(camera))
        if board is None:
            size = unit.picture_size(Path(camera))
            board = _asked(cameras.boards_of_size(all_boards(), *size), f"{camera} ({size[0]}x{size[1]})")
    else:
        chosen = cameras.choose_camera(cameras.local_cameras(), camera)
        source = unit.of_camera(chosen)
        board = board or _asked(cameras.boards_of_camera(all_boards(), chosen), chosen.text)
    return source, board


def _asked(boards: Sequence[Board], what: str) -> Board:
    """The one that fits; a person at a terminal chooses of several."""
    from ruffini.live.cameras import the_one

    if len(boards) < 2 or not sys.stdin.isatty():
        return the_one(boards, what)
    for i, board in enumerate(boards, 1):
        note(f"  {i}  {board.name}: {board.board.product}")
    while True:
        number: int = typer.prompt(f"{what} may be each of these: number", type=int, err=True)
        if 1 <= number <= len(boards):
            return boards[number - 1]
