"""What `ruffini cal auto` does for each kind of estimator: which touches it collects, and how it judges a word on them.

| estimator | stage of [pipeline] | collected | error |
| --- | --- | --- | --- |
| forces by finite elements | operator | ball presses for the colours, then a grid with shear | force |
| wrench of features | feature_wrench | the F-TOUCH paper's loads through a connector | all six axes |
| glowing skin | skin | straight presses all round | force above 2 N, and the place |
| contact model of a texture | contact_model | presses of changed indenters | normal force, and their hardness |
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Outcome
from ruffini.calibrate.gates import HARD_N
from ruffini.errors import InputError
from ruffini.rig.found import is_held, is_settled
from ruffini.rig.log_file import CONTACT_SHORE, Log, TouchRecord
from ruffini.rig.program import (
    CONDITIONS,
    INDENTERS,
    ByHand,
    Condition,
    Indent,
    Item,
    Span,
    Tool,
    Touch,
    plan,
    span_of,
    spread,
)

Array = npt.NDArray[np.float64]

FITTED_PART = 0.7  # of the span, in which an operator's touches lie; the judged ones are all over it
LONG_EACH, LONG_S = 8, 3.0  # each eighth touch is held so long
NO_SHORE = np.full((0, 2), np.nan)
AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
TOOLS = ("flat", "sphere", "square", "sphere", "triangle", "sphere")  # in turn: half of them are balls
TOOL_RADIUS_M, TOOL_SHORE_A = (4.2e-3, 5.5e-3), (20.0, 85.0)  # such that no press is above 15 N
TOOL_PLACE_M = (2.2e-3, 1.8e-3)  # from the middle: the texture beside the contact is what tells
FORCE_N, TORQUE_NM, NORMAL_N = 1.0, 0.02, 8.0  # as far as the F-TOUCH paper's sensor goes, Table III


class Counts(NamedTuple):
    """Touches of each step, and simulated ones behind an operator's stated uncertainty."""

    balls: int
    fitted: int
    judged: int
    error_touches: int


class Word(NamedTuple):
    """What sensor and truth (the twin's, or the reference's) say of one touch, a row for each frame that counts.

    said, true : (k, 6) N and N m ON the pad, NaN where not measured; off_m (k, 2): how far off a skin's contact lies;
    shore (k, 2): hardness of the object, as said and as it is.
    """

    said: Array
    true: Array
    off_m: Array
    shore: Array


@dataclass(frozen=True)
class Task:
    """One kind of estimator. `figures` has `error`, in `unit`; `left_out` is the same figure, cross-validated."""

    name: str
    stage: str
    program: str  # of the touches that it is fitted to
    whole: Counts
    quick: Counts
    depth_mm: float
    shear_mm: float
    ball_mm: float
    unit: str  # of `error`, as text
    span: Callable[[Board, float, float, tuple[float, float] | None], Span]
    fitted: Callable[[Span, int, int], Sequence[Item]]
    judged: Callable[[Span, int, int], Sequence[Item]]
    word: Callable[[Board, Log, TouchRecord, Array], Word]
    figures: Callable[[list[Word]], dict[str, Any]]
    left_out: Callable[[dict[str, Outcome]], float]


def task_of(board: Board) -> Task:
    """How a board is calibrated.

    Raises
    ------
    InputError
        It has no estimator that can be fitted.
    """
    stages = set(board.pipeline.stages)
    for task in TASKS:
        if task.stage in stages and (task.stage != "operator" or has_depth(board)):
            return task
    raise InputError(f"board {board.name!r} has no estimator yet that `cal auto` could fit: its stages "
                     f"({', '.join(board.pipeline.stages)}) make no force, no wrench, no skin's contacts")  # fmt: skip


def has_depth(board: Board) -> bool:
    """Whether a board measures depth, which forces are solved from: by its light, or by its markers' motion."""
    return "photometric" in board.pipeline.stages or board.depth.source == "markers"


def _forces_word(_: Board, __: Log, touch: TouchRecord, true: Array) -> Word:
    """The end of the hold, as one row: what a touch says."""
    held = is_settled(touch.arrays["stream_host_s"], touch.facts)
    said = touch.arrays["stream_wrench"][held].mean(axis=0, keepdims=True)
    return Word(said, true[held].mean(axis=0, keepdims=True), np.full((1, 2), np.nan), NO_SHORE)


