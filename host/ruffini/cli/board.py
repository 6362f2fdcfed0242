"""Verbs about board folders."""

from __future__ import annotations

from typing import Annotated

import typer

from ruffini.cli.common import JsonFlag, emit


def check(board: Annotated[str, typer.Argument(help="Board name, or a folder.")], json_: JsonFlag = False) -> None:
    """Read board.toml as the firmware does."""
    from ruffini.boards import find_board

    found = find_board(board)
    emit({"board": found.name, "ok": True}, json_, f"{found.name}: ok")


def show(board: Annotated[str, typer.Argument(help="Board name, or a folder.")], json_: JsonFlag = False) -> None:
    """Print a board's settings."""
    from ruffini.boards import find_board

    found = find_board(board)
    emit(found.model_dump(by_alias=True), json_, found.text)


def list_(json_: JsonFlag = False) -> None:
    """Names of the boards that come with ruffini."""
    from ruffini.boards import board_names

    emit({"boards": board_names()}, json_, "\n".join(board_names()))
