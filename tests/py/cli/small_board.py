"""What the tests of the command line share: a small board's files, and the command line as a function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ruffini.boards import Board

BASE = Path(__file__).parents[2] / "data" / "boards" / "base.toml"
COARSE = {'name = "sample"': 'name = "small"', "n_x = 31\nn_y = 25\nn_layers = 6": "n_x = 11\nn_y = 9\nn_layers = 3"}
SHAPE = (9, 11, 3)  # nodes of that board, all of them observed

Run = Callable[..., tuple[int, str, str]]


@dataclass(frozen=True)
class Files:
    """A board's folder and its calibrations: operator alone, and with colours."""

    board: Board
    folder: Path
    operator: Path
    calibration: Path
