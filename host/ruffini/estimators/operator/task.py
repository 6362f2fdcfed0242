"""Forces by finite elements: a grid with shear, after ball presses for the colours; judged by force."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Outcome
from ruffini.estimators.task import NO_SHORE, Counts, Task, Word, joined
from ruffini.rig.found import is_settled
from ruffini.rig.log_file import Log, TouchRecord
from ruffini.rig.program import Item, Span, Touch, plan, span_of, spread

Array = npt.NDArray[np.float64]

FITTED_PART = 0.7  # of the span, in which an operator's touches lie; the judged ones are all over it
LONG_EACH, LONG_S = 8, 3.0  # each eighth touch is held so long


def _forces_word(_: Board, __: Log, touch: TouchRecord, true: Array) -> Word:
    """The end of the hold, as one row: what a touch says."""
    held = is_settled(touch.arrays["stream_host_s"], touch.facts)
    said = touch.arrays["stream_wrench"][held].mean(axis=0, keepdims=True)
    return Word(said, true[held].mean(axis=0, keepdims=True), np.full((1, 2), np.nan), NO_SHORE)


def _forces_figures(words: list[Word]) -> dict[str, Any]:
    said, true, *_ = joined(words)
    measured = np.flatnonzero(~np.isnan(said[:, :3]).all(axis=0))
    axes = measured if len(measured) else np.arange(3)  # that nothing was said is no error of 0
    off, force = (said - true)[:, axes], true[:, axes]
    error, largest = np.linalg.norm(off, axis=1), float(np.linalg.norm(force, axis=1).max())
    rmse = float(np.sqrt(np.mean(error**2)))
    return {
        "error": 1e3 * rmse, "touches": len(words), "force_rmse_n": rmse,
        "force_p95_n": float(np.percentile(error, 95)), "force_worst_n": float(error.max()),
        "axes_rmse_n_nm": np.sqrt(np.mean((said - true) ** 2, axis=0)).tolist(), "largest_force_n": largest,
    }  # fmt: skip


def _forces_left_out(outcomes: dict[str, Outcome]) -> float:
    return 1e3 * float(outcomes["material"].report["left_out"]["force_rmse_n"])


def _grid_inside(span: Span, n: int, seed: int) -> Sequence[Item]:
    """Where a dent does not reach the rim that the depth is gauged by; some are held long enough to see it relax."""
    touches = plan("grid", span.inside(FITTED_PART), n, seed)
    return [t._replace(hold_s=LONG_S) if isinstance(t, Touch) and i % LONG_EACH == LONG_EACH - 1 else t
            for i, t in enumerate(touches)]  # fmt: skip


def judged_touches(span: Span, n: int, seed: int) -> Sequence[Item]:
    """Places and depths that no program of a fit has, spread all over the span, two of three sheared."""
    rng, touches = np.random.default_rng(seed), []
    for i, (x, y, depth) in enumerate(spread(n, rng)):
        angle = rng.uniform(0, 2 * np.pi)
        way = 0.0 if i % 3 == 0 else rng.uniform(0.3, 1.0) * span.shear_m
        touches.append(Touch(float((2 * x - 1) * span.half_x_m), float((2 * y - 1) * span.half_y_m),
                             float((0.4 + 0.6 * depth) * span.deepest_m),
                             float(way * np.cos(angle)), float(way * np.sin(angle))))  # fmt: skip
    return touches


TASK = Task(
    "forces", "grid", Counts(30, 40, 20, 120), Counts(16, 16, 8, 40), 0.8, 0.3, 6.0, "mN RMS of force",
    span_of, _grid_inside, judged_touches, _forces_word, _forces_figures, _forces_left_out,
    needs_ball=True, scale_part=FITTED_PART,
)  # fmt: skip