def _loaded_word(_: Board, __: Log, touch: TouchRecord, true: Array) -> Word:
    """Every frame while it is loaded: a hand never holds still."""
    held = is_held(touch.arrays["stream_host_s"], touch.facts)
    return Word(touch.arrays["stream_wrench"][held], true[held], np.full((held.sum(), 2), np.nan), NO_SHORE)


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


def _indent_word(_: Board, __: Log, touch: TouchRecord, true: Array) -> Word:
    """Every frame from the contact on; the hardness that is told last, and that of the indenter."""
    held = is_held(touch.arrays["stream_host_s"], touch.facts)
    shore = touch.arrays.get(CONTACT_SHORE, np.zeros(0))
    told = shore[np.isfinite(shore)]
    rows = np.full((int(held.sum()), 2), np.nan)
    rows[-1:] = (told[-1] if len(told) else np.nan), touch.facts["tool"]["shore_a"]
    return Word(touch.arrays["stream_wrench"][held], true[held], np.full_like(rows, np.nan), rows)


def _indent_figures(words: list[Word]) -> dict[str, Any]:
    said, true, _, shore = _joined(words)
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


def _forces_figures(words: list[Word]) -> dict[str, Any]:
    said, true, *_ = _joined(words)
    error, largest = np.linalg.norm((said - true)[:, :3], axis=1), float(np.linalg.norm(true[:, :3], axis=1).max())
    rmse = float(np.sqrt(np.mean(error**2)))
    return {
        "error": 1e3 * rmse, "touches": len(words), "force_rmse_n": rmse,
        "force_p95_n": float(np.percentile(error, 95)), "force_worst_n": float(error.max()),
        "axes_rmse_n_nm": np.sqrt(np.mean((said - true) ** 2, axis=0)).tolist(), "largest_force_n": largest,
    }  # fmt: skip


def _wrench_figures(words: list[Word]) -> dict[str, Any]:
    said, true, *_ = _joined(words)
    full = np.abs(true).max(axis=0)
    rmse = np.sqrt(np.mean((np.nan_to_num(said) - true) ** 2, axis=0))
    return {
        "error": 100 * float(np.sqrt(np.mean((rmse / full) ** 2))), "touches": len(words),
        "axes_rmse_n_nm": rmse.tolist(), "axes_full_n_nm": full.tolist(),
        "not_measured": [name for name, column in zip(AXES, said.T, strict=True) if np.isnan(column).all()],
        "largest_force_n": float(np.linalg.norm(true[:, :3], axis=1).max()),
    }  # fmt: skip


def _skin_figures(words: list[Word]) -> dict[str, Any]:
    said, true, off_m, _ = _joined(words)
    off_n, load = np.abs(said - true)[:, 2], np.abs(true[:, 2])
    is_hard, is_told = load > HARD_N, np.isfinite(off_m).all(axis=1)
    away = np.linalg.norm(off_m[is_told], axis=1)
    return {
        "error": float(100 * np.mean((off_n / load)[is_hard])) if is_hard.any() else float("nan"),
        "touches": len(words), "hard_touches": int(is_hard.sum()), "untold": int((~is_told).sum()),
        "force_rmse_n": float(np.sqrt(np.mean(off_n**2))), "largest_force_n": float(load.max()),
        "place_mm": float(1e3 * away.mean()) if len(away) else None,
    }  # fmt: skip


def _joined(words: list[Word]) -> Word:
    return Word(*(np.concatenate(column) for column in zip(*words, strict=True)))


def _contact_left_out(outcomes: dict[str, Outcome]) -> float:
    report = outcomes["contact"].report
    return 100 * float(report["left_out_sizes"]["all"]["normal_n"]) / float(report["largest_n"])


def _forces_left_out(outcomes: dict[str, Outcome]) -> float:
    return 1e3 * float(outcomes["material"].report["left_out"]["force_rmse_n"])


def _wrench_left_out(outcomes: dict[str, Outcome]) -> float:
    axes = outcomes["wrench"].report["axes"].values()
    part = [axis["rmse"] / axis["full_scale"] if axis["full_scale"] else 1.0 for axis in axes]
    return 100 * float(np.sqrt(np.mean(np.square(part))))


def _skin_left_out(outcomes: dict[str, Outcome]) -> float:
    return float(outcomes["skin"].report["force_error_percent"])


