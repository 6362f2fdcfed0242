"""Recorded ball presses that the fit has not seen reach what depth needs.

The recording is not part of the repository: RUFFINI_RECORDED_DATA names the folder that holds
`gelsight-ball-presses/`.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest
from kept import kept

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.estimators.photometric.fitted import fit_presses
from ruffini.estimators.photometric.presses import load_presses
from ruffini.evaluate.photometric import evaluate

BOARD = find_board(Path(__file__).parents[3] / "boards" / "gelsight-mini")
DATA = os.environ.get("RUFFINI_RECORDED_DATA", "")
FOLDER = Path(DATA) / "gelsight-ball-presses"
BALL_MM, PX_PER_MM = 4.70, 19.58

pytestmark = pytest.mark.skipif(
    not DATA or not FOLDER.is_dir(), reason="RUFFINI_RECORDED_DATA does not name the recorded data"
)


@pytest.mark.parametrize("half", [0, 1])
def test_half_of_the_presses_fitted_and_the_other_judged(half: int) -> None:
    presses = load_presses(FOLDER, ball_mm=BALL_MM, px_per_mm=PX_PER_MM)
    fit = kept(fit_presses, replace(presses, presses=presses.presses[half::2]), BOARD, is_foreign=True)
    assert fit.report["is_balanced"]
    assert fit.report["bend_stiffness"] is not None
    file = container.pack(fit.tensors, {**container.base_metadata(BOARD), **fit.metadata})
    others = replace(presses, presses=presses.presses[1 - half :: 2])
    judged = evaluate(others, file, BOARD, [], [])[0]["refitted"]
    assert 2 < judged["normal_median_deg"] < 5
    assert judged["normal_worst_deg"] <= 7
    assert 0.02 < judged["cap_median_mm"] <= 0.08
    assert 0.95 <= judged["peak_to_edge_median"] <= 1.05
    assert judged["peak_to_edge_least"] >= 0.85
    assert judged["peak_to_edge_most"] <= 1.15
