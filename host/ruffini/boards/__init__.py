"""board.toml, read by the firmware's own parser, and the boards that come with ruffini."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

from ruffini.boards.settings import Board, Markers, Pad, Section, Skin
from ruffini.errors import InputError
from ruffini.files import readable
from ruffini.native import library

__all__ = ["Board", "Markers", "Pad", "Section", "Skin", "board_names", "boards_folder", "find_board", "parse_board"]


def parse_board(text: str | bytes, where: str) -> Board:
    """Board of a board.toml's text; `where` names the file in messages.

    Raises
    ------
    InputError
        The parser refuses the file; its sentence says what, where and what to do.
    RuffiniError
        libruffini is missing.
    """
    raw = text.encode() if isinstance(text, str) else text
    core = library()
    json = core.ruffini_board_json(raw, ctypes.c_size_t(len(raw)), os.fsencode(where))
    if json is None:
        raise InputError(os.fsdecode(core.ruffini_error()))
    board = Board.model_validate_json(json)
    object.__setattr__(board, "_text", raw.decode())
    return board


def boards_folder() -> Path:
    """Where the boards are: RUFFINI_BOARDS, beside the package, or the repository's boards/."""
    candidates = [Path(p) for p in (os.environ.get("RUFFINI_BOARDS"),) if p]
    here = Path(__file__).resolve()
    candidates += [here.parent / "data", here.parents[3] / "boards"]
    for folder in candidates:
        if folder.is_dir():
            return folder
    raise InputError("no boards folder found: set RUFFINI_BOARDS to one")


def board_names() -> list[str]:
    """Names of the boards that come with ruffini."""
    return sorted(p.parent.name for p in boards_folder().glob("*/board.toml"))


def find_board(name_or_folder: str | Path) -> Board:
    """A board by name, or anybody's folder that holds a board.toml.

    Raises
    ------
    InputError
        Nothing there, or the file is refused; or [board] name is not the folder's name.
    """
    folder = Path(name_or_folder)
    if not (folder / "board.toml").is_file():
        folder = boards_folder() / str(name_or_folder)
    path = folder / "board.toml"
    if not path.is_file():
        raise InputError(
            f"no board {str(name_or_folder)!r}: give a folder with a board.toml or one of {', '.join(board_names())}"
        )
    board = parse_board(readable(path).read_bytes(), str(path))
    if board.name != path.resolve().parent.name:
        raise InputError(
            f"{path}: board.name is {board.name!r} but the folder is called {path.resolve().parent.name!r}"
        )
    object.__setattr__(board, "_folder", folder)
    return board
