"""A contact model of a texture: presses of changed indenters; judged by the normal force, and by their hardness."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Outcome
from ruffini.errors import InputError
from ruffini.estimators.contact_model.log import FACES, HERTZIAN, LEAST_SHORE
from ruffini.estimators.task import Counts, Task, Word, joined
from ruffini.rig.found import is_held
from ruffini.rig.log_file import CONTACT_SHORE, Log, TouchRecord, stated_wrench
from ruffini.rig.program import Item, Span, plan, span_of

Array = npt.NDArray[np.float64]

LEAST_SHAPES, LEAST_HARDNESSES = 2, 3  # each flat shape is judged by a fit without it
MAX_SHORE_A = 16.0  # RMS of hardness on sizes left out: twice what the paper has, since few presses begin with more
TOOL_PLACE_M = (2.2e-3, 1.8e-3)  # from the middle: the texture beside the contact is what tells


def _indent_word(_: Board, __: Log, touch: TouchRecord, true: Array) -> Word:
    """Every frame from the contact on; the hardness that is told last, and that of the indenter."""
    held = is_held(touch.arrays["stream_host_s"], touch.facts)
    shore = touch.arrays.get(CONTACT_SHORE, np.zeros(0))
    told = shore[np.isfinite(shore)]
    rows = np.full((int(held.sum()), 2), np.nan)
    rows[-1:] = (told[-1] if len(told) else np.nan), touch.facts["tool"]["shore_a"]
    return Word(stated_wrench(touch)[held], true[held], np.full_like(rows, np.nan), rows)


def _indent_figures(words: list[Word]) -> dict[str, Any]:
    said, true, _, shore = joined(words)
    known = shore[np.isfinite(shore[:, 1])]
    told = known[np.isfinite(known[:, 0])]
    off = np.nan_to_num(said) - true
    full = float(np.abs(true[:, 2]).max())
    rmse = np.sqrt(np.mean(off**2, axis=0))
    return {
        "error": 100 * float(rmse[2]) / full, "touches": len(words), "normal_rmse_n": float(rmse[2]),
        "axes_rmse_n_nm": [float("nan") if np.isnan(c).all() else float(r) for c, r in zip(said.T, rmse, strict=True)],
        "largest_force_n": full, "untold": int(len(known) - len(told)),
        "shore_rmse": float(np.sqrt(np.mean((told[:, 0] - told[:, 1]) ** 2))) if len(told) else None,
    }  # fmt: skip


def _contact_left_out(outcomes: dict[str, Outcome]) -> float:
    report = outcomes["contact"].report
    return 100 * float(report["left_out_sizes"]["all"]["normal_n"]) / float(report["largest_n"])


def indents(span: Span, n: int, seed: int) -> Sequence[Item]:
    """Presses of the bench's indenters, or of drawn ones, each at a place of its own."""
    return plan("indenters", span, n, seed)


def check(span: Span) -> None:
    """Raises InputError if a fit to a bench's indenters without one of the sizes or shapes could not tell it."""
    if span.tilts_deg:
        raise InputError("a contact model is fitted to straight presses: take [holder] out of the bench's file")
    tools = [tool for tool in span.tools if tool.shore_a >= LEAST_SHORE]
    faces, balls = ([tool for tool in tools if tool.shape in shapes] for shapes in (FACES, HERTZIAN))
    n_hard = len({tool.shore_a for tool in tools})
    if len({tool.shape for tool in faces}) < LEAST_SHAPES or not balls or n_hard < LEAST_HARDNESSES:
        raise InputError(
            f"a contact model is fitted to flat faces of {LEAST_SHAPES} shapes ({', '.join(FACES)}), balls, and "
            f"{LEAST_HARDNESSES} hardnesses of Shore A {LEAST_SHORE:g} or more, at least: list more [[indenters]] in "
            "the bench's file"
        )
    for kind, ones in (("flat faces", faces), ("balls", balls)):
        for one in ones:  # a fit finds no hardness far beyond those that it has
            others = {tool.shore_a for tool in ones if tool.radius_m != one.radius_m}
            if len(others) < 2 or not min(others) - MAX_SHORE_A <= one.shore_a <= max(others) + MAX_SHORE_A:
                raise InputError(
                    f"the hardness of {one.told()} is judged by a fit without its size: list {kind} of other sizes and "
                    f"two hardnesses, Shore A {one.shore_a + MAX_SHORE_A:.0f} or softer and "
                    f"{one.shore_a - MAX_SHORE_A:.0f} or harder among them, as [[indenters]]"
                )


def _about_the_middle(board: Board, depth_m: float, shear_m: float, reach_m: tuple[float, float] | None) -> Span:
    span = span_of(board, depth_m, shear_m, reach_m)
    half_x_m, half_y_m = (min(a, b) for a, b in zip(span[:2], TOOL_PLACE_M, strict=True))
    return span._replace(half_x_m=half_x_m, half_y_m=half_y_m)


TASK = Task(
    "contact", "indenters", Counts(0, 72, 24, 0), Counts(0, 18, 6, 0), 1.7, 0.0, 6.0,
    "% of the largest normal force, RMS", _about_the_middle, indents, indents, _indent_word, _indent_figures,
    _contact_left_out, check=check,
)  # fmt: skip
