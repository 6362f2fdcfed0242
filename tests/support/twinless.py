"""A board that nobody can simulate."""

from __future__ import annotations

import shutil
from pathlib import Path

from ruffini.boards import Board, find_board

MINI = Path(__file__).parents[2] / "boards" / "gelsight-mini" / "board.toml"


def board_without_twin(folder: Path) -> Board:
    """A board folder below `folder` that has a board.toml and no twin.toml."""
    own = folder / MINI.parent.name
    own.mkdir()
    shutil.copy(MINI, own)
    return find_board(own)
