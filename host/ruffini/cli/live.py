"""`ruffini live`."""

from __future__ import annotations

from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, note
from ruffini.cli.own_camera import chosen_unit
from ruffini.cli.view import HTTP_PORT, show_page


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
    from ruffini.device import Connection
    from ruffini.errors import NoDeviceError
    from ruffini.live import unit

    source, board = chosen_unit(camera, board_name)
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