def _grid_inside(span: Span, n: int, seed: int) -> Sequence[Item]:
    """Where a dent does not reach the rim that the depth is gauged by; some are held long enough to see it relax."""
    inside = span._replace(half_x_m=FITTED_PART * span.half_x_m, half_y_m=FITTED_PART * span.half_y_m)
    touches = plan("grid", inside, n, seed)
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


def _loads(_: Span, n: int, seed: int) -> Sequence[Item]:
    return plan("conditions", Span(0.0, 0.0, 0.0, 0.0), n, seed,
                ByHand(force_n=FORCE_N, torque_nm=TORQUE_NM, normal_n=NORMAL_N))  # fmt: skip


def judged_loads(_: Span, n: int, seed: int) -> Sequence[Item]:
    """Axes mixed at random, as no condition of the program has them; the normal force only presses."""
    rng, known, loads = np.random.default_rng(seed), set(CONDITIONS), list[Item]()
    while len(loads) < n:
        signs = rng.integers(-1, 2, 6)
        signs[2] = -abs(signs[2])
        if signs.any() and tuple(signs.tolist()) not in known:
            loads.append(Condition(tuple(signs.tolist()), FORCE_N, TORQUE_NM, NORMAL_N))
    return loads


def _straight(span: Span, n: int, seed: int) -> Sequence[Item]:
    return plan("balls", span, n, seed)


def indents(span: Span, n: int, seed: int) -> Sequence[Item]:
    """Indenters of sizes and hardnesses spread over their ranges, each at a place of its own."""
    rng = np.random.default_rng(seed)
    radius, shore = (rng.permutation(np.linspace(*ends, n)) for ends in (TOOL_RADIUS_M, TOOL_SHORE_A))
    # A seed of its own has sizes of its own, too.
    step = (TOOL_RADIUS_M[1] - TOOL_RADIUS_M[0]) / n
    radius = np.clip(radius + rng.uniform(-0.4, 0.4, n) * step, *TOOL_RADIUS_M)
    return [
        Indent(Tool(TOOLS[i % len(TOOLS)], float(radius[i]), float(shore[i])), float((2 * x - 1) * span.half_x_m),
               float((2 * y - 1) * span.half_y_m), span.deepest_m)
        for i, (x, y, _) in enumerate(spread(n, rng))
    ]  # fmt: skip


def _about_the_middle(board: Board, depth_m: float, shear_m: float, reach_m: tuple[float, float] | None) -> Span:
    span = span_of(board, depth_m, shear_m, reach_m)
    half_x_m, half_y_m = (min(a, b) for a, b in zip(span[:2], TOOL_PLACE_M, strict=True))
    return span._replace(half_x_m=half_x_m, half_y_m=half_y_m)


def _all_round(board: Board, depth_m: float, shear_m: float, reach_m: tuple[float, float] | None) -> Span:
    """A tube is pressed all the way round."""
    span = span_of(board, depth_m, shear_m, reach_m)
    is_tube = board.skin is not None and board.skin.shape == "tube"
    return span._replace(half_x_m=board.pad.size_x_um * 5e-7) if is_tube else span


FORCES = Task(
    "forces", "operator", "grid", Counts(30, 40, 20, 120), Counts(16, 16, 8, 40), 0.8, 0.3, 6.0, "mN RMS of force",
    span_of, _grid_inside, judged_touches, _forces_word, _forces_figures, _forces_left_out,
)  # fmt: skip
WRENCH = Task(
    "wrench", "feature_wrench", "conditions", Counts(0, 54, 20, 0), Counts(0, 18, 8, 0), 0.8, 0.0, 6.0,
    "% of what each axis was loaded with, RMS", span_of, _loads, judged_loads, _loaded_word, _wrench_figures,
    _wrench_left_out,
)  # fmt: skip
SKIN = Task(
    "skin", "skin", "balls", Counts(0, 60, 20, 0), Counts(0, 24, 6, 0), 3.4, 0.0, 10.0, "% of a force above 2 N, mean",
    _all_round, _straight, _straight, _skin_word, _skin_figures, _skin_left_out,
)  # fmt: skip
CONTACT = Task(
    "contact", "contact_model", INDENTERS, Counts(0, 72, 24, 0), Counts(0, 18, 6, 0), 1.7, 0.0, 6.0,
    "% of the largest normal force, RMS", _about_the_middle, indents, indents, _indent_word, _indent_figures,
    _contact_left_out,
)  # fmt: skip
TASKS = (CONTACT, FORCES, WRENCH, SKIN)  # a contact model's wrench is of features, too
