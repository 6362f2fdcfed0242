"""A wrench of features: the F-TOUCH paper's loads through a connector; judged by all axes that the board measures.

A gel without markers measures the normal force alone: straight presses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Outcome
from ruffini.estimators.task import NO_SHORE, Counts, Task, Word, joined
from ruffini.estimators.wrench.log import measured_axes
from ruffini.rig.found import is_held
from ruffini.rig.log_file import Log, TouchRecord, stated_wrench
from ruffini.rig.program import CONDITIONS, ByHand, Condition, Item, Span, plan, span_of

Array = npt.NDArray[np.float64]

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
FORCE_N, TORQUE_NM, NORMAL_N = 1.0, 0.02, 8.0  # as far as the F-TOUCH paper's sensor goes, Table III


def _loaded_word(board: Board, __: Log, touch: TouchRecord, true: Array) -> Word:
    """Every frame while it is loaded: a hand never holds still."""
    held = is_held(touch.arrays["stream_host_s"], touch.facts)
    return Word(
        stated_wrench(touch)[held],
        true[held] * measured_axes(board),
        np.full((held.sum(), 2), np.nan),
        NO_SHORE,
    )


def _wrench_figures(words: list[Word]) -> dict[str, Any]:
    said, true, *_ = joined(words)
    full = np.abs(true).max(axis=0)
    rmse = np.sqrt(np.mean((np.nan_to_num(said) - true) ** 2, axis=0))
    is_loaded = full > 0  # an axis that nothing loaded tells nothing
    return {
        "error": 100 * float(np.sqrt(np.mean((rmse[is_loaded] / full[is_loaded]) ** 2))), "touches": len(words),
        "axes_rmse_n_nm": rmse.tolist(), "axes_full_n_nm": full.tolist(),
        "not_measured": [name for name, column in zip(AXES, said.T, strict=True) if np.isnan(column).all()],
        "largest_force_n": float(np.linalg.norm(true[:, :3], axis=1).max()),
    }  # fmt: skip


def _wrench_left_out(outcomes: dict[str, Outcome]) -> float:
    axes = [axis for axis in outcomes["wrench"].report["axes"].values() if axis["full_scale"] or axis["rmse"]]
    part = [axis["rmse"] / axis["full_scale"] if axis["full_scale"] else 1.0 for axis in axes]
    return 100 * float(np.sqrt(np.mean(np.square(part))))


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


TASK = Task(
    "wrench", "conditions", Counts(0, 54, 20, 0), Counts(0, 18, 8, 0), 0.8, 0.0, 6.0,
    "% of what each axis was loaded with, RMS", span_of, _loads, judged_loads, _loaded_word, _wrench_figures,
    _wrench_left_out,
)  # fmt: skip


def _straight(span: Span, n: int, seed: int) -> Sequence[Item]:
    return plan("balls", span, n, seed)


PRESSES = replace(
    TASK, program="balls", whole=Counts(0, 60, 20, 0), quick=Counts(0, 16, 6, 0),
    unit="% of the largest normal force, RMS", fitted=_straight, judged=_straight, scale_part=1.0,
)  # fmt: skip
