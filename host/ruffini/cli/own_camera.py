"""A camera at this computer, or a recording, as the sensor of a verb: the firmware runs here."""

from __future__ import annotations

import contextlib
import sys
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
    """As `ruffini.live.unit.choose`; of several boards a person at a terminal chooses."""
    from ruffini.live.unit import choose

    return choose(camera, board_name, _asked)


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
