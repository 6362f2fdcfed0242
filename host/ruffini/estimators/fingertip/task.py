"""A fingertip on a bench: straight presses of flat tools at tilts, judged by the force along the tool."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Outcome
from ruffini.errors import InputError
from ruffini.estimators.fingertip.fit import LEAST
from ruffini.estimators.fingertip.presses import FACES, axes
from ruffini.estimators.fingertip.report import MOST, full_n
from ruffini.estimators.task import NO_SHORE, Counts, Task, Word, joined
from ruffini.rig.found import is_held
from ruffini.rig.holder import UPRIGHT
from ruffini.rig.log_file import Log, TouchRecord, stated_wrench
from ruffini.rig.program import Item, Span, plan, span_of

Array = npt.NDArray[np.float64]

ASIDE_PART = 0.3  # of the radius: further out a tool's edge slides down the side


def _word(board: Board, _: Log, touch: TouchRecord, true: Array) -> Word:
    """Frames of a force that counts, along the tool: the stream has its part along the fingertip's z."""
    upright = axes(*np.deg2rad(touch.facts["tilt_deg"]))[2, 2]
    part = -true[:, 2] / full_n(board)
    kept = is_held(touch.arrays["stream_host_s"], touch.facts) & (part > LEAST) & (part < MOST)
    said = np.full((int(kept.sum()), 6), np.nan)
    said[:, 2] = stated_wrench(touch)[kept, 2] / upright
    return Word(said, true[kept], np.full((len(said), 2), np.nan), NO_SHORE)


def _figures(words: list[Word]) -> dict[str, Any]:
    said, true, *_ = joined(words)
    told = np.isfinite(said[:, 2])
    off = np.abs(said[told, 2] - true[told, 2])
    return {
        "error": 1e3 * float(off.mean()) if told.any() else float("nan"), "touches": len(words),
        "frames": len(said), "told": int(told.sum()),
        "largest_force_n": float(np.abs(true[:, 2]).max(initial=0.0)),
    }  # fmt: skip


def _left_out(outcomes: dict[str, Outcome]) -> float:
    return 1e3 * float(outcomes["fingertip"].report["mean_error_of_presses_left_out"]["both"]["force_n"])


def _presses(span: Span, n: int, seed: int) -> Sequence[Item]:
    return plan("indenters", span, n, seed)


def _about_the_top(board: Board, depth_m: float, shear_m: float, reach_m: tuple[float, float] | None) -> Span:
    span = span_of(board, depth_m, shear_m, reach_m)
    most_m = ASIDE_PART * board.pad.size_x_um * 5e-7
    return span._replace(half_x_m=min(span.half_x_m, most_m), half_y_m=min(span.half_y_m, most_m))


def _check(span: Span) -> None:
    tools, tilts = {tool for tool in span.tools if tool.shape in FACES}, set(span.tilts_deg)
    is_turned = all(any(tilt[axis] for tilt in tilts) for axis in range(2))
    if len({tool.radius_m for tool in tools}) < 2 or not is_turned or UPRIGHT not in tilts:
        raise InputError(
            f"a fingertip is fitted to flat tools ({', '.join(FACES)}) of two sizes, pressed upright and turned about "
            "both axes, at least: list [[indenters]] and [holder] tilts_deg in the bench's file"
        )


TASK = Task(
    "fingertip", "indenters", Counts(0, 120, 24, 0), Counts(0, 40, 8, 0), 1.6, 0.0, 6.0, "mN mean of force",
    _about_the_top, _presses, _presses, _word, _figures, _left_out, check=_check,
)  # fmt: skip
