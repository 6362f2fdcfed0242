"""Each paper's own method on the twin's recordings of its bench, beside what the paper prints. SIMULATED.

Fitted on what the paper fits on, judged on what it judges on; where the paper does not say, the board's README does.
The twin's and the bench's constants are frozen: `digest` in each board's frozen.toml.
"""

from __future__ import annotations

import importlib
import os
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from ruffini.bench.papers.recorded import Recorded, recorded_runs
from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.sim.reproduce.make import digest, reproduce
from ruffini.sim.reproduce.settings import load_reproduce

Progress = Callable[[float], None]


class Judge(Protocol):
    """What a module of this package offers as `judge`."""

    def __call__(self, board: Board, runs: list[Recorded]) -> dict[str, float]:
        """Figures by name, in the units of the board's [[published]]."""


def default_folder(board: Board) -> Path:
    """Where the recordings of a board's bench are kept: `$XDG_CACHE_HOME/ruffini/papers/<board>-<digest>`."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "ruffini" / "papers" / f"{board.name}-{digest(board)[:12]}"


def is_frozen(board: Board) -> bool:
    """Whether board, twin and bench are those that were frozen when the method was judged."""
    path = (board.folder or Path()) / "frozen.toml"
    try:
        return bool(tomllib.loads(path.read_text("utf-8"))["digest"] == digest(board))
    except (OSError, KeyError, tomllib.TOMLDecodeError):
        return False


def run(
    board: Board, *, quick: bool, folder: Path | None = None, n_workers: int = 1, progress: Progress = lambda _: None
) -> dict[str, Any]:
    """Record what is missing, then fit and judge the paper's method.

    Raises
    ------
    InputError
        The board has no paper, or names no method.
    """
    settings = load_reproduce(board)
    if settings.method is None:
        raise InputError(f"reproduce.toml of board {board.name!r} names no method: nothing can be judged")
    folder = folder or default_folder(board)
    outcome = reproduce(board, folder, quick=quick, n_workers=n_workers, progress=lambda done: progress(0.8 * done))
    judge: Judge = importlib.import_module(f"ruffini.bench.papers.{settings.method}").judge
    figures = judge(board, recorded_runs(board, folder, quick=quick))
    progress(1.0)
    printed = {p.name: p for p in settings.published}
    rows = []
    for name in [*printed, *(n for n in figures if n not in printed)]:
        p, value = printed.get(name), figures.get(name)
        paper = p.value_1e6 * 1e-6 if p else None
        rows.append(
            {"name": name, "twin": value, "paper": paper, "unit": p.unit if p else "", "where": p.where if p else "",
             "ratio": value / paper if value is not None and paper else None}
        )  # fmt: skip
    return {
        "board": board.name, "paper": settings.paper, "method": settings.method, "quick": quick,
        "simulated": True, "frozen": is_frozen(board), "failed": outcome.failed, "rows": rows,
    }  # fmt: skip


def table(result: dict[str, Any]) -> str:
    """One board's result as text."""
    frozen = "frozen" if result["frozen"] else "NOT FROZEN: its settings changed since they were judged"
    quick = ", quick subset: not the figures of the README" if result["quick"] else ""
    lines = [f"{result['board']}: {result['method']} on the twin, SIMULATED, {frozen}{quick}",
             f"  {'':44}{'twin':>9}{'paper':>9}{'ratio':>7}"]  # fmt: skip
    for row in result["rows"]:
        twin, paper, ratio = (
            "-" if row[key] is None else f"{row[key]:.3g}" if key != "ratio" else f"{row[key]:.2f}"
            for key in ("twin", "paper", "ratio")
        )
        lines.append(f"  {row['name'] + (', ' + row['unit'] if row['unit'] else ''):44}{twin:>9}{paper:>9}{ratio:>7}")
    return "\n".join(lines)
