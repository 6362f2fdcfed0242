"""A paper's experiment on the twin: its tables and figures, with our numbers beside the paper's. SIMULATED.

`experiment` of the package that reproduce.toml names (`method = ...`), with `reproduce(board, folder, out, options)`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.sim.reproduce.settings import load_reproduce

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Figure:
    """One number of an experiment. method : the paper's own method on the same presses; paper : printed; None: none."""

    ours: float
    method: float | None = None
    paper: float | None = None


@dataclass(frozen=True)
class Experiment:
    """What came out: numbers for --json, text for a person, pictures on disk, the figures of wanted.toml."""

    result: dict[str, Any]
    text: str
    pictures: list[Path]
    figures: dict[str, Figure]


@dataclass(frozen=True)
class Options:
    """quick : fewer runs; folder : where recordings are kept, of each bench a subfolder; network : a learned network of
    `ruffini train`, judged beside ours where the experiment has one.
    """

    folder: Path | None = None
    quick: bool = False
    n_workers: int = 1
    progress: Progress = field(default=lambda _: None)
    network: Path | None = None


def reproduce(board: Board, out: Path, options: Options) -> Experiment:
    """Play the experiment of the board's paper.

    Raises
    ------
    InputError
        The board has no paper, or nobody wrote its experiment.
    """
    method = load_reproduce(board).method
    try:
        module = importlib.import_module(f"papers.{method}.experiment")
    except ModuleNotFoundError as error:
        if error.name not in (f"papers.{method}", f"papers.{method}.experiment"):
            raise
        raise InputError(
            f"the experiment of board {board.name!r} is not written: its paper's method is judged by "
            f"`ruffini reproduce {board.name} --only method`"
        ) from error
    found: Experiment = module.reproduce(board, out, options)
    return found
