"""`ruffini live`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ruffini.cli.common import JsonFlag, note
from ruffini.cli.view import HTTP_PORT, show_page

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ruffini.boards import Board


def live(
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|VIDEO|FOLDER",
            help="A camera by its path, serial number or a part of its name; a video; a folder of pictures.",
        ),
    ] = None,
    board_name: Annotated[
        str | None, typer.Option("--board", metavar="BOARD", help="Board name, or a folder with a board.toml.")
    ] = None,
    http_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of this computer for the page (0 = any that is free).")
    ] = HTTP_PORT,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address and open nothing.")] = False,
    json_: JsonFlag = False,
) -> None:
    """Your own camera as a sensor: the firmware runs on this computer, the page opens in a browser."""
    note(f"live: looking at {camera}" if camera else "live: looking for cameras")
    from ruffini.boards import board_names, find_board
    from ruffini.device import Connection
    from ruffini.errors import NoDeviceError
    from ruffini.live import cameras, unit

    def all_boards() -> list[Board]:
        return [find_board(name) for name in board_names()]

    board = find_board(board_name) if board_name else None
    if camera and not camera.startswith("/dev/") and Path(camera).exists():
        source = unit.of_recording(Path(camera))
        if board is None:
            size = unit.picture_size(Path(camera))
            board = _asked(cameras.boards_of_size(all_boards(), *size), f"{camera} ({size[0]}x{size[1]})")
    else:
        chosen = cameras.choose_camera(cameras.local_cameras(), camera)
        source = unit.of_camera(chosen)
        board = board or _asked(cameras.boards_of_camera(all_boards(), chosen), chosen.text)
    note(f"live: starting ruffinid on {source.text} as {board.name}")
    with unit.running_unit(source, board) as daemon:
        with Connection(daemon.port) as sensor:
            note(f"live: {board.name} is {unit.what_is_missing(board, sensor.hello.sensors[0].calibration)}")
        show_page(
            [daemon.port], http_port, no_browser=no_browser, json_=json_, is_over=daemon.has_ended,
            folder=unit.calibrations_folder(board, source.key),
        )  # fmt: skip
        if daemon.has_ended() and (said := daemon.problem()):
            raise NoDeviceError(said)


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
