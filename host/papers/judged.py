"""Each paper's own method on the twin's recordings of its bench, beside what the paper prints. SIMULATED.

Fitted on what the paper fits on, judged on what it judges on; where the paper does not say, the board's README does.
The twin's and the bench's constants are frozen: `digest` in each board's frozen.toml.
"""

from __future__ import annotations

import importlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from papers.recorded import Recorded, recorded_runs
from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.files import readable, write_whole
from ruffini.older_python import tomllib
from ruffini.sim.reproduce.make import digest, reproduce
from ruffini.sim.reproduce.settings import load_reproduce

Progress = Callable[[float], None]


class Judge(Protocol):
    """What `bench` of a paper offers as `judge`."""

    def __call__(self, board: Board, runs: list[Recorded]) -> dict[str, float]:
        """Figures by name, in the units of the board's [[published]]."""


def default_folder(board: Board) -> Path:
    """Where the recordings of a board's bench are kept: `$XDG_CACHE_HOME/ruffini/papers/<board>-<digest>`."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "ruffini" / "papers" / f"{board.name}-{digest(board)[:12]}"


WITHIN = 0.2  # of the paper's figure, what counts as reproduced


@dataclass(frozen=True)
class Frozen:
    """frozen.toml: what the twin was when the method was judged on it, what came out, and why some of it is far off.

    digest : of the bench, the twin and its board; is_quick : figures are of the quick subset; beyond : a reason for
    each of them that is not within 20 % of the paper's, or was not judged; ours, ours_quick : of the experiment.
    """

    digest: str
    is_quick: bool
    figures: dict[str, float]
    beyond: dict[str, str]
    ours: dict[str, float] = field(default_factory=dict)
    ours_quick: dict[str, float] = field(default_factory=dict)


def load_frozen(board: Board) -> Frozen | None:
    """frozen.toml beside the board's board.toml; None where there is none.

    Raises
    ------
    InputError
        It is not as it should be.
    """
    path = (board.folder or Path()) / "frozen.toml"
    if not path.is_file():
        return None
    try:
        tree = tomllib.loads(readable(path).read_text("utf-8"))
        parts = (dict(tree.get(name, {})) for name in ("beyond", "ours", "ours_quick"))
        return Frozen(str(tree["digest"]), bool(tree["quick"]), dict(tree["figures"]), *parts)
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path} is not as it should be ({error}): make it with ruffini reproduce --only method --freeze"
        ) from error


def freeze(board: Board, result: dict[str, Any]) -> Path:
    """Write what `run` gave as the board's frozen.toml; the reasons that stand in it stay.

    Raises
    ------
    InputError
        It cannot be written.
    """
    before = load_frozen(board)
    figures = {row["name"]: row["twin"] for row in result["rows"] if row["twin"] is not None}
    reasons = {name: text for name, text in (before.beyond if before else {}).items() if name in _beyond(result)}
    ours = (before.ours, before.ours_quick) if before else ({}, {})
    return _write(board, Frozen(digest(board), bool(result["quick"]), figures, reasons, *ours))


def freeze_ours(board: Board, figures: dict[str, float], *, quick: bool) -> Path:
    """Write our figures of an experiment into the board's frozen.toml; all else in it stays.

    Raises
    ------
    InputError
        The paper's method was not frozen before, or the file cannot be written.
    """
    before = load_frozen(board)
    if before is None:
        raise InputError(f"board {board.name!r} has no frozen.toml: run --only method --freeze first")
    return _write(board, replace(before, ours_quick=figures) if quick else replace(before, ours=figures))


def _write(board: Board, frozen: Frozen) -> Path:
    lines = [
        "# Written by `ruffini reproduce --freeze`; the reasons of [beyond] by hand.",
        f'digest = "{frozen.digest}"',
        f"quick = {json.dumps(frozen.is_quick)}",
    ]
    for name in ("figures", "ours", "ours_quick"):
        values = getattr(frozen, name)
        if values or name == "figures":
            lines += ["", f"[{name}]", *(f"{json.dumps(key)} = {value:.4g}" for key, value in values.items())]
    if frozen.beyond:
        lines += ["", "[beyond]", *(f"{json.dumps(key)} = {json.dumps(text)}" for key, text in frozen.beyond.items())]
    path = (board.folder or Path()) / "frozen.toml"
    write_whole(path, ("\n".join(lines) + "\n").encode())
    return path


def _beyond(result: dict[str, Any]) -> list[str]:
    """Figures that the paper prints and the twin does not reproduce."""
    return [
        row["name"]
        for row in result["rows"]
        if row["paper"] is not None and (row["ratio"] is None or abs(row["ratio"] - 1) > WITHIN)
    ]


def is_frozen(board: Board) -> bool:
    """Whether board, twin and bench are those that were frozen when the method was judged."""
    kept = load_frozen(board)
    return kept is not None and kept.digest == digest(board)


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
    judge: Judge = importlib.import_module(f"papers.{settings.method}.bench").judge
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
