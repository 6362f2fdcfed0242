"""A glowing skin: straight presses all round; judged by the force above HARD_N, and by the place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Outcome
from ruffini.calibrate.gates import HARD_N
from ruffini.estimators.task import NO_SHORE, Counts, Task, Word, joined
from ruffini.rig.found import is_settled
from ruffini.rig.log_file import Log, TouchRecord
from ruffini.rig.program import Item, Span, plan, span_of

Array = npt.NDArray[np.float64]


def _skin_word(board: Board, _: Log, touch: TouchRecord, true: Array) -> Word:
    """The end of the hold, as one row: force of the contact nearest to the tip (0 where none is told), and how far."""
    a = touch.arrays
    held = is_settled(a["stream_host_s"], touch.facts)
    is_told = np.isin(a.get("contact_s", np.zeros(0)), a["stream_s"][held])
    said, off_m = np.full((1, 6), np.nan), np.full((1, 2), np.nan)
    said[0, 2] = 0.0
    if is_told.any():
        away = a["contact_place"][is_told] - a["stage_place"][-1, :2]
        if board.skin is not None and board.skin.shape == "tube":
            round_m = board.pad.size_x_um * 1e-6
            away[:, 0] = (away[:, 0] + round_m / 2) % round_m - round_m / 2
        number = a["contact_number"][is_told]
        nearest = number == number[np.linalg.norm(away, axis=1).argmin()]
        off_m[0], said[0, 2] = away[nearest].mean(axis=0), a["contact_force"][is_told][nearest].mean()
    return Word(said, true[held].mean(axis=0, keepdims=True), off_m, NO_SHORE)


def _skin_figures(words: list[Word]) -> dict[str, Any]:
    said, true, off_m, _ = joined(words)
    off_n, load = np.abs(said - true)[:, 2], np.abs(true[:, 2])
    is_hard, is_told = load > HARD_N, np.isfinite(off_m).all(axis=1)
    away = np.linalg.norm(off_m[is_told], axis=1)
    return {
        "error": float(100 * np.mean((off_n / load)[is_hard])) if is_hard.any() else float("nan"),
        "touches": len(words), "hard_touches": int(is_hard.sum()), "untold": int((~is_told).sum()),
        "force_rmse_n": float(np.sqrt(np.mean(off_n**2))), "largest_force_n": float(load.max()),
        "place_mm": float(1e3 * away.mean()) if len(away) else None,
    }  # fmt: skip


def _skin_left_out(outcomes: dict[str, Outcome]) -> float:
    return float(outcomes["skin"].report["force_error_percent"])


def _straight(span: Span, n: int, seed: int) -> Sequence[Item]:
    return plan("balls", span, n, seed)


def _all_round(board: Board, depth_m: float, shear_m: float, reach_m: tuple[float, float] | None) -> Span:
    """A tube is pressed all the way round."""
    span = span_of(board, depth_m, shear_m, reach_m)
    is_tube = board.skin is not None and board.skin.shape == "tube"
    return span._replace(half_x_m=board.pad.size_x_um * 5e-7) if is_tube else span


TASK = Task(
    "skin", "balls", Counts(0, 60, 20, 0), Counts(0, 40, 6, 0), 3.4, 0.0, 10.0, "% of a force above 2 N, mean",
    _all_round, _straight, _straight, _skin_word, _skin_figures, _skin_left_out,
    needs_points=True,
)  # fmt: skip
